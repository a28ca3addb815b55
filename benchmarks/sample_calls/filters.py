"""Calls of the functions of filters."""

from __future__ import annotations

from benchmarks.sample_calls.model import calls, rand
from benchmarks.sample_calls.tensors import IMAGE, VOLUME

CALLS = calls(
    "filters",
    {
        "filter2d fft_conv convolve2d correlate2d": dict(input=IMAGE, kernel=rand("1 3 3")),
        "filter3d convolve3d correlate3d": dict(input=VOLUME, kernel=rand("1 3 3 3")),
        "canny sobel spatial_gradient": dict(input=IMAGE),
        "laplacian blur_pool2d box_blur edge_aware_blur_pool2d max_blur_pool2d median_blur": dict(
            input=IMAGE, kernel_size=5
        ),
        "spatial_gradient3d": dict(input=VOLUME),
        "in_range": dict(input=IMAGE, lower=rand("B C 1 1", 0.2, 0.2), upper=rand("B C 1 1", 0.8, 0.8)),
        "gaussian": dict(window_size=5, sigma=rand("B 1", 1, 2)),
        "get_binary_kernel2d laplacian_1d": dict(window_size=5),
        "get_box_kernel1d get_box_kernel2d get_hanning_kernel1d get_hanning_kernel2d get_laplacian_kernel1d "
        "get_laplacian_kernel2d": dict(kernel_size=5),
        "get_diff_kernel2d get_sobel_kernel2d": dict(),
        "get_gaussian_discrete_kernel1d get_gaussian_erf_kernel1d get_gaussian_kernel1d": dict(
            kernel_size=5, sigma=rand("B 1", 1, 2)
        ),
        "get_gaussian_kernel2d": dict(kernel_size=(5, 5), sigma=rand("B 2", 1, 2)),
        "get_gaussian_kernel3d": dict(kernel_size=(5, 5, 5), sigma=rand("B 3", 1, 2)),
        "get_spatial_gradient_kernel2d": dict(mode="sobel", order=1),
        "get_spatial_gradient_kernel3d": dict(mode="diff", order=1),
        "otsu_threshold": dict(x=IMAGE),
        "filter2d_separable": dict(input=IMAGE, kernel_x=rand("1 5"), kernel_y=rand("1 5")),
        "bilateral_blur": dict(input=IMAGE, kernel_size=(5, 5), sigma_color=0.1, sigma_space=(1.5, 1.5)),
        "gaussian_blur2d unsharp_mask": dict(input=IMAGE, kernel_size=(5, 5), sigma=(1.5, 1.5)),
        "get_motion_kernel2d": dict(kernel_size=5, angle=rand("B", 0, 90), direction=rand("B")),
        "get_motion_kernel3d": dict(kernel_size=5, angle=rand("B 3", 0, 90), direction=rand("B")),
        "guided_blur": dict(guidance=IMAGE, input=IMAGE, kernel_size=5, eps=0.1),
        "joint_bilateral_blur": dict(
            input=IMAGE, guidance=IMAGE, kernel_size=(5, 5), sigma_color=0.1, sigma_space=(1.5, 1.5)
        ),
        "motion_blur": dict(input=IMAGE, kernel_size=5, angle=30.0, direction=0.5),
        "motion_blur3d": dict(input=VOLUME, kernel_size=5, angle=(30.0, 10.0, 5.0), direction=0.5),
    },
)
