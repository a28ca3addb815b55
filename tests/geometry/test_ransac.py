"""RANSAC: models of correspondences with many outliers, compared with OpenCV and Kornia; its two operators."""

import cv2
import kornia
import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K
from kvision._modes import MODEL
from kvision.geometry.homography.dlt import homography_of
from kvision.geometry.ransac import _keep_best_models, _select_inliers
from kvision.geometry.solvers._minimal import SIZES, eight_points, minimal_solver
from kvision.geometry.solvers._two_view_fits import two_view_fits
from kvision.geometry.solvers.affine import affine_of
from op_tests import assert_close, instruction_set
from point_op_tests import EYE, SINGLE_AND_DOUBLE, SQUARE, Call, PointOpTests, near, vector
from view_tests import Scene, homographies, moved, moved_by, on_planes, rand

N = 400


def correspondences(model: str, seed: int = 0) -> tuple[Tensor, Tensor, Tensor, float]:
    """Points of both images, who is right, and a threshold."""
    wrong = rand(N, seed=seed + 5) < 0.4
    if model in ("homography", "affine", "homography_from_linesegments"):
        x, H = rand(1, N, 2, high=500, seed=seed), homographies(1)
        if model == "affine":
            H[:, 2] = torch.tensor([0.0, 0, 1])
        H[:, 2, :2] /= 5
        y = (moved(x, H) + 0.3 * rand(1, N, 2, low=-1, seed=seed + 1))[0]
        x = x[0]
        if model == "homography_from_linesegments":
            x, y, wrong = x.view(-1, 2, 2), y.view(-1, 2, 2), wrong[: N // 2]
        y[wrong] = rand(*y[wrong].shape, high=500, seed=seed + 2)
        return x, y, ~wrong, 2.0
    scene = Scene(1, N, noise=0.1, seed=seed)
    x, y = scene.normalized() if model == "essential" else (scene.x1, scene.x2)
    y = y[0].clone()
    y[wrong] = y[wrong].flip(0)
    return x[0], y, ~wrong, 0.5 / 80 if model == "essential" else 0.5


MODELS = [
    "homography",
    "affine",
    "homography_from_linesegments",
    "fundamental",
    "fundamental_7pt",
    "fundamental_8pt",
    "essential",
]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_inliers_are_correct(model, dtype, device):
    x, y, right, threshold = correspondences(model)
    x, y = x.to(device, dtype), y.to(device, dtype)
    result, inliers = K.geometry.RANSAC(model, threshold, seed=0)(x, y)
    inliers = inliers.cpu()
    assert (inliers & right).sum() >= 0.97 * right.sum()
    assert (inliers & ~right).sum() <= 0.2 * (~right).sum()  # some are right by chance
    assert result.shape == (3, 3) and result.dtype == dtype and result.isfinite().all()
    theirs = kornia.geometry.RANSAC(model, threshold, seed=0)(x.cpu(), y.cpu())[1]
    assert inliers.sum() >= 0.98 * theirs.sum()


@pytest.mark.parametrize("model", MODELS)
def test_a_sample_alone_has_its_model(model, device):
    """As many points as a sample give their model with its inliers, as in OpenCV; points without a model give none."""
    ransac = K.geometry.RANSAC(model, 1e-2, seed=0)
    n = ransac.minimal_sample_size
    if model in ("homography", "affine", "homography_from_linesegments"):
        H = homographies(1)
        H[:, 2, :2] /= 5
        if model == "affine":
            H[:, 2] = torch.tensor([0.0, 0, 1])
        corners = torch.tensor([[0.0, 0], [90, 5], [100, 80], [10, 110], [40, 30], [7, 60], [70, 20], [20, 5]]).double()
        x = corners[: 2 * n if model.endswith("segments") else n]
        y = moved(x[None], H)[0]
        if model.endswith("segments"):
            x, y = x.view(-1, 2, 2), y.view(-1, 2, 2)
        result, inliers = ransac(x.to(device), y.to(device))
        assert_close(result.cpu(), H[0] / H[0, 2, 2], 1e-6, 1e-6)
    else:
        scene = Scene(1, n, noise=0.0, seed=3)
        x, y = (p[0] for p in (scene.normalized() if model == "essential" else (scene.x1, scene.x2)))
        result, inliers = ransac(x.to(device), y.to(device))
        error = K.geometry.sampson_epipolar_distance(x[None], y[None], result.cpu()[None])
        assert result.any() and error.abs().max() < 1e-4
    assert inliers.all()
    if model in ("homography", "affine"):
        same = torch.ones_like(x).to(device)
        assert not any(part.any() for part in ransac(same, same))


@pytest.mark.parametrize("model", ["homography", "affine", "homography_from_linesegments", "fundamental", "essential"])
def test_batches_have_pairs_of_different_sizes_and_none(model, device):
    """Weights of 0 leave correspondences out, be they wrong or not even finite."""
    x, y, right, threshold = correspondences(model)
    count = len(x) // 2
    x, y, right = (torch.stack([v[:count], v[count : 2 * count], v[:count]]) for v in (x, y, right))
    weights = right.double()
    weights[0], weights[2, 3:] = 1, 0  # the third pair has too few
    x[1] = torch.where(right[1].view(-1, *(1,) * (x.dim() - 2)), x[1], torch.nan)
    ransac = K.geometry.RANSAC(model, threshold, seed=0)
    models, inliers = ransac(x.to(device), y.to(device), weights.to(device))
    found = inliers.cpu()
    assert models.shape == (3, 3, 3) and models[:2].flatten(1).any(1).all() and not models[2].any()
    assert (found & right)[:2].sum() >= 0.95 * right[:2].sum() and not found[1][~right[1]].any() and not found[2].any()
    empty = ransac(x[:0].to(device), y[:0].to(device))
    assert empty[0].shape == (0, 3, 3) and empty[1].shape == (0, count)


@pytest.mark.parametrize("model", ["homography", "affine", "fundamental", "essential"])
def test_gradients_are_those_of_the_fit(model, device):
    """A shift of the second image shifts maps to it by as much, and leaves epipolar lines through the shifted points."""
    x, y, _, threshold = (v.to(device) if isinstance(v, Tensor) else v for v in correspondences(model))
    y, weights = y.requires_grad_(), torch.ones_like(y[:, 0], requires_grad=True)
    M, inliers = K.geometry.RANSAC(model, threshold, seed=0)(x, y, weights)
    probe = (M[0, 2] if model in ("homography", "affine") else M[0, 0]) / (1 if model[0] in "ha" else M.norm())
    grad, of_weights = torch.autograd.grad(probe, (y, weights))
    assert grad.isfinite().all() and of_weights.isfinite().all() and grad[inliers].any() and of_weights[inliers].any()
    far = K.geometry.RANSAC(model, 6 * threshold, seed=0)(x, y.detach())[1]
    assert not grad[~far].any() and not of_weights[~far].any()
    assert of_weights.sum().abs() <= 1e-5 * of_weights.abs().sum()  # only their ratios matter
    if model in ("homography", "affine"):
        assert_close(grad.sum(0).cpu(), torch.tensor([1.0, 0.0]).double(), 0, 1e-6)


def test_essential_matrices_of_pixels(device):
    """With camera matrices points and threshold are in pixels; the model is that of normalized points, on the device of all."""
    x, y, _, threshold = correspondences("essential")
    cameras = torch.tensor(
        [[[80.0, 0.5, 40], [0, 84, 30], [0, 0, 1]], [[160.0, 0, 60], [0, 160, 50], [0, 0, 1]]]
    ).double()
    pixels = [torch.nn.functional.pad(p, (0, 1), value=1.0) @ K.mT for p, K in zip((x, y), cameras)]
    first, second = (p[:, :2].to(device) for p in pixels)
    cameras = cameras.to(device)
    ransac = K.geometry.RANSAC("essential", threshold * 121, seed=0)
    E, inliers = ransac(first, second, None, *cameras)
    normalized = K.geometry.RANSAC("essential", threshold, seed=0)(x.to(device), y.to(device))
    assert_close(E, normalized[0], 1e-6, 1e-9)
    assert torch.equal(inliers, normalized[1])
    twice = ransac(torch.stack([first, first]), torch.stack([second, second]), None, cameras[0], cameras[1:])[0]
    assert_close(twice[0].abs(), E.abs(), 0, 0.05)
    with pytest.raises(ValueError, match="RANSAC: expected no K1 and K2 for 'homography'"):
        K.geometry.RANSAC()(first, second, K1=cameras[0])
    with pytest.raises(ValueError, match=r"RANSAC: expected K2 of shape \(3, 3\) or \(1, 3, 3\)"):
        ransac(first, second, K1=cameras[0], K2=cameras)


def test_dominant_planes(device):
    """Nine of ten right points are in a plane, which any epipole explains: with its homography the others find the true one."""
    errors = {False: [], True: []}
    for seed in range(6):
        scene = Scene(1, 300, noise=0.0, seed=seed)
        normal = torch.tensor([0.1, -0.2, 1.0]).double()
        space = scene.points.clone()
        depth = 4.0 / (space[0] / space[0, :, 2:] @ normal)
        space[0, :180] = (space[0] / space[0, :, 2:] * depth[:, None])[:180]
        x, y = (moved_by(P, space) for P in (scene.P1, scene.P2))
        truth = x[0, 180:200], y[0, 180:200]
        generator = torch.Generator().manual_seed(seed)
        x, y = (p + 0.1 * torch.randn(p.shape, dtype=p.dtype, generator=generator) for p in (x, y))
        y[0, 200:] = y[0, 200:].flip(0) + 9
        for degensac in (False, True):
            ransac = K.geometry.RANSAC("fundamental", 0.4, seed=seed, degensac=degensac, max_samples=300)
            F = ransac(x[0].to(device), y[0].to(device))[0].cpu()
            errors[degensac].append(
                K.geometry.sampson_epipolar_distance(*(p[None] for p in truth), F[None], False).mean()
            )
    plain, planes = (torch.stack(errors[k]) for k in (False, True))
    assert planes.median() < 0.1 and planes.mean() < 0.5 * plain.mean(), (plain, planes)


def test_seeds(device):
    x, y, _, threshold = (v.to(device) if isinstance(v, Tensor) else v for v in correspondences("homography"))
    state = torch.get_rng_state()
    ransac = K.geometry.RANSAC("homography", threshold, seed=3, max_samples=64)
    assert_close(ransac(x, y), ransac(x, y), 0, 0)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    "options", [{"prosac_sampling": True}, {"score_type": "ransac"}, {"batch_size": 100, "max_iter": 3}]
)
def test_options(options, device):
    x, y, right, threshold = correspondences("homography")
    order = right.to(torch.int8).argsort(descending=True)  # the right ones first, as PROSAC wants them
    ransac = K.geometry.RANSAC("homography", threshold, seed=0, **options)
    inliers = ransac(x[order].to(device), y[order].to(device))[1]
    assert (inliers.cpu() & right[order]).sum() >= 0.97 * right.sum()
    assert "homography" in repr(ransac)


