"""Camera calibration: intrinsics, lens distortion and camera poses."""

from kvision.geometry.calibration.alignment import kabsch, umeyama
from kvision.geometry.calibration.camera import CameraCalibration, calibrate_camera
from kvision.geometry.calibration.distortion import (
    distort_points,
    tilt_projection,
    undistort_image,
    undistort_points,
)
from kvision.geometry.calibration.p3p import solve_p3p
from kvision.geometry.calibration.pnp import solve_pnp_dlt
from kvision.geometry.calibration.rectification import StereoRectification, stereo_rectify
from kvision.geometry.calibration.refined_pnp import solve_pnp
from kvision.geometry.calibration.rig import RigCalibration, calibrate_rig
from kvision.geometry.calibration.robust_pose import kabsch_ransac, solve_pnp_ransac, umeyama_ransac

__all__ = [
    "CameraCalibration",
    "RigCalibration",
    "StereoRectification",
    "calibrate_camera",
    "calibrate_rig",
    "distort_points",
    "kabsch",
    "kabsch_ransac",
    "solve_p3p",
    "solve_pnp",
    "solve_pnp_dlt",
    "solve_pnp_ransac",
    "stereo_rectify",
    "tilt_projection",
    "umeyama",
    "umeyama_ransac",
    "undistort_image",
    "undistort_points",
]
