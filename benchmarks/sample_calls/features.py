"""Calls of the functions and modules of features."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from benchmarks.sample_calls.model import Axes, SampleCall, Size, calls, made, rand
from benchmarks.sample_calls.tensors import GRAY, HOMOGRAPHY, IMAGE, VOLUME


def frames(s: Size) -> Tensor:
    """Half as many local affine frames as an image has columns, a tenth of its height in size, inside of it."""
    shape = 0.05 * s.h * (torch.eye(2) + 0.2 * torch.rand(s.b, s.w // 2, 2, 2))
    center = torch.tensor([s.w, s.h]) * (0.2 + 0.6 * torch.rand(s.b, s.w // 2, 2))
    return torch.cat([shape, center[..., None]], -1)


def ellipses(s: Size) -> Tensor:
    a, b, c = torch.rand(3, s.b, s.w // 2)
    return torch.stack([s.w * a, s.h * b, 0.1 + a, 0.1 * b, 0.1 + c], -1)


FRAMES = made("B N//2 2 3", frames)
PAIR = dict.fromkeys(("desc1", "desc2"), made("N//2 128", lambda s: normalize(torch.rand(s.w // 2, 128), dim=1)))
PAIRS = dict.fromkeys(
    ("desc1", "desc2"), made("B N//2 128", lambda s: normalize(torch.rand(s.b, s.w // 2, 128), dim=2))
)
PAIR_OF_FRAMES = dict.fromkeys(("lafs1", "lafs2"), made("1 N//2 2 3", lambda s: frames(s._replace(b=1))))
FRAMES_AND_IMAGE = dict(laf=FRAMES, img=GRAY)
PATCHES = {size: rand(f"16*B 1 {size} {size}") for size in (19, 32, 41)}

FUNCTIONS = {
    "denormalize_laf normalize_laf": dict(LAF=FRAMES, images=IMAGE),
    "ellipse_to_laf": dict(ells=made("B N//2 5", ellipses)),
    "get_laf_center get_laf_orientation get_laf_scale laf_to_boundary_points": dict(LAF=FRAMES),
    "laf_from_center_scale_ori": dict(xy=made("B N//2 2", lambda s: frames(s)[..., 2])),
    "laf_from_three_points": dict(threepts=FRAMES),
    "laf_is_filled laf_is_valid laf_to_three_points make_upright": dict(laf=FRAMES),
    "laf_is_inside_image": dict(laf=FRAMES, images=IMAGE),
    "perspective_transform_lafs": dict(trans_01=HOMOGRAPHY, lafs_1=FRAMES),
    "rotate_laf set_laf_orientation": dict(LAF=FRAMES, angles_degrees=rand("B N//2 1", 0, 360)),
    "scale_laf": dict(laf=FRAMES, scale_coef=2.0),
    "match_nn match_mnn match_snn match_smnn": PAIR,
    "match_smnn_batched": PAIRS,
    "match_fginn match_adalam": {**PAIR, **PAIR_OF_FRAMES},
    "extract_patches_from_pyramid extract_patches_simple": dict(img=GRAY, laf=FRAMES),
    "dog_response": dict(input=VOLUME),
    "dog_response_single gftt_response harris_response hessian_response": dict(input=GRAY),
    "convert_sift_descriptor_layout": dict(descriptors=PAIR["desc1"], source="kornia", target="opencv"),
}


def module(name: str, axes: dict[str, Axes], *args: Any, **others: Any) -> SampleCall:
    return SampleCall(f"feature.{name}", axes, others, args)


CALLS = [
    *calls("feature", FUNCTIONS),
    module("SIFTDescriptor", dict(input=PATCHES[41])),
    module("DenseSIFTDescriptor", dict(input=GRAY)),
    module("MKDDescriptor", dict(patches=PATCHES[32]), output_dims=64, whitening=None),
    module("PatchDominantGradientOrientation", dict(patch=PATCHES[32])),
    module("PatchAffineShapeEstimator", dict(patch=PATCHES[19])),
    *(module(name, FRAMES_AND_IMAGE, 32) for name in ("LAFOrienter", "LAFAffineShapeEstimator")),
    *(module(name, dict(input=PATCHES[32]), False) for name in ("HardNet", "HyNet", "SOSNet", "TFeat", "OriNet")),
    module("KeyNet", dict(x=GRAY), False),
    module("ScaleSpaceDetector", dict(img=GRAY), 100),
]
