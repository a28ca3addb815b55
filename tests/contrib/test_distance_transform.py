"""Distances: the kernel's tests, known values, and those of SciPy and Kornia 0.9."""

from __future__ import annotations

import pytest
import scipy.ndimage
import torch

import kvision as K
from op_tests import OpTests, assert_close

C = K.contrib


class TestDistanceTransform(OpTests):
    function = staticmethod(C.distance_transform)
    module = staticmethod(C.DistanceTransform)
    operators = ("distance_transform_step",)
    variants = [{}, {"kernel_size": 5, "h": 0.3}]
    errors = [({"kernel_size": 4}, ValueError, "expected kernel_size to be odd")]
    differentiable = False  # no step has a kernel then; TestCompositions of test_contrib.py has its gradients
    shape = (2, 2, 13, 18)
    small = (1, 1, 4, 5)

    def input(self, shape, dtype, device):
        return (0.7 * torch.rand(shape)).mul(torch.rand(shape) < 0.05).to(dtype).to(device)

    def expected(self, x, kwargs):
        with K.backend("reference"):
            return self.call(x, kwargs)


def test_distance_is_scipys(device):
    image = (torch.rand(2, 2, 30, 41, device=device) < 0.01).double()
    image[:, :, 3, 4] = 1
    expected = torch.from_numpy(scipy.ndimage.distance_transform_edt(1 - image[1, 1].cpu().numpy()))
    assert_close(C.distance_transform(image, exact=True)[1, 1].cpu(), expected)
    volume = (torch.rand(1, 1, 7, 8, 9) < 0.03).double()
    volume[..., 0] = 0
    volume[..., 3, 4, 5] = 1
    expected = torch.from_numpy(scipy.ndimage.distance_transform_edt(1 - volume[0, 0].numpy()))
    assert_close(C.distance_transform(volume, exact=True)[0, 0], expected)
    assert C.distance_transform(torch.zeros(1, 1, 3, 3), exact=True).isinf().all()


def test_distance_is_kornias():
    kornia = pytest.importorskip("kornia.contrib")
    image = (torch.rand(2, 1, 20, 17, dtype=torch.float64) < 0.02).double()
    image[:, :, 3, 4] = 1
    for size, h in ((3, 0.35), (7, 0.4)):
        assert_close(C.distance_transform(image, size, h), kornia.distance_transform(image, size, h), 1e-7, 1e-7)
    volume = (torch.rand(1, 2, 6, 7, 8, dtype=torch.float64) < 0.05).double()
    assert_close(C.distance_transform(volume), kornia.distance_transform(volume), 1e-7, 1e-7)
    assert_close(C.DistanceTransform(5)(image), C.distance_transform(image, 5))


def test_distance_has_finite_gradients(device):
    for fill in (0.0, 1.0):
        x = torch.full((1, 1, 8, 8), fill, device=device, requires_grad=True)
        C.distance_transform(x).sum().backward()
        assert x.grad.isfinite().all()


def test_distance_of_integers(device):
    mask = torch.zeros(1, 1, 5, 6, dtype=torch.uint8, device=device)
    mask[..., 2, 3] = 1
    for exact in (False, True):
        assert_close(C.distance_transform(mask, exact=exact), C.distance_transform(mask.float(), exact=exact))
