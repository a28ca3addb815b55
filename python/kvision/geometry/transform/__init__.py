"""Geometric transforms of images (B, C, H, W) and volumes (B, C, D, H, W)."""

from kvision.geometry.transform.affine import (
    Affine,
    Rotate,
    Scale,
    Shear,
    Translate,
    affine,
    rotate,
    scale,
    shear,
    translate,
)
from kvision.geometry.transform.crop import (
    CenterCrop2D,
    center_crop,
    crop_and_resize,
    crop_by_boxes,
    crop_by_indices,
    crop_by_transform_mat,
)
from kvision.geometry.transform.crop3d import (
    center_crop3d,
    crop_and_resize3d,
    crop_by_boxes3d,
    crop_by_transform_mat3d,
)
from kvision.geometry.transform.elastic import elastic_transform2d
from kvision.geometry.transform.flip import Hflip, Rot180, Vflip, hflip, rot180, vflip
from kvision.geometry.transform.homography_warper import BaseWarper, HomographyWarper
from kvision.geometry.transform.lists.letterbox import Letterboxed, PaddedBatch, letterbox, pad_to_batch
from kvision.geometry.transform.matrices import (
    get_affine_matrix2d,
    get_affine_matrix3d,
    get_perspective_transform,
    get_perspective_transform3d,
    get_projective_transform,
    get_rotation_matrix2d,
    get_shear_matrix2d,
    get_shear_matrix3d,
    get_translation_matrix2d,
    invert_affine_transform,
    projection_from_Rt,
)
from kvision.geometry.transform.photometric import photometric_homography_loss, photometric_normal_equations
from kvision.geometry.transform.pyramid import (
    PyrDown,
    PyrUp,
    ScalePyramid,
    build_laplacian_pyramid,
    build_pyramid,
    pyrdown,
    pyrup,
)
from kvision.geometry.transform.registration import BaseModel, Homography, ImageRegistrator, Similarity
from kvision.geometry.transform.resize import Rescale, Resize, rescale, resize, resize_to_be_divisible
from kvision.geometry.transform.thin_plate import get_tps_transform, warp_image_tps, warp_points_tps
from kvision.geometry.transform.warp import homography_warp, remap, warp_affine, warp_grid, warp_perspective
from kvision.geometry.transform.warp3d import (
    affine3d,
    homography_warp3d,
    rotate3d,
    warp_affine3d,
    warp_grid3d,
    warp_perspective3d,
)
