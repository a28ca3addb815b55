"""Motion blur: filtering along a line."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from kvision import _check
from kvision._choices import Border, Interpolation, Linear
from kvision._clamp import clamp
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import MOTION_TAPS, MOTION_TAPS_NAMES
from kvision._modules import VOLUME, FunctionModule
from kvision._ops import no_derivative, register
from kvision._torch_compat import full
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.filters.filter2d import _filter2d, filter_arguments
from kvision.filters.filter3d import filter_volumes


def get_motion_kernel2d(
    kernel_size: int, angle: Tensor | float, direction: Tensor | float = 0.0, mode: Interpolation = "nearest"
) -> Tensor:
    """A line through the center, rotated by an angle, with weights that rise or fall along it.

    Args:
        kernel_size: length of the line, an odd int of at least 3.
        angle: degrees, counter-clockwise on the screen, 0 is horizontal; a number or a tensor () or (B,).
        direction: in [-1, 1] and clamped to it; 0 gives even weights, 1 weights that fall to 0 from the left end of the
            unrotated line to its right end, -1 the reverse. A number or a tensor () or (B,).
        mode: how the rotated line is sampled: 'nearest', 'bilinear' or 'bicubic'.

    Returns:
        (B, kernel_size, kernel_size) of sum 1, in the type and on the device of the tensors given; differentiable in
        direction and, unless mode is 'nearest', in angle.

    Raises:
        TypeCheckError: an argument of the wrong type.
        ShapeError: tensors of different lengths.
        ValueCheckError: an even kernel_size or one below 3, a number that is not finite, an unknown mode.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import kvision as K
        >>> K.filters.get_motion_kernel2d(3, 0.0, 1.0)
        tensor([[[0.0000, 0.0000, 0.0000],
                 [0.6667, 0.3333, 0.0000],
                 [0.0000, 0.0000, 0.0000]]])
    """
    return _motion_kernel("get_motion_kernel2d", kernel_size, angle, direction, mode, 2)


def get_motion_kernel3d(
    kernel_size: int,
    angle: Tensor | tuple[float, float, float],
    direction: Tensor | float = 0.0,
    mode: Linear = "nearest",
) -> Tensor:
    """A line along x through the center of a cube, rotated in space, with weights that rise or fall along it.

    Args:
        kernel_size: length of the line, an odd int of at least 3.
        angle: degrees (yaw, pitch, roll), the components along x, y, z of the rotation vector; three numbers, or a
            tensor (3,) or (B, 3).
        direction: as in :func:`get_motion_kernel2d`.
        mode: 'nearest' or 'bilinear'.

    Returns:
        (B, kernel_size, kernel_size, kernel_size) of sum 1.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`get_motion_kernel2d`.

    Example:
        >>> import kvision as K
        >>> K.filters.get_motion_kernel3d(3, (0.0, 0.0, 90.0)).nonzero()[:, 1:]
        tensor([[1, 0, 1],
                [1, 1, 1],
                [1, 2, 1]])
    """
    return _motion_kernel("get_motion_kernel3d", kernel_size, angle, direction, mode, 3)


def motion_blur(
    input: Tensor,
    kernel_size: int,
    angle: Tensor | float,
    direction: Tensor | float,
    border_type: Border = "reflect",
    mode: Interpolation = "nearest",
) -> Tensor:
    """Blur an image as a camera does that moves while the shutter is open.

    Args:
        input: image (B, C, H, W). uint8 gives uint8 (rounded half to even), other integers give float32.
        kernel_size: length of the motion in pixels, an odd int of at least 3.
        angle: degrees, counter-clockwise on the screen, 0 is horizontal; a number or a tensor () or (B,).
        direction: in [-1, 1]; 0 is even, 1 weighs the left end of the unrotated line most, -1 the right end. A number or
            a tensor () or (B,).
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.
        mode: how the rotated line is sampled: 'nearest', 'bilinear' or 'bicubic'.

    Returns:
        The blurred image; differentiable as :func:`get_motion_kernel2d` and in the image.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`get_motion_kernel2d` and :func:`filter2d`.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.tensor([[[[0., 0., 3., 0., 0.]]]])
        >>> K.filters.motion_blur(x, 3, 0.0, 0.0, "replicate")
        tensor([[[[0., 1., 1., 1., 0.]]]])
    """
    return _filter2d(*motion_arguments("motion_blur", input, kernel_size, angle, direction, border_type, mode))


def motion_arguments(
    op: str,
    input: Tensor,
    kernel_size: int,
    angle: Tensor | float,
    direction: Tensor | float,
    border_type: Border,
    mode: Interpolation,
) -> tuple[Tensor, Tensor, int, bool]:
    """The checked arguments of a motion blur as :func:`filter2d`'s operator takes them."""
    _check.images(op, "input", input)
    kernel = _motion_kernel(op, kernel_size, angle, direction, mode, 2, input)
    return filter_arguments(op, input, kernel, border_type)


