"""Cameras as objects, whose lenses and projections are parts."""

from kvision.sensors.camera.lenses import (
    AffineTransform,
    BrownConradyTransform,
    DoubleSphereTransform,
    EnhancedUnifiedTransform,
    EquirectangularTransform,
    KannalaBrandtK3Transform,
    OrthographicProjection,
    Z1Projection,
)
from kvision.sensors.camera.models import (
    BrownConradyModel,
    CameraModel,
    CameraModelBase,
    CameraModelType,
    KannalaBrandtK3,
    Orthographic,
    PinholeModel,
)
from kvision.sensors.camera.spherical import DoubleSphereModel, EnhancedUnifiedModel, EquirectangularModel

__all__ = [
    "AffineTransform",
    "BrownConradyModel",
    "BrownConradyTransform",
    "CameraModel",
    "CameraModelBase",
    "CameraModelType",
    "DoubleSphereModel",
    "DoubleSphereTransform",
    "EnhancedUnifiedModel",
    "EnhancedUnifiedTransform",
    "EquirectangularModel",
    "EquirectangularTransform",
    "KannalaBrandtK3",
    "KannalaBrandtK3Transform",
    "Orthographic",
    "OrthographicProjection",
    "PinholeModel",
    "Z1Projection",
]
