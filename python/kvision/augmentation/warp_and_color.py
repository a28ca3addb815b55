"""One pass over images: a warp by the matrix of a chain of transforms, and then a program of color steps.

Both read the columns of drawn parameters. The operator stands for `transform_matrix`, `warp` and a color program one after the
other, and gives what they give: what the warp samples is rounded to the type of the images. A kernel that joins them keeps it in
registers. Either part may be missing; the result may have another type and layout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision._modes import INTERPOLATION, PADDING
from kvision._ops import FastPath, match_layout, register
from kvision.augmentation import transforms
from kvision.augmentation.columns import Column, Input, Names, bind, split_inputs
from kvision.augmentation.transforms import MAX_TRANSFORMS, Transform
from kvision.color import program
from kvision.color.frames import PLAINLY, Frames, Reading, affine_of
from kvision.color.program import MAX_TENSORS
from kvision.color.steps import CONTRAST, STEPS
from kvision.core.exceptions import ValueCheckError
from kvision.enhance.posterize import SPLIT
from kvision.geometry.transform import sampling
from kvision.geometry.transform.resize_windows import resized_windows

# Arguments of the operator: images (B, C, H, W); columns (B, P) in the type that computes, or None; the fill as warps take it, or
# None; the size of the result, empty without a warp; the plan; and numbers. The plan has the dtype and the layout of the result,
# as in color programs; interpolation, padding, align_corners and antialias; and lists, of which all but the last begin with their
# length: the plan of the transforms (transforms.make_plan); the steps; the column of each of their parameters, or -1 for a number;
# and the order of the steps, a pair for each position: a step, after the column of a number that is added to it, or -1. Where the
# number is negative there is no step. Without an order all steps follow each other. The numbers are those of the transforms, then
# those of the steps.


class _Plan(NamedTuple):
    dtype: int
    layout: int
    sampling: tuple[int, int, bool]
    antialias: bool
    transforms: Sequence[int]
    steps: Sequence[int]
    columns: Sequence[int]
    order: Sequence[int]
    transform_numbers: Sequence[float]
    numbers: Sequence[float]

    @property
    def color_plan(self) -> list[int]:
        """The plan of the color program by itself."""
        return [self.dtype, self.layout, len(self.steps), *self.steps, *self.columns]

    @property
    def plan_of_steps(self) -> list[int]:
        """The plan of a pass without the warp."""
        head = [self.dtype, self.layout, 0, 0, 0, 0, 0]
        return [*head, len(self.steps), *self.steps, len(self.columns), *self.columns, *self.order]


def _parse(plan: Sequence[int], numbers: Sequence[float]) -> _Plan:
    dtype, layout, interpolation, padding, align_corners, antialias, *rest = plan
    lists = []
    for _ in range(3):
        count = rest[0]
        lists.append(rest[1 : 1 + count])
        rest = rest[1 + count :]
    chain, steps, columns = lists
    counts = list(transforms.INPUTS.values())
    at = count = 0
    while at < len(chain):
        count += counts[chain[at]]
        at += 1 + counts[chain[at]]
    sampling = (interpolation, padding, bool(align_corners))
    return _Plan(
        dtype, layout, sampling, bool(antialias), chain, steps, columns, rest, numbers[:count], numbers[count:]
    )


# --- the reference --------------------------------------------------------------------------------------------------


def _reference(
    image: Tensor,
    columns: Tensor | None,
    fill: Tensor | None,
    size: Sequence[int],
    plan: Sequence[int],
    numbers: Sequence[float],
) -> tuple[Tensor, Tensor, Tensor]:
    parts = _parse(plan, numbers)
    columns = _columns_of(image, columns)
    matrix = columns.new_empty(image.shape[0], 0, 3)
    if size:
        matrix = transforms._transform_matrix.reference(columns, parts.transforms, parts.transform_numbers)
    y, mean = _apply(image, columns, fill, matrix, size, parts)
    return y, matrix, mean


def _columns_of(image: Tensor, columns: Tensor | None) -> Tensor:
    return image.new_empty(image.shape[0], 0, dtype=compute_dtype(image)) if columns is None else columns


def _apply(
    image: Tensor, columns: Tensor, fill: Tensor | None, matrix: Tensor, size: Sequence[int], parts: _Plan
) -> tuple[Tensor, Tensor]:
    """The result by given matrices, and the means of contrast."""
    x = image
    if size and parts.antialias:
        interpolation, _, align_corners = parts.sampling
        x = resized_windows.reference(image, matrix, size, interpolation, align_corners)
    elif size:
        x = sampling.warp.reference(image, matrix, fill, None, size, *parts.sampling, True, False)
    mean = columns.new_empty(columns.shape[0], 0)
    if parts.steps or not size or parts.dtype >= 0 or parts.layout >= 0:
        tensors = [columns[:, None], *[None] * (MAX_TENSORS - 1)]
        x, means = program._program_around_mean.reference(
            x, *tensors, _order_of(parts.order, columns), parts.color_plan, parts.numbers
        )
        mean = means if CONTRAST in parts.steps else mean
    return x, mean


def _order_of(order: Sequence[int], columns: Tensor) -> Tensor | None:
    """The steps at all positions, (B, S); -1 for none."""
    if not order:
        return None
    positions = []
    for column, step in zip(order[::2], order[1::2]):
        if column < 0:
            positions.append(columns.new_full((columns.shape[0],), step))
        else:
            added = columns[:, column].detach()
            positions.append(torch.where(added >= 0, added + step, -1.0))
    return torch.stack(positions, 1).long()


def _reference_backward(
    grad: Tensor,
    image: Tensor,
    columns: Tensor | None,
    fill: Tensor | None,
    matrix: Tensor,
    mean: Tensor,
    size: Sequence[int],
    plan: Sequence[int],
    numbers: Sequence[float],
    of_image: bool,
    of_columns: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    columns = _columns_of(image, columns)
    parts = _parse(plan, numbers)._replace(dtype=program._DTYPES.index(columns.dtype))
    if size:  # from the columns again, of which it is a function for second derivatives
        matrix = transforms._transform_matrix.reference(columns, parts.transforms, parts.transform_numbers)

    def result(image: Tensor, columns: Tensor, matrix: Tensor) -> Tensor:
        return _apply(image, columns, fill, matrix, size, parts)[0]

    vjp_fn: Any = torch.func.vjp(result, image.to(columns.dtype), columns, matrix)[1]
    grad_image, grad_columns, grad_matrix = vjp_fn(grad.to(columns.dtype))
    of_matrix = of_columns and bool(size)
    grad_image = grad_image.to(image.dtype)
    return (
        _gradient_layout(grad_image, image, size) if of_image else image.new_empty(image.shape[0], 0),
        grad_columns if _has_column_gradient(parts, columns, of_columns) else columns[:, :0],
        grad_matrix if of_matrix else matrix[:, :0],
    )


def _gradient_layout(grad: Tensor, image: Tensor, size: Sequence[int]) -> Tensor:
    """As the kernels write it: those of warps write planes."""
    return grad.contiguous() if size else program.match_layout(grad, image)


def _has_column_gradient(parts: _Plan, columns: Tensor, of_columns: bool) -> bool:
    return of_columns and bool(parts.steps) and columns.shape[1] > 0


# --- rules ----------------------------------------------------------------------------------------------------------


def _fake(image, columns, fill, size, plan, numbers):
    parts = _parse(plan, numbers)
    like = image.new_empty(image.shape[:2] + tuple(size)) if size else image
    like = program.match_layout(like, image)
    tensors = [None] * MAX_TENSORS
    y = program._result(like, *tensors, None, parts.color_plan, parts.numbers)
    dtype, batch = compute_dtype(image), image.shape[0]
    return [
        y,
        image.new_empty((batch, 3 if size else 0, 3), dtype=dtype),
        image.new_empty((batch, 1 if CONTRAST in parts.steps else 0), dtype=dtype),
    ]


def _fake_backward(grad, image, columns, fill, matrix, mean, size, plan, numbers, of_image, of_columns):
    columns = _columns_of(image, columns)
    has_columns = _has_column_gradient(_parse(plan, numbers), columns, of_columns)
    return [
        _gradient_layout(torch.empty_like(image), image, size) if of_image else image.new_empty((image.shape[0], 0)),
        columns.new_empty((image.shape[0], columns.shape[1] if has_columns else 0)),
        columns.new_empty((image.shape[0], 3 if size and of_columns else 0, 3)),
    ]


def _backward(needs, grad, of_matrix, of_mean, y, matrix, mean, image, columns, fill, size, plan, numbers):
    if needs[2] or image.dtype == torch.uint8 or y.dtype == torch.uint8:
        grads = (grad, of_matrix, of_mean)
        return warp_and_color.differentiate_reference(needs, *grads, image, columns, fill, size, plan, numbers)
    arguments = (grad, image, columns, fill, matrix, mean, size, plan, numbers)
    grad_image, grad_columns, grad_matrix = _warp_and_color_backward(*arguments, needs[0], needs[1])
    if not needs[1]:
        return [grad_image, None, None]
    if size:
        parts = _parse(plan, numbers)
        of_chain = transforms._transform_matrix_backward(
            grad_matrix, columns, parts.transforms, parts.transform_numbers
        )
        grad_columns = of_chain + grad_columns if grad_columns.shape[1] else of_chain
    elif not grad_columns.shape[1]:
        grad_columns = torch.zeros_like(columns)
    return [grad_image if needs[0] else None, grad_columns, None]


def _supports(image: Tensor, columns: Tensor | None, fill: Tensor | None, size: Any, plan: Any, *_: Any) -> str | None:
    """Images have a pixel, and image and result are both float64, or neither is."""
    if not image.numel() and 0 in image.shape[2:]:
        return f"there is no kernel for images without pixels, here {tuple(image.shape)}"
    if plan[0] >= 0 and (image.dtype == torch.float64) != (plan[0] == program._DTYPES.index(torch.float64)):
        return f"there is no kernel from {image.dtype} to {program._DTYPES[plan[0]]}"
    return _unsupported_channels(image, plan)


def _unsupported_channels(image: Tensor, plan: Sequence[int]) -> str | None:
    """Contrast is around the mean of three channels or one."""
    if image.shape[1] not in (1, 3) and _has_contrast(plan):
        return f"there is no kernel for contrast of {image.shape[1]} channels"
    return None


def _has_contrast(plan: Sequence[int]) -> bool:
    return CONTRAST in _parse(plan, ()).steps


def _supports_backward(grad: Tensor, image: Tensor, columns: Tensor | None, *rest: Any) -> str | None:
    """Images have a pixel, and at most 64 columns get gradients."""
    if 0 in image.shape[2:]:
        return f"there is no kernel for images without pixels, here {tuple(image.shape)}"
    if rest[-1] and columns is not None and columns.shape[1] > program.MAX_NUMBERS:
        return f"there is no kernel for gradients of {columns.shape[1]} columns"
    return _unsupported_channels(image, rest[4])


def _plan_clamps(plan: Sequence[int], numbers: Sequence[float]) -> bool:
    parts = _parse(plan, numbers)
    return program.clamps(parts.steps, parts.numbers)


def _adds_by_atomics(grad: Tensor, image: Tensor, *rest: Any) -> bool:
    """The gradient of an image on CUDA, unless the padding is the fill value, whose gradient is a gather.

    This is an upper bound: bilinear crops, flips and resizing with zeros or border are added without atomics as well, but only
    where the kernel finds that the rows of a block fit its shared memory.
    """
    size, plan, of_image = rest[4], rest[5], rest[7]
    return grad.is_cuda and bool(size) and bool(of_image) and plan[3] != PADDING["fill"] and not plan[5]


warp_and_color = register(
    "warp_and_color",
    _reference,
    fake=_fake,
    backward=_backward,
    saves_results=True,
    non_differentiable=(1, 2),
    bytes=True,
    casts_outputs=True,
    supports=_supports,
    clamps=lambda *args: _plan_clamps(*args[-2:]),
)
_warp_and_color_backward = register(
    "warp_and_color_backward",
    _reference_backward,
    fake=_fake_backward,
    casts_outputs=True,
    supports=_supports_backward,
    nondeterministic=_adds_by_atomics,
)

# The result and the matrices for images that are copies of pieces of a batch (mixing/pieces.py): the batch, the pieces, and the
# arguments of `warp_and_color` behind the images.
_on_pieces = FastPath("warp_and_color_pieces", (torch.float32, torch.float16, torch.bfloat16, torch.uint8))

# --- passes ---------------------------------------------------------------------------------------------------------


class Resampling(NamedTuple):
    """How a warp reads an image: names as the warps of kvision.geometry take them, and the fill value.

    With `antialias` the window that a matrix maps to the result is resized as `resize` does, and nothing around it is read. Only
    matrices that map rows to rows have windows.
    """

    mode: str = "bilinear"
    padding: str = "zeros"
    align_corners: bool = True
    fill: Any = None
    antialias: bool = False

    def for_labels(self, mode: str | None = None, fill: Any = None) -> Resampling:
        """How masks are read: pixels from outside are `fill`, or else 0, where those of images are 0 or the fill value."""
        padding = self.padding
        if padding in ("zeros", "fill"):
            padding = "zeros" if fill is None else "fill"
        return Resampling(mode or self.mode, padding, self.align_corners, fill if padding == "fill" else None)

    def for_inverse(self, mode: str | None = None) -> Resampling:
        """How results are read to undo a call, which know nothing of the pixels that left them."""
        return self._replace(mode=mode or self.mode, padding="zeros", fill=None, antialias=False)


def fill_of_images(x: Tensor, fill: Any) -> Any:
    """The fill value of images in [0, 1] as one of images x: bytes are 255ths."""
    if fill is None or x.dtype != torch.uint8:
        return fill
    return 255 * (fill if isinstance(fill, (int, float)) else torch.as_tensor(fill))


class ColorStep:
    """A step of what an augmentation does to the values of pixels: its name, and parameters that are drawn or given.

    An augmentation lists its steps in `color_steps`. The steps of neighbors run in one pass over the images.

    Args:
        name: a step for images of any number of channels, or one for three.
        *parameters: those of the step, each a number, or the name of a field of the generator; those that are left out are 0:

            - 'scale_shift': factor, offset, 1 to clip to [0, 1]
            - 'contrast': factor of the distance from the mean of the luma
            - 'gamma': exponent, gain
            - 'log': gain, 1 for the inverse, 1 to clip
            - 'sigmoid': cutoff, gain, 1 to fall
            - 'standardize': mean, standard deviation
            - 'solarize': threshold, addition, 1 to add
            - 'posterize': bits, 1
            - 'scale_shift_rgb': three factors, three offsets, 1 to clip
            - 'standardize_rgb': three means, three standard deviations
            - 'saturation', 'saturation_gray': factor of the saturation in HSV, of the distance from the luma
            - 'hue': angle in radians
            - 'affine': a matrix (3, 3) of the channels by rows, three offsets, 1 to clip; numbers only

    Raises:
        ValueError: there is no step of this name, or it has fewer parameters; in a call, a name that is none of a field.

    Example:
        >>> import kvision as K
        >>> K.augmentation.ColorStep("scale_shift", "brightness_factor", 0.0, 1.0)
        ColorStep('scale_shift', 'brightness_factor', 0.0, 1.0)
    """

    def __init__(self, name: str, *parameters: Input) -> None:
        if name not in STEPS:
            raise ValueCheckError(f"ColorStep: expected name to be one of {', '.join(STEPS)}, got {name!r}")
        count = STEPS[name].parameters
        self.name, self.parameters = name, parameters
        if len(parameters) > count:
            raise ValueCheckError(f"ColorStep: expected at most {count} parameters of {name!r}, got {self!r}")

    def __repr__(self) -> str:
        return f"ColorStep({', '.join(map(repr, (self.name, *self.parameters)))})"

    def _reduced(self, constants: Mapping[str, float]) -> ColorStep:
        """A cheaper step that gives the same, up to rounding, where fields have constant values that change nothing."""
        values = tuple(constants.get(x) if isinstance(x, str) else x for x in self.parameters)
        return _AT_IDENTITY.get((self.name, values), self)

    def _bound(self, names: Names) -> ColorStep:
        """The same step with columns in place of their names."""
        bound = ColorStep(self.name, *bind(self.parameters, names))
        if STEPS[self.name].arguments == "numbers" and any(isinstance(x, Column) for x in bound.parameters):
            raise ValueCheckError(f"ColorStep: expected numbers as parameters of {self.name!r}, got {self!r}")
        return bound


# What steps do that change nothing. Those that clip still do.
_CLIP = ColorStep("scale_shift", 1.0, 0.0, 1.0)
_AT_IDENTITY: Mapping[tuple[str, tuple[Any, ...]], ColorStep] = {
    ("contrast", (1.0,)): _CLIP,
    ("saturation_gray", (1.0,)): _CLIP,
    ("hue", (0.0,)): ColorStep("scale_shift", 1.0),
}


class ColorPart(NamedTuple):
    """The bound steps of one augmentation, and the columns with the order of them, -1 for none; None: all follow each other."""

    steps: Sequence[ColorStep]
    order: Sequence[int] | None = None

    @property
    def has_contrast(self) -> bool:
        return any(step.name == "contrast" for step in self.steps)


class Output(NamedTuple):
    """The type and the layout of a result; None for those of the images."""

    dtype: torch.dtype | None = None
    memory_format: torch.memory_format | None = None


SAME = Output()


class Pass(NamedTuple):
    """The arguments of the operator that do not depend on data."""

    size: list[int]
    plan: list[int]
    numbers: list[float]
    resampling: Resampling | None  # with a fill value
    chain: Sequence[Transform]  # the transforms that did not fit the kernel, after which the matrix is computed before
    splits: Sequence[int] = ()  # indices of the numbers that say how posterization rounds to the type of the images

    @property
    def warps(self) -> bool:
        return len(self.size) > 0

    @property
    def has_contrast(self) -> bool:
        return _has_contrast(self.plan)

    @property
    def clamps(self) -> bool:
        """Whether a color step clamps."""
        return _plan_clamps(self.plan, self.numbers)

    def reads_pieces(self, x: Tensor) -> bool:
        """Whether `run` takes pieces of images x."""
        return self.warps and x.dim() == 4 and _on_pieces.serves(x) and _supports(x, None, None, (), self.plan) is None

    def run(self, x: Tensor, columns: Tensor | None, pieces: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The result, and the matrices (B, 3, 3) of the warp, which do not carry gradients.

        With `pieces` (B, N, 9) the images are copies of these pieces of x, as `paste_pieces` makes them, in the size of x.
        """
        if pieces is not None:
            y, matrix = _on_pieces.kernel(x, pieces, *self.arguments(x, columns))
            return y, matrix
        if x.dim() == 5:  # a volume, whose slices are those of one high image
            y, matrix = self.run(x.flatten(2, 3), columns)
            return y.unflatten(2, x.shape[2:4]), matrix
        y, matrix, _ = warp_and_color(as_plane(x) if self.takes_planes(x) else x, *self.arguments(x, columns))
        return match_layout(y.view(x.shape), x) if self.takes_planes(x) else y, matrix

    def takes_planes(self, x: Tensor) -> bool:
        """Whether the channels of images (*, C, H, W) are rows of one: kernels have contrast of three channels or one, and the mean
        of others is that of all their values.
        """
        is_plain = not self.warps and self.plan[1] < 0 and x.numel() > 0
        return is_plain and x.shape[-3] not in (1, 3) and self.has_contrast

    def arguments(self, x: Tensor, columns: Tensor | None) -> tuple[Any, ...]:
        """The arguments of the operator behind images (B, C, H, W), of which the size does not count."""
        fill = None
        if self.resampling is not None:
            value = fill_of_images(x, self.resampling.fill)
            fill = sampling.padding_and_fill("augmentation", x, self.resampling.padding, value)[1]
        dtype = torch.float64 if x.dtype == torch.float64 else torch.float32
        if columns is not None and columns.dtype != dtype:
            columns = columns.to(dtype)
        if self.chain:
            columns = transforms.transform_matrix(_columns_of(x, columns), self.chain).flatten(1)
        return columns, fill, self.size, self.plan, self._numbers_for(x)

    def _numbers_for(self, x: Tensor) -> list[float]:
        if not self.splits or x.dtype not in SPLIT:
            return self.numbers
        return [SPLIT[x.dtype] if i in self.splits else number for i, number in enumerate(self.numbers)]


