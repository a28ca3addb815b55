"""torchvision.transforms.v2.functional by kvision's operators."""

from kvision import _torch_compat
from kvision.tv.functional.color import *  # noqa: F403
from kvision.tv.functional.dispatch import register_kernel as register_kernel
from kvision.tv.functional.geometry import *  # noqa: F403
from kvision.tv.functional.values import *  # noqa: F403
from kvision.tv.inputs import pil_to_tensor as pil_to_tensor
from kvision.tv.inputs import to_pil_image as to_pil_image

_FURTHER = """InterpolationMode clamp_bounding_boxes clamp_keypoints convert_bounding_box_format convert_image_dtype
get_dimensions get_image_num_channels get_num_channels get_num_frames get_size is_pure_tensor pil_to_tensor
register_kernel sanitize_bounding_boxes sanitize_keypoints to_image to_pil_image"""
__all__ = sorted({*_FURTHER.split(), *(name for name, value in globals().items() if hasattr(value, "of_each"))})

_torch_compat.refuse_script(globals())
