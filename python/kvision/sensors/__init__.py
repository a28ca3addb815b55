"""Models of sensors: cameras by their lens and projection, in :mod:`kvision.sensors.camera`."""

from kvision.sensors import camera

__all__ = ["camera"]
