"""Chains of matrices and maps as one warp."""
