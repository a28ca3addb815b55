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


class TestExactDistances(OpTests):
    function = staticmethod(C.distance_transform)
    module = staticmethod(C.DistanceTransform)
    operators = ("distance_transform_exact",)
    accepted = ("input of one axis more",)  # a volume
    variants = [{"exact": True}]
    differentiable = False
    shape = (2, 2, 13, 18)

    def input(self, shape, dtype, device):
        return (torch.rand(shape) < 0.05).to(dtype).to(device)


@pytest.mark.parametrize(
    "shape", [(1, 1, 1, 1), (2, 3, 1, 37), (1, 1, 70, 1), (2, 2, 45, 130), (1, 2, 7, 8, 9), (1, 1, 33, 3, 65)]
)
def test_exact_distances_are_scipys(shape, device):
    for share in (0.9, 0.3, 0.01):  # with a source in every image, as SciPy's distance to none is another
        image = (torch.rand(shape, device=device) < share).double().flatten(2)
        image[..., image.shape[2] // 2] = 1
        image = image.view(shape)
        distances = C.distance_transform(image, exact=True)
        for masks, actual in zip(image.flatten(0, 1).cpu(), distances.flatten(0, 1).cpu(), strict=True):
            assert_close(actual, torch.from_numpy(scipy.ndimage.distance_transform_edt(1 - masks.numpy())), 1e-15, 0)


def test_exact_distance_without_sources(device):
    assert C.distance_transform(torch.zeros(1, 1, 3, 3, device=device), exact=True).isinf().all()
    assert C.distance_transform(torch.zeros(0, 1, 3, 3, device=device), exact=True).shape == (0, 1, 3, 3)
    one = torch.zeros(2, 1, 40, 33, device=device)
    one[1, 0, 39, 32] = 1
    distances = C.distance_transform(one, exact=True)
    assert distances[0].isinf().all() and distances[1, 0, 0, 0] == (39**2 + 32**2) ** 0.5


def test_exact_distances_of_long_images_are_exact(device):
    """Squares above 2^24 are no longer whole numbers in float32."""
    image = torch.zeros(1, 1, 2, 20_001, device=device)
    image[..., 0, 0] = 1
    distances = C.distance_transform(image, exact=True)
    assert distances[0, 0, 0].tolist() == list(range(20_001))
    with K.backend("native"), pytest.raises(RuntimeError, match="too large for distances in 32 bits"):
        C.distance_transform(torch.zeros(1, 1, 1, 32_768, device=device), exact=True)


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
