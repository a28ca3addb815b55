"""Arguments as people pass them, swept over all public functions and modules; the calls are those of their examples.

- Where a number is taken, so are NumPy's scalars and tensors of no axes.
- A parameter in CPU memory follows images to their device; a second image, a map, points or labels do not.
- What is no tensor, where examples have one, is named in the error.
- Any wrong value, and tensors that do not fit together, are a ValueError or a TypeError, not an error from inside of torch.
"""

from __future__ import annotations

import doctest
import inspect
import random
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from itertools import product
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor, nn

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, sample_calls, sample_modules
from example_calls import HOMES, Call, copied, example_calls
from kvision.core.exceptions import DeviceError, TypeCheckError
from op_tests import THOROUGH
from test_docstrings import OBJECTS

pytestmark = pytest.mark.interface


def tenth_of(names: Iterable[str]) -> list[str]:
    every = list(names)
    return every if THOROUGH else random.Random(0).sample(every, len(every) // 10)


# All tests of a file follow each other: running its examples is most of their time.
homes = pytest.mark.parametrize("home", HOMES, scope="module")

# --- what is no tensor ------------------------------------------------------------------------------------------------

NO_TENSORS = {
    "list": [[1.0, 2.0]],
    "NumPy array": np.zeros((1, 3, 4, 5), np.float32),
    "PIL image": Image.new("RGB", (5, 4)),
    "None": None,
    "string": "image",
}
# Public names that take something else where their examples have a tensor.
OTHER_KINDS = {
    "print_image": "takes the path of a file, too",
    "Lambda.forward": "passes what it gets to the user's function",
    "ImageSequential.forward": "takes arrays, PIL images and paths, and passes on what else it gets",
    "show": "takes arrays, PIL images and paths, and lists of them",
    "to_numpy": "takes arrays, PIL images and paths, and lists of them",
    "to_pil": "takes arrays, PIL images and paths, and lists of them",
    "to_tensor": "takes arrays, PIL images and paths, and lists of them",
    "PassLAF.forward": "returns what it gets",
    "CameraCalibration": "holds results",
    "Letterboxed": "holds results",
    "PaddedBatch": "holds results",
    "RigCalibration": "holds results",
    "StereoRectification": "holds results",
    "LeastSquaresResult": "holds results",
    "VisionPatches": "holds results",
    "vision_patches": "takes lists of images",
    "Affine": "takes None for an angle",
    "RandomFisheye": "takes pairs of numbers, too",
}
for home in (K.augmentation, K.augmentation.auto, K.augmentation.auto.operations, K.augmentation.presets.ada):
    for name, value in vars(home).items():
        is_container = isinstance(value, type) and issubclass(value, K.augmentation.ImageSequential)
        if is_container and not issubclass(value, K.augmentation.VideoSequential):
            OTHER_KINDS[f"{name}.forward"] = "takes arrays, PIL images and paths"
OTHER_KINDS |= {f"{name}.forward": "takes any nesting, and passes on what it does not know" for name in K.tv.__all__}


# Their examples write files that are gone when the call is made again.
WRITERS = {"write_image", "show", "save_pointcloud_ply", "save_pointcloud_ply_binary"}


def tensors(home: str) -> Iterator[tuple[Call, str | int, bool]]:
    """The tensors in the examples of a file, and whether they are first arguments."""
    if home.startswith("tv."):
        return  # torchvision's functions take arrays or PIL images, too
    for calls in example_calls(home).values():
        seen = set()
        for call in calls:
            for i, (key, value) in enumerate(call.arguments().items()):
                if isinstance(value, Tensor) and (call.name, key) not in seen and call.name not in OTHER_KINDS:
                    seen.add((call.name, key))
                    yield call, key, i == 0


def words(annotation: Any) -> set[str]:
    """The words of the Literals of a type, in lower case."""
    if get_origin(annotation) is Literal:
        return {word.lower() for word in get_args(annotation) if isinstance(word, str)}
    parts = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else ()
    return set().union(*map(words, parts))


def choices(call: Call) -> Iterator[tuple[str, set[str]]]:
    """The arguments that are one of two words or more, by their types."""
    target = call.function.__init__ if inspect.isclass(call.function) else call.function
    target = inspect.unwrap(target.forward if isinstance(target, nn.Module) else target)
    for name, parameter in inspect.signature(target).parameters.items():
        if re.search(r"^[A-Z]\w+( \||$)|Literal", str(parameter.annotation)):
            known = words(eval(parameter.annotation, target.__globals__))
            if len(known) > 1:
                yield name, known


def check_choices(home: str) -> None:
    """What a wrong word is answered with are the words of the argument's type, which editors offer."""
    for calls in example_calls(home).values():
        for call in calls[:1]:
            for name, known in choices(call):
                positions = [p.name for p in call.parameters()][: len(call.args)]
                with pytest.raises(ValueError, match="one of") as raised:
                    call.replaced(positions.index(name) if name in positions else name, "no such word")
                    pytest.fail(f"{call.name} accepts any {name}")
                listed = re.search(r"one of (.*?)( or a list)?[;,] got", str(raised.value))
                assert listed and {re.sub(r" \(.*", "", x).lower() for x in listed[1].split(", ")} == known, (
                    raised.value
                )


@homes
def test_other_types_are_named(home):
    check_choices(home)  # here, as the examples of a file take time
    for call, key, is_first in tensors(home):
        kind_of_tensor = r"to be (.*Tensor|images).*" if is_first else r".*"
        for kind, value in NO_TENSORS.items():
            said = rf"expected [\w\[\] ]+ {kind_of_tensor}, got .*{type(value).__name__ if is_first else ''}"
            if value is None and not is_first:
                continue  # which many take for no tensor
            with pytest.raises(TypeCheckError, match=said):
                call.replaced(key, value)
                pytest.fail(f"{call.name} accepts a {kind}, argument {key}")


def test_nearly_all_public_names_have_examples():
    """All but base classes, features that want weights, and the function that replaces those of Kornia."""
    examples = {name: doctest.DocTestFinder(recurse=False).find(x, name) for name, x in OBJECTS.items()}
    without = [name for name, actual in examples.items() if not any(example.examples for example in actual)]
    assert len(without) < 0.05 * len(examples), without


# --- tensors that do not fit together ---------------------------------------------------------------------------------


def wrong_values() -> list[Any]:
    """What hardly any parameter takes, and numbers that few take."""
    shapes = ((), (0,), (3,), (2, 3, 4))
    numbers = (-1, 0, -0.5, 1e300, 10**30, -(10**30), float("nan"), float("inf"), 1j, True)
    sequences = ([], (), {}, [[]], [None], ("a", "b"), (-1, -1), (0.5, 0.5), (1, 2, 3, 4, 5), [[1.0, 2.0]])
    tensors = (*map(torch.rand, shapes), torch.zeros(2, 2, dtype=torch.long), torch.tensor(True))
    return [None, "image", b"image", object(), int, *numbers, *sequences, *tensors]


def misfits(x: Tensor) -> Iterator[Tensor]:
    """Tensors of another batch size, number of points, size, type, layout or device than `x`."""
    if x.dim() > 0:
        yield x[:1].expand(3, *x.shape[1:])
        yield x.to_sparse()
    yield from (x.narrow(axis, 0, n) for axis in range(x.dim()) for n in (0, 1) if n <= x.shape[axis])
    if x.dim() > 1:
        yield from (torch.cat([x, x.narrow(axis, 0, 1)], axis) for axis in range(1, x.dim()) if x.shape[axis])
        yield from (x[0], x[0, 0], x.flatten())
    yield from (x[None], x[None, None], x[..., None])
    yield from (torch.nested.nested_tensor([x.reshape(-1), x.reshape(-1)[:1]], layout=y) for y in LAYOUTS)
    yield from (x.to(dtype) for dtype in DTYPES if dtype != x.dtype)
    yield x.to("meta")
    if x.dtype == torch.float32:
        yield torch.quantize_per_tensor(x, 0.1, 0, torch.quint8)


LAYOUTS = (torch.strided, torch.jagged) if THOROUGH else (torch.strided,)  # the jagged ones import for seconds
DTYPES = (torch.int64, torch.int16, torch.uint8, torch.uint16, torch.bool, torch.float64, torch.float16, torch.bfloat16)
DTYPES += (torch.complex64, torch.float8_e4m3fn)
# Parameters that say how long a call takes, for which a large number is right, and those that name files and compile.
COUNTS = re.compile(r"iter|level|num|max_samples|batch_size|points|count|n_|_n$|trials")
NOT_REPLACED = {"pretrained", "compile_modules"}


def wrong_calls(call: SampleCall) -> Iterator[tuple[str, Any, Callable[[], Any]]]:
    """The calls of a sample with one argument replaced: the argument, the wrong value, and the call."""
    tensors = call.tensors(Size(2, 3, 12, 14))
    made = call.function()
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    parameters = [p for p in inspect.signature(made).parameters.values() if p.kind not in kinds]
    if inspect.isclass(made):
        plain = call.arguments(K, {})
        plain.update(zip([p.name for p in parameters], call.args))

        def with_argument(name: str, value: Any) -> Any:
            return made(**{**plain, name: value})(*tensors.values())

        module = made(**plain)
        for name, x in tensors.items():
            for value in (*misfits(x), *wrong_values()):
                yield name, value, lambda name=name, value=value: module(*{**tensors, name: value}.values())
    else:
        plain = call.arguments(K, tensors)

        def with_argument(name: str, value: Any) -> Any:
            return made(**{**plain, name: value})

    for name in dict.fromkeys([*plain, *(p.name for p in parameters if p.default is not p.empty)]):
        given = plain.get(name)
        for value in (*(misfits(given) if isinstance(given, Tensor) else ()), *wrong_values()):
            is_long = isinstance(value, (int, float)) and abs(value) > 1e6 and COUNTS.search(name)
            if name not in NOT_REPLACED and not is_long:
                yield name, value, lambda name=name, value=value: with_argument(name, value)


def is_named(error: Exception, value: Any) -> bool:
    """Whether an error says what is wrong: the library's own, or torch's about a type or device without an implementation."""
    if isinstance(error, (TypeError, ValueError)):
        return True
    if isinstance(value, Tensor) and value.is_meta:
        return "meta" in str(error).lower()
    return isinstance(error, NotImplementedError) and "UInt16" in str(error)


WRONGLY_CALLED = {call.name: call for call in (*sample_calls(), *sample_modules())}


@pytest.mark.parametrize("name", tenth_of(WRONGLY_CALLED))
def test_wrong_arguments_are_named(name):
    """A TypeError or a ValueError, whatever is passed; most are no error, since most parameters take several kinds.

    `HYPOTHESIS_PROFILE=thorough` calls all functions and modules, else it is a tenth with a third of the values.
    """
    chosen = random.Random(name)
    for argument, value, wrong_call in wrong_calls(WRONGLY_CALLED[name]):
        if not THOROUGH and chosen.random() > 1 / 3:
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                wrong_call()
        except Exception as error:
            if not is_named(error, value) and not str(error).startswith(name.partition(".")[2]):
                shape = f" {tuple(value.shape)}" if isinstance(value, Tensor) and not value.is_nested else ""
                pytest.fail(f"{argument}={type(value).__name__}{shape} {value!r:.60}: {error!r}")


# --- constructors -----------------------------------------------------------------------------------------------------

# Modules whose calls depend on what else was done or given, or take seconds.
NOT_MADE = {
    "DepthWarper",
    "ZCAWhitening",
    "ImageStitcher",
    "MILossFromRef",
    "RectangleEraseGenerator",
    "RandomJigsaw",
    "Lambda",
}
NOT_MADE |= {"KeyNetDetector", "ScaleSpaceDetector", "MultiResolutionDetector", "ImageRegistrator", "LAFDescriptor"}


def constructions(home: str) -> Iterator[tuple[type, dict[str, Any], list[Call]]]:
    """The public modules of a file, with the arguments of an example, and calls of their forward."""
    for calls in example_calls(home).values():
        made = [call for call in calls if inspect.isclass(call.function) and issubclass(call.function, nn.Module)]
        forwards = [call for call in calls if isinstance(call.function, nn.Module)]
        if not made or not forwards or made[0].name in NOT_MADE:
            continue
        cls, arguments = made[0].function, made[0].by_name()
        if "p" in inspect.signature(cls).parameters:
            arguments["p"] = 1.0
        if arguments:
            yield cls, arguments, forwards[:3]


def inputs_like(call: Call) -> Iterator[list[Any]]:
    """The tensors of a call, and others that a module may have been made for: samples, channels, sizes and types."""

    def changed(f: Callable[[Tensor], Tensor], axes: int = 3) -> list[Any]:
        return [f(x) if isinstance(x, Tensor) and x.dim() >= axes else x for x in call.args]

    yield call.args
    yield from (changed(lambda x, n=n: x[:1].expand(n, *x.shape[1:])) for n in (1, 2, 3, 5))
    yield changed(lambda x: x[:0])
    yield from (changed(lambda x, n=n: x[:, :1].expand(-1, n, *x.shape[2:]), 4) for n in (1, 2, 3, 5))
    yield changed(lambda x: x[:1, :1].expand(2, 2, *x.shape[2:]), 4)
    yield changed(lambda x: x.repeat(*[1] * (x.dim() - 2), 8, 8))
    yield from (changed(lambda x, dtype=dtype: x.to(dtype)) for dtype in (torch.float64, torch.uint8, torch.int64))


def some_call_works(module: nn.Module, forwards: list[Call]) -> bool | Exception:
    errors = []
    for call in forwards:
        for inputs in inputs_like(call):
            try:
                module(*map(copied, inputs), **call.kwargs)
                return True
            except Exception as error:
                errors.append(error)
    return errors[0]


@pytest.mark.parametrize("home", tenth_of(HOMES))
def test_constructors_refuse_what_every_call_refuses(home):
    """`HYPOTHESIS_PROFILE=thorough` makes the modules of all files with all values, else it is a tenth with a third of them."""
    not_replaced = NOT_REPLACED | {"args", "kwargs", "options", "data_keys"}
    for cls, arguments, forwards in constructions(home):
        chosen = random.Random(cls.__name__)
        assert some_call_works(cls(**arguments), forwards) is True, cls
        for name, value in product(inspect.signature(cls).parameters, wrong_values()):
            is_long = isinstance(value, (int, float)) and abs(value) > 1e6
            if name in not_replaced or is_long or not (THOROUGH or chosen.random() < 1 / 3):
                continue
            try:
                module = cls(**{**arguments, name: value})
            except Exception as error:
                assert isinstance(error, (TypeError, ValueError)) or str(error).startswith(cls.__name__), (cls, name)
                continue
            if not isinstance(value, (Tensor, tuple, list)):  # which may have a number for each sample or channel
                works = some_call_works(module, forwards)
                is_named = works is True or isinstance(works, NotImplementedError)
                assert is_named, f"{cls.__name__}({name}={value!r:.60}): {works!r}"


@pytest.mark.parametrize(
    "make",
    [
        lambda: K.filters.GaussianBlur2d(3, torch.rand(5, 2)),  # for batches of 5
        lambda: K.enhance.AdjustGamma(torch.rand(5)),
        lambda: K.enhance.Normalize(torch.rand(7), torch.rand(7)),  # for 7 channels
        lambda: K.enhance.Normalize(torch.rand(5, 7), 1.0),
        lambda: K.losses.FocalLoss(0.5, weight=torch.rand(11)),
        lambda: K.enhance.AddWeighted(torch.rand(4, 9, 8), 0.5, 1.0),  # for images of this size
        lambda: K.filters.GaussianBlur2d((101, 301), (9.0, 9.0)),
        lambda: K.geometry.Rotate(torch.zeros(4, requires_grad=True)),
        lambda: K.geometry.Scale(nn.Parameter(torch.ones(4, 2, dtype=torch.float64))),
        lambda: K.enhance.Rescale(torch.tensor(2.0, requires_grad=True)),
        lambda: K.filters.Sobel(eps=torch.tensor(1e-6, requires_grad=True)),  # which calls without gradients take
    ],
)
def test_constructors_take_what_some_call_takes(make):
    make()


def test_constructors_draw_nothing_and_are_silent():
    state = torch.get_rng_state()
    with warnings.catch_warnings(), torch.device("meta"):
        warnings.simplefilter("error")
        K.filters.GaussianBlur2d(3, (1.0, 1.0)), K.losses.MS_SSIMLoss(), K.geometry.Rotate(torch.zeros(1))
    assert torch.equal(torch.get_rng_state(), state)
    with pytest.raises(TypeError, match="gaussian_blur2d: expected kernel_size to be an int or 2 ints, got 'image'"):
        K.filters.GaussianBlur2d("image", (1.0, 1.0))


A = K.augmentation


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda x: A.RandomElasticTransform()(x, params={}),
            ValueError,
            "RandomElasticTransform: expected params with 'noise'",
        ),
        (
            lambda x: A.RandomMixUpV2()(x, params={"a": 1}),
            ValueError,
            "RandomMixUpV2: expected params with 'mixup_lambdas', got",
        ),
        (lambda x: A.RandomJigsaw()(x, params=[]), TypeError, "RandomJigsaw: expected params to be a dict, got list"),
        (
            lambda x: A.RandomTransplantation()(x, x[:, 0], params={"selection": x}),
            ValueError,
            "expected params with '",
        ),
        (
            lambda x: A.ImageSequential(A.RandomHue())(x, params=[1]),
            TypeError,
            "expected params to be the _params of a call",
        ),
        (
            lambda x: A.PatchSequential(A.RandomHue(), grid_size=(1, 1))(x, params={}),
            TypeError,
            "to be the _params of a call",
        ),
        (
            lambda x: A.RandomCutMixV2()(x, data_keys=["mask"]),
            ValueError,
            "RandomCutMixV2: expected data_keys with 'input'",
        ),
        (lambda x: A.RandomCrop((8, 8), padding=10**30), ValueError, "RandomCrop: expected padding of less than 2"),
        (
            lambda x: A.RandomCrop((8, 8), padding=1.5),
            TypeError,
            "RandomCrop: expected padding to be one, two or four ints",
        ),
        (
            lambda x: A.RandomCrop3D((4, 4, 4), padding=-(10**30)),
            ValueError,
            "RandomCrop3D: expected padding of less than 2",
        ),
        (
            lambda x: K.feature.KeyNetDetector(keynet_conf=3),
            TypeError,
            "KeyNet: expected keynet_conf to be a dict, got int",
        ),
        (
            lambda x: K.feature.KeyNetDetector(num_features="a"),
            TypeError,
            "expected num_features to be an int, got 'a'",
        ),
        (
            lambda x: K.feature.KeyNetDetector(ori_module=3),
            TypeError,
            "expected ori_module to be a module or function, got 3",
        ),
        (
            lambda x: K.feature.KeyNet(False, {"num_filters": -8}),
            ValueError,
            "KeyNet: expected num_filters to be an int of at",
        ),
    ],
)
def test_what_the_sweeps_do_not_replace_is_named(call, error, message):
    """Parameters of replays, paddings of crops, data keys of mixes, and detectors, before they download weights."""
    with pytest.raises(error, match=message):
        call(torch.rand(2, 3, 16, 20))


