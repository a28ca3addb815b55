"""Cameras that see more than a half space: fisheye lenses of unified models, and panoramas."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import TypeCheckError
from kvision.geometry.vector import Vector2, Vector3
from kvision.image import ImageSize
from kvision.sensors.camera.lenses import (
    DoubleSphereTransform,
    EnhancedUnifiedTransform,
    EquirectangularTransform,
    Z1Projection,
)
from kvision.sensors.camera.models import CameraModelBase

__all__ = ["DoubleSphereModel", "EnhancedUnifiedModel", "EquirectangularModel"]


class _SphericalModel(CameraModelBase):
    """A camera that sees rays in all directions."""

    def project(self, points: Vector3) -> Vector2:
        """The pixels of points in the camera's frame; NaN for those that it does not see."""
        return Vector2(self.project_rays(points.data))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points in the camera's frame that are seen at pixels, at distances from the camera, a number or of shape (*)."""
        rays = self.unproject_rays(points.data)
        return Vector3(rays * (depth.to(rays)[..., None] if isinstance(depth, Tensor) else depth))


class DoubleSphereModel(_SphericalModel):
    """A fisheye camera of the double sphere model, which the tools around Basalt calibrate.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy, xi, alpha), floating point of shape (6,) or (B, 6).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (6,) or (B, 6).

    Example:
        >>> import torch, kvision as K
        >>> params = torch.tensor([100.0, 100, 320, 240, 0.0, 0.5])
        >>> camera = K.sensors.camera.DoubleSphereModel(K.image.ImageSize(480, 640), params)
        >>> camera.project_rays(torch.tensor([1.0, 0.0, 0.0]))  # 90 degrees from the optical axis
        tensor([520., 240.])
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(DoubleSphereTransform(), Z1Projection(), image_size, params)


class EnhancedUnifiedModel(_SphericalModel):
    """A fisheye camera of the enhanced unified model (EUCM).

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy, alpha, beta), floating point of shape (6,) or (B, 6).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (6,) or (B, 6).

    Example:
        >>> import torch, kvision as K
        >>> params = torch.tensor([100.0, 100, 320, 240, 0.5, 1.0])
        >>> camera = K.sensors.camera.EnhancedUnifiedModel(K.image.ImageSize(480, 640), params)
        >>> camera.project_rays(torch.tensor([1.0, 0.0, 0.0]))
        tensor([520., 240.])
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(EnhancedUnifiedTransform(), Z1Projection(), image_size, params)


class EquirectangularModel(_SphericalModel):
    """A panorama, whose columns are longitudes about y and whose rows are latitudes; the optical axis z is at longitude 0.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy), floating point of shape (4,) or (B, 4), where fx and fy are pixels per radian. None for the whole
            sphere, with z in the middle of the image: :func:`kvision.geometry.reproject_image` joins its first and last column, and
            its rows beyond the poles.

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (4,) or (B, 4).

    Example:
        >>> import torch, kvision as K
        >>> panorama = K.sensors.camera.EquirectangularModel(K.image.ImageSize(180, 360))
        >>> panorama.project_rays(torch.tensor([[0.0, 0, 1], [1, 0, 0], [0, -1, 0]]))
        tensor([[179.5000,  89.5000],
                [269.5000,  89.5000],
                [179.5000,  -0.5000]])
    """

    def __init__(self, image_size: ImageSize, params: Tensor | None = None) -> None:
        self.is_closed = params is None
        if params is None:
            if not isinstance(image_size, ImageSize):
                raise TypeCheckError(
                    f"EquirectangularModel: expected image_size to be an ImageSize, got {_check.described(image_size)}"
                )
            h, w = image_size.height, image_size.width
            params = torch.tensor(
                [w / math.tau, h / math.pi, (w - 1) / 2, (h - 1) / 2], dtype=torch.float64, device="cpu"
            )
        super().__init__(EquirectangularTransform(), Z1Projection(), image_size, params)

    def project_rays(self, rays: Tensor) -> Tensor:
        """The pixels of rays. Of all columns of a longitude this is the one nearest to the middle of the image."""
        x, y = super().project_rays(rays).unbind(-1)
        turn = (math.tau * self.fx).to(x)
        turn = turn.reshape(turn.shape + (1,) * (x.dim() - turn.dim()))
        return torch.stack([x - turn * (((x - (self.width - 1) / 2) / turn).detach().round()), y], -1)
