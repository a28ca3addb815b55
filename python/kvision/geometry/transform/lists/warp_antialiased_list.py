"""Antialiased warps of lists of images by a matrix each: the operator `warp_antialiased` for one image after the other."""

from __future__ import annotations

from kvision.geometry.transform.antialiased import warp_antialiased as batches
from kvision.geometry.transform.lists.register_warp import register_warp

# Options: those of `warp_list` without an interpolation.
warp_antialiased_list, warp_antialiased_list_backward, warp_antialiased_list_matrix_backward = register_warp(
    "warp_antialiased_list",
    batches.warp_antialiased,
    batches._warp_image_backward,
    batches._warp_matrix_backward,
    lambda grads, *args: grads[0].is_cuda,
)
