"""Adjustments of images (*, C, H, W): brightness, contrast, color, histograms, normalization.

Values are in [0, 1] unless said otherwise. Other values follow the formula of the function as well, and are clamped to
[0, 1] where it says so; functions of 8-bit levels or of powers use the nearest value with a level or a power.
uint8 images hold 255ths: parameters are those of [0, 1], and results are uint8, rounded half to even and saturated.
Parameters are numbers, or tensors with the leading axes of the images: (B,) has one value per sample.
Computation is in float32, or in float64 for float64 images.
"""

from kvision import _torch_compat
from kvision.enhance.add_weighted import AddWeighted, add_weighted
from kvision.enhance.brightness import (
    AdjustBrightness,
    AdjustBrightnessAccumulative,
    adjust_brightness,
    adjust_brightness_accumulative,
)
from kvision.enhance.clahe import equalize_clahe
from kvision.enhance.contrast import (
    AdjustContrast,
    AdjustContrastWithMeanSubtraction,
    adjust_contrast,
    adjust_contrast_with_mean_subtraction,
)
from kvision.enhance.curves import AdjustGamma, AdjustLog, AdjustSigmoid, adjust_gamma, adjust_log, adjust_sigmoid
from kvision.enhance.equalize import equalize, equalize3d
from kvision.enhance.histogram import histogram, histogram2d, image_histogram2d
from kvision.enhance.hue import AdjustHue, adjust_hue, adjust_hue_raw
from kvision.enhance.integral import IntegralImage, IntegralTensor, integral_image, integral_tensor
from kvision.enhance.invert import Invert, invert
from kvision.enhance.jpeg import JPEGCodecDifferentiable, jpeg_codec_differentiable
from kvision.enhance.min_max import normalize_min_max
from kvision.enhance.normalize import Denormalize, Normalize, denormalize, normalize
from kvision.enhance.posterize import posterize
from kvision.enhance.program import ColorProgram
from kvision.enhance.rescale import Rescale
from kvision.enhance.saturation import (
    AdjustSaturation,
    AdjustSaturationWithGraySubtraction,
    adjust_saturation,
    adjust_saturation_raw,
    adjust_saturation_with_gray_subtraction,
)
from kvision.enhance.sharpness import sharpness
from kvision.enhance.shift_rgb import shift_rgb
from kvision.enhance.solarize import solarize
from kvision.enhance.threshold import Threshold, ThresholdType, threshold
from kvision.enhance.zca import ZCAWhitening, linear_transform, zca_mean, zca_whiten

_torch_compat.refuse_script(globals())
