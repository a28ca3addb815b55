"""Numbers that kernels, Python and the C++ interface share, read from the declarations of csrc; for tools/generate.py."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
HEAD = "Written by tools/generate.py from the declarations in csrc that it names."

# Modes: the name in Python, the enum and its file in csrc, and the enum of the C++ interface, if it has one.
MODES = (
    ("BORDER", "Border", "core/border.h", "BorderType"),
    ("DTYPE", "DType", "core/dtype.h", ""),
    ("COLOR_DISTANCE", "ColorDistance", "filters/smoothing/bilateral.h", ""),
    ("DERIVATIVE_MODE", "DerivativeMode", "filters/edges/spatial_gradient.h", "DerivativeMode"),
    ("INTERPOLATION", "ResizeFilter", "geometry/transform/resize/resize.h", "Interpolation"),
    ("PADDING", "Padding", "geometry/transform/sampling.h", ""),
    ("WARP_FORMULA", "WarpFormula", "geometry/formulas.h", "ops::WarpFormula"),
    ("PHOTOMETRIC_DISTANCE", "Distance", "geometry/transform/photometric.h", "Distance"),
    ("POINT_MAP", "PointMapKind", "geometry/transform_points_op.cpp", "ops::PointMap"),
    ("ROBUST_LOSS", "RobustLoss", "geometry/optim/robust_losses.h", ""),
    ("MODEL", "Model", "geometry/solvers/minimal.h", "ops::Model"),
    ("CORRESPONDENCE_ERROR", "ErrorKind", "geometry/correspondence_errors.h", "ops::CorrespondenceError"),
    ("MAP_KIND", "MapKind", "augmentation/distortion/displacement_map.h", ""),
    ("BLOCK_VALUE", "BlockValue", "augmentation/corruption/pixelate.h", ""),
    ("BOX_DECAY", "Decay", "geometry/detection/suppression.h", ""),
    ("BOX_FORMAT", "BoxFormat", "metrics/boxes.h", ""),
    ("CONFUSION_STATISTIC", "ConfusionStatistic", "metrics/confusion_matrix.h", ""),
    ("POINT_LOSS", "PointLoss", "metrics/pointwise.h", ""),
    ("SSIM_PADDING", "SsimPadding", "metrics/ssim.h", ""),
    ("CORNER_KIND", "CornerKind", "feature/responses.h", ""),
    ("MOTION_TAPS", "MotionTaps", "filters/smoothing/motion.h", ""),
    ("HISTOGRAM_KERNEL", "HistogramKernel", "enhance/image_histogram2d.h", ""),
    ("BIN_KERNEL", "BinKernel", "losses/mutual_information.h", ""),
    ("DRAW_KIND", "DrawKind", "augmentation/draws.h", ""),
    ("TRANSFORM_KIND", "TransformKind", "augmentation/transforms.h", "ops::TransformKind"),
    ("POLICY_OPERATION", "Operation", "augmentation/auto/operations.h", ""),
    ("NODE_KIND", "NodeKind", "augmentation/preimages/preimages.h", ""),
    ("POSITION_KIND", "PositionKind", "augmentation/preimages/preimages.h", ""),
    ("CHROMA_SITE", "ChromaSite", "color/frames/frames.h", ""),
    ("MIX_KIND", "MixKind", "augmentation/mixing/pieces.h", ""),
)
IN_PYTHON = {"nearest_exact": "nearest-exact"}  # names that C++ cannot have
# Limits of kernels, which Python asks before a call, and constants of formulas: the name in Python, and in csrc.
CONSTANTS = (
    ("LARGEST_WINDOW", "kLargestWindow", "glue/glue.h"),
    ("MAX_COLOR_STEPS", "kMaxSteps", "color/program.h"),
    ("MAX_COLOR_NUMBERS", "kMaxParameters", "color/program.h"),
    ("MAX_COLOR_TENSORS", "kMaxTensors", "color/program.h"),
    ("MAX_LINKS", "kMaxLinks", "geometry/transform/composed/composed_warp.h"),
    ("MAX_SHRINK", "kMaxShrink", "geometry/transform/antialiased/warp_antialiased.h"),
    ("MAX_REACH", "kMaxReach", "geometry/transform/antialiased/warp_antialiased.h"),
    ("MAX_SLOPE", "kMaxSlope", "geometry/transform/antialiased/warp_antialiased.h"),
    ("MAX_BUNDLE_CAMERAS", "kMaxBundleCameras", "geometry/optim/fit_bundle.h"),
    ("MAX_PYRAMID_LEVELS", "kMaxLevels", "feature/patches.h"),
    ("MAX_OCTAVES", "kMaxOctaves", "feature/scale_space/scale_space_peaks.h"),
    ("MAX_SCALES", "kMaxScales", "feature/scale_space/hessian.h"),
    ("MAX_ORIENTATION_BINS", "kMaxOrientationBins", "feature/orientation.h"),
    ("LARGEST_SHARED_PATCH", "kLargestSharedPatch", "feature/patch_gradient.h"),
    ("SIFT_EPSILON", "kSiftEpsilon", "feature/sift.h"),
    ("MAX_SIFT_BINS", "kMaxSiftBins", "feature/sift_op.cpp"),
    ("MAX_SIFT_CELLS", "kMaxSiftCells", "feature/sift_op.cpp"),
    ("LARGEST_SIFT", "kLargestSift", "feature/sift_op.cpp"),
    ("MAX_CLASSES", "kMaxClasses", "losses/segmentation_op.cpp"),
    ("MAX_EROSIONS", "kMaxErosions", "losses/hausdorff_op.cpp"),
    ("MAX_SSIM_SCALES", "kMaxSsimScales", "metrics/ssim.h"),
    ("MAX_SSIM_WEIGHTS", "kMaxSsimWeights", "metrics/ssim.h"),
    ("RANSAC_CHUNK", "kChunk", "geometry/ransac.h"),
    ("RANSAC_DEVIATIONS", "kDeviations", "geometry/ransac.h"),
    ("LINE_WIDTH", "kLineWidth", "geometry/residuals.h"),
    ("LINE_WIDTH_64", "kLineWidth64", "geometry/residuals.h"),
    ("NOISE_ROUNDS", "kNoiseRounds", "geometry/solvers/two_view_fits.h"),
    ("FREEDOM", "kFreedom", "geometry/solvers/two_view_fits.h"),
    ("RED_POSITIONS", "kRedPositions", "color/raw_op.cpp"),
    ("CORNER_REACH", "kWindowReach", "feature/responses.h"),
    ("FINE_REACH", "kFineReach", "feature/responses.h"),
    ("COARSE_REACH", "kCoarseReach", "feature/responses.h"),
    ("MAX_PATCH_CHANNELS", "kMaxPatchChannels", "contrib/vision_patches.h"),
    ("JPEG_LUMINANCE", "luminance", "enhance/jpeg.h"),
    ("JPEG_LOW_CHROMINANCE", "low_chrominance", "enhance/jpeg.h"),
    ("JPEG_HIGH_CHROMINANCE", "high_chrominance", "enhance/jpeg.h"),
    ("NEAR_PIXEL", "kNearPixel", "augmentation/preimages/preimages.h"),
    ("DRAW_NUMBERS", "kDrawNumbers", "augmentation/draws.h"),
    ("DRAW_COLUMNS", "kDrawColumns", "augmentation/draws.h"),
    ("CHOSEN_DRAW", "kChosenDraw", "augmentation/draws.h"),
    ("BATCH_SAMPLE", "kBatchSample", "augmentation/draws.h"),
    ("CROP_TRIES", "kCropTries", "augmentation/draws.h"),
    ("GAMMA_TRIES", "kGammaTries", "augmentation/draws.h"),
    ("NOISE_MULTIPLY", "multiply", "augmentation/noise.h"),
    ("NOISE_CLAMP", "clamp", "augmentation/noise.h"),
    ("NOISE_SHARED", "shared", "augmentation/noise.h"),
    ("NOISE_BY_CHANNEL", "by_channel", "augmentation/noise.h"),
    ("NOISE_RANDOM", "random", "augmentation/noise.h"),
    ("NOISE_UNIT", "unit", "augmentation/noise.h"),
    ("AFFINE_INPUTS", "kAffineInputs", "augmentation/transforms.h"),
    ("PERSPECTIVE_INPUTS", "kPerspectiveInputs", "augmentation/transforms.h"),
    ("CROP_INPUTS", "kCropInputs", "augmentation/transforms.h"),
    ("MATRIX_INPUTS", "kMatrixInputs", "augmentation/transforms.h"),
    ("MAX_DRAWS", "kMaxDraws", "augmentation/draws.h"),
    ("MAX_DRAW_NUMBERS", "kMaxDrawNumbers", "augmentation/draws.h"),
    ("MAX_PIECES", "kMaxPieces", "augmentation/mixing/pieces.h"),
    ("MAX_PIXELATE_SIDE", "kMaxPixelateSide", "augmentation/corruption/pixelate.h"),
    ("FAR_FROM_OUTLINE", "kFarFromOutline", "augmentation/corruption/drops.h"),
    ("MAX_PIXELATE_ROW", "kMaxPixelateRow", "augmentation/corruption/pixelate.h"),
    ("MAX_TRANSFORMS", "kMaxTransforms", "augmentation/transforms.h"),
)


def source(file: str) -> str:
    return re.sub(r"//.*", "", (ROOT / "csrc" / file).read_text())


def members(enum: str, file: str) -> dict[str, int]:
    """The names of an enum of csrc and their numbers."""
    text = source(file)
    (body,) = re.findall(rf"enum (?:class )?{enum}\b[^{{;]*\{{(.*?)\}}", text, re.DOTALL)
    for macro in re.findall(r"KV_\w+(?=\(KV_NAME_FORMULA\))", body):  # a list of formulas
        (rows,) = re.findall(rf"#define {macro}\(_\)(.*?[^\\])\n", text, re.DOTALL)
        body = re.sub(rf"{macro}\(KV_NAME_FORMULA\),?", ", ".join(re.findall(r"_\((\w+),", rows)) + ", ", body)
    numbers: dict[str, int] = {}
    following = 0
    for member in filter(None, map(str.strip, body.split(","))):
        name, _, number = member.partition("=")
        numbers[snake_case(name.strip())] = following = int(number or following)
        following += 1
    return numbers


def snake_case(name: str) -> str:
    """An enumerator without its k, as `nearest_pixel` for `kNearestPixel`; names without one as they are."""
    return re.sub(r"(?<!^)([A-Z])", r"_\1", name[1:]).lower() if re.match(r"k[A-Z]", name) else name


def constant(name: str, file: str) -> str:
    pattern = rf"^ *constexpr[^;]*\b{name}(?:\[\w*\])? = (\{{.*?\}}(?=;)|[^;,{{]+)[;,]"
    (value,) = re.findall(pattern, source(file), re.MULTILINE | re.DOTALL)
    return str(value).replace("{", "(").replace("}", ")")


def luma() -> list[str]:
    return re.findall(r"\bkLuma(?:Red|Green|Blue) = ([\d.]+)", source("color/luma.h"))


def color_steps() -> list[tuple[str, ...]]:
    """The rows of step_list.h: name, number, count of parameters, domain, arguments, channels, affine."""
    text = re.sub(r"/\*.*?\*/", "", source("color/step_list.h"))
    return [tuple(row.replace(" ", "").split(",")) for row in re.findall(r"X\((\w+, \d+,[^)]*)\)", text)]


def python_files() -> Iterator[tuple[Path, str]]:
    tables = []
    for name, enum, file, _ in MODES:
        rows = {IN_PYTHON.get(k, k): v for k, v in members(enum, file).items() if k != "none"}
        entries = ", ".join(f'"{k}": {v}' for k, v in rows.items())
        tables.append(f"# {enum} in csrc/{file}\n{name} = {{{entries}}}\n{name}_NAMES = tuple({name})\n")
    yield (
        ROOT / "python/kvision/_modes.py",
        '"""Stable numbers of the modes that operators take.\n\n'
        "Operators take small integers: torch's stable C interface leaks 48 bytes for each string argument of a call. The "
        "numbers\nnever change, so that exported graphs keep their meaning.\n\n"
        f'{HEAD}\n"""\n\n' + "".join(tables),
    )
    constants = "".join(f"{name} = {constant(of, file)}  # {of} in csrc/{file}\n" for name, of, file in CONSTANTS)
    yield (
        ROOT / "python/kvision/_limits.py",
        f'"""Limits of kernels, and constants of their formulas.\n\n{HEAD}\n"""\n\n{constants}'
        f"LUMA = ({', '.join(luma())})  # ITU-R BT.601; csrc/color/luma.h\n",
    )
    rows_of_steps = "".join(
        f'"{name}": ({number}, {count}, ' + ", ".join(f'"{x}"' for x in others) + "),\n"
        for name, number, count, *others in color_steps()
    )
    yield (
        ROOT / "python/kvision/color/_step_list.py",
        f'"""The rows of csrc/color/step_list.h, whose columns it explains.\n\n{HEAD}\n"""\n\nSTEP_LIST = {{\n{rows_of_steps}}}\n',
    )


