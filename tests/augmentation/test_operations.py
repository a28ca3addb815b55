"""Operations of policies with learned magnitudes and probabilities."""

from __future__ import annotations

import copy
import inspect
import pickle
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.auto import operations as O

NAMES = [n for n in O.__all__ if n not in ("OperationBase", "PolicySequential")]
names = pytest.mark.parametrize("name", NAMES)
WITHOUT_GRADIENT = ("Posterize", "Solarize")  # of the magnitude: it counts bits, or is a threshold


def images(device: Any = "cpu") -> Tensor:
    return (0.2 + 0.6 * torch.rand(8, 3, 12, 16, generator=torch.Generator().manual_seed(0))).to(device)


@names
def test_replay_seeds_and_gradients(name: str, device: torch.device) -> None:
    x, operation = images(device), getattr(O, name)().to(device)
    y = operation(x)
    assert y.shape == x.shape
    assert torch.equal(operation(x, params=operation._params), y)
    assert torch.equal(operation(x, seed=3), operation(x, seed=3))
    chosen = operation._params["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 8
    y = operation(x, seed=3)
    assert torch.equal(y[~chosen], x[~chosen])
    y.square().sum().backward()
    assert operation._probability.grad is not None and operation._probability.grad.isfinite().all()
    if operation.magnitude is not None and name not in WITHOUT_GRADIENT:
        assert operation._magnitude.grad is not None and operation._magnitude.grad.abs().sum() > 0


@names
def test_probability_follows_the_choices(name: str) -> None:
    for probability in (0.0, 1.0):
        operation = getattr(O, name)(initial_probability=probability)
        operation(images())
        assert (operation._params["batch_prob"] == probability).all()
    operation = getattr(O, name)(initial_probability=0.3)
    with torch.no_grad():
        share = operation.forward_parameters((4000, 3, 4, 4))["batch_prob"].mean()
    assert abs(share - 0.3) < 0.04


def test_magnitudes() -> None:
    shape = (200, 3, 10, 20)
    with torch.no_grad():
        angles = O.Rotate(initial_magnitude=20.0).forward_parameters(shape)["degrees"]
        assert set(angles.tolist()) == {-20.0, 20.0}
        assert set(O.TranslateX(0.25).forward_parameters(shape)["translate_x"].tolist()) == {-5.0, 5.0}
        shears = O.ShearY(0.1).forward_parameters(shape)["shear_y"]
        torch.testing.assert_close(shears.abs(), torch.full_like(shears, 18.0))
    assert O.Brightness(initial_magnitude=9.0).magnitude.item() == pytest.approx(1.8)
    assert O.Brightness(initial_magnitude=None).magnitude.item() == pytest.approx(1.0)


def test_gradient_of_the_probability_has_the_sign_of_the_change() -> None:
    brighter = O.Brightness(initial_magnitude=1.5, initial_probability=0.5, temperature=1.0)
    brighter(images()).sum().backward()
    assert brighter._probability.grad.item() > 0


def test_policies() -> None:
    policy = O.PolicySequential(O.Brightness(), O.Rotate())
    y = policy(images())
    assert y.shape == images().shape and [p.name for p in policy._params] == ["Brightness_0", "Rotate_1"]
    y.sum().backward()
    assert all(p.grad is not None for p in policy.parameters())
    with pytest.raises(ValueError, match="PolicySequential: expected operations"):
        O.PolicySequential(torch.nn.Identity())
    with pytest.raises(TypeError, match="expected operation to be an augmentation"):
        O.OperationBase(torch.nn.Identity())
    with pytest.raises(ValueError, match="temperature"):
        O.Invert(temperature=0.0)
    with pytest.raises(TypeError, match="Invert: expected temperature to be a number, got '"):
        O.Invert(temperature="low")
    with pytest.raises(TypeError, match="Brightness: expected initial_magnitude to be a number, got '"):
        O.Brightness(initial_magnitude="high")


@names
def test_labels_follow_and_containers_replay(name: str, device: torch.device) -> None:
    x, points = images(device), torch.rand(8, 4, 2, device=device) * 10
    operation = getattr(O, name)().to(device)
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(), O.PolicySequential(operation), data_keys=["image", "mask", "keypoints"]
    )
    state = torch.get_rng_state()
    y, masks, moved = augment(x, x, points, seed=torch.arange(8))
    assert torch.equal(torch.get_rng_state(), state)  # seeds leave the generator alone
    expected = K.geometry.linalg.transform_points(augment.transform_matrix.detach(), points)
    torch.testing.assert_close(moved, expected, atol=1e-4, rtol=1e-4)
    chosen = (operation._params["batch_prob"] > 0.5).to(device)
    assert 0 < chosen.sum() < 8
    moves = operation.transform_matrix.detach() != torch.eye(3, device=device)
    assert torch.equal(moves.flatten(1).any(1), chosen & isinstance(operation.op, A.GeometricAugmentationBase2D))
    for part, again in zip((y, masks, moved), augment(x, x, points, params=augment._params)):
        assert torch.equal(part, again)
    torch.testing.assert_close(augment.inverse(moved, data_keys=["keypoints"]), points, atol=1e-4, rtol=1e-4)
    for part, some in zip((y, masks, moved), augment(x[3:], x[3:], points[3:], seed=torch.arange(3, 8))):
        torch.testing.assert_close(part[3:], some)


