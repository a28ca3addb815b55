"""Morphology: the values of SciPy, OpenCV and Kornia 0.9, and gradients."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch

import kvision as K
from composition_tests import Case, CompositionTests, on
from op_tests import assert_close

M = K.morphology
NAMES = ("dilation", "erosion", "opening", "closing", "gradient", "top_hat", "bottom_hat")
CROSS = torch.tensor([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
CORNER = torch.tensor([[1.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
HEIGHTS = torch.tensor([[0.1, 0.2, 0.0], [0.3, 0.7, -0.2], [0.0, 0.1, 0.4]], dtype=torch.float64)


@pytest.fixture(scope="module")
def kornia():
    return pytest.importorskip("kornia.morphology")


class TestMorphology(CompositionTests):
    cases = {
        "dilation": Case(lambda x: M.dilation(x, torch.ones(3, 3, device=x.device)), ((2, 3, 7, 6),)),
        "erosion": Case(lambda x: M.erosion(x, on(x.device, CROSS), border_type="constant"), ((2, 3, 7, 6),)),
        "heights": Case(lambda x, h: M.dilation(x, on(x.device, CROSS), h), ((2, 1, 5, 4), (3, 3)), (1,)),
        "opening": Case(lambda x: M.opening(x, torch.ones(2, 3, device=x.device)), ((2, 1, 5, 6),)),
        "reconstruction": Case(lambda x, m: M.reconstruction(x, m, num_iters=2), ((2, 1, 5, 6),) * 2),
    }
    compiled = ("dilation",)

    def test_transforms(self, case, name, device):
        if name == "heights":
            pytest.skip("one element serves the whole batch")
        super().test_transforms(case, device)


@pytest.mark.parametrize("options", [{}, {"border_type": "constant", "border_value": 0.4}, {"origin": [0, 1]}], ids=str)
@pytest.mark.parametrize("kernel", [torch.ones(3, 3), torch.ones(2, 5), CROSS, CORNER], ids=lambda k: str(k.tolist()))
@pytest.mark.parametrize("name", NAMES)
def test_kornia(kornia, name, kernel, options):
    x = torch.rand(2, 3, 9, 8, dtype=torch.float64)
    assert_close(getattr(M, name)(x, kernel, **options), getattr(kornia, name)(x, kernel, **options))


@pytest.mark.parametrize("name", NAMES)
def test_heights(kornia, name):
    x = torch.rand(2, 3, 9, 8, dtype=torch.float64)
    assert_close(getattr(M, name)(x, CROSS, HEIGHTS), getattr(kornia, name)(x, CROSS, HEIGHTS))
    for ours, theirs in ((M.dilation, scipy.ndimage.grey_dilation), (M.erosion, scipy.ndimage.grey_erosion)):
        element = {"footprint": CROSS.numpy(), "structure": HEIGHTS.numpy()}
        expected = theirs(x[0, 0].numpy(), **element, mode="constant", cval=-9.0 if ours is M.dilation else 9.0)
        assert_close(ours(x, CROSS, HEIGHTS)[0, 0], torch.from_numpy(expected))


@pytest.mark.parametrize(
    "kernel", [torch.ones(3, 3), torch.ones(15, 15), torch.ones(1, 9), CROSS], ids=lambda k: str([*k.shape])
)
@pytest.mark.parametrize(
    "name, code", [("dilation", cv2.MORPH_DILATE), ("erosion", cv2.MORPH_ERODE), ("opening", cv2.MORPH_OPEN)]
)
def test_opencv(name, code, kernel, device):
    x = torch.rand(1, 1, 40, 41)
    expected = cv2.morphologyEx(x[0, 0].numpy(), code, kernel.numpy().astype(np.uint8))
    assert_close(getattr(M, name)(x.to(device), kernel.to(device))[0, 0].cpu(), torch.from_numpy(expected))


@pytest.mark.parametrize(
    "kernel", [torch.tensor([[0, 0, 0], [0, 1, 1], [0, 1, 0]]), torch.tensor([[1, 1, 0, 1], [0, 1, 1, 1]])]
)
def test_opencv_does_not_rotate_kernels(kernel):
    x = torch.randint(0, 256, (1, 1, 20, 21), dtype=torch.uint8)
    expected = torch.from_numpy(cv2.dilate(x[0, 0].numpy(), kernel.numpy().astype(np.uint8)))
    origin = [(n - 1) // 2 for n in kernel.shape]
    assert torch.equal(M.dilation(x, kernel.flip((0, 1)), origin=origin)[0, 0], expected)
    assert not torch.equal(M.dilation(x, kernel)[0, 0], expected)
    assert (M.opening(x, kernel) <= x).all() and (M.closing(x, kernel) >= x).all()


ELLIPSE = torch.from_numpy(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 7)))
CODES = {
    "dilation": cv2.MORPH_DILATE,
    "erosion": cv2.MORPH_ERODE,
    "opening": cv2.MORPH_OPEN,
    "closing": cv2.MORPH_CLOSE,
    "gradient": cv2.MORPH_GRADIENT,
    "top_hat": cv2.MORPH_TOPHAT,
    "bottom_hat": cv2.MORPH_BLACKHAT,
}


@pytest.mark.parametrize(
    "kernel", [torch.ones(3, 3), torch.ones(15, 15), CROSS, ELLIPSE], ids=lambda k: str([*k.shape])
)
@pytest.mark.parametrize("name", NAMES)
def test_bytes_are_opencvs(name, kernel, device):
    x = torch.randint(0, 256, (2, 3, 61, 83), dtype=torch.uint8, device=device)
    y = getattr(M, name)(x, kernel)
    for planes, result in zip(x.flatten(0, 1).cpu(), y.flatten(0, 1).cpu()):
        expected = cv2.morphologyEx(planes.numpy(), CODES[name], kernel.numpy().astype(np.uint8))
        assert torch.equal(result, torch.from_numpy(expected))


def test_differences_of_bytes_saturate(device):
    """A kernel without its center: the dilation is below the image somewhere."""
    x = torch.randint(0, 256, (1, 2, 20, 30), dtype=torch.uint8, device=device)
    kernel = torch.tensor([[1, 0, 0]])
    terms = {"gradient": (M.dilation, M.erosion), "top_hat": (None, M.opening), "bottom_hat": (M.closing, None)}
    for name, functions in terms.items():
        larger, smaller = (x if f is None else f(x, kernel) for f in functions)
        assert name != "gradient" or (larger < smaller).any()  # by definition the others are not negative
        expected = (larger.int() - smaller.int()).clamp(min=0).byte()
        assert torch.equal(getattr(M, name)(x, kernel), expected)


def test_bytes_with_heights_saturate(device):
    x = torch.randint(0, 256, (1, 2, 20, 30), dtype=torch.uint8, device=device)
    for function in (M.dilation, M.erosion):
        expected = function(x.float(), CROSS, 100 * HEIGHTS).round().clamp(0, 255).byte()
        assert torch.equal(function(x, CROSS, 100 * HEIGHTS), expected)


def test_reconstruction_of_bytes(device):
    mask = torch.randint(0, 256, (2, 1, 20, 21), dtype=torch.uint8, device=device)
    for method, seed in (("dilation", mask // 2), ("erosion", 255 - (255 - mask) // 2)):
        expected = M.reconstruction(seed.float(), mask.float(), method=method)
        assert torch.equal(M.reconstruction(seed, mask, method=method), expected.byte())


@pytest.mark.parametrize("method", ["dilation", "erosion"])
def test_reconstruction(method, device):
    morphology = pytest.importorskip("skimage.morphology")
    mask = torch.rand(1, 1, 20, 21, device=device)
    seed = mask - 0.2 if method == "dilation" else mask + 0.2
    expected = morphology.reconstruction(seed[0, 0].cpu().numpy(), mask[0, 0].cpu().numpy(), method=method)
    assert_close(M.reconstruction(seed, mask, method=method)[0, 0].cpu(), torch.from_numpy(expected).float())


def test_ties_share_the_gradient(device):
    x = torch.tensor([[[[1.0, 1.0, 0.0]]]], device=device, requires_grad=True)
    M.dilation(x, torch.ones(1, 3, device=device)).sum().backward()
    assert x.grad.flatten().tolist() == [1.0, 2.0, 0.0]  # the windows are 1 1, 1 1 0 and 1 0
    x = torch.zeros(1, 1, 1, 2, device=device, requires_grad=True)
    M.erosion(x, torch.ones(1, 3, device=device)).sum().backward()
    assert x.grad.flatten().tolist() == [1.0, 1.0]


def test_infinite_and_nan_pixels(device):
    x = torch.zeros(1, 1, 5, 5, device=device)
    x[..., 2, 2] = torch.inf
    cross = CROSS.to(device)
    y = M.dilation(x, cross)
    assert y.isinf().sum() == 5 and not y.isnan().any() and (M.erosion(x, cross) == 0).all()
    x[..., 2, 2] = torch.nan
    assert M.dilation(x, cross).isnan().sum() == M.erosion(x, cross).isnan().sum() == 5


def test_half(device):
    x = torch.rand(1, 1, 5, 6, device=device).half()
    assert_close(
        M.dilation(x, torch.ones(3, 3, device=device)), M.dilation(x.float(), torch.ones(3, 3, device=device)).half()
    )


@pytest.mark.parametrize("name", NAMES)
def test_errors(name):
    function, x, kernel = getattr(M, name), torch.rand(1, 1, 5, 5), torch.ones(3, 3)
    for arguments, options, error, message in [
        (([1.0], kernel), {}, TypeError, "expected tensor to be a Tensor"),
        ((x[0], kernel), {}, ValueError, "expected tensor of shape"),
        ((x, [1.0]), {}, TypeError, "expected kernel to be a Tensor"),
        ((x, kernel[0]), {}, ValueError, "expected kernel of shape"),
        ((x, kernel, kernel[:2]), {}, ValueError, "expected structuring_element of shape"),
        ((x, kernel), {"origin": [3, 0]}, ValueError, "expected an origin in the kernel"),
        ((x, kernel), {"border_type": "mirror"}, NotImplementedError, "border_type must be"),
        ((x, kernel), {"engine": "fast"}, NotImplementedError, "engine must be"),
    ]:
        with pytest.raises(error, match=f"{name}: {message}"):
            function(*arguments, **options)
    with pytest.raises(ValueError, match="reconstruction: expected kernel to be odd"):
        M.reconstruction(x, x, torch.ones(2, 2))


@pytest.mark.parametrize("method", ["dilation", "erosion"])
def test_reconstruction_under_vmap(method, device):
    """Without num_iters, until no sample changes; gradients flow, too."""
    mask = torch.rand(3, 2, 1, 7, 8, device=device)
    seed = mask - 0.4 if method == "dilation" else mask + 0.4

    def call(seed, mask):
        return M.reconstruction(seed, mask, method=method)

    expected = torch.stack([call(s, m) for s, m in zip(seed, mask)])
    assert_close(torch.vmap(call)(seed, mask), expected)
    grads = torch.vmap(torch.func.grad(lambda s, m: call(s, m).square().sum()))(seed, mask)
    each = [torch.func.grad(lambda s, m=m: call(s, m).square().sum())(s) for s, m in zip(seed, mask)]
    assert_close(grads, torch.stack(each))
