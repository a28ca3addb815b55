"""Policies: each sample equals its operations applied one by one, chosen and drawn as in the papers."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import pytest
import torch
from scipy import stats
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.auto import AugMix, AutoAugment, PolicyAugmentBase, RandAugment, TrivialAugment
from kvision.augmentation.auto.operation_table import OPERATIONS
from op_tests import DispatchedOperators

POLICIES: dict[str, Callable[[], PolicyAugmentBase]] = {
    "imagenet": lambda: AutoAugment("imagenet"),
    "cifar10": lambda: AutoAugment("cifar10"),
    "svhn": lambda: AutoAugment("svhn"),
    "rand": lambda: RandAugment(3, 12),
    "trivial": TrivialAugment,
}
policies = pytest.mark.parametrize("make", POLICIES.values(), ids=list(POLICIES))
MIXTURES: dict[str, Callable[[], AugMix]] = {
    "default": AugMix,
    "deep": lambda: AugMix(10, 2, 4, 0.4),
    "plain": lambda: AugMix(5, 1, -1, 2.0, False),
}
mixtures = pytest.mark.parametrize("make", MIXTURES.values(), ids=list(MIXTURES))
POLICIES_AND_MIXTURES = {**POLICIES, **MIXTURES}
policies_and_mixtures = pytest.mark.parametrize("make", POLICIES_AND_MIXTURES.values(), ids=list(POLICIES_AND_MIXTURES))
NAMES = {operation.number: name for name, operation in OPERATIONS.items()}


def images(device: Any = "cpu", batch: int = 32, dtype: torch.dtype = torch.float32) -> Tensor:
    levels = torch.randint(0, 256, (batch, 3, 12, 15), generator=torch.Generator().manual_seed(batch))
    return (levels.to(dtype) if dtype == torch.uint8 else levels.to(dtype) / 255).to(device)


# --- one operation on one image (C, H, W), in plain torch, but for what has a test of its own -------------------------


def luma(x: Tensor) -> Tensor:
    return 0.299 * x[:1] + 0.587 * x[1:2] + 0.114 * x[2:]


def moved(x: Tensor, linear: tuple[float, float, float, float], shift: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    """Moved by a linear map about the center, then shifted."""
    a, b, c, d = linear
    cx, cy = (x.shape[-1] - 1) / 2, (x.shape[-2] - 1) / 2
    rows = [[a, b, cx + shift[0] - a * cx - b * cy], [c, d, cy + shift[1] - c * cx - d * cy]]
    matrix = torch.tensor([rows], device=x.device)
    return K.geometry.transform.warp_affine(x[None], matrix, (x.shape[-2], x.shape[-1]))[0]


def stretched(x: Tensor) -> Tensor:
    low, high = x.amin((1, 2), keepdim=True), x.amax((1, 2), keepdim=True)
    return torch.where(low == high, x, (x - low) / (high - low))


def turned(x: Tensor, degrees: float) -> Tensor:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return moved(x, (c, s, -s, c))


REFERENCES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "identity": lambda x, v: x,
    "auto_contrast": lambda x, v: stretched(x),
    "equalize": lambda x, v: K.enhance.equalize(x),
    "invert": lambda x, v: 1 - x,
    "rotate": turned,
    "posterize": lambda x, v: ((x * 255).round().int() & (256 - 2 ** (8 - round(v)))).float() / 255,
    "solarize": lambda x, v: torch.where(x < v, x, 1 - x),
    "solarize_add": lambda x, v: torch.where((x + v).clamp(0, 1) < 0.5, (x + v).clamp(0, 1), 1 - (x + v).clamp(0, 1)),
    "color": lambda x, v: (v * x + (1 - v) * luma(x)).clamp(0, 1),
    "contrast": lambda x, v: (v * x + (1 - v) * luma(x).mean()).clamp(0, 1),
    "brightness": lambda x, v: (v * x).clamp(0, 1),
    "sharpness": lambda x, v: K.enhance.sharpness(x, v),
    "shear_x": lambda x, v: moved(x, (1, -v, 0, 1)),
    "shear_y": lambda x, v: moved(x, (1, 0, -v, 1)),
    "translate_x": lambda x, v: moved(x, (1, 0, 0, 1), (v * x.shape[-1], 0)),
    "translate_y": lambda x, v: moved(x, (1, 0, 0, 1), (0, v * x.shape[-2])),
    "translate_x_pixels": lambda x, v: moved(x, (1, 0, 0, 1), (v, 0)),
    "translate_y_pixels": lambda x, v: moved(x, (1, 0, 0, 1), (0, v)),
}
RANGES = {
    "rotate": (0.0, 40.0),
    "posterize": (1.0, 8.0),
    "solarize": (0.0, 1.0),
    "solarize_add": (0.0, 0.4),
    "translate_x_pixels": (0.0, 4.0),
    "translate_y_pixels": (0.0, 4.0),
}


def expected(x: Tensor, params: list[Any]) -> Tensor:
    """The images one by one, from the parameters of a call."""
    rows = []
    for i, image in enumerate(x):
        for item in params:
            number = int(item.data["operation"][i])
            if number >= 0:
                image = REFERENCES[NAMES[number]](image, float(item.data["magnitude"][i]))
        rows.append(image)
    return torch.stack(rows)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_is_its_formula(name: str, dtype: torch.dtype, device: torch.device) -> None:
    augment = TrivialAugment([[(name, *RANGES.get(name, (0.1, 0.9)))]])
    x = images(device, dtype=dtype)
    y = augment(x)
    assert y.dtype == dtype and y.shape == x.shape
    if dtype == torch.uint8:
        reference = 255 * expected(x.float() / 255, augment._params)
        # A value on a threshold, or in the middle of two levels, may fall to either side.
        assert ((y.float() - reference).abs() <= 0.51).float().mean() > 0.995
    else:
        reference = expected(x.float(), augment._params)
        error = (y.float() - reference).abs()
        if dtype == torch.float16:
            assert (error <= 4e-3).float().mean() > 0.99
        else:
            assert (error <= 5e-5).float().mean() > 0.999


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.bfloat16, torch.uint8], ids=str)
def test_posterize_is_exact(dtype: torch.dtype, device: torch.device) -> None:
    levels = torch.arange(256, dtype=torch.uint8, device=device).expand(64, 3, 1, 256)
    x = levels if dtype == torch.uint8 else (levels / 255).to(dtype)
    augment = TrivialAugment([[("posterize", 0.0, 8.0)]])
    y = augment(x)
    bits = augment._params[0].data["magnitude"].round().int().to(device)
    if dtype == torch.uint8:
        assert torch.equal(y, x & (256 - 2 ** (8 - bits))[:, None, None, None].to(torch.uint8))
    else:
        assert torch.equal(y, K.enhance.posterize(x, bits))


@policies
def test_a_policy_is_its_operations_one_after_the_other(make: Any, device: torch.device) -> None:
    augment, x = make(), images(device, 64)
    y = augment(x, seed=3)
    error = (y - expected(x, augment._params)).abs()
    # Rounding may carry a value across a threshold of solarize, or a level of equalize and posterize.
    assert (error <= 1e-3).float().mean() > 0.985
    assert len({int(n) for item in augment._params for n in item.data["operation"]}) > 5


# --- what is drawn ----------------------------------------------------------------------------------------------------


def drawn(augment: PolicyAugmentBase, batch: int = 20_000) -> list[dict[str, Tensor]]:
    torch.manual_seed(0)
    return [item.data for item in augment.forward_parameters((batch, 3, 8, 8))]


# Values of levels 0 to 9, as the AutoAugment paper's ranges and torchvision's documentation give them; * are mirrored.
LEVELS = {
    "shear_x": [0.3 * i / 9 for i in range(10)],
    "translate_y": [150 / 331 * i / 9 for i in range(10)],
    "rotate": [0.0, 3.3333, 6.6667, 10.0, 13.3333, 16.6667, 20.0, 23.3333, 26.6667, 30.0],
    "color": [1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9],
    "posterize": [8, 8, 7, 7, 6, 6, 5, 5, 4, 4],
    "solarize": [1.0, 0.8889, 0.7778, 0.6667, 0.5556, 0.4444, 0.3333, 0.2222, 0.1111, 0.0],
}


@pytest.mark.parametrize("name", LEVELS)
def test_levels_of_auto_augment(name: str) -> None:
    for level, value in enumerate(LEVELS[name]):
        magnitude = drawn(AutoAugment([[(name, 1.0, level)]]), 64)[0]["magnitude"]
        neutral = OPERATIONS[name].neutral
        if name == "posterize":
            magnitude = magnitude.round()
        values = {value} if neutral is None else {value, 2 * neutral - value}
        assert magnitude.unique().tolist() == pytest.approx(sorted(values), abs=1e-4)


def test_the_policies_have_the_entries_of_the_paper() -> None:
    for name, first, last in (
        ("imagenet", [("posterize", 0.4), ("rotate", 0.6)], [("equalize", 0.8), ("equalize", 0.6)]),
        ("cifar10", [("invert", 0.1), ("contrast", 0.2)], [("translate_y", 0.7), ("auto_contrast", 0.9)]),
        ("svhn", [("shear_x", 0.9), ("invert", 0.2)], [("shear_x", 0.7), ("invert", 0.1)]),
    ):
        policy = AutoAugment(name).policy
        assert len(policy) == 25 and all(len(part) == 2 for part in policy)
        assert [(e.name, e.probability) for e in policy[0]] == first
        assert [(e.name, e.probability) for e in policy[-1]] == last


def test_probabilities_of_auto_augment() -> None:
    first, second = drawn(AutoAugment([[("rotate", 0.3, 9), ("invert", 0.8, None)], [("equalize", 1.0, None)]]))
    numbers = {name: OPERATIONS[name].number for name in ("rotate", "invert", "equalize")}
    shares = {name: (first["operation"] == n).float().mean() for name, n in numbers.items()}
    assert shares["equalize"] == pytest.approx(0.5, abs=0.015)
    assert shares["rotate"] == pytest.approx(0.15, abs=0.012)
    # The second operation belongs to the sub-policy of the first one, with a chance of its own.
    assert (second["operation"] == numbers["invert"]).float().mean() == pytest.approx(0.4, abs=0.015)
    assert not (second["operation"][first["operation"] == numbers["equalize"]] >= 0).any()
    both = (first["operation"] == numbers["rotate"]) & (second["operation"] == numbers["invert"])
    assert both.float().mean() == pytest.approx(0.12, abs=0.01)
    mirrored = first["magnitude"][first["operation"] == numbers["rotate"]] < 0
    assert mirrored.float().mean() == pytest.approx(0.5, abs=0.03)


def test_choices_of_rand_augment_are_uniform_and_independent() -> None:
    first, second = drawn(RandAugment(2, 10))
    counts = first["operation"].bincount(minlength=len(OPERATIONS))
    used = counts[counts > 0]
    assert len(used) == 14 and (used / 20_000 - 1 / 14).abs().max() < 0.008
    assert (first["operation"] == second["operation"]).float().mean() == pytest.approx(1 / 14, abs=0.008)
    rotations = first["magnitude"][first["operation"] == OPERATIONS["rotate"].number]
    assert rotations.unique().tolist() == pytest.approx([-10.0, 10.0])


def test_trivial_augment_draws_levels() -> None:
    (step,) = drawn(TrivialAugment())
    values = step["magnitude"][step["operation"] == OPERATIONS["rotate"].number]
    assert sorted({round(abs(v), 3) for v in values.tolist()}) == [4.5 * i for i in range(31)]
    shifts = step["magnitude"][step["operation"] == OPERATIONS["translate_x_pixels"].number]
    assert shifts.abs().max() == 32


# --- what all augmentations promise -----------------------------------------------------------------------------------


@policies_and_mixtures
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16, torch.uint8], ids=str)
def test_replay_is_exact(make: Any, dtype: torch.dtype, device: torch.device) -> None:
    augment, x = make(), images(device, dtype=dtype)
    y = augment(x)
    params, matrix = augment._params, augment.transform_matrix
    augment(x.flip(0))
    assert torch.equal(make()(x, params=params), y)
    again = pickle.loads(pickle.dumps(copy.deepcopy(augment)))
    assert torch.equal(again(x, params=params), y) and torch.equal(again.transform_matrix, matrix)
    assert torch.equal(augment.get_transformation_matrix(x, params), matrix)
    assert torch.equal(augment.inverse(y, params), again.inverse(y))


@policies_and_mixtures
def test_seeds(make: Any, device: torch.device) -> None:
    augment, x = make(), images(device)
    assert torch.equal(augment(x, seed=5), augment(x, seed=5))
    assert not torch.equal(augment(x, seed=5), augment(x, seed=6))
    torch.manual_seed(1)
    y = augment(x)
    torch.manual_seed(1)
    assert torch.equal(augment(x), y)
    seeds, order = torch.arange(len(x), device=device), torch.randperm(len(x), device=device)
    whole = augment(x, seed=seeds)
    torch.testing.assert_close(augment(x[order], seed=seeds[order]), whole[order])


@policies
def test_samples_without_an_operation_pass_unchanged(make: Any, device: torch.device) -> None:
    augment, x = make(), images(device, 64)
    y = augment(x, seed=1)
    none = torch.ones(64, dtype=torch.bool)
    for item in augment._params:
        none &= (item.data["operation"] < 0) | (item.data["operation"] == OPERATIONS["identity"].number)
        assert torch.equal(item.data["batch_prob"] > 0.5, item.data["operation"] >= 0)
    assert torch.equal(y[none.to(device)], x[none.to(device)])


def test_same_on_batch(device: torch.device) -> None:
    x = images(device, 1).expand(8, -1, -1, -1)
    for seed in range(4):
        y = RandAugment(2, 9, same_on_batch=True)(x, seed=seed)
        assert torch.equal(y, y[:1].expand_as(y))


@policies_and_mixtures
def test_an_empty_batch_and_one_image(make: Any, device: torch.device) -> None:
    augment = make()
    assert augment(images(device)[:0]).shape == (0, 3, 12, 15)
    assert augment.transform_matrix.shape == (0, 3, 3)
    assert augment(images(device)[0]).shape == (1, 3, 12, 15)


@policies_and_mixtures
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8])
def test_gray_images_are_those_of_three_equal_channels(make: Any, dtype: torch.dtype, device: torch.device) -> None:
    x, augment = images(device, 64, dtype)[:, :1], make()
    y = augment(x, seed=5)
    assert y.shape == x.shape
    expected = augment(x.expand(-1, 3, -1, -1), seed=5)[:, :1]
    # Of uint8, each of up to four steps rounds, and the next one may triple the difference.
    share = ((y.double() - expected.double()).abs() > (1 if dtype == torch.uint8 else 1e-5)).double().mean()
    assert share < 0.01


@pytest.mark.parametrize("make", [*POLICIES.values(), AugMix], ids=[*POLICIES, "mixture"])
@pytest.mark.parametrize("channels", [2, 4, 13])
def test_images_of_other_channels(make: Any, channels: int, device: torch.device) -> None:
    x = torch.rand(8, channels, 8, 8, device=device)
    y = make()(x, seed=3)
    assert y.shape == x.shape and not torch.equal(y, x)
    color, contrast = (PolicyAugmentBase([[(name, 1.0, 1.5, 1.5)]]) for name in ("color", "contrast"))
    assert torch.equal(color(x), x)
    factor = contrast.forward_parameters(x.shape)[0].data["magnitude"].to(device)[:, None, None, None]
    mean = x.mean((1, 2, 3), keepdim=True)
    expected = (mean + (x - mean) * factor).clamp(0, 1)
    torch.testing.assert_close(contrast(x, params=contrast._params), expected)


@policies_and_mixtures
def test_gradients_reach_images(make: Any, device: torch.device) -> None:
    x = images(device).requires_grad_()
    make()(x).sum().backward()
    assert x.grad.isfinite().all() and x.grad.any()


@policies_and_mixtures
def test_operations_do_not_depend_on_the_batch_or_synchronize(make: Any) -> None:
    calls = []
    make()(images(batch=2), seed=1)  # constants are made once in a process
    for batch in (2, 50):
        with DispatchedOperators() as dispatched:
            make()(images(batch=batch), seed=1)
        calls.append([name for name in dispatched.names if "random" not in name])
    assert len(calls[0]) == len(calls[1])
    assert not [name for name in calls[1] if "local_scalar" in name or "nonzero" in name]


@policies
def test_inverse_and_matrix(make: Any, device: torch.device) -> None:
    augment, x = make(), images(device, 64)
    y = augment(x, seed=2)
    matrix, eye = augment.transform_matrix, torch.eye(3, device=device)
    geometric = [OPERATIONS[name].number for name in OPERATIONS if OPERATIONS[name].neutral == 0]
    operations = torch.stack([item.data["operation"] for item in augment._params])
    moves = torch.isin(operations, torch.tensor(geometric)).any(0).to(device)
    assert moves.any() and not moves.all()
    assert torch.equal(matrix[~moves], eye.expand_as(matrix[~moves])) and not torch.equal(matrix, eye.expand_as(matrix))
    back = augment.inverse(y)
    assert back.shape == x.shape
    torch.testing.assert_close(back[~moves], y[~moves])


def test_labels_follow(device: torch.device) -> None:
    policy, x = TrivialAugment([[("rotate", 90.0, 90.0)]]), images(device)[..., :12]
    points = torch.tensor([[[0.0, 0.0], [3.0, 2.0]]], device=device).expand(len(x), -1, -1)
    augment = A.AugmentationSequential(policy, data_keys=["input", "mask", "keypoints"])
    y, mask, moved_points = augment(x, x, points, seed=4)
    torch.testing.assert_close(y, mask, atol=1e-4, rtol=0)
    i, j = moved_points.round().long().unbind(-1)
    at = torch.arange(len(x), device=device)[:, None]
    before = x[at, :, points[..., 1].long(), points[..., 0].long()]
    torch.testing.assert_close(y[at, :, j, i], before, atol=1e-4, rtol=0)
    torch.testing.assert_close(augment.inverse(y, mask, moved_points)[2], points, atol=1e-4, rtol=0)
    again = augment(x, x, points, params=augment._params)
    torch.testing.assert_close(again[0], y, atol=0, rtol=0)


def test_a_policy_in_a_chain(device: torch.device) -> None:
    x = images(device)
    chain = A.ImageSequential(A.RandomHorizontalFlip(), TrivialAugment(), A.Normalize([0.5] * 3, [0.2] * 3))
    y = chain(x)
    assert torch.equal(chain(x, params=chain._params), y)
    assert chain.transform_matrix.shape == (len(x), 3, 3) and chain.inverse(y).shape == x.shape
    assert not chain.is_intensity_only()
    assert A.ImageSequential(AutoAugment([[("invert", 0.5, None)]])).is_intensity_only()


# --- mixtures ---------------------------------------------------------------------------------------------------------


@mixtures
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
def test_a_mixture_is_the_weighted_mean_of_its_chains(make: Any, dtype: torch.dtype, device: torch.device) -> None:
    augment, x = make(), images(device, 64, dtype)
    y = augment(x, seed=2)
    assert y.dtype == dtype and y.shape == x.shape
    params, image = augment._params, x.float() / 255 if dtype == torch.uint8 else x.float()
    weights = params[0].data["weights"].to(device)[..., None, None, None]
    depth = len(params) // augment.mixture_width
    chains = [expected(image, params[i : i + depth]) for i in range(0, len(params), depth)]
    mixture = weights[:, 0] * image + sum(weights[:, i + 1] * chain for i, chain in enumerate(chains))
    error = (y.float() / 255 - mixture if dtype == torch.uint8 else y.float() - mixture).abs()
    # Rounding may carry a value across a threshold of solarize, or a level of equalize and posterize.
    assert (error <= {torch.uint8: 0.02, torch.float16: 5e-3}.get(dtype, 1e-4)).float().mean() > 0.985
    assert not torch.equal(y, x)


def test_weights_of_a_mixture_are_those_of_beta_and_dirichlet() -> None:
    alpha, width = 0.7, 3
    weights = drawn(AugMix(3, width, 1, alpha))[0]["weights"].double()
    assert weights.shape == (20_000, 1 + width) and (weights >= 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(20_000, dtype=torch.float64), atol=1e-6, rtol=0)
    image, chains = weights[:, 0], weights[:, 1:] / (1 - weights[:, :1])
    for values, a, b in ((image, alpha, alpha), *((chain, alpha, (width - 1) * alpha) for chain in chains.T)):
        assert stats.kstest(values.numpy(), stats.beta(a, b).cdf).pvalue > 1e-4
    # Of a Dirichlet distribution, and independent of the image's weight.
    correlation = torch.corrcoef(torch.cat([image[:, None], chains], 1).T)
    expected_rows = torch.full((width, width), -1 / (width - 1), dtype=torch.float64).fill_diagonal_(1.0)
    assert (correlation[1:, 1:] - expected_rows).abs().max() < 0.03 and correlation[0, 1:].abs().max() < 0.03


def test_operations_of_a_mixture() -> None:
    """Names and values are torchvision's: level i of 10, of which severity 3 draws the lowest three; * are mirrored."""
    items = drawn(AugMix(3))
    assert len(items) == 9
    executed = torch.stack([item["operation"] >= 0 for item in items], 1).unflatten(1, (3, 3))
    assert executed[..., 0].all() and not (executed[..., 2] & ~executed[..., 1]).any()
    depths = executed.sum(2).flatten()
    assert all((depths == n).float().mean() == pytest.approx(1 / 3, abs=0.01) for n in (1, 2, 3))
    values = {
        "shear_x": [0.3 * i / 9 for i in range(3)],
        "translate_y": [i / 27 for i in range(3)],
        "rotate": [30 * i / 9 for i in range(3)],
        "posterize": [4, 3.5556, 3.1111],
        "solarize": [1, 8 / 9, 7 / 9],
        "sharpness": [1, 1.1, 1.2],
    }
    for name, levels in values.items():
        operation = OPERATIONS[name]
        magnitude = items[0]["magnitude"][items[0]["operation"] == operation.number]
        mirrored = [2 * operation.neutral - level for level in levels] if operation.neutral is not None else []
        assert magnitude.unique().tolist() == pytest.approx(sorted({*levels, *mirrored}), abs=1e-4)
    counts = items[0]["operation"].bincount(minlength=len(OPERATIONS))
    assert (counts > 0).sum() == 13
    assert "sharpness" not in {entry.name for part in AugMix(all_ops=False).policy for entry in part}
    bits = drawn(AugMix(10))[0]
    bits = bits["magnitude"][bits["operation"] == OPERATIONS["posterize"].number].round().unique()
    assert bits.tolist() == [0, 1, 2, 3, 4]


