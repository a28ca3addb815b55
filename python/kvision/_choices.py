"""The words that arguments of several modules choose from: types, which editors complete and type checkers read.

`typing.get_args` gives the words of a type to the check and to its message. What one module alone takes is declared there.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

Border: TypeAlias = Literal["constant", "reflect", "replicate", "circular"]
Reduction: TypeAlias = Literal["none", "mean", "sum"]
WindowPadding: TypeAlias = Literal["same", "valid"]
Behaviour: TypeAlias = Literal["corr", "conv"]
DerivativeMode: TypeAlias = Literal["sobel", "diff"]
Distance: TypeAlias = Literal["l1", "l2", "charbonnier"]
OutputType: TypeAlias = Literal["pt", "numpy", "pil"]

# How an image is read between pixels and out of bounds.
Linear: TypeAlias = Literal["bilinear", "nearest"]  # also of volumes
Interpolation: TypeAlias = Literal["bilinear", "nearest", "bicubic"]
ResizeInterpolation: TypeAlias = Literal["bilinear", "nearest", "nearest-exact", "bicubic", "area", "lanczos"]
ResizeSide: TypeAlias = Literal["short", "long", "vert", "horz"]
Padding: TypeAlias = Literal["zeros", "border", "reflection"]
PaddingOrFill: TypeAlias = Literal["zeros", "border", "reflection", "fill"]
CroppingMode: TypeAlias = Literal["slice", "resample"]

# Of containers: how often neighbors interpolate, and what children without a matrix do; "silence" is a word of Kornia's policies.
EachOrOnce: TypeAlias = Literal["each", "once"]
MatrixMode: TypeAlias = Literal["silent", "silence", "rigid", "skip"]
