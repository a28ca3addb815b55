#!/usr/bin/env bash
# torchmetrics 1.9.0: visual information fidelity takes images for 0..255 whatever they are, and finds those in 0..1 nearly perfect.
# Believed: a metric without data_range does not depend on the range, or finds it, and images in 0..1 are as good as others. Seen: the noise of the eye in
# its model has a variance of 2, which is meant for bytes. The same pair, with noise of .2 of the range, scores .12 as 0..255, which is the
# definition's value, .96 as 0..1 and .04 as 0..65535, and noise of .05 even 1.006 as 0..1, so that methods that networks compare in their own range
# all look alike. There is no warning. Multiply by 255 first. SSIM and PSNR of the package take data_range.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchmetrics==1.9.0 torch==2.13.0 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import numpy as np
import torch
import torchmetrics
from scipy import signal
from torchmetrics.functional.image import visual_information_fidelity as vif

print("torchmetrics", torchmetrics.__version__)
torch.manual_seed(0)
smooth = torch.nn.functional.avg_pool2d(torch.rand(1, 1, 208, 248), 9, 1)
image = (smooth - smooth.min()) / (smooth.max() - smooth.min())
noise = torch.randn(image.shape)


def by_definition(reference, distorted, eye=2.0):
    """In the pixel domain, as published: four scales, Gaussian windows of 17, 9, 5 and 3 pixels."""
    seen = whole = 0.0
    for scale in range(4):
        size = 2 ** (4 - scale) + 1
        line = np.exp(-((np.arange(size) - size // 2) ** 2) / (2 * (size / 5) ** 2))
        window = np.outer(line, line) / line.sum() ** 2

        def mean(x):
            return signal.convolve2d(x, window, "valid")

        if scale:
            reference, distorted = mean(reference)[::2, ::2], mean(distorted)[::2, ::2]
        m1, m2 = mean(reference), mean(distorted)
        v1, v2 = np.maximum(mean(reference**2) - m1**2, 0), np.maximum(mean(distorted**2) - m2**2, 0)
        both = mean(reference * distorted) - m1 * m2
        gain = np.maximum(both / (v1 + 1e-10), 0)
        rest = np.maximum(v2 - gain * both, 1e-10)
        seen += np.log10(1 + gain**2 * v1 / (rest + eye)).sum()
        whole += np.log10(1 + v1 / eye).sum()
    return seen / whole


for sigma in (0.05, 0.2):
    other = (image + sigma * noise).clamp(0, 1)
    scores = {top: vif(other * top, image * top).item() for top in (1, 255, 65535)}
    exact = by_definition(255.0 * image[0, 0].double().numpy(), 255.0 * other[0, 0].double().numpy())
    print(
        f"noise of {sigma}: as 0..1 {scores[1]:.3f}, as 0..255 {scores[255]:.3f}, as 0..65535 {scores[65535]:.3f}; by the definition for bytes {exact:.3f}"
    )
    assert abs(scores[255] - exact) < 0.005 and scores[1] > 0.95 and scores[65535] < 0.5 * exact < 0.2
PROGRAM