def cpp_file() -> tuple[Path, str]:
    """The numbers of the C++ interface."""
    enums: dict[str, str] = {"": "", "ops": ""}
    for _, enum, file, public in MODES:
        if public:
            scope, _, name = public.rpartition("::")
            rows = {k: v for k, v in members(enum, file).items() if k != "none" and not k.startswith("pyr")}
            listed = ", ".join(f"{k} = {v}" for k, v in rows.items())
            enums[scope] += f"enum class {name}{' : int64_t' if scope else ''} {{ {listed} }};\n"
    filters = members("ResizeFilter", "geometry/transform/resize/resize.h")
    formulas = members("WarpFormula", "geometry/formulas.h")
    names = ", ".join(f'"{name}"' if number else '""' for name, number in formulas.items())
    steps = ", ".join(f"{name} = {number}" for name, number, *_ in color_steps())
    return (
        ROOT / "include/kvision/numbers.h",
        f"// The numbers of modes, which never change. {HEAD}\n#pragma once\n\n#include <cstdint>\n\nnamespace kvision {{\n\n"
        f"{enums['']}\n"
        f"inline constexpr double kLuma[] = {{{', '.join(luma())}}};  // ITU-R BT.601\n\n"
        f"namespace ops {{\n\n{enums['ops']}"
        "// Filters of resize beside those of Interpolation.\n"
        f"inline constexpr int64_t kPyrDown = {filters['pyrdown']}, kPyrUp = {filters['pyrup']};\n\n"
        f"}}  // namespace ops\n\nnamespace detail {{\n\n"
        f"// The operators of WarpFormula, by its numbers.\ninline constexpr char const* kWarpFormulas[] = {{{names}}};\n\n"
        "}  // namespace detail\n}  // namespace kvision\n\n"
        f"// The members of ColorProgram::Step in color.h.\n#define KVISION_COLOR_STEPS {steps}\n",
    )
