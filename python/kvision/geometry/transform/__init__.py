"""Geometric transforms of images (B, C, H, W) and volumes (B, C, D, H, W)."""

from kvision.geometry.transform.warp import homography_warp, remap, warp_affine, warp_grid, warp_perspective
