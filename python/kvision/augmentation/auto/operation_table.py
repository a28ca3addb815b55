"""The operations of policies, by name: what they do with a sample's value, for a whole batch at once.

An operation is a number of the sample, and so is its value. One kernel runs a step on a batch, each sample's operation
alone, and so does its gradient. Where a type has no kernel, or values get gradients, a step executes on the whole batch:

    all operations that move pixels       one matrix a sample (the identity for other operations) and one warp
    all operations on single pixels       one color program, whose order has the step of each sample's operation alone
    sharpness, equalize and auto_contrast     a pass each, if the policy has them
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, is_grad_enabled

from kvision import enhance
from kvision._constants import constant
from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision._modes import POLICY_OPERATION
from kvision._ops import FastPath, behind_grad, register, vjp
from kvision._torch_compat import in_forward_ad
from kvision.augmentation.columns import name_columns
from kvision.augmentation.drawn_pass import COMPUTED_IN_FLOAT32
from kvision.augmentation.engine import Warp
from kvision.augmentation.filters import has_range
from kvision.augmentation.lists import statistics_lists
from kvision.augmentation.lists.conversions import bytes_of_float_images, in_type, run_on_list
from kvision.augmentation.lists.filter_lists import sharpness
from kvision.augmentation.lists.sides import sizes_of_list
from kvision.augmentation.maps import warp, warp_to_sizes
from kvision.augmentation.transforms import Transform, transform_matrix
from kvision.augmentation.warp_and_color import ColorPart, ColorStep, Pass, Resampling, make_pass
from kvision.geometry.transform.lists.arguments import fake_results, like_batch, sizes
from kvision.geometry.transform.lists.kept_sizes import Operation as ListedOperation


class Operation(NamedTuple):
    """An operation of policies. `neutral` is the value that changes nothing, about which values are mirrored at random."""

    number: int
    neutral: float | None = None


# Those of `rotate` are degrees, counter-clockwise; of shears tangents of the angles; of translations fractions of width and
# height; of `color`, `contrast`, `brightness` and `sharpness` factors: 0 for gray, mean gray, black, smooth. `posterize` has the
# bits that are kept, `solarize` the threshold, `solarize_add` what is added before values of at least 0.5 are inverted.
_NEUTRAL = {
    **dict.fromkeys(("rotate", "shear_x", "shear_y"), 0.0),
    **dict.fromkeys(("translate_x", "translate_y", "translate_x_pixels", "translate_y_pixels"), 0.0),
    **dict.fromkeys(("color", "contrast", "brightness", "sharpness"), 1.0),
}
OPERATIONS = {name: Operation(number, _NEUTRAL.get(name)) for name, number in POLICY_OPERATION.items()}

_GEOMETRIC = (
    "rotate",
    "shear_x",
    "shear_y",
    "translate_x",
    "translate_y",
    "translate_x_pixels",
    "translate_y_pixels",
)
_COLOR = {
    "invert": ColorStep("scale_shift", -1.0, 1.0),
    "posterize": ColorStep("posterize", "value", 1.0),
    "solarize": ColorStep("solarize", "value", 0.0, 1.0),
    "solarize_add": ColorStep("solarize", 0.5, "value", 1.0),
    "color": ColorStep("saturation_gray", "value"),
    "contrast": ColorStep("contrast", "value"),
    "brightness": ColorStep("scale_shift", "value", 0.0, 1.0),
}
_FIELDS_OF_MATRIX = (("angle", 0), ("translation", 2), ("shear", 2), ("center", 2))
BILINEAR = Resampling("bilinear", "zeros")

_apply_operations = FastPath("apply_operations", COMPUTED_IN_FLOAT32, clamps=True)
_listed = FastPath("apply_operations_list", COMPUTED_IN_FLOAT32, clamps=True)


def execute_steps(
    x: Tensor, names: Sequence[tuple[str, ...]], operation: Tensor, value: Tensor
) -> tuple[Tensor, list[Warp]]:
    """Run operations on each image, one after the other.

    Args:
        x: images (B, C, H, W).
        names: the operations that may occur, of each step.
        operation: numbers (B, steps) of the operations, -1 for none.
        value: (B, steps), the values of the operations.

    Returns:
        The images, and what labels have to follow.
    """
    size = (x.shape[-2], x.shape[-1])

    def warps(of_step: tuple[str, ...], matrix: Tensor) -> list[Warp]:
        return [Warp(matrix, size, size, BILINEAR)] if _moves_pixels(of_step) else []

    stages: list[Warp] = []
    if _has_kernel(x, operation, value, _apply_operations):
        x, matrices = _apply_operations.kernel(x, operation, value)
        for of_step, matrix in zip(names, matrices.unbind()):
            stages += warps(of_step, matrix)
        return x, stages
    for of_step, numbers, values in zip(names, operation.unbind(1), value.unbind(1)):
        if _supports(x, numbers, values) is None and not values.requires_grad and _apply_operation.is_native(x):
            x, matrix = _apply_operation(x, numbers, values)
            more = warps(of_step, matrix)
        else:
            x, more = execute_step(x, of_step, numbers, values)
        stages += more
    return x, stages


def _has_kernel(x: Tensor, operation: Tensor, value: Tensor, kernel: FastPath) -> bool:
    is_usual = x.shape[1] > 0 and operation.dtype == torch.int64 and value.dtype == torch.float32
    return is_usual and not value.requires_grad and kernel.serves(x)


# --- a step with its gradient ---------------------------------------------------------------------------------------

# Arguments: images (B, C, H, W); numbers (B,) of the operations; their values (B,).


def _reference(x: Tensor, operation: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    y, stages = execute_step(x, tuple(OPERATIONS), operation, value)
    (warp,) = stages
    return y, warp.matrix


def _reference_backward(grad: Tensor, x: Tensor, operation: Tensor, value: Tensor) -> Tensor:
    gradient: Tensor = vjp(lambda x: _reference(x, operation, value)[0])(grad, x)
    return gradient.contiguous()


def _supports(x: Tensor, operation: Tensor, value: Tensor) -> str | None:
    """Images have a pixel, and are float32, or on CUDA float16 or bfloat16."""
    if not x.numel():
        return f"there is no kernel for images {tuple(x.shape)}"
    if x.dtype != torch.float32 and not (x.is_cuda and x.dtype in (torch.float16, torch.bfloat16)):
        return f"there is no kernel for {x.dtype} on {x.device.type}"
    if operation.dtype != torch.int64 or value.dtype != torch.float32:
        return f"there is no kernel for operations of {operation.dtype} with values of {value.dtype}"
    return None


_apply_operation = register(
    "apply_operation",
    _reference,
    fake=lambda x, *_: [x.shape, x.new_empty((x.shape[0], 3, 3), dtype=torch.float32)],
    gradients="images: apply_operation_backward; value: reference",
    non_differentiable=(1,),
    casts_outputs=True,
    supports=_supports,
    clamps=True,
)
_apply_operation_backward = register(
    "apply_operation_backward",
    _reference_backward,
    fake=lambda grad, x, *_: x.new_empty(x.shape),
    casts_outputs=True,
    supports=behind_grad(_supports),
)

# --- lists of images of different sizes -----------------------------------------------------------------------------


def execute_steps_on_list(
    images: Sequence[Tensor], names: Sequence[tuple[str, ...]], operation: Tensor, value: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """Run operations on each image (C, H, W) of a list, as :func:`execute_steps` does; gives the images, and the matrices
    (B, 3, 3) of the steps that move pixels.
    """
    call: Any = None
    if has_list_kernel(_listed, images, operation, value):
        call = _listed.kernel
    elif has_list_operator(images, operation, value):
        call = _apply_operations_list
    if call is not None:
        *results, matrices = call(images, operation, value)
        return results, [own for of_step, own in zip(names, matrices.unbind()) if _moves_pixels(of_step)]
    results, matrices = list(images), []
    for of_step, numbers, values in zip(names, operation.unbind(1), value.unbind(1)):
        results, more = _execute_step_on_list(results, of_step, numbers, values)
        matrices += more
    return results, matrices


def has_list_kernel(kernel: FastPath, images: Sequence[Tensor], operation: Tensor, value: Tensor) -> bool:
    """Whether a kernel executes steps on a list, without gradients."""
    wants_gradients = is_grad_enabled() and any([image.requires_grad for image in images])
    return (
        not wants_gradients and not in_forward_ad() and _has_kernel(images[0].detach()[None], operation, value, kernel)
    )


def has_list_operator(images: Sequence[Tensor], operation: Tensor, value: Tensor) -> bool:
    """Whether an operator executes steps on a list, with its gradients."""
    return _supports_list(images, operation, value) is None and _apply_operation.is_native(images[0])


def _supports_list(images: Sequence[Tensor], operation: Tensor, value: Tensor, *_: Any) -> str | None:
    reason = _supports(images[0][None], operation, value)
    return "there is no kernel for gradients of values" if reason is None and value.requires_grad else reason


# Arguments: images (C, h, w); numbers (B, S) of the operations of S steps; their values (B, S). The matrices (S, B, 3, 3) follow
# the results.


def _reference_of_list(images: Sequence[Tensor], operation: Tensor, value: Tensor) -> list[Tensor]:
    each = [steps_reference(x[None], *own) for x, *own in zip(images, operation.split(1), value.split(1))]
    return [*(y[0] for y, _ in each), torch.cat([matrices for _, matrices in each], 1)]


def steps_reference(x: Tensor, operation: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    """What steps (1, S) make of an image (1, C, h, w), and their matrices (S, 1, 3, 3)."""
    matrices = []
    for step in zip(operation.unbind(1), value.unbind(1)):
        x, matrix = _apply_operation.reference(x, *step)
        matrices.append(matrix)
    return x, torch.stack(matrices)


def _fake_of_list(images: Sequence[Tensor], operation: Tensor, value: Tensor) -> list[Tensor]:
    matrices = value.new_empty((operation.shape[1], len(images), 3, 3))
    return [*fake_results(images, [n for x in images for n in x.shape[-2:]]), matrices]


def _gradients_of_list(
    needs: Sequence[bool], grads: Sequence[Any], images: Sequence[Tensor], operation: Tensor, value: Tensor
) -> list[Any]:
    of_images = None
    if needs[0]:
        each = zip(grads, images, operation.split(1), value.split(1))
        of_images = [None if g is None else steps_vjp(g[None], x[None], *own)[0] for g, x, *own in each]
    return [of_images, None, None]


def steps_vjp(grad: Tensor, x: Tensor, operation: Tensor, value: Tensor) -> Tensor:
    """The gradient of an image (1, C, h, w) from that of what steps make of it, which run again."""
    steps = list(zip(operation.unbind(1), value.unbind(1)))
    before = [x]
    for step in steps[:-1]:
        before.append(_apply_operation(before[-1], *step)[0])
    for y, step in zip(reversed(before), reversed(steps)):
        grad = _apply_operation_backward(grad, y, *step)
    return grad


def list_operator(name: str, reference: Any, fake: Any, backward: Any, **options: Any) -> ListOperator:
    """An operator that executes steps on lists, whose arguments begin with those above."""
    return ListOperator(
        name, _apply_operation, reference, fake=fake, backward=backward, supports=_supports_list, **options
    )


_apply_operations_list = list_operator(
    "apply_operations_list", _reference_of_list, _fake_of_list, _gradients_of_list, non_differentiable=(-1,)
)

# --- the parts of a step --------------------------------------------------------------------------------------------


@functools.lru_cache
def _moves_pixels(names: tuple[str, ...]) -> bool:
    return any(name in names for name in _GEOMETRIC)


def execute_step(x: Tensor, names: tuple[str, ...], operation: Tensor, value: Tensor) -> tuple[Tensor, list[Warp]]:
    """Run one operation on each image.

    Args:
        x: images (B, C, H, W).
        names: the operations that may occur.
        operation: numbers (B,) of the operations, -1 for none.
        value: (B,), the values of the operations.

    Returns:
        The images, and what labels have to follow.
    """
    stages: list[Warp] = []
    size = (x.shape[-2], x.shape[-1])
    if _moves_pixels(names):
        matrix = _matrix(operation, value, constant((tuple(map(float, size)),), value))
        x = warp(x, matrix, size, BILINEAR)
        stages.append(Warp(matrix, size, size, BILINEAR))
    color = _color_names(names, x.shape[1])
    if color:
        x, _ = _color_pass(color).run(x, _color_columns(color, operation, value))
    for name, function in _ALONE.items():
        if name in names:
            chosen = is_one(operation, name)
            changes = chosen[:, None, None, None]
            if name == "auto_contrast":
                changes = changes & has_range(x)
            x = torch.where(changes, _on_floats(function, x, chosen, value), x)
    return x, stages


def _execute_step_on_list(
    images: list[Tensor], names: tuple[str, ...], operation: Tensor, value: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """The same of a list, by an operator on all images for each of the operations that may occur; gives these and the matrices."""
    matrices: list[Tensor] = []
    if _moves_pixels(names):
        matrices.append(_matrix(operation, value, sizes_of_list(images).to(value.dtype)))
        images = warp_to_sizes(images, matrices[0], sizes(images), BILINEAR)
    color = _color_names(names, images[0].shape[0])
    if color:
        images = run_on_list(_color_pass(color), images, _color_columns(color, operation, value))
    like, are_bytes = like_batch(images), images[0].dtype == torch.uint8
    for name, of_values in _ALONE_ON_LISTS.items():
        if name in names:
            chosen = is_one(operation, name)
            x = in_type(torch.float32, images) if are_bytes else images
            factors = torch.where(chosen, value, 1.0).to(compute_dtype(like))[:, None, None]
            y = of_values(factors).on_list(x, chosen.float())
            images = bytes_of_float_images(y) if are_bytes else y
    return images, matrices


def is_one(operation: Tensor, name: str) -> Tensor:
    """(B,), whether the operation of a sample is that of the name."""
    return operation == OPERATIONS[name].number


def _matrix(operation: Tensor, value: Tensor, sides: Tensor) -> Tensor:
    """The matrices (B, 3, 3) of the samples' operations, about the centers of images, for height and width (B or 1, 2)."""
    factors = value[:, None] * constant(_factors(), value)[operation]
    angle, across, down, right, lower, *tangents = factors.unbind(1)
    height, width = sides.expand(len(value), 2).unbind(1)
    shears = (tangent.atan().rad2deg() for tangent in tangents)
    center = (width - 1) / 2, (height - 1) / 2
    columns = torch.stack([angle, across * width + right, down * height + lower, *shears, *center], 1)
    chain = Transform.affine("center", angle="angle", translation="translation", shear="shear")
    return transform_matrix(columns, [chain._bound(name_columns(_FIELDS_OF_MATRIX))])


