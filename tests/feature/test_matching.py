"""Matches of descriptors, compared with Kornia's and OpenCV's; their operators."""

from __future__ import annotations

import cv2
import kornia.feature as KF
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.feature.matching import _two_nearest
from op_tests import instruction_set
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector


def descriptors(*sizes: int, seed: int = 0) -> Tensor:
    x = torch.randn(*sizes, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.nn.functional.normalize(x, dim=-1)


def pair(n: int, m: int, width: int = 16, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Two sets of which most descriptors of the smaller one have a counterpart."""
    x, y, noise = descriptors(n, width, seed=seed), descriptors(m, width, seed=seed + 1), descriptors(n, width, seed=9)
    common = min(n, m) * 3 // 4
    y[:common] = x[:common] + 0.25 * noise[:common]
    return x, y[torch.randperm(m, generator=torch.Generator().manual_seed(seed))]


def frames(n: int, seed: int = 0) -> Tensor:
    lafs = torch.zeros(1, n, 2, 3, dtype=torch.float64)
    lafs[..., :2] = 8 * torch.eye(2)
    lafs[..., 2] = 90 * torch.rand(1, n, 2, generator=torch.Generator().manual_seed(seed))
    return lafs


MODES = {
    "nn": lambda k, x, y, dm=None: k.match_nn(x, y, dm),
    "mnn": lambda k, x, y, dm=None: k.match_mnn(x, y, dm),
    "snn": lambda k, x, y, dm=None: k.match_snn(x, y, 0.9, dm),
    "smnn": lambda k, x, y, dm=None: k.match_smnn(x, y, 0.97, dm),
    "fginn": lambda k, x, y, dm=None: k.match_fginn(
        x, y, frames(len(x)).to(x), frames(len(y), 1).to(y), 0.95, 12.0, False, dm
    ),
    "mutual fginn": lambda k, x, y, dm=None: k.match_fginn(
        x, y, frames(len(x)).to(x), frames(len(y), 1).to(y), 0.95, 12.0, True, dm
    ),
}


@pytest.mark.parametrize("uses_dm", [False, True], ids=["", "dm"])
@pytest.mark.parametrize("sizes", [(60, 60), (40, 90), (90, 40), (2, 2)], ids=str)
@pytest.mark.parametrize("mode", MODES)
def test_equals_kornia(mode, sizes, uses_dm, device):
    x, y = (t.to(device, torch.float32).requires_grad_() for t in pair(*sizes))
    dm = torch.cdist(x, y).detach() if uses_dm else None
    scores, indices = MODES[mode](K.feature, x, y, dm)
    expected_scores, expected_indices = MODES[mode](KF, x, y, dm)
    assert torch.equal(indices, expected_indices)
    torch.testing.assert_close(scores, expected_scores, atol=2e-5, rtol=2e-5)
    if sizes != (2, 2):
        assert len(indices) > 0
    if len(indices) and not uses_dm:
        grads, expected = (torch.autograd.grad(s.square().sum(), (x, y)) for s in (scores, expected_scores))
        torch.testing.assert_close(grads, expected, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("uses_dm", [False, True], ids=["", "dm"])
def test_batches_equal_kornia(masked, uses_dm, device):
    x, y = (torch.stack(t).to(device) for t in zip(*(pair(50, 45, seed=s) for s in range(3))))
    masks = {"mask1": torch.rand(3, 50) < 0.8, "mask2": torch.rand(3, 45) < 0.8} if masked else {}
    masks = {name: mask.to(device) for name, mask in masks.items()}
    dm = torch.cdist(x, y) if uses_dm else None
    ours = K.feature.match_smnn_batched(x, y, 0.97, dm, **masks)
    theirs = KF.match_smnn_batched(x, y, 0.97, dm, **masks)
    assert len(ours[1]) > 20 and torch.equal(ours[1], theirs[1])
    torch.testing.assert_close(ours[0], theirs[0])
    if not masked:
        for b in range(3):
            ratios, indices = K.feature.match_smnn(x[b], y[b], 0.97)
            of_sample = ours[1][:, 0] == b
            assert torch.equal(ours[1][of_sample, 1:], indices)
            torch.testing.assert_close(ours[0][of_sample], ratios)


def test_masked_descriptors_do_not_matter(device):
    """Nor do their values, NaN included."""
    x, y = (torch.stack(t).to(device) for t in zip(*(pair(50, 45, seed=s) for s in range(2))))
    mask1, mask2 = torch.rand(2, 50, device=device) < 0.7, torch.rand(2, 45, device=device) < 0.7
    ratios, indices = K.feature.match_smnn_batched(x, y, 0.97, None, mask1, mask2)
    x[~mask1], y[~mask2] = torch.nan, 7.0
    others = K.feature.match_smnn_batched(x, y, 0.97, None, mask1, mask2)
    assert len(indices) and torch.equal(others[0], ratios) and torch.equal(others[1], indices)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sizes", [(0, 0), (0, 5), (5, 0), (1, 1), (1, 5), (5, 1)], ids=str)
def test_few_descriptors(mode, sizes, device):
    x, y = (descriptors(n, 8, seed=n).to(device).requires_grad_() for n in sizes)
    for dm in (None, torch.cdist(x, y)):
        scores, indices = MODES[mode](K.feature, x, y, dm)
        count = len(indices)
        assert scores.shape == (count, 1) and indices.shape == (count, 2) and indices.dtype == torch.int64
        if 0 in sizes or (mode not in ("nn", "mnn") and sizes[1] < 2) or (mode == "smnn" and 1 in sizes):
            assert count == 0
        if dm is None:
            grads = torch.autograd.grad(scores.sum(), (x, y), retain_graph=True)
            assert all(g.isfinite().all() and (count > 0 or (g == 0).all()) for g in grads)
        if count > 0 and dm is None:
            expected_scores, expected_indices = MODES[mode](KF, x, y)
            assert torch.equal(indices, expected_indices)
            torch.testing.assert_close(scores, expected_scores)
    batched = K.feature.match_smnn_batched(x[None], y[None])
    assert batched[0].shape == (len(batched[1]), 1) and batched[1].shape[1] == 3
    assert K.feature.match_smnn_batched(x[None][:0], y[None][:0])[1].shape == (0, 3)


@pytest.mark.parametrize("mode", MODES)
def test_nan_has_no_match(mode, device):
    x, y = (t.to(device) for t in pair(40, 30))
    wrong_x, wrong_y = x.clone(), y.clone()
    wrong_x[3, 2], wrong_y[4, 1] = torch.nan, torch.nan
    leaves = wrong_x.requires_grad_(), wrong_y.requires_grad_()
    scores, indices = MODES[mode](K.feature, *leaves)
    right = torch.ones(len(indices), dtype=torch.bool)
    if mode == "nn":
        assert scores[3].isinf() and indices[3].tolist() == [3, 0]
        right[3] = False
    assert not (indices[right] == torch.tensor([3, 4], device=device)).any() and scores[right].isfinite().all()
    for of in (scores, scores[right]):  # the distance inf has no gradient
        of_x, of_y = torch.autograd.grad(of.sum(), leaves, retain_graph=True)
        assert of_x.isfinite().all() and of_x.count_nonzero() > 0 and torch.equal(of_x[3], torch.zeros_like(of_x[3]))
        assert of_y.isfinite().all() and of_y.count_nonzero() > 0 and torch.equal(of_y[4], torch.zeros_like(of_y[4]))
    x[3], y[4] = 100.0, -100.0  # far from all others
    assert torch.equal(MODES[mode](K.feature, x, y)[1][right], indices[right])


def test_equal_descriptors(device):
    """Distances of 0 are exact, with gradients of 0; two equal candidates have no ratio."""
    x = descriptors(30, 128).to(device, torch.float32).requires_grad_()
    distances, indices = K.feature.match_mnn(x, x)
    assert distances.count_nonzero() == 0 and torch.equal(
        indices, torch.arange(30, device=device)[:, None].expand(30, 2)
    )
    distances.sum().backward()
    assert x.grad.count_nonzero() == 0
    ratios, indices = K.feature.match_smnn(x, x)
    assert len(indices) == 30 and ratios.count_nonzero() == 0
    twice = torch.cat([x, x])
    assert len(K.feature.match_smnn(x, twice)[1]) == 0
    assert K.feature.match_nn(x, twice)[1][:, 1].tolist() == list(range(30))  # the first one


def test_fginn_compares_all_candidates():
    """Kornia looks at the ten nearest only: 10 equal neighbors at one position have ratio 0 there."""
    x = torch.zeros(1, 2)
    y = torch.tensor([[1.0, 0]] * 12 + [[0, 2.0]])
    lafs = torch.zeros(1, 13, 2, 3)
    lafs[0, -1, 0, 2] = 50.0
    ratios, indices = K.feature.match_fginn(x, y, lafs[:, :1], lafs)
    assert ratios.tolist() == [[0.5]] and indices.tolist() == [[0, 0]]
    assert K.feature.match_fginn(x, y, lafs[:, :1], lafs, 0.4)[1].shape == (0, 2)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
def test_half_types_are_those_of_float32(dtype, device):
    x, y = (t.to(device, dtype) for t in pair(300, 300, 128))
    for mode in ("nn", "mnn", "snn", "smnn", "fginn"):
        scores, indices = MODES[mode](K.feature, x, y)
        expected, expected_indices = MODES[mode](K.feature, x.float(), y.float())
        assert scores.dtype == dtype and torch.equal(indices, expected_indices)
        torch.testing.assert_close(scores, expected.to(dtype), atol=0, rtol=0)


def test_bytes_equal_opencv(device):
    x, y = (torch.randint(0, 256, (n, 32), dtype=torch.uint8) for n in (80, 70))
    expected = cv2.BFMatcher(cv2.NORM_L2).knnMatch(x.numpy(), y.numpy(), k=2)
    distances, indices = K.feature.match_nn(x.to(device), y.to(device))
    assert indices[:, 1].tolist() == [m[0].trainIdx for m in expected]
    torch.testing.assert_close(distances[:, 0].cpu(), torch.tensor([m[0].distance for m in expected]))


def test_memory_is_not_that_of_a_matrix(device):
    """100,000 x 100 descriptors; and float32 does not lose distances next to large values."""
    x = torch.rand(20_000, 8, device=device) + 1000
    distances, indices = K.feature.match_nn(x[:200], x)
    assert torch.equal(indices[:, 1], torch.arange(200, device=device)) and distances.count_nonzero() == 0


@pytest.mark.parametrize("kind", ["unit", "far from 0", "clusters", "different lengths", "duplicates"])
def test_neighbors_in_float32_are_the_nearest(kind, device):
    """Kernels may estimate candidates first; no descriptor is nearer than the chosen neighbors, up to rounding of float32."""
    x, y = descriptors(300, 40).to(device), descriptors(400, 40, seed=1).to(device)
    if kind == "far from 0":
        x, y = x / 8 + 100, y / 8 + 100
    elif kind == "clusters":
        x, y = x[:3].repeat(100, 1) + 1e-3 * x, x[:4].repeat(100, 1) + 1e-3 * y
    elif kind == "different lengths":
        x, y = (
            x * torch.logspace(-3, 3, 300, device=device)[:, None],
            y * torch.logspace(-3, 3, 400, device=device)[:, None],
        )
    elif kind == "duplicates":
        y = y[:40].repeat(10, 1)
    x, y = x.float(), y.float()
    distances1, indices1, distances2, indices2 = _two_nearest(x[None], y[None], None, None, None, None, 0.0, True)
    exact = torch.cdist(x.double(), y.double(), compute_mode="donot_use_mm_for_euclid_dist")
    for d, distances, indices in ((exact, distances1[0], indices1[0]), (exact.mT, distances2[0], indices2[0])):
        nearest = d.topk(2, 1, largest=False)[0]
        torch.testing.assert_close(distances.double(), nearest, atol=1e-6, rtol=1e-5)
        torch.testing.assert_close(d.gather(1, indices), nearest, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("both", [False, True])
def test_few_and_many_descriptors_give_the_same_bits(both, device):
    """CUDA compares few descriptors in one kernel, and of more it searches candidates."""
    x, y = descriptors(300, 128).float(), descriptors(280, 128, seed=1).float()
    x[7, 3], y[9, 2], y[40:80] = torch.nan, torch.inf, y[:40]
    mask = torch.arange(280)[None] % 11 != 5
    x, y, mask = x[None].to(device), y[None].to(device), mask.to(device)
    few = _two_nearest(x, y, None, mask, None, None, 0.0, both)
    many = _two_nearest(*(t.repeat(6, *[1] * (t.dim() - 1)) for t in (x, y)), None, mask, None, None, 0.0, both)
    for a, b in zip(few, many):
        assert torch.equal(a.expand_as(b), b)
    distances, pairs = K.feature.match_nn(x[0], y[0])
    of_two = _two_nearest(x, y, None, None, None, None, 0.0, False)
    assert torch.equal(distances, of_two[0][0, :, :1]) and torch.equal(pairs[:, 1], of_two[1][0, :, 0].clamp(min=0))


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_all_sizes_and_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the kernels of the CPU")
    with instruction_set(isa):
        for n, m, width in [(1, 1, 1), (3, 65, 5), (257, 2, 7), (4, 64, 8), (300, 130, 33), (5, 63, 128)]:
            for dtype in SINGLE_AND_DOUBLE:
                x, y = descriptors(2, n, width).to(dtype), descriptors(2, m, width, seed=1).to(dtype)
                args = (x, y, None, None, None, None, 0.0, True)
                result = _two_nearest(*args)
                with K.backend("reference"):
                    expected = _two_nearest(*args)
                for a, b in zip(result, expected):
                    torch.testing.assert_close(a, b, atol=2e-6, rtol=1e-5)


@pytest.mark.parametrize("mode", KF.GeometryAwareDescriptorMatcher.known_modes[:1])
def test_modules_equal_kornias(mode, device):
    x, y = (t.to(device) for t in pair(50, 60))
    lafs = frames(50).to(x), frames(60, 1).to(x)
    for params in ({}, {"th": 0.97, "spatial_th": 30.0, "mutual": True}):
        ours, theirs = (k.GeometryAwareDescriptorMatcher(mode.upper(), params)(x, y, *lafs) for k in (K.feature, KF))
        assert torch.equal(ours[1], theirs[1])
        torch.testing.assert_close(ours[0], theirs[0])
    for name in K.feature.DescriptorMatcher.known_modes:
        ours, theirs = (k.DescriptorMatcher(name, 0.9)(x, y) for k in (K.feature, KF))
        assert torch.equal(ours[1], theirs[1])
        torch.testing.assert_close(ours[0], theirs[0])


@pytest.mark.tracing
@pytest.mark.parametrize("mode", K.feature.DescriptorMatcher.known_modes)
def test_export(mode, device):
    """Calls of the exported program have another number of matches than the example."""
    matcher = K.feature.DescriptorMatcher(mode, 0.97)
    x, y = (t.to(device) for t in pair(30, 40))
    exported = torch.export.export(matcher, (torch.rand_like(x), torch.rand_like(y))).module()
    for actual, expected in zip(exported(x, y), matcher(x, y)):
        assert torch.equal(actual, expected)


def test_errors():
    x, lafs = torch.rand(5, 8), torch.rand(1, 5, 2, 3)
    with pytest.raises(TypeError, match="match_nn: expected desc1 to be a Tensor, got list"):
        K.feature.match_nn([1.0], x)
    with pytest.raises(ValueError, match=r"match_snn: expected desc2 of shape \(M, D\), got \(1, 5, 8\)"):
        K.feature.match_snn(x, x[None])
    with pytest.raises(ValueError, match=r"match_smnn: expected descriptors of one width, got \(5, 8\) and \(5, 7\)"):
        K.feature.match_smnn(x, x[:, :7])
    with pytest.raises(
        TypeError, match="match_mnn: expected descriptors of one type, got torch.float32 and torch.float64"
    ):
        K.feature.match_mnn(x, x.double())
    with pytest.raises(ValueError, match=r"match_nn: expected dm of shape \(5, 5\), got \(5, 4\)"):
        K.feature.match_nn(x, x, torch.rand(5, 4))
    with pytest.raises(ValueError, match="match_smnn_batched: expected descriptors of one batch and width"):
        K.feature.match_smnn_batched(x[None], x[None].expand(2, 5, 8))
    with pytest.raises(TypeError, match="match_smnn_batched: expected mask1 to be bool"):
        K.feature.match_smnn_batched(x[None], x[None], mask1=torch.ones(1, 5))
    with pytest.raises(ValueError, match=r"match_fginn: expected lafs2 of shape \(1, 5, 2, 3\)"):
        K.feature.match_fginn(x, x, lafs, lafs[:, :4])
    with pytest.raises(TypeError, match="match_snn: expected th to be a number"):
        K.feature.match_snn(x, x, "high")
    with pytest.raises(NotImplementedError, match="DescriptorMatcher: match_mode must be one of nn, mnn, snn, smnn"):
        K.feature.DescriptorMatcher("best")
    with pytest.raises(NotImplementedError, match="match_mode must be one of fginn, adalam"):
        K.feature.GeometryAwareDescriptorMatcher("nn")


def positions_of(n: int):
    return vector(n, 2, scale=100.0)


def finite(*results: Tensor) -> tuple[Tensor, Tensor]:
    """The distances, of which those to no neighbor are inf."""
    return tuple(torch.where(x.isinf(), 0, x) for x in results[::2])


def neighbors(n: int, m: int):
    """Indices of two neighbors among m, of which the second is missing for a tenth of the descriptors."""

    def draw() -> Tensor:
        first = torch.randint(0, m, (n, 1))
        return torch.cat([first, (first + torch.randint(1, m, (n, 1))) % m], 1).where(torch.rand(n, 1) > 0.1, -1)

    return draw


def mutual() -> Tensor:
    """Indices of six descriptors whose neighbors are among 40."""
    return torch.stack([torch.randperm(40)[:6], torch.randint(0, 40, (6,))], 1)


SETS, MASKS = (vector(7, 5), vector(6, 5)), (torch.arange(7)[None] != 3, torch.arange(6)[None] > 1)


class TestMatchingOperators(PointOpTests):
    calls = {
        "two_nearest": [
            Call(
                (*SETS, *optional),
                options,
                dtypes=SINGLE_AND_DOUBLE,
                accepted=(
                    " cut along axis -2",
                    "1 of torch.bool",
                    "2 of torch.bool",
                    "1 of torch.int64",
                    "2 of torch.int64",
                ),
                compared=finite,
                broadcasts=optional[2] is None,
                differentiable=optional[2] is None,
            )
            for optional, options in [
                ((None, None, None, None), (0.0, True)),
                ((None, None, None, None), (0.0, False)),
                ((*MASKS, None, None), (0.0, True)),
                ((*MASKS, positions_of(7), positions_of(6)), (30.0, True)),
            ]
        ],
        "nearest_pairs": [Call(SETS, dtypes=SINGLE_AND_DOUBLE, accepted=(" cut along axis -2", "of torch.int64"))],
        "select_matches": [
            Call(
                (vector(40, 2), neighbors(40, 6), *back),
                (6, ratios, 0.9),
                dtypes=SINGLE_AND_DOUBLE,
                broadcasts=False,
                differentiable=ratios or back[0] is None,  # without ratios in the distances of one set only
                accepted=("count2", "of torch.int64", "distances1 of another dtype"),
            )
            for back in ((None, None), (vector(6, 2), mutual))
            for ratios in (False, True)
        ],
    }
