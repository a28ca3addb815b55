"""Chains of augmentations of images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._choices import EachOrOnce, OutputType
from kvision._ops import FLOATS
from kvision._tv_tensors import wrap
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.configuration import kept
from kvision.augmentation.engine.label_settings import KNOWN
from kvision.augmentation.engine.list_caller import ListCaller
from kvision.augmentation.engine.record import ParamItem, Record, item_of
from kvision.augmentation.engine.stages import ByMatrix, Chain
from kvision.augmentation.engine.turns import SomeSamples
from kvision.augmentation.inputs import (
    WIDE_INTEGERS,
    as_output_type,
    check_matrix,
    check_output_type,
    image_and_matrix,
    image_of,
    in_type_of,
    list_in_type_of,
    plain_image,
)
from kvision.augmentation.keys import Seed
from kvision.augmentation.samples import (
    at_scale,
    inverse_at,
    is_known,
    known_everywhere,
    with_matrix,
    without_added_axes,
)
from kvision.color.frames import Frames
from kvision.constants import DataKey
from kvision.core.exceptions import TypeCheckError, ValueCheckError


class ImageSequential(ListCaller):
    """Run augmentations one after the other on images, joined into few passes over memory.

    Args:
        *args: augmentations, other containers, or any modules of images.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children.
        random_apply: False runs all children in order; True a random number of them in random order; n that many; (n, m) at
            least n and fewer than m. More than there are children means drawing with replacement.
        random_apply_weights: relative probabilities of the children with `random_apply`.
        if_unsupported_ops: accepted for code written for Kornia; any module may be a child.
        disable_item_features, disable_sequential_features: accepted for code written for Kornia.
        resample: "each" interpolates in every geometric augmentation; "once" multiplies the matrices of neighboring ones,
            composes them with elastic, thin-plate and fisheye maps between them, and interpolates once: beyond a crop is
            the image. Pixels from outside of it are those of the first one that interpolates. With antialiased resizing among
            them, a pixel is the mean of what it covers where that is more than a pixel.
        generator: draws the keys of each call; default: torch's generator.
        output_dtype: type of the results; default: that of the images. Floating-point types have uint8 images in [0, 1].
        memory_format: `torch.channels_last` or `torch.contiguous_format` for the results; default: that of the images.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module; `random_apply` is neither a bool nor one or two ints; `output_dtype` is no
            type of images.
        ValueError: `random_apply_weights` has another length; `resample` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.ImageSequential(
        ...     K.augmentation.RandomHorizontalFlip(p=1.0), K.augmentation.Normalize(mean=1.0, std=1.0)
        ... )
        >>> augment(torch.tensor([[[[1.0, 2.0, 3.0]]]]))
        tensor([[[[2., 1., 0.]]]])
    """

    transformation_matrix_mode = "silent"
    takes_lists = True  # of images of different sizes

    @property
    def accepts_wide_integers(self) -> bool:
        """Whether all children move pixels and nothing else, so that images may be int16 or uint16."""
        return len(self) > 0 and all(getattr(child, "accepts_wide_integers", False) for child in self.children())

    def __init__(
        self,
        *args: nn.Module,
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        random_apply: int | bool | tuple[int, int] | tuple[int] = False,
        random_apply_weights: Sequence[float] | None = None,
        if_unsupported_ops: str = "raise",
        disable_item_features: bool = True,
        disable_sequential_features: bool = False,
        resample: EachOrOnce = "each",
        generator: Generator | None = None,
        output_dtype: torch.dtype | None = None,
        memory_format: torch.memory_format | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__(*args, same_on_batch=same_on_batch, keepdim=keepdim)
        op = type(self).__name__
        _check.choice(op, "resample", resample, get_args(EachOrOnce))
        if random_apply_weights is not None and len(random_apply_weights) != len(self):
            raise ValueCheckError(
                f"{op}: expected {len(self)} random_apply_weights, one of each child, got {len(random_apply_weights)}"
            )
        self.random_apply = self._counts(random_apply)
        self.random_apply_weights = None if random_apply_weights is None else list(random_apply_weights)
        if output_dtype is not None and output_dtype not in (*FLOATS, torch.uint8):
            raise TypeCheckError(
                f"{op}: expected output_dtype to be uint8 or a floating-point type, got {output_dtype!r}"
            )
        if memory_format not in (None, torch.contiguous_format, torch.channels_last):
            raise ValueCheckError(
                f"{op}: expected memory_format to be torch.contiguous_format or torch.channels_last, got {memory_format!r}"
            )
        self.resample, self.generator = resample, generator
        self.output_dtype, self.memory_format = output_dtype, memory_format
        self.return_transform = return_transform

    def _counts(self, random_apply: Any) -> tuple[int, int] | None:
        """The lowest number of children that run, and the end of the range of numbers; None for all in order."""
        if random_apply is False:
            return None
        if random_apply is True:
            return (1, len(self) + 1)
        if isinstance(random_apply, int):
            random_apply = (random_apply, random_apply + 1)
        numbers = random_apply if isinstance(random_apply, (tuple, list)) else ()
        if len(numbers) == 1:
            numbers = (numbers[0], len(self) + 1)
        if len(numbers) != 2 or not all(isinstance(n, int) for n in numbers) or not 0 <= numbers[0] < numbers[1]:
            raise ValueCheckError(
                f"{type(self).__name__}: expected random_apply to be a bool, a number of children or a range of "
                f"numbers, got {random_apply!r}"
            )
        return (numbers[0], numbers[1])

    @property
    def _params(self) -> list[ParamItem]:
        """The names and parameters of the children of the last call, in its order."""
        return self._read_params(self._record)

    @_params.setter
    def _params(self, params: list[ParamItem]) -> None:
        self._keep(self._record.replaced(items=params, children=()))

    def _read_params(self, record: Record) -> list[Any]:
        """The parameters of a call by name."""
        if record.items is None:
            items = self._items(record) if record.parts is None else record.parts.params(self._read_params)
            record.items = items
        return record.items

    def _items(self, record: Record) -> list[Any]:
        return [item_of(child) for child in record.children]

    def forward(
        self,
        input: Tensor | tuple[Tensor, Tensor] | Frames,
        params: Sequence[ParamItem] | None = None,
        extra_args: dict[Any, Any] | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8. Images (C, H, W) of different sizes
                are a list; :class:`kvision.color.Frames` are read where they are by crops, resizes and warps at the start. A
                tuple of images and matrices (B, 3, 3) passes the matrices on, as chains with `return_transform` do.
                Images of NumPy and PIL and files become floating point in [0, 1].
            params: the `_params` of an earlier call, to repeat it on these images.
            extra_args: accepted for code written for Kornia.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays with the channels last, "pil" for a list of PIL images.

        Returns:
            Images (B, C, h, w) of the type of `input`; with `return_transform` a pair of them and the matrices (B, 3, 3). A
            list becomes a batch if the children give all images one size, as RandomResizedCrop does, and a list otherwise.

        Raises:
            TypeError: `input` is not a tensor of a floating-point type or uint8, nor what becomes one; it is a list, and a child
                mixes samples.
            ValueError: `input` has another number of axes; `params` names a child that there is not; matrices have another
                shape; `output_type` is unknown.
        """
        if output_type != "pt":
            check_output_type(self, output_type)
        source = input if isinstance(input, Frames) and self._reads_frames else None
        if isinstance(input, Frames):
            input = input.rgb() if source is None else self._like(source)
        given, before = (input, None) if isinstance(input, Tensor) else image_and_matrix(self, image_of(self, input))
        image = plain_image(self, given)
        x = self.transform_tensor(image)
        if before is not None:
            check_matrix(self, before, x)
        if isinstance(x, list) and not self._reads_lists():
            (y,), record = self._call_list([DataKey.INPUT], [x], params, seed, generator)
        else:
            y, record = self._execute(x, params, self._context(seed, generator, self._time(image), source=source))
            record.stages.forget()
        self._keep(record)
        y = self._restored(y, image)
        output = self._with_matrix(y if image is given else wrap(y, given), before, return_transform, record)
        return output if output_type == "pt" else as_output_type(output, output_type)

    def _with_matrix(self, y: Any, before: Tensor | None, return_transform: bool | None, record: Record) -> Any:
        """The result of a call, with its matrix if that is asked for, or with those that containers inside return."""
        returns = self.return_transform if return_transform is None else return_transform
        if returns is None:
            transform = self._matrix_of_inner(record)
        else:
            transform = self._matrix(record) if returns else None
        device = y[0].device if isinstance(y, list) else y.device
        return with_matrix(y, before, None if transform is None else transform.to(device))

    def _matrix_of_inner(self, record: Record) -> Tensor | None:
        """The product of the matrices that containers inside return, as one after the other does; None if none returns one."""
        if not self._has_inner_that_return() or record.shape is None:
            return None
        if record.parts is not None:
            return record.parts.matrix(self._matrix_of_inner)
        matrix = record.identity_matrix()
        for child in record.children:
            module = child.module
            if isinstance(module, ImageSequential) and module.return_transform is not False:
                own = module._matrix(child.record) if module.return_transform else module._matrix_of_inner(child.record)
                if own is not None:
                    stages = [ByMatrix(own)]
                    stage = Chain(stages) if child.samples is None else SomeSamples(stages, child.samples, child.batch)
                    matrix = stage.product(matrix)
        return matrix

    @kept
    def _has_inner_that_return(self) -> bool:
        inner = [m for m in self.modules() if m is not self and isinstance(m, ImageSequential)]
        return any(m.return_transform for m in inner)

    def _like(self, frames: Frames) -> Tensor:
        """What has the shape and the type of the images that frames are, but no values."""
        return frames._like()

    def _time(self, images: Tensor) -> int:
        """How many neighbors in a batch are frames of a video; 0 for images."""
        return 0

    def _restored(self, y: Tensor, input: Tensor) -> Tensor:
        """A result of the type and with the axes of the input."""
        if isinstance(input, list):
            return list_in_type_of(y, input) if self.output_dtype is None else y
        if isinstance(y, list):
            return y
        if input.dtype in WIDE_INTEGERS and self.output_dtype is None:
            y = in_type_of(y, input)
        return without_added_axes(y, input) if y.dim() > input.dim() and self._keeps_axes() else y

    def _keeps_axes(self) -> bool:
        """Whether results have no more axes than the images."""
        if self.keepdim is not None:
            return self.keepdim
        augmentations = [m for m in self.children() if isinstance(m, AugmentationBase)]
        return bool(augmentations) and all(m.keepdim for m in augmentations)

    # --- matrices and the inverse ---

    @property
    def transform_matrix(self) -> Tensor | None:
        """The product (B, 3, 3) of the matrices of the last call; None before the first one, and where these are skipped."""
        return self._matrix(self._record)

    def _matrix(self, record: Record) -> Tensor | None:
        if record.parts is not None:
            return record.parts.matrix(self._matrix)
        if record.shape is None or self.transformation_matrix_mode == "skip":
            return None
        return record.stages.product(record.identity_matrix())

    def get_transformation_matrix(
        self,
        input: Tensor,
        params: Sequence[ParamItem] | None = None,
        recompute: bool = False,
        extra_args: dict[Any, Any] | None = None,
    ) -> Tensor | None:
        """The product (B, 3, 3) of the matrices of a call on `input`: the last one, or that of the given parameters."""
        if params is None and not recompute:
            return self.transform_matrix
        x, params = self.transform_tensor(input), self._params if params is None else params
        if isinstance(x, list) and not self._reads_lists():
            return self._matrix(self._call_list([DataKey.INPUT], [x], params, None, None)[1])
        record = self._replayed(x, params)
        return record.stages.product(record.identity_matrix())

    def inverse(
        self, input: Tensor, params: Sequence[ParamItem] | None = None, extra_args: dict[Any, Any] | None = None
    ) -> Tensor:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            input: images (B, C, h, w) as that call returned them.
            params: the `_params` of the call.
            extra_args: accepted for code written for Kornia.

        Returns:
            Images of the size that the input had, of a list a list; 0 where the result has no data of them.
        """
        parts = self._parts_of(params, input)
        if parts is not None:
            return parts.each_result(self, input, lambda own, x: own.inverse(x))
        x = self.transform_tensor(input)
        record = self._record_to_invert(x, params)
        return self._restored(inverse_at(x, record.size, record.stages.invert), input)

    def known_pixels(self, output: Tensor, params: Sequence[ParamItem] | None = None) -> Tensor:
        """Which pixels of the images :meth:`inverse` finds in a result; the others were lost in the call, or in part.

        Args:
            output: images (B, C, h, w) as that call returned them, of which only the size and the device count.
            params: the `_params` of the call.

        Returns:
            bool (B, 1, H, W), of the size that :meth:`inverse` gives; of a list a list of (1, H, W).
        """
        if params is None and self._record.is_of_list:
            params = self._params
        parts = self._parts_of(params, output)
        if parts is not None:
            return parts.each_result(self, output, lambda own, x: own.known_pixels(x))
        x = self.transform_tensor(output)
        record = self._record_of(x, params)
        moved = record.stages.move_masks(known_everywhere(record.shape or tuple(x.shape), x.device), KNOWN)
        return at_scale(is_known(record.stages.invert(moved)), x.shape[2:], moved.shape[2:])

    def _record_of(self, x: Tensor, params: Sequence[ParamItem] | None) -> Record:
        """The last call, or one with given parameters on images of which only the size counts."""
        last = self._record
        params = last.items if params is None and last.shape is None else params  # given without a call
        if params is None:
            return last
        return self._replayed(x.new_zeros(1).expand(_input_shape(params) or last.shape or tuple(x.shape)), params)

    def _record_to_invert(self, x: Tensor, params: Sequence[ParamItem] | None) -> Record:
        record = self._record_of(x, params)
        if record.shape is None:
            raise RuntimeError(f"{type(self).__name__}.inverse: there was no call yet; pass its params")
        return record

    @property
    def _moves_labels(self) -> bool:
        return not self.is_intensity_only(strict=False)

    def is_intensity_only(self, strict: bool = True) -> bool:
        """Whether all children keep the positions of pixels; other modules count as moving them if `strict`."""
        return all(
            m.is_intensity_only(strict) if isinstance(m, ImageSequential) else getattr(m, "keeps_positions", not strict)
            for m in self.children()
        )

    def forward_parameters(self, batch_shape: Sequence[int]) -> list[ParamItem]:
        """Draw the parameters of a call on images of a shape, without executing it."""
        shape, items = tuple(batch_shape), []
        module: Any
        for name, module in self.get_forward_sequence():
            data = module.forward_parameters(shape) if hasattr(module, "forward_parameters") else None
            if isinstance(module, AugmentationBase):
                shape = module.output_shape(shape, module.flags)
            items.append(ParamItem(name, data))
        return items


def _input_shape(params: Sequence[ParamItem]) -> tuple[int, ...] | None:
    """The shape of the images of a call."""
    for item in params:
        data = getattr(item, "data", None)  # cells of a grid say nothing about the image
        samples = getattr(item, "samples", None)
        shape: tuple[int, ...] | None = None
        if isinstance(data, dict) and "forward_input_shape" in data:
            shape = tuple(int(n) for n in data["forward_input_shape"])
        elif isinstance(data, (list, tuple)):
            shape = _input_shape(data)
        if shape is not None:
            return shape if samples is None else (len(samples), *shape[1:])
    return None