@pytest.mark.parametrize("name", ["RandomMixUpV2", "RandomCutMixV2"])
def test_labels_at_probability_0_are_as_those_of_samples_that_were_not_chosen(name):
    x, labels = torch.rand(2, 3, 8, 8), torch.tensor([3, 5])
    options = {"data_keys": ["input", "class"]}
    image, mixed = getattr(K.augmentation, name)(p=0.0, **options)(x, labels)
    expected = getattr(K.augmentation, name)(p=1e-9, **options)(x, labels)[1]
    assert torch.equal(image, x) and mixed.shape == expected.shape
    assert torch.equal(mixed[..., 0], expected[..., 0]) and not mixed[..., 2].any()


def test_rain_without_drops_is_the_image():
    x = torch.rand(1, 3, 16, 16)
    assert torch.equal(K.augmentation.RandomRain((0, 0), (3, 5), (-2, 2), p=1.0)(x), x)


def test_a_switch_takes_what_is_true_or_false():
    x = torch.rand(3, 8, 8)
    for value in (1, np.bool_(True), torch.tensor(True)):
        assert K.augmentation.RandomHorizontalFlip(keepdim=value)(x).shape == x.shape
    assert K.augmentation.RandomHorizontalFlip(keepdim=None)(x).shape == (1, 3, 8, 8)
    with pytest.raises(TypeError, match="RandomHorizontalFlip: expected keepdim to be a bool, got str"):
        K.augmentation.RandomHorizontalFlip(keepdim="no")


