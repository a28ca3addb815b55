"""Crops: windows of images, of which masks, boxes and key points become those of the windows."""

from kvision.augmentation.crops.box_crops import AtLeastOneBBoxRandomCrop, RandomCropNearBBox, RandomSizedBBoxSafeCrop
from kvision.augmentation.crops.crop import CenterCrop, RandomCrop, RandomResizedCrop
from kvision.augmentation.crops.iou_crop import RandomIoUCrop
from kvision.augmentation.crops.mask_crop import CropNonEmptyMaskIfExists
from kvision.augmentation.crops.views import FiveCrop, MultiCrop, TenCrop
from kvision.augmentation.crops.zoom_out import RandomZoomOut

__all__ = [
    "AtLeastOneBBoxRandomCrop",
    "CenterCrop",
    "CropNonEmptyMaskIfExists",
    "FiveCrop",
    "MultiCrop",
    "RandomCrop",
    "RandomCropNearBBox",
    "RandomIoUCrop",
    "RandomResizedCrop",
    "RandomSizedBBoxSafeCrop",
    "RandomZoomOut",
    "TenCrop",
]