def as_plane(x: Tensor) -> Tensor:
    """Images (*, C, H, W) with the rows of all channels in one, (*, 1, C * H, W)."""
    return x.flatten(-3, -2).unsqueeze(-3)


def make_pass(
    chain: Sequence[Transform] | None,
    size: Sequence[int] = (),
    resampling: Resampling | None = None,
    parts: Sequence[ColorPart] = (),
    output: Output = SAME,
) -> Pass:
    """The pass of a chain of transforms, None for no warp, and then of the steps of several augmentations."""
    sampling = [0, 0, 0, 0]
    transform_plan: list[int] = []
    numbers: list[float] = []
    before: Sequence[Transform] = ()
    if chain is not None:
        assert resampling is not None
        padding = PADDING.get(resampling.padding, PADDING["fill"])
        sampling = [
            INTERPOLATION[resampling.mode],
            padding,
            int(resampling.align_corners),
            int(resampling.antialias),
        ]
        if len(chain) > MAX_TRANSFORMS:
            assert not parts  # whose columns would be others
            before, chain = chain, [Transform("matrix", *[Column(i) for i in range(9)])]
        transform_plan, numbers = transforms.make_plan(chain)
    steps: list[int] = []
    columns: list[int] = []
    order: list[int] = []
    splits: list[int] = []
    is_ordered = any(part.order is not None for part in parts)
    for part in parts:
        first = len(steps)
        for step in part.steps:
            number, count, *_ = STEPS[step.name]
            steps.append(number)
            if step.name == "posterize":
                splits.append(len(numbers) + 1)
            own_numbers, own_columns = split_inputs([*step.parameters, *[0.0] * (count - len(step.parameters))])
            numbers, columns = numbers + own_numbers, columns + own_columns
        if is_ordered:
            for i in range(len(part.steps)):
                order += (-1, first + i) if part.order is None else (part.order[i], first)
    if all(c < 0 for c in columns):
        columns = []
    head = [
        -1 if output.dtype is None else program._DTYPES.index(output.dtype),
        program.LAYOUTS[output.memory_format],
        *sampling,
    ]
    plan = [*head, len(transform_plan), *transform_plan, len(steps), *steps, len(columns), *columns, *order]
    has_fill = resampling is not None and resampling.padding == "fill" and resampling.fill is not None
    size = [] if chain is None else list(size)
    return Pass(size, plan, [float(x) for x in numbers], resampling if has_fill else None, before, splits)


