"""Stable numbers of the modes that operators take.

Operators take small integers: torch's stable C interface leaks 48 bytes for each string argument of a call. The numbers
never change, so that exported graphs keep their meaning. The C++ enums with the same numbers are named next to each table.
"""

BORDER = {"constant": 0, "reflect": 1, "replicate": 2, "circular": 3}  # Border in csrc/core/border.h
BORDER_NAMES = tuple(BORDER)
COLOR_DISTANCE = {"l1": 0, "l2": 1}  # ColorDistance in csrc/filters/smoothing/bilateral.h
DERIVATIVE_MODE = {"sobel": 0, "diff": 1}  # DerivativeMode in csrc/filters/edges/spatial_gradient.h
DERIVATIVE_MODE_NAMES = tuple(DERIVATIVE_MODE)
INTERPOLATION = {  # ResizeFilter in csrc/geometry/transform/resize/resize.h; warps take nearest, bilinear and bicubic
    **{"nearest": 0, "nearest-exact": 1, "area": 2, "bilinear": 3, "bicubic": 4, "lanczos": 5},
    **{"pyrdown": 6, "pyrup": 7},
}
INTERPOLATION_NAMES = tuple(INTERPOLATION)
PADDING = {"fill": 0, "border": 1, "reflection": 2}  # Padding in csrc/geometry/transform/sampling.h
PADDING_NAMES = tuple(PADDING)
WARP_FORMULA = {  # WarpFormula in csrc/geometry/formulas.h
    **{
        "affine_matrix2d": 1,
        "translation_matrix2d": 2,
        "scale_matrix2d": 3,
        "shear_factor_matrix2d": 4,
        "crop_matrix": 5,
    },
    **{"affine_matrix3d": 6, "translation_matrix3d": 7, "perspective_matrix3d": 8},
}
PHOTOMETRIC_DISTANCE = {"l1": 0, "l2": 1, "charbonnier": 2}  # Distance in csrc/geometry/transform/photometric.h
PHOTOMETRIC_DISTANCE_NAMES = tuple(PHOTOMETRIC_DISTANCE)
# PointMapKind in csrc/geometry/transform_points_op.cpp
POINT_MAP = {"transform": 0, "project": 1, "unproject": 2, "unproject_distance": 3, "intersect": 4}
POINT_MAP_NAMES = tuple(POINT_MAP)
# Model in csrc/geometry/solvers/minimal.h
MODEL = {"affine": 0, "homography": 1, "lines": 2, "fundamental": 3, "fundamental8": 4, "essential": 5}
MODEL_NAMES = tuple(MODEL)
CORRESPONDENCE_ERROR = {  # ErrorKind in csrc/geometry/correspondence_errors.h
    **{"sampson": 0, "symmetrical": 1, "right": 2, "left": 3},
    **{"transfer": 4, "symmetric_transfer": 5, "sampson_transfer": 6, "segments": 7},
}
CORRESPONDENCE_ERROR_NAMES = tuple(CORRESPONDENCE_ERROR)
