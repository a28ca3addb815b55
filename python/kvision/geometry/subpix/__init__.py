"""Peaks of images and volumes, at pixels and between them."""

from kvision.geometry.subpix.corners import refine_corners
from kvision.geometry.subpix.nms import NonMaximaSuppression2d, NonMaximaSuppression3d, nms2d, nms3d, nms3d_minmax
from kvision.geometry.subpix.quad_interp3d import (
    AdaptiveQuadInterp3d,
    ConvQuadInterp3d,
    IterativeQuadInterp3d,
    conv_quad_interp3d,
    iterative_quad_interp3d,
)
from kvision.geometry.subpix.soft_argmax import (
    ConvSoftArgmax2d,
    ConvSoftArgmax3d,
    conv_soft_argmax2d,
    conv_soft_argmax3d,
)
from kvision.geometry.subpix.spatial import (
    SpatialSoftArgmax2d,
    render_gaussian2d,
    spatial_expectation2d,
    spatial_soft_argmax2d,
    spatial_softmax2d,
)

# Submodules are left out, because `nms` would hide the function of that name in kvision.geometry.
__all__ = [
    "AdaptiveQuadInterp3d",
    "ConvQuadInterp3d",
    "ConvSoftArgmax2d",
    "ConvSoftArgmax3d",
    "IterativeQuadInterp3d",
    "NonMaximaSuppression2d",
    "NonMaximaSuppression3d",
    "SpatialSoftArgmax2d",
    "conv_quad_interp3d",
    "conv_soft_argmax2d",
    "conv_soft_argmax3d",
    "iterative_quad_interp3d",
    "nms2d",
    "nms3d",
    "nms3d_minmax",
    "refine_corners",
    "render_gaussian2d",
    "spatial_expectation2d",
    "spatial_soft_argmax2d",
    "spatial_softmax2d",
]
