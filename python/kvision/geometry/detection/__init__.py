"""Boxes of detectors: areas, images and masks, suppression of boxes that overlap better ones."""

from kvision.geometry.detection.regions import box_area, clip_boxes_to_image, masks_to_boxes, remove_small_boxes
from kvision.geometry.detection.rotated import nms_rotated
from kvision.geometry.detection.suppression import batched_nms, nms, nms_mask, soft_nms

__all__ = [
    "batched_nms",
    "box_area",
    "clip_boxes_to_image",
    "masks_to_boxes",
    "nms",
    "nms_mask",
    "nms_rotated",
    "remove_small_boxes",
    "soft_nms",
]
