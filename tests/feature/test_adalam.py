"""AdaLAM on matches of which many are wrong, compared with Kornia's."""

from __future__ import annotations

import kornia.feature as KF
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close


def scene(n: int = 800, right: float = 0.5, seed: int = 0, noise: float = 0.5) -> tuple[Tensor, ...]:
    """Descriptors and frames of two images 600 x 400 that a homography relates, and which descriptors have a counterpart."""
    generator = torch.Generator().manual_seed(seed)

    def rand(*sizes: int) -> Tensor:
        return torch.rand(*sizes, generator=generator, dtype=torch.float64)

    def unit(x: Tensor) -> Tensor:
        return torch.nn.functional.normalize(x, dim=-1)

    xy1 = rand(1, n, 2) * torch.tensor([600.0, 400.0])
    scale, angle = 5 + 10 * rand(1, n, 1, 1), 360 * rand(1, n, 1)
    lafs1 = K.feature.laf_from_center_scale_ori(xy1, scale, angle)
    homography = torch.tensor([[[0.9, 0.25, 20], [-0.2, 1.1, 60], [2e-4, -1e-4, 1.0]]], dtype=torch.float64)
    lafs2 = K.feature.perspective_transform_lafs(homography, lafs1)
    lafs2[..., 2] += noise * (2 * rand(1, n, 2) - 1)
    desc1 = unit(rand(n, 64) - 0.5)
    desc2 = unit(desc1 + 0.4 * unit(rand(n, 64) - 0.5))
    is_right = rand(n) < right
    wrong = (~is_right).nonzero()[:, 0]
    lafs2[:, wrong] = K.feature.laf_from_center_scale_ori(
        rand(1, len(wrong), 2) * torch.tensor([600.0, 400.0]),
        5 + 10 * rand(1, len(wrong), 1, 1),
        360 * rand(1, len(wrong), 1),
    )
    return desc1, desc2, lafs1, lafs2, is_right


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_correct_matches_are_kept(dtype, device):
    *inputs, is_right = (x.to(device, dtype if x.is_floating_point() else None) for x in scene())
    scores, indices = K.feature.match_adalam(*inputs, hw1=(400, 600), hw2=(400, 600))
    assert scores.dtype == torch.float32 and scores.shape == (len(indices), 1) and scores.max() <= 1 / 200
    assert (indices[:, 0].diff() > 0).all()
    kept = is_right[indices[:, 0]]
    assert torch.equal(indices[:, 0], indices[:, 1]) and kept.float().mean() > 0.97
    assert kept.sum() > 0.9 * is_right.sum()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("config", [None, {"area_ratio": 30, "refit": False}, {"force_seed_mnn": False}], ids=str)
def test_matches_are_those_of_kornia(config, seed, device):
    *inputs, is_right = (x.to(device) for x in scene(seed=seed))
    sizes = {"hw1": (400, 600), "hw2": (400, 600)}
    ours, theirs = (k.match_adalam(*inputs, config=config, **sizes)[1] for k in (K.feature, KF))
    in_both = len(set(map(tuple, ours.tolist())) & set(map(tuple, theirs.tolist())))
    assert in_both > 0.9 * len(theirs)
    assert is_right[ours[:, 0]].sum() >= 0.97 * is_right[theirs[:, 0]].sum()
    assert is_right[ours[:, 0]].float().mean() >= is_right[theirs[:, 0]].float().mean() - 0.02


@pytest.mark.parametrize("sizes", [{}, {"hw1": (400, 600), "hw2": (400, 600)}])
def test_identical_images(sizes, device):
    """All residuals are 0."""
    desc, _, lafs, _, _ = (x.to(device) for x in scene())
    scores, indices = K.feature.match_adalam(desc, desc, lafs, lafs, **sizes)
    assert len(indices) > 0.98 * len(desc) and torch.equal(indices[:, 0], indices[:, 1])
    assert scores.isfinite().all() and scores.max() <= 1 / 200


