#!/usr/bin/env bash
# tonic 1.7.0: ToVoxelGrid counts off events as on where polarity is a bool, as in the package's own events, and drops the end of a recording.
# Believed: what its documentation says, the event volume of Zhu et al., 2019: on events count 1, off events -1, each shared by the two nearest of B
# bins that reach from the first event to the last, so that nothing is lost. Seen of 10001 events from make_structured_array: the grid of off events
# alone sums up to 9500, that of as many on as off to the same, in place of -10001 and -1. With polarity as an int signs are right, but 1 / (2 B) of
# all weight is missing at the end, a quarter with two bins, and the last bin holds twice what the first does, which the definition makes equal.
# Nothing warns.
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
from tonic.io import events_struct, make_structured_array

print("tonic", version("tonic"), "its events:", events_struct)
count, sensor = 10001, (4, 3, 2)
random = np.random.default_rng(0)
times = np.arange(count) * 100
x, y = random.integers(0, 4, count), random.integers(0, 3, count)
events = {
    "half on, half off": make_structured_array(x, y, times, np.arange(count) % 2),
    "all off": make_structured_array(x, y, times, np.zeros(count, int)),
    "all on": make_structured_array(x, y, times, np.ones(count, int)),
}


def by_definition(events, bins):
    """The events of each bin of Zhu et al., 2019, over all pixels: on is 1, off is -1, each shared by the two nearest bins."""
    place = (bins - 1) * (events["t"] - events["t"][0]) / (events["t"][-1] - events["t"][0])
    sign = np.where(events["p"], 1, -1)
    return np.array([(sign * np.clip(1 - np.abs(place - k), 0, None)).sum() for k in range(bins)])


for name, recorded in events.items():
    signed = recorded.astype([(field, int) for field in recorded.dtype.names])
    for bins in (10, 5, 2):
        grid = transforms.ToVoxelGrid(sensor, bins)
        seen, wide, right = grid(recorded).sum((1, 2, 3)), grid(signed).sum((1, 2, 3)), by_definition(recorded, bins)
        print(
            f"{name}, {bins} bins: sum {seen.sum():.0f}, with polarity as int {wide.sum():.0f}, by the definition {right.sum():.0f}",
            end="; ",
        )
        print("first and last bin", seen[[0, -1]].round(), "by the definition", right[[0, -1]].round())
        kept = count * (1 - 1 / (2 * bins))
        sign = {"half on, half off": 0, "all off": -1, "all on": 1}[name]
        assert abs(seen.sum() - kept) < 2 and abs(wide.sum() - sign * kept) < 2 and abs(right.sum() - sign * count) < 2
        if sign:
            assert np.isclose(right[0], right[-1], rtol=0.01) and seen[-1] > (1.9 if bins > 2 else 0.9) * seen[0]
PROGRAM
