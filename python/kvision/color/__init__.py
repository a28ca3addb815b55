"""Color conversions of images (*, C, H, W), pixel by pixel.

Colors are in [0, 1] and hue is in radians unless said otherwise. Computation is in float32, or in float64 for float64
images; half types are rounded once, at the end.
"""

from kvision import _torch_compat
from kvision.color.colormap import ApplyColorMap, ColorMap, ColorMapType, apply_colormap
from kvision.color.frames import Frames, frames_to_rgb, resize_frames, rgb_to_frames, warp_frames
from kvision.color.gray import (
    BgrToGrayscale,
    GrayscaleToRgb,
    RgbToGrayscale,
    bgr_to_grayscale,
    grayscale_to_rgb,
    rgb_to_grayscale,
)
from kvision.color.hls import HlsToRgb, RgbToHls, hls_to_rgb, rgb_to_hls
from kvision.color.hsv import HsvToRgb, RgbToHsv, hsv_to_rgb, rgb_to_hsv
from kvision.color.lab import LabToRgb, RgbToLab, lab_to_rgb, rgb_to_lab
from kvision.color.linear import LinearRgbToRgb, RgbToLinearRgb, linear_rgb_to_rgb, rgb_to_linear_rgb
from kvision.color.luv import LuvToRgb, RgbToLuv, luv_to_rgb, rgb_to_luv
from kvision.color.raw import (
    CFA,
    RawToRgb,
    RawToRgb2x2Downscaled,
    RgbToRaw,
    raw_to_rgb,
    raw_to_rgb_2x2_downscaled,
    rgb_to_raw,
)
from kvision.color.rgb import BgrToRgb, RgbToBgr, bgr_to_rgb, rgb_to_bgr
from kvision.color.rgb255 import (
    NormalsToRgb255,
    Rgb255ToNormals,
    Rgb255ToRgb,
    RgbToRgb255,
    normals_to_rgb255,
    rgb255_to_normals,
    rgb255_to_rgb,
    rgb_to_rgb255,
)
from kvision.color.rgba import (
    BgrToRgba,
    RgbaToBgr,
    RgbaToRgb,
    RgbToRgba,
    bgr_to_rgba,
    rgb_to_rgba,
    rgba_to_bgr,
    rgba_to_rgb,
)
from kvision.color.sepia import Sepia, sepia
from kvision.color.xyz import RgbToXyz, XyzToRgb, rgb_to_xyz, xyz_to_rgb
from kvision.color.ycbcr import RgbToYcbcr, YcbcrToRgb, rgb_to_y, rgb_to_ycbcr, ycbcr_to_rgb
from kvision.color.yuv import (
    RgbToYuv,
    RgbToYuv420,
    RgbToYuv422,
    Yuv420ToRgb,
    Yuv422ToRgb,
    YuvToRgb,
    rgb_to_yuv,
    rgb_to_yuv420,
    rgb_to_yuv422,
    yuv420_to_rgb,
    yuv422_to_rgb,
    yuv_to_rgb,
)

_torch_compat.refuse_script(globals())
