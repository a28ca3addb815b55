"""Stable numbers of the modes that operators take.

Operators take small integers: torch's stable C interface leaks 48 bytes for each string argument of a call. The numbers
never change, so that exported graphs keep their meaning.

Written by tools/generate.py from the declarations in csrc that it names.
"""

# Border in csrc/core/border.h
BORDER = {"constant": 0, "reflect": 1, "replicate": 2, "circular": 3}
BORDER_NAMES = tuple(BORDER)
# DType in csrc/core/dtype.h
DTYPE = {"uint8": 0, "float16": 1, "bfloat16": 2, "float32": 3, "float64": 4}
DTYPE_NAMES = tuple(DTYPE)
# ColorDistance in csrc/filters/smoothing/bilateral.h
COLOR_DISTANCE = {"l1": 0, "l2": 1}
COLOR_DISTANCE_NAMES = tuple(COLOR_DISTANCE)
# DerivativeMode in csrc/filters/edges/spatial_gradient.h
DERIVATIVE_MODE = {"sobel": 0, "diff": 1}
DERIVATIVE_MODE_NAMES = tuple(DERIVATIVE_MODE)
# ResizeFilter in csrc/geometry/transform/resize/resize.h
INTERPOLATION = {
    "nearest": 0,
    "nearest-exact": 1,
    "area": 2,
    "bilinear": 3,
    "bicubic": 4,
    "lanczos": 5,
    "pyrdown": 6,
    "pyrup": 7,
}
INTERPOLATION_NAMES = tuple(INTERPOLATION)
# Padding in csrc/geometry/transform/sampling.h
PADDING = {"fill": 0, "border": 1, "reflection": 2}
PADDING_NAMES = tuple(PADDING)
# WarpFormula in csrc/geometry/formulas.h
WARP_FORMULA = {
    "affine_matrix2d": 1,
    "translation_matrix2d": 2,
    "scale_matrix2d": 3,
    "shear_factor_matrix2d": 4,
    "crop_matrix": 5,
    "affine_matrix3d": 6,
    "translation_matrix3d": 7,
    "perspective_matrix3d": 8,
}
WARP_FORMULA_NAMES = tuple(WARP_FORMULA)
# Distance in csrc/geometry/transform/photometric.h
PHOTOMETRIC_DISTANCE = {"l1": 0, "l2": 1, "charbonnier": 2}
PHOTOMETRIC_DISTANCE_NAMES = tuple(PHOTOMETRIC_DISTANCE)
# PointMapKind in csrc/geometry/transform_points_op.cpp
POINT_MAP = {"transform": 0, "project": 1, "unproject": 2, "unproject_distance": 3, "intersect": 4}
POINT_MAP_NAMES = tuple(POINT_MAP)
# RobustLoss in csrc/geometry/optim/robust_losses.h
ROBUST_LOSS = {
    "linear": 0,
    "huber": 1,
    "soft_l1": 2,
    "cauchy": 3,
    "arctan": 4,
    "geman_mcclure": 5,
    "welsch": 6,
    "tukey": 7,
}
ROBUST_LOSS_NAMES = tuple(ROBUST_LOSS)
# Model in csrc/geometry/solvers/minimal.h
MODEL = {"affine": 0, "homography": 1, "lines": 2, "fundamental": 3, "fundamental8": 4, "essential": 5}
MODEL_NAMES = tuple(MODEL)
# ErrorKind in csrc/geometry/correspondence_errors.h
CORRESPONDENCE_ERROR = {
    "sampson": 0,
    "symmetrical": 1,
    "right": 2,
    "left": 3,
    "transfer": 4,
    "symmetric_transfer": 5,
    "sampson_transfer": 6,
    "segments": 7,
}
CORRESPONDENCE_ERROR_NAMES = tuple(CORRESPONDENCE_ERROR)
# MapKind in csrc/augmentation/distortion/displacement_map.h
MAP_KIND = {"camera": 0, "fisheye_lens": 1, "swirl": 2, "cells": 3, "triangles": 4, "fisheye": 5, "thin_plate": 6}
MAP_KIND_NAMES = tuple(MAP_KIND)
# BlockValue in csrc/augmentation/corruption/pixelate.h
BLOCK_VALUE = {"mean": 0, "mean_of_whole": 1, "pixel": 2}
BLOCK_VALUE_NAMES = tuple(BLOCK_VALUE)
# Decay in csrc/geometry/detection/suppression.h
BOX_DECAY = {"linear": 0, "gaussian": 1}
BOX_DECAY_NAMES = tuple(BOX_DECAY)
# BoxFormat in csrc/metrics/boxes.h
BOX_FORMAT = {"xyxy": 0, "xywh": 1, "cxcywh": 2}
BOX_FORMAT_NAMES = tuple(BOX_FORMAT)
# ConfusionStatistic in csrc/metrics/confusion_matrix.h
CONFUSION_STATISTIC = {"counts": 0, "rates": 1, "iou": 2}
CONFUSION_STATISTIC_NAMES = tuple(CONFUSION_STATISTIC)
# PointLoss in csrc/metrics/pointwise.h
POINT_LOSS = {"charbonnier": 0, "welsch": 1, "cauchy": 2, "geman_mcclure": 3, "square": 4, "kl": 5, "js": 6}
POINT_LOSS_NAMES = tuple(POINT_LOSS)
# SsimPadding in csrc/metrics/ssim.h
SSIM_PADDING = {"reflect": 0, "constant": 1, "valid": 2}
SSIM_PADDING_NAMES = tuple(SSIM_PADDING)
# CornerKind in csrc/feature/responses.h
CORNER_KIND = {"harris": 0, "gftt": 1}
CORNER_KIND_NAMES = tuple(CORNER_KIND)
# MotionTaps in csrc/filters/smoothing/motion.h
MOTION_TAPS = {"nearest": 0, "bilinear": 1, "bicubic": 2}
MOTION_TAPS_NAMES = tuple(MOTION_TAPS)
# HistogramKernel in csrc/enhance/image_histogram2d.h
HISTOGRAM_KERNEL = {"triangular": 0, "epanechnikov": 1, "uniform": 2}
HISTOGRAM_KERNEL_NAMES = tuple(HISTOGRAM_KERNEL)
# BinKernel in csrc/losses/mutual_information.h
BIN_KERNEL = {"xu": 0, "rectangular": 1, "truncated_gaussian": 2}
BIN_KERNEL_NAMES = tuple(BIN_KERNEL)
# DrawKind in csrc/augmentation/draws.h
DRAW_KIND = {
    "chosen": 0,
    "uniform": 1,
    "integer": 2,
    "exponential_of_uniform": 3,
    "permutation": 4,
    "resized_crop": 5,
    "rectangle": 6,
    "beta": 7,
    "normal": 8,
    "uniform_and_affine": 9,
    "uniform_of_sample": 10,
    "rectangles": 11,
    "number": 12,
}
DRAW_KIND_NAMES = tuple(DRAW_KIND)
# TransformKind in csrc/augmentation/transforms.h
TRANSFORM_KIND = {"affine": 0, "perspective": 1, "crop": 2, "matrix": 3}
TRANSFORM_KIND_NAMES = tuple(TRANSFORM_KIND)
# Operation in csrc/augmentation/auto/operations.h
POLICY_OPERATION = {
    "identity": 0,
    "auto_contrast": 1,
    "equalize": 2,
    "invert": 3,
    "rotate": 4,
    "posterize": 5,
    "solarize": 6,
    "solarize_add": 7,
    "color": 8,
    "contrast": 9,
    "brightness": 10,
    "sharpness": 11,
    "shear_x": 12,
    "shear_y": 13,
    "translate_x": 14,
    "translate_y": 15,
    "translate_x_pixels": 16,
    "translate_y_pixels": 17,
}
POLICY_OPERATION_NAMES = tuple(POLICY_OPERATION)
# NodeKind in csrc/augmentation/preimages/preimages.h
NODE_KIND = {"outside": 0, "inside": 1, "pixel": 2}
NODE_KIND_NAMES = tuple(NODE_KIND)
# PositionKind in csrc/augmentation/preimages/preimages.h
POSITION_KIND = {"invisible": 0, "nearest_pixel": 1, "exact": 2}
POSITION_KIND_NAMES = tuple(POSITION_KIND)
# ChromaSite in csrc/color/frames/frames.h
CHROMA_SITE = {"nearest": 0, "cosited": 1, "between": 2}
CHROMA_SITE_NAMES = tuple(CHROMA_SITE)
# MixKind in csrc/augmentation/mixing/pieces.h
MIX_KIND = {"mixup": 0, "cutmix": 1, "patch_mix": 2, "jigsaw": 3, "mosaic": 4}
MIX_KIND_NAMES = tuple(MIX_KIND)
