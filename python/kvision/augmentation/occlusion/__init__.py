"""Parts of images that are dropped: holes, grids, stripes and pixels. What users import is in `kvision.augmentation`."""

from kvision.augmentation.occlusion.grids import GridDropout, GridMask
from kvision.augmentation.occlusion.holes import CoarseDropout, FrequencyMasking, TimeMasking, XYMasking
from kvision.augmentation.occlusion.objects import MaskDropout
from kvision.augmentation.occlusion.pixels import PixelDropout

__all__ = [
    "CoarseDropout",
    "FrequencyMasking",
    "GridDropout",
    "GridMask",
    "MaskDropout",
    "PixelDropout",
    "TimeMasking",
    "XYMasking",
]
