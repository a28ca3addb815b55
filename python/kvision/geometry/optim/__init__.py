"""Optimization: nonlinear least squares on manifolds."""

from kvision.geometry.optim.least_squares import LeastSquaresResult, least_squares
from kvision.geometry.optim.reprojection import ReprojectionError

__all__ = ["LeastSquaresResult", "ReprojectionError", "least_squares"]
