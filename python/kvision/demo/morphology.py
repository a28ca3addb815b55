"""The sheet of the morphology and contrib modules."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import torch
from torch import Tensor

from kvision import contrib, morphology
from kvision.demo.sheet import Image, Sheet, Step

PATCH = 16  # pixels


def square(operation: Callable[..., Tensor]) -> Callable[[Tensor], Tensor]:
    return lambda photos: operation(photos, torch.ones(5, 5, device=photos.device))


def opencv(operation: int) -> Callable[[Image], Image]:
    return lambda image: cv2.morphologyEx(image, operation, np.ones((5, 5), np.uint8))


def mosaic(photos: Tensor) -> Tensor:
    """The patches of every photo, from the darkest to the brightest."""
    patches = contrib.extract_tensor_patches(photos, PATCH, PATCH)
    order = patches.mean((2, 3, 4)).argsort(1)
    patches = patches.gather(1, order[:, :, None, None, None].expand_as(patches))
    height, width = photos.shape[2:]
    return contrib.combine_tensor_patches(patches, (height, width), PATCH, PATCH)


SHEET = Sheet(
    "Shapes and patches",
    [
        Step(
            "dilation",
            "dilation(x, ones(5, 5)): the brightest of 5 x 5",
            square(morphology.dilation),
            opencv(cv2.MORPH_DILATE),
        ),
        Step(
            "erosion",
            "erosion(x, ones(5, 5)): the darkest of 5 x 5",
            square(morphology.erosion),
            opencv(cv2.MORPH_ERODE),
        ),
        Step(
            "opening",
            "opening(x, ones(5, 5)): bright spots are gone",
            square(morphology.opening),
            opencv(cv2.MORPH_OPEN),
        ),
        Step(
            "outline",
            "gradient(x, ones(5, 5)): dilation less erosion",
            square(morphology.gradient),
            opencv(cv2.MORPH_GRADIENT),
        ),
        Step("mosaic", "extract_tensor_patches(x, 16, 16), from dark to bright", mosaic),
    ],
)
