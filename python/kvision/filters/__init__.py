"""Filters for images (B, C, H, W) and volumes (B, C, D, H, W).

Sizes and sigmas are (y, x). Results have the size of the input unless said otherwise. Computation is in float32, or in
float64 for float64 images; half types and, where OpenCV has it, uint8 are stored back.
"""

from kvision import _torch_compat
from kvision.filters.bilateral import BilateralBlur, JointBilateralBlur, bilateral_blur, joint_bilateral_blur
from kvision.filters.blur_pool import (
    BlurPool2D,
    EdgeAwareBlurPool2D,
    MaxBlurPool2D,
    blur_pool2d,
    edge_aware_blur_pool2d,
    max_blur_pool2d,
)
from kvision.filters.box import BoxBlur, box_blur
from kvision.filters.canny import Canny, canny
from kvision.filters.fft_conv import fft_conv
from kvision.filters.filter2d import convolve2d, correlate2d, filter2d
from kvision.filters.filter3d import convolve3d, correlate3d, filter3d
from kvision.filters.gaussian import GaussianBlur2d, gaussian_blur2d
from kvision.filters.guided import GuidedBlur, guided_blur
from kvision.filters.in_range import InRange, in_range
from kvision.filters.kernels import (  # after gaussian.py, whose name is taken by the function
    gaussian,
    get_binary_kernel2d,
    get_box_kernel1d,
    get_box_kernel2d,
    get_diff_kernel2d,
    get_gaussian_discrete_kernel1d,
    get_gaussian_erf_kernel1d,
    get_gaussian_kernel1d,
    get_gaussian_kernel2d,
    get_gaussian_kernel3d,
    get_hanning_kernel1d,
    get_hanning_kernel2d,
    get_laplacian_kernel1d,
    get_laplacian_kernel2d,
    get_sobel_kernel2d,
    get_spatial_gradient_kernel2d,
    get_spatial_gradient_kernel3d,
    laplacian_1d,
)
from kvision.filters.laplacian import Laplacian, laplacian
from kvision.filters.median import MedianBlur, median_blur
from kvision.filters.motion import (
    MotionBlur,
    MotionBlur3D,
    get_motion_kernel2d,
    get_motion_kernel3d,
    motion_blur,
    motion_blur3d,
)
from kvision.filters.otsu import OtsuThreshold, otsu_threshold
from kvision.filters.separable import filter2d_separable
from kvision.filters.sobel import Sobel, sobel
from kvision.filters.spatial_gradient import SpatialGradient, SpatialGradient3d, spatial_gradient, spatial_gradient3d
from kvision.filters.unsharp import UnsharpMask, unsharp_mask

_torch_compat.refuse_script(globals())
