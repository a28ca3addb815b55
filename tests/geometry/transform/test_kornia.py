"""Every function of geometry.transform against Kornia 0.9, which defines names, arguments and conventions.

docs/differences.md has what is not compared here: shears about a center in space, and the weights of thin-plate splines.
"""

import kornia
import pytest
import torch
from torch import Tensor

import kvision as K
from op_tests import assert_close

G = K.geometry
theirs = kornia.geometry.transform


def rand(*shape: int, low: float = 0.0, high: float = 1.0, seed: int = 0) -> Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * (high - low) + low


IMAGES = rand(2, 3, 9, 14)
VOLUMES = rand(2, 1, 4, 5, 6)
HOMOGRAPHIES = torch.eye(3).double() + rand(2, 3, 3, low=-0.05, high=0.05)
HOMOGRAPHIES_3D = torch.eye(4).double() + rand(2, 4, 4, low=-0.03, high=0.03)
CENTERS, CENTERS_3D = rand(2, 2, high=9), rand(2, 3, high=5)
ANGLES, ANGLES_3D = torch.tensor([33.0, -120.0]).double(), rand(2, 3, low=-60, high=60)
QUADS = torch.tensor([[[1.0, 1], [11, 2], [10, 7], [2, 8]], [[3.0, 0], [9, 1], [12, 6], [4, 7]]]).double()
BOXES = torch.tensor([[[1.0, 2], [7, 2], [7, 6], [1, 6]], [[4.0, 1], [10, 1], [10, 5], [4, 5]]]).double()
CORNERS = torch.tensor(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
).double()
BOXES_3D = (CORNERS * torch.tensor([3.0, 2, 1]) + torch.tensor([1.0, 1, 2])).expand(2, 8, 3)
SHEARS = {
    name: rand(2, low=-0.3, high=0.3, seed=i) for i, name in enumerate(("sxy", "sxz", "syx", "syz", "szx", "szy"))
}
SCALES = rand(2, 2, low=0.7, high=1.4)