def test_a_mask_of_inliers_is_a_weight():
    points, moved, inliers = torch.rand(2, 9, 2), torch.rand(2, 9, 2), torch.rand(2, 9) > 0.2
    G = K.geometry
    for fit in (G.find_homography_dlt, G.find_homography_dlt_iterated, G.find_fundamental, G.find_affine):
        assert torch.equal(fit(points, moved, inliers), fit(points, moved, inliers.float()))


@pytest.mark.parametrize("dtype", [torch.uint16, torch.uint32])
def test_unsigned_integers(dtype):
    """torch neither flips, compares nor subtracts them."""
    x = (torch.rand(1, 2, 5, 6) * 60000).to(dtype)
    same = [K.geometry.hflip, K.geometry.vflip, K.geometry.rot180, lambda x: K.enhance.invert(x, 65535)]
    for function in (*same, lambda x: K.filters.otsu_threshold(x)[0], lambda x: K.filters.otsu_threshold(x)[1]):
        actual = function(x)
        assert actual.dtype == dtype and torch.equal(actual.long(), function(x.long()))


# --- numbers ----------------------------------------------------------------------------------------------------------


def scalars_like(value: Any) -> list[Any]:
    """A number, or a tuple or list of them, as NumPy and torch have it."""
    if type(value) is int:
        return [np.int64(value), np.int32(value), torch.tensor(value)]
    if type(value) is float:
        return [np.float32(value), np.float64(value), torch.tensor(value)]
    if isinstance(value, (tuple, list)) and value and all(type(v) in (int, float) for v in value):
        kinds = zip(*map(scalars_like, value))
        return [type(value)(kind) for kind in kinds if type(value) in (tuple, list)]
    return []


