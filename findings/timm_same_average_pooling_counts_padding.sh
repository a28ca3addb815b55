#!/usr/bin/env bash
# timm 1.0.31 (torch 2.14.1): average pooling with padding="same" and a stride counts the padding, also with count_include_pad=False.
# Believed: "same" is TensorFlow's, whose averages leave the padding out, and count_include_pad=False, as NASNet's layers pass it, means what it
# means in torch. Seen: of ones, 7 x 7, create_pool2d("avg", 3, 2, padding="same", count_include_pad=False) makes .44 in the corners and .67 along the
# edges, the same as with True, and so it is for other sizes, windows and strides above 1. With stride 1, and with padding=1, the same function
# gives ones. Borders of a map, most of it in small ones, are darker than in the network that was converted.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet timm==1.0.31 torchvision==0.29.1 torch==2.14.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import timm
import torch
from timm.layers import create_pool2d
from torch.nn.functional import pad

print("timm", timm.__version__, "torch", torch.__version__)
torch.manual_seed(0)


def pooled(image, window, stride):
    """By TensorFlow's rule of SAME, which gives the last row and column the odd padding: averages of all cells, and of those inside."""
    down, right = (max((-(-n // stride) - 1) * stride + window - n, 0) for n in image.shape[-2:])
    around = [right // 2, right - right // 2, down // 2, down - down // 2]
    sums, cells = (pad(each, around).unfold(-2, window, stride).unfold(-2, window, stride).sum((-2, -1)) for each in (image, torch.ones_like(image)))
    return sums / window**2, sums / cells


ones = torch.ones(1, 1, 7, 7)
result = create_pool2d("avg", 3, 2, padding="same", count_include_pad=False)(ones)[0, 0]
print(f"of ones, padding same: corner {result[0, 0]:.2f}, edge {result[0, 1]:.2f}, middle {result[1, 1]:.2f}")
assert torch.allclose(result[0, :2], torch.tensor([4 / 9, 6 / 9])) and result[1, 1] == 1
assert torch.equal(create_pool2d("avg", 3, 2, padding=1, count_include_pad=False)(ones), torch.ones(1, 1, 4, 4))
for height, width, window, stride in ((7, 7, 3, 2), (14, 9, 5, 2), (10, 10, 4, 3), (8, 11, 3, 1)):
    image = torch.rand(2, 3, height, width)
    with_padding, without = (create_pool2d("avg", window, stride, padding="same", count_include_pad=count)(image) for count in (True, False))
    of_all, of_inside = pooled(image, window, stride)
    wrong = (abs(without / of_inside - 1) > 1e-4).double().mean().item()
    least = (without / of_inside).min().item()
    print(f"{height} x {width}, window {window}, stride {stride}: {wrong:.0%} of the averages are wrong, down to {least:.2f} of the right one")
    assert torch.allclose(with_padding, of_all, atol=1e-6) and torch.allclose(without, of_inside if stride == 1 else of_all, atol=1e-6)
    assert (wrong > 0.2) == (stride > 1)
PROGRAM
