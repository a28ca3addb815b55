"""Geometry: images moved, bent, resized, cropped and registered; points, poses and cameras."""

from kvision.geometry import camera, conversions, depth, grid, linalg, subpix, transform
from kvision.geometry.camera import *  # noqa: F403
from kvision.geometry.conversions import *  # noqa: F403
from kvision.geometry.depth import *  # noqa: F403
from kvision.geometry.grid import *  # noqa: F403
from kvision.geometry.linalg import *  # noqa: F403
from kvision.geometry.subpix import *  # noqa: F403
from kvision.geometry.transform import *  # noqa: F403