# Numbers that are data, not parameters of an operation.
NOT_PARAMETERS = {
    "dataclass_to_dict",
    "ImageSize",
    "batched_forward",
    "PatchSequential",  # has as many children as cells
    "ResizeGenerator.forward",  # the shape of images
    "UniformDistribution",  # torch's
}


def numeric_arguments(home: str) -> Iterator[tuple[Call, str | int, Any]]:
    """The arguments of examples that are numbers, and the defaults that are."""
    for calls in example_calls(home).values():
        seen = set()
        for call in calls[:4]:
            if call.name in NOT_PARAMETERS | WRITERS:
                continue
            for key, value in {**call.arguments(), **call.defaults()}.items():
                if scalars_like(value) and (call.name, key) not in seen:
                    seen.add((call.name, key))
                    yield call, key, value


@homes
def test_scalars_of_numpy_and_torch_are_numbers(home):
    def result(call: Call, key: str | int, x: Any) -> Any:
        torch.manual_seed(0)
        return call.replaced(key, x)

    for call, key, value in numeric_arguments(home):
        expected = result(call, key, value)
        for x in scalars_like(value):
            actual = result(call, key, x)
            if isinstance(expected, Tensor):
                said = f"{call.name}, {key}: {x!r}"
                assert actual.dtype == expected.dtype and actual.shape == expected.shape, said
                torch.testing.assert_close(
                    actual, expected, rtol=1e-5, atol=1e-5, equal_nan=True, msg=lambda m, said=said: f"{said}: {m}"
                )


