"""The augmentations of Kornia with the parameters that it drew give the same images."""

from __future__ import annotations

import pytest
import torch

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import IMAGES, MAPS, Augmentation

KA = pytest.importorskip("kornia.augmentation")

# docs/differences.md: RandomAffine turns the other way, RandomThinPlateSpline centers its kernels elsewhere, and Kornia's
# RandomRotation90 is not exact at the border.
DIFFERENT = ("RandomAffine", "RandomRotation90", "SmallestMaxSize", "RandomThinPlateSpline")
CASES = [case for case in IMAGES if case.name not in DIFFERENT and hasattr(KA, case.name)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_same_parameters_give_the_same_images(case: Augmentation) -> None:
    theirs = getattr(KA, case.name)(*case.args, **case.kwargs)
    x = torch.rand(5, 3, 16, 20)
    expected = theirs(x)
    ours = getattr(A, case.name)(*case.args, **case.kwargs)
    torch.testing.assert_close(ours(x, params=dict(theirs._params)), expected, rtol=1e-4, atol=1e-5)
    if case not in MAPS:
        torch.testing.assert_close(ours.transform_matrix, theirs.transform_matrix.float(), rtol=1e-4, atol=1e-4)
    assert set(ours._params) == set(theirs._params)