def motion_blur3d(
    input: Tensor,
    kernel_size: int,
    angle: Tensor | tuple[float, float, float],
    direction: Tensor | float,
    border_type: Border = "replicate",
    mode: Linear = "nearest",
) -> Tensor:
    """Blur a volume along a line in space.

    Args:
        input: volume (B, C, D, H, W); integers give float32.
        kernel_size, angle, direction, mode: as in :func:`get_motion_kernel3d`.
        border_type: 'constant' (zeros), 'reflect', 'replicate' or 'circular'.

    Returns:
        The blurred volume.

    Raises:
        TypeCheckError, ShapeError, ValueCheckError, DeviceError: as :func:`get_motion_kernel3d` and :func:`filter3d`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.motion_blur3d(torch.rand(2, 3, 4, 8, 8), 3, (0.0, 0.0, 45.0), 0.5).shape
        torch.Size([2, 3, 4, 8, 8])
    """
    _check.volumes("motion_blur3d", "input", input)
    kernel = _motion_kernel("motion_blur3d", kernel_size, angle, direction, mode, 3, input)
    return filter_volumes("motion_blur3d", input, kernel, border_type, False, "corr")


# The taps around a position, as offsets from its whole part, and the weight of a tap at distance d from it; positions
# are whole for 'nearest'.
_TAPS = {"nearest": (0,), "bilinear": (0, 1), "bicubic": (-1, 0, 1, 2)}
_WEIGHT = {
    "nearest": lambda d: (d == 0).to(d.dtype),
    "bilinear": lambda d: clamp(1 - d, 0),
    "bicubic": lambda d: torch.where(
        d <= 1,
        (1.25 * d - 2.25) * d**2 + 1,
        torch.where(d < 2, ((-0.75 * d + 3.75) * d - 6) * d + 3, 0),
    ),
}


def _motion_kernel(
    op: str,
    kernel_size: int,
    angle: Tensor | tuple[float, ...] | float,
    direction: Tensor | float,
    mode: Interpolation,
    axes: int,
    image: Tensor | None = None,
) -> Tensor:
    """(B, kernel_size, ...): every pixel of the kernel reads its weight on the line before the line is rotated."""
    (size,) = _check.ints(op, "kernel_size", kernel_size, 1, minimum=3)
    _check.odd(op, "kernel_size", (size,))
    _check.choice(op, "mode", mode, MOTION_TAPS_NAMES if axes == 2 else MOTION_TAPS_NAMES[:2])
    angle, direction, dtype = _parameters(op, angle, direction, axes, image)
    angle = angle.detach() if mode == "nearest" else angle
    kernel: Tensor = _motion_kernels(angle, direction, size, MOTION_TAPS[mode])
    return as_dtype(kernel, dtype)


