#!/usr/bin/env bash
# transformers 5.24.0 without torchvision: image processors resize floats in 256 levels, rounded down, and images of 0 and 1 in two.
# Believed: images in [0, 1] with do_rescale=False, as the warning about scaled images advises, are resized as numbers, as the same processor does
# where torchvision is installed. Seen of AutoImageProcessor without it, which takes the backend "pil" by itself: images go to bytes and back, so that a
# ramp from .50 to .51, as in a map of depth or heat, has 4 values in place of 64, and it and noise get half of 1/255 darker. Floats that are all 0 or 1
# have no gray pixels afterwards, and are bytes, while the same times .999 have them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet transformers==5.24.0 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import json
import tempfile
from pathlib import Path

import numpy as np
import transformers
from PIL import Image

print("transformers", transformers.__version__)
images = {
    "ramp": np.tile(np.linspace(0.5, 0.51, 256, dtype=np.float32), (256, 1)),
    "noise": np.random.default_rng(0).random((256, 256), np.float32),
    "checks": (np.indices((256, 256)).sum(0) % 16 < 5).astype(np.float32),
}
images["checks * .999"] = images["checks"] * np.float32(0.999)
for kind in ("ViTImageProcessor", "CLIPImageProcessor"):
    options = {"size": {"height": 64, "width": 64}, "resample": int(Image.Resampling.BILINEAR)}
    options |= {"do_rescale": False, "do_normalize": False, "do_center_crop": False}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "preprocessor_config.json").write_text(json.dumps({"image_processor_type": kind, **options}))
        processor = transformers.AutoImageProcessor.from_pretrained(folder)
    assert processor.backend == "pil"
    for name, image in images.items():
        result = np.asarray(processor(np.stack([image] * 3, axis=-1), return_tensors="np")["pixel_values"][0][0])
        exact = np.asarray(Image.fromarray(image).resize((64, 64), Image.Resampling.BILINEAR))
        values, exact_values, off = len(np.unique(result)), len(np.unique(exact)), (result - exact) * 255
        print(f"{type(processor).__name__}, {name}: {result.dtype}, {values} values, {exact_values} by Pillow in floats;",
              f"{off.mean():+.2f} levels of 255 on average, at most {abs(off).max():.2f} off")
        if name == "checks":
            assert result.dtype == np.uint8 and values == 2 and exact_values > 10 and abs(off).max() > 100
        else:
            levels = result.astype(np.float64) * 255
            assert result.dtype == np.float32 and np.allclose(levels, np.round(levels), atol=1e-4) and off.mean() < -0.3
            assert name != "ramp" or (values, exact_values) == (4, 64)
PROGRAM
