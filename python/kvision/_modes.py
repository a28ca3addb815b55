"""Stable numbers of the modes that operators take.

Operators take small integers: torch's stable C interface leaks 48 bytes for each string argument of a call. The numbers
never change, so that exported graphs keep their meaning. The C++ enums with the same numbers are named next to each table.
"""

BORDER = {"constant": 0, "reflect": 1, "replicate": 2, "circular": 3}  # Border in csrc/core/border.h
BORDER_NAMES = tuple(BORDER)
COLOR_DISTANCE = {"l1": 0, "l2": 1}  # ColorDistance in csrc/filters/bilateral.h
DERIVATIVE_MODE = {"sobel": 0, "diff": 1}  # DerivativeMode in csrc/filters/spatial_gradient.h
DERIVATIVE_MODE_NAMES = tuple(DERIVATIVE_MODE)