# Tables by the number of an operation, which -1 for none reads from the end.


@functools.lru_cache
def _factors() -> tuple[tuple[float, ...], ...]:
    """What a value is multiplied by: angle, translation along x and y in sides and then in pixels, shear along x and y."""
    names = (
        "rotate",
        "translate_x",
        "translate_y",
        "translate_x_pixels",
        "translate_y_pixels",
        "shear_x",
        "shear_y",
    )
    return tuple(tuple(float(name == own) for own in names) for name in (*OPERATIONS, "none"))


def _color_names(names: tuple[str, ...], channels: int) -> tuple[str, ...]:
    """Those of color steps that change images of so many channels."""
    return tuple(name for name in _COLOR if name in names and (channels == 3 or name != "color"))


def _color_columns(color: tuple[str, ...], operation: Tensor, value: Tensor) -> Tensor:
    """The columns of the program of these steps."""
    values = torch.where(operation == OPERATIONS["posterize"].number, value.round(), value)
    return torch.cat([values[:, None], constant(_orders(color), value)[operation]], 1)


@functools.lru_cache
def _orders(color: tuple[str, ...]) -> tuple[tuple[float, ...], ...]:
    """The order of the steps of a color program: the one of the operation alone."""
    return tuple(
        tuple(float(i) if name == own else -1.0 for i, own in enumerate(color)) for name in (*OPERATIONS, "none")
    )


