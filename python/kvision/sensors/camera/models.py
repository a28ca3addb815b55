"""Cameras as objects: a projection of points in the camera's frame, a lens, and their parameters in one vector."""

from __future__ import annotations

from enum import Enum
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.vector import Vector2, Vector3
from kvision.image import ImageSize
from kvision.sensors.camera.lenses import (
    AffineTransform,
    BrownConradyTransform,
    Distortion,
    KannalaBrandtK3Transform,
    OrthographicProjection,
    Projection,
    Z1Projection,
)

__all__ = [
    "BrownConradyModel",
    "CameraModel",
    "CameraModelBase",
    "CameraModelType",
    "KannalaBrandtK3",
    "Orthographic",
    "PinholeModel",
]


class CameraModelType(Enum):
    """Lens and projection of a camera.

    Example:
        >>> from kvision.sensors.camera import CameraModelType
        >>> [kind.name for kind in CameraModelType]
        ['PINHOLE', 'BROWN_CONRADY', 'KANNALA_BRANDT_K3', 'ORTHOGRAPHIC']
    """

    PINHOLE = 0
    BROWN_CONRADY = 1
    KANNALA_BRANDT_K3 = 2
    ORTHOGRAPHIC = 3


class CameraModelBase:
    """A camera of a projection and a lens, or a batch of cameras.

    Points are (x, y, z) in the camera's frame, z forwards, and pixels (x, y), whose centers are whole numbers. Of a batch, the
    points (B, *, 3) of element i belong to camera i.

    Args:
        distortion: the lens, `AffineTransform()`, `BrownConradyTransform()` or `KannalaBrandtK3Transform()`.
        projection: `Z1Projection()` or `OrthographicProjection()`.
        image_size: height and width of the images.
        params: the parameters that the lens names, floating point of shape (N,) or (B, N).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (N,) or (B, N).

    Example:
        >>> import torch, kvision as K
        >>> from kvision.sensors.camera import AffineTransform, CameraModelBase, Z1Projection
        >>> params = torch.tensor([328.0, 328, 320, 240])
        >>> camera = CameraModelBase(AffineTransform(), Z1Projection(), K.image.ImageSize(480, 640), params)
        >>> camera.fx, camera.height
        (tensor(328.), 480)
    """

    def __init__(self, distortion: Distortion, projection: Projection, image_size: ImageSize, params: Tensor) -> None:
        op = type(self).__name__
        sizes = getattr(distortion, "sizes", (distortion.size,))
        _check.floating_trailing_shape(op, "params", params, sizes[0] if len(sizes) == 1 else "n")
        if params.dim() > 2 or params.shape[-1] not in sizes:
            n = sizes[0] if len(sizes) == 1 else "n"
            which = "" if len(sizes) == 1 else f" with n one of {', '.join(map(str, sizes))}"
            raise ShapeError(
                f"{op}: expected params of shape ({n},) or (B, {n}){which}, got {tuple(params.shape)}",
                actual_shape=list(params.shape),
            )
        if not isinstance(image_size, ImageSize):
            raise TypeCheckError(
                f"{op}: expected image_size to be an ImageSize, got {_check.described(image_size)}",
                actual_type=type(image_size),
            )
        self.distortion = distortion
        self.projection = projection
        self._image_size = image_size
        self._params = params

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.image_size}, {self.params})"

    @property
    def image_size(self) -> ImageSize:
        """Height and width of the images."""
        return self._image_size

    @property
    def height(self) -> int:
        """The height of the images."""
        return self._image_size.height

    @property
    def width(self) -> int:
        """The width of the images."""
        return self._image_size.width

    @property
    def params(self) -> Tensor:
        """The parameters (N,) or (B, N)."""
        return self._params

    @property
    def fx(self) -> Tensor:
        """The focal length in x, in pixels."""
        return self._params[..., 0]

    @property
    def fy(self) -> Tensor:
        """The focal length in y, in pixels."""
        return self._params[..., 1]

    @property
    def cx(self) -> Tensor:
        """The principal point's x, in pixels."""
        return self._params[..., 2]

    @property
    def cy(self) -> Tensor:
        """The principal point's y, in pixels."""
        return self._params[..., 3]

    def matrix(self) -> Tensor:
        """The camera matrix, of shape (3, 3) or (B, 3, 3)."""
        return camera_matrix_of(self.fx, self.fy, self.cx, self.cy)

    def K(self) -> Tensor:
        """The camera matrix: :meth:`matrix`."""
        return self.matrix()

    def project(self, points: Vector3) -> Vector2:
        """The pixels of points in the camera's frame."""
        return self.distortion.distort(self._params, self.projection.project(points))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points in the camera's frame that are seen at pixels and have depths z, a number or of shape (*)."""
        return self.projection.unproject(self.distortion.undistort(self._params, points), depth)

    def project_rays(self, rays: Tensor) -> Tensor:
        """The pixels (*, 2) of rays from the camera's center, in directions (*, 3) of any length.

        NaN, without a gradient, for rays that the lens does not show: those that go backwards, and those beyond the field in which
        the lens model is one to one.
        """
        params = self._params_for_rays("project_rays", "rays", rays, 3)
        pixels, valid = self.distortion.distort_rays(params, rays)
        return torch.where(valid[..., None], pixels, torch.nan)

    def unproject_rays(self, pixels: Tensor) -> Tensor:
        """The directions (*, 3), of length 1, of the rays that are seen at pixels (*, 2); NaN for pixels without a ray."""
        params = self._params_for_rays("unproject_rays", "pixels", pixels, 2)
        rays = self.distortion.undistort_rays(params, pixels)
        return rays / torch.linalg.vector_norm(rays, dim=-1, keepdim=True)

    def _params_for_rays(self, method: str, name: str, points: Tensor, size: int) -> Tensor:
        """The parameters on the device and of the type of rays or pixels (*, size)."""
        op = f"{type(self).__name__}.{method}"
        _check.floating_trailing_shape(op, name, points, size)
        if not isinstance(self.projection, Z1Projection):
            raise ValueCheckError(f"{op}: expected a camera whose rays meet in its center, got parallel ones")
        return _check.to_device_of(op, points, "params", as_dtype(self._params, points.dtype), of=name)


