"""Camera calibration: intrinsics, lens distortion and camera poses."""

from kvision.geometry.calibration.camera import CameraCalibration, calibrate_camera
from kvision.geometry.calibration.distortion import (
    distort_points,
    tilt_projection,
    undistort_image,
    undistort_points,
)
from kvision.geometry.calibration.pnp import solve_pnp_dlt

__all__ = [
    "CameraCalibration",
    "calibrate_camera",
    "distort_points",
    "solve_pnp_dlt",
    "tilt_projection",
    "undistort_image",
    "undistort_points",
]
