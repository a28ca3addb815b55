"""The reprojection error of points before cameras, with its Jacobian in closed form."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.geometry.liegroup.so3 import skew

__all__ = ["ReprojectionError"]


class ReprojectionError:
    """Residuals of :func:`least_squares`: where cameras see points, less where they were observed, in pixels.

    The variables are "pose", Se3 from world to camera, and "points" (B, N, 3) or (B, K, 3) with an index, unless `points` are
    given. Without an index one pose of each problem sees all points. Pixels have no distortion: undistort them first.

    Args:
        pixels: observations (B, N, 2) as (x, y).
        camera_matrix: (B, 3, 3), upper triangular, or (3, 3) for all.
        points: known points (B, N, 3) of the world; None for a variable.

    Raises:
        TypeError: an argument is not a floating-point tensor.
        ValueError: a shape is not as in Args.

    Example:
        >>> import torch, kvision as K
        >>> points = torch.rand(1, 6, 3, dtype=torch.float64) + torch.tensor([0.0, 0.0, 4.0])
        >>> pixels = 100 * points[..., :2] / points[..., 2:]
        >>> camera = torch.diag(torch.tensor([100.0, 100.0, 1.0])).double()
        >>> error = K.geometry.optim.ReprojectionError(pixels, camera, points)
        >>> start = {"pose": K.geometry.liegroup.Se3.exp(0.05 * torch.ones(1, 6).double())}
        >>> pose = K.geometry.optim.least_squares(error, start).variables["pose"]
        >>> pose.log().abs().max() < 1e-6
        tensor(True)
    """

    def __init__(self, pixels: Tensor, camera_matrix: Tensor, points: Tensor | None = None) -> None:
        op = "ReprojectionError"
        _check.floating_trailing_shape(op, "pixels", pixels, "B", "N", 2)
        _check.floating_trailing_shape(op, "camera_matrix", camera_matrix, 3, 3)
        if points is not None:
            _check.floating_trailing_shape(op, "points", points, "B", "N", 3)
        _check.same_device(op, pixels=pixels, camera_matrix=camera_matrix)
        self.pixels, self.points = pixels, points
        K = camera_matrix[None] if camera_matrix.dim() == 2 else camera_matrix
        self.focal, self.center = K[:, None, :2, :2], K[:, None, :2, 2]

    def _in_camera(self, variables: dict[str, Any]) -> tuple[Any, Tensor]:
        pose, points = variables["pose"], variables.get("points", self.points)
        pose = pose[:, None] if pose.t.dim() == 2 else pose
        return pose, pose * points

    def _error(self, p: Tensor) -> Tensor:
        projected = (self.focal @ (p[..., :2] / p[..., 2:])[..., None])[..., 0]
        return projected + self.center - self.pixels

    def __call__(self, variables: dict[str, Any]) -> Tensor:
        """The errors (B, N, 2)."""
        return self._error(self._in_camera(variables)[1])

    def with_jacobian(self, variables: dict[str, Any]) -> tuple[Tensor, dict[str, Tensor]]:
        """The errors (B, N, 2), and their derivatives (B, N, 2, d) with respect to steps of the variables."""
        pose, p = self._in_camera(variables)
        inverse = 1 / p[..., 2, None]
        of_focal = self.focal * inverse[..., None]
        to_point = torch.cat([of_focal, -of_focal @ (p[..., :2] * inverse)[..., None]], -1)
        jacobian = {"pose": torch.cat([to_point, to_point @ -skew(p)], -1)}  # exp(d) p is p + t + w x p
        if "points" in variables:
            jacobian["points"] = to_point @ pose.r.matrix()
        return self._error(p), jacobian