def test_a_number_that_requires_a_gradient_is_refused():
    eps = torch.tensor(1e-6, requires_grad=True)
    with pytest.raises(TypeError, match=r"sobel: expected eps to be a number, got a Tensor that requires a gradient"):
        K.filters.sobel(torch.rand(1, 1, 4, 4), eps=eps)
    with torch.no_grad():
        K.filters.sobel(torch.rand(1, 1, 4, 4), eps=eps)


def test_parameters_without_axes_get_gradients(device):
    x = torch.rand(1, 3, 6, 6, device=device)
    for call in (
        lambda p: K.filters.gaussian_blur2d(x, 3, p),
        lambda p: K.filters.bilateral_blur(x, 3, p, (1.0, 1.0)),
        lambda p: K.filters.guided_blur(x, x, 3, p),
        lambda p: K.enhance.adjust_gamma(x, p),
        lambda p: K.geometry.intrinsics_like(p, x),
        lambda p: K.color.rgb_to_rgba(x, p),
    ):
        p = torch.tensor(0.5, requires_grad=True)  # on the CPU, whatever the device of the images
        call(p).sum().backward()
        assert p.grad is not None and p.grad.shape == () and p.grad.isfinite()


# --- devices ----------------------------------------------------------------------------------------------------------

# The first argument of functions on images, and what among the others is data.
IMAGES = {"image", "input", "tensor", "src", "patch_src", "data", "depth", "image_src", "input_tensor", "imgs", "seed"}
IMAGES |= {"source", "views", "disparity", "inp", "img"}
DATA = {"target", "img2", "guidance", "imageuv", "inputuv", "template", "src2", "mask", "noise", "map_x", "map_y"}
DATA |= {"depth_dst", "patch_dst", "xyz_grid", "depth", "image"}
DATA |= {"corners", "kernel_centers", "kernel_weights", "affine_weights", "pixel_coords", "dst", "laf", "lafs"}
# Functions that read values on the host, which "meta" has not; draw_* and boxes of crops decide sizes.
READ = {"draw_line", "draw_point2d", "draw_rectangle", "draw_convex_polygon", "crop_by_boxes", "crop_by_boxes3d"}
READ |= {"crop_by_indices"}
READ |= {"linear_transform"}  # uses torch.autocast, which has no answer for meta
READ |= {"MaskDropout.forward"}  # numbers the regions of masks


