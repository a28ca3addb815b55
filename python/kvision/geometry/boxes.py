"""Boxes of images and volumes as objects, which keep their mode and are transformed with their images."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, get_args

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.bbox import corners, mask_between
from kvision.geometry.collection import Collection

__all__ = ["Boxes", "Boxes3D", "VideoBoxes"]

BoxMode: TypeAlias = Literal["xyxy", "xyxy_plus", "xywh", "vertices", "vertices_plus"]
BoxMode3D: TypeAlias = Literal["xyzxyz", "xyzxyz_plus", "xyzwhd", "vertices", "vertices_plus"]
Translation: TypeAlias = Literal["warp", "fast"]
_TRANSLATIONS = get_args(Translation)
Self = TypeVar("Self", bound="_Boxes")


class _Boxes(Collection):
    """Boxes by their corners, both ends included, in two or three dimensions; normalized ones by their edges."""

    # Two corners with an exclusive end, two corners, corner and size, all corners with an exclusive end, all corners.
    modes: ClassVar[tuple[str, str, str, str, str]]

    def __init__(self, boxes: Tensor | Sequence[Tensor], raise_if_not_floating_point: bool, mode: str) -> None:
        super().__init__("boxes", boxes, raise_if_not_floating_point)
        self._mode = self._known(mode)
        self._normalized = False

    @classmethod
    def _known(cls, mode: Any) -> Any:
        if not isinstance(mode, str):
            raise TypeCheckError(f"{cls.__name__}: expected mode to be a str, got {mode!r}", actual_type=type(mode))
        _check.choice(cls.__name__, "mode", mode.lower(), cls.modes)
        return mode.lower()

    def _like(self, data, valid, counts):
        other = super()._like(data, valid, counts)
        other._mode, other._normalized = self._mode, self._normalized
        return other

    def _put(self, value, write):
        self._check_units(value)
        return super()._put(value, write)

    def _check_units(self, other: _Boxes) -> None:
        if self._normalized != other._normalized:
            raise ValueCheckError(f"{type(self).__name__}: expected boxes that are all normalized, or none, got both")

    @classmethod
    def _exclusive(cls) -> tuple[str, str]:
        """The modes whose end is exclusive."""
        return cls.modes[0], cls.modes[3]

    @property
    def mode(self) -> str:
        """The mode of the boxes that the constructor took."""
        return self._mode

    @property
    def normalized(self) -> bool:
        """Whether the corners are edges in fractions of the image's sizes, not the centers of pixels."""
        return self._normalized

    @classmethod
    def _from_tensor(
        cls: type[Self], boxes: Tensor | Sequence[Tensor], mode: str, validate: bool, is_normalized: bool
    ) -> Self:
        """Boxes of a mode, of one tensor or of a list with one for each image."""
        _check.flag(cls.__name__, "normalized", is_normalized)
        vertices = []
        for part in [boxes] if isinstance(boxes, Tensor) else boxes:
            vertices.append(cls._vertices(part, mode, validate, 0 if is_normalized else 1))
        made = cls(vertices[0] if isinstance(boxes, Tensor) else vertices, False, mode)
        made._normalized = is_normalized
        return made

    @classmethod
    def _vertices(cls, boxes: Tensor, mode: str, validate_boxes: bool, pixel: int) -> Tensor:
        """Convert boxes of a mode to corners: both ends included with a `pixel` of 1, edges with one of 0."""
        axes = cls.item[-1]
        of_corners = mode.startswith("vertices")
        last = cls.item if of_corners else (2 * axes,)
        _check.trailing_shape(cls.__name__, "boxes", boxes, *last)
        if boxes.dim() - len(last) not in (1, 2):
            shape = ", ".join(map(str, last))
            raise ShapeError(
                f"{cls.__name__}: expected boxes of shape (N, {shape}) or (B, N, {shape}) in mode {mode!r}, "
                f"got {tuple(boxes.shape)}",
                actual_shape=boxes.shape,
            )
        boxes = floats(boxes)
        check_values = validate_boxes and _check.values_are_readable(boxes)
        if check_values and not boxes.isfinite().all():
            raise ValueCheckError(f"{cls.__name__}: expected boxes that are finite")
        if of_corners:
            if not (pixel and mode in cls._exclusive()):
                return boxes.clone()
            if check_values:
                cls._warn_of_sides_below_1(boxes.amax(-2) - boxes.amin(-2))
            return boxes - corners(boxes.new_zeros(axes), boxes.new_ones(axes))
        near, far = boxes.split(axes, -1)
        if mode == cls.modes[2]:
            far = near + far - pixel
        elif mode in cls._exclusive():
            far = far - pixel
        if check_values:
            sides = far - near + pixel
            if not (sides > 0).all():
                raise ValueCheckError(f"{cls.__name__}: expected boxes of positive size")
            if pixel:
                cls._warn_of_sides_below_1(sides)
        return corners(near, far)

    @classmethod
    def _warn_of_sides_below_1(cls, sides: Tensor) -> None:
        """Such a side has its last pixel before its first one, so that it comes back as another."""
        if (sides < 1).any():
            warnings.warn(
                f"{cls.__name__}.from_tensor: got boxes with a side below 1, which become others: they are in pixels unless "
                "normalized=True says that they are in fractions of the image",
                stacklevel=5,
            )

    def _in_mode(self, mode: str) -> Tensor:
        near, far = self._data.amin(-2), self._data.amax(-2)
        pixel = 0 if self._normalized else 1
        if mode in self._exclusive():
            far = far + pixel
        elif mode == self.modes[2]:
            far = far - near + pixel
        boxes = corners(near, far) if mode.startswith("vertices") else torch.cat([near, far], -1)
        if self._valid is None:
            return boxes
        return torch.where(self._valid.reshape(*self._valid.shape, *(1,) * (boxes.dim() - self._valid.dim())), boxes, 0)

    def _sizes(self) -> Sequence[Tensor]:
        """Width, height and depth."""
        return self._in_mode(self.modes[2])[..., self.item[-1] :].unbind(-1)

    def _mask_of(self, **sizes: int) -> Tensor:
        for name, size in sizes.items():
            _check.ints(f"{type(self).__name__}.to_mask", name, size, 1)
        boxes = self._in_mode(self.modes[0]).detach()
        if self._normalized:
            boxes = torch.stack([x * n for x, n in zip(boxes.unbind(-1), 2 * [*reversed(sizes.values())])], -1)
        near, end = boxes.round().split(self.item[-1], -1)
        return mask_between(near, end - 1, tuple(sizes.values())).to(self.dtype)


