"""Small helpers, and the names of other modules that older code imports from here."""

from kvision import _torch_compat
from kvision.core.ops import eye_like, vec_like
from kvision.image import (
    ImageToTensor,
    draw_convex_polygon,
    draw_line,
    draw_point2d,
    draw_rectangle,
    image_list_to_tensor,
    image_to_string,
    image_to_tensor,
    print_image,
    tensor_to_image,
)
from kvision.io import get_sample_images
from kvision.utils.batch import batched_forward
from kvision.utils.device import (
    get_cuda_device_if_available,
    get_cuda_or_mps_device_if_available,
    get_mps_device_if_available,
    is_autocast_enabled,
    is_mps_tensor_safe,
    xla_is_available,
)
from kvision.utils.legacy import map_location_to_cpu, torch_meshgrid
from kvision.utils.linalg import safe_inverse_with_mask, safe_solve_with_mask
from kvision.utils.records import dataclass_to_dict, dict_to_dataclass

__all__ = [
    "ImageToTensor",
    "batched_forward",
    "dataclass_to_dict",
    "dict_to_dataclass",
    "draw_convex_polygon",
    "draw_line",
    "draw_point2d",
    "draw_rectangle",
    "eye_like",
    "get_cuda_device_if_available",
    "get_cuda_or_mps_device_if_available",
    "get_mps_device_if_available",
    "get_sample_images",
    "image_list_to_tensor",
    "image_to_string",
    "image_to_tensor",
    "is_autocast_enabled",
    "is_mps_tensor_safe",
    "map_location_to_cpu",
    "print_image",
    "safe_inverse_with_mask",
    "safe_solve_with_mask",
    "tensor_to_image",
    "torch_meshgrid",
    "vec_like",
    "xla_is_available",
]

_torch_compat.refuse_script(globals())
