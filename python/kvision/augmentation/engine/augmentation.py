"""The bases of augmentations with what users call: images, labels, the inverse, and what was drawn."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import Self

from kvision._modules import give_own_forward
from kvision._tv_tensors import wrap
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import Execution, ListExecution, Params, Shape, replaying
from kvision.augmentation.engine.executor import Executor
from kvision.augmentation.engine.list_calls import Parts, call_in_parts, shapes_of_images
from kvision.augmentation.engine.list_runs import run_list
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.stages import LabelSettings
from kvision.augmentation.inputs import (
    as_batch,
    check_batch,
    check_matrix,
    checked_images,
    image_and_matrix,
    in_type_of,
    plain_image,
)
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import box_edges, masks_as_batch
from kvision.augmentation.maps import exact
from kvision.augmentation.samples import (
    at_scale,
    inverse_at,
    is_known,
    known_everywhere,
    where_chosen,
    with_matrix,
    without_added_axes,
)
from kvision.color.frames import Frames
from kvision.constants import DataKey
from kvision.geometry.transform.lists.arguments import largest_shape

_KEYS = {"boxes": DataKey.BBOX_XYXY, "masks": DataKey.MASK}  # of labels that draws read


class AugmentationBase(Executor, keeps_contract=True):
    """What augmentations of images and of volumes share; see the package."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        give_own_forward(cls)

    takes_lists: ClassVar[bool] = False  # of images of different sizes

    def validate_tensor(self, input: Tensor) -> None:
        """Raise unless `input` is a tensor of a type of images with at most a batch of images that have pixels."""
        check_batch(self, input, self.axes)

    def transform_tensor(self, input: Tensor, **_: Any) -> Tensor:
        """The input as a batch: (H, W) and (C, H, W) become (1, C, H, W); integers of 16 bits become float32."""
        self.validate_tensor(input)
        return as_batch(input, self.axes)

    def _flags_of(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        return self._checked_flags({**self.flags, **overrides}) if overrides else self.flags

    def forward(
        self,
        input: Tensor | tuple[Tensor, Tensor] | Frames,
        params: Params | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        **kwargs: Any,
    ) -> Any:
        """Augment images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8; volumes have one more axis. A
                pair of images and matrices (B, 3, 3) passes the matrices on, as chains with `return_transform` do. Images
                (C, H, W) of different sizes are a list. Of :class:`kvision.color.Frames` their images; containers read the
                planes.
            params: parameters of an earlier call, its `_params`, to repeat it on these images.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow; torch's generator is not used.
            generator: draws the key of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            **kwargs: flags of this call, such as `resample`.

        Returns:
            Images (B, C, h, w) of the type of `input`, with fewer axes if `keepdim` and the input has; with
            `return_transform` a pair of them and the matrices (B, 3, 3). A list becomes a batch if the augmentation gives all
            images one size, as RandomResizedCrop does, and a list otherwise.

        Raises:
            TypeError: `input` is not a tensor of a floating-point type or uint8, nor a list of such images, nor a tuple of a
                tensor and of matrices.
            ValueError: `input` has another number of axes; matrices have another shape.
        """
        returns = self.return_transform if return_transform is None else return_transform
        if type(input) is Tensor:
            given, before = input, None
        else:
            given, before = image_and_matrix(self, input.rgb() if isinstance(input, Frames) else input)
            if isinstance(given, list):
                y, execution = self._call_on_list(given, params, seed, generator, kwargs)
                return with_matrix(y, None, self._matrix(execution).to(given[0].device) if returns else None)
        image = plain_image(self, given)
        x = self.transform_tensor(image)
        if before is not None:
            check_matrix(self, before, x)
        labels = self._labels_of_call(kwargs, x) if self.reads_labels is not None else None
        flags = self._flags_of(kwargs)
        if params is None:
            y, execution = self._draw_and_run(x, seed, generator, flags, labels)
        else:
            with replaying(type(self).__name__, params):
                execution = self._execution = self._from_params(params, x)  # before it runs, as in _draw_and_run
                y = self._run(x, execution, flags)
        if x is not image:
            y = self._restored(y, image)
        if image is not given:
            y = wrap(y, given)
        return with_matrix(y, before, self._matrix(execution).to(y.device) if returns else None)

    def _call_on_list(
        self, given: list[Tensor], params: Any, seed: Seed, generator: Generator | None, kwargs: dict[str, Any]
    ) -> tuple[Any, Execution]:
        """Augment a list of images (C, H, W): in the launches of a batch, and where there are no such image by image."""
        op, labels = type(self).__name__, None if self.reads_labels is None else kwargs.pop(self.reads_labels, None)
        flags, plain = self._flags_of(kwargs), plain_image(self, given)
        images = checked_images(self, plain)
        keys, inputs = [DataKey.INPUT], [images]
        child, context = Child(op, self, params), CallContext.of_module(op, seed, generator, self._plans)
        if labels is not None:
            keys, inputs = [*keys, _KEYS[self.reads_labels or ""]], [images, labels]
            context = context._replace(labels=CallLabels(keys, inputs, LabelSettings(), largest_shape(images), True))
        with nullcontext() if params is None else replaying(op, params):
            done = run_list(images, [child], context) if flags is self.flags else None
            if done is not None and params is None:  # and has been kept
                y, _ = done
            else:
                if done is not None:
                    y, shapes = done[0], [x.shape for x in images]
                    parts = Parts.of_params(op, params, shapes, images, self._execution_of_part)
                else:
                    call = functools.partial(self._call_part, flags)
                    (y, *_), parts = call_in_parts([self], keys, inputs, params, seed, generator, call)
                child.record = self._execution = ListExecution(parts)
        return y if plain is given else wrap(y, given), child.record

    def _call_part(
        self, flags: dict[str, Any], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Tensor], Execution]:
        """The results of images of one size, and what was done."""
        x, *labels = inputs
        if params is not None:
            execution = self._execution = self._from_params(params, x)
            return [self._run(x, execution, flags)], execution
        read = self._labels_of_call({self.reads_labels or "": labels[0]}, x) if labels else None
        y, execution = self._draw_and_run(x, seed, generator, flags, read)
        return [y], execution

    def _each_part(self, output: Any, params: Params | None, call: Callable[[Self, Tensor], Any]) -> Any:
        """What a call makes of the results of a list, as a list; None if the last call, or that of params, was on a batch."""
        last = self._execution
        if params is None and last is not None:
            params = last.params if last.of_list is None else self._read_params(last)
        shapes = None if params is None else shapes_of_images(params)
        if shapes is None:
            return None
        parts = None if last is None or last.params is not params else last.of_list
        if not isinstance(parts, Parts):
            parts = Parts.of_params(type(self).__name__, params, shapes, output, self._execution_of_part)
        return parts.each_result(self, output, call)

    def _execution_of_part(self, like: Tensor, shape: Shape, params: Any) -> Execution:
        return self._execution_on(like.expand(shape), params, self.flags)

    def _labels_of_call(self, kwargs: dict[str, Any], x: Tensor) -> Any:
        """What a draw reads of the labels among the arguments of a call, which are taken out of them."""
        assert self.reads_labels is not None
        labels = kwargs.pop(self.reads_labels, None)
        if labels is None:
            return None
        if self.reads_labels == "masks":
            return [masks_as_batch(labels, tuple(x.shape))]
        return box_edges(labels, "xyxy", x.shape[0]).to(x.device)

    # --- what was drawn ---

    @property
    def _params(self) -> Params:
        """The parameters of the last call by name, with `batch_prob` and `forward_input_shape`."""
        if self._execution is None:
            return {}
        return self._read_params(self._execution)

    @_params.setter
    def _params(self, params: Params) -> None:
        shape = params["forward_input_shape"]
        self._execution = Execution(tuple((shape if shape.dim() == 1 else shape.amax(0)).tolist()), params=params)

    @property
    def transform_matrix(self) -> Tensor | None:
        """The matrices (B, 3, 3) of the last call, from image pixels to result pixels; None before the first call."""
        return None if self._execution is None else self._matrix(self._execution)

    def forward_parameters(self, batch_shape: Sequence[int]) -> Params:
        """Draw the parameters of a batch by name, with `batch_prob` and `forward_input_shape`."""
        shape = tuple(batch_shape)
        execution = self._draw(torch.empty(1, device=self._rng[0]).expand(shape), None, None)
        if self._draws_by_name:
            execution.params = None
            return {**self._read_params(execution), **self.generate_parameters(shape)}
        return self._read_params(execution)

    # --- labels ---

    @property
    def _moves_labels(self) -> bool:
        """Whether pixels move, or masks change, as where rectangles are erased."""
        return not self.keeps_positions or type(self).transform_masks is not AugmentationBase.transform_masks

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks (B, C, H, W) of any type, moved as the images were."""
        return self._masks_by_name(masks, execution, flags) if self._is_overridden("apply_transform_mask") else masks

    def _masks_by_name(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks moved by a method that a user's class overrides, which gets parameters by name."""
        if not execution.applied:
            return masks
        params, matrix = self._params_on_device(masks, execution), self._matrix(execution).to(masks.device)
        y = self.apply_transform_mask(exact(masks), params, flags, matrix).to(masks.dtype)
        return where_chosen(execution.chosen, y, masks) if y.shape == masks.shape else y

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        """Points (B, N, 2), (B, N, 3) of volumes, moved as the images were."""
        return points

    # --- the inverse ---

    def inverse_images(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Images (B, C, h, w) of the size of results, moved back."""
        if self._is_overridden("inverse"):
            self._execution = execution
            x = self.inverse(x)
        return x

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks (B, C, h, w) of results, moved back."""
        return masks

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        """Points (B, N, 2), (B, N, 3) of volumes, of results, moved back."""
        return points

    def inverse(self, output: Tensor, params: Params | None = None, **kwargs: Any) -> Tensor:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            output: images (B, C, h, w) as that call returned them.
            params: the `_params` of the call.
            **kwargs: flags, such as `resample`.

        Returns:
            Images of the size that the input had, of a list a list; 0 where the result has no data of them. Predictions of another
            size than the results give one that is smaller or larger by the same ratio.
        """
        if type(self).inverse_images is AugmentationBase.inverse_images:  # pixels keep their positions
            return output
        of_list = self._each_part(output, params, lambda own, x: own.inverse(x, **kwargs))
        if of_list is not None:
            return of_list
        flags, x = self._flags_of(kwargs), self.transform_tensor(output)
        call = self._execution_of(params, x, flags)
        if call is None:
            raise RuntimeError(f"{type(self).__name__}.inverse: there was no call yet; pass its params")
        if not call.applied:
            return output
        y = inverse_at(
            x, self._size_of(call, flags), functools.partial(self.inverse_images, execution=call, flags=flags)
        )
        return self._restored(y, output)

    def _size_of(self, execution: Execution, flags: dict[str, Any]) -> Sequence[int]:
        """The size of the results of an execution."""
        return self.output_shape(execution.shape, flags)[2:]

    def known_pixels(self, output: Tensor, params: Params | None = None) -> Tensor:
        """Which pixels of the images :meth:`inverse` finds in a result; the others were lost in the call, or in part.

        Args:
            output: images (B, C, h, w) as that call returned them, of which only the size and the device count.
            params: the `_params` of the call.

        Returns:
            bool (B, 1, H, W), of the size that :meth:`inverse` gives; of a list a list of (1, H, W).
        """
        of_list = self._each_part(output, params, lambda own, x: own.known_pixels(x))
        if of_list is not None:
            return of_list
        x = self.transform_tensor(output)
        execution = self._execution_of(params, x, self.flags)
        if execution is None:
            return is_known(known_everywhere(x.shape, x.device))
        ones = known_everywhere(execution.shape, x.device)
        moved = self.transform_masks(ones, execution, {**self.flags, "resample": "bilinear"})
        known = is_known(self.inverse(moved, params).reshape(ones.shape))
        return at_scale(known, x.shape[2:], moved.shape[2:])

    def _restored(self, y: Tensor, input: Tensor) -> Tensor:
        """A result of the type of the input, and with as many axes if `keepdim` is True."""
        y = in_type_of(y, input)
        return without_added_axes(y, input) if self.keepdim else y

    def _execution_of(self, params: Params | None, x: Tensor, flags: dict[str, Any]) -> Execution | None:
        """The last execution, or that of given parameters, whose matrices are on the device of x."""
        if params is None:
            return self._execution
        shape = tuple(int(n) for n in params["forward_input_shape"])
        return self._execution_on(x.new_empty(1).expand(shape), params, flags)

    def _execution_on(self, x: Tensor, params: Params, flags: dict[str, Any]) -> Execution:
        """The execution of given parameters, with its matrices, on images of which only the shape and the device count."""
        return self._from_params(params, x)


class AugmentationBase2D(AugmentationBase):
    """Base of the augmentations of images: a subclass overrides `apply_transform`, and what it needs besides.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Dim(K.augmentation.AugmentationBase2D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return input / 2
        >>> Dim(p=1.0)(torch.ones(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    axes = 3
    takes_lists = True


class RigidAffineAugmentationBase2D(AugmentationBase2D):
    """Base of augmentations with a matrix (B, 3, 3): geometric ones, and those that leave pixels in place.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import kvision as K
        >>> issubclass(K.augmentation.RandomAffine, K.augmentation.RigidAffineAugmentationBase2D)
        True
    """


class AugmentationBase3D(AugmentationBase):
    """Base of the augmentations of volumes (B, C, D, H, W); as :class:`AugmentationBase2D`.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import torch, kvision as K
        >>> class Dim(K.augmentation.AugmentationBase3D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return input / 2
        >>> Dim(p=1.0)(torch.ones(1, 1, 1, 1, 2))
        tensor([[[[[0.5000, 0.5000]]]]])
    """

    axes = 4


class RigidAffineAugmentationBase3D(AugmentationBase3D):
    """Base of augmentations of volumes with a matrix (B, 4, 4).

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import kvision as K
        >>> issubclass(K.augmentation.IntensityAugmentationBase3D, K.augmentation.RigidAffineAugmentationBase3D)
        True
    """
