"""kvision: differentiable computer vision for PyTorch with hand-written CPU and CUDA kernels.

    >>> import torch, kvision as K
    >>> K.filters.sobel(torch.rand(1, 3, 8, 8)).shape
    torch.Size([1, 3, 8, 8])

`kvision.info()` prints what was built and which types of which device the kernels serve. A module is imported, and registers
its operators, when it is first used.
"""

from __future__ import annotations

import gc
import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

from kvision import _backend, _ops, constants  # constants now: its tensor must not be made inside of a FakeTensorMode
from kvision._backend import backend
from kvision._version import __version__

if TYPE_CHECKING:
    from kvision import (
        augmentation,
        color,
        contrib,
        core,
        enhance,
        feature,
        filters,
        geometry,
        image,
        io,
        losses,
        metrics,
        morphology,
        sensors,
        tv,
        utils,
    )
    from kvision._hints import RangeWarning
    from kvision.color import bgr_to_rgb, rgb_to_grayscale
    from kvision.constants import pi
    from kvision.contrib import extract_tensor_patches
    from kvision.core import eye_like, vec_like
    from kvision.enhance import normalize  # type: ignore[no-redef]  # the name of a module of enhance as well
    from kvision.feature import (
        BlobHessian,
        HardNet,
        LAFAffineShapeEstimator,
        LAFOrienter,
        ScaleSpaceDetector,
        extract_patches_from_pyramid,
        match_smnn,
    )
    from kvision.filters import gaussian_blur2d, sobel
    from kvision.geometry import (
        ConvQuadInterp3d,
        DepthWarper,
        HomographyWarper,
        ScalePyramid,
        create_meshgrid,
        create_meshgrid3d,
        find_homography_dlt_iterated,
        get_perspective_transform,
        homography_warp,
        load_pointcloud_ply,
        normal_transform_pixel,
        pyrdown,
        save_pointcloud_ply,
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
        show,
        tensor_to_image,
        to_numpy,
        to_pil,
        to_tensor,
    )
    from kvision.losses import (  # type: ignore[no-redef]  # one_hot is the name of a module of losses as well
        dice_loss,
        focal_loss,
        one_hot,
        psnr_loss,
        ssim_loss,
        tversky_loss,
    )
    from kvision.patch import patch_kornia
    from kvision.utils import (
        get_cuda_device_if_available,
        get_cuda_or_mps_device_if_available,
        get_mps_device_if_available,
        is_autocast_enabled,
        xla_is_available,
    )

__all__ = [
    "BlobHessian",
    "ConvQuadInterp3d",
    "DepthWarper",
    "HardNet",
    "HomographyWarper",
    "LAFAffineShapeEstimator",
    "LAFOrienter",
    "RangeWarning",
    "ScalePyramid",
    "ScaleSpaceDetector",
    "__version__",
    "augmentation",
    "backend",
    "bgr_to_rgb",
    "color",
    "constants",
    "contrib",
    "core",
    "create_meshgrid",
    "create_meshgrid3d",
    "dice_loss",
    "draw_convex_polygon",
    "draw_line",
    "draw_point2d",
    "draw_rectangle",
    "enhance",
    "extract_patches_from_pyramid",
    "extract_tensor_patches",
    "eye_like",
    "feature",
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
    "load_pointcloud_ply",
    "losses",
    "match_smnn",
    "metrics",
    "morphology",
    "normal_transform_pixel",
    "normalize",
    "one_hot",
    "patch_kornia",
    "pi",
    "print_image",
    "psnr_loss",
    "pyrdown",
    "rgb_to_grayscale",
    "save_pointcloud_ply",
    "sensors",
    "show",
    "sobel",
    "ssim_loss",
    "tensor_to_image",
    "to_numpy",
    "to_pil",
    "to_tensor",
    "tv",
    "tversky_loss",
    "utils",
    "vec_like",
    "warp_perspective",
    "xla_is_available",
]

# Names at the top level, and their modules: those in the examples of Kornia's paper, and those that Kornia 0.9 has there.
_HOMES = {
    "RangeWarning": "_hints",
    "pi": "constants",
    "eye_like": "core",
    "vec_like": "core",
    "bgr_to_rgb": "color",
    "rgb_to_grayscale": "color",
    "extract_tensor_patches": "contrib",
    "normalize": "enhance",
    "gaussian_blur2d": "filters",
    "sobel": "filters",
    "ConvQuadInterp3d": "geometry",
    "DepthWarper": "geometry",
    "HomographyWarper": "geometry",
    "ScalePyramid": "geometry",
    "create_meshgrid": "geometry",
    "create_meshgrid3d": "geometry",
    "find_homography_dlt_iterated": "geometry",
    "get_perspective_transform": "geometry",
    "homography_warp": "geometry",
    "load_pointcloud_ply": "geometry",
    "normal_transform_pixel": "geometry",
    "pyrdown": "geometry",
    "save_pointcloud_ply": "geometry",
    "warp_perspective": "geometry",
    "BlobHessian": "feature",
    "HardNet": "feature",
    "LAFAffineShapeEstimator": "feature",
    "LAFOrienter": "feature",
    "ScaleSpaceDetector": "feature",
    "extract_patches_from_pyramid": "feature",
    "match_smnn": "feature",
    "draw_convex_polygon": "image",
    "draw_line": "image",
    "draw_point2d": "image",
    "draw_rectangle": "image",
    "image_to_string": "image",
    "image_to_tensor": "image",
    "print_image": "image",
    "show": "image",
    "tensor_to_image": "image",
    "to_numpy": "image",
    "to_pil": "image",
    "to_tensor": "image",
    "dice_loss": "losses",
    "focal_loss": "losses",
    "one_hot": "losses",
    "psnr_loss": "losses",
    "ssim_loss": "losses",
    "tversky_loss": "losses",
    "get_cuda_device_if_available": "utils",
    "get_cuda_or_mps_device_if_available": "utils",
    "get_mps_device_if_available": "utils",
    "is_autocast_enabled": "utils",
    "xla_is_available": "utils",
    "patch_kornia": "patch",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(_import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    if name in __all__:
        return _import_module(name)
    raise AttributeError(f"module 'kvision' has no attribute {name!r}")


def _import_module(name: str) -> ModuleType:
    """Import a module of this package without collecting garbage.

    What an import makes stays, and one collection looks at all objects of torch, which takes .1 s, as long as the filters.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(f"kvision.{name}")
    finally:
        if collects:
            gc.enable()


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
