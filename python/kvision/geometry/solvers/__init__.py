"""Batched solvers of small systems of equations."""

from kvision.geometry.solvers.affine import find_affine
from kvision.geometry.solvers.null_vector import null_vector_3x4
from kvision.geometry.solvers.polynomials import (
    determinant_to_polynomial,
    multiply_deg_one_poly,
    multiply_deg_two_one_poly,
)
from kvision.geometry.solvers.roots import solve_cubic, solve_quadratic, solve_quartic

__all__ = [
    "determinant_to_polynomial",
    "find_affine",
    "multiply_deg_one_poly",
    "multiply_deg_two_one_poly",
    "null_vector_3x4",
    "solve_cubic",
    "solve_quadratic",
    "solve_quartic",
]