@pytest.mark.tracing
@names
def test_compiles(name: str) -> None:
    """By itself with torch's generator, and in a container with a seed."""
    torch.compiler.reset()
    x, operation = images(), getattr(O, name)()
    chain = A.AugmentationSequential(
        A.RandomHorizontalFlip(), O.PolicySequential(operation), data_keys=["image", "mask"]
    )
    for call in (lambda x: [operation(x)], lambda x: chain(x, x, seed=4)):
        results, gradients = [], []
        for own in (call, torch.compile(call, fullgraph=True, backend="aot_eager")):
            torch.manual_seed(1)
            results.append(own(x))
            gradients.append(torch.autograd.grad(results[-1][0].square().sum(), operation._probability)[0])
        torch.testing.assert_close(*results)
        torch.testing.assert_close(*gradients)


@names
def test_containers_give_all_samples_the_same(name: str) -> None:
    policy = O.PolicySequential(getattr(O, name)())
    policy.same_on_batch = True
    x = images()[:1].expand(8, -1, -1, -1)
    results = [policy(x) for _ in range(8)]
    assert all(torch.equal(y, y[:1].expand_as(y)) for y in results)
    chosen = policy[0]._params["batch_prob"]
    assert (chosen == chosen[0]).all()
    policy.same_on_batch = False
    policy(images()[:1].expand(64, -1, -1, -1))
    assert 0 < (policy[0]._params["batch_prob"] > 0.5).sum() < 64


def test_return_transform(device: torch.device) -> None:
    x, before = images(device), torch.tensor([[1.0, 0, 3], [0, 1, 0], [0, 0, 1]]).expand(8, 3, 3)
    operation = O.Rotate().to(device)
    y, matrix = operation((x, before), return_transform=True)
    torch.testing.assert_close(matrix, operation.transform_matrix @ before.to(device))
    own = O.OperationBase(A.RandomRotation(30.0, p=1.0, return_transform=True), [("degrees", 9.0)]).to(device)
    y, matrix = own(x)
    assert torch.equal(matrix, own.transform_matrix) and y.shape == x.shape


def test_frames_of_a_video_share_what_is_drawn(device: torch.device) -> None:
    video = A.VideoSequential(O.Rotate(initial_probability=0.5), O.Posterize(), data_format="BTCHW", same_on_frame=True)
    y = video.to(device)(images(device)[:, None].expand(-1, 3, -1, -1, -1))
    assert torch.equal(y[:, 0], y[:, 2])


def test_params_of_another_batch(device: torch.device) -> None:
    operation = O.Rotate().to(device)
    operation(images(device))
    with pytest.raises(ValueError, match="Rotate: expected params of a batch of 3, got those of 8 images"):
        operation(images(device)[:3], params=operation._params)


def test_other_parameters_follow_the_seed(device: torch.device) -> None:
    operation = O.OperationBase(A.RandomAffine(30.0, (0.2, 0.2), p=0.5), [("angle", 10.0)]).to(device)
    first, second = operation(images(device), seed=1), operation(images(device), seed=1)
    assert torch.equal(first, second)
    assert operation._params["translations"].unique(dim=0).shape[0] == 8


@names
def test_copies_and_pickles_have_the_settings(name: str) -> None:
    operation = getattr(O, name)()
    y = operation(images(), seed=3)
    for other in (copy.deepcopy(operation), pickle.loads(pickle.dumps(operation))):
        assert torch.equal(other(images(), seed=3), y)


def test_signatures_are_those_of_kornia() -> None:
    theirs = pytest.importorskip("kornia.augmentation.auto.operations")
    for name in NAMES:
        ours = inspect.signature(getattr(O, name).__init__).parameters
        expected = inspect.signature(getattr(theirs, name).__init__).parameters
        assert {n: p.default for n, p in ours.items()} == {n: p.default for n, p in expected.items()}, name
