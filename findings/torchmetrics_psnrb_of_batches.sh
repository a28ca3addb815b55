#!/usr/bin/env bash
# torchmetrics 1.9.0: PSNR with blocked effect falls with the size of the batch, by 8 dB from 1 image to 8.
# Believed: a metric of a batch is a mean of its images, or at least that of one image where all are the same, and the module does not depend on
# how a data set is cut into batches. Seen: squared errors are divided by their number, block effects are summed over the batch and over updates
# and divided by the pixels of one image: PSNRB of a JPEG file of quality 5 is 21.7 dB alone, 19.4 in a batch of two copies, 13.9 in one of eight,
# and as low after eight updates. Take the functional form, one image a call, and average.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchmetrics==1.9.0 torch==2.13.0 numpy==2.4.6 pillow==13.0.0
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import io

import numpy as np
import torch
import torchmetrics
from PIL import Image
from torchmetrics.functional.image import peak_signal_noise_ratio_with_blocked_effect as psnrb
from torchmetrics.image import PeakSignalNoiseRatioWithBlockedEffect

print("torchmetrics", torchmetrics.__version__)
y, x = np.mgrid[:96, :96]
original = np.uint8(128 + 60 * np.sin(x / 5 + y / 9) + 50 * np.cos(y / 4))
file = io.BytesIO()
Image.fromarray(original).save(file, "JPEG", quality=5)
target, decoded = (torch.tensor(np.array(image))[None, None] / 255 for image in (original, Image.open(file)))
batches = [psnrb(decoded.repeat(n, 1, 1, 1), target.repeat(n, 1, 1, 1), data_range=1.0).item() for n in (1, 2, 8, 32)]
metric = PeakSignalNoiseRatioWithBlockedEffect(data_range=1.0)
for _ in range(8):
    metric.update(decoded, target)
print("batches of 1, 2, 8, 32 copies:", np.round(batches, 2), f"eight updates of one: {metric.compute():.2f} dB")
assert np.allclose(batches, [21.70, 19.38, 13.95, 8.10], atol=0.3) and abs(metric.compute().item() - batches[2]) < 0.01
PROGRAM
