"""Cameras: how points of space come to pixels, and back."""

from kvision.geometry.camera.perspective import project_points, unproject_points
from kvision.geometry.camera.pinhole import PinholeCamera
