#!/usr/bin/env bash
# tonic 1.7.0: SpatialJitter moves events by half a pixel to the left and up on average, however small the jitter.
# Believed: what its documentation says, a Gaussian around each event's place, "mean = [x,y]", so that a picture of jittered events is blurred and
# lies where it was, as frames, boxes and labels beside it do. Seen of 20000 events: the mean is (-.5, -.5) at variances of .0001, .01, .25, 1 and
# 4; at .0001, a hundredth of a pixel, half of the events move by a whole one, all of them to the left, and a line in column 64 comes to 63.5.
# Coordinates are whole numbers, and fractions are cut off after the jitter. Variance 0 moves nothing. Jitter in floats and round, or add .5 first.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet h5py==3.16.0 importRosbag==1.0.4 scipy==1.17.1 tqdm==4.67.1 typing-extensions==4.15.0 expelliarmus==1.1.12
"$folder/venv/bin/pip" install --quiet requests==2.32.5 numpy==2.4.6
"$folder/venv/bin/pip" install --quiet --no-deps tonic==1.7.0  # librosa, which it asks for, is for sounds
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
from importlib.metadata import version

import numpy as np
import tonic.transforms as transforms
from tonic.io import make_structured_array

print("tonic", version("tonic"))
np.random.seed(0)
count, sensor = 20000, (128, 96, 2)
random = np.random.default_rng(0)
x, y = random.integers(10, 118, count), random.integers(10, 86, count)
events = make_structured_array(x, y, np.arange(count) * 10, random.integers(0, 2, count))
for variance in (0.0001, 0.01, 0.25, 1, 4):
    result = transforms.SpatialJitter(sensor, var_x=variance, var_y=variance)(events.copy())
    moved = [result["x"].astype(int) - x, result["y"].astype(int) - y]
    by = [part.mean() for part in moved]
    print(f"variance {variance}: events move by {np.round(by, 2)} on average, {np.mean(moved[0] != 0):.0%} of them along x,", end=" ")
    print("rounded it would be", np.round(np.mean(np.round(random.normal(0, variance**0.5, count))), 2))
    assert np.allclose(by, -0.5, atol=0.05) and (variance > 0.01 or abs(np.mean(moved[0] != 0) - 0.5) < 0.02)
    if variance <= 0.01:
        assert set(np.unique(moved[0]).tolist()) == {-1, 0}
still = transforms.SpatialJitter(sensor, var_x=0, var_y=0)(events.copy())
print("variance 0: events as they were:", bool(np.array_equal(still["x"], events["x"])))
line = make_structured_array(np.full(count, 64), y, np.arange(count) * 10, np.ones(count, int))
frame = transforms.ToImage(sensor)(transforms.SpatialJitter(sensor, var_x=1, var_y=1)(line)).sum(0)
center = (frame * np.arange(128)).sum() / frame.sum()
print(f"a line in column 64 has its center in column {center:.2f}")
assert abs(center - 63.5) < 0.05
PROGRAM
