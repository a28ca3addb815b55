"""Blurs, of fixed and of edge-preserving weights, and sharpening by them."""

from kvision.filters.smoothing.bilateral import BilateralBlur, JointBilateralBlur, bilateral_blur, joint_bilateral_blur
from kvision.filters.smoothing.blur_pool import (
    BlurPool2D,
    EdgeAwareBlurPool2D,
    MaxBlurPool2D,
    blur_pool2d,
    edge_aware_blur_pool2d,
    max_blur_pool2d,
)
from kvision.filters.smoothing.box import BoxBlur, box_blur
from kvision.filters.smoothing.gaussian import GaussianBlur2d, gaussian_blur2d
from kvision.filters.smoothing.guided import GuidedBlur, guided_blur
from kvision.filters.smoothing.median import MedianBlur, median_blur
from kvision.filters.smoothing.motion import (
    MotionBlur,
    MotionBlur3D,
    get_motion_kernel2d,
    get_motion_kernel3d,
    motion_blur,
    motion_blur3d,
)
from kvision.filters.smoothing.unsharp import UnsharpMask, unsharp_mask

# Submodules are left out, because `gaussian` would hide the function of that name in kvision.filters.
__all__ = [
    "BilateralBlur",
    "BlurPool2D",
    "BoxBlur",
    "EdgeAwareBlurPool2D",
    "GaussianBlur2d",
    "GuidedBlur",
    "JointBilateralBlur",
    "MaxBlurPool2D",
    "MedianBlur",
    "MotionBlur",
    "MotionBlur3D",
    "UnsharpMask",
    "bilateral_blur",
    "blur_pool2d",
    "box_blur",
    "edge_aware_blur_pool2d",
    "gaussian_blur2d",
    "get_motion_kernel2d",
    "get_motion_kernel3d",
    "guided_blur",
    "joint_bilateral_blur",
    "max_blur_pool2d",
    "median_blur",
    "motion_blur",
    "motion_blur3d",
    "unsharp_mask",
]
