"""Crops of images. Boxes are (B, 4, 2): corners (x, y) in order from the top left, clockwise, the last pixels included."""

from __future__ import annotations

import math
from typing import Any, Literal, TypeAlias, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._choices import CroppingMode, Interpolation, PaddingOrFill, ResizeInterpolation
from kvision._dtype import as_dtype, compute_dtype
from kvision._modes import INTERPOLATION, WARP_FORMULA
from kvision._modules import FunctionModule
from kvision._ops import register
from kvision._torch_compat import in_function_transform, without_transforms
from kvision.color.frames import Frames
from kvision.constants import AnyResample, Resample
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry._formula import batch_of, register_formula
from kvision.geometry.transform import sampling
from kvision.geometry.transform.antialiased.warp_antialiased import check_antialias, warp_antialiased
from kvision.geometry.transform.frames import check_frames, cropped_frames, reading_of, warped_frames
from kvision.geometry.transform.lists.arguments import check_list, like_batch
from kvision.geometry.transform.lists.warp_list import warped
from kvision.geometry.transform.matrices import crop_matrix
from kvision.geometry.transform.nearest import as_values, of_values
from kvision.geometry.transform.resize import INTERPOLATIONS, resize
from kvision.geometry.transform.warp import warp_affine, warp_perspective

__all__ = [
    "CenterCrop2D",
    "center_crop",
    "crop_and_resize",
    "crop_by_boxes",
    "crop_by_indices",
    "crop_by_transform_mat",
]

ShapeCompensation: TypeAlias = Literal["resize", "pad"]
_COMPENSATIONS = get_args(ShapeCompensation)
_CROPPING_MODES = get_args(CroppingMode)


def _crop_box_checks_reference(quads, others):
    uneven = [q[:, 1] - q[:, 0] - q[:, 2] + q[:, 3] for q in (quads, others)]
    each = [*uneven, others[:, 2] - others[:, 0]]
    batch = batch_of(quads, others)
    return torch.cat([x.expand(batch, 2) for x in each], 1)


# For quadrangles `quads` and `others` (B, 4, 2): the differences (x, y) of opposite sides of both, and width and height of
# `others`, (B, 6). crop_by_boxes reads these on the host, with a single wait for the device.
_crop_box_checks = register_formula("crop_box_checks", _crop_box_checks_reference, lambda *args: (6,))


def _crop_pixels_reference(input, corner, size):
    (y, x), (h, w), (height, width) = corner, size, input.shape[2:]
    return F.pad(input, (-x, x + w - width, -y, y + h - height))


# The pixels of a rectangle, 0 outside of the image. The backward pass is a crop at the negated corner.
_crop_pixels = register(
    "crop",
    _crop_pixels_reference,
    fake=lambda input, corner, size: (*input.shape[:2], *size),
    gradients="input: crop(input=grad, corner=minus(corner), size=sizes(input))",
    linear=True,
    bytes=True,
)


