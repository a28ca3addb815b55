"""Geometry: images moved, bent, resized, cropped and registered; points, poses, cameras and boxes."""

from kvision.geometry import bbox, boxes, camera, conversions, grid, keypoints, linalg, subpix, transform
from kvision.geometry.bbox import *  # noqa: F403
from kvision.geometry.boxes import *  # noqa: F403
from kvision.geometry.camera import *  # noqa: F403
from kvision.geometry.conversions import *  # noqa: F403
from kvision.geometry.grid import *  # noqa: F403
from kvision.geometry.keypoints import *  # noqa: F403
from kvision.geometry.linalg import *  # noqa: F403
from kvision.geometry.subpix import *  # noqa: F403
from kvision.geometry.transform import *  # noqa: F403