class PinholeModel(CameraModelBase):
    """A perspective camera without distortion.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy), floating point of shape (4,) or (B, 4).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (4,) or (B, 4).

    Example:
        >>> import torch, kvision as K
        >>> from kvision.sensors.camera import PinholeModel
        >>> PinholeModel(K.image.ImageSize(480, 640), torch.tensor([328.0, 328, 320, 240])).scale(2).params
        tensor([656., 656., 640., 480.])
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(AffineTransform(), Z1Projection(), image_size, params)

    def scale(self, scale_factor: Tensor | float, *, pixel_centers: bool = False) -> PinholeModel:
        """The camera of images that are resized by a factor.

        Args:
            scale_factor: what height and width are multiplied by, rounded to whole numbers; a number or a tensor of no axes.
            pixel_centers: whether the principal point moves as :func:`kvision.geometry.resize` moves pixels: cx becomes
                s (cx + 1/2) - 1/2, and s cx otherwise, as in Kornia.
        """
        op = "PinholeModel.scale"
        _check.flag(op, "pixel_centers", pixel_centers)
        kept = scale_factor.detach() if isinstance(scale_factor, Tensor) else scale_factor
        number = _check.number(op, "scale_factor", kept, minimum=0.0)
        focal, center = self._params.split(2, -1)
        half = 0.5 if pixel_centers else 0.0
        scaled = torch.cat([focal * scale_factor, (center + half) * scale_factor - half], -1)
        return PinholeModel(ImageSize(round(self.height * number), round(self.width * number)), scaled)


class BrownConradyModel(CameraModelBase):
    """A perspective camera with the distortion of :func:`kvision.geometry.distort_points`.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6), floating point of shape (12,) or (B, 12). 4, 5, 12 or 14
            coefficients instead of 8 are those of `distort_points`.

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of such a shape.

    Example:
        >>> import torch, kvision as K
        >>> from kvision.geometry.vector import Vector3
        >>> params = torch.tensor([10.0, 10, 5, 5, 0.1, 0, 0, 0, 0, 0, 0, 0])
        >>> K.sensors.camera.BrownConradyModel(K.image.ImageSize(10, 10), params).project(Vector3.from_coords(2.0, 0.0, 2.0))
        Vector2(tensor([16.,  5.]))
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(BrownConradyTransform(), Z1Projection(), image_size, params)


