"""The augmentations of Kornia with the parameters that it drew give the same images."""

from __future__ import annotations

import pytest
import torch

import kvision.augmentation as A
from augmentation_cases import CASES, MAPS, Case

KA = pytest.importorskip("kornia.augmentation")

# docs/differences.md: RandomAffine turns the other way, RandomThinPlateSpline centers its kernels elsewhere, and Kornia's
# RandomRotation90 is not exact at the border.
DIFFERENT = ("RandomAffine", "RandomRotation90", "SmallestMaxSize", "RandomThinPlateSpline")


@pytest.mark.parametrize("case", [c for c in CASES if c.name not in DIFFERENT], ids=lambda case: case.name)
def test_same_parameters_give_the_same_images(case: Case) -> None:
    fisheye = case.name == "RandomFisheye"  # takes tensors in Kornia
    args = [torch.tensor(a) if isinstance(a, list) or fisheye else a for a in case.args]
    theirs = getattr(KA, case.name)(*args, **case.kwargs)
    x = torch.rand(5, 3, 16, 20)
    expected = theirs(x)
    ours = getattr(A, case.name)(*case.args, **case.kwargs)
    torch.testing.assert_close(ours(x, params=dict(theirs._params)), expected, rtol=1e-4, atol=1e-5)
    if case not in MAPS:
        torch.testing.assert_close(ours.transform_matrix, theirs.transform_matrix.float(), rtol=1e-4, atol=1e-4)
    assert set(ours._params) == set(theirs._params)
