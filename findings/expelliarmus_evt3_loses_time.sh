#!/usr/bin/env bash
# expelliarmus 1.1.12: EVT3 files that it writes lose the time of the events, all but its lowest 4.096 milliseconds.
# Believed: events written by Wizard(encoding="evt3").save and read again are those that went in, as with the encodings "dat" and "evt2". Seen: the
# upper half of the time, the word EVT_TIME_HIGH, is written once, before the first event. By the format's definition, written out below, a whole file
# lies within 4.096 ms; its own reader guesses the rest where events are less than that apart, so that a dense recording survives, but 1600
# events over 8 s come back within 1.45 s, and what begins 20 s into a recording begins at 3.2 s. x, y and polarity are right, and nothing warns.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet expelliarmus==1.1.12 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PROGRAM'
import sys
from importlib.metadata import version

import numpy as np
from expelliarmus import Wizard

print("expelliarmus", version("expelliarmus"))
random = np.random.default_rng(0)
kind = np.dtype([("t", np.int64), ("x", np.int16), ("y", np.int16), ("p", np.uint8)], align=True)


def by_definition(path):
    data = open(path, "rb").read()
    while data.startswith(b"%"):  # the header
        data = data[data.index(b"\n") + 1 :]
    high = low = 0
    times, highs = [], 0
    for word in np.frombuffer(data, "<u2").tolist():
        name, value = word >> 12, word & 0xFFF
        if name == 0x8:
            high, highs = value, highs + 1
        elif name == 0x6:
            low = value
        elif name == 0x2:  # an event
            times.append(high << 12 | low)
    return np.array(times), highs


for name, start, step in (("one per 100 us", 0, 100), ("one per 5 ms", 0, 5000), ("one per 100 us, from 20 s", 20_000_000, 100)):
    events = np.zeros(1600, kind)
    events["t"] = start + np.arange(1600) * step
    events["x"], events["y"], events["p"] = random.integers(0, 640, 1600), random.integers(0, 480, 1600), random.integers(0, 2, 1600)
    back = {}
    for encoding, ending in (("dat", "dat"), ("evt2", "raw"), ("evt3", "raw")):
        path = f"{sys.argv[1]}/{encoding}.{ending}"
        Wizard(encoding=encoding).save(path, events)
        back[encoding] = Wizard(encoding=encoding).read(path)
        assert all(np.array_equal(back[encoding][field], events[field]) for field in "xyp")
    times, highs = by_definition(f"{sys.argv[1]}/evt3.raw")
    spans = {encoding: (int(read["t"][0]), int(read["t"][-1])) for encoding, read in back.items()}
    print(
        f"{name}: written {events['t'][0]} to {events['t'][-1]}, read {spans}, by the definition {times.min()} to {times.max()}, {highs} time high"
    )
    assert highs == 1 and times.max() - times.min() < 4096
    assert np.array_equal(back["dat"]["t"], events["t"]) and np.array_equal(back["evt2"]["t"], events["t"])
    survives = np.array_equal(back["evt3"]["t"], events["t"])
    assert survives == (name == "one per 100 us")
    if step == 5000:
        assert 1_440_000 < back["evt3"]["t"][-1] < 1_450_000
    elif start:
        assert np.array_equal(back["evt3"]["t"], events["t"] - 2**24)
PROGRAM
