"""YUV: luma and its differences from blue and red, in full and with the chroma at half the resolution."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision._leading import apply_on_batch, flatten_batch
from kvision._limits import LUMA
from kvision._ops import has_pixels, register
from kvision.color.matrix import Matrix, affine, inverse, mixed
from kvision.core.exceptions import ShapeError

YUV_FROM_RGB = (
    LUMA,
    (-0.147, -0.289, 0.436),
    (0.615, -0.515, -0.100),
)
RGB_FROM_YUV = inverse(YUV_FROM_RGB)


_rgb_to_yuv = affine(YUV_FROM_RGB)
_yuv_to_rgb = affine(RGB_FROM_YUV)


# --- chroma shared by cells of 1 x 2 or 2 x 2 pixels -----------------------------------------------------------------


def _split(x: Tensor, rows: int, numbers: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Split RGB into the luma of pixels and the chroma of summed cells, by the three rows of a matrix."""
    y = mixed(x, _matrix(numbers))
    return y[:, :1], y[:, 1:].unflatten(2, (-1, rows)).unflatten(4, (-1, 2)).sum((3, 5))


def _join(luma: Tensor, chroma: Tensor, rows: int, numbers: Sequence[float]) -> Tensor:
    """Join the luma of pixels and the chroma of cells to colors, by the three rows of a matrix."""
    whole = chroma.repeat_interleave(rows, 2).repeat_interleave(2, 3).expand(luma.shape[0], -1, -1, -1)
    return mixed(torch.cat([luma, whole], 1), _matrix(numbers))


def _matrix(numbers: Sequence[float]) -> Matrix:
    a, b, c, d, e, f, g, h, i = numbers
    return (a, b, c), (d, e, f), (g, h, i)


def _transposed(numbers: Sequence[float]) -> list[float]:
    return [numbers[3 * j + i] for i in range(3) for j in range(3)]


