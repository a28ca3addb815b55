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
MAX_BUNDLE_CAMERAS = 200  # kMaxBundleCameras in csrc/geometry/optim/fit_bundle.h
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
MAX_EROSIONS = 1000  # kMaxErosions in csrc/losses/hausdorff_op.cpp
MAX_SSIM_SCALES = 16  # kMaxSsimScales in csrc/metrics/ssim.h
MAX_SSIM_WEIGHTS = 400  # kMaxSsimWeights in csrc/metrics/ssim.h
RANSAC_CHUNK = 64  # kChunk in csrc/geometry/ransac.h
RANSAC_DEVIATIONS = 2  # kDeviations in csrc/geometry/ransac.h
LINE_WIDTH = 1.2e-7  # kLineWidth in csrc/geometry/residuals.h
LINE_WIDTH_64 = 3e-8  # kLineWidth64 in csrc/geometry/residuals.h
NOISE_ROUNDS = 2  # kNoiseRounds in csrc/geometry/solvers/two_view_fits.h
FREEDOM = 7  # kFreedom in csrc/geometry/solvers/two_view_fits.h
RED_POSITIONS = ((0, 0), (0, 1), (1, 1), (1, 0))  # kRedPositions in csrc/color/raw_op.cpp
CORNER_REACH = 3  # kWindowReach in csrc/feature/responses.h
FINE_REACH = 4  # kFineReach in csrc/feature/responses.h
COARSE_REACH = 6  # kCoarseReach in csrc/feature/responses.h
MAX_PATCH_CHANNELS = 4  # kMaxPatchChannels in csrc/contrib/vision_patches.h
JPEG_LUMINANCE = (
    16,
    11,
    10,
    16,
    24,
    40,
    51,
    61,
    12,
    12,
    14,
    19,
    26,
    58,
    60,
    55,
    14,
    13,
    16,
    24,
    40,
    57,
    69,
    56,
    14,
    17,
    22,
    29,
    51,
    87,
    80,
    62,
    18,
    22,
    37,
    56,
    68,
    109,
    103,
    77,
    24,
    35,
    55,
    64,
    81,
    104,
    113,
    92,
    49,
    64,
    78,
    87,
    103,
    121,
    120,
    101,
    72,
    92,
    95,
    98,
    112,
    100,
    103,
    99,
)  # luminance in csrc/enhance/jpeg.h
JPEG_LOW_CHROMINANCE = (
    17,
    18,
    24,
    47,
    18,
    21,
    26,
    66,
    24,
    26,
    56,
    99,
    47,
    66,
    99,
    99,
)  # low_chrominance in csrc/enhance/jpeg.h
JPEG_HIGH_CHROMINANCE = 99  # high_chrominance in csrc/enhance/jpeg.h
NEAR_PIXEL = 1.5  # kNearPixel in csrc/augmentation/preimages/preimages.h
DRAW_NUMBERS = (0, 3, 4, 3, 3, 6, 6, 3, 3, 5, 3, 10, 1)  # kDrawNumbers in csrc/augmentation/draws.h
DRAW_COLUMNS = (1, 1, 1, 1, 0, 4, 4, 1, 1, 2, 1, 0, 1)  # kDrawColumns in csrc/augmentation/draws.h
CHOSEN_DRAW = 0  # kChosenDraw in csrc/augmentation/draws.h
BATCH_SAMPLE = 0xFFFFFFFF  # kBatchSample in csrc/augmentation/draws.h
CROP_TRIES = 10  # kCropTries in csrc/augmentation/draws.h
GAMMA_TRIES = 8  # kGammaTries in csrc/augmentation/draws.h
NOISE_MULTIPLY = 1  # multiply in csrc/augmentation/noise.h
NOISE_CLAMP = 2  # clamp in csrc/augmentation/noise.h
NOISE_SHARED = 4  # shared in csrc/augmentation/noise.h
NOISE_BY_CHANNEL = 8  # by_channel in csrc/augmentation/noise.h
NOISE_RANDOM = 16  # random in csrc/augmentation/noise.h
NOISE_UNIT = 32  # unit in csrc/augmentation/noise.h
AFFINE_INPUTS = 9  # kAffineInputs in csrc/augmentation/transforms.h
PERSPECTIVE_INPUTS = 16  # kPerspectiveInputs in csrc/augmentation/transforms.h
CROP_INPUTS = 7  # kCropInputs in csrc/augmentation/transforms.h
MATRIX_INPUTS = 9  # kMatrixInputs in csrc/augmentation/transforms.h
MAX_DRAWS = 64  # kMaxDraws in csrc/augmentation/draws.h
MAX_DRAW_NUMBERS = 256  # kMaxDrawNumbers in csrc/augmentation/draws.h
MAX_PIECES = 512  # kMaxPieces in csrc/augmentation/mixing/pieces.h
MAX_PIXELATE_SIDE = 32767  # kMaxPixelateSide in csrc/augmentation/corruption/pixelate.h
FAR_FROM_OUTLINE = 20  # kFarFromOutline in csrc/augmentation/corruption/drops.h
MAX_PIXELATE_ROW = 10240  # kMaxPixelateRow in csrc/augmentation/corruption/pixelate.h
MAX_TRANSFORMS = 16  # kMaxTransforms in csrc/augmentation/transforms.h
LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601; csrc/color/luma.h
