"""Bad input of every kind to every public function of kvision.filters.

A call either gives the shapes that its docstring states or raises a BaseError that reads `function: expected ..., got
...`. It never reaches an error from inside torch, never crashes, and never takes more time or memory than a small
image deserves.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import re
import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import filters
from benchmarks.sample_calls.tensors import VOLUME as VOLUME_AXES
from kvision.core.exceptions import BaseError

pytestmark = pytest.mark.interface

# ----------------------------------------------------------------------------------------------------- kinds of values


@dataclass(frozen=True)
class Kind:
    """What may be passed for a parameter: values that work, values that are refused, and values that do either.

    An `odd` value works in one function and not in the other, or depends on the other arguments: a kernel larger than
    the image, a batch of its own, another device; or it works and the result is of no use, as that of a NaN tensor.
    """

    good: tuple[Any, ...]
    refused: tuple[Any, ...]
    odd: tuple[Any, ...] = ()

    def but(self, good: tuple[Any, ...] = (), refused: tuple[Any, ...] = (), odd: tuple[Any, ...] = ()) -> Kind:
        """This kind with these values judged otherwise, or added."""
        judged = {repr(v) for v in (*good, *refused, *odd)}

        def rest(values: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(v for v in values if repr(v) not in judged)

        return Kind((*good, *rest(self.good)), (*refused, *rest(self.refused)), (*odd, *rest(self.odd)))


NAN, INF = math.nan, math.inf
HUGE = (2**31, 2**40, 10**30)  # more pixels than an axis can have: to be refused, not tried
LARGEST = (1e300, 10**400)  # more than a float32 or even a float64 can hold


def filled(*shape: int) -> Tensor:
    """Numbers in [0, 1), the same ones in every run."""
    return (torch.arange(math.prod(shape)) * 37 % 101 / 101).reshape(shape)


def spoiled(x: Tensor, value: float) -> Tensor:
    x = x.clone()
    x.flatten()[x.numel() // 2] = value
    return x


def meta(*shape: int) -> Tensor:
    return torch.empty(shape, device="meta")


def complex_(*shape: int) -> Tensor:
    return filled(*shape).to(torch.complex64)


NO_TENSORS = (None, "image", 3, 0.5, [[1.0]], np.zeros((2, 3, 6, 7), np.float32), torch.float32, object())
NO_NUMBERS = (None, "3", [], {}, 1j, np.zeros(2), torch.float32, object())
DTYPES = (torch.float16, torch.bfloat16, torch.float64, torch.uint8, torch.int16, torch.int64, torch.bool)


def tensors(*shape: int) -> Kind:
    """Tensors of this shape in any type and with any values; no other ranks."""
    x = filled(*shape)
    ranks = (filled(*(1,) * rank) for rank in range(7) if rank != len(shape))
    layouts = [x.to_sparse(), x.to_mkldnn()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch gives quantized tensors up
        layouts.append(torch.quantize_per_tensor(x, 0.1, 0, torch.quint8))
    return Kind(
        good=(x,),
        refused=(*NO_TENSORS, *ranks, *layouts, complex_(*shape), x.to(torch.float8_e4m3fn)),
        odd=(
            *((3 * x).to(dtype) for dtype in DTYPES),
            *(spoiled(x, value) for value in (NAN, INF, -INF, 3e38, -1.0)),
            meta(*shape),
        ),
    )


def images(b: int, c: int, *size: int) -> Kind:
    """Images, also none at all, without channels, very small ones; no images without pixels."""
    without_pixels = (filled(b, c, 0, *size[1:]), filled(b, c, *size[:-1], 0), filled(0, 0, *(0 for _ in size)))
    others = (filled(*bc, *size) for bc in ((0, c), (b, 0), (b, 2), (1, c)))
    return tensors(b, c, *size).but(
        refused=without_pixels,
        odd=(*others, filled(b, c, *(1 for _ in size)), filled(b, c, *size).transpose(-1, -2)),
    )


IMAGE = images(2, 3, 6, 7)
VOLUME = images(2, 3, 4, 5, 6)
WITHOUT_PIXELS = (filled(2, 3, 0, 7), filled(2, 3, 6, 0), filled(0, 0, 0, 0))
ANY_RANK = (filled(6, 7), filled(3, 6, 7), filled(6), torch.tensor(0.5), filled(1, 2, 1, 6, 7))


def kernels(b: int, *size: int) -> Kind:
    """Kernels of one sample or as many as IMAGE has; no kernels without taps."""
    sizes = ((0, *size), (2, *size), (b, *(2 for _ in size)), (b, *(9 for _ in size)), (b, *size[:-1], 501))
    return tensors(b, *size).but(
        refused=(filled(b, *(0 for _ in size)), filled(3, *size), meta(b, *size)),
        odd=(*(filled(*s) for s in sizes), torch.zeros(b, *size)),
    )


KERNEL, ROW, KERNEL_3D = kernels(1, 3, 3), kernels(1, 3), kernels(1, 3, 1, 3)

NO_INT = (None, "3", 3.0, True, 2 + 0j, NAN, torch.tensor(3.0), torch.tensor([3]), torch.float32)
NO_SIZE = (*NO_INT, "33", [], {3: 3}, (3.0, 3.0), (True, 3), (None, 3), (3,) * 5)
LENGTH = Kind((3, 5), (*NO_SIZE, 0, -1, -3, -(2**40), *HUGE), (1, 2, 4, 501))
ODD_LENGTH = LENGTH.but(refused=(2, 4))
SIZE = LENGTH.but(
    good=((3, 3), (1, 5), [3, 1], torch.Size((3, 3))),
    refused=((3, 0), (3, 2**15), (1, 32769), (3,), (3, 3, 3)),
)
SIZE = SIZE.but(odd=((4, 3), 101, (1, 501)))
ODD_SIZE = SIZE.but(refused=(2, 4, (4, 3)))
WINDOW = Kind(ODD_SIZE.good, ODD_SIZE.refused, (1, 31, (1, 501)))  # for what costs as much as there are taps
STEP = LENGTH.but(good=(1, 2))

FLAG = Kind((False, True), (None, "yes", 2, 0.5, [], torch.tensor([True, False])))
UNREAD = Kind((False, True), (), (None, "yes", torch.zeros(3)))  # taken for compatibility


def names(*known: str) -> Kind:
    no_names = ("", "mirror", known[0].upper(), f"{known[0]} ", None, 3, True, b"same", ["same"], (), {}, np.zeros(2))
    return Kind(known, (*no_names, torch.zeros(2)))


BORDER = names("reflect", "constant", "replicate", "circular")
MODE_3D = names("nearest", "bilinear")
MODE = MODE_3D.but(good=("nearest", "bilinear", "bicubic"))
DERIVATIVE = names("sobel", "diff")
# The median of an even window is the lower one of its two middle values.
MEDIAN_WINDOW = WINDOW.but(good=(2, 4, (4, 3)))
DERIVATIVE_3D = names("diff").but(odd=("sobel",))  # NotImplementedError, as documented
ORDER = Kind((1, 2), (0, 3, -1, "1", None, [1], 1.0, torch.zeros(2)), (True,))

EPS = Kind((1e-6, 0, 2), (*NO_NUMBERS, NAN, -1.0, -INF, *LARGEST), (True, 1e-300, INF))
ABOVE_0 = Kind((0.5, 2), (*NO_NUMBERS, NAN, 0, 0.0, -1.0, -INF, *LARGEST), (True, 1e-300, INF))


def sigmas(count: int, zero: bool = False) -> Kind:
    """Standard deviations along `count` axes: numbers, or a tensor with a row for every image."""
    ranks = (filled(*shape) for shape in ((count + 1,), (2, count + 1), (1, count, 1), (2, 0)))
    tuples = ((1.0,) * (count + 1), *((value,) * count for value in (NAN, "1", None, -1.0, 10**400)))
    numbers = (-1.0, -INF, NAN, *LARGEST, *(() if zero else (0.0,)))
    return Kind(
        good=(1.5, (1.0,) * count, [0.5] * count, filled(1, count) + 0.5, filled(2, count) + 0.5),
        refused=(*NO_NUMBERS, *numbers, *tuples, *ranks, complex_(2, count)),
        odd=(
            *(filled(3, count), filled(0, count), filled(1, count).double(), filled(1, count).half(), meta(2, count)),
            *(torch.tensor(1.5), torch.tensor(-1.0), meta()),
            *(torch.full((2, count), value) for value in (0.0, -1.0, NAN, INF, 7)),
            *(0.0, 1e-300, 1e-30, INF, True),
        ),
    )


PER_IMAGE = Kind(  # one number for all images or for each
    good=(0.5, torch.tensor(0.5), filled(1) + 0.5, filled(2) + 0.5),
    refused=(*NO_NUMBERS, (0.1,), -1.0, NAN, *LARGEST, *map(filled, (0, 3)), filled(2, 1), meta(2)),
    odd=(torch.tensor([0.0, INF]), torch.tensor([NAN, -1]), 0.0, INF, 1e-300, True),
)
ANGLE = Kind(
    good=(30.0, -400, filled(2) * 90, filled(1), torch.tensor(45.0)),
    refused=(*NO_NUMBERS, (1.0, 2.0), NAN, INF, *LARGEST, filled(2, 2), filled(2, 1, 1), complex_(2)),
    odd=(filled(3), filled(0), torch.tensor([NAN, INF]), torch.tensor([30, 60]), meta(2), -1e6, True),
)
ANGLES = Kind(
    good=((10.0, 20.0, 30.0), [0, 0, 90.0], filled(2, 3) * 90, filled(3)),
    refused=(*NO_NUMBERS, (1.0, 2.0), (NAN, 0, 0), (1e300, 0, 0), NAN, *map(torch.ones, ((2, 2), (2, 1, 3)))),
    odd=(torch.tensor(30.0), filled(3, 3), filled(0, 3), torch.full((2, 3), NAN), meta(2, 3), 30.0),
)
MEAN = Kind(
    good=(None, 1.0, -3, filled(2, 1)),
    refused=(*NO_NUMBERS[1:], NAN, *LARGEST, filled(2), filled(2, 2), complex_(2, 1)),
    odd=(filled(3, 1), filled(0, 1), meta(2, 1), INF),
)
LIMITS = Kind(
    good=((0.2, 0.2, 0.2), (-INF, 0, 1)),
    refused=(None, 0.2, "low", (), (0.2,), ("a", "b", "c"), (None,) * 3, (1j,) * 3, complex_(3)),
    odd=(
        *(filled(*shape) for shape in ((), (3,), (3, 1, 1), (2, 3, 6, 7), (5,), (0,), (1, 2, 3, 6, 7))),
        *(torch.tensor([0, 0, 0]), meta(3), [0.2] * 3, (NAN,) * 3, (1e300,) * 3),
    ),
)

DEVICE = Kind((None,), (), (torch.device("meta"), "meta"))  # others are refused by torch, which knows its devices
FLOATING = Kind(
    good=(None, torch.float32, torch.float64, torch.float16, torch.bfloat16),
    refused=("float32", float, np.float32, 3, torch.int32, torch.bool, torch.complex64),
)
REAL = FLOATING.but(odd=(torch.int64, torch.int32, torch.int8, torch.bool))

# ------------------------------------------------------------------------------------------------ shapes as documented

Shapes = list[tuple[int, ...]]


def same(a: Any) -> Shapes:
    return [tuple(a.input.shape)]


def within(a: Any, *taps: int) -> Shapes:
    """The image, less what a kernel of these sizes needs around a pixel where there is no border."""
    b, c, *size = a.input.shape
    return [(b, c, *(n - k + 1 if a.padding == "valid" else n for n, k in zip(size, taps)))]


def pooled(a: Any, window: int = 1) -> Shapes:
    b, c, *size = a.input.shape
    return [(b, c, *(math.ceil((n - window + 1) / a.stride) for n in size))]


def derived(a: Any, *counts: int) -> Shapes:
    b, c, *size = a.input.shape
    return [(b, c, counts[a.order - 1], *size)]


def along(axes: int, size: Any) -> tuple[int, ...]:
    """The sizes that an int, or an int for each axis, stands for."""
    return (size,) * axes if isinstance(size, int) else tuple(size)


def rows(*parameters: Any) -> int:
    """The batch that numbers and tensors (B, ...) make together."""
    batches = {p.shape[0] for p in parameters if isinstance(p, Tensor) and p.dim()} - {1}
    return max(batches, default=1)


def masked(a: Any) -> Shapes:
    *batch, h, w = a.input.shape
    return [(*batch[:-1], *(1 for _ in batch[-1:]), h, w) if a.return_mask else tuple(a.input.shape)]


def rows_3d(a: Any) -> int:
    one = isinstance(a.angle, Tensor) and a.angle.dim() == 1  # (3,) is one row
    return rows(None if one else a.angle, a.direction)


# ------------------------------------------------------------------------------------------------------- the functions


# Parameters that are alike in all functions that have them, but for those that FUNCTIONS names.
SIGMA = sigmas(2).but(refused=(meta(2, 2), filled(3, 2)))
KINDS = {
    **dict(input=IMAGE, guidance=IMAGE, kernel_x=ROW, kernel_y=ROW, border_type=BORDER, padding=names("same", "valid")),
    **dict(normalized=FLAG, behaviour=names("corr", "conv"), kernel_size=ODD_SIZE, sigma=SIGMA, sigma_space=SIGMA),
    **dict(
        sigma_color=PER_IMAGE, color_distance_type=names("l1", "l2"), eps=EPS, epsilon=EPS, order=ORDER, stride=STEP
    ),
    **dict(
        subsample=STEP, angle=ANGLE, direction=ANGLE, hysteresis=FLAG, return_mask=FLAG, slow_and_differentiable=FLAG
    ),
    **dict(
        separable=UNREAD, force_even=FLAG, window_size=LENGTH, device=DEVICE, dtype=REAL, lower=LIMITS, upper=LIMITS
    ),
}


@dataclass(frozen=True)
class Function:
    shapes: Callable[[Any], Shapes]  # of the results, from the arguments
    kinds: dict[str, Kind]  # parameter by parameter


CALLS = {call.name.partition(".")[2]: call for call in filters.CALLS}
FUNCTIONS: dict[str, Function] = {}


def functions(of: str, shapes: Callable[[Any], Shapes], **kinds: Kind) -> None:
    """Functions with these results, and the kinds of their parameters that are not those of KINDS."""
    for name in of.split():
        axes = CALLS[name].axes.get("input")
        by_name = KINDS | ({"input": VOLUME} if axes is VOLUME_AXES else {}) | kinds
        parameters = inspect.signature(getattr(K.filters, name)).parameters
        FUNCTIONS[name] = Function(shapes, {parameter: by_name[parameter] for parameter in parameters})


def filtered(a: Any) -> Shapes:
    return within(a, *a.kernel.shape[1:])


def kernel_1d(a: Any) -> Shapes:
    return [(a.kernel_size,)]


def kernel_2d(a: Any) -> Shapes:
    return [along(2, a.kernel_size)]


WITHOUT_ONE = ODD_LENGTH.but(refused=(1,))
MOTION = dict(kernel_size=WITHOUT_ONE, mode=MODE)
MOTION_3D = dict(kernel_size=Kind((3, 5), (*ODD_LENGTH.refused, 1), (21,)), angle=ANGLES, mode=MODE_3D)
SIGMA_1D = dict(sigma=sigmas(1, zero=True), dtype=FLOATING)

functions("filter2d correlate2d convolve2d fft_conv", filtered, kernel=KERNEL)
functions("filter2d_separable", lambda a: within(a, a.kernel_y.shape[1], a.kernel_x.shape[1]))
functions("filter3d correlate3d convolve3d", same, kernel=KERNEL_3D)
functions("gaussian_blur2d unsharp_mask sobel", same)
functions("box_blur", same, kernel_size=SIZE)
functions("median_blur", same, kernel_size=MEDIAN_WINDOW)
functions("laplacian", same, kernel_size=ODD_SIZE.but(refused=(1, (1, 1))))
functions("spatial_gradient", lambda a: derived(a, 2, 3), mode=DERIVATIVE)
functions("spatial_gradient3d", lambda a: derived(a, 3, 6), mode=DERIVATIVE_3D)
functions(
    "canny",
    lambda a: 2 * [(a.input.shape[0], 1, *a.input.shape[2:])],
    low_threshold=ABOVE_0.but(good=(0.1,), refused=(5, (0.1,)), odd=(2, INF)),
    high_threshold=ABOVE_0.but(refused=(0.001, (0.2,), 1e-300)),
)
functions("bilateral_blur joint_bilateral_blur", same, kernel_size=WINDOW)
functions("guided_blur", same, kernel_size=SIZE, eps=PER_IMAGE)
functions("motion_blur", same, **MOTION)
functions("motion_blur3d", same, **MOTION_3D)
functions("blur_pool2d", pooled, kernel_size=SIZE)
functions(
    "max_blur_pool2d",
    lambda a: pooled(a, a.max_pool_size),
    kernel_size=SIZE,
    max_pool_size=STEP.but(refused=(7, 501)),
    ceil_mode=UNREAD.but(good=(None,), odd=(True,)),
)
functions(
    "edge_aware_blur_pool2d",
    same,
    kernel_size=SIZE,
    edge_threshold=ABOVE_0.but(good=(1.25,), refused=(0.5, 1), odd=(2,)),
    edge_dilation_kernel_size=ODD_LENGTH,
)
functions("in_range", masked, input=IMAGE.but(odd=(*ANY_RANK, *WITHOUT_PIXELS)))
functions(
    "otsu_threshold",
    lambda a: [tuple(a.x.shape), (math.prod(a.x.shape[:-2]),)],
    x=IMAGE.but(odd=(*ANY_RANK, *(filled(*(1,) * rank) for rank in range(6)), (3 * filled(2, 3, 6, 7)).bool())),
    nbins=LENGTH.but(good=(256, 2), refused=(1,)),
)
functions("gaussian", lambda a: [(rows(a.sigma, a.mean), a.window_size)], mean=MEAN, **SIGMA_1D)
for axes, size in (
    (1, LENGTH.but(odd=((3,),))),
    (2, SIZE),
    (3, Kind((3, (3, 1, 5)), (*LENGTH.refused, (3, 3)), (1, 2, 21))),
):
    functions(
        f"get_gaussian_kernel{axes}d",
        lambda a, axes=axes: [(rows(a.sigma), *along(axes, a.kernel_size))],
        kernel_size=size,
        sigma=sigmas(axes, zero=True),
        dtype=FLOATING,
    )
functions(
    "get_gaussian_discrete_kernel1d",
    lambda a: [(rows(a.sigma), a.kernel_size)],
    kernel_size=ODD_LENGTH,
    force_even=UNREAD,
    **SIGMA_1D,
)
functions(
    "get_gaussian_erf_kernel1d",
    lambda a: [(rows(a.sigma), a.kernel_size)],
    kernel_size=LENGTH,
    sigma=sigmas(1),
    dtype=FLOATING,
)
functions("get_laplacian_kernel1d", kernel_1d, kernel_size=WITHOUT_ONE)
functions("get_laplacian_kernel2d", kernel_2d, kernel_size=ODD_SIZE.but(refused=(1, (1, 1))))
functions("laplacian_1d", lambda a: [(a.window_size,)])
functions("get_box_kernel1d", lambda a: [(1, a.kernel_size)], kernel_size=LENGTH, dtype=FLOATING)
functions("get_box_kernel2d", lambda a: [(1, *along(2, a.kernel_size))], kernel_size=SIZE, dtype=FLOATING)
functions(
    "get_binary_kernel2d",
    lambda a: [(math.prod(along(2, a.window_size)), 1, *along(2, a.window_size))],
    window_size=Kind(SIZE.good, SIZE.refused, (1, 2, 31, (1, 101))),  # as much memory as taps squared
)
functions("get_hanning_kernel1d", kernel_1d, kernel_size=LENGTH.but(refused=(1, 2)), dtype=FLOATING)
functions(
    "get_hanning_kernel2d",
    kernel_2d,
    kernel_size=SIZE.but(good=((3, 3), (4, 5)), refused=(1, 2, (1, 5), [3, 1], (1, 501))),
    dtype=FLOATING,
)
functions("get_sobel_kernel2d get_diff_kernel2d", lambda a: [(2, 3, 3)])
functions(
    "get_spatial_gradient_kernel2d",
    lambda a: [(2, 3, 3) if a.order == 1 else (3, 5, 5) if a.mode == "sobel" else (3, 3, 3)],
    mode=DERIVATIVE,
)
functions(
    "get_spatial_gradient_kernel3d", lambda a: [((3, 6)[a.order - 1], 1, 3, 3, 3)], mode=DERIVATIVE_3D, dtype=FLOATING
)
functions("get_motion_kernel2d", lambda a: [(rows(a.angle, a.direction), *along(2, a.kernel_size))], **MOTION)
functions("get_motion_kernel3d", lambda a: [(rows_3d(a), *along(3, a.kernel_size))], **MOTION_3D)


def call(name: str, arguments: dict[str, Any], device: torch.device) -> BaseError | None:
    """Makes the call and checks what comes of it, results or a refusal; gives the refusal."""
    arguments = {parameter: on(device, value) for parameter, value in arguments.items()}
    try:
        with frugal(), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            output = getattr(K.filters, name)(**arguments)
    except NotImplementedError as error:
        assert arguments["mode"] == "sobel" and str(error).startswith(f"{name}: mode 'sobel' is not implemented in 3-D")
        return BaseError(str(error))
    except BaseError as error:
        assert re.match(rf"{name}: (.* )?(expected|must be) .*[,;] got ", str(error), re.DOTALL), str(error)
        return error
    results = output if isinstance(output, tuple) else (output,)
    assert [tuple(y.shape) for y in results] == FUNCTIONS[name].shapes(SimpleNamespace(**arguments))
    return None


def on(device: torch.device, value: Any) -> Any:
    movable = isinstance(value, Tensor) and value.layout is torch.strided and not (value.is_quantized or value.is_meta)
    return value.to(device) if movable else value


@contextlib.contextmanager
def frugal() -> Iterator[None]:
    """Makes it an error to take more than 2 GB or 20 seconds of CPU time, which other processes do not change."""

    def late(*_: Any) -> None:
        raise TimeoutError("20 s for a small image")

    in_use = int(re.search(r"VmSize:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024
    limits = resource.getrlimit(resource.RLIMIT_AS)
    handler = signal.signal(signal.SIGPROF, late)
    if not torch.cuda.is_available():  # which reserves addresses by the terabyte
        resource.setrlimit(resource.RLIMIT_AS, (in_use + 2 * 2**30, limits[1]))
    signal.setitimer(signal.ITIMER_PROF, 20)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, handler)
        resource.setrlimit(resource.RLIMIT_AS, limits)


def working(name: str) -> dict[str, Any]:
    return {parameter: kind.good[0] for parameter, kind in FUNCTIONS[name].kinds.items()}


def shown(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{value.dtype} {tuple(value.shape)} {value.device} {value.layout}"
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}"
    return repr(value)


def test_every_function_is_called():
    assert set(FUNCTIONS) == {name for name, f in vars(K.filters).items() if inspect.isfunction(f)}


PARAMETERS = [(name, parameter) for name, f in FUNCTIONS.items() for parameter in f.kinds]


@pytest.mark.parametrize("name, parameter", PARAMETERS)
def test_one_bad_argument(name, parameter, device):
    kind, wrong = FUNCTIONS[name].kinds[parameter], []
    for expected, values in (("works", kind.good), ("is refused", kind.refused), ("either", kind.odd)):
        for value in values:
            try:
                refusal = call(name, {**working(name), parameter: value}, device)
            except Exception as error:
                wrong.append(f"{shown(value)}: {type(error).__name__}: {error}")
                continue
            if (expected == "works" and refusal) or (expected == "is refused" and not refusal):
                wrong.append(f"{shown(value)}: {refusal or 'accepted'}")
    assert not wrong, f"{name}({parameter}=...)\n" + "\n".join(wrong)


@pytest.mark.parametrize("name, parameter", [(n, p) for n, p in PARAMETERS if isinstance(working(n)[p], Tensor)])
def test_type_error_for_other_types_and_value_error_for_wrong_ranks(name, parameter, device):
    for value in (*NO_TENSORS, filled(*(1,) * 6)):
        refusal = call(name, {**working(name), parameter: value}, device)
        assert isinstance(refusal, ValueError if isinstance(value, Tensor) else TypeError), shown(value)


@pytest.mark.parametrize("name", FUNCTIONS)
@given(data=st.data())
def test_mixtures(name, data, device):
    """Good arguments, some of which are replaced by any others."""
    kinds = FUNCTIONS[name].kinds
    replaced = data.draw(st.sets(st.sampled_from(sorted(kinds)), max_size=3), label="replaced")
    arguments = {}
    for parameter, kind in kinds.items():
        values = (*kind.good, *kind.odd, *kind.refused) if parameter in replaced else kind.good
        arguments[parameter] = values[data.draw(st.integers(0, len(values) - 1), label=parameter)]
    try:
        call(name, arguments, device)
    except Exception:
        print(name, {parameter: shown(value) for parameter, value in arguments.items()})
        raise