def tensor_parameters(home: str) -> Iterator[tuple[Call, str]]:
    """The tensors besides the first one in examples of functions on images."""
    for calls in example_calls(home).values():
        seen = set()
        for call in calls:
            args = call.by_name()
            names = [name for name, value in args.items() if isinstance(value, Tensor)]
            if not names or inspect.isclass(call.function) or names[0] not in IMAGES or args[names[0]].dim() < 3:
                continue
            for name in names[1:]:
                if (call.name, name) not in seen:
                    seen.add((call.name, name))
                    yield call, name


@pytest.fixture
def elsewhere(device: torch.device) -> torch.device:
    """A device that is not the CPU."""
    return device if device.type != "cpu" else torch.device("meta")


@homes
def test_parameters_follow_the_images_and_data_does_not(home, elsewhere):
    for call, name in tensor_parameters(home):
        function = call.function.to(elsewhere) if isinstance(call.function, nn.Module) else call.function
        args = {
            key: value.to(elsewhere) if isinstance(value, Tensor) and key != name else value
            for key, value in call.by_name().items()
        }
        if name in DATA:
            with pytest.raises(DeviceError, match=r"expected all tensors on one device, got .*\bon cpu\b"):
                function(**args)
                pytest.fail(f"{call.name} accepts {name} on another device")
        elif elsewhere.type == "cuda" or call.name not in READ:
            result = function(**args)
            first = next(iter(result if isinstance(result, tuple) else (result,)))
            assert first.device.type == elsewhere.type, f"{call.name}, {name}"


