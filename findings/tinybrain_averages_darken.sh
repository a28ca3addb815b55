#!/usr/bin/env bash
# tinybrain 1.7.0: downsample_with_averaging of bytes and uint16 rounds down, by .38 levels in the first level of a pyramid and .49 from the third on.
# Believed: a mean of bytes is rounded to the nearest level, so that a coarse level of an image volume is as bright as a fine one, where thresholds and
# statistics are made for all levels. Seen of noise: no voxel is above the exact mean and some are a whole level below, also of uint16, and three calls one
# after the other, which a pipeline makes by stages, are 1.1 levels too dark where num_mips=3 is .48. Means of floats are exact.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet tinybrain==1.7.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import importlib.metadata

import numpy as np
import tinybrain

print("tinybrain", importlib.metadata.version("tinybrain"))
noise = np.random.default_rng(0).integers(0, 256, (96, 96, 24, 1)).astype(np.uint8)
exact, stages = noise.astype(float), noise
for level, small in enumerate(tinybrain.downsample_with_averaging(noise, factor=(2, 2, 1), num_mips=3)):
    exact = exact.reshape(exact.shape[0] // 2, 2, exact.shape[1] // 2, 2, 24, 1).mean((1, 3))
    stages = tinybrain.downsample_with_averaging(stages, factor=(2, 2, 1))[0]
    off, by_stages = small - exact, (stages - exact).mean()
    print(f"level {level + 1} by (2, 2, 1): {off.mean():.3f} levels from the exact mean, {off.min():.2f} to {off.max():.2f}, by stages {by_stages:.3f}")
    assert abs(off.mean() - (-0.375, -0.47, -0.49)[level]) < 0.02 and off.max() <= 0
    assert abs(by_stages + 0.375 * (level + 1)) < 0.03
for kind in (np.uint16, np.float32):
    small = tinybrain.downsample_with_averaging(noise.astype(kind), factor=(2, 2, 1))[0]
    off = small.mean() - noise.mean()
    print(f"{kind.__name__}: {off:.3f}")
    assert abs(off + (0.375 if kind == np.uint16 else 0)) < 0.02
for factor in ((2, 2, 2), (3, 3, 1), (4, 4, 1)):
    off = tinybrain.downsample_with_averaging(noise, factor=factor)[0].mean() - noise.mean()
    print(f"by {factor}: {off:.3f}")
    assert -0.5 < off < -0.4
PROGRAM
