"""Lenses and poses of cameras."""

from kvision.geometry.calibration.distortion import (
    distort_points,
    tilt_projection,
    undistort_image,
    undistort_points,
)
from kvision.geometry.calibration.pnp import solve_pnp_dlt