def fits_one_program(parts: Sequence[ColorPart]) -> bool:
    """Whether the kernels take the steps of all parts in one program."""
    steps = [step for part in parts for step in part.steps]
    numbers = sum(STEPS[step.name].parameters for step in steps)
    return (
        len(steps) <= program.MAX_STEPS
        and numbers <= program.MAX_NUMBERS
        and sum(STEPS[step.name].number == CONTRAST for step in steps) <= 1
    )


def frames_pass(frames: Frames, image_pass: Pass, columns: Tensor | None) -> tuple[Tensor, Tensor] | None:
    """What `Pass.run` gives of the images that the frames are; None where no launch reads the planes for it."""
    like = frames._like()
    like = like[None] if frames.is_single else like
    columns, _, size, plan, numbers = image_pass.arguments(like, columns)
    parts = _parse(plan, numbers)
    interpolation, padding, align_corners = parts.sampling
    is_bilinear = interpolation == INTERPOLATION["bilinear"]
    affine = affine_of(parts.steps, parts.columns, parts.numbers)
    dtype = program._DTYPES[parts.dtype] if parts.dtype >= 0 else frames.dtype
    # Steps get colors that are rounded to bytes, if frames are images of these.
    if parts.order or parts.layout >= 0 or (parts.steps and not frames.dtype.is_floating_point):
        affine = None
    if not image_pass.warps and affine is not None:
        return frames._read(None, None, PLAINLY, *affine, dtype), like.new_empty(len(like), 0, 3)
    if not image_pass.warps or image_pass.resampling is not None:
        return None
    if not (is_bilinear or (interpolation == INTERPOLATION["nearest"] and not parts.antialias)):
        return None
    if padding == PADDING["reflection"] and not parts.antialias:
        return None
    matrix = transforms._transform_matrix(_columns_of(like, columns), parts.transforms, parts.transform_numbers)
    windows = (2 if align_corners else 1) if parts.antialias else 0
    reading = Reading(windows, False, not is_bilinear, padding == PADDING["border"])
    if affine is not None:
        y = frames._read(matrix, (size[0], size[1]), reading, *affine, dtype)
    else:
        y = frames._read(matrix, (size[0], size[1]), reading)
        y, _, _ = warp_and_color(y, columns, None, [], parts.plan_of_steps, parts.numbers)
    return y, matrix.detach()
