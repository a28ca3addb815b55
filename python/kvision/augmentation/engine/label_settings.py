"""What containers say about the labels of images."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from kvision.augmentation.labels import BoxFilter
from kvision.constants import DataKey, Resample


class MaskReading(NamedTuple):
    """How masks are read: a mode, None for that of the images, and what enters from outside, None for 0."""

    mode: str | None = None
    fill: Any = None
    is_fixed: bool = False  # also inside of containers that read masks in another way

    @classmethod
    def of(cls, extra_args: Mapping[Any, Mapping[str, Any]]) -> MaskReading:
        """What the flags of a container say."""
        for key, options in extra_args.items():
            if DataKey.get(key) == DataKey.MASK:
                mode = options.get("resample", "nearest")
                return cls(None if mode is None else Resample.get(mode).name.lower(), options.get("fill_value"))
        return cls()

    def inside(self, settings: LabelSettings | None) -> MaskReading:
        """The same inside of a container with settings."""
        return self if self.is_fixed or settings is None or settings.has_default_masks else settings.masks


KNOWN = MaskReading("bilinear", None, True)  # of masks of the pixels that are known


class LabelSettings(NamedTuple):
    """What a container says about labels."""

    clips_each: bool = False  # boxes end at the edges of the image after each stage
    box_filter: BoxFilter = BoxFilter()
    masks: MaskReading = MaskReading()
    has_default_masks: bool = False  # `masks` is only for a container by itself; the one around it decides
    may_remove_boxes: bool = False  # it, or what is in it
