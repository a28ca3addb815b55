"""Cameras as objects: a projection of points in the camera's frame, a lens, and their parameters in one vector."""

from __future__ import annotations

from enum import Enum
from typing import Any, Protocol

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._intrinsics import camera_matrix_of
from kvision.geometry.calibration.distortion import distort_points, undistort_points
from kvision.geometry.camera.distortion import (
    distort_points_affine,
    distort_points_kannala_brandt,
    undistort_points_affine,
    undistort_points_kannala_brandt,
)
from kvision.geometry.camera.projection import project_points_orthographic, project_points_z1
from kvision.geometry.vector import Vector2, Vector3
from kvision.image import ImageSize

__all__ = [
    "AffineTransform",
    "BrownConradyModel",
    "BrownConradyTransform",
    "CameraModel",
    "CameraModelBase",
    "CameraModelType",
    "KannalaBrandtK3",
    "KannalaBrandtK3Transform",
    "Orthographic",
    "OrthographicProjection",
    "PinholeModel",
    "Z1Projection",
]


class Distortion(Protocol):
    """A lens: a map between the plane at depth 1 and pixels."""

    size: int  # the number of parameters

    def distort(self, params: Tensor, points: Vector2) -> Vector2: ...

    def undistort(self, params: Tensor, points: Vector2) -> Vector2: ...


class Projection(Protocol):
    """A map between points in the camera's frame and points of a plane."""

    def project(self, points: Vector3) -> Vector2: ...

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3: ...


def _for_points(params: Tensor, points: Tensor) -> Tensor:
    """Parameters (B, N) of the cameras of points (B, *, D), one camera an element of the first axis: (B, 1, ..., N)."""
    if params.dim() == 1 or points.dim() < 2:
        return params
    return params.reshape(params.shape[0], *[1] * (points.dim() - 2), params.shape[1])


# --- projections ----------------------------------------------------------------------------------------------------


class Z1Projection:
    """The perspective projection onto the plane at depth 1.

    Example:
        >>> from kvision.geometry.vector import Vector3
        >>> from kvision.sensors.camera import Z1Projection
        >>> Z1Projection().project(Vector3.from_coords(2.0, 4.0, 2.0))
        Vector2(tensor([1., 2.]))
    """

    def project(self, points: Vector3) -> Vector2:
        """The points (x / z, y / z). They are not finite where z is 0, and mirrored where it is negative."""
        return Vector2(project_points_z1(_data("Z1Projection.project", points, Vector3)))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points of depths z, a number or of shape (*), that project to `points`: (x z, y z, z)."""
        x, y, z = _with_depth("Z1Projection.unproject", points, depth)
        return Vector3.from_coords(x * z, y * z, z)


class OrthographicProjection:
    """The projection along z: (x, y), whatever the depth.

    Example:
        >>> from kvision.geometry.vector import Vector3
        >>> from kvision.sensors.camera import OrthographicProjection
        >>> OrthographicProjection().project(Vector3.from_coords(2.0, 4.0, 2.0))
        Vector2(tensor([2., 4.]))
    """

    def project(self, points: Vector3) -> Vector2:
        """The points (x, y)."""
        return Vector2(project_points_orthographic(_data("OrthographicProjection.project", points, Vector3)))

    def unproject(self, points: Vector2, depth: Tensor | float) -> Vector3:
        """The points of depths z, a number or of shape (*), that project to `points`: (x, y, z)."""
        x, y, z = _with_depth("OrthographicProjection.unproject", points, depth)
        return Vector3.from_coords(x, y, z)


def _with_depth(op: str, points: Vector2, depth: Tensor | float) -> list[Tensor]:
    xy = _data(op, points, Vector2)
    z = depth.to(xy) if isinstance(depth, Tensor) else xy.new_tensor(_check.number(op, "depth", depth))
    _check.broadcastable(op, points=xy.shape[:-1], depth=z.shape)
    return list(torch.broadcast_tensors(xy[..., 0], xy[..., 1], z))


def _data(op: str, points: Any, kind: type[Vector2] | type[Vector3]) -> Tensor:
    if not isinstance(points, kind):
        raise TypeCheckError(
            f"{op}: expected points to be a {kind.__name__}, got {_check.described(points)}", actual_type=type(points)
        )
    return points.data


# --- lenses ---------------------------------------------------------------------------------------------------------


class AffineTransform:
    """No distortion: f p + c. Parameters are (fx, fy, cx, cy).

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import AffineTransform
        >>> AffineTransform().distort(torch.tensor([1.0, 2, 3, 4]), Vector2.from_coords(1.0, 2.0))
        Vector2(tensor([4., 8.]))
    """

    size = 4

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("AffineTransform.distort", points, Vector2)
        return Vector2(distort_points_affine(xy, _for_points(params, xy)))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1."""
        uv = _data("AffineTransform.undistort", points, Vector2)
        return Vector2(undistort_points_affine(uv, _for_points(params, uv)))