def _fake_split(x: Tensor, rows: int, numbers: Sequence[float]) -> list[Tensor]:
    b, _, h, w = x.shape
    return [x.new_empty((b, 1, h, w)), x.new_empty((b, 2, h // rows, w // 2))]


def _backward_of_split(needs, luma, chroma, x, rows, numbers):
    return [_join_chroma(luma, chroma, rows, _transposed(numbers))]


def _backward_of_join(needs, grad, luma, chroma, rows, numbers):
    of_luma, of_chroma = _split_chroma(grad, rows, _transposed(numbers))
    return of_luma, of_chroma.sum_to_size(chroma.shape)


_split_chroma = register(
    "split_chroma", _split, fake=_fake_split, backward=_backward_of_split, linear=True, supports=has_pixels
)
_join_chroma = register(
    "join_chroma",
    _join,
    fake=lambda luma, *_: luma.new_empty((luma.shape[0], 3, *luma.shape[2:])),
    backward=_backward_of_join,
    supports=has_pixels,
)
# Chroma is linear, so the chroma of a mean is the mean of the chroma.
_SPLITS = {rows: [w / n for n, row in zip((1, 2 * rows, 2 * rows), YUV_FROM_RGB) for w in row] for rows in (1, 2)}
_JOINS = [w for row in RGB_FROM_YUV for w in row]


def _subsampled(x: Tensor, rows: int) -> tuple[Tensor, Tensor]:
    return _split_chroma(x, rows, _SPLITS[rows])


def _upsampled(luma: Tensor, chroma: Tensor, rows: int) -> Tensor:
    return _join_chroma(luma, chroma.to(luma.dtype), rows, _JOINS)


def rgb_to_yuv(image: Tensor) -> Tensor:
    """RGB to YUV, as analog television has it.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1]. Integers are computed in float32, unscaled.

    Returns:
        Images of the same shape: y in [0, 1], u in [-0.436, 0.436], v in [-0.615, 0.615]; grays have u = v = 0.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> K.color.rgb_to_yuv(torch.tensor([1.0, 0.0, 0.0]).view(3, 1, 1)).flatten()
        tensor([ 0.2990, -0.1470,  0.6150])
    """
    _check.channels("rgb_to_yuv", "image", image, 3)
    return apply_on_batch(_rgb_to_yuv, floats(image))


def yuv_to_rgb(image: Tensor) -> Tensor:
    """YUV to RGB, the inverse of :func:`rgb_to_yuv`.

    Args:
        image: YUV images (*, 3, H, W): y in [0, 1], u in [-0.436, 0.436], v in [-0.615, 0.615].

    Returns:
        RGB images of the same shape, not clamped.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W).

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> K.color.yuv_to_rgb(torch.tensor([0.3, 0.0, 0.0]).view(3, 1, 1)).flatten()
        tensor([0.3000, 0.3000, 0.3000])
    """
    _check.channels("yuv_to_rgb", "image", image, 3)
    return apply_on_batch(_yuv_to_rgb, floats(image))


def rgb_to_yuv420(image: Tensor) -> tuple[Tensor, Tensor]:
    """RGB to YUV 4:2:0: the chroma is the mean of 2 x 2 pixels.

    Encoders of video take other codes: :func:`rgb_to_frames` makes those.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1], H and W even. Integers are computed in float32, unscaled.

    Returns:
        y (*, 1, H, W) and uv (*, 2, H / 2, W / 2), in the ranges of :func:`rgb_to_yuv`.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W), or H or W is odd.

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> y, uv = K.color.rgb_to_yuv420(torch.rand(2, 3, 4, 6))
        >>> y.shape, uv.shape
        (torch.Size([2, 1, 4, 6]), torch.Size([2, 2, 2, 3]))
    """
    _check.channels("rgb_to_yuv420", "image", image, 3)
    _check_even("rgb_to_yuv420", "image", image, 2, 2)
    return apply_on_batch(_subsampled, floats(image), 2)


def rgb_to_yuv422(image: Tensor) -> tuple[Tensor, Tensor]:
    """RGB to YUV 4:2:2: the chroma is the mean of 2 pixels side by side.

    Args:
        image: RGB images (*, 3, H, W) in [0, 1], W even. Integers are computed in float32, unscaled.

    Returns:
        y (*, 1, H, W) and uv (*, 2, H, W / 2), in the ranges of :func:`rgb_to_yuv`.

    Raises:
        TypeCheckError: image is not a tensor.
        ShapeError: image is not (*, 3, H, W), or W is odd.

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> y, uv = K.color.rgb_to_yuv422(torch.rand(2, 3, 4, 6))
        >>> y.shape, uv.shape
        (torch.Size([2, 1, 4, 6]), torch.Size([2, 2, 4, 3]))
    """
    _check.channels("rgb_to_yuv422", "image", image, 3)
    _check_even("rgb_to_yuv422", "image", image, 1, 2)
    return apply_on_batch(_subsampled, floats(image), 1)


def yuv420_to_rgb(imagey: Tensor, imageuv: Tensor) -> Tensor:
    """YUV 4:2:0 to RGB: each chroma serves 2 x 2 pixels.

    This is not what decoders of video give: frames of NV12 or I420 hold codes of Y'CbCr, mostly of limited range, and come
    out flat and in wrong colors here, without an error. :func:`frames_to_rgb` converts those.

    Args:
        imagey: y (*, 1, H, W) in [0, 1], H and W even.
        imageuv: uv (*, 2, H / 2, W / 2), in the ranges of :func:`rgb_to_yuv`; taken in the type of imagey.

    Returns:
        RGB images (*, 3, H, W) in the type of imagey, not clamped.

    Raises:
        TypeCheckError: imagey or imageuv is not a tensor.
        ShapeError: imagey is not (*, 1, H, W) with even H and W; imageuv does not fit it.
        DeviceError: imagey and imageuv on different devices.

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> K.color.yuv420_to_rgb(torch.rand(2, 1, 4, 6), torch.rand(2, 2, 2, 3)).shape
        torch.Size([2, 3, 4, 6])
    """
    return _joined("yuv420_to_rgb", imagey, imageuv, 2, 2)


def yuv422_to_rgb(imagey: Tensor, imageuv: Tensor) -> Tensor:
    """YUV 4:2:2 to RGB: each chroma serves 2 pixels side by side.

    Args:
        imagey: y (*, 1, H, W) in [0, 1], W even.
        imageuv: uv (*, 2, H, W / 2), in the ranges of :func:`rgb_to_yuv`; taken in the type of imagey.

    Returns:
        RGB images (*, 3, H, W) in the type of imagey, not clamped.

    Raises:
        TypeCheckError: imagey or imageuv is not a tensor.
        ShapeError: imagey is not (*, 1, H, W) with even W; imageuv does not fit it.
        DeviceError: imagey and imageuv on different devices.

    Source: ITU-R BT.601, BT.470.

    Example:
        >>> import torch, kvision as K
        >>> K.color.yuv422_to_rgb(torch.rand(2, 1, 4, 6), torch.rand(2, 2, 4, 3)).shape
        torch.Size([2, 3, 4, 6])
    """
    return _joined("yuv422_to_rgb", imagey, imageuv, 1, 2)


def _joined(op: str, luma: Tensor, chroma: Tensor, rows: int, columns: int) -> Tensor:
    _check.channels(op, "imagey", luma, 1)
    _check.channels(op, "imageuv", chroma, 2)
    _check_even(op, "imagey", luma, rows, columns)
    *leading, _, h, w = luma.shape
    expected = (*leading, 2, h // rows, w // columns)
    if chroma.shape != expected:
        raise ShapeError(
            f"{op}: expected imageuv of shape {expected} for imagey of shape {tuple(luma.shape)}, got "
            f"{tuple(chroma.shape)}"
        )
    _check.same_device(op, imagey=luma, imageuv=chroma)
    return apply_on_batch(_upsampled, floats(luma), flatten_batch(chroma), rows)


def _check_even(op: str, name: str, x: Tensor, rows: int, columns: int) -> None:
    if x.shape[-2] % rows or x.shape[-1] % columns:
        even = "H and W" if rows == 2 else "W"
        raise ShapeError(f"{op}: expected {name} with even {even}, got {tuple(x.shape)}")


class RgbToYuv(nn.Module):
    """Module form of :func:`rgb_to_yuv`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.RgbToYuv()(torch.rand(2, 3, 4, 6)).shape
        torch.Size([2, 3, 4, 6])
    """

    def forward(self, input: Tensor) -> Tensor:
        return rgb_to_yuv(input)


class YuvToRgb(nn.Module):
    """Module form of :func:`yuv_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.YuvToRgb()(torch.rand(2, 3, 4, 6)).shape
        torch.Size([2, 3, 4, 6])
    """

    def forward(self, input: Tensor) -> Tensor:
        return yuv_to_rgb(input)


class RgbToYuv420(nn.Module):
    """Module form of :func:`rgb_to_yuv420`.

    Example:
        >>> import torch, kvision as K
        >>> [plane.shape for plane in K.color.RgbToYuv420()(torch.rand(2, 3, 4, 6))]
        [torch.Size([2, 1, 4, 6]), torch.Size([2, 2, 2, 3])]
    """

    def forward(self, yuvinput: Tensor) -> tuple[Tensor, Tensor]:
        return rgb_to_yuv420(yuvinput)


class RgbToYuv422(nn.Module):
    """Module form of :func:`rgb_to_yuv422`.

    Example:
        >>> import torch, kvision as K
        >>> [plane.shape for plane in K.color.RgbToYuv422()(torch.rand(2, 3, 4, 6))]
        [torch.Size([2, 1, 4, 6]), torch.Size([2, 2, 4, 3])]
    """

    def forward(self, yuvinput: Tensor) -> tuple[Tensor, Tensor]:
        return rgb_to_yuv422(yuvinput)


class Yuv420ToRgb(nn.Module):
    """Module form of :func:`yuv420_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.Yuv420ToRgb()(torch.rand(2, 1, 4, 6), torch.rand(2, 2, 2, 3)).shape
        torch.Size([2, 3, 4, 6])
    """

    def forward(self, inputy: Tensor, inputuv: Tensor) -> Tensor:
        return yuv420_to_rgb(inputy, inputuv)


class Yuv422ToRgb(nn.Module):
    """Module form of :func:`yuv422_to_rgb`.

    Example:
        >>> import torch, kvision as K
        >>> K.color.Yuv422ToRgb()(torch.rand(2, 1, 4, 6), torch.rand(2, 2, 4, 3)).shape
        torch.Size([2, 3, 4, 6])
    """

    def forward(self, inputy: Tensor, inputuv: Tensor) -> Tensor:
        return yuv422_to_rgb(inputy, inputuv)
