"""Derivatives of images and volumes, and edges."""

from kvision.filters.edges.canny import Canny, canny
from kvision.filters.edges.laplacian import Laplacian, laplacian
from kvision.filters.edges.sobel import Sobel, sobel
from kvision.filters.edges.spatial_gradient import (
    SpatialGradient,
    SpatialGradient3d,
    spatial_gradient,
    spatial_gradient3d,
)

# Submodules are left out, because `sobel` would hide the function of that name in kvision.filters.
__all__ = [
    "Canny",
    "Laplacian",
    "Sobel",
    "SpatialGradient",
    "SpatialGradient3d",
    "canny",
    "laplacian",
    "sobel",
    "spatial_gradient",
    "spatial_gradient3d",
]
