"""The steps of color programs, in one table: csrc/color/step_list.h has the same table, and a test compares both.

Numbers are stable, because exported graphs contain them. A new step takes the next number, at the end of both tables.
"""

from __future__ import annotations

from typing import NamedTuple


class Step(NamedTuple):
    """What kernels know of a step, in the columns of step_list.h."""

    number: int
    parameters: int
    domain: str  # rgb: needs three channels; any: the same for all channels
    arguments: str  # numbers: parameters are the same for all samples; tensors: they may be tensors
    channels: str  # of the result: same as before, or one
    affine: str  # always, unless_clipped or never


STEPS = {
    "affine": Step(0, 13, "rgb", "numbers", "same", "unless_clipped"),
    "rgb_to_hsv": Step(1, 1, "rgb", "numbers", "same", "never"),
    "hsv_to_rgb": Step(2, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_hls": Step(3, 1, "rgb", "numbers", "same", "never"),
    "hls_to_rgb": Step(4, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_linear_rgb": Step(5, 0, "rgb", "numbers", "same", "never"),
    "linear_rgb_to_rgb": Step(6, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_lab": Step(7, 0, "rgb", "numbers", "same", "never"),
    "lab_to_rgb": Step(8, 1, "rgb", "numbers", "same", "never"),
    "rgb_to_luv": Step(9, 1, "rgb", "numbers", "same", "never"),
    "luv_to_rgb": Step(10, 1, "rgb", "numbers", "same", "never"),
    "luma_u8_fixed_point": Step(11, 3, "rgb", "numbers", "one", "never"),
    "hsv_u8": Step(12, 0, "rgb", "numbers", "same", "never"),
    "weighted_sum": Step(13, 3, "rgb", "tensors", "one", "always"),
    "luma_u8": Step(14, 3, "rgb", "tensors", "one", "never"),
    "scale_shift_rgb": Step(15, 7, "rgb", "tensors", "same", "unless_clipped"),
    "standardize_rgb": Step(16, 6, "rgb", "tensors", "same", "always"),
    "saturation": Step(17, 1, "rgb", "tensors", "same", "never"),
    "saturation_raw": Step(18, 1, "rgb", "tensors", "same", "never"),
    "saturation_gray": Step(19, 1, "rgb", "tensors", "same", "never"),
    "hue": Step(20, 1, "rgb", "tensors", "same", "never"),
    "hue_raw": Step(21, 1, "rgb", "tensors", "same", "never"),
    "contrast": Step(22, 2, "any", "tensors", "same", "never"),
    "scale_shift": Step(23, 3, "any", "tensors", "same", "unless_clipped"),
    "standardize": Step(24, 2, "any", "tensors", "same", "always"),
    "gamma": Step(25, 2, "any", "tensors", "same", "never"),
    "log": Step(26, 3, "any", "tensors", "same", "never"),
    "sigmoid": Step(27, 3, "any", "tensors", "same", "never"),
    "solarize": Step(28, 3, "any", "tensors", "same", "never"),
    "posterize": Step(29, 2, "any", "tensors", "same", "never"),
    "threshold": Step(30, 5, "any", "tensors", "same", "never"),
}
NAMES = {step.number: name for name, step in STEPS.items()}
CONTRAST = STEPS["contrast"].number  # the last parameter is the mean of the image before this step