def test_mixtures_keep_positions_of_labels(device: torch.device) -> None:
    augment = A.AugmentationSequential(AugMix(10), data_keys=["input", "mask", "keypoints"])
    x, points = images(device), torch.rand(32, 2, 2, device=device)
    y, mask, moved_points = augment(x, x, points)
    assert torch.equal(mask, x) and torch.equal(moved_points, points) and not torch.equal(y, x)
    assert torch.equal(augment(x, x, points, params=augment._params)[0], y)
    assert (
        torch.equal(augment.transform_matrix, torch.eye(3, device=device).expand(32, 3, 3))
        and augment.is_intensity_only()
    )


def test_gradients_of_a_mixture(device: torch.device) -> None:
    augment = AugMix(2, 2, 2, all_ops=False)
    params = augment.forward_parameters((1, 3, 5, 6))
    for item, name in zip(params, ("rotate", "shear_x", "translate_y", "rotate")):
        item.data["operation"] = torch.tensor([OPERATIONS[name].number])
        item.data["magnitude"] = torch.tensor([0.2])
    x = images(device, 1, torch.float64)[..., :5, :6].requires_grad_()
    assert torch.autograd.gradcheck(lambda x: augment(x, params=params), (x,))


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: AutoAugment("coco"), NotImplementedError, "imagenet, cifar10, svhn"),
        (lambda: AutoAugment("coco"), ValueError, "got 'coco'"),
        (lambda: AutoAugment([[("rotate", 0.5)]]), TypeError, "name, probability, level"),
        (lambda: AutoAugment([[("twirl", 0.5, 1)]]), ValueError, "got 'twirl'"),
        (lambda: AutoAugment([[("rotate", 1.5, 1)]]), ValueError, "within 0 and 1"),
        (lambda: AutoAugment([[("rotate", 0.5, 10)]]), ValueError, "within 0 and 9"),
        (lambda: AutoAugment([[("rotate", 0.5, None)]]), ValueError, "a level for 'rotate'"),
        (lambda: AutoAugment([]), ValueError, "at least one operation"),
        (lambda: AutoAugment(3), TypeError, "AutoAugment: expected policy to be sub-policies, lists of entries, got 3"),
        (lambda: AutoAugment([3]), TypeError, r"lists of entries, got \[3\]"),
        (lambda: AutoAugment([[("rotate", "often", 1)]]), TypeError, "probability of 'rotate' to be a number"),
        (lambda: RandAugment(2, "9"), TypeError, "RandAugment: expected m to be a number, got '9'"),
        (lambda: RandAugment(2, 9, 3), TypeError, "RandAugment: expected policy"),
        (lambda: PolicyAugmentBase([[("rotate", 1, 0, "far")]]), TypeError, "values of 'rotate' to be a number"),
        (lambda: PolicyAugmentBase([[("invert", 1, 0, 0)]], count=0), ValueError, "count of at least 1, got 0"),
        (lambda: PolicyAugmentBase([[("invert", 1, 0, 0)]], count=1.5), TypeError, "count to be an int, got 1.5"),
        (lambda: AutoAugment(transformation_matrix_mode="loud"), ValueError, "got 'loud'"),
        (lambda: RandAugment(2, -0.1), ValueError, "within 0 and 30"),
        (lambda: RandAugment(2, 30.1), ValueError, "within 0 and 30"),
        (lambda: RandAugment(0, 3), ValueError, "n of at least 1"),
        (lambda: RandAugment(1.5, 3), TypeError, "n to be an int"),
        (lambda: RandAugment(1, 3, [[("rotate", 0, 1), ("invert", 0, 1)]]), TypeError, "one entry"),
        (lambda: TrivialAugment([[("twirl", 0, 1)]]), ValueError, "got 'twirl'"),
        (lambda: RandAugment(2, 3)(images(), params=[]), ValueError, "2 steps, got 0"),
        (lambda: RandAugment(2, 3)(images(), params=3), TypeError, "RandAugment: expected params to be the _params"),
        (
            lambda: RandAugment(1, 3)(images(batch=2), params=RandAugment(1, 3).forward_parameters((3, 3, 12, 15))),
            ValueError,
            "RandAugment: expected params of a batch of 2, got those of 3 images",
        ),
        (lambda: RandAugment(17, 3), ValueError, "n to take at most 64 random numbers a sample, got 68"),
        (lambda: AugMix(11), ValueError, "severity within 1 and 10, got 11"),
        (lambda: AugMix(2.5), TypeError, "severity to be an int"),
        (lambda: AugMix(3, 0), ValueError, "mixture_width of at least 1"),
        (lambda: AugMix(3, 3, 0), ValueError, "chain_depth to be -1 or at least 1, got 0"),
        (lambda: AugMix(alpha=0.0), ValueError, "alpha above 0"),
        (
            lambda: AugMix(3, 5),
            ValueError,
            "mixture_width and chain_depth to take at most 64 random numbers a sample, got 70",
        ),
        (
            lambda: AugMix(3, 1, 1)(images(), params=RandAugment(1, 3).forward_parameters((32, 3, 12, 15))),
            ValueError,
            "weights",
        ),
    ],
)
def test_errors(make: Callable[[], Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make()


def test_the_highest_and_the_lowest_level_of_rand_augment() -> None:
    policy = [[("brightness", 1.0, 1.9)]]
    for m, factor in ((0, 1.0), (30, 1.9)):
        magnitude = RandAugment(1, m, policy).forward_parameters((64, 3, 8, 8))[0].data["magnitude"]
        drawn = magnitude.unique()
        torch.testing.assert_close(drawn, torch.tensor(sorted({factor, 2 - factor}), dtype=drawn.dtype))
