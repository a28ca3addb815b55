"""torchvision.transforms.v2.functional by kvision's operators."""

from kvision import _torch_compat
from kvision.tv.functional.color import (
    adjust_brightness,
    adjust_contrast,
    adjust_gamma,
    adjust_hue,
    adjust_saturation,
    adjust_sharpness,
    autocontrast,
    equalize,
    gaussian_blur,
    grayscale_to_rgb,
    invert,
    normalize,
    permute_channels,
    posterize,
    rgb_to_grayscale,
    solarize,
    to_grayscale,
)
from kvision.tv.functional.dispatch import register_kernel
from kvision.tv.functional.geometry import (
    InterpolationMode,
    affine,
    center_crop,
    crop,
    elastic,
    elastic_transform,
    five_crop,
    hflip,
    horizontal_flip,
    pad,
    perspective,
    resize,
    resized_crop,
    rotate,
    ten_crop,
    vertical_flip,
    vflip,
)
from kvision.tv.functional.values import (
    clamp_bounding_boxes,
    clamp_keypoints,
    convert_bounding_box_format,
    convert_image_dtype,
    erase,
    gaussian_noise,
    get_dimensions,
    get_image_num_channels,
    get_num_channels,
    get_num_frames,
    get_size,
    is_pure_tensor,
    jpeg,
    sanitize_bounding_boxes,
    sanitize_keypoints,
    to_dtype,
    to_image,
    uniform_temporal_subsample,
)
from kvision.tv.inputs import pil_to_tensor, to_pil_image

_torch_compat.refuse_script(globals())