class Boxes(_Boxes):
    """Boxes of images, as quadrangles of corners (x, y) in pixels.

    Corners go clockwise from the top left. They are kept with both ends included: a box of pixels 0 to 9 has corners at 0 and
    9. Methods that are not `inplace` leave the object as it is; none changes the tensors it was made of.

    Args:
        boxes: corners (N, 4, 2), (B, N, 4, 2), or a list with (N, 4, 2) for each image. No mode is converted here:
            :meth:`from_tensor` does.
        raise_if_not_floating_point: refuse integers; else they become float32.
        mode: the form that :meth:`to_tensor` gives by default.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of a shape of Args or the mode is unknown.

    Example:
        >>> import torch, kvision as K
        >>> boxes = K.geometry.Boxes.from_tensor(torch.tensor([[1.0, 2, 5, 8]]), mode="xyxy")
        >>> boxes.get_boxes_shape()
        (tensor([6.]), tensor([4.]))
        >>> boxes.translate(torch.tensor([[10.0, 20.0]])).to_tensor("xywh")
        tensor([[11., 22.,  4.,  6.]])
    """

    item = (4, 2)
    modes = get_args(BoxMode)

    def __init__(
        self,
        boxes: Tensor | Sequence[Tensor],
        raise_if_not_floating_point: bool = True,
        mode: BoxMode = "vertices_plus",
    ) -> None:
        super().__init__(boxes, raise_if_not_floating_point, mode)

    @classmethod
    def from_tensor(
        cls,
        boxes: Tensor | Sequence[Any],
        mode: BoxMode = "xyxy",
        validate_boxes: bool = True,
        normalized: bool = False,
    ) -> Boxes:
        """Boxes from one of their forms.

        Args:
            boxes: (N, 4) or (B, N, 4), corners (N, 4, 2) or (B, N, 4, 2), a list of such tensors for each image, or nested
                lists of numbers. Integers give float32.
            mode: 'xyxy' for first and last corner whose difference is the size, 'xyxy_plus' for the same with both ends
                included, 'xywh' for the first corner and the size, 'vertices' for the corners of the first, 'vertices_plus'
                for those of the second.
            validate_boxes: refuse what is not finite or, but for corners, has no positive size, and warn of sides below 1.
                Boxes on other devices than the CPU are not read, because that would wait for them.
            normalized: `boxes` are edges in fractions of the width and height of the image. They are kept as they are, without
                the 1 of a last pixel, and every mode gives them back; :meth:`to_mask` multiplies them by its sizes.

        Raises:
            TypeError: not of tensors or numbers.
            ValueError: `boxes` is not of a shape of Args, an unknown mode, or bad boxes.

        Example:
            >>> import torch, kvision as K
            >>> boxes = K.geometry.Boxes.from_tensor(torch.tensor([[0.1, 0.2, 0.6, 0.8]]), normalized=True)
            >>> boxes.to_tensor("xywh"), boxes.to_mask(10, 10).sum()
            (tensor([[0.1000, 0.2000, 0.5000, 0.6000]]), tensor(30.))
        """
        mode = cls._known(mode)
        if not isinstance(boxes, (Tensor, list, tuple)):
            raise TypeCheckError(f"{cls.__name__}: expected boxes to be a Tensor or a list, got {type(boxes).__name__}")
        if not isinstance(boxes, Tensor) and boxes and not isinstance(boxes[0], Tensor):
            boxes = torch.tensor(boxes)
        return cls._from_tensor(boxes, mode, validate_boxes, normalized)

    def to_tensor(self, mode: BoxMode | None = None, as_padded_sequence: bool = False) -> Tensor | list[Tensor]:
        """The axis-aligned bounding boxes of the corners, in one of the forms of :meth:`from_tensor`.

        Args:
            mode: the mode of the result, None for that of the constructor.
            as_padded_sequence: return boxes from a list as one tensor, padded with zeros.

        Returns:
            (N, 4) or (B, N, 4), corners (N, 4, 2) or (B, N, 4, 2), or a list. Boxes that were filtered out are 0.
        """
        boxes = self._in_mode(self._mode if mode is None else self._known(mode))
        return boxes if as_padded_sequence else self._unpadded(boxes)

    def get_boxes_shape(self) -> tuple[Tensor, Tensor]:
        """Heights and widths, (N,) or (B, N), both ends included."""
        width, height = self._sizes()
        return height, width

    def to_mask(self, height: int, width: int) -> Tensor:
        """Masks (N, H, W) or (B, N, H, W) of the upright boxes around the corners, whose ends are rounded. No gradient."""
        return self._mask_of(height=height, width=width)

    def compute_area(self) -> Tensor:
        """The areas (N,) or (B, N) of the quadrangles between the centers of the corner pixels.

        So an upright box of width w and height h has (w - 1) (h - 1), as in Kornia; a normalized one has w h.
        """
        a, b, c, d = self._data.unbind(-2)
        x, y = c - a, d - b  # the diagonals
        return (x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]).abs() / 2

    def merge(self, boxes: Boxes, inplace: bool = False) -> Boxes:
        """These boxes and those of the same images in `boxes`, in this order; `inplace` adds them to this object."""
        op = f"{type(self).__name__}.merge"
        if not isinstance(boxes, Boxes):
            raise TypeCheckError(
                f"{op}: expected boxes to be Boxes, got {type(boxes).__name__}", actual_type=type(boxes)
            )
        self._check_units(boxes)
        if self._data.shape[:-3] != boxes._data.shape[:-3]:
            raise ShapeError(
                f"{op}: expected boxes of as many images, got {tuple(self.shape)} and {tuple(boxes.shape)}"
            )
        if self._counts is None and boxes._counts is None:
            counts, data = None, torch.cat([self._data, boxes._data], -3)
            all_valid = self._valid is None and boxes._valid is None
            valid = None if all_valid else torch.cat([self._mask(), boxes._mask()], -1)
        else:  # padding entries stay after the boxes of their image
            pairs = [x._counts or [x._data.shape[1]] * len(x._data) for x in (self, boxes)]
            counts = [i + j for i, j in zip(*pairs)]

            def joined(a: Tensor, b: Tensor) -> Tensor:
                parts = [torch.cat([x[:i], y[:j]]) for x, y, i, j in zip(a, b, *pairs)]
                return pad_sequence(parts, batch_first=True)

            data, valid = joined(self._data, boxes._data), joined(self._mask(), boxes._mask())
        if not inplace:
            return self._like(data, valid, counts)
        self._data, self._valid, self._counts = data, valid, counts
        return self

    def clamp(
        self,
        topleft: Tensor | tuple[float, float] | None = None,
        botright: Tensor | tuple[float, float] | None = None,
        inplace: bool = False,
    ) -> Boxes:
        """Boxes with corners inside of limits.

        Args:
            topleft: the least (x, y), (B, 2), (1, 2) or two numbers for all images; None for no limit.
            botright: the largest (x, y), likewise.
            inplace: change this object.
        """
        op = f"{type(self).__name__}.clamp"
        low, high = self._limit(op, "topleft", topleft), self._limit(op, "botright", botright)
        data = self._data if low is None else torch.maximum(self._data, low)
        return self._changed(data if high is None else torch.minimum(data, high), inplace)

    def _limit(self, op: str, name: str, limit: Any) -> Tensor | None:
        if limit is None:
            return None
        if isinstance(limit, (tuple, list)):
            x, y = (_check.number(op, name, value) for value in limit)
            limit = torch.stack([self._data.new_full((1,), value) for value in (x, y)], -1)
        _check.shape(op, name, limit, "B", 2)
        return self._of_images(op, name, limit)

    def filter_boxes_by_area(
        self, min_area: float | None = None, max_area: float | None = None, inplace: bool = False
    ) -> Boxes:
        """Set boxes to 0 whose area is out of limits. They stay 0 in later calls.

        Args:
            min_area: the least :meth:`compute_area` that is kept; None for no limit.
            max_area: the largest one; None for no limit.
            inplace: change this object.
        """
        area = self.compute_area()
        keep = torch.ones_like(area, dtype=torch.bool)
        if min_area is not None:
            keep = keep & (area >= min_area)
        if max_area is not None:
            keep = keep & (area <= max_area)
        data = torch.where(keep[..., None, None], self._data, 0)
        return self._changed(data, inplace, keep & self._mask())

    def trim(self, correspondence_preserve: bool = False, inplace: bool = False) -> Boxes:
        """Remove boxes that are 0, because they were filtered out or are padding. This waits for the device.

        Args:
            correspondence_preserve: remove only boxes whose index is 0 in all images. Otherwise the boxes of each image move to
                its first indices before.
            inplace: change this object.
        """
        mask = self._mask()
        order = torch.arange(mask.shape[-1], device=mask.device).expand_as(mask)
        if not correspondence_preserve:
            order = (~mask).to(torch.uint8).argsort(dim=-1, stable=True)
        mask = mask.take_along_dim(order, -1)
        any_image = mask.any(0) if self._is_batched else mask
        data = self._data.take_along_dim(order[..., None, None], -3)[..., any_image, :, :]
        valid = mask[..., any_image]
        if not inplace:
            return self._like(data, valid, None)
        self._data, self._valid, self._counts = data, valid, None
        return self

    def transform_boxes(self, M: Tensor, inplace: bool = False) -> Boxes:
        """Transform boxes by homographies (B, 3, 3), or (3, 3) for all images. `inplace` changes this object."""
        return self._transformed("transform_boxes", M, inplace)

    def transform_boxes_(self, M: Tensor) -> Boxes:
        """:meth:`transform_boxes` of this object."""
        return self.transform_boxes(M, inplace=True)

    def translate(self, size: Tensor, method: Translation = "warp", inplace: bool = False) -> Boxes:
        """Translate boxes by (x, y).

        Args:
            size: translations of shape (B, 2), or (1, 2) for all images.
            method: 'warp' or 'fast', which give the same result.
            inplace: change this object.
        """
        op = f"{type(self).__name__}.translate"
        _check.choice(op, "method", method, _TRANSLATIONS)
        _check.shape(op, "size", size, "B", 2)
        return self._changed(self._data + self._of_images(op, "size", size), inplace)


