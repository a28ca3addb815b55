"""Keypoints of images and volumes as objects, which are transformed with their images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError
from kvision.geometry.collection import Collection

__all__ = ["Keypoints", "Keypoints3D", "VideoKeypoints"]

Self = TypeVar("Self", bound="_Keypoints")


class _Keypoints(Collection):
    def __init__(self, keypoints: Tensor | Sequence[Tensor], raise_if_not_floating_point: bool = True) -> None:
        super().__init__("keypoints", keypoints, raise_if_not_floating_point)

    @classmethod
    def from_tensor(cls: type[Self], keypoints: Tensor | Sequence[Tensor]) -> Self:
        """Keypoints from a tensor; the same as calling the class."""
        return cls(keypoints)

    def to_tensor(self, as_padded_sequence: bool = False) -> Tensor | list[Tensor]:
        """The points as a tensor. Points from a list give a list, or one padded tensor with `as_padded_sequence`."""
        return self._data if as_padded_sequence else self._unpadded(self._data)

    def transform_keypoints(self: Self, M: Tensor, inplace: bool = False) -> Self:
        """The points mapped by homographies, one for each image or one for all. `inplace` changes this object."""
        return self._transformed("transform_keypoints", M, inplace)

    def transform_keypoints_(self: Self, M: Tensor) -> Self:
        """:meth:`transform_keypoints` of this object."""
        return self.transform_keypoints(M, inplace=True)


class Keypoints(_Keypoints):
    """Keypoints (x, y) of images, in pixels.

    Methods return a new object, unless they are `inplace`. :meth:`pad` and :meth:`unpad` change the object. No method changes
    the tensor passed to the constructor.

    Args:
        keypoints: points of shape (N, 2) or (B, N, 2), or a list of tensors (N, 2), one for each image.
        raise_if_not_floating_point: raise an error for integers. Otherwise they are converted to float32.

    Raises:
        TypeError: `keypoints` is not a tensor of real numbers, or is of integers with `raise_if_not_floating_point`.
        ValueError: `keypoints` is not of a shape of Args.

    Example:
        >>> import torch, kvision as K
        >>> points = K.geometry.Keypoints(torch.tensor([[1.0, 2.0]]))
        >>> mirror = torch.tensor([[-1.0, 0, 10], [0, 1, 0], [0, 0, 1]])
        >>> points.transform_keypoints(mirror).to_tensor()
        tensor([[9., 2.]])
    """

    item = (2,)


class Keypoints3D(_Keypoints):
    """Keypoints (x, y, z) of volumes, in voxels.

    The methods are those of :class:`Keypoints`.

    Args:
        keypoints: points of shape (N, 3) or (B, N, 3), or a list of tensors (N, 3), one for each volume.
        raise_if_not_floating_point: raise an error for integers. Otherwise they are converted to float32.

    Raises:
        TypeError: `keypoints` is not a tensor of real numbers, or is of integers with `raise_if_not_floating_point`.
        ValueError: `keypoints` is not of a shape of Args.

    Example:
        >>> import torch, kvision as K
        >>> points = K.geometry.Keypoints3D(torch.tensor([[1.0, 2.0, 3.0]]))
        >>> points.pad(torch.tensor([[1.0, 0, 2, 0, 3, 0]])).to_tensor()
        tensor([[2., 4., 6.]])
    """

    item = (3,)


class VideoKeypoints(Keypoints):
    """Keypoints (x, y) of the frames of videos, in pixels.

    The methods are those of :class:`Keypoints`; :attr:`data` holds the frames of all videos as one batch (B T, N, 2). Make an
    object from videos by :meth:`from_tensor`.

    Args:
        keypoints: points of the frames of one video, (T, N, 2).
        raise_if_not_floating_point: raise an error for integers. Otherwise they are converted to float32.

    Raises:
        TypeError: `keypoints` is not a tensor of real numbers, or is of integers with `raise_if_not_floating_point`.
        ValueError: `keypoints` is not (T, N, 2), or has no frames.

    Example:
        >>> import torch, kvision as K
        >>> points = K.geometry.VideoKeypoints.from_tensor(torch.ones(2, 3, 4, 2))
        >>> points.data.shape, points.to_tensor().shape
        (torch.Size([6, 4, 2]), torch.Size([2, 3, 4, 2]))
    """

    def __init__(self, keypoints: Tensor, raise_if_not_floating_point: bool = True) -> None:
        _check.shape("VideoKeypoints", "keypoints", keypoints, "T", "N", 2)
        super().__init__(keypoints, raise_if_not_floating_point)
        self.temporal_channel_size = keypoints.shape[0]  # T, the frames of each video

    @classmethod
    def from_tensor(  # type: ignore[override]  # Kornia's names
        cls, boxes: Tensor, validate_boxes: bool = True
    ) -> VideoKeypoints:
        """Keypoints of videos.

        Args:
            boxes: points (B, T, N, 2), with T of at least 1.
            validate_boxes: of no effect.

        Returns:
            The object.
        """
        _check.shape("VideoKeypoints", "boxes", boxes, "B", "T", "N", 2)
        if boxes.shape[1] == 0:
            raise ShapeError(f"VideoKeypoints: expected boxes with at least one frame, got {tuple(boxes.shape)}")
        points = cls(boxes.flatten(0, 1))
        points.temporal_channel_size = boxes.shape[1]
        return points

    def _like(self, data: Tensor, valid: Tensor | None, counts: list[int] | None) -> VideoKeypoints:
        other = super()._like(data, valid, counts)
        other.temporal_channel_size = self.temporal_channel_size
        return other

    def to_tensor(self) -> Tensor:  # type: ignore[override]  # nothing is padded
        """The points (B, T, N, 2)."""
        return self._data.unflatten(0, (-1, self.temporal_channel_size))
