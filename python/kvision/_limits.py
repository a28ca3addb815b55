"""Limits of kernels, and constants of their formulas.

Written by tools/generate.py from the declarations in csrc that it names.
"""

LARGEST_WINDOW = (1 << 15) - 1  # kLargestWindow in csrc/glue/glue.h
MAX_COLOR_STEPS = 16  # kMaxSteps in csrc/color/program.h
MAX_COLOR_NUMBERS = 64  # kMaxParameters in csrc/color/program.h
MAX_COLOR_TENSORS = 6  # kMaxTensors in csrc/color/program.h
MAX_LINKS = 8  # kMaxLinks in csrc/geometry/transform/composed/composed_warp.h
MAX_SHRINK = 32  # kMaxShrink in csrc/geometry/transform/antialiased/warp_antialiased.h
MAX_REACH = 48  # kMaxReach in csrc/geometry/transform/antialiased/warp_antialiased.h
MAX_SLOPE = 1e4  # kMaxSlope in csrc/geometry/transform/antialiased/warp_antialiased.h
MAX_PYRAMID_LEVELS = 16  # kMaxLevels in csrc/feature/patches.h
MAX_OCTAVES = 16  # kMaxOctaves in csrc/feature/scale_space/scale_space_peaks.h
MAX_SCALES = 32  # kMaxScales in csrc/feature/scale_space/hessian.h
MAX_ORIENTATION_BINS = 64  # kMaxOrientationBins in csrc/feature/orientation.h
LARGEST_SHARED_PATCH = 88  # kLargestSharedPatch in csrc/feature/patch_gradient.h
SIFT_EPSILON = 1e-10  # kSiftEpsilon in csrc/feature/sift.h
MAX_SIFT_BINS = 64  # kMaxSiftBins in csrc/feature/sift_op.cpp
MAX_SIFT_CELLS = 32  # kMaxSiftCells in csrc/feature/sift_op.cpp
LARGEST_SIFT = 1024  # kLargestSift in csrc/feature/sift_op.cpp
MAX_CLASSES = 224  # kMaxClasses in csrc/losses/segmentation_op.cpp
MAX_SSIM_SCALES = 16  # kMaxSsimScales in csrc/metrics/ssim.h
MAX_SSIM_WEIGHTS = 400  # kMaxSsimWeights in csrc/metrics/ssim.h
MAX_DRAWS = 64  # kMaxDraws in csrc/augmentation/draws.h
MAX_DRAW_NUMBERS = 256  # kMaxDrawNumbers in csrc/augmentation/draws.h
MAX_TRANSFORMS = 16  # kMaxTransforms in csrc/augmentation/transforms.h
LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601; kJpegRed to kJpegBlue in csrc/enhance/jpeg.h
