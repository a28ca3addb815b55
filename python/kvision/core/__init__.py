"""Shared by the other modules: exceptions, constant tensors, tensor-like classes, modules that take images."""

from kvision import _torch_compat
from kvision.core.image_module import ImageModule, ImageModuleMixIn, ImageSequential
from kvision.core.ops import eye_like, vec_like
from kvision.core.tensor_wrapper import TensorWrapper

__all__ = ["ImageModule", "ImageModuleMixIn", "ImageSequential", "TensorWrapper", "eye_like", "vec_like"]

_torch_compat.refuse_script(globals())
