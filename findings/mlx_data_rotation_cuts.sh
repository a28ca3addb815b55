#!/usr/bin/env bash
# mlx-data 0.1.0: image_rotate cuts a fifth of an image off where it is told not to crop, and by 180 degrees it loses a row and a column.
# Believed: crop=False, the default, "crop to the original size" being off, gives all of the turned image, 96 x 120 pixels by 90 degrees 120 x 96, and
# crop=True keeps the size. Seen: by 90 degrees without crop the result is 96 x 96 and has columns 12 to 107 of 120 in it, the ends of the longer side are
# gone; by 0 and by 180 it is 120 x 120. With crop the content of 180 degrees lies one pixel to the right and below, its first row and
# column black, as does that of 90 degrees. A turn by 0 degrees with crop and turns of 30 and 45 degrees have all of the image.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mlx-data==0.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
from importlib.metadata import version

import mlx.data
import numpy as np

print("mlx-data", version("mlx-data"))
row, column = np.mgrid[:96, :120]
image = np.stack([column + 1, row + 1, np.full_like(row, 255)], -1).astype(np.uint8)
crops = {
    (0, False): (120, 120),
    (0, True): (96, 120),
    (90, False): (96, 96),
    (90, True): (96, 120),
    (180, False): (120, 120),
    (180, True): (96, 120),
    (30, False): (151, 151),
    (45, False): (152, 152),
}
for (angle, crop), size in crops.items():
    result = np.asarray(mlx.data.buffer_from_vector([{"image": image}]).image_rotate("image", float(angle), crop)[0]["image"])
    inside = result[..., 2] == 255
    columns, rows = (np.unique(result[..., channel][inside]) - 1 for channel in (0, 1))
    print(f"{angle} degrees, crop={crop}: {result.shape[:2]}, has columns {columns[0]} to {columns[-1]}, rows {rows[0]} to {rows[-1]}")
    assert result.shape[:2] == size
    if angle in (30, 45) or (angle, crop) == (0, True):
        assert (columns[0], columns[-1], rows[0], rows[-1]) == (0, 119, 0, 95)
    if angle == 90:
        assert (columns[0], columns[-1]) == (12, 107)
    if (angle, crop) == (180, True):
        assert not result[0].any() and not result[:, 0].any() and (result[1:, 1:] == image[::-1, ::-1][:-1, :-1]).all()
PROGRAM