class KannalaBrandtK3(CameraModelBase):
    """A fisheye camera of the model of Kannala and Brandt.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy, k1, k2, k3, k4), floating point of shape (8,) or (B, 8).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (8,) or (B, 8).

    Example:
        >>> import torch, kvision as K
        >>> from kvision.geometry.vector import Vector3
        >>> params = torch.tensor([100.0, 100, 0, 0, 0, 0, 0, 0])
        >>> K.sensors.camera.KannalaBrandtK3(K.image.ImageSize(10, 10), params).project(Vector3.from_coords(2.0, 0.0, 2.0))
        Vector2(tensor([78.5398,  0.0000]))
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(KannalaBrandtK3Transform(), Z1Projection(), image_size, params)


class Orthographic(CameraModelBase):
    """A camera whose rays are parallel to z.

    Args:
        image_size: height and width of the images.
        params: (fx, fy, cx, cy), floating point of shape (4,) or (B, 4).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (4,) or (B, 4).

    Example:
        >>> import torch, kvision as K
        >>> from kvision.geometry.vector import Vector3
        >>> camera = K.sensors.camera.Orthographic(K.image.ImageSize(10, 10), torch.tensor([1.0, 1, 5, 5]))
        >>> camera.project(Vector3.from_coords(1.0, 2.0, 9.0))
        Vector2(tensor([6., 7.]))
    """

    def __init__(self, image_size: ImageSize, params: Tensor) -> None:
        super().__init__(AffineTransform(), OrthographicProjection(), image_size, params)


_MODELS: dict[CameraModelType, Any] = {
    CameraModelType.PINHOLE: PinholeModel,
    CameraModelType.BROWN_CONRADY: BrownConradyModel,
    CameraModelType.KANNALA_BRANDT_K3: KannalaBrandtK3,
    CameraModelType.ORTHOGRAPHIC: Orthographic,
}


class CameraModel:
    """A camera of a type that a value chooses. It has the attributes and methods of that class.

    Args:
        image_size: height and width of the images.
        model_type: lens and projection.
        params: the parameters that the class of this type names.

    Raises:
        TypeError: `model_type` is no `CameraModelType`, or an argument is not what the class expects.
        ValueError: `params` is not of the shape that the class expects.

    Example:
        >>> import torch, kvision as K
        >>> from kvision.geometry.vector import Vector2, Vector3
        >>> from kvision.sensors.camera import CameraModel, CameraModelType
        >>> camera = CameraModel(K.image.ImageSize(480, 640), CameraModelType.PINHOLE, torch.tensor([328.0, 328, 320, 240]))
        >>> camera.project(Vector3.from_coords(1.0, 1.0, 2.0))
        Vector2(tensor([484., 404.]))
        >>> camera.unproject(Vector2.from_coords(484.0, 404.0), 2.0)
        Vector3(tensor([1., 1., 2.]))
    """

    def __init__(self, image_size: ImageSize, model_type: CameraModelType, params: Tensor) -> None:
        if not isinstance(model_type, CameraModelType):
            raise TypeCheckError(
                f"CameraModel: expected model_type to be a CameraModelType, got {_check.described(model_type)}",
                actual_type=type(model_type),
            )
        self._model: CameraModelBase = _MODELS[model_type](image_size, params)

    def __getattr__(self, name: str) -> Any:
        if name == "_model":  # of a copy that has no attributes yet
            raise AttributeError(name)
        return getattr(self._model, name)

    def __repr__(self) -> str:
        return f"CameraModel({self.image_size}, {type(self._model).__name__}, {self.params})"
