"""The sheet of the filters module."""

from __future__ import annotations

from typing import Any

import cv2
import torch
from torch import Tensor

from kvision import filters
from kvision.demo.sheet import Image, Sheet, Step, StepInput


def salt_and_pepper(photos: Tensor, fraction: float = 0.1) -> Tensor:
    """Every tenth pixel white or black."""
    generator = torch.Generator().manual_seed(0)
    draw = torch.rand(len(photos), 1, *photos.shape[2:], generator=generator).to(photos.device)
    return photos.masked_fill(draw < fraction / 2, 0).masked_fill(draw > 1 - fraction / 2, 1)


MOTION = filters.get_motion_kernel2d(21, 35.0, 0.0)


def sobel_opencv(image: Image) -> Any:
    gx, gy = (
        cv2.Sobel(image, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=0.125, borderType=cv2.BORDER_REPLICATE) for dx in (1, 0)
    )
    return cv2.magnitude(gx, gy)


def canny_opencv(image: Image) -> Any:
    gray = cv2.convertScaleAbs(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), alpha=255)
    return cv2.Canny(cv2.GaussianBlur(gray, (5, 5), 1), 25.5, 51, L2gradient=True)


def unsharp_opencv(image: Image) -> Any:
    return cv2.addWeighted(image, 2, cv2.GaussianBlur(image, (9, 9), 2), -1, 0)


LAPLACIAN = filters.get_laplacian_kernel2d(3).numpy() / 16

SHEET = Sheet(
    "Filters",
    [
        Step(
            "gaussian blur",
            "gaussian_blur2d(x, (21, 21), (4.0, 4.0)): means with the weights of a Gaussian",
            lambda x: filters.gaussian_blur2d(x, (21, 21), (4.0, 4.0)),
            lambda image: cv2.GaussianBlur(image, (21, 21), 4),
        ),
        Step(
            "motion blur",
            "motion_blur(x, 21, 35.0, 0.0): means along a line of 21 pixels",
            lambda x: filters.motion_blur(x, 21, 35.0, 0.0),
            lambda image: cv2.filter2D(image, -1, MOTION[0].numpy()),
        ),
        Step(
            "sobel",
            "4 * sobel(x): the length of the gradient of each color",
            filters.sobel,
            sobel_opencv,
            lambda y: 4 * y,
        ),
        Step(
            "laplacian",
            "0.5 + 8 * laplacian(x, 3): second derivatives, 0 is gray",
            lambda x: filters.laplacian(x, 3),
            lambda image: cv2.filter2D(image, -1, LAPLACIAN),
            lambda y: 0.5 + 8 * y,
        ),
        Step("canny", "canny(x)[1]: edges of one pixel", lambda x: filters.canny(x)[1], canny_opencv),
        Step(
            "median",
            "median_blur(x, 3): the middle of 3 x 3 values has no lone pixel",
            lambda x: filters.median_blur(x, 3),
            lambda image: cv2.medianBlur(image, 3),
            input=StepInput("salt and pepper", salt_and_pepper),
        ),
        Step(
            "bilateral",
            "bilateral_blur(x, (21, 21), 0.5, (7.0, 7.0)): means of like colors keep edges",
            lambda x: filters.bilateral_blur(x, (21, 21), 0.5, (7.0, 7.0)),
            lambda image: cv2.bilateralFilter(image, 21, 0.5, 7),
        ),
        Step(
            "unsharp mask",
            "unsharp_mask(x, (9, 9), (2.0, 2.0)): the photo and its difference from a blur",
            lambda x: filters.unsharp_mask(x, (9, 9), (2.0, 2.0)),
            unsharp_opencv,
        ),
    ],
)
