"""A batch of rectified stereo cameras: depth from disparity."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision import _check
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry.conversions.homogeneous import divisor
from kvision.geometry.grid import create_meshgrid

__all__ = ["StereoCamera"]


class StereoCamera:
    """Rectified stereo pairs: two cameras that differ by a horizontal translation, and in the columns of principal points.

    A point of disparity d has depth Z = fx tx / (d + cx_right - cx_left).

    Args:
        rectified_left_camera: projection matrices (B, 3, 4).
        rectified_right_camera: projection matrices (B, 3, 4), equal but for the columns of the principal points and the last
            column, whose first entry, -fx times the distance of the cameras, is negative. Cameras on other devices than the
            CPU are not read to see whether that is so, because it would wait for them.

    Raises:
        TypeError: `rectified_left_camera` or `rectified_right_camera` is not a floating-point tensor, or the types differ.
        ValueError: a shape or value is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> left = torch.tensor([[[100.0, 0, 4, 0], [0, 100, 3, 0], [0, 0, 1, 0]]])
        >>> right = left.clone()
        >>> right[:, 0, 3] = -50
        >>> pair = K.geometry.StereoCamera(left, right)
        >>> pair.reproject_disparity_to_3D(torch.full((1, 1, 1, 1), 25.0))
        tensor([[[[-0.0800, -0.0600,  2.0000]]]])
    """

    def __init__(self, rectified_left_camera: Tensor, rectified_right_camera: Tensor) -> None:
        op, left, right = type(self).__name__, rectified_left_camera, rectified_right_camera
        _check.shape(op, "rectified_left_camera", left, "B", 3, 4)
        _check.floating(op, "rectified_left_camera", left)
        _check.shape(op, "rectified_right_camera", right, *left.shape)
        _check.same_device(op, rectified_left_camera=left, rectified_right_camera=right)
        if left.dtype != right.dtype:
            raise TypeCheckError(f"{op}: expected cameras of one type, got {left.dtype} and {right.dtype}")
        if _check.values_are_readable(left):
            differs = left[..., :3] != right[..., :3]
            differs[:, 0, 2] = False
            if differs.any():
                raise ValueCheckError(
                    f"{op}: expected cameras that are equal but for [:, 0, 2] and their last column, got others"
                )
            if not (right[:, 0, 3] < 0).all():
                raise ValueCheckError(
                    f"{op}: expected rectified_right_camera[:, 0, 3] to be negative, -fx times a distance"
                )
        self.rectified_left_camera = left
        self.rectified_right_camera = right
        self.device = left.device
        self.dtype = left.dtype

    @property
    def batch_size(self) -> int:
        """How many pairs there are."""
        return self.rectified_left_camera.shape[0]

    @property
    def fx(self) -> Tensor:
        """Focal lengths (B,) in pixels."""
        return self.rectified_left_camera[:, 0, 0]

    @property
    def fy(self) -> Tensor:
        """Focal lengths (B,) in pixels."""
        return self.rectified_left_camera[:, 1, 1]

    @property
    def cx_left(self) -> Tensor:
        """Columns (B,) of the left cameras' principal points."""
        return self.rectified_left_camera[:, 0, 2]

    @property
    def cx_right(self) -> Tensor:
        """Columns (B,) of the right cameras' principal points."""
        return self.rectified_right_camera[:, 0, 2]

    @property
    def cy(self) -> Tensor:
        """Rows (B,) of the principal points."""
        return self.rectified_left_camera[:, 1, 2]

    @property
    def tx(self) -> Tensor:
        """The distances (B,) of the cameras, which are positive."""
        return -self.rectified_right_camera[:, 0, 3] / self.fx

    @property
    def Q(self) -> Tensor:
        """The homographies (B, 4, 4) from (x, y, disparity) to points of the left cameras' frames."""
        return with_kernel_casts(_reprojection)(self.rectified_left_camera, self.rectified_right_camera)

    def reproject_disparity_to_3D(
        self, disparity_tensor: Tensor, return_mask: bool = False
    ) -> Tensor | tuple[Tensor, Tensor]:
        """Points of the left cameras' frames at all pixels.

        Args:
            disparity_tensor: by how many pixels a point is farther left in the right image, (B, H, W, 1).
            return_mask: say where the points are some, too.

        Returns:
            (B, H, W, 3); where the disparity puts a point at infinity it is not divided. With `return_mask` also where it is
            finite, (B, H, W, 1).

        Raises:
            TypeError: `disparity_tensor` is not a floating-point tensor.
            ValueError: `disparity_tensor` is not of shape (B, H, W, 1), or not on the device of the cameras.
        """
        op = f"{type(self).__name__}.reproject_disparity_to_3D"
        _check.shape(op, "disparity_tensor", disparity_tensor, "B", "H", "W", 1)
        _check.floating(op, "disparity_tensor", disparity_tensor)
        _check.same_device(op, cameras=self.rectified_left_camera, disparity_tensor=disparity_tensor)
        if not _check.is_one_or(self.batch_size, disparity_tensor.shape[0]):
            raise ShapeError(f"{op}: expected {self.batch_size} disparity maps, got {tuple(disparity_tensor.shape)}")
        points, divides = _reprojected(disparity_tensor, self.rectified_left_camera, self.rectified_right_camera)
        if not return_mask:
            return points
        return points, points.isfinite().all(-1, keepdim=True) & (divides != 0)


def _reprojection(left: Tensor, right: Tensor) -> Tensor:
    fx, fy, cx, cy = left[:, 0, 0], left[:, 1, 1], left[:, 0, 2], left[:, 1, 2]
    o, base = torch.zeros_like(fx), right[:, 0, 3] / fx
    rows = [
        *(fy * base, o, o, -fy * cx * base),
        *(o, fx * base, o, -fx * cy * base),
        *(o, o, o, fx * fy * base),
        *(o, o, -fy, fy * (cx - right[:, 0, 2])),
    ]
    return torch.stack(rows, -1).unflatten(-1, (4, 4))


@with_kernel_casts
def _reprojected(disparity: Tensor, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """The points, and 1 where the homogeneous division applied."""
    Q = _reprojection(left, right).to(disparity.dtype)[:, None, None]
    _, height, width, _ = disparity.shape
    pixels = create_meshgrid(height, width, False, disparity.device, disparity.dtype)
    image_points = torch.cat([pixels.expand(disparity.shape[0], -1, -1, -1), disparity], -1)
    moved = Q[..., 3]
    for i, x in enumerate(image_points.split(1, -1)):
        moved = moved + x * Q[..., i]
    w = moved[..., 3:]
    return moved[..., :3] / divisor(w), (w.abs() > 1e-8).to(disparity.dtype)