class BrownConradyTransform:
    """The distortion of :func:`kvision.geometry.distort_points`. Parameters are (fx, fy, cx, cy, k1, k2, p1, p2, k3, ..., k6).

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import BrownConradyTransform
        >>> params = torch.tensor([10.0, 10, 5, 5, 0.1, 0, 0, 0, 0, 0, 0, 0])
        >>> BrownConradyTransform().distort(params, Vector2.from_coords(1.0, 0.0))
        Vector2(tensor([16.,  5.]))
    """

    size = 12

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("BrownConradyTransform.distort", points, Vector2)
        return Vector2(self._through(xy, params, True))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1; NaN where the lens shows no point."""
        uv = _data("BrownConradyTransform.undistort", points, Vector2)
        return Vector2(self._through(uv, params, False))

    @staticmethod
    def _through(points: Tensor, params: Tensor, to_pixels: bool) -> Tensor:
        of_points = points.dim() == 1 or params.dim() == points.dim() == 2
        given = points[..., None, :] if of_points else points
        params = params if params.dim() == 1 else _for_points(params, given[..., 0, :])
        matrix, dist = camera_matrix_of(*params[..., :4].unbind(-1)), params[..., 4:]
        plane = torch.eye(3, dtype=params.dtype, device=params.device)
        moved = (
            distort_points(given, matrix, dist, plane) if to_pixels else undistort_points(given, matrix, dist, plane)
        )
        return moved.squeeze(-2) if of_points else moved


class KannalaBrandtK3Transform:
    """The lens of :func:`kvision.geometry.camera.distort_points_kannala_brandt`. Parameters are (fx, fy, cx, cy, k1, k2, k3, k4).

    Example:
        >>> import torch
        >>> from kvision.geometry.vector import Vector2
        >>> from kvision.sensors.camera import KannalaBrandtK3Transform
        >>> params = torch.tensor([100.0, 100, 0, 0, 0, 0, 0, 0])
        >>> KannalaBrandtK3Transform().distort(params, Vector2.from_coords(1.0, 0.0))
        Vector2(tensor([78.5398,  0.0000]))
    """

    size = 8

    def distort(self, params: Tensor, points: Vector2) -> Vector2:
        """Points of the plane at depth 1 in pixels."""
        xy = _data("KannalaBrandtK3Transform.distort", points, Vector2)
        return Vector2(distort_points_kannala_brandt(xy, _for_points(params, xy)))

    def undistort(self, params: Tensor, points: Vector2) -> Vector2:
        """Pixels on the plane at depth 1; NaN where it has no point for them."""
        uv = _data("KannalaBrandtK3Transform.undistort", points, Vector2)
        return Vector2(undistort_points_kannala_brandt(uv, _for_points(params, uv)))


# --- cameras --------------------------------------------------------------------------------------------------------


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
        _check.floating_trailing_shape(op, "params", params, distortion.size)
        if params.dim() > 2:
            raise ShapeError(
                f"{op}: expected params of shape ({distortion.size},) or (B, {distortion.size}), got {tuple(params.shape)}",
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
        params: (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6), floating point of shape (12,) or (B, 12).

    Raises:
        TypeError: `params` is not a floating-point tensor, or `image_size` no `ImageSize`.
        ValueError: `params` is not of shape (12,) or (B, 12).

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
