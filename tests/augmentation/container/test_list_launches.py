"""Operator calls for lists of images of different sizes: as many for any number of images."""

from __future__ import annotations

import warnings

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from augmentation.test_lists import pictures, seeds_of
from benchmarks.sample_calls.augmentations import IMAGES
from kvision import augmentation as A
from kvision.augmentation.engine.list_chains import ChainParts
from op_tests import assert_close

SIZES = ((20, 28), (24, 18), (17, 17), (30, 25), (22, 23), (26, 21))


class Calls(TorchDispatchMode):
    """Counts the calls of kvision's operators."""

    count = 0

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        self.count += operator.namespace == "kvision"
        return operator(*args, **(kwargs or {}))


def calls(augment, images, *labels, **options):
    with warnings.catch_warnings(), Calls() as counted:
        warnings.simplefilter("ignore")  # of calls without boxes or masks
        augment(images, *labels, **options)
    return counted.count


def grows(augment, images):
    """Whether more images take more calls."""
    calls(augment, images[:3], seed=0)  # which makes constants
    return calls(augment, images, seed=0) > calls(augment, images[:3], seed=0)


class Launches(Calls):
    """Counts kvision's operators, and those of torch that are no views."""

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):
        results = operator._schema.returns
        is_view = bool(results) and results[0].alias_info is not None and not results[0].alias_info.is_write
        self.count += not is_view
        return operator(*args, **(kwargs or {}))


def launches(augment, images, **options):
    with warnings.catch_warnings(), Launches() as counted:
        warnings.simplefilter("ignore")
        augment(images, **options)
    return counted.count


def backward_launches(augment, images):
    leaves = [x.clone().requires_grad_() for x in images]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        results = augment(leaves, seed=0)
    results = [results] if isinstance(results, torch.Tensor) else results
    if not results[0].requires_grad:
        return 0
    grads = [torch.ones_like(y) for y in results]
    with Launches() as counted:
        torch.autograd.grad(results, leaves, grads)
    return counted.count


@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_launches_of_gradients_do_not_depend_on_the_number_of_images(case, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, images = case.make(p=1.0), pictures("cpu", SIZES)
    backward_launches(augment, images[:3])  # which makes constants
    assert backward_launches(augment, images) <= backward_launches(augment, images[:3])


DTYPES = pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
WITH_DOUBLES = pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.float64], ids=str)