# Name, arguments, keyword arguments.
CALLS = [
    ("warp_affine", (IMAGES, HOMOGRAPHIES[:, :2], (7, 12)), {}),
    ("warp_affine", (IMAGES, HOMOGRAPHIES[:, :2], (7, 12)), {"padding_mode": "fill", "fill_value": torch.rand(3).double()}),
    ("warp_perspective", (IMAGES, HOMOGRAPHIES, (7, 12)), {"mode": "bicubic", "align_corners": False}),
    ("homography_warp", (IMAGES, HOMOGRAPHIES, (7, 12)), {}),
    ("homography_warp", (IMAGES, HOMOGRAPHIES, (7, 12)), {"align_corners": True, "padding_mode": "reflection"}),
    ("homography_warp", (IMAGES, HOMOGRAPHIES, (7, 12)), {"normalized_coordinates": False}),
    ("remap", (IMAGES, rand(2, 5, 6, high=13), rand(2, 5, 6, high=8)), {"align_corners": True}),
    ("remap", (IMAGES, rand(2, 5, 6, low=-1), rand(2, 5, 6, low=-1)), {"normalized_coordinates": True}),
    ("warp_grid", (rand(1, 4, 5, 2), HOMOGRAPHIES), {}),
    ("warp_grid3d", (rand(1, 3, 4, 5, 3), HOMOGRAPHIES_3D), {}),
    ("warp_affine3d", (VOLUMES, HOMOGRAPHIES_3D[:, :3], (3, 6, 5)), {}),
    ("warp_perspective3d", (VOLUMES, HOMOGRAPHIES_3D, (4, 5, 6)), {"align_corners": True}),
    ("homography_warp3d", (VOLUMES, HOMOGRAPHIES_3D, (3, 6, 5)), {"align_corners": True, "padding_mode": "border"}),
    ("get_perspective_transform", (QUADS, BOXES), {}),
    ("get_perspective_transform3d", (BOXES_3D, BOXES_3D + 0.1 * rand(2, 8, 3)), {}),
    ("get_projective_transform", (CENTERS_3D, ANGLES_3D, rand(2, 3) + 0.5), {}),
    ("get_rotation_matrix2d", (CENTERS, ANGLES, SCALES), {}),
    ("get_affine_matrix2d", (CENTERS, CENTERS + 1, SCALES, ANGLES, rand(2), rand(2, seed=1)), {}),
    ("get_affine_matrix2d", (CENTERS, CENTERS + 1, SCALES, ANGLES), {}),
    ("get_affine_matrix3d", (CENTERS_3D, 0 * CENTERS_3D, rand(2, 3) + 0.5, ANGLES_3D), SHEARS),
    ("get_shear_matrix2d", (CENTERS, rand(2), rand(2, seed=1)), {}),
    ("get_shear_matrix3d", (0 * CENTERS_3D,), SHEARS),
    ("get_translation_matrix2d", (CENTERS,), {}),
    ("invert_affine_transform", (HOMOGRAPHIES[:, :2],), {}),
    ("projection_from_Rt", (rand(2, 3, 3), rand(2, 3, 1)), {}),
    ("affine", (IMAGES, HOMOGRAPHIES[:, :2]), {}),
    ("affine3d", (VOLUMES, HOMOGRAPHIES_3D[:, :3]), {"align_corners": True}),
    ("rotate", (IMAGES, ANGLES), {}),
    ("rotate", (IMAGES, ANGLES, CENTERS), {"padding_mode": "border"}),
    ("rotate3d", (VOLUMES, *ANGLES_3D[:, :2].unbind(), ANGLES), {"align_corners": True}),
    ("translate", (IMAGES, CENTERS), {}),
    ("scale", (IMAGES, SCALES), {}),
    ("scale", (IMAGES, SCALES[:, :1], CENTERS), {}),
    ("shear", (IMAGES, rand(2, 2, low=-0.3, high=0.3)), {}),
    ("resize", (IMAGES, (5, 21)), {}),
    ("resize", (IMAGES, 6), {"side": "long", "interpolation": "bicubic", "align_corners": True}),
    ("resize", (IMAGES[0], 5), {"interpolation": "area"}),
    ("resize", (IMAGES[0, 0], 20), {"interpolation": "nearest", "side": "vert"}),
    ("rescale", (IMAGES, (0.7, 1.3)), {}),
    ("resize_to_be_divisible", (IMAGES, 4), {}),
    ("pyrdown", (IMAGES,), {}),
    ("pyrdown", (IMAGES,), {"factor": 1.5, "border_type": "replicate", "align_corners": True}),
    ("pyrup", (IMAGES,), {}),
    ("build_pyramid", (rand(1, 2, 33, 40), 3), {}),
    ("build_laplacian_pyramid", (rand(1, 2, 12, 20), 3), {}),
    ("build_laplacian_pyramid", (rand(1, 2, 16, 24), 3), {}),
    ("center_crop", (IMAGES, (5, 8)), {}),
    ("center_crop", (IMAGES, (4, 9)), {}),
    ("center_crop", (IMAGES, (11, 16)), {}),
    ("crop_and_resize", (IMAGES, BOXES, (6, 9)), {}),
    ("crop_and_resize", (IMAGES, QUADS, (6, 9)), {"padding_mode": "border"}),
    ("crop_by_boxes", (IMAGES, QUADS, BOXES - BOXES[:, :1]), {"validate_boxes": False}),
    ("crop_by_boxes", (IMAGES, BOXES, BOXES - 0.5), {}),
    ("crop_by_transform_mat", (IMAGES, HOMOGRAPHIES, (4, 5)), {}),
    ("crop_by_indices", (IMAGES, BOXES.long()), {}),
    ("crop_by_indices", (IMAGES, BOXES.long(), (4, 4)), {}),
    ("crop_by_indices", (IMAGES, BOXES.long(), (9, 9)), {"shape_compensation": "pad"}),
    ("crop_and_resize3d", (VOLUMES, BOXES_3D, (2, 4, 5)), {"align_corners": True}),
    ("crop_by_boxes3d", (VOLUMES, BOXES_3D, BOXES_3D - BOXES_3D[:, :1]), {"align_corners": True}),
    ("crop_by_transform_mat3d", (VOLUMES, HOMOGRAPHIES_3D[:, :3], (2, 3, 4)), {}),
    ("center_crop3d", (VOLUMES, (2, 3, 3)), {}),
    ("hflip", (IMAGES,), {}),
    ("vflip", (IMAGES[0],), {}),
    ("rot180", (IMAGES,), {}),
    ("elastic_transform2d", (IMAGES, rand(2, 2, 9, 14, low=-1)), {"kernel_size": (7, 5), "sigma": (2.0, 3.0), "alpha": (0.8, 0.5)}),
    ("warp_points_tps", (rand(2, 7, 2), QUADS / 12, rand(2, 4, 2), rand(2, 3, 2)), {}),
    ("warp_image_tps", (IMAGES, QUADS / 12, 0.1 * rand(2, 4, 2), torch.eye(3)[:, 1:].double().expand(2, 3, 2)), {}),
]  # fmt: skip


