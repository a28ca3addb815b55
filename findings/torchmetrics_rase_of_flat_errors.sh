#!/usr/bin/env bash
# torchmetrics 1.9.0: the relative average spectral error is too large by the number of pixels in its window, 64 by default.
# Believed: RASE is what its definition says, 100 / M * sqrt(mean over bands of RMSE^2) with the mean radiance M, a percentage: 10 where
# 0.05 is added to a flat 0.5, whatever the window. Seen: 640, and 160 or 2560 with windows of 4 and 16 pixels a side, because the mean of
# the target in a window is divided by the pixels of the window a second time. The RMSE itself, root_mean_squared_error_using_sliding_window, is
# right. Divide by window_size ** 2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchmetrics==1.9.0 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import torch
import torchmetrics
from torchmetrics.functional.image import relative_average_spectral_error as rase
from torchmetrics.functional.image import root_mean_squared_error_using_sliding_window as sliding_rmse

print("torchmetrics", torchmetrics.__version__)
target = torch.full((1, 3, 64, 64), 0.5)
for size in (4, 8, 16):
    seen, rmse = rase(target + 0.05, target, window_size=size).item(), sliding_rmse(target + 0.05, target, window_size=size).item()
    print(f"window of {size}: RMSE {rmse:.4f}, RASE {seen:.1f}, by its definition {100 * rmse / 0.5:.1f}")
    assert abs(rmse - 0.05) < 1e-5 and abs(seen / (10 * size**2) - 1) < 1e-3
PROGRAM
