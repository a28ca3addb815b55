"""False colors: gray levels shown by a table of colors."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._ops import has_pixels, register
from kvision._torch_compat import ConstantModule
from kvision.color import colormap_data
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

_DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


class ColorMapType(Enum):
    """The named color maps.

    Example:
        >>> import kvision as K
        >>> K.color.ColorMapType.list()[:5]
        ['autumn', 'bone', 'jet', 'winter', 'rainbow']
    """

    autumn = 1
    bone = 2
    jet = 3
    winter = 4
    rainbow = 5
    ocean = 6
    summer = 7
    spring = 8
    cool = 9
    hsv = 10
    brg = 11
    pink = 12
    hot = 13
    plasma = 14
    viridis = 15
    cividis = 16
    twilight = 17
    turbo = 18
    seismic = 19

    @classmethod
    def list(cls) -> list[str]:
        """The names of all maps."""
        return [member.name for member in cls]


class ColorMap:
    """A table of colors.

    The named tables are Kornia's, which have 64 colors of Matplotlib's maps; `twilight` begins in the middle of Matplotlib's,
    as in OpenCV. Other tables have these names in OpenCV: `jet`, `hot`, `pink` and `hsv` (up to 0.09 to 0.21 apart), `rainbow`
    and `ocean` (other colors). `brg` and `seismic` are not in OpenCV.

    Args:
        base: a ColorMapType or its name, which stand for 64 colors, or a list of colors (r, g, b) in [0, 1].
        num_colors: size of the table. The base is resampled linearly, as an image of one row would be.
        device: where the table is.
        dtype: floating-point type of the table; default: torch's.

    Attributes:
        name: the name of the base, "custom" for a list.
        colors: the table, (3, num_colors).

    Raises:
        TypeCheckError: a base of the wrong type, num_colors not an int, dtype not floating point.
        ValueCheckError: an unknown name, colors that are not three numbers, num_colors less than 1.

    Example:
        >>> import kvision as K
        >>> autumn = K.color.ColorMap("autumn", num_colors=3)
        >>> autumn.colors
        tensor([[1.0000, 1.0000, 1.0000],
                [0.1614, 0.5000, 0.8386],
                [0.0000, 0.0000, 0.0000]])
        >>> len(autumn)
        3
    """

    def __init__(
        self,
        base: Sequence[Sequence[float]] | str | ColorMapType,
        num_colors: int = 64,
        device: torch.device | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        (num_colors,) = _check.ints("ColorMap", "num_colors", num_colors, 1)
        dtype = torch.get_default_dtype() if dtype is None else dtype
        if dtype not in _DTYPES:
            raise TypeCheckError(f"ColorMap: expected dtype to be a floating-point type, got {dtype!r}")
        if isinstance(base, str):
            _check.choice("ColorMap", "base", base, ColorMapType.list())
            self.name = base
        else:
            self.name = base.name if isinstance(base, ColorMapType) else "custom"
        colors = _custom(base) if self.name == "custom" else colormap_data.colors(self.name)
        table = torch.tensor(colors, dtype=torch.float64, device="cpu").T
        table = F.interpolate(table[None], size=num_colors, mode="linear", align_corners=False)[0]
        self.colors = table.to(device=device, dtype=dtype)

    def __len__(self) -> int:
        return self.colors.shape[1]

    def __repr__(self) -> str:
        return f"ColorMap({self.name!r}, num_colors={len(self)})"


def _custom(colors: object) -> Sequence[Sequence[float]]:
    if not isinstance(colors, (list, tuple)):
        raise TypeCheckError(
            f"ColorMap: expected base to be a name, a ColorMapType or a list of colors, got {type(colors).__name__}"
        )
    for color in colors:
        if not isinstance(color, (list, tuple)) or len(color) != 3:
            raise ValueCheckError(f"ColorMap: expected base to hold colors (r, g, b), got {color!r}")
        for c in color:
            _check.number("ColorMap", "base", c)
    if not colors:
        raise ValueCheckError("ColorMap: expected base to hold at least one color, got none")
    return colors


def _reference(x: Tensor, white: Tensor, colors: Tensor) -> Tensor:
    """Color images (B, C, H, W) by tables (B or 1, 3, n). The value `white` (B, C) gets the last color."""
    x = x / white[..., None, None]
    n = colors.shape[2]
    index = torch.where(x >= 1, n - 1, (x * max(n - 2, 1)).ceil()).clamp(0, n - 1)
    images = torch.arange(x.shape[0], device=x.device)[:, None, None, None]
    mapped = colors.expand(x.shape[0], -1, -1)[images, :, index.nan_to_num().long()].movedim(-1, 2)
    return torch.where(x.isnan()[:, :, None], torch.nan, mapped).flatten(1, 2)


def _fake(x: Tensor, white: Tensor, colors: Tensor) -> Tensor:
    b, c, *size = x.shape
    return x.new_empty((b, 3 * c, *size))


_table = register("apply_colormap", _reference, fake=_fake, supports=has_pixels)


def apply_colormap(input_tensor: Tensor, colormap: ColorMap) -> Tensor:
    """Map the values of every channel to colors of a table.

    Args:
        input_tensor: images (B, C, H, W) or (C, H, W). Floating-point values are in [0, 1]; a channel of an image that
            has greater ones is divided by 255. Integers are always divided by 255.
        colormap: the table of n colors. 0 gives its first color, 1 its last; what lies between is divided evenly among
            the others but the last. Values outside [0, 1] count as its ends; NaN gives NaN.

    Returns:
        Images (B, 3 C, H, W) in the type of the table, the colors of the first channel first; B is 1 for (C, H, W).
        The gradient goes to the colors.

    Raises:
        TypeCheckError: input_tensor is not a tensor, colormap is not a ColorMap.
        ShapeError: input_tensor has another number of axes.
        DeviceError: a table on another device; one in CPU memory is moved.

    Example:
        >>> import torch, kvision as K
        >>> gray = torch.tensor([[[0.0, 0.5, 1.0]]])
        >>> K.color.apply_colormap(gray, K.color.ColorMap("autumn"))[0, :, 0]
        tensor([[1.0000, 1.0000, 1.0000],
                [0.0000, 0.4921, 1.0000],
                [0.0000, 0.0000, 0.0000]])
    """
    if not isinstance(colormap, ColorMap):
        raise TypeCheckError(
            f"apply_colormap: expected colormap to be a ColorMap, got {type(colormap).__name__}",
            actual_type=type(colormap),
        )
    return _apply(input_tensor, colormap.colors)


def _apply(x: Tensor, colors: Tensor) -> Tensor:
    _check.numbers("apply_colormap", "input_tensor", x)
    if x.dim() not in (3, 4):
        raise ShapeError(
            f"apply_colormap: expected input_tensor of shape (B, C, H, W) or (C, H, W), got {tuple(x.shape)}",
            actual_shape=x.shape,
        )
    colors = _check.to_device_of("apply_colormap", x, "colormap", colors, of="input_tensor")
    x = (x if x.dim() == 4 else x[None]).detach()  # the gradient goes to the colors
    if x.is_floating_point():
        x = x if x.dtype == torch.float64 else x.float()
        white = torch.where((x > 1).flatten(2).any(2), 255.0, 1.0).to(x.dtype)
    else:
        x = x.float()
        white = x.new_full(x.shape[:2], 255)
    return _table(x, white, colors[None].to(x.dtype)).to(colors.dtype)


class ApplyColorMap(ConstantModule):
    """Module form of :func:`apply_colormap`; the table moves with the module.

    Example:
        >>> import torch, kvision as K
        >>> K.color.ApplyColorMap(K.color.ColorMap("jet"))(torch.rand(2, 1, 4, 5)).shape
        torch.Size([2, 3, 4, 5])
    """

    colors: Tensor

    def __init__(self, colormap: ColorMap) -> None:
        super().__init__()
        if not isinstance(colormap, ColorMap):
            raise TypeCheckError(
                f"ApplyColorMap: expected colormap to be a ColorMap, got {type(colormap).__name__}",
                actual_type=type(colormap),
            )
        self.colormap = colormap
        self.register_buffer("colors", colormap.colors, persistent=False)

    def extra_repr(self) -> str:
        return repr(self.colormap)

    def forward(self, input_tensor: Tensor) -> Tensor:
        return _apply(input_tensor, self.colors)
