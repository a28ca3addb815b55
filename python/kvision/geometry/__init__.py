"""Geometry: images moved, bent, resized, cropped and registered."""

from kvision.geometry import transform
from kvision.geometry.transform import *  # noqa: F403
