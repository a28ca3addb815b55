#!/usr/bin/env bash
# torchvision 0.29.1 (torch 2.14.1): decode_image of a PNG file with a palette gives indices by default, and of few colors not even those.
# Believed: mode UNCHANGED, the default, gives the file's channels, as it does for gray and for RGB. Seen: a palette of 256 colors gives one
# channel of indices, which looks like a gray image, and the palette is nowhere. With four colors, of which PNG stores four pixels in a
# byte, each row begins with these bytes: the indices 0, 1, 2, 3 are the value 27. The modes RGB and GRAY are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torchvision==0.29.1 torch==2.14.1 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import io
import warnings

import numpy as np
import torch
import torchvision
from PIL import Image
from torchvision.io import decode_image

warnings.simplefilter("ignore")  # deprecation
print("torchvision", torchvision.__version__, "torch", torch.__version__)
for colors, first in ((256, [0, 1, 2, 3]), (4, [27, 27, 27, 27])):
    picture = Image.fromarray(np.tile((np.arange(16) % colors).astype(np.uint8), (4, 1)), "P")
    picture.putpalette([x for i in range(colors) for x in (255 - i, 40, i)])
    file = io.BytesIO()
    picture.save(file, "PNG", bits=8 if colors == 256 else 2)
    data = torch.frombuffer(bytearray(file.getvalue()), dtype=torch.uint8)
    unchanged, rgb = decode_image(data), decode_image(data, "RGB")
    row = unchanged[0, 0, :4].tolist()
    print(f"{colors} colors: UNCHANGED {tuple(unchanged.shape)}, a row begins with {row}, in RGB with {rgb[:, 0, 0].tolist()}")
    assert unchanged.shape == (1, 4, 16) and row == first
    assert rgb[:, 0, 3].tolist() == [252, 40, 3]
PROGRAM
