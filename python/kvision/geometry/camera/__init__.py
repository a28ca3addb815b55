"""Cameras: projection of points in space to pixels, and back-projection."""

from kvision.geometry.camera.distortion import (
    distort_points_affine,
    distort_points_kannala_brandt,
    dx_distort_points_affine,
    dx_distort_points_kannala_brandt,
    undistort_points_affine,
    undistort_points_kannala_brandt,
)
from kvision.geometry.camera.perspective import project_points, unproject_points
from kvision.geometry.camera.pinhole import PinholeCamera
from kvision.geometry.camera.pixel import cam2pixel, pixel2cam
from kvision.geometry.camera.projection import (
    dx_project_points_orthographic,
    dx_project_points_z1,
    project_points_orthographic,
    project_points_z1,
    unproject_points_orthographic,
    unproject_points_z1,
)
from kvision.geometry.camera.reprojection import reproject_image
from kvision.geometry.camera.stereo import StereoCamera
