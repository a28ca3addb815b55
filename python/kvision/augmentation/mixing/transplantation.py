"""Regions of one sample that are pasted into another, with their labels."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import torch
from torch import Generator, Tensor

from kvision import _check
from kvision.augmentation.draws import integer, mixed_words
from kvision.augmentation.engine import Execution, Params, replaying
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import parse_data_keys
from kvision.augmentation.mixing.mix import MixAugmentationBaseV2
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.samples import per_sample
from kvision.constants import DataKey, DataKeys
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["RandomTransplantation", "RandomTransplantation3D"]


class _WordGenerator(RandomGeneratorBase):
    """Draws one number of each sample, from which its label is chosen."""

    fields = (("word", 0),)

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [integer(0, 2**24 - 1)]  # exact in float32


class MaskMixBase(MixAugmentationBaseV2):
    """Base of augmentations that paste what masks mark: :meth:`_drawn` decides it, :meth:`_pasted` does it."""

    needs_masks = True  # containers hand over the masks as they are by then
    needs_key = DataKey.MASK

    def forward(  # type: ignore[override]  # several inputs
        self,
        *input: Tensor,
        params: Params | None = None,
        data_keys: DataKeys | None = None,
        seed: Seed = None,
        generator: Generator | None = None,
        **kwargs: Any,
    ) -> Any:
        """Paste regions of samples into others.

        Args:
            *input: images (B, C, H, W) and masks (B, H, W), in the order of the data keys; the spatial axes are two to four.
            params: the `_params` of an earlier call, to repeat it.
            data_keys: keys of this call; default: those of the constructor.
            seed: an int from which all parameters follow.
            generator: draws the key of this call; default: that of the constructor, or torch's.
            **kwargs: accepted for the other classes' sake.

        Returns:
            What was given, with the regions.

        Raises:
            TypeError: an input is not a tensor.
            ValueError: there is another number of inputs than of keys, or no mask; shapes do not fit.
        """
        op = type(self).__name__
        keys = self.data_keys if data_keys is None else parse_data_keys(op, data_keys)
        if len(input) != len(keys) or DataKey.MASK not in keys:
            raise ValueCheckError(f"{op}: expected one input of each data key, a mask among them, got {len(input)}")
        for key, x in zip(keys, input):
            _check.numbers(op, "inputs", x)
            if x.dim() < 3 and key in (DataKey.INPUT, DataKey.MASK):
                raise ShapeError(f"{op}: expected images (B, C, H, W) and masks (B, H, W), got {tuple(x.shape)}")
        masks = input[keys.index(DataKey.MASK)]
        with nullcontext() if params is None else replaying(op, params):
            self._execution = execution = self._drawn(masks, params, seed, generator)
            outputs = [self._pasted(key, x, execution) for key, x in zip(keys, input)]
        return outputs[0] if len(outputs) == 1 else outputs

    def _drawn(self, masks: Tensor, params: Params | None, seed: Seed, generator: Generator | None) -> Execution:
        """An execution whose parameters say what is pasted where."""
        raise NotImplementedError(f"{type(self).__name__}._drawn")

    def _pasted(self, key: DataKey, x: Tensor, execution: Execution) -> Tensor:
        """Images or labels with what an execution pastes."""
        raise NotImplementedError(f"{type(self).__name__}._pasted")

    def _masks_of_call(self, masks: Any) -> Tensor:
        """The masks that a container hands over."""
        op = type(self).__name__
        if masks is None:
            raise ValueCheckError(f"{op}: expected a mask among the data_keys of the container")
        if not isinstance(masks, Tensor):
            raise TypeCheckError(f"{op}: expected mask to be a Tensor, got {type(masks).__name__}")
        return masks

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        return self._pasted(DataKey.MASK, masks, execution)


class RandomTransplantation(MaskMixBase):
    """Paste the region of a random label of one sample into the next one, in images and masks.

    The donor of a sample is the one before it in the batch. All labels that the donor's mask has are equally likely. In
    containers the labels are those of the first mask.
    Source: Sellner and others, Semantic segmentation of surgical hyperspectral images under geometric domain shifts, MICCAI
    2023.

    Args:
        excluded_labels: labels that are never pasted.
        p: probability that a sample receives a region.
        p_batch: probability that samples of a batch do at all.
        data_keys: what the arguments of a call are; default: the first one is the image, the second one its mask.

    Raises:
        TypeError: `excluded_labels` are not whole numbers.
        ValueError: in a call, there is no mask, or its shape does not fit the images.

    Example:
        >>> import torch, kvision as K
        >>> images = torch.tensor([1.0, 2.0]).reshape(2, 1, 1, 1).expand(2, 1, 2, 2)
        >>> masks = torch.tensor([[[0, 0], [0, 3]], [[0, 0], [0, 0]]])
        >>> transplant = K.augmentation.RandomTransplantation(excluded_labels=[0], p=1.0)
        >>> images, masks = transplant(images, masks)
        >>> images[1, 0], masks[1]
        (tensor([[2., 2.],
                [2., 1.]]), tensor([[0, 0],
                [0, 3]]))
    """

    def __init__(
        self,
        excluded_labels: Sequence[int] | Tensor | None = None,
        p: float = 0.5,
        p_batch: float = 1.0,
        data_keys: DataKeys | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p, p_batch, data_keys=["input", "mask"] if data_keys is None else data_keys, **options)
        labels = () if excluded_labels is None else excluded_labels
        excluded = _check.as_tensor(type(self).__name__, "excluded_labels", labels).flatten().tolist()
        if any(label % 1 != 0 for label in excluded):  # also of infinities and NaN
            raise TypeCheckError(
                f"{type(self).__name__}: expected excluded_labels of whole numbers, got {excluded_labels!r}"
            )
        self.excluded_labels = [int(label) for label in excluded]
        self._param_generator = _WordGenerator()

    def _pasted(self, key: DataKey, x: Tensor, execution: Execution) -> Tensor:
        """Images or masks with the regions of an execution, whose shape is that of the masks."""
        drawn, shape = self._read_params(execution), execution.shape
        donors, selection = drawn["donor_indices"].to(x.device), drawn["selection"].to(x.device)
        acceptors = drawn["acceptor_indices"].to(x.device)
        extra = x.dim() - len(shape)
        if x.shape[0] != shape[0] or extra not in (0, 1) or x.shape[1 + extra :] != shape[1:]:
            raise ShapeError(
                f"{type(self).__name__}: expected {key.name.lower()} of the size of masks {shape}, got {tuple(x.shape)}"
            )
        chosen = selection[:, None] if extra else selection
        if execution.columns is not None and execution.applied:  # every sample receives from the one before it
            return torch.where(chosen, x.roll(1, 0), x)
        pasted = torch.where(chosen, x[donors], x[acceptors])
        return x.index_copy(0, acceptors, pasted) if acceptors.numel() else x

    # --- in containers ---

    def _run_with_masks(
        self, x: Tensor, masks: Any, params: Params | None, seed: Seed, generator: Generator | None
    ) -> tuple[Tensor, Execution]:
        op = type(self).__name__
        if masks is None and params is not None and "selection" in params:
            masks = x[:, 0]  # of which only the size counts
        masks = self._masks_of_call(masks)
        if masks.dim() == x.dim() and masks.shape[1] == 1:
            masks = masks[:, 0]
        if masks.dim() != x.dim() - 1:
            raise ShapeError(f"{op}: expected masks of one channel, got {tuple(masks.shape)}")
        execution = self.__dict__["_execution"] = self._drawn(masks, params, seed, generator)
        execution.params = {**self._read_params(execution), "forward_input_shape": torch.tensor(x.shape, device="cpu")}
        return self._pasted(DataKey.INPUT, x, execution), execution

    def _mixed_labels(self, key: DataKey, labels: Any, execution: Execution, boxes: int | None) -> Any:
        raise self._refuse({DataKey.KEYPOINTS: "key points", DataKey.CLASS: "labels"}.get(key, "boxes"))

    def _drawn(self, masks: Tensor, params: Params | None, seed: Seed, generator: Generator | None) -> Execution:
        """An execution whose parameters say which pixels of which donors go where."""
        shape = tuple(masks.shape)
        if params is not None:
            params = dict(params)
            if "selection" not in params:
                labels = params["selected_labels"].to(masks.device)
                donors = masks[params["donor_indices"].to(masks.device)]
                params["selection"] = donors == per_sample(labels, masks)
            return Execution(shape, None, None, True, params)
        # Draws read the batch and the device of images, and have no kernel for the labels' type.
        images = masks.new_empty(1, dtype=torch.float32).expand(shape)
        execution = self._draw(images, seed, generator)
        columns = execution.columns
        if columns is None or not execution.applied:
            none = torch.zeros(0, dtype=torch.int64, device="cpu")
            drawn: Params = {
                "acceptor_indices": none,
                "donor_indices": none,
                "selected_labels": none,
                "selection": torch.zeros(0, *shape[1:], dtype=torch.bool, device="cpu"),
            }
            chosen = torch.zeros(shape[0], device="cpu")
        else:
            donors = masks.roll(1, 0)
            labels, has_label = self._labels(donors, columns.values[:, 0].long())
            selection = (donors == per_sample(labels, masks)) & has_label
            everyone = torch.arange(shape[0], device=masks.device)
            chosen = torch.ones(shape[0], device=masks.device)
            if columns.chosen is not None:
                chosen = columns.chosen
                selection = selection & per_sample(chosen > 0.5, masks)
            drawn = {
                "acceptor_indices": everyone,
                "donor_indices": everyone.roll(1),
                "selected_labels": labels,
                "selection": selection,
            }
        execution.params = {**drawn, "batch_prob": chosen, "forward_input_shape": torch.tensor(shape, device="cpu")}
        return execution

    def _labels(self, donors: Tensor, words: Tensor) -> tuple[Tensor, Tensor]:
        """A label of each donor (B,), and whether it has one (B, 1, ...), without a loop over labels.

        Every label has a random rank that depends on the sample; the label of the pixel with the highest rank is taken.
        """
        flat = donors.flatten(1).long()
        rank = mixed_words(flat ^ mixed_words(words)[:, None])
        for label in self.excluded_labels:
            rank = torch.where(flat == label, -1, rank)
        if flat.shape[1] == 0:
            return flat.new_zeros(flat.shape[0]), flat.new_zeros(flat.shape[0], *[1] * (donors.dim() - 1)).bool()
        best, at = rank.max(1, keepdim=True)
        return flat.gather(1, at)[:, 0].to(donors.dtype), per_sample(best >= 0, donors)


class RandomTransplantation3D(RandomTransplantation):
    """:class:`RandomTransplantation` for volumes (B, C, D, H, W) with masks (B, D, H, W).

    Args:
        excluded_labels: labels that are never pasted.
        p: probability that a sample receives a region.
        p_batch: probability that samples of a batch do at all.
        data_keys: what the arguments of a call are; default: the first one is the volume, the second one its mask.

    Raises:
        TypeError: `excluded_labels` are not whole numbers.

    Example:
        >>> import torch, kvision as K
        >>> volumes, masks = torch.rand(2, 1, 2, 3, 4), torch.randint(0, 3, (2, 2, 3, 4))
        >>> [x.shape for x in K.augmentation.RandomTransplantation3D(p=1.0)(volumes, masks)]
        [torch.Size([2, 1, 2, 3, 4]), torch.Size([2, 2, 3, 4])]
    """

    axes = 4
