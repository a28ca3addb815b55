#!/usr/bin/env bash
# batchgenerators 0.25.5: the noise_variance of GaussianNoiseTransform is the standard deviation, so that its noise is a tenth of what .01 says.
# Believed: "variance is uniformly sampled from that range", as its documentation says, so that the default (0, .1) is noise with a deviation of up to
# .32 in images normalized to 1. Seen: noise_variance=(.1, .1) has a variance of .010 and a deviation of .100, (.01, .01) a deviation of
# .01 for .1, and (4, 4) one of 4 for 2. Settings taken over from scikit-image, whose random_noise(var=.1) has a variance of .1, are weaker below 1 and
# stronger above.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet batchgenerators==0.25.5 scikit-image==0.26.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import importlib.metadata

import numpy as np
from batchgenerators.transforms.noise_transforms import GaussianNoiseTransform
from skimage.util import random_noise

print("batchgenerators", importlib.metadata.version("batchgenerators"))
np.random.seed(0)
for variance in (0.01, 0.1, 1, 4):
    image = np.zeros((1, 1, 400, 400))
    noise = GaussianNoiseTransform(noise_variance=(variance, variance))(data=image.copy())["data"]
    peer = random_noise(image[0, 0], var=variance, clip=False, rng=0)
    print(f"noise_variance {variance}: variance {noise.var():.4f}, deviation {noise.std():.3f}; random_noise of scikit-image has {peer.var():.4f}")
    assert abs(noise.std() / variance - 1) < 0.02 and abs(peer.var() / variance - 1) < 0.02
PROGRAM
