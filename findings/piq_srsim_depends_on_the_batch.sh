#!/usr/bin/env bash
# piq 0.8.0 with torch 2.14.1: SR-SIM of a pair of images depends on what else is in the batch, .91 alone and .94 beside another pair.
# Believed: reduction="none" gives the score of each pair, which is that of the pair alone, so that batches only save time, as with eleven other metrics of
# the package that were tried. Seen: in a batch of two the score rises by .03 to .04, whatever the other pair is but a copy of the first. So a mean
# over a data set depends on batch_size and on the order, and the last, smaller batch is scored otherwise than the rest. Call it with one
# pair at a time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet piq==0.8.0 torch==2.14.1 torchvision==0.29.1 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import piq
import torch

print("piq", version("piq"), "torch", torch.__version__)
torch.manual_seed(0)


def picture(window):
    smooth = torch.nn.functional.avg_pool2d(torch.rand(1, 3, 199 + window, 239 + window), window, 1)
    return (smooth - smooth.min()) / (smooth.max() - smooth.min())


def noisy(image):
    return (image + 0.05 * torch.randn(image.shape)).clamp(0, 1)


first, second = picture(9), picture(5)
pair = first, noisy(first)
beside = {
    "itself": pair,
    "another pair": (second, noisy(second)),
    "two equal images": (second, second),
    "noise": (torch.rand_like(first),) * 2,
}
metrics = (
    "srsim",
    "ssim",
    "multi_scale_ssim",
    "fsim",
    "vsi",
    "gmsd",
    "multi_scale_gmsd",
    "mdsi",
    "dss",
    "haarpsi",
    "vif_p",
    "information_weighted_ssim",
)
for name in metrics:
    metric = getattr(piq, name)
    alone = metric(*pair, data_range=1.0, reduction="none").item()
    scores = {
        other: metric(*(torch.cat(both) for both in zip(pair, images)), data_range=1.0, reduction="none")[0].item()
        for other, images in beside.items()
    }
    print(f"{name}: alone {alone:.4f}, beside", {other: round(score, 4) for other, score in scores.items()})
    if name == "srsim":
        assert all((0.02 < score - alone < 0.05) == (other != "itself") for other, score in scores.items())
        assert abs(scores["itself"] - alone) < 1e-4
    else:
        assert all(abs(score - alone) < 1e-4 for score in scores.values())
PROGRAM
