"""Geometry: images moved, bent, resized, cropped and registered; cameras and what several of them see."""

from kvision.geometry import calibration, epipolar, homography, solvers, transform
from kvision.geometry.calibration import *  # noqa: F403
from kvision.geometry.epipolar import *  # noqa: F403
from kvision.geometry.homography import *  # noqa: F403
from kvision.geometry.solvers import *  # noqa: F403
from kvision.geometry.transform import *  # noqa: F403