@pytest.mark.parametrize("name, args, kwargs", CALLS, ids=[f"{i}-{call[0]}" for i, call in enumerate(CALLS)])
def test_function(name, args, kwargs, device):
    expected = getattr(theirs, name)(*args, **kwargs)
    moved = [a.to(device) if isinstance(a, Tensor) else a for a in args]
    result = getattr(G, name)(*moved, **{k: v.to(device) if isinstance(v, Tensor) else v for k, v in kwargs.items()})
    for ours, his in zip(*(x if isinstance(x, (list, tuple)) else [x] for x in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-6, 1e-6)


MODULES = [
    ("Rotate", (ANGLES,)),
    ("Translate", (CENTERS,)),
    ("Scale", (SCALES,)),
    ("Shear", (rand(2, 2, low=-0.3, high=0.3),)),
    ("Affine", (ANGLES, CENTERS, SCALES, rand(2, 2, low=-0.3, high=0.3))),
    ("Affine", (None, None, SCALES)),
    ("Resize", ((5, 8),)),
    ("Rescale", (0.6,)),
    ("PyrDown", ()),
    ("PyrUp", ()),
    ("Hflip", ()),
    ("Vflip", ()),
    ("Rot180", ()),
    ("CenterCrop2D", ((4, 5),)),
]


@pytest.mark.parametrize("name, args", MODULES, ids=[f"{i}-{m[0]}" for i, m in enumerate(MODULES)])
def test_module(name, args, device):
    ours = getattr(G, name)(*args).to(device)
    assert_close(ours(IMAGES.to(device)).cpu(), getattr(theirs, name)(*args)(IMAGES), 1e-6, 1e-6)
    assert name in repr(ours)


@pytest.mark.parametrize("double_image", [False, True])
def test_scale_pyramid(double_image, device):
    x = rand(1, 1, 50, 64).float()
    expected = theirs.ScalePyramid(3, 1.6, 10, double_image)(x)
    result = G.ScalePyramid(3, 1.6, 10, double_image)(x.to(device))
    for ours, his in zip(result, expected, strict=True):
        for a, b in zip(ours, his, strict=True):
            assert_close(a.cpu(), b, 1e-4, 1e-5)


def test_warper(device):
    x, M = IMAGES.to(device), HOMOGRAPHIES.to(device)
    warper = G.HomographyWarper(7, 12)
    expected = theirs.HomographyWarper(7, 12)(IMAGES, HOMOGRAPHIES)
    assert_close(warper(x, M).cpu(), expected)
    with pytest.raises(RuntimeError, match="precompute_warp_grid"):
        warper(x)
    warper.precompute_warp_grid(M)
    assert_close(warper(x).cpu(), expected)
