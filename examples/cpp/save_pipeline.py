"""Save a pipeline for run_pipeline.cpp, which runs it without Python: as an AOTInductor package and as a traced module.

    python examples/cpp/save_pipeline.py --image photo.jpg --device cuda --out build/pipeline

writes pipeline.pt2 (torch.export and AOTInductor: any batch), pipeline.pt (torch.jit.trace: the sizes it was traced with) and
case.pt, an input with the results of Python, for run_pipeline to compare with.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import torch
from torch import Tensor, nn

import kvision as K
from kvision.demo.arguments import device_of, images_of, require


class Pipeline(nn.Module):
    """How much of the detail of a photograph a blur keeps, and the edges that it leaves.

    The image is blurred, turned gray and straightened by a learned matrix. The results are its edges, (B, 1, H, W), and
    its mean structural similarity with what the same matrix makes of the sharp image, (B,).
    """

    def __init__(self) -> None:
        super().__init__()
        self.blur = K.filters.GaussianBlur2d((5, 5), (1.5, 1.5))
        self.matrix = nn.Parameter(torch.tensor([[0.998, 0.052, -12.0], [-0.052, 0.998, 13.0]]))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        straight = self.straighten(self.blur(image))
        similarity = K.metrics.ssim(straight, self.straighten(image), 11).mean(dim=(1, 2, 3))
        return K.filters.sobel(straight), similarity

    def straighten(self, image: Tensor) -> Tensor:
        gray = K.color.rgb_to_grayscale(image)
        matrices = self.matrix.expand(image.shape[0], 2, 3)
        return K.geometry.warp_affine(gray, matrices, image.shape[-2:], padding_mode="border")


def save(pipeline: nn.Module, image: Tensor, folder: Path) -> None:
    """Write pipeline.pt2, pipeline.pt and case.pt."""
    folder.mkdir(parents=True, exist_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # torch 2.13 warns of its own code
        program = torch.export.export(pipeline, (image,), dynamic_shapes=({0: torch.export.Dim.DYNAMIC},))
        torch._inductor.aoti_compile_and_package(program, package_path=str(folder / "pipeline.pt2"))
        warnings.simplefilter("ignore")  # each size that is recorded as a number
        torch.jit.trace(pipeline, image).save(str(folder / "pipeline.pt"))

    with torch.no_grad():
        edges, similarity = pipeline(image)
    torch.save({"image": image.detach(), "edges": edges, "similarity": similarity}, folder / "case.pt")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--image", type=Path, help="an image; default: a photograph of scikit-image")
    parser.add_argument("--device", default="cpu", help="where the pipeline will run: cpu or cuda")
    parser.add_argument("--out", type=Path, default=Path("build/pipeline"), help="folder for the files")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.image is None:
        require(parser, "skimage")
        (image,) = K.io.get_sample_images(paths=("astronaut",))
    else:
        image = images_of(parser, [options.image])[0][0]
    batch = torch.stack([image, image.flip(-1)]).to(device)
    save(Pipeline().to(device).eval(), batch, options.out)
    print(f"{options.out} has pipeline.pt2, pipeline.pt and case.pt, {tuple(batch.shape)}")


if __name__ == "__main__":
    main()
