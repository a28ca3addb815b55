"""What distortions by maps share: how images are read."""

from __future__ import annotations

from typing import Any

from kvision.augmentation.elastic import MapAugmentation
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding


class DistortionBase(MapAugmentation, keeps_contract=True):
    """Base of maps whose images are read with an interpolation and a padding of the user."""

    def __init__(self, resample: AnyResample, padding_mode: AnySamplePadding, **options: Any) -> None:
        super().__init__(**options)
        self.flags = {
            "resample": Resample.get(resample),
            "padding_mode": SamplePadding.get(padding_mode),
            "align_corners": True,
        }
