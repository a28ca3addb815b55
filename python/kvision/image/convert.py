"""NumPy images, channels last, to tensors, channels first, and back. Neither direction scales the values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from kvision import _check
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["ImageToTensor", "image_list_to_tensor", "image_to_tensor", "tensor_to_image"]


def image_to_tensor(image: np.ndarray[Any, Any], keepdim: bool = True) -> Tensor:
    """NumPy image to tensor: the channels move to the front, dtype and values stay.

    The tensor is a view of the array's memory. Only arrays torch cannot view are copied: reversed ones such as
    `bgr[..., ::-1]`, read-only ones, and those of foreign byte order.

    Args:
        image: (H, W), (H, W, C) or (B, H, W, C).
        keepdim: False adds a batch axis to an (H, W) or (H, W, C) image.

    Returns:
        (1, H, W) for (H, W); (C, H, W) for (H, W, C); either with a leading 1 where `keepdim` is False;
        (B, C, H, W) for (B, H, W, C).

    Raises:
        TypeCheckError: `image` is no NumPy array, or its elements are of a type that torch does not have.
        ShapeError: `image` has less than two or more than four axes.

    Example:
        >>> import numpy as np, kvision as K
        >>> photo = np.zeros((480, 640, 3), np.uint8)
        >>> K.image.image_to_tensor(photo).shape
        torch.Size([3, 480, 640])
        >>> K.image.image_to_tensor(photo, keepdim=False).shape
        torch.Size([1, 3, 480, 640])
    """
    tensor = view_array("image_to_tensor", "image", image)
    if tensor.dim() == 4:
        return tensor.permute(0, 3, 1, 2)
    if tensor.dim() == 3:
        tensor = tensor.permute(2, 0, 1)
    elif tensor.dim() == 2:
        tensor = tensor[None]
    else:
        raise ShapeError(
            f"image_to_tensor: expected image of shape (H, W), (H, W, C) or (B, H, W, C), got {image.shape}",
            actual_shape=image.shape,
        )
    return tensor if keepdim else tensor[None]


def view_array(op: str, name: str, array: Any) -> Tensor:
    """The array as a tensor of the same shape, sharing memory where torch can."""
    if not isinstance(array, np.ndarray):
        raise TypeCheckError(
            f"{op}: expected {name} to be a numpy.ndarray, got {type(array).__name__}", actual_type=type(array)
        )
    if not (array.flags.writeable and array.dtype.isnative and all(stride >= 0 for stride in array.strides)):
        array = array.astype(array.dtype.newbyteorder("="), order="C")
    try:
        return torch.from_numpy(array)
    except TypeError as error:
        raise TypeCheckError(
            f"{op}: expected {name} of a number type torch has, got {array.dtype}", actual_type=array.dtype
        ) from error


def tensor_to_image(tensor: Tensor, keepdim: bool = False, force_contiguous: bool = False) -> np.ndarray[Any, Any]:
    """Tensor to NumPy image on the CPU: the channels move to the back, dtype and values stay.

    The array is a view of the tensor's memory where that is on the CPU. Types NumPy lacks (bfloat16) become float32.
    A single channel is dropped. Gradients end here.

    Args:
        tensor: (H, W), (C, H, W) or (B, C, H, W).
        keepdim: keep the batch axis of a (1, C, H, W) tensor, which is dropped otherwise.
        force_contiguous: copy, if need be, so that the array's memory is in the order of its axes.

    Returns:
        (H, W), (H, W, C), (B, H, W) or (B, H, W, C).

    Raises:
        TypeCheckError: `tensor` is not a tensor.
        ShapeError: `tensor` has less than two or more than four axes.

    Example:
        >>> import torch, kvision as K
        >>> K.image.tensor_to_image(torch.rand(3, 480, 640)).shape
        (480, 640, 3)
        >>> K.image.tensor_to_image(torch.rand(1, 1, 480, 640)).shape
        (480, 640)
    """
    _check.is_tensor("tensor_to_image", "tensor", tensor)
    if not 2 <= tensor.dim() <= 4:
        raise ShapeError(
            f"tensor_to_image: expected tensor of shape (H, W), (C, H, W) or (B, C, H, W), got {tuple(tensor.shape)}",
            actual_shape=tensor.shape,
        )
    image = tensor.detach().cpu()
    if image.is_floating_point() and image.dtype not in (torch.float16, torch.float32, torch.float64):
        image = image.float()
    if image.dim() > 2:
        image = image.movedim(-3, -1)
        if image.shape[-1] == 1:
            image = image[..., 0]
    if tensor.dim() == 4 and len(tensor) == 1 and not keepdim:
        image = image[0]
    array: np.ndarray[Any, Any] = (image.contiguous() if force_contiguous else image).numpy()
    return array


def image_list_to_tensor(images: Sequence[np.ndarray[Any, Any]]) -> Tensor:
    """NumPy images of one shape to one batch. The images are copied.

    Args:
        images: at least one array, each (H, W, C), all of the same shape.

    Returns:
        (B, C, H, W).

    Raises:
        TypeCheckError: an entry is no NumPy array.
        ValueCheckError: there is no image.
        ShapeError: an image is not (H, W, C), or they differ in shape.

    Example:
        >>> import numpy as np, kvision as K
        >>> K.image.image_list_to_tensor([np.ones((4, 5, 3)), np.zeros((4, 5, 3))]).shape
        torch.Size([2, 3, 4, 5])
    """
    if len(images) == 0:
        raise ValueCheckError("image_list_to_tensor: expected at least one image, got none")
    tensors = [view_array("image_list_to_tensor", f"images[{i}]", image) for i, image in enumerate(images)]
    shape = tuple(tensors[0].shape)
    for i, tensor in enumerate(tensors):
        if tensor.dim() != 3 or tensor.shape != shape:
            expected = "(H, W, C)" if i == 0 else f"{shape}, as images[0]"
            raise ShapeError(
                f"image_list_to_tensor: expected images[{i}] of shape {expected}, got {tuple(tensor.shape)}",
                actual_shape=tensor.shape,
            )
    return torch.stack(tensors).permute(0, 3, 1, 2)


class ImageToTensor(nn.Module):
    """Module form of :func:`image_to_tensor`; here a batch axis is added unless `keepdim` is set.

    Args:
        keepdim: add no batch axis.

    Example:
        >>> import numpy as np, kvision as K
        >>> K.image.ImageToTensor()(np.zeros((4, 5, 3))).shape
        torch.Size([1, 3, 4, 5])
    """

    def __init__(self, keepdim: bool = False) -> None:
        super().__init__()
        self.keepdim = _check.switch("ImageToTensor", "keepdim", keepdim)

    def forward(self, x: np.ndarray[Any, Any]) -> Tensor:
        return image_to_tensor(x, self.keepdim)

    def extra_repr(self) -> str:
        return f"keepdim={self.keepdim}"
