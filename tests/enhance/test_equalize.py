"""equalize and equalize_clahe, compared with PIL, OpenCV and a plain loop."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
import skimage.data
import torch
from torch import Tensor

import kvision as K
from op_tests import OpTests, assert_close
from point_op_tests import Call, PointOpTests, vector

E = K.enhance


def photo(h: int, w: int, seed: int = 0) -> np.ndarray:
    """Smooth and noisy, with levels that miss and one that prevails."""
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:h, :w]
    values = 90 + 60 * np.sin(x / 9) * np.cos(y / 7) + generator.normal(0, 8, (h, w))
    values[: h // 4, : w // 4] = 30
    return values.clip(0, 255).astype(np.uint8)


def unit(levels: np.ndarray) -> Tensor:
    return torch.from_numpy(levels).float()[None, None] / 255


def to_levels(x: Tensor) -> np.ndarray:
    return (x[0, 0] * 255).round().byte().numpy()


class LevelTests(OpTests):
    """Results jump from level to level, so the reference computes in the type of the image."""

    differentiable = False
    shape = (2, 3, 23, 28)
    max_size = 21

    def expected(self, x: Tensor, kwargs: dict[str, Any]) -> Tensor:
        with K.backend("reference"):
            return self.call(x, kwargs)

    bytes = True

    # Other than filters, these refuse other integers and take images of two axes and more.

    def test_other_integers_become_float32(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.uint8)
        with pytest.raises(K.core.exceptions.TypeCheckError, match="floating point or uint8"):
            self.call(x.int(), kwargs)

    def test_wrong_kinds(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        for wrong, error in [(None, TypeError), (x.to(torch.complex64), TypeError), (x[0, 0, 0, 0], ValueError)]:
            with pytest.raises(error, match=f"^{self.function.__name__}: "):
                self.call(wrong, kwargs)


class TestEqualize(LevelTests):
    function = staticmethod(E.equalize)
    operators = ("equalize",)
    variants = [{}, {"opencv": True}]
    errors = [({"opencv": 1}, TypeError, "opencv to be a bool")]

    @pytest.mark.native
    @pytest.mark.large
    @pytest.mark.parametrize("size", [(256, 256), (301, 333), (700, 320)], ids=str)
    @pytest.mark.parametrize("planes", [1, 3, pytest.param(70, marks=pytest.mark.gpu)])
    def test_large_planes(self, size, planes, device):
        """One block a plane or several, in packs or not; with flat and NaN planes among them."""
        x = torch.rand(planes, 1, *size, device=device) ** 3
        x[-1] = 0.3
        x[0, 0, 5, 6] = torch.nan
        assert_close(E.equalize(x), self.expected(x, {}))

    def test_gradient_reaches_unchanged_pixels_only(self, device):
        """Nothing but NaN and planes that come back as they are."""
        x = torch.rand(2, 1, 20, 20, device=device)
        x[0] = 0.5
        x[1, 0, 3, 4] = torch.nan
        stays = torch.zeros_like(x)
        stays[0], stays[1, 0, 3, 4] = 1, 1
        for backend in ("auto", "reference"):
            with K.backend(backend):
                (grad,) = torch.autograd.grad(E.equalize(x.requires_grad_()).sum(), x)
                assert_close(grad, stays)
                tangent = torch.func.jvp(E.equalize, (x.detach(),), (torch.ones_like(x),))[1]
                assert_close(tangent, stays)


class TestClahe(LevelTests):
    function = staticmethod(E.equalize_clahe)
    operators = ("equalize_clahe",)
    tolerances = {torch.uint8: (0, 1)}  # a mixture of tables just above or below a half of a level
    variants = [
        {"clip_limit": 2.0, "grid_size": (3, 2)},
        {"clip_limit": 0.0, "grid_size": (1, 1)},
        {"clip_limit": 3.5, "grid_size": (5, 9)},
        {"clip_limit": 3.5, "grid_size": (5, 9), "opencv": True},
        # Integers, since limits get no gradient; 0 for none.
        {"clip_limit": lambda x: torch.arange(x.shape[0]), "grid_size": (3, 2)},
        {"clip_limit": lambda x: 1 + torch.arange(x.shape[0] * x.shape[1]).reshape(x.shape[:2]), "grid_size": (2, 2)},
    ]
    errors = [
        ({"clip_limit": -1.0}, ValueError, "clip_limit"),
        ({"clip_limit": torch.ones(7)}, ValueError, "clip_limit with the first axes of the images"),
        ({"grid_size": (0, 2)}, ValueError, "grid_size"),
        ({"opencv": 1}, TypeError, "opencv to be a bool"),
        ({"opencv": True, "slow_and_differentiable": True}, ValueError, "opencv without"),
    ]

    @pytest.mark.parametrize("size, grid", [((240, 320), (2, 2)), ((199, 203), (1, 3)), ((256, 256), (8, 8))], ids=str)
    def test_large_tiles(self, size, grid, device):
        x = torch.rand(2, 2, *size, device=device) ** 3
        x[0, 0], x[0, 1, 5, 6] = 0.3, torch.nan
        kwargs = {"clip_limit": 4.0, "grid_size": grid}
        self.check(E.equalize_clahe(x, **kwargs), self.expected(x, kwargs))

    @pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
    def test_bytes_are_those_of_the_cpu(self, layout, device):
        for size in ((64, 96), (45, 67), (300, 264), (90, 13)):
            x = torch.from_numpy(photo(6 * size[0], size[1])).view(2, 3, *size).contiguous(memory_format=layout)
            for opencv in (False, True):
                y, expected = (E.equalize_clahe(of, 3.0, (3, 5), opencv=opencv) for of in (x.to(device), x))
                assert_close(y.cpu(), expected, 0, 0)

    def test_more_tiles_than_pixels(self, device):
        x = torch.rand(1, 2, 7, 5, device=device)
        for grid in ((1, 1), (7, 5), (11, 2), (3, 40)):
            for opencv in (False, True):
                kwargs = {"clip_limit": 2.0, "grid_size": grid, "opencv": opencv}
                self.check(E.equalize_clahe(x, **kwargs), self.expected(x, kwargs))


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (16, 16), (40, 50), (120, 160)], ids=str)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16], ids=str)
def test_equalize_is_pils(size, dtype):
    image, ops = pytest.importorskip("PIL.Image"), pytest.importorskip("PIL.ImageOps")
    for seed in range(3):
        levels = photo(*size, seed)
        expected = np.asarray(ops.equalize(image.fromarray(levels)))
        assert np.array_equal(to_levels(E.equalize(unit(levels).to(dtype))), expected)


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (16, 16), (40, 50), (120, 160)], ids=str)
def test_equalize_equals_opencv_with_opencv_true(size, device):
    """OpenCV leaves the darkest bin out, PIL the brightest: the curves are close, not equal."""
    for seed in range(3):
        levels = photo(*size, seed)
        expected = cv2.equalizeHist(levels)
        assert np.array_equal(to_levels(E.equalize(unit(levels).to(device), opencv=True).cpu()), expected)
        of_bytes = E.equalize(torch.from_numpy(levels).to(device), opencv=True)
        assert np.array_equal(of_bytes.cpu().numpy(), expected)
        if size == (120, 160):
            assert 0 < np.median(np.abs(to_levels(E.equalize(unit(levels))).astype(int) - expected)) < 12


def test_equalize_equals_opencvs_on_photographs(device):
    for picture in (skimage.data.camera(), skimage.data.moon(), skimage.data.coffee()[..., 1]):
        actual = to_levels(E.equalize(unit(picture).to(device), opencv=True).cpu())
        assert np.array_equal(actual, cv2.equalizeHist(np.ascontiguousarray(picture)))


def test_equalize3d_counts_all_voxels(device):
    x = torch.rand(2, 1, 4, 20, 30, device=device)
    flat = E.equalize(x.reshape(2, 1, 80, 30)).reshape(x.shape)
    assert_close(E.equalize3d(x), flat)
    assert_close(E.equalize3d(x[0]), flat[0])


def test_values_outside_count_as_the_nearest():
    x = torch.rand(1, 1, 40, 40) * 1.4 - 0.2
    assert_close(E.equalize(x), E.equalize(x.clamp(0, 1)))
    assert_close(E.equalize_clahe(x, 3.0, (2, 2)), E.equalize_clahe(x.clamp(0, 1), 3.0, (2, 2)))


@pytest.mark.parametrize("size, grid", [((64, 64), (8, 8)), ((48, 96), (2, 4)), ((60, 44), (3, 2)), ((64, 64), (1, 1))])
@pytest.mark.parametrize("clip", [2.0, 40.0])
def test_clahe_is_opencvs(size, grid, clip):
    """Up to OpenCV's rounding and its tile centers, half a pixel away."""
    levels = photo(*size)
    expected = cv2.createCLAHE(clip, grid[::-1]).apply(levels)
    apart = np.abs(255 * E.equalize_clahe(unit(levels), clip, grid)[0, 0].numpy() - expected)
    step = 255 / 2 / min(size[0] // grid[0], size[1] // grid[1])  # what half a pixel can make, from black to white
    assert apart.max() < 0.5 + 2 * step and apart.mean() < 0.5 + step / 2
    if grid == (1, 1):
        assert apart.max() < 1e-3


@pytest.mark.parametrize("size, grid", [((64, 64), (8, 8)), ((63, 96), (2, 4)), ((61, 45), (3, 2)), ((50, 9), (1, 5))])
@pytest.mark.parametrize("clip", [0.0, 2.0, 40.0])
def test_clahe_equals_opencv_with_opencv_true(size, grid, clip, device):
    for seed in range(3):
        levels = photo(*size, seed)
        expected = cv2.createCLAHE(clip, grid[::-1]).apply(levels)
        actual = to_levels(E.equalize_clahe(unit(levels).to(device), clip, grid, opencv=True).cpu())
        assert np.array_equal(actual, expected)
        of_bytes = E.equalize_clahe(torch.from_numpy(levels).to(device), clip, grid, opencv=True)
        assert np.array_equal(of_bytes.cpu().numpy(), expected)


@pytest.mark.parametrize("clip, grid", [(40.0, (8, 8)), (2.0, (8, 8)), (3.0, (5, 7)), (0.0, (6, 10))])
def test_clahe_equals_opencvs_on_photographs(clip, grid, device):
    for picture in (skimage.data.camera(), skimage.data.moon()[:301, :403], skimage.data.coffee()[..., 1]):
        expected = cv2.createCLAHE(clip, grid[::-1]).apply(picture)
        actual = to_levels(E.equalize_clahe(unit(picture).to(device), clip, grid, opencv=True).cpu())
        assert np.array_equal(actual, expected)


def clahe_by_hand(levels: np.ndarray, clip: float, grid: tuple[int, int]) -> np.ndarray:
    """The definition, pixel by pixel."""
    (h, w), (rows, columns) = levels.shape, grid
    th, tw = -(-h // rows), -(-w // columns)
    padded = np.pad(levels, ((0, th * rows - h), (0, tw * columns - w)), "reflect" if min(h, w) > 1 else "edge")
    tables = np.empty((rows, columns, 256))
    for r in range(rows):
        for c in range(columns):
            counts = np.bincount(padded[r * th : (r + 1) * th, c * tw : (c + 1) * tw].ravel(), minlength=256)
            limit = max(int(clip * th * tw // 256), 1)
            excess = int(np.maximum(counts - limit, 0).sum())
            counts = np.minimum(counts, limit) + excess // 256
            rest = excess % 256
            if rest:
                counts[:: max(256 // rest, 1)][:rest] += 1
            tables[r, c] = np.round(np.cumsum(counts).astype(np.float32) * np.float32(255 / (th * tw))).clip(0, 255)
    result = np.empty((h, w))
    for y in range(h):
        for x in range(w):
            fy, fx = (y + 0.5) / th - 0.5, (x + 0.5) / tw - 0.5
            y0, x0 = int(np.floor(fy)), int(np.floor(fx))
            wy, wx = fy - y0, fx - x0
            result[y, x] = sum(
                weight * tables[min(max(r, 0), rows - 1), min(max(c, 0), columns - 1), levels[y, x]]
                for r, c, weight in (
                    (y0, x0, (1 - wy) * (1 - wx)),
                    (y0, x0 + 1, (1 - wy) * wx),
                    (y0 + 1, x0, wy * (1 - wx)),
                    (y0 + 1, x0 + 1, wy * wx),
                )
            )
    return result


@pytest.mark.parametrize(
    "size, grid", [((17, 23), (3, 4)), ((9, 30), (1, 5)), ((5, 4), (8, 8)), ((1, 1), (2, 3)), ((3, 20), (4, 1))]
)
def test_clahe_by_hand(size, grid):
    levels = photo(*size)
    for clip in (1.0, 7.5):
        expected = clahe_by_hand(levels, clip, grid)
        assert_close(
            255 * E.equalize_clahe(unit(levels), clip, grid)[0, 0].double(), torch.from_numpy(expected), 0, 1e-3
        )


def test_clahe_of_the_transposed_image(device):
    x = torch.rand(2, 3, 40, 60, device=device)
    assert_close(E.equalize_clahe(x.mT, 3.0, (5, 3)).mT, E.equalize_clahe(x, 3.0, (3, 5)))


def test_clahe_limits_of_samples_and_channels(device, backend):
    x = torch.rand(3, 2, 40, 50, device=device) ** 3
    limits = torch.tensor([[1.3, 0.0], [2.75, 400.0], [torch.inf, 0.2]])
    for options in ({"grid_size": (3, 4)}, {"grid_size": (1, 2), "opencv": True}):
        y = E.equalize_clahe(x, limits, **options)
        for i, row in enumerate(limits.tolist()):
            for k, limit in enumerate(row):
                limit = 0.0 if limit == torch.inf else limit
                assert torch.equal(y[i, k], E.equalize_clahe(x[i, k], limit, **options))
        assert torch.equal(E.equalize_clahe(x, limits[:, 0], **options)[:, 0], y[:, 0])
    smooth = {"grid_size": (2, 1), "slow_and_differentiable": True}
    y = E.equalize_clahe(x, limits[:, :1], **smooth)
    assert_close(y[1], E.equalize_clahe(x[1], 2.75, **smooth))
    with pytest.raises(ValueError, match="one clip_limit for all pixels"):
        E.equalize_clahe(x, torch.ones_like(x))


def test_clahe_gradient(device):
    x = torch.rand(1, 1, 16, 16, device=device, requires_grad=True)
    (none,) = torch.autograd.grad(E.equalize_clahe(x, 2.0, (2, 2)).sum(), x)
    assert not none.any()
    E.equalize_clahe(x, 0.0, (2, 2), slow_and_differentiable=True).square().sum().backward()
    assert x.grad.isfinite().all() and x.grad.abs().sum() > 0


class TestEqualizeOperators(PointOpTests):
    calls = {
        "equalize_backward": [
            Call((vector(3, 4, 5), vector(3, 4, 5), changed), broadcasts=False, differentiable=False)
            for changed in (None, lambda: torch.tensor([0.0, 1, 2]))
        ],
    }