x = torch.rand(2, 3, 6, 7)
FOLLOWING = {
    "adjust_brightness": lambda x, p: K.enhance.adjust_brightness(x, p),
    "adjust_brightness_accumulative": lambda x, p: K.enhance.adjust_brightness_accumulative(x, p),
    "adjust_contrast": lambda x, p: K.enhance.adjust_contrast(x, p),
    "adjust_contrast_with_mean_subtraction": lambda x, p: K.enhance.adjust_contrast_with_mean_subtraction(x, p),
    "adjust_gamma": lambda x, p: K.enhance.adjust_gamma(x, p, p),
    "adjust_hue": lambda x, p: K.enhance.adjust_hue(x, p),
    "adjust_log": lambda x, p: K.enhance.adjust_log(x, p),
    "adjust_saturation": lambda x, p: K.enhance.adjust_saturation(x, p),
    "adjust_sigmoid": lambda x, p: K.enhance.adjust_sigmoid(x, p, p),
    "posterize": lambda x, p: K.enhance.posterize(x, (8 * p).round()),
    "sharpness": lambda x, p: K.enhance.sharpness(x, p),
    "solarize": lambda x, p: K.enhance.solarize(x, p, p),
    "shift_rgb": lambda x, p: K.enhance.shift_rgb(x, p, p, p),
    "add_weighted": lambda x, p: K.enhance.add_weighted(x, p[:1], x, p[:1], p[:1]),
    "invert": lambda x, p: K.enhance.invert(x, p[0]),
    "normalize": lambda x, p: K.enhance.normalize(x, p[:1], p[:1]),
    "denormalize": lambda x, p: K.enhance.denormalize(x, p[:1], p[:1]),
    "Normalize": lambda x, p: K.enhance.Normalize((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))(x),
    "ColorProgram": lambda x, p: K.enhance.ColorProgram(("brightness", p))(x),
    "gaussian_blur2d": lambda x, p: K.filters.gaussian_blur2d(x, 3, torch.stack([p, p], 1)),
    "bilateral_blur": lambda x, p: K.filters.bilateral_blur(x, 3, p, torch.stack([p, p], 1)),
    "unsharp_mask": lambda x, p: K.filters.unsharp_mask(x, 3, torch.stack([p, p], 1)),
    "guided_blur": lambda x, p: K.filters.guided_blur(x, x, 3, p),
    "motion_blur": lambda x, p: K.filters.motion_blur(x, 3, p, p),
    "in_range": lambda x, p: K.filters.in_range(x, torch.zeros(3), torch.ones(3)),
    "rgba_to_rgb": lambda x, p: K.color.rgba_to_rgb(torch.cat([x, x[:, :1]], 1), torch.zeros(3, 1, 1)),
    "apply_colormap": lambda x, p: K.color.apply_colormap(x[:, :1], K.color.ColorMap("jet")),
    "focal_loss": lambda x, p: K.losses.focal_loss(x, x[:, 0].long(), 0.5, weight=torch.ones(3)),
    "dice_loss": lambda x, p: K.losses.dice_loss(x, x[:, 0].long(), weight=torch.ones(3)),
    "binary_focal_loss_with_logits": lambda x, p: K.losses.binary_focal_loss_with_logits(
        x, x, 0.5, pos_weight=torch.ones(3), weight=torch.ones(3)
    ),
    "warp_perspective": lambda x, p: K.geometry.warp_perspective(
        x, torch.eye(3)[None], (4, 4), padding_mode="fill", fill_value=torch.zeros(3)
    ),
    "rotate": lambda x, p: K.geometry.rotate(x, p, torch.ones(1, 2)),
    "elastic_transform2d": lambda x, p: K.geometry.elastic_transform2d(
        x, torch.zeros_like(x[:, :2]), (3, 3), sigma=p, alpha=p
    ),
    "dilation": lambda x, p: K.morphology.dilation(x, torch.ones(3, 3), torch.ones(3, 3)),
}


