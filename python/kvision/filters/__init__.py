"""Filters for images (B, C, H, W) and volumes (B, C, D, H, W).

Sizes and sigmas are (y, x). Results have the size of the input unless said otherwise. Computation is in float32, or in
float64 for float64 images; half types and, where OpenCV has it, uint8 are stored back.
"""

from kvision import _torch_compat
from kvision.filters.edges import *  # noqa: F403
from kvision.filters.fft_conv import fft_conv
from kvision.filters.filter2d import convolve2d, correlate2d, filter2d
from kvision.filters.filter3d import convolve3d, correlate3d, filter3d
from kvision.filters.in_range import InRange, in_range
from kvision.filters.kernels import (
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
from kvision.filters.otsu import OtsuThreshold, otsu_threshold
from kvision.filters.separable import filter2d_separable
from kvision.filters.smoothing import *  # noqa: F403

_torch_compat.refuse_script(globals())
