"""Values of transformers' image processors, which test_vision_patches.py compares with.

`python tests/contrib/vision_patches_values.py` writes vision_patches_values.json anew; it needs transformers and torchvision.
The committed values are of transformers 5.24.0 and torchvision 0.29.1 on the CPU. In the file is, for each case, what the
processor says of the sizes, and some pixels of its patches as levels from 0 to 255.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

FILE = Path(__file__).with_suffix(".json")
SAMPLES = 97

# layout, height and width of the image, options
CASES: list[tuple[str, tuple[int, int], dict[str, Any]]] = [
    ("qwen2_vl", (100, 200), {}),
    ("qwen2_vl", (37, 41), {}),
    ("qwen2_vl", (5, 300), {"min_pixels": 3136, "max_pixels": 12544}),
    ("qwen2_vl", (233, 410), {"min_pixels": 784, "max_pixels": 30000, "temporal_patch_size": 1}),
    ("qwen2_vl", (90, 64), {"patch_size": 16}),
    ("siglip2", (100, 200), {}),
    ("siglip2", (300, 121), {"max_num_patches": 40}),
    ("siglip2", (7, 400), {"max_num_patches": 16, "patch_size": 8}),
]


def image(height: int, width: int) -> Tensor:
    """Bytes (3, height, width): a smooth image with noise in one of its channels."""
    c, y, x = torch.meshgrid(torch.arange(3), torch.arange(height), torch.arange(width), indexing="ij")
    noise = (y * y * 7 + x * x * 13 + x * y * 5) % 256
    smooth = 128 + 100 * torch.sin(x / 9.0 + c) * torch.cos(y / 13.0)
    return torch.where(c == 1, noise, smooth.round().long()).to(torch.uint8)


def sampled(patches: Tensor) -> Tensor:
    """SAMPLES numbers of patches, from the first to the last one."""
    flat = patches.flatten()
    return flat[torch.linspace(0, len(flat) - 1, SAMPLES, dtype=torch.float64).long().to(flat.device)]


def main() -> None:
    from transformers.models.qwen2_vl.image_processing_qwen2_vl import Qwen2VLImageProcessor
    from transformers.models.siglip2.image_processing_siglip2 import Siglip2ImageProcessor

    values = []
    for layout, size, options in CASES:
        if layout == "qwen2_vl":
            result = Qwen2VLImageProcessor(do_normalize=False, do_rescale=False, **options)(
                image(*size), return_tensors="pt"
            )
            patches, grid, count = result["pixel_values"], result["image_grid_thw"], None
        else:
            result = Siglip2ImageProcessor(do_normalize=False, do_rescale=False, **options)(
                image(*size), return_tensors="pt"
            )
            patches, grid = result["pixel_values"], result["spatial_shapes"]
            count = int(result["pixel_attention_mask"].sum())
            patches = patches[:, :count]
        entry = {"grid": grid.tolist(), "count": count, "mean": round(patches.double().mean().item(), 3)}
        values.append(entry | {"levels": [int(v) for v in sampled(patches).tolist()]})
    FILE.write_text("[\n" + ",\n".join(json.dumps(v, separators=(",", ":")) for v in values) + "\n]\n")


if __name__ == "__main__":
    main()
