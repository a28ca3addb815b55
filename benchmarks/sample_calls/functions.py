"""Calls of the functions of color, contrib, core, enhance, image, losses, metrics, morphology and utils."""

from __future__ import annotations

from typing import Any

import torch

from benchmarks.sample_calls.model import Axes, Derived, calls, made, rand, randint
from benchmarks.sample_calls.tensors import (
    BINARY,
    BOX,
    BOXES_ROTATED,
    BOXES_XYXY,
    DISTRIBUTION,
    GRAY,
    HOMOGRAPHY,
    IMAGE,
    LABELS,
    NUMBERS,
    POSE,
    ROTATION,
    VECTORS,
    VOLUME,
)

_COLOR_MAPS: dict[tuple[str, torch.device], Any] = {}


def color_map(library: Any, device: torch.device) -> Any:
    """A table of colors, made once for each library and device: torch.compile does not trace how it is made."""
    key = library.__name__, device
    if key not in _COLOR_MAPS:
        _COLOR_MAPS[key] = library.color.ColorMap("autumn", device=device)
    return _COLOR_MAPS[key]


def mask(threshold: float) -> Axes:
    return made("B 1 H W", lambda s: (torch.rand(s.b, 1, s.h, s.w) > threshold).float())


def listed(name: str) -> Derived:
    return Derived(lambda _, tensors: [tensors[name]])


FRAMES = rand("B H//2*3 W//2*2")
EVEN_RGB, EVEN_GRAY = rand("B 3 H//2*2 W//2*2"), rand("B 1 H//2*2 W//2*2")
BINS, BANDWIDTH = made("32", lambda _: torch.linspace(0, 1, 32)), made("", lambda _: torch.tensor(0.1))
COLOR_MAP = Derived(lambda library, tensors: color_map(library, tensors["input_tensor"].device))
CFA = Derived(lambda library, _: library.color.CFA.BG)

