#!/usr/bin/env bash
# torchvision 0.29.1 (torch 2.14.1): v2.Grayscale and v2.RandomGrayscale hand videos back in color, and v2.RGB hands gray ones back gray.
# Believed: what the documentation of these classes says, that they convert images or videos. Seen: a tv_tensors.Video keeps its channels
# and its values without a word, where the same frames as tv_tensors.Image become gray. The colors of ColorJitter change for both.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import torch
from torchvision import tv_tensors
from torchvision.transforms import v2

frames = torch.arange(2 * 3 * 4 * 5).mul(2).to(torch.uint8).reshape(2, 3, 4, 5)
steps = {"Grayscale(3)": v2.Grayscale(3), "RandomGrayscale(1)": v2.RandomGrayscale(1.0), "ColorJitter(2)": v2.ColorJitter((2.0, 2.0))}
changed = {}
for kind in (tv_tensors.Image, tv_tensors.Video):
    for name, step in steps.items():
        result = step(kind(frames))
        changed[kind.__name__, name] = not torch.equal(result, frames)
        print(f"{kind.__name__:5} {name:18} {'changed' if changed[kind.__name__, name] else 'as it was'}")
print("RGB of a gray image:", v2.RGB()(tv_tensors.Image(frames[:, :1])).shape[1], "channels")
print("RGB of a gray video:", v2.RGB()(tv_tensors.Video(frames[:, :1])).shape[1], "channel")
assert all(changed["Image", name] for name in steps) and changed["Video", "ColorJitter(2)"]
assert not changed["Video", "Grayscale(3)"] and not changed["Video", "RandomGrayscale(1)"]
assert v2.RGB()(tv_tensors.Image(frames[:, :1])).shape[1] == 3 and v2.RGB()(tv_tensors.Video(frames[:, :1])).shape[1] == 1
PROGRAM