@functools.lru_cache(maxsize=32)
def _color_pass(color: tuple[str, ...]) -> Pass:
    names = name_columns([("value", 0), ("order", len(color))])
    steps = [_COLOR[name]._bound(names) for name in color]
    return make_pass(None, parts=[ColorPart(steps, [column.position for column in names["order"]])])


def _on_floats(function: Callable[..., Tensor], x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    """A function of images in [0, 1], on images of any type."""
    if x.dtype != torch.uint8:
        return function(x, chosen, value).to(x.dtype)
    y = function(x.float() / 255, chosen, value)
    return (y * 255).round().clamp(0, 255).to(torch.uint8)


def _sharpness(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    return enhance.sharpness(x, torch.where(chosen, value, 1.0).to(x.dtype))


def _equalize(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    return enhance.equalize(x)


def _auto_contrast(x: Tensor, chosen: Tensor, value: Tensor) -> Tensor:
    return enhance.normalize_min_max(x)


_ALONE = {"sharpness": _sharpness, "equalize": _equalize, "auto_contrast": _auto_contrast}
_ALONE_ON_LISTS: dict[str, Callable[[Tensor], ListedOperation]] = {
    "sharpness": lambda factors: ListedOperation(sharpness, (factors, 0.0)),
    "equalize": lambda _: ListedOperation(statistics_lists.equalize, (False,)),
    "auto_contrast": lambda _: ListedOperation(statistics_lists.normalize_min_max, (0.0, 1.0, 1e-6, False, True)),
}
