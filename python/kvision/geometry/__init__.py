"""Geometry: images moved, bent, resized, cropped and registered; points, poses, cameras and boxes."""

from kvision import _torch_compat
from kvision.geometry import (
    bbox,
    boxes,
    calibration,
    camera,
    conversions,
    depth,
    detection,
    epipolar,
    grid,
    homography,
    keypoints,
    liegroup,
    linalg,
    line,
    optim,
    plane,
    pointcloud,
    pose,
    quaternion,
    ransac,
    ray,
    solvers,
    subpix,
    transform,
    vector,
    volumes,
)
from kvision.geometry.bbox import *  # noqa: F403
from kvision.geometry.boxes import *  # noqa: F403
from kvision.geometry.calibration import *  # noqa: F403
from kvision.geometry.camera import *  # noqa: F403
from kvision.geometry.conversions import *  # noqa: F403
from kvision.geometry.depth import *  # noqa: F403
from kvision.geometry.detection import *  # noqa: F403
from kvision.geometry.epipolar import *  # noqa: F403
from kvision.geometry.grid import *  # noqa: F403
from kvision.geometry.homography import *  # noqa: F403
from kvision.geometry.keypoints import *  # noqa: F403
from kvision.geometry.liegroup import *  # noqa: F403
from kvision.geometry.linalg import *  # noqa: F403
from kvision.geometry.line import *  # noqa: F403
from kvision.geometry.optim import *  # noqa: F403
from kvision.geometry.plane import *  # noqa: F403
from kvision.geometry.pointcloud import *  # noqa: F403
from kvision.geometry.pose import *  # noqa: F403
from kvision.geometry.quaternion import *  # noqa: F403
from kvision.geometry.ransac import *  # noqa: F403
from kvision.geometry.ray import *  # noqa: F403
from kvision.geometry.solvers import *  # noqa: F403
from kvision.geometry.subpix import *  # noqa: F403
from kvision.geometry.transform import *  # noqa: F403
from kvision.geometry.vector import *  # noqa: F403
from kvision.geometry.volumes import *  # noqa: F403

_torch_compat.refuse_script(globals())
