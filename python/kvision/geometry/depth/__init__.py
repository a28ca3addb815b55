"""Depth: points, normals and warps of depth images."""

from kvision.geometry.depth.photometric import photometric_depth_loss
from kvision.geometry.depth.points import (
    depth_from_disparity,
    depth_from_plane_equation,
    depth_to_3d,
    depth_to_3d_v2,
    depth_to_normals,
    unproject_meshgrid,
)
from kvision.geometry.depth.warp import DepthWarper, depth_warp, warp_frame_depth