def crop_and_resize(
    input_tensor: Tensor | list[Tensor] | Frames,
    boxes: Tensor,
    size: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    box_indices: Tensor | None = None,
    antialias: bool = False,
) -> Tensor:
    """Resample quadrangles of images to a size; their corners go to the corner pixels of the result.

    With `box_indices`, or with one image, there are any number of boxes for each image. The images are not copied for
    them, and neither is their gradient.

    Args:
        input_tensor: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them. A list of images (C, H, W) may have different sizes. Of video
            :class:`~kvision.color.Frames` 'bilinear' and 'nearest' with 'zeros' or 'border' read the planes; other calls, and
            those with `box_indices` or `antialias`, convert them first.
        boxes: (N, 4, 2), one for each image or all of one image. (1, 4, 2) serves all images.
        size: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection', for boxes that reach out of the image.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        box_indices: (N,), int64 or int32: the image of each of the N boxes, from 0 to B - 1. On a GPU a number out of
            this range is clamped, because reading it would wait for the device. Not for lists.
        antialias: where boxes become smaller, average the pixels that a pixel of the result covers, as `resize` does with
            `antialias`; see :doc:`/conventions`. Only with 'bilinear'.

    Returns:
        (N, C, h, w), of the dtype of `input_tensor`.

    Raises:
        TypeError: `input_tensor` or `boxes` is not a tensor of real numbers; `size` is not two ints; `align_corners` or
            `antialias` is not a bool; `box_indices` is not a tensor of int64 or int32.
        ValueError: `input_tensor` is not (B, C, H, W), or a list without images or of different types, devices or
            numbers of channels; `boxes` is not (N, 4, 2), or N is not the number of images; an entry of `size` is below 1;
            `mode` or `padding_mode` is unknown; `antialias` with another mode than 'bilinear';
            `box_indices` is not (N,) or, on the CPU,
            out of range; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(16.0).reshape(1, 1, 4, 4)
        >>> box = torch.tensor([[[1.0, 1], [3, 1], [3, 3], [1, 3]]])
        >>> K.geometry.crop_and_resize(image, box, (2, 2))
        tensor([[[[ 5.,  7.],
                  [13., 15.]]]])
    """
    op = "crop_and_resize"
    size = _check.ints(op, "size", size, 2)  # type: ignore[assignment]  # two entries by construction
    return _crop(op, input_tensor, boxes, None, size, mode, padding_mode, align_corners, box_indices, antialias)


def crop_by_boxes(
    input_tensor: Tensor,
    src_box: Tensor,
    dst_box: Tensor,
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
    validate_boxes: bool = True,
) -> Tensor:
    """Resample one box of each image into another box of the result, which has the size of that box.

    The size of the result is read from `dst_box`, which waits for the device; :func:`crop_and_resize` does not.

    Args:
        input_tensor: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        src_box: (B, 4, 2), or (1, 4, 2) for all images.
        dst_box: (B, 4, 2), or (1, 4, 2), boxes that all have the same size.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.
        validate_boxes: raise ValueError for boxes that are no rectangles.

    Returns:
        (B, C, h, w), of the dtype of `input_tensor`.

    Raises:
        TypeError: `input_tensor` or a box is not a tensor of real numbers; `align_corners` or `validate_boxes` is not a bool.
        ValueError: `input_tensor` is not (B, C, H, W); a box is not (B, 4, 2) or (1, 4, 2); a box is no rectangle and
            `validate_boxes` is set; the boxes of `dst_box` have different sizes; `mode` or `padding_mode` is unknown;
            the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(16.0).reshape(1, 1, 4, 4)
        >>> box = torch.tensor([[[1.0, 1], [2, 1], [2, 2], [1, 2]]])
        >>> K.geometry.crop_by_boxes(image, box, box - 1)
        tensor([[[[ 5.,  6.],
                  [ 9., 10.]]]])
    """
    op = "crop_by_boxes"
    _check.images(op, "input_tensor", input_tensor)
    _check.shape(op, "src_box", src_box, "B", 4, 2)
    _check.shape(op, "dst_box", dst_box, "B", 4, 2)
    _check.flag(op, "validate_boxes", validate_boxes)
    src_box, dst_box = (
        sampling.cast_to_image(op, input_tensor, name, box)
        for name, box in (("src_box", src_box), ("dst_box", dst_box))
    )
    shapes = rows(_crop_box_checks(src_box.detach(), dst_box.detach()))
    for name, box, of in (("src_box", src_box, slice(0, 2)), ("dst_box", dst_box, slice(2, 4))):
        if validate_boxes and not all(abs(side) <= 1e-4 for shape in shapes for side in shape[of]):
            raise ValueCheckError(f"{op}: expected {name} of rectangles, got {box.tolist()}")
    extents = {(shape[4], shape[5]) for shape in shapes}
    if len(extents) != 1 or not all(map(math.isfinite, *extents)):
        raise ValueCheckError(f"{op}: expected dst_box of one size, got widths and heights less 1 of {sorted(extents)}")
    w, h = (int(side) + 1 for side in extents.pop())
    if not (1 <= w <= _check.LARGEST_INT and 1 <= h <= _check.LARGEST_INT):
        raise ValueCheckError(f"{op}: expected dst_box clockwise from the top left, got a size of {h} by {w} pixels")
    return _crop(op, input_tensor, src_box, dst_box[:, 0], (h, w), mode, padding_mode, align_corners)


