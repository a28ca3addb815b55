#!/usr/bin/env bash
# scikit-image 0.26.0: sato, frangi, meijering and hessian find other ridges near the border in a transposed image.
# Believed: ridge filters do not care for orientation; the result of a transposed image is the transposed result, and the mixed derivative
# is the same whichever comes first. Seen with the defaults on "camera" at half size, 256 x 256: sato is up to 22% of its maximum off, meijering 17%,
# frangi 10%, and hessian, which is 0 to 1, by 1. It is the mixed term of hessian_matrix(use_gaussian_derivatives=True): the first derivative is
# mirrored at the border like an image, where it ought to change its sign. Reach: 10 pixels for sigma 3, 29 for sigma 9; inside all is well.
# use_gaussian_derivatives=False is symmetric, and so is padding the image by its mirror image first, and cropping after.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import warnings

import numpy as np
import skimage
from skimage import data, feature, filters

warnings.simplefilter("ignore")
print("scikit-image", skimage.__version__)
image = data.camera()[::2, ::2] / 255.0


def off(f):
    """The largest difference between the result of the transposed image and the transposed result, and the largest value."""
    result = f(image)
    difference = abs(f(np.ascontiguousarray(image.T)).T - result)
    return difference.max() / result.max(), difference[48:-48, 48:-48].max() / result.max()


def padded(f):
    return lambda x: f(np.pad(x, 48, mode="symmetric"))[48:-48, 48:-48]


for name, low, high in (("sato", 0.15, 0.3), ("meijering", 0.1, 0.25), ("frangi", 0.05, 0.15), ("hessian", 0.9, 1.01)):
    f = getattr(filters, name)
    at_all, inside = off(f)
    apart = off(padded(f))[0]
    print(f"{name}: {at_all:.1%} of its maximum off, {inside:.1%} away from the border; with padding {apart:.1%}")
    assert low < at_all < high and inside < 1e-6
    assert name == "hessian" or apart < 1e-6
for sigma, reach in ((1, 3), (3, 10), (9, 29)):
    for gaussian in (True, False):
        options = {"sigma": sigma, "mode": "reflect", "order": "rc", "use_gaussian_derivatives": gaussian}
        (rr, rc, cc), (rr_turned, rc_turned, cc_turned) = (feature.hessian_matrix(x, **options) for x in (image, image.T))
        assert np.allclose(rr, cc_turned.T) and np.allclose(cc, rr_turned.T)
        wrong = np.argwhere(abs(rc - rc_turned.T) > 1e-6 * abs(rc).max())
        depth = max((min(y, x, 255 - y, 255 - x) for y, x in wrong), default=-1) + 1
        share = abs(rc - rc_turned.T).max() / abs(rc).max()
        print(f"sigma {sigma}, use_gaussian_derivatives={gaussian}: the mixed derivative is {share:.0%} off, {depth} pixels deep")
        assert depth == (reach if gaussian else 0)
PROGRAM
