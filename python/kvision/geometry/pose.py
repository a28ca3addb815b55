"""Poses with the names of their source and target frames."""

from __future__ import annotations

import uuid

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.liegroup import Se2, Se3, So2, So3
from kvision.geometry.linalg import transform_points
from kvision.geometry.quaternion import Quaternion

__all__ = ["NamedPose"]


class NamedPose:
    """Rigid transformations from the points of one frame to those of another, in the plane or in space.

    Args:
        dst_from_src: an Se2 or Se3; or (3, 3), (4, 4), (B, 3, 3) or (B, 4, 4): a rotation and a translation, with
            0 ... 0 1 below.
        frame_src: the name of the frame that points come from; None makes one up.
        frame_dst: the name of the frame that points go to; None makes one up.

    Raises:
        TypeError: `dst_from_src` is neither Se2, Se3 nor a floating-point tensor.
        ValueError: `dst_from_src` is not of a shape of Args.

    Example:
        >>> import torch, kvision as K
        >>> move = torch.eye(3)
        >>> move[0, 2] = 2
        >>> map_from_robot = K.geometry.NamedPose(move, "robot", "map")
        >>> robot_from_camera = K.geometry.NamedPose(move, "camera", "robot")
        >>> map_from_camera = map_from_robot * robot_from_camera
        >>> map_from_camera.frame_src, map_from_camera.frame_dst, map_from_camera.transform_points(torch.zeros(1, 2))
        ('camera', 'map', tensor([[4., 0.]]))
    """

    def __init__(
        self, dst_from_src: Tensor | Se2 | Se3, frame_src: str | None = None, frame_dst: str | None = None
    ) -> None:
        self._pose = dst_from_src
        self._frame_src = frame_src or uuid.uuid4().hex
        self._frame_dst = frame_dst or uuid.uuid4().hex
        if isinstance(dst_from_src, (Se2, Se3)):
            return
        _check.numbers("NamedPose", "dst_from_src", dst_from_src)
        _check.floating("NamedPose", "dst_from_src", dst_from_src)
        if dst_from_src.dim() not in (2, 3) or dst_from_src.shape[-2:] not in ((3, 3), (4, 4)):
            raise ShapeError(
                f"NamedPose: expected dst_from_src of shape (3, 3), (4, 4), (B, 3, 3) or (B, 4, 4), "
                f"got {tuple(dst_from_src.shape)}",
                actual_shape=dst_from_src.shape,
            )

    @classmethod
    def from_matrix(cls, matrix: Tensor, frame_src: str | None = None, frame_dst: str | None = None) -> NamedPose:
        """The same as the class itself."""
        return cls(matrix, frame_src, frame_dst)

    @classmethod
    def from_rt(
        cls,
        rotation: Tensor | Quaternion | So2 | So3,
        translation: Tensor,
        frame_src: str | None = None,
        frame_dst: str | None = None,
    ) -> NamedPose:
        """Poses of rotations (2, 2), (3, 3), (B, 2, 2), (B, 3, 3) or quaternions, and translations (n,) or (B, n).

        The pose of a So2 or So3 is an Se2 or Se3, that of the others a matrix.
        """
        if isinstance(rotation, (So2, So3)):
            pose = Se2(rotation, translation) if isinstance(rotation, So2) else Se3(rotation, translation)
            return cls(pose, frame_src, frame_dst)
        R = rotation.matrix() if isinstance(rotation, Quaternion) else rotation
        _check.numbers("NamedPose.from_rt", "rotation", R)
        if R.dim() not in (2, 3) or R.shape[-2:] not in ((2, 2), (3, 3)):
            raise ShapeError(f"NamedPose.from_rt: expected rotation of shape (2, 2) or (3, 3), got {tuple(R.shape)}")
        _check.shape("NamedPose.from_rt", "translation", translation, *R.shape[:-1])
        _check.same_device("NamedPose.from_rt", rotation=R, translation=translation)
        return cls(homogeneous(torch.cat([R, translation[..., None]], -1)), frame_src, frame_dst)

    def __repr__(self) -> str:
        return f"NamedPose({self._pose}, frame_src={self._frame_src!r}, frame_dst={self._frame_dst!r})"

    def __mul__(self, other: NamedPose) -> NamedPose:
        """Apply `other` first, then this pose, whose source frame must be the target frame of `other`."""
        if not isinstance(other, NamedPose):
            raise TypeCheckError(f"NamedPose: expected a NamedPose to follow, got {type(other).__name__}")
        if self._frame_src != other._frame_dst:
            raise ValueCheckError(
                f"NamedPose: expected a pose that leads to {self._frame_src!r}, got one that leads to {other._frame_dst!r}"
            )
        if isinstance(self._pose, (Se2, Se3)) and type(self._pose) is type(other._pose):
            return NamedPose(self._pose * other._pose, other._frame_src, self._frame_dst)
        left, right = self.matrix(), other.matrix()
        if left.shape[-1] != right.shape[-1]:
            raise ShapeError(
                f"NamedPose: expected poses of one dimension, got {tuple(left.shape)} and {tuple(right.shape)}"
            )
        _check.broadcastable("NamedPose", left=left.shape[:-2], right=right.shape[:-2])
        return NamedPose(with_kernel_casts(torch.matmul)(left, right), other._frame_src, self._frame_dst)

    @property
    def pose(self) -> Tensor | Se2 | Se3:
        """The transformations, of the kind and shape of the constructor's argument."""
        return self._pose

    def matrix(self) -> Tensor:
        """The transformations as matrices, (n + 1, n + 1) or (B, n + 1, n + 1)."""
        return self._pose if isinstance(self._pose, Tensor) else self._pose.matrix()

    @property
    def rotation(self) -> Tensor | So2 | So3:
        """(n, n) or (B, n, n), or a So2 or So3 where the pose is an Se2 or Se3."""
        return self._pose[..., :-1, :-1] if isinstance(self._pose, Tensor) else self._pose.rotation

    @property
    def translation(self) -> Tensor:
        """(n,) or (B, n)."""
        return self._pose[..., :-1, -1] if isinstance(self._pose, Tensor) else self._pose.translation

    @property
    def frame_src(self) -> str:
        """The name of the frame that points come from."""
        return self._frame_src

    @property
    def frame_dst(self) -> str:
        """The name of the frame that points go to."""
        return self._frame_dst

    def inverse(self) -> NamedPose:
        """The inverse transformations."""
        if not isinstance(self._pose, Tensor):
            return NamedPose(self._pose.inverse(), self._frame_dst, self._frame_src)
        back = self._pose[..., :-1, :-1].mT
        moved = -(back * self.translation[..., None, :]).sum(-1, keepdim=True)
        return NamedPose(homogeneous(torch.cat([back, moved], -1)), self._frame_dst, self._frame_src)

    def transform_points(self, points_in_src: Tensor) -> Tensor:
        """Points (*, n), or (B, *, n) with a pose each, in the other frame."""
        return transform_points(self.matrix(), points_in_src)