def _crop(op, input_tensor, boxes, first, size, mode, padding_mode, align_corners, box_indices=None, antialias=False):
    """Resample the quadrangles `boxes` to the rectangle of `size` with first pixel `first` (B, 2); None for (0, 0)."""
    is_list, is_video = isinstance(input_tensor, list), isinstance(input_tensor, Frames)
    if is_list:
        input_tensor = check_list(op, "input_tensor", input_tensor)
    elif is_video:
        check_frames(op, "input_tensor", input_tensor)
    else:
        _check.images(op, "input_tensor", input_tensor)
    _check.shape(op, "boxes", boxes, "N", 4, 2)
    sampling.check_options(op, mode, padding_mode, align_corners)
    check_antialias(op, antialias, mode)
    if is_video:
        reading = reading_of(mode, padding_mode, None, antialias, True)
        if reading is not None and box_indices is None:
            corners = as_dtype(boxes, compute_dtype(input_tensor._like()))
            matrix = crop_matrix(corners, None, float(max(size[1] - 1, 1)), float(max(size[0] - 1, 1)))
            return warped_frames(op, input_tensor, "boxes", matrix, size, reading)
        input_tensor = input_tensor.rgb()
    if is_list:
        if box_indices is not None:
            raise ValueCheckError(f"{op}: a list takes no box_indices; it may hold an image several times")
        like = like_batch(input_tensor)
        corners = sampling.cast_to_image(op, like, "boxes", boxes)
        matrix = crop_matrix(corners, None, float(max(size[1] - 1, 1)), float(max(size[0] - 1, 1)))
        options = (mode, padding_mode, align_corners)
        return warped(op, input_tensor, "boxes", matrix, list(size), *options, antialias=antialias)
    images = as_values(input_tensor, mode)
    if box_indices is None:
        samples = sampling.count_samples(images, boxes)
    else:
        samples = boxes.shape[0]
        _check_box_indices(op, images, box_indices, samples)
    boxes = sampling.cast_to_image(op, images, "boxes", boxes, samples)
    if first is not None:
        first = sampling.cast_to_image(op, images, "dst_box", first, samples)
    h, w = size
    padding, _ = sampling.padding_and_fill(op, images, padding_mode, None)
    across, down = max(w - 1, 1), max(h - 1, 1)
    options = (list(size), INTERPOLATION[mode], padding, align_corners, False, False)
    if antialias:
        matrix = crop_matrix.definition if _check.is_symbolic(h, w) else crop_matrix
        options = (list(size), padding, align_corners, False, False)
        result = warp_antialiased(images, matrix(boxes, first, across, down), None, box_indices, *options)
        return of_values(result, input_tensor, mode)
    if _check.is_symbolic(h, w):
        matrix = crop_matrix.definition(boxes, first, across, down)
        return of_values(sampling.warp(images, matrix, None, box_indices, *options), input_tensor, mode)
    numbers = [float(across), float(down)]
    tensors = (boxes, first, *[None] * 4, box_indices)
    result = sampling.warp_by_formula(images, *tensors, WARP_FORMULA["crop_matrix"], numbers, *options)
    return of_values(result, input_tensor, mode)


def _check_box_indices(op: str, images: Tensor, box_indices: Tensor, boxes: int) -> None:
    if not isinstance(box_indices, Tensor) or box_indices.dtype not in (torch.int64, torch.int32):
        got = box_indices.dtype if isinstance(box_indices, Tensor) else type(box_indices).__name__
        raise TypeCheckError(f"{op}: expected box_indices to be a Tensor of int64 or int32, got {got}")
    _check.shape(op, "box_indices", box_indices, boxes)
    _check.same_device(op, input_tensor=images, box_indices=box_indices)
    if boxes and _check.values_are_readable(box_indices):
        low, high = (int(bound) for bound in box_indices.aminmax())
        if low < 0 or high >= images.shape[0]:
            raise ValueCheckError(
                f"{op}: expected box_indices from 0 to {images.shape[0] - 1}, got {low if low < 0 else high}"
            )


