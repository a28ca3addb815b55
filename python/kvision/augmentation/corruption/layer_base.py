"""What augmentations that put a layer on images share."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from kvision.augmentation.engine import Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D


class LayerAugmentation(IntensityAugmentationBase2D, keeps_contract=True):
    """Base of augmentations of which one operator makes the results: that of images and a layer, which others have made.

    A subclass says the operator of a batch by `_operation`, and by `_operation_on_list` that of images of different sizes, with a
    layer as large as the largest of them.
    """

    filters_chosen = True

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(input)
