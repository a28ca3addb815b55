"""The bases of augmentations with what users call: images, labels, the inverse, and what was drawn."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from kvision._modules import give_own_forward
from kvision._tv_tensors import wrap
from kvision.augmentation.engine.execution import Execution, Params, replaying
from kvision.augmentation.engine.list_executor import ListExecutor
from kvision.augmentation.inputs import (
    as_batch,
    check_batch,
    check_matrix,
    image_and_matrix,
    in_type_of,
    plain_image,
)
from kvision.augmentation.keys import Seed
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


class AugmentationBase(ListExecutor, keeps_contract=True):
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
                y, execution = self._replay_and_run(x, params, flags)
        if x is not image:
            y = self._restored(y, image)
        if image is not given:
            y = wrap(y, given)
        return with_matrix(y, before, self._matrix(execution).to(y.device) if returns else None)

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

    @property
    def _leaves_labels(self) -> bool:
        """Whether masks, boxes and points stay as they are."""
        return not (self._moves_labels or self._is_overridden("apply_transform_mask") or self.mixes_samples)

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks (B, C, H, W) of any type, moved as the images were."""
        return self._masks_by_name(masks, execution, flags) if self._is_overridden("apply_transform_mask") else masks

    def _move_mask_list(self, masks: list[Tensor], execution: Execution, fill: Any) -> list[Tensor] | None:
        """Masks (N, H, W) of the images of a list, changed as the images were; None where each is changed by itself."""
        return None

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
