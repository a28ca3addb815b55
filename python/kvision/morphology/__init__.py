"""Morphology of images (B, C, H, W): dilation, erosion and their compositions.

A structuring element is a mask (kH, kW) with its origin in the middle, and may have heights. Everything is differentiable.
"""

from kvision import _torch_compat
from kvision.morphology.compositions import bottom_hat, closing, gradient, opening, top_hat
from kvision.morphology.dilation import dilation, erosion
from kvision.morphology.reconstruction import reconstruction

_torch_compat.refuse_script(globals())
