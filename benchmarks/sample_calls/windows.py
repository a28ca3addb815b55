"""Calls of filters and of pointwise functions, with how far a pixel is seen: windows of many sizes, or of one pixel.

Tests of bad pixels make all of them. Tests of large images make the `large` ones: filters where rows are no vectors, and
pointwise functions where planes are not aligned either.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from benchmarks.sample_calls import features, filters, functions, geometry
from benchmarks.sample_calls.model import Axes, SampleCall, Size, made, rand

CALLS = {call.name: call for module in (features, filters, functions, geometry) for call in module.CALLS}


@dataclass(frozen=True)
class Window:
    """A call whose first tensor is given. An argument that is a function is called with that one."""

    call: SampleCall
    reach: tuple[int, ...]  # how far a pixel is seen, along the axes of an image or a volume
    changed: dict[str, Any]
    channels: bool = False  # whether it is seen by the other channels, too
    large: bool = False
    suite: bool = False  # a variant of the function's inherited tests
    gray: bool = False  # takes one channel, which is the first one of an image

    def __str__(self) -> str:
        shown = {k: v.axes if isinstance(v, Axes) else v for k, v in self.changed.items() if not inspect.isfunction(v)}
        return " ".join([self.call.name.partition(".")[2], *(f"{k}={v}" for k, v in shown.items())])

    def __call__(self, x: Tensor) -> Any:
        x = x[:, :1] if self.gray else x
        first, *others = self.call.axes
        dtype = torch.float64 if x.dtype == torch.float64 else torch.float32
        with torch.random.fork_rng(devices=()):
            torch.default_generator.manual_seed(0)  # that of a GPU is left alone
            size = Size(*x.shape[:2], *x.shape[-2:])
            tensors = {name: self.call.axes[name](size).to(x.device, dtype) for name in others}
        arguments = {k: v(x) if inspect.isfunction(v) else v for k, v in self.call.others.items()}
        return self.call.function()(**{first: x}, **tensors, **arguments)


def window(
    name: str,
    *reach: int,
    channels: bool = False,
    large: bool = False,
    suite: bool = False,
    gray: bool = False,
    **changed: Any,
) -> Window:
    """A call with some arguments changed. Without a reach, it is half of the kernel's size."""
    call = CALLS[name]
    axes = {k: v for k, v in call.axes.items() if k not in changed}
    axes |= {k: v for k, v in changed.items() if isinstance(v, Axes)}
    others = {k: v for k, v in {**call.others, **changed}.items() if k not in axes}
    if not reach:
        size = others["kernel_size"]
        reach = tuple(n // 2 for n in ((size, size) if isinstance(size, int) else size))
    return Window(replace(call, axes=axes, others=others), reach, changed, channels, large, suite, gray)


def itself(x: Tensor) -> Tensor:
    return x


def upside_down(x: Tensor) -> Tensor:
    return x.flip(-2)


def suite(name: str, *reach: int, **changed: Any) -> Window:
    return window(name, *reach, suite=True, **changed)


def bilateral(**changed: Any) -> Window:
    return suite("filters.bilateral_blur", channels=True, **{"sigma_color": 0.3, "sigma_space": 1.5, **changed})


def pointwise(name: str, **changed: Any) -> Window:
    return window(name, 0, 0, large=True, **changed)


def inverted(x: Tensor) -> Tensor:
    return 1 - x.detach()


EACH, SIGMAS = rand("B", 0.5, 1.5), rand("B 2", 0.5, 1.5)
ONE_SIGMA = made("1 2", lambda _: torch.tensor([[0.8, 1.7]]))
PINHOLE = made("B 3 3", lambda s: torch.tensor([[400.0, 0, 250], [0, 410, 160], [0, 0, 1]]).repeat(s.b, 1, 1))
DEPTH = dict(camera_matrix=PINHOLE, channels=True, gray=True)
SIGNED = rand("1 3 3", -0.4, 0.6)
WINDOWS = [
    suite("filters.sobel", 1, 1, large=True),
    suite("filters.sobel", 1, 1, normalized=False),
    suite("filters.sobel", 1, 1, eps=1e-2),
    suite("filters.spatial_gradient", 1, 1, large=True),
    suite("filters.spatial_gradient", 2, 2, large=True, order=2),
    suite("filters.spatial_gradient", 1, 1, mode="diff"),
    suite("filters.spatial_gradient", 2, 2, mode="diff", order=2, normalized=False),
    suite("filters.spatial_gradient", 2, 2, order=2, normalized=False),
    suite("filters.spatial_gradient3d", 1, 1, 1),
    suite("filters.spatial_gradient3d", 1, 1, 1, order=2),
    suite("filters.laplacian", large=True, kernel_size=3),
    suite("filters.laplacian", kernel_size=3, normalized=False, border_type="replicate"),
    suite("filters.laplacian", kernel_size=5, border_type="circular"),
    suite("filters.laplacian", kernel_size=(1, 9)),
    suite("filters.laplacian", kernel_size=(11, 3), border_type="constant"),
    suite("filters.laplacian", kernel_size=(9, 11), border_type="replicate"),
    window("filters.canny", 4, 4, channels=True, low_threshold=0.01, high_threshold=0.02, hysteresis=False),
    # Every border, odd and even windows, summed one by one and in blocks; 3 and 5 squared have kernels of their own.
    suite("filters.box_blur", large=True, kernel_size=3),
    suite("filters.box_blur", kernel_size=5, border_type="circular"),
    suite("filters.box_blur", kernel_size=5, border_type="constant"),
    suite("filters.box_blur", kernel_size=(2, 6)),
    suite("filters.box_blur", kernel_size=(7, 9)),
    suite("filters.box_blur", kernel_size=(1, 8), border_type="constant"),
    suite("filters.box_blur", kernel_size=(4, 3), border_type="circular"),
    suite("filters.box_blur", kernel_size=(21, 11), border_type="replicate"),
    suite("filters.box_blur", kernel_size=(6, 5), border_type="replicate"),
    window("filters.box_blur", kernel_size=(5, 13), border_type="circular"),
    window("filters.box_blur", large=True, kernel_size=11),
    window("filters.box_blur", kernel_size=31, border_type="constant"),
    suite("filters.gaussian_blur2d", large=True, kernel_size=5, sigma=(1.0, 1.5)),
    suite("filters.gaussian_blur2d", kernel_size=(3, 7), sigma=ONE_SIGMA),
    suite("filters.gaussian_blur2d", kernel_size=5, sigma=SIGMAS, border_type="replicate"),
    suite("filters.gaussian_blur2d", kernel_size=(7, 1), sigma=2.0, border_type="constant"),
    suite("filters.gaussian_blur2d", large=True, kernel_size=9, sigma=(1.5, 0.5), border_type="circular"),
    window("filters.gaussian_blur2d", large=True, border_type="constant"),
    window("filters.gaussian_blur2d", large=True, border_type="replicate"),
    window("filters.gaussian_blur2d", kernel_size=(3, 11), sigma=(0.8, 3.0), border_type="constant"),
    window("filters.gaussian_blur2d", large=True, kernel_size=31, sigma=(5.0, 5.0)),
    suite("filters.unsharp_mask", large=True, kernel_size=5, sigma=(1.0, 1.5)),
    suite("filters.unsharp_mask", kernel_size=(3, 7), sigma=SIGMAS, border_type="replicate"),
    suite("filters.unsharp_mask", kernel_size=9, sigma=ONE_SIGMA, border_type="constant"),
    suite("filters.unsharp_mask", kernel_size=3, sigma=1.0, border_type="circular"),
    suite("filters.median_blur", large=True, kernel_size=3),
    suite("filters.median_blur", kernel_size=3, border_type="constant"),
    suite("filters.median_blur", large=True, kernel_size=5),
    suite("filters.median_blur", kernel_size=5, border_type="circular"),
    suite("filters.median_blur", kernel_size=5, border_type="replicate"),
    suite("filters.median_blur", kernel_size=(3, 5), border_type="replicate"),
    suite("filters.median_blur", kernel_size=4),
    suite("filters.median_blur", kernel_size=(2, 5), border_type="circular"),
    suite("filters.median_blur", kernel_size=7, border_type="constant"),
    window("filters.median_blur", kernel_size=(3, 9)),
    bilateral(kernel_size=5, sigma_space=(1.5, 1.0)),
    bilateral(kernel_size=(3, 5), color_distance_type="l2"),
    bilateral(kernel_size=(5, 3), border_type="replicate"),
    bilateral(kernel_size=3, border_type="constant"),
    bilateral(kernel_size=(3, 7), border_type="circular"),
    bilateral(kernel_size=(9, 7), sigma_color=0.5, sigma_space=3.0, border_type="replicate"),
    bilateral(kernel_size=3, sigma_color=rand("B", 0.2, 0.5), sigma_space=ONE_SIGMA),
    window("filters.joint_bilateral_blur", channels=True, guidance=itself, sigma_color=0.2, border_type="replicate"),
    window("filters.guided_blur", 2, 2, channels=True, input=itself, kernel_size=3),
    window("filters.motion_blur", kernel_size=5),
    window("filters.motion_blur3d", 1, 1, 1, kernel_size=3, angle=(30.0, 10.0, 50.0)),
    window("filters.filter2d", 1, 1, large=True, kernel=SIGNED),
    window("filters.filter2d", 1, 1, large=True, kernel=SIGNED, border_type="replicate"),
    window("filters.filter2d", 1, 2, kernel=rand("1 3 5", 0.1, 1.1)),
    window("filters.filter2d", 3, 3, large=True, kernel=rand("1 7 7", 1, 1), normalized=True),
    window("filters.filter2d_separable", 1, 3, kernel_x=rand("1 7", 0.1, 1.1), kernel_y=rand("1 3", 0.1, 1.1)),
    window("filters.filter3d", 1, 0, 2, kernel=rand("1 3 1 5", 0.1, 1.1)),
    window("filters.blur_pool2d", kernel_size=3, stride=1),
    window("filters.edge_aware_blur_pool2d", 3, 3, channels=True, kernel_size=3, edge_threshold=1.05),
    window("morphology.dilation", 1, 1, large=True),
    window("morphology.dilation", 1, 1, large=True, structuring_element=rand("3 3", -0.4, 0.3)),
    window("morphology.dilation", 3, 3, large=True, kernel=rand("7 7", 1, 1)),
    window("morphology.erosion", 1, 1, large=True),
    window("metrics.ssim", 3, 3, large=True, img2=upside_down, window_size=7),
    window("geometry.nms2d", large=True),
    window("geometry.nms2d", large=True, kernel_size=(5, 5)),
    window("geometry.nms3d", large=True),
    window("feature.harris_response", 4, 4, large=True),
    window("feature.gftt_response", 4, 4, large=True),
    window("feature.hessian_response", 2, 2, large=True),
    pointwise("color.rgb_to_hsv", channels=True),
    pointwise("color.rgb_to_lab", channels=True),
    pointwise("color.rgb_to_ycbcr", channels=True),
    pointwise("color.rgb_to_grayscale", channels=True),
    pointwise("enhance.adjust_saturation", channels=True, factor=EACH),
    pointwise("enhance.adjust_hue", channels=True, factor=0.5),
    pointwise("enhance.adjust_brightness", factor=EACH),
    pointwise("enhance.adjust_gamma", gamma=1.5),
    pointwise("enhance.normalize"),
    pointwise("enhance.add_weighted", alpha=rand("B 1 1 1", 0.5, 1.5), src2=inverted, beta=0.25, gamma=0.125),
    pointwise("geometry.depth_to_3d", **DEPTH),
    pointwise("geometry.depth_to_3d", normalize_points=True, **DEPTH),
]


def variants(name: str) -> list[dict[str, Any]]:
    """The arguments of a function of filters, besides the image, with which its inherited tests call it."""
    calls = [window.call for window in WINDOWS if window.suite and window.call.name == f"filters.{name}"]
    return [{**call.others, **dict(list(call.axes.items())[1:])} for call in calls]