def test_no_model_to_find(device):
    x, y = rand(30, 2, high=1000, seed=1).to(device), rand(30, 2, high=1000, seed=2).to(device)
    H, inliers = K.geometry.RANSAC("homography", 0.01, seed=0, max_samples=300)(x, y)
    assert not H.any() and not inliers.any()
    x[3] = float("nan")
    right = K.geometry.RANSAC("affine", 1.0, seed=0)(x, 2 * x)[1]
    assert right.sum() == 29 and not right[3]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("weight", [0.0, -1.0, float("nan")])
def test_no_correspondence_exists(model, weight, device):
    """Zeros and no inliers, as where no model is found, also beside a pair that has its model."""
    x, y, _, threshold = correspondences(model)
    weights = torch.full((2, len(x)), weight, dtype=torch.float64, device=device)
    weights[1] = 1
    M, inliers = K.geometry.RANSAC(model, threshold, seed=0)(*(torch.stack([p, p]).to(device) for p in (x, y)), weights)
    assert not M[0].any() and not inliers[0].any() and M[1].isfinite().all() and inliers[1].any()


@pytest.mark.parametrize("model", ["affine", "homography"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_points_on_one_line_have_no_map(model, dtype, device):
    """A map may do anything beside the line. In float32 rounding moves points off it; a narrow strip has its map."""
    t = torch.linspace(0, 100, 60, dtype=torch.float64)
    line = torch.stack([t, 0.3 * t + 7], 1)
    strip = line + 0.02 * torch.tensor([-0.3, 1.0]) * (torch.arange(60) % 3)[:, None]
    for points, exists in ((line, False), (line + 1000, False), (strip, True)):
        points = points.to(device, dtype)
        M, inliers = K.geometry.RANSAC(model, 1.0, seed=0)(points, 1.25 * points - 3)
        assert (bool(M.any()), int(inliers.sum())) == ((True, 60) if exists else (False, 0))


def test_steps(device):
    x, y, _, threshold = correspondences("fundamental")
    x, y = x.to(device), y.to(device)
    ransac = K.geometry.RANSAC("fundamental", threshold, seed=0, max_samples=500)
    assert ransac.sample_budget == 500
    chosen = ransac.sample(7, N, 50, 0, device)
    assert chosen.shape == (50, 7) and all(len(set(row)) == 7 for row in chosen.tolist())
    first, second = ransac.remove_bad_samples(x[chosen], y[chosen])
    models = ransac.remove_bad_models(ransac.estimate_model_from_minsample(first, second).flatten(0, 1))
    _, inliers, score, count = ransac.verify(x, y, models, threshold**2)
    assert inliers.sum() == count >= score
    assert ransac.polish_model(x, y, inliers).shape == (1, 3, 3)
    assert ransac.max_samples_by_conf(50, 100, 4, 0.99) == kornia.geometry.RANSAC.max_samples_by_conf(50, 100, 4, 0.99)


@pytest.mark.parametrize(
    "options, error, message",
    [
        ({"model_type": "sphere"}, NotImplementedError, "model_type must be one of"),
        ({"inl_th": 0.0}, ValueError, "expected inl_th above 0"),
        ({"confidence": 1.5}, ValueError, "expected confidence"),
        ({"score_type": "count"}, ValueError, "score_type must be one of"),
        ({"degensac": True}, ValueError, "expected degensac False or None for 'homography'"),
        ({"max_iter": 0}, ValueError, "expected max_iter"),
    ],
)
def test_errors(options, error, message):
    with pytest.raises(error, match=f"RANSAC: {message}"):
        K.geometry.RANSAC(**options)
    with pytest.raises(ValueError, match="RANSAC: expected kp1 of at least 4"):
        K.geometry.RANSAC()(torch.rand(3, 2), torch.rand(3, 2))


# --- operators --------------------------------------------------------------------------------------------------------


def invariant(models: Tensor) -> Tensor:
    """Of candidates in any order and of any sign: sums of products of their entries, (S, 9, 9)."""
    flat = models.flatten(2).nan_to_num(0.0)
    return flat.mT @ flat


@pytest.mark.parametrize("model", SIZES)
def test_minimal_models_are_the_references(model, device):
    scene, planes = Scene(1, 30, noise=0.3), on_planes(1, 30, noise=0.3)
    x, y = scene.normalized() if model == "essential" else (scene.x1, scene.x2) if model[0] == "f" else planes[:2]
    if model == "lines":
        x, y = x.reshape(1, 15, 4), y.reshape(1, 15, 4)
    size, count = SIZES[model]
    draws = torch.cat([rand(64, size), torch.full((64, 1), float(x.shape[1])).double()], 1)
    x, y, draws = (v.to(device) for v in (x, y, draws))
    result = minimal_solver(x, y, draws, model)
    with K.backend("reference"):
        expected = minimal_solver(x, y, draws, model)
    assert result.shape == expected.shape == (64, count, 3, 3)
    assert torch.equal(result.isnan().flatten(2).any(-1).sum(1), expected.isnan().flatten(2).any(-1).sum(1))
    if model == "affine":
        result, expected = result.clamp(-1e3, 1e3), expected.clamp(-1e3, 1e3)
    assert_close(invariant(result), invariant(expected), 1e-4, 1e-4)


@pytest.mark.parametrize("model", ["affine", "homography", "lines", "fundamental", "essential"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_best_models_are_the_references(model, dtype, device):
    """Of new models and of three kept so far; where three are kept, few models are as good as these and most are given up."""
    numbers = 4 if model == "lines" else 2
    x, y = (rand(2, numbers, 333, high=9, seed=s).to(device, dtype) for s in (1, 2))
    models, kept = (rand(2, n, 3, 3, low=-1, seed=n).to(device, dtype) for n in (40, 3))
    models[0, 7, 1, 1] = float("nan")
    scores = torch.tensor([[[300.0, 310], [250, 333], [200, 201]], [[9, 8], [7, 9], [0, 0]]]).to(device, dtype)
    thresholds = torch.tensor([3.0, 2.5]).to(device, dtype)
    existing = torch.tensor([333.0, 3]).to(device, dtype)
    whole = _keep_best_models(models, x, y, kept, scores, thresholds, existing, 43, False, MODEL[model], 0.99, 99)[0]
    for count, by_count in ((1, False), (3, False), (3, True), (43, False)):
        args = models, x, y, kept, scores, thresholds, existing, count, by_count, MODEL[model], 0.99, 99
        result = _keep_best_models(*args)
        with K.backend("reference"):
            expected = _keep_best_models(*args)
        assert_close(result[1][..., 1], expected[1][..., 1])
        assert_close(result[1], expected[1], 1e-4, 1e-3)
        assert torch.equal(result[0].nan_to_num(), expected[0].nan_to_num()) and torch.equal(result[2], expected[2])
        if not by_count:
            assert torch.equal(result[0].nan_to_num(), whole[:, :count].nan_to_num())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_required_samples(dtype, device):
    """Of kept models with known inliers: without any, with too few points, some, and all."""
    scores = torch.tensor([0.0, 4, 30, 57, 99, 100]).to(device, dtype)[:, None, None].expand(-1, 1, 2)
    existing = torch.tensor([100.0, 3, 100, 100, 100, 100]).to(device, dtype)
    models, x = torch.full((6, 1, 3, 3), torch.nan).to(scores), torch.zeros(6, 2, 9).to(scores)
    for confidence, budget in ((0.99, 5000), (0.99, 100), (1.0, 50)):
        args = models, x, x, models, scores, torch.ones_like(existing), existing, 1, False, MODEL["homography"]
        required = _keep_best_models(*args, confidence, budget)[2].tolist()
        expected = [
            min(K.geometry.RANSAC.max_samples_by_conf(int(n), 100, 4, confidence), budget)
            for n in scores[:, 0, 0].tolist()
        ]
        assert required == [expected[0], 0, *expected[2:]] and required[0] == budget


@pytest.mark.parametrize("count", [1, 8, 3000])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_the_first_of_equal_models_wins(count, dtype, device):
    kept, scores = rand(2, 2500, 3, 3, low=-1), (9 * rand(2, 2500, 2)).round()  # many are as good
    models, x = torch.full((2, 70, 3, 3), torch.nan).double(), rand(2, 2, 90)  # of score 0
    models, x, kept, scores, thresholds = (v.to(device, dtype) for v in (models, x, kept, scores, torch.ones(2)))
    for by_count in (False, True):
        args = models, x, x, kept, scores, thresholds, 90 * thresholds, count, by_count, MODEL["affine"], 0.9, 99
        result = _keep_best_models(*args)
        with K.backend("reference"):
            assert_close([r.nan_to_num() for r in result], [r.nan_to_num() for r in _keep_best_models(*args)], 0, 0)


@pytest.mark.parametrize("model", ["affine", "homography", "lines", "fundamental", "essential"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_inliers_are_the_references(model, dtype, device):
    """Of three pairs, the second of few correspondences and the third without a consensus."""
    numbers = 4 if model == "lines" else 2
    x, y = (rand(3, 70, numbers, high=9, seed=s).to(device, dtype) for s in (1, 2))
    x[0, 5] = float("nan")
    models, weights = rand(3, 3, 3, low=-1, seed=3).to(device), rand(3, 70, seed=4).to(device, dtype)
    weights[1, 2:] = 0
    thresholds = torch.tensor([4.0, 90, 1e-6]).to(device, dtype)
    for w in (None, weights):
        args = x, y, w, thresholds, models, MODEL[model]
        result = _select_inliers(*args)
        with K.backend("reference"):
            expected = _select_inliers(*args)
        assert_close(result[0], expected[0], 1e-5, 1e-6)
        assert torch.equal(result[1], expected[1]) and result[0].dtype == dtype
    assert not result[0][2].any() and not result[1][2].any()
    assert result[1][1].sum() == (0 if model in ("affine", "homography") else 2)  # two points are on one line


def up_to_scale(models: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """Products of the entries of models, which have no sign, in units of the largest."""
    flat = models.flatten(2)[..., None]
    products = flat @ flat.mT
    return products / products.abs().amax((-2, -1), keepdim=True), scores


@pytest.mark.parametrize("model", ["affine", "homography", "lines", "fundamental", "essential"])
def test_two_view_fits_are_the_references(model, device):
    """Of two pairs of different sizes, from good models and bad ones."""
    scene, planes = Scene(2, 90, noise=0.3), on_planes(2, 90, noise=0.3)
    x, y = scene.normalized() if model == "essential" else (scene.x1, scene.x2) if model[0] == "f" else planes[:2]
    if model == "lines":
        x, y = x.reshape(2, 45, 4), y.reshape(2, 45, 4)
    size = SIZES[model][0]
    draws = torch.cat([rand(6, size), torch.full((6, 1), float(x.shape[1])).double()], 1)
    models = minimal_solver(x, y, draws, model).view(2, -1, 3, 3)
    x, y, weights = x.mT.clone(), y.mT.clone(), rand(2, x.shape[1])
    y[:, 1, :20], weights[1, -9:] = rand(2, 20, high=90), 0
    x[0, 0, 11] = float("nan")
    reach = 3.0 if model != "essential" else 3 / 80
    x, y, weights, models = (v.to(device) for v in (x, y, weights, models))
    reach = torch.tensor([reach, 0.8 * reach], dtype=torch.float64, device=device)
    for options in ((None, reach, 0), (weights, reach, 1), (weights, reach, 6)):
        result = two_view_fits(models, x, y, *options, model)
        with K.backend("reference"):
            expected = two_view_fits(models, x, y, *options, model)
        assert_close(result[1], expected[1], 1e-5, 1e-9)
        has_model = expected[1] > 0
        assert torch.equal(result[0].isnan().flatten(2).any(-1), expected[0].isnan().flatten(2).any(-1))
        a, b = (up_to_scale(*r)[0][has_model] for r in (result, expected))
        assert_close(a, b, 0, 1e-5)
    assert (result[1] >= two_view_fits(models, x, y, weights, reach, 0, model)[1] * (1 - 1e-9)).all()


def test_fits_that_adapt_are_the_references(device):
    scene = Scene(2, 90, noise=0.3)
    models = scene.F * (1 + 1e-2 * rand(2, 3, 3, 3, low=-1))
    models[0, 1, 2, 2] = torch.nan
    x, y, weights = scene.x1.mT.clone(), scene.x2.mT.clone(), 3 * rand(2, 90)
    y[:, 1, :20], weights[1, -9:], x[0, 0, 11] = rand(2, 20, high=90), 0, torch.nan
    reach = torch.tensor([3.0, 2.4]).double()
    x, y, weights, models, reach = (v.to(device) for v in (x, y, weights, models, reach))
    for w, rounds in ((None, 0), (weights, 3), (weights, 8)):
        result = two_view_fits(models, x, y, w, reach, rounds, "fundamental", True)
        with K.backend("reference"):
            expected = two_view_fits(models, x, y, w, reach, rounds, "fundamental", True)
        assert_close(result[1], expected[1], 1e-5, 1e-9)
        assert torch.equal(result[0].isnan(), expected[0].isnan()) and result[0].isnan().sum() == 9
        known = ~expected[0].isnan().flatten(2).any(-1)
        assert_close(*(up_to_scale(*r)[0][known] for r in (result, expected)), 0, 1e-5)
    assert_close(two_view_fits(models, x, y, 5 * weights, reach, 8, "fundamental", True)[1], result[1], 1e-9, 1e-9)


def test_fits_that_adapt_find_noise_and_right_correspondences(device):
    """Of half the correspondences, with noise far below the reach: as near the truth as least squares of these alone."""
    errors = []
    for seed in range(12):
        scene = Scene(1, 400, noise=0.0, seed=seed)
        generator = torch.Generator().manual_seed(seed)
        x, y = (p + 0.1 * torch.randn(p.shape, dtype=p.dtype, generator=generator) for p in (scene.x1, scene.x2))
        y[:, 200:] = y[:, 200:].flip(1) + 5 * torch.randn(1, 200, 2, generator=generator).double()
        right = (torch.arange(400)[None] < 200).double()
        reach = torch.tensor([2.0], device=device, dtype=torch.float64)
        start = scene.F[None, None].to(device)
        a, b = x.mT.contiguous().to(device), y.mT.contiguous().to(device)
        adapted, count = two_view_fits(start, a, b, None, reach, 12, "fundamental", True)
        least = two_view_fits(start, a, b, right.to(device), 1e3 * reach, 12, "fundamental")[0]
        consensus = two_view_fits(start, a, b, None, reach, 12, "fundamental")[0]
        assert 190 < count.item() < 235  # wrong ones near their line look right
        errors.append(
            [
                K.geometry.sampson_epipolar_distance(scene.x1[:, :200], scene.x2[:, :200], F[0].cpu(), False).mean()
                for F in (adapted, least, consensus)
            ]
        )
    own, least, consensus = torch.tensor(errors).T
    assert own.mean() < 1.2 * least.mean() and own.mean() < 0.8 * consensus.mean(), (own, least, consensus)


def test_one_set_of_points_serves_all_weights(device):
    x, y, _ = on_planes(1, 300, noise=0.3)
    x, y, weights = x.to(device), y.to(device), rand(5, 300).to(device)
    for fit in (homography_of, eight_points, affine_of):
        expected = fit(x.expand(5, -1, -1), y.expand(5, -1, -1), weights)
        assert_close(fit(x, y, weights), expected, 1e-9, 1e-12)


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the CPU's kernels")
    with instruction_set(isa):
        for model in ("lines", "fundamental", "essential"):
            test_minimal_models_are_the_references(model, device)
            test_best_models_are_the_references(model, torch.float32, device)
            test_inliers_are_the_references(model, torch.float32, device)
            test_two_view_fits_are_the_references(model, device)
        scene = Scene(1, 9)
        assert_close(K.geometry.triangulate_points(scene.P1, scene.P2, scene.x1, scene.x2), scene.points, 1e-7, 1e-7)


def test_operators_refuse_bad_arguments(backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x, ops = torch.rand(1, 9, 2), torch.ops.kvision
    eye, scores, models, rows, one = (
        torch.eye(3)[None],
        torch.zeros(1, 4, 2),
        torch.rand(1, 4, 3, 3),
        x.mT,
        torch.ones(1),
    )
    for call in (
        lambda: ops.minimal_solver(x, x, None, MODEL["homography"]),
        lambda: ops.minimal_solver(x, x[:, :3], None, MODEL["affine"]),
        lambda: ops.minimal_solver(x, x, torch.rand(5, 4), MODEL["homography"]),
        lambda: ops.minimal_solver(x.half(), x.half(), torch.rand(5, 5), MODEL["homography"]),
        lambda: ops.minimal_solver(x, x, torch.rand(5, 5), 6),
        *(
            lambda args=args: ops.keep_best_models(*args, 2, False, MODEL["homography"], 0.9, 99)
            for args in (
                (models, x, x, models, scores, one, one),
                (models, rows, rows, models, scores, one[:0], one),
                (models, rows, rows, models, scores, one, one[:0]),
                (models[0], rows, rows, models, scores, one, one),
                (models, rows, rows, models, scores[..., :1], one, one),
                (models, rows, rows, models[:0], scores[:0], one, one),
                (models[:, :0], rows, rows, models, scores, one, one),
                (models, rows, rows.double(), models, scores, one, one),
            )
        ),
        lambda: ops.select_inliers(x, x[:, :3], None, one, eye, MODEL["homography"]),
        lambda: ops.select_inliers(rows, rows, None, one, eye, MODEL["homography"]),
        lambda: ops.select_inliers(x, x, torch.rand(1, 8), one, eye, MODEL["homography"]),
        lambda: ops.select_inliers(x, x, None, one[:0], eye, MODEL["homography"]),
        lambda: ops.select_inliers(x, x, None, one, eye[0], MODEL["homography"]),
        lambda: ops.two_view_fits(models, rows, rows, None, one.double(), 2, MODEL["homography"], False),
        *(
            lambda args=args: ops.two_view_fits(models.double(), rows.double(), rows.double(), *args)
            for args in (
                (None, one.double(), 2, MODEL["lines"], False),
                (one.double(), one.double(), 2, MODEL["affine"], False),
                (None, one.double(), 2, MODEL["essential"], True),
            )
        ),
        lambda: ops.null_vector(torch.rand(2, 5, 7), None),
        lambda: ops.null_vector(torch.rand(2, 5, 9), torch.rand(2, 4)),
        lambda: ops.null_vector_backward(torch.rand(2, 9), torch.rand(2, 4), torch.rand(2, 5, 9), None),
        lambda: ops.triangulate(x, x[:, :3], torch.rand(1, 3, 4), torch.rand(1, 3, 4)),
        lambda: ops.triangulate(x, x, torch.rand(2, 3, 4), torch.rand(2, 3, 4)),
        lambda: ops.triangulate_backward(x, x, x, torch.rand(1, 3, 4), torch.rand(1, 3, 4)),
        lambda: ops.triangulate_backward(torch.rand(1, 9, 3), x, x, torch.rand(1, 3, 4), torch.rand(1, 3, 3)),
        lambda: ops.real_roots(torch.rand(2, 12)),
        lambda: ops.undistort_points(x, torch.rand(1, 3, 2), eye, torch.rand(1, 4), None, 5),
        lambda: ops.undistort_points(x, eye, eye, torch.rand(1, 15), None, 5),
        lambda: ops.undistort_points(x, eye, eye, torch.rand(1, 4), eye.double(), 5),
        lambda: ops.undistort_points(x, eye, eye, torch.rand(1, 4), None, -1),
        lambda: ops.undistort_points(x.half(), eye.half(), eye.half(), torch.rand(1, 4).half(), None, 5),
        lambda: ops.distort_points(x, eye, eye, torch.rand(1, 15), None),
        lambda: ops.distort_points(x, eye, torch.rand(1, 3, 2), torch.rand(1, 4), None),
        lambda: ops.eigenvectors(torch.rand(2, 5, 5)),
        lambda: ops.eigenvectors(torch.rand(2, 5, 9)),
        lambda: ops.homography_dlt(x, x[:, :3], None),
        lambda: ops.homography_dlt(x, x, torch.rand(1, 8)),
        lambda: ops.homography_lines_dlt(x, x, None),
        lambda: ops.homography_lines_dlt(x[..., None].expand(1, 9, 2, 3), x[..., None].expand(1, 9, 2, 2), None),
        lambda: ops.normalize_points(x, torch.rand(1, 8), 0.0),
        lambda: ops.normalize_points_backward(x[:, :3], eye, x, None, 0.0),
        lambda: ops.homography_dlt_backward(torch.rand(1, 9), x, x, None),
        lambda: ops.fundamental_dlt(x, x, torch.rand(2, 8)),
        lambda: ops.fundamental_dlt_backward(torch.rand(2, 3, 3), x, x, torch.rand(2, 9)),
        lambda: ops.affine_fit(x, x, torch.rand(1, 8)),
        lambda: ops.affine_fit_backward(torch.rand(1, 9), x, x, None),
        lambda: ops.pose_dlt(x, x, eye, None, 0.0),
        lambda: ops.pose_dlt(torch.rand(1, 9, 3), x, eye[:, :2], None, 0.0),
        lambda: ops.correspondence_errors(x, x[:, :4], eye, "sampson", True),
        lambda: ops.correspondence_errors(x, x, eye, "segments", True),
        lambda: ops.correspondence_errors(x, x, eye, "sphere", True),
        lambda: ops.correspondence_errors(x.expand(2, 9, 2), x, eye.expand(3, 3, 3), "transfer", True),
        lambda: ops.correspondence_errors_backward(torch.rand(1, 8), x, x, eye, "transfer", True),
        lambda: ops.nearest_essential(eye[:, :2]),
        lambda: ops.nearest_essential_backward(eye[0], eye),
        lambda: ops.essential_motions(eye.half()),
        lambda: ops.essential_motions_backward(torch.rand(1, 4, 3, 3), torch.rand(1, 3, 3, 1), eye),
        lambda: ops.motion_choice(eye, eye, eye, x, x[:, :4], None),
        lambda: ops.motion_choice(eye, eye, eye, x, x, torch.ones(1, 9)),
        lambda: ops.pose_dlt_backward(eye, torch.rand(1, 9, 3), x, eye, None, 0.0),
    ):
        with pytest.raises(RuntimeError):
            call()


# --- photographs ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", ["graf/1/3", "wall/1/3", "boat/1/3", "leuven/1/4", "bikes/1/3", "ubc/1/4"])
def test_photographs_against_opencv(pair, data, device):
    """Key points of both images, by the ratio test: as many agree as with OpenCV's, and the homography is the true one."""
    name, i, k = pair.split("/")
    folder = data / "homography" / name
    images = [cv2.imread(str(folder / f"img{n}.png"), cv2.IMREAD_GRAYSCALE) for n in (i, k)]
    (key1, d1), (key2, d2) = (cv2.SIFT_create(2000).detectAndCompute(image, None) for image in images)
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(d1, d2, k=2) if m.distance < 0.85 * n.distance]
    x = np.float32([key1[m.queryIdx].pt for m in pairs])
    y = np.float32([key2[m.trainIdx].pt for m in pairs])
    H, inliers = K.geometry.RANSAC("homography", 3.0, seed=0, confidence=0.999)(
        *(torch.from_numpy(p).to(device) for p in (x, y))
    )
    theirs = cv2.findHomography(x, y, cv2.RANSAC, 3.0, maxIters=10000, confidence=0.999)[1].ravel() > 0
    inliers = inliers.cpu()
    assert inliers.sum() >= 0.97 * theirs.sum()
    assert (inliers & torch.from_numpy(theirs)).sum() >= 0.95 * theirs.sum()
    truth = torch.from_numpy(np.loadtxt(folder / f"H_{i}_{k}.txt"))
    h, w = images[0].shape
    corners = torch.tensor([[[0.0, 0], [w, 0], [w, h], [0, h]]]).double()
    assert (moved(corners, H.double().cpu()) - moved(corners, truth)).norm(dim=-1).mean() < 6  # pixels, of some 800


def test_errors_are_as_small_as_opencvs(device):
    """Of USAC_MAGSAC at equal threshold, half of the correspondences being wrong; `python -m benchmarks.robust_fits` has more."""
    ours, theirs = [], []
    for seed in range(12):
        H, x = homographies(1, seed=seed + 50), rand(1, 300, 2, high=500, seed=seed)
        H[:, 2, :2] /= 5
        y = moved(x, H)
        probes = x, y
        generator = torch.Generator().manual_seed(seed)
        x, y = (p + torch.randn(p.shape, dtype=p.dtype, generator=generator) for p in (x, y))
        y[:, :150] = rand(1, 150, 2, high=500, seed=seed + 99)
        peer, _ = cv2.findHomography(x[0].numpy(), y[0].numpy(), cv2.USAC_MAGSAC, 4.0, maxIters=5000, confidence=0.999)
        own, _ = K.geometry.RANSAC("homography", 4.0, seed=seed, confidence=0.999)(x[0].to(device), y[0].to(device))
        for errors, M in ((ours, own.cpu()), (theirs, torch.from_numpy(peer))):
            errors.append((moved(probes[0], M[None].double()) - probes[1]).norm(dim=-1).mean())
    own, peer = torch.stack(ours), torch.stack(theirs)
    assert own.median() <= 1.02 * peer.median() and (own <= 1.1 * peer + 0.02).double().mean() > 0.9


def test_opencv_essential():
    x, y, _, threshold = correspondences("essential")
    inliers = K.geometry.RANSAC("essential", threshold, seed=0)(x, y)[1]
    theirs = cv2.findEssentialMat(x.numpy(), y.numpy(), np.eye(3), cv2.RANSAC, 0.999, threshold)[1].ravel() > 0
    assert inliers.sum() >= 0.97 * theirs.sum()


def test_opencv_affine():
    """Of all points, and of those that its RANSAC keeps: what OpenCV refines to is the least squares of its inliers."""
    x, y, right, threshold = correspondences("affine")
    result, mask = cv2.estimateAffine2D(x.numpy(), y.numpy(), method=cv2.RANSAC, ransacReprojThreshold=threshold)
    inliers = torch.from_numpy(mask[:, 0] > 0)
    least = K.geometry.find_affine(x[None, inliers], y[None, inliers])[0]
    assert_close(least[:2], torch.from_numpy(result), 1e-6, 1e-4)
    model, ours = K.geometry.RANSAC("affine", inl_th=threshold, seed=0)(x, y)
    assert (ours == inliers).double().mean() > 0.99 and (ours & right).sum() > 0.99 * right.sum()
    assert_close(moved(x[None, right], model[None]), moved(x[None, right], least[None]), 0, 0.1)


def random_models() -> Tensor:
    return rand(4, 3, 3, low=-1) + 0.3 * torch.rand(4, 3, 3)


SCENE, PLANES = Scene(1, 77, noise=0.1), on_planes(1, 77, noise=0.1)


# Any number of models may be kept, any number of samples required, and C++ asks for axes before it checks how many there are.
RANSAC_ACCEPTED = ("count ", "budget ", "rounds ", "another batch", "without axes", "one axis less")


class TestRansacOperators(PointOpTests):
    calls = {
        "keep_best_models": [
            Call(
                (
                    random_models,
                    vector(2, 77, scale=9.0),
                    vector(2, 77, scale=9.0),
                    random_models,
                    vector(4, 2, scale=9.0),
                    vector(scale=3.0),
                    vector(scale=77.0),
                ),
                (2, by_count, MODEL[model], 0.9, 500),
                broadcasts=False,
                differentiable=False,
                accepted=RANSAC_ACCEPTED,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            )
            for model, by_count in (("homography", False), ("fundamental", True), ("essential", False))
        ],
        "select_inliers": [
            Call(
                (vector(77, 2, scale=9.0), vector(77, 2, scale=9.0), None, vector(scale=3.0), vector(3, 3)),
                (MODEL[model],),
                broadcasts=False,
                differentiable=False,
                accepted=(*RANSAC_ACCEPTED, "another dtype"),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            )
            for model in ("homography", "essential")
        ],
        "two_view_fits": [
            Call(
                (
                    *(near(x, distance) for x, distance in zip(inputs, distances)),
                    vector(77),
                    near(torch.tensor(reach), 0.1),
                ),
                (1, MODEL[model], adapts),
                broadcasts=False,
                differentiable=False,
                accepted=(*RANSAC_ACCEPTED, "another dtype"),
                dtypes=(torch.float64,),
                tolerance=200,
                compared=up_to_scale,
            )
            for adapts, model, reach, inputs, distances in (
                (False, "affine", 4.0, (EYE.expand(3, 3, 3), PLANES[0][0].mT, PLANES[0][0].mT), (1e-3, 0.1, 0.1)),
                (
                    False,
                    "homography",
                    4.0,
                    (PLANES[2].expand(3, 3, 3), PLANES[0][0].mT, PLANES[1][0].mT),
                    (1e-4, 0.1, 0.1),
                ),
                *(
                    (
                        adapts,
                        "fundamental",
                        4.0,
                        (SCENE.F.expand(3, 3, 3), SCENE.x1[0].mT, SCENE.x2[0].mT),
                        (1e-6, 0.1, 0.1),
                    )
                    for adapts in (False, True)
                ),
                (
                    False,
                    "essential",
                    0.1,
                    (SCENE.E.expand(3, 3, 3), *(x[0].mT for x in SCENE.normalized())),
                    (1e-3, 1e-3, 1e-3),
                ),
            )
        ],
        "minimal_solver": [
            Call(
                (vector(3, 2), vector(3, 2), None),
                (MODEL["affine"],),
                broadcasts=False,
                differentiable=False,
                accepted=RANSAC_ACCEPTED,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            ),
            Call(
                (lambda: SQUARE + 0.5 * torch.rand(4, 2), lambda: SQUARE + 0.5 * torch.rand(4, 2), None),
                (MODEL["homography"],),
                broadcasts=False,
                differentiable=False,
                accepted=RANSAC_ACCEPTED,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=200,
            ),
        ],
    }