def _reference(angle: Tensor, direction: Tensor, size: int, taps: int) -> Tensor:
    """Kernels (B, size, ...) from angles (B or 1, 1 or 3) and directions (B or 1, 1)."""
    axes, mode = 2 if angle.shape[1] == 1 else 3, MOTION_TAPS_NAMES[taps]
    if mode == "nearest":
        angle = angle.detach().double()  # which of two pixels is nearer can be a matter of the last bits
    center = size // 2
    along, *across = _rotate_back(torch.deg2rad(angle), center)
    if mode == "nearest":
        along, *across = (_round_to_nearest(p, center) for p in (along, *across))

    start = (clamp(direction, -1, 1) + 1).reshape(direction.shape[0], *(1,) * axes) / 2
    kernel = torch.zeros_like(along)
    for offset in _TAPS[mode]:
        tap = along.floor() + offset
        weight_on_line = start + (1 - 2 * start) * (tap + center) / (size - 1)
        kernel = kernel + torch.where(tap.abs() <= center, weight_on_line * _WEIGHT[mode]((along - tap).abs()), 0)
    for p in across:
        kernel = kernel * _WEIGHT[mode](p.abs())
    return (kernel / kernel.sum(tuple(range(1, axes + 1)), keepdim=True)).to(direction.dtype)


def _sizes(angle: Tensor, direction: Tensor, size: int, _: int) -> tuple[int, ...]:
    return (direction if angle.shape[0] == 1 else angle).shape[0], *(size,) * (2 if angle.shape[1] == 1 else 3)


_motion_kernels = register("motion_kernel", _reference, fake=_sizes, supports=no_derivative)


def _parameters(
    op: str,
    angle: Tensor | tuple[float, ...] | float,
    direction: Tensor | float,
    axes: int,
    image: Tensor | None,
) -> tuple[Tensor, Tensor, torch.dtype]:
    """angle (B or 1, 1 or 3) and direction (B or 1, 1) in float32 or wider, and the type the kernel shall have.

    Numbers become tensors on the device of the tensor parameters, or on that of the image and in the type it is computed in.
    """
    tensors = {name: p for name, p in (("angle", angle), ("direction", direction)) if isinstance(p, Tensor)}
    if image is not None:
        tensors = {name: _check.to_device_of(op, image, name, p) for name, p in tensors.items()}
    for name, p in tensors.items():
        _check.numbers(op, name, p)
    _check.same_device(op, **tensors)
    angle, direction = tensors.get("angle", angle), tensors.get("direction", direction)
    types = [p.dtype for p in tensors.values() if p.is_floating_point()]
    default = torch.get_default_dtype() if image is None else compute_dtype(image)
    # One type in most calls; promote_types is not traced by torch.compile.
    dtype = functools.reduce(torch.promote_types, types) if len(set(types)) > 1 else (types or [default])[0]
    promoted = torch.float64 if dtype == torch.float64 else torch.float32
    device = next((p.device for p in (*tensors.values(), image) if p is not None), None)
    angle = _rows(op, "angle", angle, 1 if axes == 2 else 3, device, promoted)
    direction = _rows(op, "direction", direction, 1, device, promoted)
    lengths = (angle.shape[0], direction.shape[0])
    if lengths[0] != lengths[1] and 1 not in lengths:
        raise ShapeError(f"{op}: expected angle and direction of one length, got {lengths[0]} and {lengths[1]}")
    return angle, direction, dtype


