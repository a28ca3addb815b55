"""Tests of every augmentation: randomness, replay, probabilities, types, layouts, ranks, gradients."""

from __future__ import annotations

import copy
import functools
import inspect
import io
import json
import pickle
import random
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import GEOMETRIC, IMAGES, Augmentation
from kvision.augmentation.engine import AugmentationBase
from op_tests import THOROUGH, does_not_wait

BASES = (
    "AugmentationBase",
    "MixAugmentationBase",
    "GeometricAugmentation",
    "IntensityAugmentation",
    "RigidAffineAugmentation",
)
RANDOM = [case for case in IMAGES if not case.fixed]
COMPOSED = [case for case in IMAGES if case.composed]
SLOW = [c for c in IMAGES if not c.composed] + (
    COMPOSED if THOROUGH else random.Random(1).sample(COMPOSED, len(COMPOSED) // 10 or 1)
)
names = pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
slow_names = pytest.mark.parametrize("case", SLOW, ids=lambda case: case.name)
random_names = pytest.mark.parametrize("case", RANDOM, ids=lambda case: case.name)


def images(device: Any = "cpu", batch: int = 6, dtype: torch.dtype = torch.float32) -> Tensor:
    x = torch.rand(batch, 3, 16, 20, generator=torch.Generator().manual_seed(batch))
    return ((255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)).to(device)


def test_all_classes_have_a_case() -> None:
    classes = {
        name
        for name, value in vars(A).items()
        if inspect.isclass(value)
        and issubclass(value, AugmentationBase)
        and not issubclass(value, A.MixAugmentationBaseV2)  # test_mix.py
        and not name.startswith(BASES)
        and not name.endswith("3D")  # test_volumes.py
    }
    assert classes == {case.name for case in IMAGES}


MADE = {
    **{case.name: functools.partial(case.make, p=0.7) for case in IMAGES},
    "RandAugment": functools.partial(A.auto.RandAugment, 2, 10),
    "AugMix": A.auto.AugMix,
    "RandomMixUpV2": A.RandomMixUpV2,
    "RandomCutMixV2": A.RandomCutMixV2,
    "RandomMosaic": functools.partial(A.RandomMosaic, (16, 20)),
    "RandomJigsaw": functools.partial(A.RandomJigsaw, (2, 2)),
    "once": lambda: A.ImageSequential(A.RandomAffine(30.0), A.RandomPerspective(), resample="once"),
    "random_apply": lambda: A.ImageSequential(A.RandomAffine(30.0), A.RandomJPEG(), random_apply=1),
    "OneOf": lambda: A.OneOf(A.RandomAffine(30.0), A.RandomJPEG(), A.RandomInvert()),
    "RandomOrder": lambda: A.RandomOrder(A.RandomAffine(30.0), A.RandomInvert()),
}


def test_nothing_depends_on_the_default_device(device: torch.device) -> None:
    x, differs = images(device), []
    for name, make in MADE.items():
        expected, augment = make(), make()
        has_matrix = not getattr(augment, "mixes_samples", False)
        results = [expected(x, seed=3), expected._params, has_matrix and expected.transform_matrix]
        with torch.device("meta"):
            others = [augment(x, seed=3), augment._params, has_matrix and augment.transform_matrix]
        pairs = zip(pytree.tree_leaves(results), pytree.tree_leaves(others), strict=True)
        tensors = [(a, b) for a, b in pairs if isinstance(a, Tensor)]
        if not all(a.device == b.device and torch.equal(a, b) for a, b in tensors):
            differs.append(name)
    assert not differs


@names
def test_matrices_are_where_images_are(case: Augmentation, device: torch.device) -> None:
    x = images(device)
    for p in (0.0, 0.7, 1.0):
        augment = case.make(p=p)
        flipped = A.AugmentationSequential(A.RandomHorizontalFlip(), augment, data_keys=["image"])
        for call in (augment, lambda x, augment=augment: augment(x, params=augment._params), flipped):
            call(x)
            matrix = augment.transform_matrix
            assert matrix is None or matrix.device == x.device, p


@pytest.mark.interface
@names
def test_replay_is_exact(case: Augmentation, device: torch.device) -> None:
    x, augment = images(device), case.make(p=0.7)
    first = augment(x)
    again = case.make(p=0.7)
    assert torch.equal(again(x, params=augment._params), first)
    params = torch.load(_saved(augment._params))
    assert torch.equal(augment(x, params=params), first)
    types = {key: value.dtype for key, value in params.items()}
    text = json.dumps({key: value.tolist() for key, value in params.items()})
    params = {key: torch.tensor(value, dtype=types[key]) for key, value in json.loads(text).items()}
    assert torch.equal(augment(x, params=params), first)
    other = images(device).flip(0)
    augment(other)
    assert torch.equal(augment(x, params=params), first)
    wide = x.double()
    first = augment(wide)
    assert torch.equal(augment(wide, params=augment._params), first)


@pytest.mark.interface
@pytest.mark.parametrize("case", GEOMETRIC, ids=lambda case: case.name)
def test_matrices_have_the_type_that_computes(case: Augmentation, device: torch.device) -> None:
    """Drawn, replayed, in a container and where they are computed from the parameters again."""
    for dtype in (torch.float32, torch.float64, torch.float16):
        x, augment = images(device).to(dtype), case.make(p=1.0)
        augment(x)
        matrix, params = augment.transform_matrix, augment._params
        assert matrix.dtype == (torch.float64 if dtype == torch.float64 else torch.float32)
        augment(x, params=params)
        of_params = augment._execution_of(params, x, augment.flags).matrix
        torch.testing.assert_close(augment.transform_matrix, matrix, rtol=0, atol=0)
        torch.testing.assert_close(of_params, matrix, rtol=0, atol=0)
        chain = A.ImageSequential(A.RandomHorizontalFlip(p=1.0), augment)
        chain(x)
        matrix = chain.transform_matrix
        chain(x, params=chain._params)
        torch.testing.assert_close(chain.transform_matrix, matrix, rtol=0, atol=0)


def _saved(params: dict[str, Any]) -> io.BytesIO:
    stream = io.BytesIO()
    torch.save(params, stream)
    stream.seek(0)
    return stream


@pytest.mark.interface
@names
def test_manual_seed_reproduces(case: Augmentation, device: torch.device) -> None:
    x, augment = images(device), case.make()
    torch.manual_seed(5)
    first = augment(x)
    torch.manual_seed(5)
    assert torch.equal(augment(x), first)
    own = torch.Generator().manual_seed(5)
    assert torch.equal(augment(x, generator=own), first)
    assert torch.equal(case.make(generator=torch.Generator().manual_seed(5))(x), first)


@pytest.mark.interface
@random_names
def test_a_call_takes_one_word_of_the_generator(case: Augmentation) -> None:
    x, augment = images(), case.make(p=1.0)
    torch.manual_seed(5)
    augment(x)
    after = torch.get_rng_state()
    torch.manual_seed(5)
    torch.empty(1, dtype=torch.int64).random_(-(2**63), None)
    assert torch.equal(torch.get_rng_state(), after)
    case.make(p=0.0)(x)
    assert torch.equal(torch.get_rng_state(), after)


@pytest.mark.interface
@names
def test_seeds_of_samples_are_independent_of_the_batch(case: Augmentation, device: torch.device) -> None:
    if case.one_kernel:
        pytest.skip("samples share a size, which is that of the first")
    x, augment = images(device), case.make(**({} if case.changes_size else {"p": 0.7}))
    seeds = torch.arange(6) * 1000
    all_of_them = augment(x, seed=seeds)
    state = torch.get_rng_state()
    order = torch.tensor([4, 1, 5])
    some = augment(x[order], seed=seeds[order])
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(some, all_of_them[order])
    assert torch.equal(augment(x, seed=7), augment(x, seed=7))


@pytest.mark.interface
@random_names
def test_parameters_are_those_of_the_cpu(case: Augmentation, device: torch.device) -> None:
    on_device, on_cpu = case.make(p=0.7), case.make(p=0.7)
    on_device(images(device), seed=3), on_cpu(images(), seed=3)
    for name, value in on_cpu._params.items():
        assert on_device._params[name].device.type == "cpu"
        assert torch.equal(on_device._params[name], value), name


@names
def test_samples_not_chosen_are_unchanged(case: Augmentation, device: torch.device) -> None:
    x = images(device, batch=32) * 3 - 1  # out of [0, 1] as well
    if case.name == "PadTo":
        pytest.skip("it has no probability")
    assert torch.equal(case.make(p=0.0)(x), x)
    if case.changes_size or case.all_or_none:
        return
    augment = case.make(p=0.5)
    y = augment(x)
    chosen = augment._params["batch_prob"] > 0.5
    assert 2 < chosen.sum() < 30
    assert torch.equal(y[~chosen], x[~chosen])
    matrix = augment.transform_matrix.cpu()
    assert torch.equal(matrix[~chosen], torch.eye(3).expand(int((~chosen).sum()), 3, 3))


@pytest.mark.interface
@random_names
def test_same_on_batch(case: Augmentation) -> None:
    if case.changes_size and "same_on_batch" not in inspect.signature(getattr(A, case.name)).parameters:
        return
    augment = case.make(p=1.0, same_on_batch=True)
    x = images()[:1].expand(4, -1, -1, -1)
    y = augment(x)
    assert torch.equal(y, y[:1].expand_as(y))
    augment = case.make(p=0.5 if "Flip" in case.name else 1.0)  # which is all that flips draw
    augment(images()[:1].expand(64, -1, -1, -1))
    drawn = [x for name, x in augment._params.items() if name not in ("forward_input_shape", "center", "batch_idx")]
    assert any((x != x[:1]).any() for x in drawn)


@names
def test_small_batches(case: Augmentation, device: torch.device) -> None:
    for batch in (0, 1):
        x = images(device, batch)
        assert case.make(p=1.0)(x).shape[:2] == x.shape[:2]


@pytest.mark.interface
@names
def test_ranks(case: Augmentation) -> None:
    x = images()[0]
    assert case.make(p=1.0)(x).dim() == 4
    assert case.make(p=1.0, **_keepdim(case))(x).dim() == (3 if _keepdim(case) else 4)
    if case.any_channels and case.name not in ("RandomChannelDropout", "RandomChannelShuffle"):
        assert case.make(p=1.0)(x[0]).dim() == 4


def _keepdim(case: Augmentation) -> dict[str, bool]:
    return {"keepdim": True} if "keepdim" in inspect.signature(getattr(A, case.name)).parameters else {}


@names
def test_types(case: Augmentation, device: torch.device) -> None:
    for dtype in (torch.float16, torch.bfloat16, torch.float64, torch.uint8):
        x, augment = images(device, dtype=dtype), case.make(p=1.0)
        y = augment(x, seed=3)
        leaves_unit = case.name in ("Normalize", "Denormalize") and dtype == torch.uint8
        assert y.dtype == (torch.float32 if leaves_unit else dtype)
        expected = augment(x.float() / (255 if dtype == torch.uint8 else 1), seed=3)
        if y.dtype == torch.uint8:
            expected = expected.clamp(0, 1)  # bytes saturate
        exact = (1.0, 1e-4)
        scale, tolerance = {torch.uint8: (255.0, 1.01), torch.float64: exact, torch.float32: exact}.get(
            y.dtype, (1.0, 0.03)
        )
        if case.gradient:  # others jump
            assert (y.double() - scale * expected.double()).abs().max() <= tolerance, dtype


@names
def test_channels_last(case: Augmentation, device: torch.device) -> None:
    x = images(device)
    planar, last = case.make(p=0.7), case.make(p=0.7)
    expected = planar(x, seed=3)
    y = last(x.to(memory_format=torch.channels_last), seed=3)
    torch.testing.assert_close(y, expected, rtol=1e-5, atol=1e-5)
    assert y.is_contiguous(memory_format=torch.channels_last)
    again = last(x.to(memory_format=torch.channels_last), params=last._params)
    assert again.is_contiguous(memory_format=torch.channels_last) and torch.equal(again, y)


@pytest.mark.interface
@names
def test_inputs_are_not_modified(case: Augmentation) -> None:
    x = images()
    before = x.clone()
    case.make(p=0.7)(x)
    assert torch.equal(x, before)


@names
def test_any_number_of_channels(case: Augmentation) -> None:
    if not case.any_channels:
        pytest.skip("defined for RGB")
    for channels in (1, 2, 5):
        x = torch.rand(2, channels, 16, 20)
        assert case.make(p=1.0)(x).shape[:2] == (2, channels)


@pytest.mark.interface
@names
def test_pickles_and_copies(case: Augmentation) -> None:
    x, augment = images(), case.make()
    augment(x)
    for other in (pickle.loads(pickle.dumps(augment)), copy.deepcopy(augment)):
        assert torch.equal(other(x, seed=1), augment(x, seed=1))


@pytest.mark.derivatives
@slow_names
def test_gradient_of_images(case: Augmentation) -> None:
    if not case.gradient:
        pytest.skip("jumps")
    augment = case.make(p=1.0)
    x = (0.25 + 0.5 * torch.rand(2, 3, 8, 9, generator=torch.Generator().manual_seed(1))).double().requires_grad_()
    if case.name in ("CenterCrop", "RandomCrop", "RandomResizedCrop", "Resize"):
        augment = getattr(A, case.name)((4, 5))
    elif case.name in ("AtLeastOneBBoxRandomCrop", "CropNonEmptyMaskIfExists"):
        augment = getattr(A, case.name)(4, 5)
    assert torch.autograd.gradcheck(lambda x: augment(x, seed=2), x, eps=1e-7, atol=1e-4)


@pytest.mark.interface
@names
def test_wrong_inputs(case: Augmentation) -> None:
    augment = case.make()
    with pytest.raises(TypeError, match=f"{case.name}: expected input to be .*, got a list of 1"):
        augment([1.0])
    with pytest.raises(TypeError, match=f"{case.name}: .*int64"):
        augment(torch.zeros(1, 3, 8, 8, dtype=torch.int64))
    with pytest.raises(ValueError, match=f"{case.name}: expected input of shape"):
        augment(torch.zeros(1, 1, 3, 8, 8))
    for size in ((0, 8), (8, 0)):
        with pytest.raises(ValueError, match=f"{case.name}: expected input with pixels"):
            augment(torch.zeros(1, 3, *size))
    if case.name != "PadTo":  # has no probability
        for p in (-0.1, 1.1):
            with pytest.raises(ValueError, match=f"{case.name}: expected p"):
                case.make(p=p)


@pytest.mark.interface
@names
def test_return_transform(case: Augmentation) -> None:
    x = images()
    y, matrix = case.make(p=1.0)(x, return_transform=True)
    assert y.dim() == 4 and matrix.shape == (6, 3, 3)
    before = torch.tensor([[1.0, 0, 3], [0, 1, 0], [0, 0, 1]]).expand(6, 3, 3)
    augment = case.make(p=1.0, return_transform=True)
    y, product = augment((x, before))
    torch.testing.assert_close(product, augment.transform_matrix @ before)
    assert case.make(p=1.0)((x, before))[1] is before


@pytest.mark.tracing
@slow_names
def test_compiles(case: Augmentation) -> None:
    """Two graphs serve all sizes and seeds, also of many classes in a process; one more draws what eager calls draw."""
    from torch._dynamo.testing import CompileCounterWithBackend

    if case.one_kernel:
        pytest.skip("the host reads the size of a kernel, where this has a range")
    augment, backend = case.make(**({} if case.changes_size else {"p": 0.7})), CompileCounterWithBackend("aot_eager")
    compiled = torch.compile(augment, fullgraph=True, backend=backend)
    sizes = [(2, 18, 21), (3, 20, 24), (5, 33, 22), (4, 19, 32)]
    if ("Plasma" in case.name or case.composed) and not THOROUGH:  # tens of seconds
        torch.compiler.reset()
        sizes = sizes[:1]
    for seed, (batch, *size) in enumerate(sizes):
        x = torch.rand(batch, 3, *size)
        torch.testing.assert_close(compiled(x, seed=seed), augment(x, seed=seed))
    assert backend.frame_count <= 2
    torch.manual_seed(1)
    y = compiled(x)
    torch.manual_seed(1)
    torch.testing.assert_close(y, augment(x))


def test_no_two_classes_have_the_code_of_one_forward() -> None:
    """torch.compile keeps eight graphs of a code. Mixed-in methods still precede inherited ones."""
    classes = {getattr(A, name) for name in A.__all__ if inspect.isclass(getattr(A, name))}
    modules = [c for c in classes if issubclass(c, (AugmentationBase, A.ImageSequential))]
    assert len({id(c.forward.__code__) for c in modules}) == len(modules) > 75

    class Half:
        def forward(self, x: Tensor) -> Tensor:
            return super().forward(x) / 2

    class Own(A.RandomHorizontalFlip):
        pass

    class Mixed(Own, Half, A.RandomVerticalFlip):
        pass

    assert torch.equal(Mixed(p=1.0)(torch.ones(1, 1, 2, 2)), torch.full((1, 1, 2, 2), 0.5))


@pytest.mark.tracing
@pytest.mark.parametrize("backend", ["aot_eager", "aot_eager_decomp_partition"])
def test_calls_of_one_graph_draw_apart(backend: str) -> None:
    """Also where gradients are wanted, in graphs of which equal calls are removed."""
    torch.compiler.reset()
    x, augment, chain = images().requires_grad_(), A.RandomRotation(30.0, p=1.0), A.ImageSequential(A.RandomInvert())

    def views(x: Tensor) -> list[Tensor]:
        return [augment(x), augment(x), chain(x), chain(x)]

    torch.manual_seed(1)
    expected = views(x)
    torch.manual_seed(1)
    results = torch.compile(views, fullgraph=True, backend=backend)(x)
    torch.testing.assert_close(results, expected)
    assert not torch.equal(results[0], results[1])


@pytest.mark.tracing
def test_compiles_without_decisions_of_the_host() -> None:
    x, augment = images(), A.RandomMotionBlur(3, 35.0, 0.5, p=1.0)
    compiled = torch.compile(lambda x: augment(x, seed=4), fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(x), augment(x, seed=4))


@pytest.mark.parametrize("seed", [None, 5, torch.arange(6) + 3], ids=["none", "one", "each"])
@pytest.mark.parametrize("p", [1.0, 0.6])
def test_the_host_draws_the_size_of_a_kernel_again(p: float, seed: Any) -> None:
    augment = A.RandomMotionBlur((3, 21), 35.0, 0.5, p=p)
    chain = A.ImageSequential(A.RandomHorizontalFlip(), augment)
    for _ in range(4):
        for call in (augment, chain):
            call(images(), seed=seed)
            execution = augment._execution
            assert torch.equal(augment._values_on_host(execution), execution.columns.values)
            sizes = execution.columns.values[:, 0].int()
            first = next((n for n in sizes.tolist() if n), 3)
            expected = sizes.clamp(min=3) if isinstance(seed, Tensor) else torch.full((6,), first)
            assert augment._params["ksize_factor"].tolist() == expected.tolist()


@names
def test_no_call_waits_for_the_device(case: Augmentation, device: torch.device) -> None:
    x, augment = images(device), case.make(**({} if case.changes_size else {"p": 0.7}))
    does_not_wait(device, [lambda: augment(x), lambda: augment(x, seed=1)])


@random_names
def test_a_graph_draws_anew(case: Augmentation, device: torch.device) -> None:
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    x, augment = images(device), case.make(p=1.0)
    x = torch.cat([x] * 4)
    for _ in range(2):
        augment(x)
    graph = torch.cuda.CUDAGraph()
    if case.one_kernel:  # of a size that the host decides
        with pytest.raises(RuntimeError, match=f"{case.name}: .* cannot be captured"), torch.cuda.graph(graph):
            augment(x)
        return
    augment = case.make(p=0.5) if "Flip" in case.name else augment  # which is all that flips draw
    with torch.cuda.graph(graph):
        y = augment(x)
    graph.replay()
    before = y.clone()
    graph.replay()
    assert not torch.equal(y, before)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: A.ColorJitter(hue=0.6),
            r"ColorJitter: expected hue in ascending order within -0\.5 and 0\.5, got 0\.6",
        ),
        (lambda: A.ColorJiggle(brightness=3.0), "ColorJiggle: expected brightness in ascending order within 0 and 2"),
        (lambda: A.RandomAffine(400.0), "RandomAffine: expected degrees in ascending order within -360 and 360"),
        (lambda: A.RandomAffine(float("inf")), "RandomAffine: expected degrees"),
        (lambda: A.RandomAffine(5.0, translate=(1.5, 0.1)), "RandomAffine: expected translate"),
        (lambda: A.RandomMotionBlur(3, 5.0, 2.0), "RandomMotionBlur: expected direction"),
        (lambda: A.RandomSolarize(thresholds=2.0), "RandomSolarize: expected thresholds"),
        (lambda: A.RandomSolarize(additions=2.0), "RandomSolarize: expected additions"),
    ],
)
def test_numbers_that_stand_for_ranges_out_of_bounds(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
    A.ColorJitter(2.0, 2.0, 2.0, 0.5)  # factors begin at 0


def test_parameters_that_lack_a_name() -> None:
    augment = A.RandomAffine(30.0, p=1.0)
    with pytest.raises(ValueError, match="RandomAffine: expected params with 'shear_x', got angle, "):
        augment(
            images(), params={"angle": torch.zeros(6), **{k: v for k, v in _params(augment).items() if k != "shear_x"}}
        )


def _params(augment: Any) -> dict[str, Any]:
    augment(images())
    return dict(augment._params)
