"""The strongest peaks of scale spaces, refined and filtered."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from feature_images import photo
from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision.feature.scale_space.scale_space_peaks import scale_space_peaks
from op_tests import OpTests, assert_close

ANYWHERE = float("-inf")


def peaks(
    input: Tensor,
    weights: Tensor | None = None,
    differences: bool = False,
    minima: bool = False,
    count: int = 6,
    border: float = 0.2,
    edge_ratio: float = 0.0,
    threshold: float = ANYWHERE,
    radius: int = 1,
) -> tuple[Tensor, Tensor]:
    """The operator on levels (B, L, H, W), with a scale of half a pixel and weights that are eighths."""
    _check.images("peaks", "input", input)
    levels = floats(input)
    wide = compute_dtype(levels)
    scales = torch.full(levels.shape[:1], 0.5, dtype=wide, device=levels.device)
    weights = None if weights is None else weights.to(wide).clamp(max=8) / 8
    filters = (3.0, border, edge_ratio, threshold)
    result, voxels = scale_space_peaks(
        levels, weights, scales, differences, minima, count, *filters, 5, 0.6, radius, True
    )
    return result, voxels.to(wide)  # the suite weighs results by random numbers, which integers have none of


def blobs(shape: tuple[int, ...]) -> Tensor:
    """Levels (B, L, H, W) of bright and dark blobs, of clearly different heights, near the middle of voxels."""
    if len(shape) == 5:
        return torch.stack([blobs(shape[1:])] * shape[0])
    z, y, x = torch.meshgrid(*[torch.arange(n, dtype=torch.float64) for n in shape[1:]], indexing="ij")
    total = torch.zeros(shape[1:], dtype=torch.float64)
    middles = [(2.2, 2.3, 3.1), (2.3, 6.8, 4.3), (1.7, 2.8, 9.1), (2.8, 7.1, 10.2)]
    for height, (i, j, k) in zip((1.3, -1.0, 0.7, -0.5), middles):
        total += height * torch.exp(-((z - i) ** 2 + (y - j) ** 2 + (x - k) ** 2) / 2)
    return (1 + 0.1 * torch.arange(shape[0], dtype=torch.float64)).view(-1, 1, 1, 1) * total


class TestScaleSpacePeaks(OpTests):
    function = staticmethod(peaks)
    operators = ("scale_space_peaks", "scale_space_peaks_backward")
    channels = 6
    accepted = ("count 0", "count 32768", "voxels of torch.int64")
    shape = (2, 6, 10, 14)
    small = (1, 6, 5, 6)
    max_size = 11
    variants = [
        {},
        {"minima": True, "weights": lambda x: torch.arange(-9, x[:, 0].numel() - 9).view(x[:, 0].shape)},
        {"minima": True, "differences": True, "edge_ratio": 10.0, "threshold": 0.1, "radius": 3, "count": 3},
    ]
    # Coordinates divide differences that float32 rounds.
    tolerances = {torch.float32: (2e-4, 2e-4), torch.float16: (1e-2, 3e-2), torch.bfloat16: (5e-2, 1e-1)}

    def input(self, shape, dtype, device):
        if dtype in (torch.uint8, torch.float16, torch.bfloat16):
            return (blobs(shape) * 16).round().clamp(0 if dtype == torch.uint8 else -100).to(dtype).to(device)
        return blobs(shape).to(dtype).to(device)

    def expected(self, x, kwargs):
        wide = {k: v.double() if isinstance(v, Tensor) else v for k, v in kwargs.items()}
        with K.backend("reference"):
            result, voxels = self.call(x.double(), wide)
        return tuple(y.to(compute_dtype(floats(x))) for y in (result, voxels))

    @pytest.fixture(autouse=True)
    def on_the_cpu(self, device):
        if device.type == "cuda":
            pytest.skip("on CUDA other operators find peaks step by step")

    def test_fuzz(self, device):
        pytest.skip("in float32 another voxel may be the largest")


@pytest.mark.native
@pytest.mark.parametrize("masked", [False, True])
def test_peaks_of_photographs_are_those_of_the_reference(masked, device):
    """In float64 no decision depends on rounding: the same voxels in the same order."""
    levels = K.ScalePyramid(3, 1.6, 16)(photo(150, 170).to(device))[0][0][:, 0]
    levels = torch.cat([levels, levels.flip(-1)])
    weights = None
    if masked:
        weights = torch.randint(1, 9, (2, *levels.shape[2:]), device=device)
        weights[:, 40:60] = 0
    options = {"weights": weights, "minima": True, "differences": True, "border": 5.0, "edge_ratio": 10.0}
    for count in (20, 400):
        actual = peaks(levels, count=count, **options)
        with K.backend("reference"):
            expected = peaks(levels, count=count, **options)
        assert_close(actual, expected, 1e-9, 1e-9)
        assert (actual[1] >= 0).sum() > 30


def test_a_blob_is_found_between_voxels(device):
    z, y, x = torch.meshgrid(*[torch.arange(n, dtype=torch.float64, device=device) for n in (5, 20, 24)], indexing="ij")
    volume = -((x - 11.3) ** 2 + 2 * (y - 8.8) ** 2 + (z - 2.1) ** 2)[None]
    for sign, minima in ((1, False), (-1, True)):
        result, voxels = peaks(sign * (volume + 1), minima=minima, count=2)
        # A minimum has its negative value.
        expected = torch.tensor([2.1, 11.3, 8.8, 1.0], dtype=torch.float64, device=device)
        assert_close(result[0, 0], expected, 1e-9, 1e-9)
        assert voxels.long().tolist() == [[(2 * 20 + 9) * 24 + 11, -1]]
        assert (result[0, 1] == 0).all()


@pytest.mark.native  # torch.topk, by which the reference chooses, gives equal ones in any order
def test_equal_peaks_are_in_the_order_of_their_voxels(device):
    height, width = 40, 8192  # the CPU searches bands of 8 rows
    levels = torch.zeros(1, 3, height, width, device=device)
    rows = torch.tensor([3, 8, 23, 36], device=device)
    levels[0, 1, rows, 7] = 1
    for count in (2, 4):
        voxels = peaks(levels, count=count)[1].long()
        if levels.is_cpu:
            assert voxels.tolist() == [((height + rows) * width + 7).tolist()[:count]]
        assert voxels.shape == (1, count) and (voxels >= 0).all()


def test_voxel_adjacent_to_nan_is_no_peak(device):
    near = [(z, y, x) for z in (0, 1, 2) for y in (3, 4, 5) for x in (16, 17, 18) if (z, y, x) != (1, 4, 17)]
    levels = torch.zeros(len(near) + 1, 3, 8, 40, device=device)
    levels[:, 1, 4, 17] = 1
    for sample, (z, y, x) in enumerate(near):
        levels[sample, z, y, x] = torch.nan
    for sign in (1, -1):
        voxels = peaks(sign * levels, minima=True)[1]
        assert (voxels[:-1] < 0).all() and (voxels[-1] >= 0).sum() == 1


def test_infinity_and_nan_are_no_peaks(device):
    levels = blobs((2, 6, 10, 14)).to(device)
    levels[0, :, :, 5:] = torch.nan
    levels.requires_grad_()
    result, voxels = peaks(levels)
    assert result.isfinite().all() and (voxels[0] >= 0).sum() == 1 and (voxels[1] >= 0).sum() == 2
    (grad,) = torch.autograd.grad(result.sum(), levels)
    assert grad.isfinite().all() and (grad != 0).any()