def crop_by_transform_mat(
    input_tensor: Tensor,
    transform: Tensor,
    out_size: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Warp images and keep the first rows and columns of the result.

    This is :func:`warp_perspective` for matrices (B, 3, 3) and :func:`warp_affine` for (B, 2, 3).

    Args:
        input_tensor: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but nearest modes keep them.
        transform: (B, 3, 3) or (B, 2, 3), from pixels (x, y) of the image to those of the result; one matrix serves all
            images.
        out_size: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border', 'reflection', or 'fill', which is the same as 'zeros' here.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Returns:
        (B, C, h, w), of the dtype of `input_tensor`.

    Raises:
        TypeError: `input_tensor` or `transform` is not a tensor of real numbers; `out_size` is not two ints;
            `align_corners` is not a bool.
        ValueError: `input_tensor` is not (B, C, H, W); `transform` is not (B, 3, 3) or (B, 2, 3); an entry of
            `out_size` is below 1; `mode` or `padding_mode` is unknown; the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(16.0).reshape(1, 1, 4, 4)
        >>> up_left = torch.tensor([[[1.0, 0, -1], [0, 1, -1], [0, 0, 1]]])
        >>> K.geometry.crop_by_transform_mat(image, up_left, (2, 2))
        tensor([[[[ 5.,  6.],
                  [ 9., 10.]]]])
    """
    _check.images("crop_by_transform_mat", "input_tensor", input_tensor)
    _check.numbers("crop_by_transform_mat", "transform", transform)
    if transform.dim() != 3 or transform.shape[1:] not in ((2, 3), (3, 3)):
        raise ShapeError(
            f"crop_by_transform_mat: expected transform of shape (B, 3, 3) or (B, 2, 3), got {tuple(transform.shape)}"
        )
    warp = warp_affine if transform.shape[1] == 2 else warp_perspective
    return warp(input_tensor, transform, out_size, mode, padding_mode, align_corners)


def center_crop(
    input_tensor: Tensor | list[Tensor] | Frames,
    size: tuple[int, int],
    mode: Interpolation = "bilinear",
    padding_mode: PaddingOrFill = "zeros",
    align_corners: bool = True,
) -> Tensor:
    """Crop images around their center.

    The crop lies between pixels, and is interpolated, where the sizes differ by an odd number.

    Args:
        input_tensor: images (B, C, H, W), floating point or uint8. Other integers are computed in float32,
            but 'nearest' and crops at whole pixels keep them. A list of images (C, H, W) may have different sizes. Of video
            :class:`~kvision.color.Frames` crops at whole pixels read the planes; others convert them first.
        size: height and width of the result.
        mode: 'bilinear', 'nearest' or 'bicubic', where the crop lies between pixels.
        padding_mode: 'zeros', 'border' or 'reflection', for sizes larger than the image.
        align_corners: mirror at the centers of the outermost pixels, not at their edges. Only 'reflection' uses it.

    Returns:
        (B, C, h, w), of the dtype of `input_tensor`.

    Raises:
        TypeError: `input_tensor` is not a tensor of real numbers; `size` is not two ints; `align_corners` is not a bool.
        ValueError: `input_tensor` is not (B, C, H, W), or a list without images or of
            different types, devices or numbers of channels; an entry of `size` is below 1; `mode` or `padding_mode` is
            unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.center_crop(torch.arange(16.0).reshape(1, 1, 4, 4), (2, 2))
        tensor([[[[ 5.,  6.],
                  [ 9., 10.]]]])
    """
    op = "center_crop"
    if isinstance(input_tensor, list):
        input_tensor = check_list(op, "input_tensor", input_tensor)
    elif isinstance(input_tensor, Frames):
        check_frames(op, "input_tensor", input_tensor)
    else:
        _check.images(op, "input_tensor", input_tensor)
    h, w = _check.ints("center_crop", "size", size, 2)
    sampling.check_options("center_crop", mode, padding_mode, align_corners)
    if isinstance(input_tensor, Frames):
        y, x = (whole - part for whole, part in zip(input_tensor.shape[2:], (h, w)))
        if y >= 0 and x >= 0 and y % 2 == 0 and x % 2 == 0:
            return cropped_frames(input_tensor, (y // 2, x // 2), (h, w))
        input_tensor = input_tensor.rgb()
    if isinstance(input_tensor, list):
        shifts = [((x.shape[2] - w) / 2, (x.shape[1] - h) / 2) for x in input_tensor]
        matrix = torch.tensor([[[1, 0, x], [0, 1, y]] for x, y in shifts], dtype=torch.float64, device="cpu")
        cropped: Tensor = warped(op, input_tensor, "size", matrix, [h, w], mode, padding_mode, align_corners)
        return cropped
    _, _, height, width = input_tensor.shape
    y, x = height - h, width - w
    symbolic = _check.is_symbolic(y, x)  # their parity is unknown
    if not symbolic and y >= 0 and x >= 0 and y % 2 == 0 and x % 2 == 0:
        values = as_values(input_tensor, "nearest")
        return of_values(_crop_pixels(values, [y // 2, x // 2], [h, w]), input_tensor, "nearest")
    images = as_values(input_tensor, mode)
    padding, _ = sampling.padding_and_fill("center_crop", images, padding_mode, None)
    options = ([h, w], INTERPOLATION[mode], padding, align_corners, False, False)
    if symbolic:
        shift, numbers = sampling.symbolic_point(images, x / 2, y / 2), [0.0, 0.0]
    else:
        shift, numbers = None, [x / 2, y / 2]
    formula = WARP_FORMULA["translation_matrix2d"]
    result = sampling.warp_by_formula(images, shift, *[None] * 6, formula, numbers, *options)
    return of_values(result, input_tensor, mode)


def crop_by_indices(
    input_tensor: Tensor,
    src_box: Tensor,
    size: tuple[int, int] | None = None,
    interpolation: ResizeInterpolation = "bilinear",
    align_corners: bool | None = None,
    antialias: bool = False,
    shape_compensation: ShapeCompensation = "resize",
) -> Tensor:
    """Crop rectangles of whole pixels.

    The boxes are read on the host, which waits for the device.

    Args:
        input_tensor: images (B, C, H, W).
        src_box: (B, 4, 2), whole pixels, the last ones included.
        size: height and width of the result; None for the size of the boxes, which must then all be equal.
        interpolation: see :func:`resize`.
        align_corners: see :func:`resize`.
        antialias: see :func:`resize`.
        shape_compensation: for boxes whose size is not `size`: 'resize' them, or 'pad' them with zeros on the right and
            below.

    Returns:
        (B, C, h, w), of the dtype of `input_tensor`.

    Raises:
        TypeError: `input_tensor` or `src_box` is not a tensor of real numbers; `size` is not two ints.
        ValueError: `input_tensor` is not (B, C, H, W); `src_box` is not (B, 4, 2); the boxes have different sizes and
            `size` is None; an entry of `size` is below 1; `shape_compensation` or `interpolation` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.arange(16).reshape(1, 1, 4, 4)
        >>> K.geometry.crop_by_indices(image, torch.tensor([[[1, 1], [2, 1], [2, 2], [1, 2]]]))
        tensor([[[[ 5,  6],
                  [ 9, 10]]]])
    """
    op = "crop_by_indices"
    _check.images(op, "input_tensor", input_tensor)
    _check.shape(op, "src_box", src_box, len(input_tensor), 4, 2)
    _check.choice(op, "shape_compensation", shape_compensation, _COMPENSATIONS)
    _check.choice(op, "interpolation", interpolation, INTERPOLATIONS)
    boxes = src_box.long()
    corners = rows(torch.cat([boxes[:, 0], boxes[:, 2] + 1], -1))
    if without_transforms(src_box) is not src_box:
        crops = [_windows_of_one_size(op, input_tensor, boxes, corners)]
    else:
        images = [input_tensor] if len(corners) == 1 else input_tensor.split(1)  # whose gradient is copied
        crops = [image[..., y0:y1, x0:x1] for image, (x0, y0, x1, y1) in zip(images, corners)]
    sizes = {tuple(crop.shape[2:]) for crop in crops}
    if size is None:
        if len(sizes) != 1:
            raise ValueCheckError(f"{op}: expected boxes of one size, as no size is given, got {sorted(sizes)}")
        (target,) = sizes
    else:
        target = _check.ints(op, "size", size, 2)
    h, w = target
    if not crops:
        return resize(input_tensor, (h, w), interpolation, align_corners, "short", antialias)
    for i, crop in enumerate(crops):
        if tuple(crop.shape[2:]) == (h, w):
            continue
        if shape_compensation == "pad":
            crops[i] = F.pad(crop, (0, w - crop.shape[3], 0, h - crop.shape[2]))
        else:
            crops[i] = resize(crop, (h, w), interpolation, align_corners, "short", antialias)
    return torch.cat(crops)


def rows(x: Tensor) -> list[list[float]]:
    """The rows of `x` (B, n), which waits for the device; under vmap those of all elements."""
    if in_function_transform():
        x = torch.stack([without_transforms(column).flatten() for column in x.unbind(-1)], -1)
    return x.tolist()


def _windows_of_one_size(op: str, images: Tensor, boxes: Tensor, corners: list[list[float]]) -> Tensor:
    """The pixels of boxes (B, 4, 2) that vmap maps; `corners` are those of all its elements."""
    height, width = images.shape[2:]
    sizes = {(int(y1 - y0), int(x1 - x0)) for x0, y0, x1, y1 in corners}
    if len(sizes) != 1 or not all(0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height for x0, y0, x1, y1 in corners):
        raise ValueCheckError(
            f"{op}: expected src_box of one size and inside of the images under vmap, got (height, width) {sorted(sizes)}; "
            "crop_and_resize takes others"
        )
    ((h, w),) = sizes
    b, c = (torch.arange(n, device=images.device).reshape(-1, *(1,) * axes) for n, axes in zip(images.shape, (3, 2)))
    y, x = (boxes[:, :1, axis, None] + torch.arange(n, device=images.device) for axis, n in ((1, h), (0, w)))
    return images[b, c, y[..., None], x[..., None, :]]


class CenterCrop2D(FunctionModule):
    """Crop images around their center.

    Args:
        size: height and width, or one number for both.
        align_corners: see :func:`center_crop`.
        resample: interpolation of `cropping_mode` 'resample': 'nearest', 'bilinear' or 'bicubic' in upper or lower
            case, or an enum member of that name.
        cropping_mode: 'slice' takes whole pixels, nearer to the top left where the difference is odd; 'resample' calls
            :func:`center_crop`.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.CenterCrop2D((2, 3))(torch.rand(1, 3, 5, 5)).shape
        torch.Size([1, 3, 2, 3])
    """

    def __init__(
        self,
        size: int | tuple[int, int],
        align_corners: bool = True,
        resample: AnyResample = "BILINEAR",
        cropping_mode: CroppingMode = "slice",
    ) -> None:
        _check.choice("CenterCrop2D", "cropping_mode", cropping_mode, _CROPPING_MODES)
        Resample.get(resample)
        size = _check.pair("CenterCrop2D", "size", size, maximum=_check.LARGEST_INT)
        super().__init__(size=size, align_corners=align_corners, resample=resample, cropping_mode=cropping_mode)

    def forward(self, input: Tensor) -> Tensor:
        if self.cropping_mode == "resample":
            mode: Any = Resample.get(self.resample).name.lower()
            return center_crop(input, self.size, mode, "zeros", self.align_corners)
        _check.images("CenterCrop2D", "input", input)
        (h, w), (height, width) = self.size, input.shape[2:]
        if h > height or w > width:
            raise ShapeError(f"CenterCrop2D: expected input of at least {self.size} pixels, got {tuple(input.shape)}")
        y, x = (height - h) // 2, (width - w) // 2
        return input[..., y : y + h, x : x + w]