class VideoBoxes(Boxes):
    """Boxes of videos, stored as the :class:`Boxes` of all frames, (B * T, N, 4, 2).

    Create objects with :meth:`from_tensor`. Methods return tensors of shape (B, T, ...). An index selects videos.

    Args:
        boxes: corners of all frames, of shape (B * T, N, 4, 2).
        raise_if_not_floating_point: raise an error for integers. Otherwise they are converted to float32.
        mode: the value of :attr:`mode`.

    Example:
        >>> import torch, kvision as K
        >>> boxes = K.geometry.VideoBoxes.from_tensor(torch.zeros(2, 5, 3, 4, 2))
        >>> boxes.shape, boxes.to_tensor("xyxy").shape
        (torch.Size([10, 3, 4, 2]), torch.Size([2, 5, 3, 4]))
    """

    temporal_channel_size: int  # (B, T, ...): frames of a video

    @classmethod
    def from_tensor(  # type: ignore[override]
        cls, boxes: Tensor, validate_boxes: bool = True, normalized: bool = False
    ) -> VideoBoxes:
        """Boxes from corners (B, T, N, 4, 2), both ends included, or edges if normalized; see :meth:`Boxes.from_tensor`."""
        _check.shape(cls.__name__, "boxes", boxes, "B", "T", "N", 4, 2)
        video_boxes = cls._from_tensor(boxes.flatten(0, 1), "vertices_plus", validate_boxes, normalized)
        video_boxes.temporal_channel_size = boxes.shape[1]
        return video_boxes

    def _like(self, data, valid, counts):
        other = super()._like(data, valid, counts)
        other.temporal_channel_size = self.temporal_channel_size
        return other

    def _of_videos(self, x: Tensor) -> Tensor:
        return x.reshape(x.shape[0] // self.temporal_channel_size, self.temporal_channel_size, *x.shape[1:])

    def __getitem__(self, key: Any) -> VideoBoxes:
        videos = slice(key, key + 1 or None) if isinstance(key, int) else key
        valid = None if self._valid is None else self._of_videos(self._valid)[videos].flatten(0, 1)
        return self._like(self._of_videos(self._data)[videos].flatten(0, 1), valid, None)

    def __setitem__(self, key: Any, value: VideoBoxes) -> None:
        def write(into: Tensor, x: Tensor) -> None:
            self._of_videos(into)[key] = value._of_videos(x)

        data = self._data.clone()
        write(data, value._data)
        self._valid = self._put(value, write)
        self._data = data

    def to_tensor(self, mode: BoxMode | None = None, as_padded_sequence: bool = False) -> Tensor:
        """(B, T, N, 4), or corners (B, T, N, 4, 2), in one of the forms of :meth:`Boxes.from_tensor`."""
        return self._of_videos(self._in_mode(self._mode if mode is None else self._known(mode)))

    def get_boxes_shape(self) -> tuple[Tensor, Tensor]:
        """Heights and widths (B, T, N), both ends included."""
        height, width = super().get_boxes_shape()
        return self._of_videos(height), self._of_videos(width)


class Boxes3D(_Boxes):
    """Boxes of volumes, as corners (x, y, z) in voxels.

    Corners are inclusive. They go clockwise from the top left, first of the front face and then of the back face.

    Args:
        boxes: corners (N, 8, 3) or (B, N, 8, 3). No mode is converted here: :meth:`from_tensor` does.
        raise_if_not_floating_point: refuse integers; else they become float32.
        mode: what :attr:`mode` says.

    Raises:
        TypeError: `boxes` is not a tensor of real numbers.
        ValueError: `boxes` is not of a shape of Args or the mode is unknown.

    Example:
        >>> import torch, kvision as K
        >>> boxes = K.geometry.Boxes3D.from_tensor(torch.tensor([[1.0, 2, 3, 5, 8, 10]]), mode="xyzxyz")
        >>> boxes.get_boxes_shape()
        (tensor([7.]), tensor([6.]), tensor([4.]))
    """

    item = (8, 3)
    modes = get_args(BoxMode3D)

    def __init__(
        self, boxes: Tensor, raise_if_not_floating_point: bool = True, mode: BoxMode3D = "xyzxyz_plus"
    ) -> None:
        super().__init__(boxes, raise_if_not_floating_point, mode)

    @classmethod
    def from_tensor(
        cls, boxes: Tensor, mode: BoxMode3D = "xyzxyz", validate_boxes: bool = True, normalized: bool = False
    ) -> Boxes3D:
        """Boxes from one of their forms.

        Args:
            boxes: (N, 6) or (B, N, 6), or corners (N, 8, 3) or (B, N, 8, 3). Integers give float32.
            mode: 'xyzxyz' for first and last corner whose difference is the size, 'xyzxyz_plus' for the same with both ends
                included, 'xyzwhd' for the first corner and the size, 'vertices' for the corners of the first,
                'vertices_plus' for those of the second.
            validate_boxes: see :meth:`Boxes.from_tensor`.
            normalized: `boxes` are edges in fractions of width, height and depth; see :meth:`Boxes.from_tensor`.

        Raises:
            TypeError: `boxes` is not a tensor of real numbers.
            ValueError: `boxes` is not of a shape of Args, an unknown mode, or bad boxes.
        """
        mode = cls._known(mode)
        _check.is_tensor(cls.__name__, "boxes", boxes)
        return cls._from_tensor(boxes, mode, validate_boxes, normalized)

    def to_tensor(self, mode: BoxMode3D = "xyzxyz") -> Tensor:
        """Axis-aligned bounding boxes of the corners, (N, 6) or (B, N, 6), in one of the forms of :meth:`from_tensor`."""
        return self._in_mode(self._known(mode))

    def get_boxes_shape(self) -> tuple[Tensor, Tensor, Tensor]:
        """Depths, heights and widths, (N,) or (B, N), both ends included."""
        width, height, depth = self._sizes()
        return depth, height, width

    def to_mask(self, depth: int, height: int, width: int) -> Tensor:
        """Masks (N, D, H, W) or (B, N, D, H, W) of the axis-aligned bounding boxes, rounded to voxels. No gradient."""
        return self._mask_of(depth=depth, height=height, width=width)

    def transform_boxes(self, M: Tensor, inplace: bool = False) -> Boxes3D:
        """Transform boxes by homographies of space (B, 4, 4), or (4, 4) for all volumes. `inplace` changes this object."""
        return self._transformed("transform_boxes", M, inplace)

    def transform_boxes_(self, M: Tensor) -> Boxes3D:
        """:meth:`transform_boxes` of this object."""
        return self.transform_boxes(M, inplace=True)
