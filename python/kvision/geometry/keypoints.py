"""Key points of images and volumes as objects that move with their images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from torch import Tensor

from kvision.geometry.collection import Collection

__all__ = ["Keypoints", "Keypoints3D"]

Self = TypeVar("Self", bound="_Keypoints")


class _Keypoints(Collection):
    def __init__(self, keypoints: Tensor | Sequence[Tensor], raise_if_not_floating_point: bool = True) -> None:
        super().__init__("keypoints", keypoints, raise_if_not_floating_point)

    @classmethod
    def from_tensor(cls: type[Self], keypoints: Tensor | Sequence[Tensor]) -> Self:
        """The same as the class itself."""
        return cls(keypoints)

    def to_tensor(self, as_padded_sequence: bool = False) -> Tensor | list[Tensor]:
        """The points; where they were given as a list, a list, or one padded tensor with `as_padded_sequence`."""
        return self._data if as_padded_sequence else self._unpadded(self._data)

    def transform_keypoints(self: Self, M: Tensor, inplace: bool = False) -> Self:
        """Points after homographies, one for each image or one for all; `inplace` changes this object."""
        return self._transformed("transform_keypoints", M, inplace)

    def transform_keypoints_(self: Self, M: Tensor) -> Self:
        """:meth:`transform_keypoints` of this object."""
        return self.transform_keypoints(M, inplace=True)


class Keypoints(_Keypoints):
    """Points (x, y) of images, in pixels.

    Methods that are not `inplace` leave the object as it is, except :meth:`pad` and :meth:`unpad`; none changes the tensor it
    was made of.

    Args:
        keypoints: (N, 2), (B, N, 2), or a list with (N, 2) for each image.
        raise_if_not_floating_point: refuse integers; else they become float32.

    Raises:
        TypeError: no tensor of real numbers, or integers.
        ValueError: another shape.

    Example:
        >>> import torch, kvision as K
        >>> points = K.geometry.Keypoints(torch.tensor([[1.0, 2.0]]))
        >>> mirror = torch.tensor([[-1.0, 0, 10], [0, 1, 0], [0, 0, 1]])
        >>> points.transform_keypoints(mirror).to_tensor()
        tensor([[9., 2.]])
    """

    item = (2,)


class Keypoints3D(_Keypoints):
    """Points (x, y, z) of volumes, in voxels: (N, 3), (B, N, 3) or a list with (N, 3) for each volume; see :class:`Keypoints`.

    Example:
        >>> import torch, kvision as K
        >>> points = K.geometry.Keypoints3D(torch.tensor([[1.0, 2.0, 3.0]]))
        >>> points.pad(torch.tensor([[1.0, 0, 2, 0, 3, 0]])).to_tensor()
        tensor([[2., 4., 6.]])
    """

    item = (3,)
