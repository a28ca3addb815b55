"""Crops: windows of images, of which masks, boxes and key points become those of the windows."""

from kvision.augmentation.crops.crop import CenterCrop, RandomCrop, RandomResizedCrop
from kvision.augmentation.crops.views import FiveCrop, MultiCrop, TenCrop

__all__ = ["CenterCrop", "FiveCrop", "MultiCrop", "RandomCrop", "RandomResizedCrop", "TenCrop"]
