"""What cameras, lenses, weather and codecs do to images. What users import is in `kvision.augmentation`."""

from kvision.augmentation.corruption.blurs import Defocus, GlassBlur, RingingOvershoot, ZoomBlur
from kvision.augmentation.corruption.downscale import Downscale
from kvision.augmentation.corruption.noises import ISONoise, MultiplicativeNoise, ShotNoise, SpeckleNoise

__all__ = [
    "Defocus",
    "Downscale",
    "GlassBlur",
    "ISONoise",
    "MultiplicativeNoise",
    "RingingOvershoot",
    "ShotNoise",
    "SpeckleNoise",
    "ZoomBlur",
]
