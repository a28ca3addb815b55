"""Augmentation of the inputs of a discriminator, with a probability that follows its accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator, Tensor, nn

import kvision.augmentation as A
from kvision import _check
from kvision._choices import OutputType
from kvision.augmentation.columns import draw_columns
from kvision.augmentation.draws import Request, uniform
from kvision.augmentation.engine import AugmentationSequential, ParamItem, Record
from kvision.augmentation.keys import Seed, draw_keys
from kvision.augmentation.labels import MaskCounts
from kvision.augmentation.samples import where_chosen
from kvision.color.frames import Frames
from kvision.constants import DataKey, DataKeys
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.core.pixels import to_unit

__all__ = ["AdaptiveDiscriminatorAugmentation"]


class AdaptiveDiscriminatorAugmentation(AugmentationSequential):
    """Augment a fraction of the inputs of a discriminator; the fraction grows while its accuracy on real images is above a target.

    Source: Karras, Aittala, Hellsten, Laine, Lehtinen and Aila, Training generative adversarial networks with limited data,
    NeurIPS 2020.

    Args:
        *args: augmentations; default: flips, quarter turns, erasing, an affine transform, color jitter and noise.
        initial_p: first fraction of the samples that are augmented.
        adjustment_speed: by how much the fraction changes at once.
        max_p: highest fraction.
        target_real_acc: accuracy on real images above which the fraction grows.
        ema_lambda: weight of the past in the moving average of accuracies.
        update_every: calls between two changes.
        erasing_scale, erasing_ratio, erasing_fill_value: of the default RandomErasing.
        data_keys: what the arguments of a call are; default: images alone.
        same_on_batch: all samples get the same parameters.
        **kwargs: further arguments of AugmentationSequential.

    Attributes:
        p: the fraction; it may be set.

    Raises:
        ValueError: a fraction or an accuracy is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> ada = K.augmentation.presets.ada.AdaptiveDiscriminatorAugmentation(initial_p=0.5, update_every=1, ema_lambda=0)
        >>> ada(torch.rand(4, 3, 16, 16), real_acc=0.95).shape
        torch.Size([4, 3, 16, 16])
        >>> round(ada.p, 3)
        0.51
    """

    def __init__(
        self,
        *args: nn.Module,
        initial_p: float = 1e-05,
        adjustment_speed: float = 0.01,
        max_p: float = 0.8,
        target_real_acc: float = 0.85,
        ema_lambda: float = 0.99,
        update_every: int = 5,
        erasing_scale: tuple[float, float] = (0.02, 0.33),
        erasing_ratio: tuple[float, float] = (0.3, 3.3),
        erasing_fill_value: float = 0.0,
        data_keys: DataKeys | None = None,
        same_on_batch: bool | None = False,
        **kwargs: Any,
    ) -> None:
        for name, value in (("initial_p", initial_p), ("max_p", max_p), ("target_real_acc", target_real_acc)):
            _check.fraction(type(self).__name__, name, value)
        augmentations = args or (
            A.RandomHorizontalFlip(p=1.0),
            A.RandomRotation90((0, 3), p=1.0),
            A.RandomErasing(erasing_scale, erasing_ratio, erasing_fill_value, p=0.9),
            A.RandomAffine(10.0, (0.1, 0.1), (0.9, 1.1), p=1.0),
            A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=1.0),
            A.RandomGaussianNoise(std=0.1, p=1.0),
        )
        super().__init__(
            *augmentations,
            data_keys=(DataKey.INPUT,) if data_keys is None else data_keys,
            same_on_batch=same_on_batch,
            **kwargs,
        )
        self.p, self.adjustment_speed, self.max_p = float(initial_p), float(adjustment_speed), float(max_p)
        self.target_real_acc, self.ema_lambda = float(target_real_acc), float(ema_lambda)
        self.update_every = update_every
        self.real_acc_ema, self._calls = 0.5, 0

    def update(self, real_acc: float | Tensor) -> None:
        """Take an accuracy on real images into account.

        Args:
            real_acc: the accuracy; or the discriminator's logits of real images, of which those above 0 are right.
        """
        if isinstance(real_acc, Tensor):
            accuracy = float(real_acc if real_acc.dim() == 0 else (real_acc > 0).float().mean())
        else:
            accuracy = float(real_acc)
        self._calls += 1
        if self._calls % self.update_every:
            return
        self.real_acc_ema = self.ema_lambda * self.real_acc_ema + (1 - self.ema_lambda) * accuracy
        step = self.adjustment_speed if self.real_acc_ema >= self.target_real_acc else -self.adjustment_speed
        self.p = min(max(self.p + step, 0.0), self.max_p)

    def forward(
        self,
        *inputs: Any,
        params: Sequence[ParamItem] | None = None,
        data_keys: DataKeys | None = None,
        real_acc: float | Tensor | None = None,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment a fraction of the samples.

        Args:
            *inputs: images and labels in the order of the data keys; or one dict.
            params: the `_params` of an earlier call, to repeat it.
            data_keys: keys of this call; default: those of the constructor.
            real_acc: accuracy on real images, or the discriminator's logits of them, which adjust the fraction.
            seed: an int from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays, images and masks with the channels last, "pil" for images and
                masks as lists of PIL images.

        Returns:
            What was given, with a fraction of the samples augmented. With `return_transform` the first image is a pair of it
            and the matrices (B, 3, 3).

        Raises:
            TypeError: no input is a tensor.
            ValueError: an augmentation changes the size of the images.
        """
        if real_acc is not None:
            self.update(real_acc)
        options: dict[str, Any] = {"seed": seed, "generator": generator, "return_transform": return_transform}
        return super().forward(*inputs, params=params, data_keys=data_keys, output_type=output_type, **options)

    def _call(
        self,
        keys: list[DataKey],
        inputs: list[Any],
        params: Any,
        seed: Seed,
        generator: Generator | None,
        before: Tensor | None,
        source: Frames | None = None,
        masks: dict[int, MaskCounts] | None = None,
    ) -> tuple[list[Any], Record]:
        op = type(self).__name__
        if source is not None:  # the images of samples that are not augmented are results
            first = keys.index(DataKey.INPUT)
            inputs = [source.rgb() if i == first else x for i, x in enumerate(inputs)]
        images = next((x for x in inputs if isinstance(x, Tensor)), None)
        if images is None:
            raise TypeCheckError(f"{op}: expected inputs to be Tensors, got {type(inputs[0]).__name__}")
        if params is not None:
            chosen = _chosen_of(params)
            params = params[:-1]
        else:
            own = draw_keys(op, 1, torch.device("cpu"), seed, generator or self.generator)
            request, position = Request([uniform(0.0, 1.0)]), _CHOICE if own.has_seed else 0
            (columns,) = draw_columns(torch.empty(images.shape[0], device="cpu"), own, [request], position)
            chosen = columns.values[:, 0] < self.p
        outputs, record = super()._call(keys, inputs, params, seed, generator, before, masks=masks)
        record.chosen = chosen
        return [_where(chosen, new, old) for new, old in zip(outputs, inputs)], record

    def _items(self, record: Record) -> list[Any]:
        items = super()._items(record)
        if record.chosen is not None:
            items.append(ParamItem("share", {"batch_prob": record.chosen.float()}))
        return items

    def _matrix(self, record: Record) -> Tensor | None:
        """The product (B, 3, 3) of the matrices of a call, the identity of samples that were not augmented."""
        matrix = super()._matrix(record)
        if matrix is None or record.chosen is None:
            return matrix
        return where_chosen(
            record.chosen, matrix, torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
        )

    def _invert_all(self, keys: list[DataKey], inputs: list[Any], params: Any) -> list[Any]:
        if self._parts_of(params) is not None:
            return super()._invert_all(keys, inputs, params)
        chosen = _chosen_of(self._params if params is None else params)
        outputs = super()._invert_all(keys, inputs, None if params is None else params[:-1])
        return [_where(chosen, new, old) for new, old in zip(outputs, inputs)]


_CHOICE = 1 << 16  # the position in the chain of the draw that chooses samples


def _chosen_of(params: Sequence[ParamItem]) -> Tensor:
    """(B,), which samples of a call were augmented."""
    is_chosen: Tensor = params[-1].data["batch_prob"] > 0.5
    return is_chosen


def _where(chosen: Tensor, new: Any, old: Any) -> Any:
    if isinstance(new, (list, tuple)) and isinstance(old, (list, tuple)):  # one of each sample
        return type(new)(after if is_chosen else before for is_chosen, after, before in zip(chosen, new, old))
    if hasattr(new, "_data") and hasattr(old, "_data"):  # kvision.geometry's Boxes and Keypoints
        mixed = new.clone()
        mixed._data = _where(chosen, new._data, old._data)
        return mixed
    if not isinstance(new, Tensor) or not isinstance(old, Tensor):
        return new
    if new.shape != old.shape:
        raise ValueCheckError(
            f"AdaptiveDiscriminatorAugmentation: expected augmentations that keep sizes, got {tuple(new.shape)} "
            f"from {tuple(old.shape)}"
        )
    return where_chosen(chosen, new, old if old.dtype == new.dtype else to_unit(old))