def _rows(op: str, name: str, value: object, count: int, device: torch.device | None, dtype: torch.dtype) -> Tensor:
    """`value` as (B, count), or (1, count) made from numbers on the device."""
    if isinstance(value, Tensor):
        if value.dim() == 0:
            value = value.expand(count)
        elif count == 1:
            value = value[..., None]
        value = value[None] if value.dim() == 1 else value
        _check.shape(op, name, value, "B", count)
        return value.to(dtype)
    numbers = _check.scalars(op, name, value)
    numbers = (numbers,) * count if isinstance(numbers, (int, float)) else numbers
    if not isinstance(numbers, (tuple, list)) or not all(isinstance(v, (int, float)) for v in numbers):
        raise TypeCheckError(f"{op}: expected {name} to be a Tensor or numbers, got {value!r}", actual_type=type(value))
    if len(numbers) != count or not all(_check.fits_float(v) and -math.inf < v < math.inf for v in numbers):
        raise ValueCheckError(f"{op}: expected {name} to be {count} finite numbers, got {value!r}", actual_value=value)
    columns = [full((1, 1), float(v), device=device, dtype=dtype) for v in numbers]
    return columns[0] if count == 1 else torch.cat(columns, 1)


def _rotate_back(angle: Tensor, center: int) -> list[Tensor]:
    """x, y (, z) from the center of every pixel of a kernel, rotated back by `angle` (B, 1 or 3) radians."""
    offsets = torch.arange(-center, center + 1, device=angle.device, dtype=angle.dtype)
    if angle.shape[1] == 1:
        y, x = offsets[:, None], offsets
        cos, sin = angle.cos()[..., None], angle.sin()[..., None]
        return [cos * x - sin * y, sin * x + cos * y]  # y points down: counter-clockwise on the screen
    # Rodrigues' formula for the rotation vector -angle: p cos t - (v x p) sin(t) / t + v (v . p) (1 - cos(t)) / t^2
    z, y, x = torch.meshgrid(offsets, offsets, offsets, indexing="ij")
    u, v, w = (component[:, None, None, None] for component in angle.unbind(1))
    square = u**2 + v**2 + w**2
    no_rotation = square == 0
    t = torch.where(no_rotation, 1.0, square).sqrt()
    sinc = torch.where(no_rotation, 1.0, t.sin() / t)
    versine = torch.where(no_rotation, 0.5, 2 * ((t / 2).sin() / t) ** 2)
    cos = 1 - square * versine
    dot = versine * (u * x + v * y + w * z)
    cross = (v * z - w * y, w * x - u * z, u * y - v * x)
    return [cos * p - sinc * c + dot * a for p, c, a in zip((x, y, z), cross, (u, v, w))]


def _round_to_nearest(position: Tensor, center: int) -> Tensor:
    """The nearest whole pixel; halves, whatever their last bits, go to the even index as counted from the border."""
    return ((position * 2**20).round() / 2**20 + center).round() - center


class MotionBlur(FunctionModule):
    """Module form of :func:`motion_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.MotionBlur(3, 35.0, 0.5)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        kernel_size: int,
        angle: Tensor | float,
        direction: Tensor | float,
        border_type: Border = "reflect",
        mode: Interpolation = "nearest",
    ) -> None:
        super().__init__(kernel_size=kernel_size, angle=angle, direction=direction, border_type=border_type, mode=mode)

    def forward(self, x: Tensor) -> Tensor:
        return motion_blur(x, self.kernel_size, self.angle, self.direction, self.border_type, self.mode)


class MotionBlur3D(FunctionModule):
    """Module form of :func:`motion_blur3d`; a single angle stands for all three.

    Example:
        >>> import torch, kvision as K
        >>> K.filters.MotionBlur3D(3, (0.0, 0.0, 35.0), 0.5)(torch.rand(1, 1, 4, 8, 8)).shape
        torch.Size([1, 1, 4, 8, 8])
    """

    samples = (VOLUME,)

    def __init__(
        self,
        kernel_size: int,
        angle: Tensor | tuple[float, float, float] | float,
        direction: Tensor | float,
        border_type: Border = "replicate",
        mode: Linear = "nearest",
    ) -> None:
        super().__init__(kernel_size=kernel_size, angle=angle, direction=direction, border_type=border_type, mode=mode)

    def forward(self, x: Tensor) -> Tensor:
        return motion_blur3d(x, self.kernel_size, self.angle, self.direction, self.border_type, self.mode)
