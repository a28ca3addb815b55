"""What cameras, lenses, weather and codecs do to images. What users import is in `kvision.augmentation`."""

from kvision.augmentation.corruption.blurs import Defocus, GlassBlur, RingingOvershoot, ZoomBlur
from kvision.augmentation.corruption.common import CommonCorruption
from kvision.augmentation.corruption.downscale import Downscale
from kvision.augmentation.corruption.noises import ISONoise, MultiplicativeNoise, ShotNoise, SpeckleNoise
from kvision.augmentation.corruption.weather import RandomFog, RandomFrost, Spatter

__all__ = [
    "CommonCorruption",
    "Defocus",
    "Downscale",
    "GlassBlur",
    "ISONoise",
    "MultiplicativeNoise",
    "RandomFog",
    "RandomFrost",
    "RingingOvershoot",
    "ShotNoise",
    "Spatter",
    "SpeckleNoise",
    "ZoomBlur",
]
