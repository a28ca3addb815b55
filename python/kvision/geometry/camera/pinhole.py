"""A batch of pinhole cameras: their matrices, poses and image sizes."""

from __future__ import annotations

from typing import Any, Literal, overload

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import floats
from kvision._ops import with_kernel_casts
from kvision.core.exceptions import ShapeError
from kvision.geometry._transform_points import transformed
from kvision.geometry._validity import NEAREST, with_validity
from kvision.geometry.conversions.homogeneous import homogeneous
from kvision.geometry.linalg import inverse3x3

__all__ = ["PinholeCamera"]


class PinholeCamera:
    """Pinhole cameras that look at the world: project its points to pixels, and back at a depth.

    The camera has x to the right, y down and z forwards; the center of the first pixel is (0, 0). It owns copies of its
    tensors, through which gradients go; only :meth:`scale_` and setting `tx`, `ty` and `tz` change it.

    Args:
        intrinsics: (B, 4, 4), with the camera matrix as its first 3 rows and columns; the rest is not read.
        extrinsics: (B, 4, 4), world to camera; its last row is not read.
        height: of the images, (B,).
        width: of the images, (B,).

    Raises:
        TypeError: an argument is not a tensor of real numbers, or matrices of integers.
        ValueError: a shape is not as in Args, or the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> pose, size = torch.eye(4)[None], torch.tensor([10.0])
        >>> intrinsics = torch.diag(torch.tensor([2.0, 2, 1, 1]))[None]
        >>> camera = K.geometry.PinholeCamera(intrinsics, pose, size, size)
        >>> camera.project(torch.tensor([[[1.0, 2.0, 2.0]]]))
        tensor([[[1., 2.]]])
    """

    def __init__(self, intrinsics: Tensor, extrinsics: Tensor, height: Tensor, width: Tensor) -> None:
        op = type(self).__name__
        for name, matrix in (("intrinsics", intrinsics), ("extrinsics", extrinsics)):
            _check.shape(op, name, matrix, "B", 4, 4)
            _check.floating(op, name, matrix)
        _check.shape(op, "extrinsics", extrinsics, intrinsics.shape[0], 4, 4)
        _check.shape(op, "height", height, intrinsics.shape[0])
        _check.shape(op, "width", width, intrinsics.shape[0])
        _check.same_device(op, intrinsics=intrinsics, extrinsics=extrinsics, height=height, width=width)
        self.height = height.clone()
        self.width = width.clone()
        self._intrinsics = intrinsics.clone()
        self._extrinsics = extrinsics.clone()

    @classmethod
    def from_parameters(
        cls,
        fx: Tensor | float,
        fy: Tensor | float,
        cx: Tensor | float,
        cy: Tensor | float,
        height: int,
        width: int,
        tx: Tensor | float,
        ty: Tensor | float,
        tz: Tensor | float,
        batch_size: int,
        device: torch.device | str | None,
        dtype: torch.dtype | None,
    ) -> PinholeCamera:
        """Cameras that are not rotated; each parameter is a number for all or (B,)."""
        like: dict[str, Any] = {"device": device, "dtype": dtype}
        intrinsics = torch.eye(4, **like).repeat(batch_size, 1, 1)
        extrinsics = intrinsics.clone()
        for value, (row, column) in ((fx, (0, 0)), (fy, (1, 1)), (cx, (0, 2)), (cy, (1, 2))):
            intrinsics[:, row, column] = value
        for row, value in enumerate((tx, ty, tz)):
            extrinsics[:, row, 3] = value
        sizes = (torch.full((batch_size,), size, **like) for size in (height, width))
        return cls(intrinsics, extrinsics, *sizes)

    def clone(self) -> PinholeCamera:
        """A copy."""
        return type(self)(self._intrinsics, self._extrinsics, self.height, self.width)

    def device(self) -> torch.device:
        """Where the cameras are."""
        return self._intrinsics.device

    @property
    def intrinsics(self) -> Tensor:
        """(B, 4, 4)."""
        return self._intrinsics

    @property
    def extrinsics(self) -> Tensor:
        """(B, 4, 4), world to camera."""
        return self._extrinsics

    @property
    def batch_size(self) -> int:
        """How many cameras there are."""
        return self._intrinsics.shape[0]

    @property
    def fx(self) -> Tensor:
        """Focal lengths (B,) in pixels."""
        return self._intrinsics[:, 0, 0]

    @property
    def fy(self) -> Tensor:
        """Focal lengths (B,) in pixels."""
        return self._intrinsics[:, 1, 1]

    @property
    def cx(self) -> Tensor:
        """Columns (B,) of the principal points."""
        return self._intrinsics[:, 0, 2]

    @property
    def cy(self) -> Tensor:
        """Rows (B,) of the principal points."""
        return self._intrinsics[:, 1, 2]

    @property
    def tx(self) -> Tensor:
        """Translations (B,) along x; can be set to a number or (B,)."""
        return self._extrinsics[:, 0, 3]

    @tx.setter
    def tx(self, value: Tensor | float) -> None:
        self._extrinsics[:, 0, 3] = value

    @property
    def ty(self) -> Tensor:
        """Translations (B,) along y; can be set to a number or (B,)."""
        return self._extrinsics[:, 1, 3]

    @ty.setter
    def ty(self, value: Tensor | float) -> None:
        self._extrinsics[:, 1, 3] = value

    @property
    def tz(self) -> Tensor:
        """Translations (B,) along z; can be set to a number or (B,)."""
        return self._extrinsics[:, 2, 3]

    @tz.setter
    def tz(self, value: Tensor | float) -> None:
        self._extrinsics[:, 2, 3] = value

    @property
    def rt_matrix(self) -> Tensor:
        """Rotations and translations (B, 3, 4)."""
        return self._extrinsics[:, :3]

    @property
    def camera_matrix(self) -> Tensor:
        """(B, 3, 3)."""
        return self._intrinsics[:, :3, :3]

    @property
    def rotation_matrix(self) -> Tensor:
        """(B, 3, 3)."""
        return self._extrinsics[:, :3, :3]

    @property
    def translation_vector(self) -> Tensor:
        """(B, 3, 1)."""
        return self._extrinsics[:, :3, 3:]

    def intrinsics_inverse(self) -> Tensor:
        """(B, 4, 4), with the inverse of the camera matrix as its first 3 rows and columns."""
        inverse = with_kernel_casts(inverse3x3)(self.camera_matrix)
        return homogeneous(torch.cat([inverse, torch.zeros_like(inverse[..., :1])], -1))

    def scale(self, scale_factor: Tensor | float, pixel_centers: bool = False) -> PinholeCamera:
        """Cameras for images of another size: camera matrix, height and width by a factor.

        Args:
            scale_factor: a number for all or (B,).
            pixel_centers: give the cameras of images after :func:`resize`; see :func:`scale_intrinsics`.

        Example:
            >>> import torch, kvision as K
            >>> image = torch.rand(1, 3, 48, 64)
            >>> intrinsics = torch.eye(4)[None].clone()
            >>> intrinsics[:, :3, :3] = K.geometry.intrinsics_like(50.0, image, pixel_centers=True)
            >>> camera = K.geometry.PinholeCamera(intrinsics, torch.eye(4)[None], torch.tensor([48]), torch.tensor([64]))
            >>> half = camera.scale(0.5, pixel_centers=True)  # of resize(image, (24, 32))
            >>> half.cx, half.scale(2, pixel_centers=True).cx
            (tensor([15.5000]), tensor([31.5000]))
        """
        return self.clone().scale_(scale_factor, pixel_centers)

    def scale_(self, scale_factor: Tensor | float, pixel_centers: bool = False) -> PinholeCamera:
        """:meth:`scale` of these cameras themselves."""
        _check.flag(f"{type(self).__name__}.scale", "pixel_centers", pixel_centers)
        factor = scale_factor[..., None, None] if isinstance(scale_factor, Tensor) else scale_factor
        self._intrinsics = self._intrinsics.clone()
        self._intrinsics[:, :2, :3] *= factor
        if pixel_centers:
            self._intrinsics[:, :2, :3] += self._intrinsics[:, 2:3, :3] * ((factor - 1) / 2)
        self.height = self.height * scale_factor
        self.width = self.width * scale_factor
        return self

    @overload
    def project(self, point_3d: Tensor, return_valid: Literal[False] = False) -> Tensor: ...
    @overload
    def project(self, point_3d: Tensor, return_valid: bool) -> Tensor | tuple[Tensor, Tensor]: ...
    def project(self, point_3d: Tensor, return_valid: bool = False) -> Tensor | tuple[Tensor, Tensor]:
        """Pixels (B, *, 2) of points of the world (B, *, 3); one camera also serves any (*, 3).

        A point is not divided by a depth between -1e-8 and 1e-8; one behind the camera gives a mirrored pixel. With
        `return_valid` also which points are in front of the camera, at a depth above 1e-8, (B, *); the pixels of the
        others have no gradient then.
        """
        self._check_points("project", "point_3d", point_3d, 3)
        _check.flag("PinholeCamera.project", "return_valid", return_valid)
        points, projection = floats(point_3d), _projection(self._intrinsics, self._extrinsics)
        if not return_valid:
            return transformed(points, projection)
        return with_validity(transformed, points, _depth(points, projection) > NEAREST, projection)

    def unproject(self, point_2d: Tensor, depth: Tensor) -> Tensor:
        """Points of the world (B, *, 3) at pixels (B, *, 2) and a depth (B, *, 1), which is z in the camera's frame."""
        self._check_points("unproject", "point_2d", point_2d, 2)
        _check.shape("PinholeCamera.unproject", "depth", depth, *point_2d.shape[:-1], 1)
        scaled = torch.cat([floats(point_2d) * depth, depth.expand_as(point_2d[..., :1])], -1)
        return transformed(scaled, _unprojection(self._intrinsics, self._extrinsics))

    def _check_points(self, method: str, name: str, points: Tensor, axes: int) -> None:
        op = f"{type(self).__name__}.{method}"
        _check.trailing_shape(op, name, points, axes)
        _check.same_device(op, intrinsics=self._intrinsics, **{name: points})
        if self.batch_size != 1 and (points.dim() < 3 or points.shape[0] != self.batch_size):
            raise ShapeError(
                f"{op}: expected {name} of shape ({self.batch_size}, *, {axes}), got {tuple(points.shape)}"
            )


@with_kernel_casts
def _projection(intrinsics: Tensor, extrinsics: Tensor) -> Tensor:
    return intrinsics[:, :3, :3] @ extrinsics[:, :3]


@with_kernel_casts
def _depth(points: Tensor, projection: Tensor) -> Tensor:
    """Depths (B, *) of points (B, *, 3)."""
    row = projection.detach()[:, 2]
    if points.dim() > 1:
        row = row.reshape(-1, *(1,) * (points.dim() - 2), 4)
    else:
        row = row[0]
    return (points.detach() * row[..., :3]).sum(-1) + row[..., 3]


@with_kernel_casts
def _unprojection(intrinsics: Tensor, extrinsics: Tensor) -> Tensor:
    """The matrices that map (x z, y z, z) of the image plane to the world."""
    projection = intrinsics[:, :3, :3] @ extrinsics[:, :3]
    back = inverse3x3(projection[..., :3])
    return homogeneous(torch.cat([back, -back @ projection[..., 3:]], -1))