@WITH_DOUBLES
@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_calls_do_not_depend_on_the_number_of_images(case, dtype, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    assert not grows(case.make(p=1.0), pictures("cpu", SIZES, dtype))


@WITH_DOUBLES
@pytest.mark.parametrize("name", A.CommonCorruption.NAMES)
def test_calls_of_corruptions(name, dtype, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment = A.CommonCorruption(name, 1, torch.rand(3, 40, 40) if name == "frost" else None)
    assert not grows(augment, pictures("cpu", SIZES, dtype))


OPTIONS = {
    "elastic by sides": lambda: A.RandomElasticTransform((13, 13), (4.0, 4.0), scale_window=True, p=1.0),
    "wide elastic": lambda: A.RandomElasticTransform((71, 71), (4.0, 4.0), p=1.0),
    "pixels of colors": lambda: A.PixelDropout(0.3, drop_value=(0.1, 0.2, 0.3), p=1.0),
    "pixels by channel": lambda: A.PixelDropout(0.3, True, 0.5, p=1.0),
    "learned by sides": lambda: A.RandomElasticTransform((5, 5), torch.tensor([[2.0, 2.0]]), scale_window=True, p=1.0),
    "learned": lambda: A.RandomElasticTransform((5, 5), torch.tensor([[2.0, 2.0]]), p=1.0),
    "expanded": lambda: A.RandomRotation(20.0, expand=True, p=1.0),
}
# Those that docs/inputs.md names: image by image.
OPTIONS_BY_SIZE = {
    "slow": lambda: A.RandomClahe(grid_size=(2, 2), slow_and_differentiable=True, p=1.0),
}


@WITH_DOUBLES
@pytest.mark.parametrize("name", [*OPTIONS, *OPTIONS_BY_SIZE])
def test_calls_with_options(name, dtype, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment = {**OPTIONS, **OPTIONS_BY_SIZE}[name]()
    assert grows(augment, pictures("cpu", SIZES, dtype)) == (name in OPTIONS_BY_SIZE)


@pytest.mark.parametrize("channels", [1, 2, 4])
@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_launches_for_other_channels(case, channels, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, images = case.make(p=1.0), [x[:1].repeat(channels, 1, 1) for x in pictures("cpu", SIZES)]
    counts = []
    for some in (images[:3], images):
        try:
            launches(augment, some, seed=0)  # which makes constants
        except ValueError:
            pytest.skip("it takes three channels")
        counts.append(launches(augment, some, seed=0))
    assert counts[1] <= counts[0]


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize(
    "name", ["RandomGrayscale", "Normalize", "RandomChannelDropout", "factors", "ColorJitter", "behind a warp"]
)
def test_other_channels_become_what_those_of_each_image_become(name, channels, device):
    make = {
        "RandomGrayscale": lambda: A.RandomGrayscale(p=0.5),
        "Normalize": lambda: A.Normalize([0.1, 0.2, 0.3, 0.4][:channels], [0.5, 0.6, 0.7, 0.8][:channels], p=0.5),
        "RandomChannelDropout": lambda: A.RandomChannelDropout(1, 0.3, p=0.5),
        "ColorJitter": lambda: A.ColorJitter(0.3, 0.5, p=0.7),
        "behind a warp": lambda: A.ImageSequential(
            A.RandomAffine(20.0), A.RandomGamma((0.5, 1.5), p=0.7), A.ColorJitter(0.3, 0.5, p=0.7), A.RandomPosterize()
        ),
        "factors": lambda: A.MultiplicativeNoise((0.5, 1.5), per_channel=True, p=0.5),
    }[name]
    for dtype in (torch.float32, torch.uint8):
        images = [x[[0, 1, 2, 0][:channels]] for x in pictures(device, SIZES, dtype)]
        augment, seeds = make(), seeds_of(images)
        results = augment(images, seed=seeds)
        for b, x in enumerate(images):
            assert torch.equal(results[b], augment(x[None], seed=seeds[b : b + 1])[0])


@pytest.mark.filterwarnings("ignore:.*this call has no")
@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_images_without_channels_are_taken_or_refused_by_name(case, device):
    augment, images = case.make(p=1.0), [x[:0] for x in pictures(device, SIZES)]
    try:
        batch = augment(torch.stack([x[:, :17, :17] for x in images]))
    except ValueError:
        with pytest.raises(ValueError, match=r"^\w+: expected"):
            augment(images)
        return
    results = augment(images)
    assert all(y.shape[0] == 0 and y.dtype == batch.dtype for y in results)


POLICIES = {
    "AutoAugment": A.auto.AutoAugment,
    "RandAugment": lambda: A.auto.RandAugment(2, 9),
    "TrivialAugment": A.auto.TrivialAugment,
    "AugMix": A.auto.AugMix,
}


@DTYPES
@pytest.mark.parametrize("name", POLICIES)
def test_calls_of_policies(name, dtype, backend):
    """At most those of a batch: two that draw, and one that executes all steps, or a chain of a mixture."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, images = POLICIES[name](), pictures("cpu", SIZES, dtype)
    most = 3 if name != "AugMix" else 5
    assert calls(augment, torch.stack([x[:, :17, :17] for x in images])) == most
    assert calls(augment, images) <= most and not grows(augment, images)


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("name", POLICIES)
def test_calls_of_policies_on_float64(name, channels, backend):
    """Each operation that may occur is one, as on a batch."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, images = POLICIES[name](), [x[:channels] for x in pictures("cpu", SIZES, torch.float64)]
    assert calls(augment, images) == calls(augment, torch.stack([x[:, :17, :17] for x in images]))
    launches(augment, images[:3], seed=0)  # which makes constants
    assert launches(augment, images, seed=0) == launches(augment, images[:3], seed=0)


CONTAINERS = {
    "policies": lambda: A.ImageSequential(
        A.OneOf(POLICIES["AutoAugment"](), POLICIES["TrivialAugment"]()), A.RandomApply(POLICIES["RandAugment"]())
    ),
    "OneOf": lambda: A.OneOf(A.RandomAffine(20.0), A.RandomErasing(), A.ShotNoise()),
    "SomeOf": lambda: A.SomeOf(A.RandomAffine(20.0, p=1.0), A.RandomErasing(p=1.0), A.RandomInvert(p=1.0), n=2),
    "RandomApply": lambda: A.RandomApply(A.RandomAffine(20.0, p=1.0), A.RandomErasing(p=1.0)),
    "chain": lambda: A.ImageSequential(
        A.RandomHorizontalFlip(), A.OneOf(A.RandomAffine(20.0), A.RandomErasing(), A.ShotNoise()), A.RandomInvert()
    ),
    "containers": lambda: A.ImageSequential(A.ImageSequential(A.RandomHorizontalFlip()), A.RandomErasing()),
    "random_apply": lambda: A.ImageSequential(A.RandomAffine(20.0), A.RandomErasing(), random_apply=1),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_calls_of_containers_are_those_of_their_children(name, backend):
    """Two for each child: the draws and what it does, and those of choices."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, images = CONTAINERS[name](), pictures("cpu", [(16 + i, 40 - i) for i in range(24)])
    assert calls(augment, images, seed=seeds_of(images)) <= 12


REPLAYS = {
    **{name: make for name, make in CONTAINERS.items() if name not in ("OneOf", "chain", "policies")},  # image by image
    "run": lambda: A.ImageSequential(A.RandomAffine(20.0), A.RandomErasing(), A.ColorJitter(0.2, 0.2, 0.2, 0.1)),
    "late crop": lambda: A.ImageSequential(A.RandomAffine(20.0), A.RandomResizedCrop((12, 14)), A.RandomInvert()),
    "augmentation": lambda: A.RandomRotation(20.0),
    "choices inside": lambda: A.ImageSequential(
        A.RandomApply(A.RandomAffine(20.0, p=1.0), A.RandomErasing(p=1.0)), A.OneOf(A.RandomErasing(), A.RandomInvert())
    ),
}


@DTYPES
@pytest.mark.parametrize("name", REPLAYS)
def test_calls_with_given_parameters(name, dtype, backend):
    """They give the bits of the call, without one for each image."""
    augment, images = REPLAYS[name](), pictures("cpu", [(16 + i, 40 - i) for i in range(24)], dtype)
    results = augment(images, seed=seeds_of(images))
    params, matrices = augment._params, augment.transform_matrix
    again = augment(images, params=params)
    assert all(torch.equal(a, b) for a, b in zip(results, again)) and type(results) is type(again)
    assert_close(augment.transform_matrix, matrices)
    if backend != "reference":
        assert calls(augment, images, params=params) <= 8


@pytest.mark.parametrize("behind", [A.RandomInvert, A.PixelDropout, A.Transpose], ids=lambda kind: kind.__name__)
def test_chains_with_a_choice_that_some_images_get(behind, device):
    """Parameters of a list have the children of each image, which a replay gives to that image alone."""
    apply = A.RandomApply(A.RandomInvert(p=1.0), A.RandomSolarize(0.1, 0.1, p=1.0))
    augment, images = A.ImageSequential(apply, behind(p=1.0)), pictures(device, [(16 + i, 40 - i) for i in range(8)])
    results = augment(images, seed=seeds_of(images))
    assert all(torch.equal(a, b) for a, b in zip(results, augment(images, params=augment._params)))


@pytest.mark.parametrize("name", ["run", "late crop", "containers", "RandomApply"])
def test_labels_with_given_parameters(name):
    augment, images = REPLAYS[name](), pictures("cpu", [(16 + i, 40 - i) for i in range(24)])
    augment = A.AugmentationSequential(*augment.children(), data_keys=["input", "bbox_xyxy", "mask"])
    boxes = [torch.tensor([[1.0, 2, 9, 12]])[: b % 2] for b in range(len(images))]
    inputs = (images, boxes, [(x[:1] > 0.5).byte() for x in images])
    results = augment(*inputs, seed=seeds_of(images))
    again = augment(*inputs, params=augment._params)
    assert all(torch.equal(a, b) for of, given in zip(results, again) for a, b in zip(of, given))


MIXES = {
    "passes": lambda: (
        A.OneOf(A.RandomAffine(20.0), A.RandomRotation(30.0), A.ColorJitter(0.2, 0.2)),
        A.RandomInvert(),
    ),
    "blur inside": lambda: (
        A.RandomOrder(A.RandomRotation(9.0), A.RandomGaussianBlur((3, 3), (0.1, 2.0))),
        A.RandomErasing(),
    ),
    "late crop": lambda: (A.SomeOf(A.RandomInvert(p=1.0), A.SpeckleNoise(p=1.0)), A.RandomResizedCrop((12, 14))),
    "container": lambda: (A.ImageSequential(A.RandomHorizontalFlip(), A.RandomErasing()), torch.nn.AvgPool2d(2)),
}


@pytest.mark.parametrize("name", MIXES)
def test_labels_gradients_and_parameters_of_mixed_containers(name, device):
    images = [x.requires_grad_() for x in pictures(device, SIZES)]
    augment, seeds = A.AugmentationSequential(*MIXES[name](), data_keys=["input", "bbox_xyxy"]), seeds_of(images)
    boxes = [torch.tensor([[1.0, 2, 9, 12]], device=device)[: b % 2] for b in range(len(images))]
    results, moved = augment(images, boxes, seed=seeds)
    assert type(augment._record.parts) is ChainParts
    params, matrices = augment._params, augment.transform_matrix
    gradients = torch.autograd.grad(sum(y.square().sum() for y in results), images)
    for b, x in enumerate(images):
        y, own = augment(x[None], [boxes[b]], seed=seeds[b : b + 1])
        assert torch.equal(results[b], y[0]) and torch.equal(matrices[b], augment.transform_matrix[0])
        assert torch.equal(moved[b], own[0])
        assert torch.allclose(gradients[b], torch.autograd.grad(y.square().sum(), x)[0], atol=1e-4)
    again, _ = augment(images, boxes, params=params)
    assert all(torch.allclose(a, b, atol=1e-5) for a, b in zip(again, results))
