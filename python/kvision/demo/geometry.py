"""The sheet of the geometry module."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from kvision import geometry
from kvision.demo.sheet import Image, Sheet, Step

# A quadrangle of the image and the whole image, in fractions of its width and height: the first is warped to the second.
QUADRANGLE = [[0.10, 0.15], [0.85, 0.05], [0.95, 0.90], [0.05, 0.80]]
WHOLE = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]


def corners(fractions: list[list[float]], height: int, width: int) -> Image:
    return np.array(fractions, np.float32) * np.array([width - 1, height - 1], np.float32)


def rotate(photos: Tensor) -> Tensor:
    return geometry.rotate(photos, torch.tensor(25.0, device=photos.device))


def rotate_opencv(image: Image) -> Image:
    height, width = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 25, 1)
    return cv2.warpAffine(image, matrix, (width, height))


def rectify(photos: Tensor) -> Tensor:
    height, width = photos.shape[2:]
    source, target = (torch.from_numpy(corners(p, height, width))[None].to(photos) for p in (QUADRANGLE, WHOLE))
    matrix = geometry.get_perspective_transform(source, target)
    return geometry.warp_perspective(photos, matrix, (height, width))


def rectify_opencv(image: Image) -> Image:
    height, width = image.shape[:2]
    matrix = cv2.getPerspectiveTransform(corners(QUADRANGLE, height, width), corners(WHOLE, height, width))
    return cv2.warpPerspective(image, matrix, (width, height))


def elastic(photos: Tensor) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    noise = 2 * torch.rand(1, 2, *photos.shape[2:], generator=generator) - 1
    return geometry.elastic_transform2d(
        photos, noise.to(photos.device), (63, 63), (10.0, 10.0), (1.2, 1.2), padding_mode="reflection"
    )


def pixelated(photos: Tensor) -> Tensor:
    height, width = photos.shape[2:]
    small = geometry.resize(photos, (height // 12, width // 12), antialias=True)
    return geometry.resize(small, (height, width), "nearest")


def detail(photos: Tensor) -> Tensor:
    """The finest level of a Laplacian pyramid, with 0 shown as gray."""
    height, width = photos.shape[2:]
    return (geometry.build_laplacian_pyramid(photos, 2)[0][..., :height, :width] * 2 + 0.5).clamp(0, 1)


SHEET = Sheet(
    "Geometry",
    [
        Step("rotation", "rotate(x, 25): by 25 degrees about the center", rotate, rotate_opencv),
        Step(
            "perspective",
            "warp_perspective(x, matrix, (320, 320)): a quadrangle fills the image",
            rectify,
            rectify_opencv,
        ),
        Step("elastic", "elastic_transform2d(x, noise, (63, 63), (10.0, 10.0), (1.2, 1.2)): smooth waves", elastic),
        Step("pixels", 'resize(x, (26, 26), antialias=True), and back with "nearest"', pixelated),
        Step("pyramid detail", "0.5 + 2 * build_laplacian_pyramid(x, 2)[0]: what a blur takes away", detail),
    ],
)