def test_is_invariant_to_a_common_rotation_and_scale(device):
    *inputs, _ = (x.to(device) for x in scene())
    expected = K.feature.match_adalam(*inputs)
    desc1, desc2, lafs1, lafs2 = inputs
    lafs1 = K.feature.rotate_laf(K.feature.scale_laf(lafs1, 1.5), torch.full((1, len(desc1), 1), 130.0).to(lafs1))
    result = K.feature.match_adalam(desc1, desc2, lafs1, lafs2)
    assert torch.equal(result[1], expected[1])
    assert_close(result[0], expected[0])


def test_same_every_call_and_from_distances(device):
    *inputs, _ = (x.to(device) for x in scene())
    state = torch.random.get_rng_state()
    results = [K.feature.match_adalam(*inputs, dm=dm) for dm in (None, None, torch.cdist(*inputs[:2]))]
    assert torch.equal(torch.random.get_rng_state(), state)
    assert torch.equal(results[0][0], results[1][0])
    assert all(torch.equal(indices, results[0][1]) for _, indices in results)


@pytest.mark.parametrize("sizes", [(0, 0), (0, 9), (9, 0), (1, 1), (1, 9), (9, 1), (2, 2), (4, 4)], ids=str)
def test_few_descriptors(sizes, device):
    lafs = [torch.eye(2, 3, device=device).repeat(1, n, 1, 1) for n in sizes]
    desc = [torch.eye(9, device=device)[:n] for n in sizes]
    scores, indices = K.feature.match_adalam(*desc, *lafs)
    assert scores.shape == (len(indices), 1) and indices.shape == (len(indices), 2) and scores.dtype == torch.float32
    assert len(indices) == (sizes[0] if min(sizes) >= 2 else 0)  # the fallback


def test_nan_and_coinciding_points(device):
    desc1, desc2, lafs1, lafs2, _ = (x.to(device) for x in scene(300))
    desc1[5], desc2[7], lafs2[0, 9] = torch.nan, torch.nan, torch.nan
    scores, indices = K.feature.match_adalam(desc1, desc2, lafs1, lafs2)
    assert scores.isfinite().all() and not (indices == torch.tensor([5, 7], device=device)).any()
    lafs1[...], lafs2[...] = torch.eye(2, 3, device=device), torch.eye(2, 3, device=device)
    scores, _ = K.feature.match_adalam(desc1, desc2, lafs1, lafs2)
    assert scores.isfinite().all()


def test_module_equals_the_function(device):
    *inputs, _ = (x.to(device) for x in scene())
    matcher = K.feature.GeometryAwareDescriptorMatcher("adalam", {"area_ratio": 50})
    expected = K.feature.match_adalam(*inputs, config={"area_ratio": 50})
    assert all(torch.equal(a, b) for a, b in zip(matcher(*inputs), expected))


def test_errors():
    desc1, desc2, lafs1, lafs2, _ = scene(20)
    with pytest.raises(TypeError, match="match_adalam: expected config to be a dict, got int"):
        K.feature.match_adalam(desc1, desc2, lafs1, lafs2, 3)
    with pytest.raises(ValueError, match="match_adalam: expected min_confidence to be positive, got 0"):
        K.feature.match_adalam(desc1, desc2, lafs1, lafs2, {"min_confidence": 0})
    with pytest.raises(TypeError, match="match_adalam: expected refit to be a bool"):
        K.feature.match_adalam(desc1, desc2, lafs1, lafs2, {"refit": 1})
    with pytest.raises(ValueError, match=r"match_adalam: expected lafs1 of shape \(1, 20, 2, 3\), got \(1, 19, 2, 3\)"):
        K.feature.match_adalam(desc1, desc2, lafs1[:, :19], lafs2)
    with pytest.warns(UserWarning) as warned:
        K.feature.match_adalam(desc1, desc2, lafs1, lafs2, {"area_Ration": 3, "verbose": True})
    said = [str(warning.message) for warning in warned]
    assert said[0] == "match_adalam: config has no 'area_Ration'; did you mean 'area_ratio'?"
    assert said[1:] == ["match_adalam: config has no 'verbose'"]
