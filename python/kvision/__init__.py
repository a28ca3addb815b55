"""kvision: differentiable computer vision for PyTorch with hand-written CPU and CUDA kernels.

    >>> import torch, kvision as K
    >>> K.filters.sobel(torch.rand(1, 3, 8, 8)).shape
    torch.Size([1, 3, 8, 8])

`kvision.info()` prints what was built and which types of which device the kernels serve.
"""

import importlib
from typing import Any

from kvision import (
    color,
    constants,
    contrib,
    core,
    enhance,
    filters,
    geometry,
    image,
    io,
    losses,
    metrics,
    morphology,
    utils,
)
from kvision._ops import backend
from kvision._version import __version__

# Names at the top level: those in the examples of Kornia's paper, and those that Kornia 0.9 has there.
from kvision.color import bgr_to_rgb, rgb_to_grayscale
from kvision.contrib import extract_tensor_patches
from kvision.enhance import normalize
from kvision.filters import gaussian_blur2d, sobel
from kvision.geometry import (
    ConvQuadInterp3d,
    DepthWarper,
    HomographyWarper,
    ScalePyramid,
    find_homography_dlt_iterated,
    get_perspective_transform,
    homography_warp,
    normal_transform_pixel,
    pyrdown,
    warp_perspective,
)
from kvision.image import (
    draw_convex_polygon,
    draw_line,
    draw_point2d,
    draw_rectangle,
    image_to_string,
    image_to_tensor,
    print_image,
    tensor_to_image,
)
from kvision.losses import dice_loss, focal_loss, psnr_loss, ssim_loss, tversky_loss
from kvision.utils import (
    get_cuda_device_if_available,
    get_cuda_or_mps_device_if_available,
    get_mps_device_if_available,
    is_autocast_enabled,
    xla_is_available,
)

__all__ = [
    "ConvQuadInterp3d",
    "DepthWarper",
    "HomographyWarper",
    "ScalePyramid",
    "__version__",
    "backend",
    "bgr_to_rgb",
    "color",
    "constants",
    "contrib",
    "core",
    "dice_loss",
    "draw_convex_polygon",
    "draw_line",
    "draw_point2d",
    "draw_rectangle",
    "enhance",
    "extract_tensor_patches",
    "filters",
    "find_homography_dlt_iterated",
    "focal_loss",
    "gaussian_blur2d",
    "geometry",
    "get_cuda_device_if_available",
    "get_cuda_or_mps_device_if_available",
    "get_mps_device_if_available",
    "get_perspective_transform",
    "homography_warp",
    "image",
    "image_to_string",
    "image_to_tensor",
    "info",
    "io",
    "is_autocast_enabled",
    "losses",
    "metrics",
    "morphology",
    "normal_transform_pixel",
    "normalize",
    "print_image",
    "psnr_loss",
    "pyrdown",
    "rgb_to_grayscale",
    "sobel",
    "ssim_loss",
    "tensor_to_image",
    "tversky_loss",
    "utils",
    "warp_perspective",
    "xla_is_available",
]


def __getattr__(name: str) -> Any:
    if name == "info":  # imported late: `python -m kvision.info` warns about a module that is loaded before it runs
        return importlib.import_module("kvision.info")
    raise AttributeError(f"module 'kvision' has no attribute {name!r}")