@pytest.mark.parametrize("name", FOLLOWING)
def test_parameters_in_cpu_memory_follow_the_images(name, elsewhere):
    p = torch.tensor([0.5, 0.75])
    actual = FOLLOWING[name](x.to(elsewhere), p)
    expected = FOLLOWING[name](x, p)
    assert actual.device.type == elsewhere.type and actual.shape == expected.shape and actual.dtype == expected.dtype
    if elsewhere.type == "cuda":
        torch.testing.assert_close(actual.cpu(), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    "name", [name for name in FOLLOWING if name not in ("Normalize", "apply_colormap", "in_range")]
)
def test_parameters_follow_without_waiting(name, device):
    """The copy of a parameter to the GPU does not wait for the GPU."""
    if device.type != "cuda":
        pytest.skip("needs a GPU")
    p, images = torch.tensor([0.5, 0.75]), x.to(device)
    FOLLOWING[name](images, p)
    torch.cuda.synchronize()
    with torch.cuda.device(device):
        torch.cuda.set_sync_debug_mode("error")
        try:
            FOLLOWING[name](images, p)
        finally:
            torch.cuda.set_sync_debug_mode("default")


def test_a_parameter_on_another_gpu_is_refused():
    image, elsewhere = torch.rand(1, 3, 4, 4), torch.full((1,), 0.5, device="meta")
    with pytest.raises(DeviceError, match="adjust_brightness: expected all tensors on one device"):
        K.enhance.adjust_brightness(image, elsewhere)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("layout", [torch.strided, torch.jagged], ids=str)
def test_nested_tensors_are_refused(layout):
    nested = torch.nested.nested_tensor([torch.rand(3, 4, 5), torch.rand(3, 4, 5)], layout=layout)
    for call in (K.filters.sobel, K.color.rgb_to_hsv, K.geometry.quaternion_to_rotation_matrix):
        with pytest.raises(TypeError, match="to be dense, got a nested tensor"):
            call(nested)
