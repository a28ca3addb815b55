"""The rows of csrc/color/step_list.h, whose columns it explains.

Written by tools/generate.py from the declarations in csrc that it names.
"""

STEP_LIST = {
    "affine": (0, 13, "rgb", "numbers", "same", "unless_clipped"),
    "rgb_to_hsv": (1, 1, "rgb", "numbers", "same", "never"),
    "hsv_to_rgb": (2, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_hls": (3, 1, "rgb", "numbers", "same", "never"),
    "hls_to_rgb": (4, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_linear_rgb": (5, 0, "rgb", "numbers", "same", "never"),
    "linear_rgb_to_rgb": (6, 0, "rgb", "numbers", "same", "never"),
    "rgb_to_lab": (7, 0, "rgb", "numbers", "same", "never"),
    "lab_to_rgb": (8, 1, "rgb", "numbers", "same", "never"),
    "rgb_to_luv": (9, 1, "rgb", "numbers", "same", "never"),
    "luv_to_rgb": (10, 1, "rgb", "numbers", "same", "never"),
    "luma_u8_fixed_point": (11, 3, "rgb", "numbers", "one", "never"),
    "hsv_u8": (12, 0, "rgb", "numbers", "same", "never"),
    "weighted_sum": (13, 3, "rgb", "tensors", "one", "always"),
    "luma_u8": (14, 3, "rgb", "tensors", "one", "never"),
    "scale_shift_rgb": (15, 7, "rgb", "tensors", "same", "unless_clipped"),
    "standardize_rgb": (16, 6, "rgb", "tensors", "same", "always"),
    "saturation": (17, 1, "rgb", "tensors", "same", "never"),
    "saturation_raw": (18, 1, "rgb", "tensors", "same", "never"),
    "saturation_gray": (19, 1, "rgb", "tensors", "same", "never"),
    "hue": (20, 1, "rgb", "tensors", "same", "never"),
    "hue_raw": (21, 1, "rgb", "tensors", "same", "never"),
    "contrast": (22, 2, "any", "tensors", "same", "never"),
    "scale_shift": (23, 3, "any", "tensors", "same", "unless_clipped"),
    "standardize": (24, 2, "any", "tensors", "same", "always"),
    "gamma": (25, 2, "any", "tensors", "same", "never"),
    "log": (26, 3, "any", "tensors", "same", "never"),
    "sigmoid": (27, 3, "any", "tensors", "same", "never"),
    "solarize": (28, 3, "any", "tensors", "same", "never"),
    "posterize": (29, 2, "any", "tensors", "same", "never"),
    "threshold": (30, 5, "any", "tensors", "same", "never"),
    "lightness_raw": (31, 2, "rgb", "tensors", "same", "never"),
}
