"""Rays: lines from an origin."""

from kvision.geometry.line import ParametrizedLine

__all__ = ["Ray"]

Ray = ParametrizedLine
