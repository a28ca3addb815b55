"""Camera calibration: intrinsics, lens distortion and camera poses."""

from kvision.geometry.calibration.alignment import kabsch, umeyama
from kvision.geometry.calibration.camera import CameraCalibration, calibrate_camera
from kvision.geometry.calibration.distortion import (
    distort_points,
    tilt_projection,
    undistort_image,
    undistort_points,
)
from kvision.geometry.calibration.pnp import solve_pnp_dlt
from kvision.geometry.calibration.rectification import StereoRectification, stereo_rectify
from kvision.geometry.calibration.refined_pnp import solve_pnp

__all__ = [
    "CameraCalibration",
    "StereoRectification",
    "calibrate_camera",
    "distort_points",
    "kabsch",
    "solve_pnp",
    "solve_pnp_dlt",
    "stereo_rectify",
    "tilt_projection",
    "umeyama",
    "undistort_image",
    "undistort_points",
]
