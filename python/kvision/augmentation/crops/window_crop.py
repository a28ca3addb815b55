"""The base of crops that resize a window of each image, which may depend on its labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kvision import _check
from kvision.augmentation.engine import Shape
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.random_generator.crop import WindowGeneratorBase
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import Resample
from kvision.core.exceptions import ValueCheckError


class WindowCrop(GeometricAugmentationBase2D):
    """Base of crops that resize a window of each image to one size, by one launch for all.

    Args:
        windows: draws the windows. If the results have the size of the images, `p` is that of a sample, else that of a batch.
        p: probability that a sample or a batch is cropped.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: the centers of the outermost pixels of the window go to those of the result; False: their edges.
        antialias: blur windows that become smaller, and read no pixel next to them.
    """

    def __init__(
        self,
        windows: WindowGeneratorBase,
        p: float,
        resample: Any = Resample.BILINEAR.name,
        align_corners: bool = False,
        antialias: bool = False,
        **options: Any,
    ) -> None:
        has_size = windows.output_size is not None
        super().__init__(p=1.0 if has_size else p, p_batch=p if has_size else 1.0, **options)
        op = type(self).__name__
        self._param_generator: WindowGeneratorBase = windows
        self.size = windows.output_size
        self.flags = {
            "size": self.size,
            "resample": Resample.get(resample),
            "align_corners": align_corners,
            "padding_mode": "border",
            "antialias": _check.switch(op, "antialias", antialias),
        }
        if antialias and self.flags["resample"] == Resample.NEAREST:
            raise ValueCheckError(f"{op}: expected resample 'bilinear' or 'bicubic' with antialias")

    @property
    def whole_batch(self) -> bool:  # type: ignore[override]  # depends on the size
        return self.size is not None

    def output_size(self, shape: Shape, flags: dict[str, Any]) -> tuple[int, int]:
        return self.size or (shape[-2], shape[-1])

    def transforms(self, shape: Shape, flags: dict[str, Any]) -> Sequence[Transform] | None:
        h, w = self.output_size(shape, flags)
        corners = float(flags["align_corners"] is not False)
        return [Transform("crop", "window", float(w), float(h), corners)]

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        read = super().resampling(flags)
        antialias = bool(flags["antialias"]) and read.mode != "nearest"
        # Not by `_replace`: torch 2.11 cannot compile a call that leaves its result in an Execution.
        return Resampling(read.mode, read.padding, read.align_corners, read.fill, antialias)
