"""Poses as vectors of a quaternion and a translation, in the orders of other libraries."""

from __future__ import annotations

from typing import Literal, TypeAlias

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.conversions.poses import Rt_to_matrix4x4
from kvision.geometry.conversions.rotations import quaternion_to_rotation_matrix, rotation_matrix_to_quaternion

__all__ = ["matrix4x4_to_pose_vector", "pose_vector_to_matrix4x4"]

Order: TypeAlias = Literal["t_xyzw", "xyzw_t", "wxyz_t", "t_wxyz"]
# Where a pose has w, x, y, z, and where the translation.
_ORDERS: dict[Order, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "t_xyzw": ((6, 3, 4, 5), (0, 1, 2)),
    "xyzw_t": ((3, 0, 1, 2), (4, 5, 6)),
    "wxyz_t": ((0, 1, 2, 3), (4, 5, 6)),
    "t_wxyz": ((3, 4, 5, 6), (0, 1, 2)),
}


def pose_vector_to_matrix4x4(pose: Tensor, order: Order) -> Tensor:
    """Convert poses as a quaternion and a translation in one vector to matrices.

    The direction, camera to world or world to camera, stays; :func:`inverse_transformation` turns it.

    Args:
        pose: poses of shape (*, 7). Quaternions of any length but 0 are rotations.
        order: "t_xyzw", as PyPose's SE3 and TUM's trajectories; "xyzw_t", as pycolmap's `Rigid3d.params`; "wxyz_t", as COLMAP's
            images.txt and `Se3.from_qxyz`; or "t_wxyz".

    Returns:
        Poses of shape (*, 4, 4), whose last row is 0 0 0 1.

    Raises:
        TypeError: `pose` is not a floating-point tensor.
        ValueError: `pose` is not of shape (*, 7), or `order` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.pose_vector_to_matrix4x4(torch.tensor([1.0, 2, 3, 0, 0, 0, 1]), "t_xyzw")
        tensor([[1., 0., 0., 1.],
                [0., 1., 0., 2.],
                [0., 0., 1., 3.],
                [0., 0., 0., 1.]])
    """
    _check.choice("pose_vector_to_matrix4x4", "order", order, tuple(_ORDERS))
    _check.floating_trailing_shape("pose_vector_to_matrix4x4", "pose", pose, 7)
    entries = pose.unbind(-1)
    wxyz, t = ([entries[i] for i in indices] for indices in _ORDERS[order])
    R = quaternion_to_rotation_matrix(torch.stack(wxyz, -1))
    return Rt_to_matrix4x4(R, torch.stack(t, -1)[..., None])


def matrix4x4_to_pose_vector(extrinsics: Tensor, order: Order) -> Tensor:
    """Convert pose matrices to a quaternion and a translation in one vector: back from :func:`pose_vector_to_matrix4x4`.

    Args:
        extrinsics: poses of shape (*, 4, 4), rotations and translations.
        order: "t_xyzw", "xyzw_t", "wxyz_t" or "t_wxyz".

    Returns:
        Poses of shape (*, 7) with quaternions of length 1 and of either sign.

    Raises:
        TypeError: `extrinsics` is not a floating-point tensor.
        ValueError: `extrinsics` is not of shape (*, 4, 4), or `order` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> K.geometry.matrix4x4_to_pose_vector(torch.eye(4), "xyzw_t")
        tensor([0., 0., 0., 1., 0., 0., 0.])
    """
    _check.choice("matrix4x4_to_pose_vector", "order", order, tuple(_ORDERS))
    _check.floating_trailing_shape("matrix4x4_to_pose_vector", "extrinsics", extrinsics, 4, 4)
    wxyz, t = rotation_matrix_to_quaternion(extrinsics[..., :3, :3]), extrinsics[..., :3, 3]
    places = [i for indices in _ORDERS[order] for i in indices]
    entries = (*wxyz.unbind(-1), *t.unbind(-1))
    return torch.stack([entries[places.index(i)] for i in range(7)], -1)
