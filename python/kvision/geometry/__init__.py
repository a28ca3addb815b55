"""Geometry: images moved, bent, resized, cropped and registered; points, poses and cameras, and what several of them see."""

from kvision.geometry import (
    calibration,
    camera,
    conversions,
    epipolar,
    grid,
    homography,
    linalg,
    solvers,
    transform,
)
from kvision.geometry.calibration import *  # noqa: F403
from kvision.geometry.camera import *  # noqa: F403
from kvision.geometry.conversions import *  # noqa: F403
from kvision.geometry.epipolar import *  # noqa: F403
from kvision.geometry.grid import *  # noqa: F403
from kvision.geometry.homography import *  # noqa: F403
from kvision.geometry.linalg import *  # noqa: F403
from kvision.geometry.solvers import *  # noqa: F403
from kvision.geometry.transform import *  # noqa: F403
