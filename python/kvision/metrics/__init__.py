"""Metrics: of images, segmentations, boxes, disparities, flows and poses.

Nothing waits for the device of its tensors, except where the result is a Python number. Computation is in float32, or in
float64 for float64.
"""

from kvision import _torch_compat
from kvision.metrics.accuracy import accuracy
from kvision.metrics.average_meter import AverageMeter
from kvision.metrics.box_overlap import box_iou_rotated, complete_box_iou, distance_box_iou, generalized_box_iou
from kvision.metrics.boxes import mean_average_precision, mean_iou_bbox
from kvision.metrics.confusion_matrix import confusion_matrix, mean_iou
from kvision.metrics.disparity import (
    kitti_d1_error,
    mean_absolute_disparity_error,
    mean_bad_pixel_error,
    root_mean_squared_disparity_error,
)
from kvision.metrics.endpoint_error import AEPE, aepe, average_endpoint_error
from kvision.metrics.pose import angle_error_mat, angle_error_vec, auc_from_errors, pose_errors, translation_ate
from kvision.metrics.psnr import psnr
from kvision.metrics.ssim import SSIM, SSIM3D, ssim, ssim3d

_torch_compat.refuse_script(globals())