TABLES = {
    "color": {
        "apply_colormap": dict(input_tensor=GRAY, colormap=COLOR_MAP),
        "bgr_to_grayscale rgb_to_grayscale hls_to_rgb rgb_to_hls hsv_to_rgb rgb_to_hsv lab_to_rgb rgb_to_lab "
        "linear_rgb_to_rgb rgb_to_linear_rgb luv_to_rgb rgb_to_luv bgr_to_rgb rgb_to_bgr normals_to_rgb255 "
        "rgb255_to_normals rgb255_to_rgb rgb_to_rgb255 rgb_to_xyz xyz_to_rgb rgb_to_y rgb_to_ycbcr ycbcr_to_rgb "
        "rgb_to_yuv yuv_to_rgb": dict(image=IMAGE),
        "grayscale_to_rgb": dict(image=GRAY),
        "raw_to_rgb raw_to_rgb_2x2_downscaled": dict(image=EVEN_GRAY, cfa=CFA),
        "rgb_to_raw": dict(image=EVEN_RGB, cfa=CFA),
        "bgr_to_rgba rgb_to_rgba": dict(image=IMAGE, alpha_val=0.5),
        "rgba_to_bgr rgba_to_rgb": dict(image=rand("B 4 H W")),
        "sepia": dict(input=IMAGE),
        "rgb_to_yuv420 rgb_to_yuv422": dict(image=EVEN_RGB),
        "yuv420_to_rgb": dict(imagey=EVEN_GRAY, imageuv=rand("B 2 H//2 W//2", -0.5, 0.5)),
        "frames_to_rgb": dict(planes=FRAMES),
        "resize_frames": dict(planes=FRAMES, dsize=(9, 11), antialias=True),
        "warp_frames": dict(planes=FRAMES, M=HOMOGRAPHY, dsize=(9, 11)),
        "rgb_to_frames": dict(image=EVEN_RGB),
        "yuv422_to_rgb": dict(imagey=EVEN_GRAY, imageuv=rand("B 2 H//2*2 W//2", -0.5, 0.5)),
    },
    "contrib": {
        "connected_components connected_components_union_find": dict(image=mask(0.5)),
        "distance_transform": dict(image=mask(0.98)),
        "histogram_matching": dict(source=IMAGE, template=IMAGE),
        "interp": dict(x=rand("H W"), xp=made("9", lambda _: torch.linspace(0, 1, 9)), fp=rand("9")),
        "combine_tensor_patches": dict(
            patches=rand("B H//4*(W//4) C 4 4"),
            original_size=Derived(lambda _, t: (4, 4 * t["patches"].shape[1])),
            window_size=(4, 4),
            stride=(4, 4),
        ),
        "compute_padding": dict(
            _like=IMAGE, original_size=Derived(lambda _, t: tuple(t["_like"].shape[-2:])), window_size=5
        ),
        "extract_tensor_patches": dict(input=IMAGE, window_size=(4, 5), stride=(4, 5)),
        "vision_patches": dict(
            images=IMAGE, patch_size=4, merge_size=1, min_pixels=16, max_pixels=1 << 20, mean=0.5, std=0.25
        ),
    },
    "core": {
        "eye_like": dict(n=3, input=IMAGE),
        "vec_like": dict(n=3, tensor=IMAGE),
    },
    "enhance": {
        "add_weighted": dict(src1=IMAGE, alpha=0.5, src2=IMAGE, beta=0.3, gamma=0.1),
        "adjust_brightness adjust_brightness_accumulative adjust_contrast adjust_contrast_with_mean_subtraction "
        "adjust_hue adjust_hue_raw adjust_saturation adjust_saturation_raw adjust_saturation_with_gray_subtraction": dict(
            image=IMAGE, factor=0.7
        ),
        "equalize equalize_clahe integral_tensor normalize_min_max solarize": dict(input=IMAGE),
        "histogram": dict(x=rand("B M"), bins=BINS, bandwidth=BANDWIDTH),
        "adjust_gamma": dict(input=IMAGE, gamma=0.7),
        "adjust_log adjust_sigmoid integral_image invert": dict(image=IMAGE),
        "equalize3d": dict(input=VOLUME),
        "histogram2d": dict(x1=rand("B M"), x2=rand("B M"), bins=BINS, bandwidth=BANDWIDTH),
        "image_histogram2d": dict(image=IMAGE, max=1.0, n_bins=32),
        "jpeg_codec_differentiable": dict(input=rand("B 3 H//16*16 W//16*16"), jpeg_quality=rand("B", 20, 70)),
        "normalize denormalize": dict(data=IMAGE, mean=rand("C"), std=rand("C", 0.5, 1.5)),
        "posterize": dict(input=IMAGE, bits=3),
        "sharpness": dict(input=IMAGE, factor=0.7),
        "shift_rgb": dict(image=IMAGE, r_shift=rand("B", 0, 0.3), g_shift=rand("B", 0, 0.3), b_shift=rand("B", 0, 0.3)),
        "threshold": dict(input=IMAGE, thresh=0.5, maxval=1.0),
        "linear_transform": dict(inp=rand("N 8"), transform_matrix=rand("8 8"), mean_vector=rand("1 8")),
        "zca_mean zca_whiten": dict(inp=rand("N 8")),
    },
    "image": {
        "draw_convex_polygon": dict(images=IMAGE, polygons=BOX, colors=rand("B C")),
        "draw_line": dict(
            image=rand("C H W"),
            p1=made("1 2", lambda _: torch.tensor([[1, 2]])),
            p2=made("1 2", lambda _: torch.tensor([[9, 7]])),
            color=rand("C"),
        ),
        "draw_point2d": dict(
            image=rand("C H W"), points=made("2 2", lambda _: torch.tensor([[1, 2], [9, 7]])), color=rand("C")
        ),
        "draw_rectangle": dict(
            image=IMAGE, rectangle=made("B 1 4", lambda s: torch.tensor([1.0, 2, 9, 7]).repeat(s.b, 1, 1))
        ),
        "make_grid": dict(tensor=IMAGE),
    },
    "losses": {
        "js_div_loss_2d kl_div_loss_2d": dict(pred=DISTRIBUTION, target=DISTRIBUTION),
        "binary_focal_loss_with_logits": dict(pred=IMAGE, target=BINARY),
        "focal_loss": dict(pred=IMAGE, target=LABELS, alpha=0.5),
        "lovasz_hinge_loss": dict(pred=GRAY, target=randint("B H W", 2)),
        "lovasz_softmax_loss dice_loss": dict(pred=IMAGE, target=LABELS),
        "mutual_information_loss normalized_mutual_information_loss": dict(input=rand("B M"), target=rand("B M")),
        "mutual_information_loss_2d normalized_mutual_information_loss_2d": dict(
            input=rand("B H W"), target=rand("B H W")
        ),
        "mutual_information_loss_3d normalized_mutual_information_loss_3d": dict(input=VOLUME, target=VOLUME),
        "one_hot": dict(labels=LABELS, num_classes=5, device=torch.device("cpu"), dtype=torch.float32),
        "tversky_loss": dict(pred=IMAGE, target=LABELS, alpha=0.5, beta=0.5),
        "psnr_loss": dict(image=IMAGE, target=IMAGE, max_val=1.0),
        "cauchy_loss charbonnier_loss geman_mcclure_loss welsch_loss l1_ssim_loss": dict(img1=IMAGE, img2=IMAGE),
        "inverse_depth_smoothness_loss": dict(idepth=GRAY, image=IMAGE),
        "complete_box_iou_loss distance_box_iou_loss generalized_box_iou_loss": dict(
            boxes1=BOXES_XYXY, boxes2=BOXES_XYXY
        ),
        "total_variation": dict(img=IMAGE),
        "ssim3d_loss": dict(img1=VOLUME, img2=VOLUME, window_size=5),
        "ssim_loss": dict(img1=IMAGE, img2=IMAGE, window_size=5),
    },
    "metrics": {
        "accuracy": dict(pred=rand("B 10"), target=randint("B", 10)),
        "mean_average_precision": dict(
            _boxes=BOXES_XYXY,
            _labels=randint("N", 3),
            _scores=rand("N"),
            pred_boxes=listed("_boxes"),
            pred_labels=listed("_labels"),
            pred_scores=listed("_scores"),
            gt_boxes=listed("_boxes"),
            gt_labels=listed("_labels"),
            n_classes=4,
        ),
        "mean_iou_bbox": dict(boxes_1=BOXES_XYXY, boxes_2=BOXES_XYXY),
        "generalized_box_iou distance_box_iou complete_box_iou": dict(boxes1=BOXES_XYXY, boxes2=BOXES_XYXY),
        "box_iou_rotated": dict(boxes1=BOXES_ROTATED, boxes2=BOXES_ROTATED),
        "confusion_matrix mean_iou": dict(pred=LABELS, target=LABELS, num_classes=3),
        "kitti_d1_error mean_absolute_disparity_error mean_bad_pixel_error root_mean_squared_disparity_error": dict(
            input=GRAY, target=GRAY
        ),
        "aepe": dict(input=rand("B H W 2"), target=rand("B H W 2")),
        "angle_error_mat": dict(R1=ROTATION, R2=ROTATION),
        "angle_error_vec": dict(v1=VECTORS, v2=VECTORS),
        "auc_from_errors": dict(errors=rand("N", 0, 10)),
        "pose_errors": dict(P=POSE, P_gt=POSE),
        "translation_ate": dict(t=VECTORS, t_gt=VECTORS),
        "psnr": dict(image=IMAGE, target=IMAGE, max_val=1.0),
        "ssim": dict(img1=IMAGE, img2=IMAGE, window_size=5),
        "ssim3d": dict(img1=VOLUME, img2=VOLUME, window_size=5),
    },
    "morphology": {
        "dilation bottom_hat closing gradient opening top_hat erosion": dict(tensor=IMAGE, kernel=rand("3 3", 1, 1)),
        "reconstruction": dict(seed=IMAGE, mask=IMAGE, num_iters=8),
    },
    "utils": {
        "get_cuda_device_if_available get_cuda_or_mps_device_if_available get_mps_device_if_available is_autocast_enabled "
        "xla_is_available": dict(),
        "is_mps_tensor_safe": dict(x=NUMBERS),
        "safe_inverse_with_mask": dict(A=HOMOGRAPHY),
        "safe_solve_with_mask": dict(B=rand("B 3 2"), A=HOMOGRAPHY),
    },
}
CALLS = [call for module, table in TABLES.items() for call in calls(module, table)]
