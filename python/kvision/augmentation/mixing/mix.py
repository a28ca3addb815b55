"""Augmentations that mix the samples of a batch: images, and the masks, boxes and labels that belong to them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any, get_args

import torch
from torch import Generator, Tensor

from kvision import _check, geometry
from kvision._choices import CroppingMode
from kvision._constants import constant
from kvision._dtype import floats
from kvision.augmentation.engine import AugmentationBase2D, Execution, Params, replaying
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import BOX_FORMATS, parse_data_keys
from kvision.augmentation.mixing.pieces import (
    MIX_KIND,
    cutmix_pieces,
    jigsaw_pieces,
    mix_pieces,
    mixup_pieces,
    mosaic_pieces,
    paste_pieces,
)
from kvision.augmentation.random_generator.mix import (
    CutmixGenerator,
    JigsawGenerator,
    MixupGenerator,
    MosaicGenerator,
    PatchMixGenerator,
)
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.samples import where_chosen
from kvision.constants import AnyResample, DataKey, DataKeys, Resample
from kvision.core.exceptions import BaseError, ShapeError, TypeCheckError, ValueCheckError

__all__ = ["MixAugmentationBaseV2", "PatchMix", "RandomCutMixV2", "RandomJigsaw", "RandomMixUpV2", "RandomMosaic"]


class _UnsupportedKeyError(BaseError, NotImplementedError):
    """A label that an operation cannot mix."""


class _NoMatrixError(BaseError, RuntimeError):
    """The matrix of an operation that has none."""


class _GridError(ShapeError, RuntimeError):
    """Kornia raises a RuntimeError."""


class MixAugmentationBaseV2(AugmentationBase2D, keeps_contract=True):
    """Base of augmentations that mix the samples of a batch.

    A subclass implements `apply_transform` for images, and those of `apply_transform_mask`, `apply_transform_boxes`,
    `apply_transform_keypoint` and `apply_transform_class` that make sense.

    Args:
        p: probability that a sample is mixed.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: accepted for the other classes' sake; samples of a batch are mixed.
        data_keys: what the arguments of a call are, "input" first; default: images alone.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1; a key is unknown.

    Example:
        >>> import torch, kvision as K
        >>> class Swap(K.augmentation.MixAugmentationBaseV2):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return input.flip(0)
        >>> Swap(p=1.0, p_batch=1.0)(torch.tensor([1.0, 2.0]).reshape(2, 1, 1, 1)).flatten()
        tensor([2., 1.])
    """

    mixes_samples = True
    needs_key = DataKey.INPUT  # without which there is nothing to mix

    def __init__(
        self,
        p: float,
        p_batch: float,
        same_on_batch: bool = False,
        keepdim: bool = False,
        data_keys: DataKeys | None = None,
        **options: Any,
    ) -> None:
        op = type(self).__name__
        if options.get("return_transform"):
            raise _NoMatrixError(f"{op}: samples are mixed, there is no matrix to return")
        super().__init__(p=p, p_batch=p_batch, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.data_keys = [DataKey.INPUT] if data_keys is None else parse_data_keys(op, data_keys)
        if self.needs_key not in self.data_keys:
            raise ValueCheckError(
                f"{op}: expected data_keys with {self.needs_key.name.lower()!r}, got {data_keys!r}",
                actual_value=data_keys,
            )

    @property
    def transform_matrix(self) -> Tensor:
        """Mixing has no matrix."""
        raise _NoMatrixError(f"{type(self).__name__}: samples are mixed, there is no matrix")

    def forward(  # type: ignore[override]  # several inputs
        self,
        *input: Any,
        params: Params | None = None,
        data_keys: DataKeys | None = None,
        seed: Seed = None,
        generator: Generator | None = None,
    ) -> Any:
        """Mix the samples of a batch.

        Args:
            *input: images and labels in the order of the data keys; those without a key are ignored.
            params: the `_params` of an earlier call, to repeat it.
            data_keys: keys of this call; default: those of the constructor.
            seed: an int from which all parameters follow.
            generator: draws the key of this call; default: that of the constructor, or torch's.

        Returns:
            What was given, mixed: one tensor for one key, else a list.

        Raises:
            TypeError: the images are not tensors of a floating-point type or uint8.
            ValueError: there are fewer inputs than keys.
            NotImplementedError: a key that this operation cannot mix.
        """
        op = type(self).__name__
        keys = self.data_keys if data_keys is None else parse_data_keys(op, data_keys)
        if len(input) < len(keys):
            raise ValueCheckError(f"{op}: expected {len(keys)} inputs, got {len(input)}")
        if DataKey.INPUT not in keys:
            raise ValueCheckError(f"{op}: expected data_keys with 'input', got {data_keys!r}", actual_value=data_keys)
        x = self.transform_tensor(input[keys.index(DataKey.INPUT)])
        for key, value in zip(keys, input):
            if key != DataKey.INPUT:
                self._check_labels(key, value, x.shape[0])
        boxes = next((value.shape[1] for key, value in zip(keys, input) if key in BOX_FORMATS), None)
        with nullcontext() if params is None else replaying(op, params):
            execution = self._draw(x, seed, generator) if params is None else self._from_params(params, x)
            self._execution = execution
            outputs = [self._mixed(key, value, x, execution, boxes) for key, value in zip(keys, input)]
        return outputs[0] if len(outputs) == 1 else outputs

    def _mixed(self, key: DataKey, value: Any, x: Tensor, execution: Execution, boxes: int | None) -> Any:
        """What belongs to a key, mixed; `boxes` is how many boxes an image has, None without boxes."""
        if key == DataKey.INPUT:
            return self._run(self.transform_tensor(value), execution, self.flags)
        if key == DataKey.MASK:
            return self.transform_masks(value, execution, self.flags)
        if execution.applied:
            params = {**self._params_on_device(x, execution), "chosen": execution.chosen}
        else:  # labels have the shape of mixed ones, so that the parameters are read all the same
            params = {name: value.to(x.device) for name, value in self._read_params(execution).items()}
            params["chosen"] = torch.zeros(x.shape[0], dtype=torch.bool, device=x.device)
        if key in BOX_FORMATS:
            return self.apply_transform_boxes(value, params, {**self.flags, "mode": key, "chosen": params["chosen"]})
        if key == DataKey.KEYPOINTS:
            return where_chosen(params["chosen"], self.apply_transform_keypoint(value, params, self.flags), value)
        if value.dim() == 2 and value.shape[1] != boxes and self._is_mixture(value, boxes):
            return self._mixed_probabilities(value, params, execution)
        return self.apply_transform_class(value, params, self.flags)

    def _mixed_labels(self, key: DataKey, labels: Any, execution: Execution, boxes: int | None) -> Any:
        """Labels of the images of an execution, in containers."""
        self._check_labels(key, labels, execution.shape[0])
        return self._mixed(key, labels, labels.new_empty(execution.shape[0]), execution, boxes)

    def _partners(self, params: Params) -> list[tuple[Tensor, Tensor]] | None:
        """Partners (B,) and their parts (B,) of the result, for labels (B, K); None where images are not mixed so."""
        return None

    def _is_mixture(self, labels: Tensor, boxes: int | None) -> bool:
        """Whether labels (B, K) are probabilities of K classes, or integers with one 1 a row, which are read for that."""
        if type(self)._partners is MixAugmentationBaseV2._partners:
            return False
        if labels.is_floating_point():
            return True
        return boxes is None and bool((((labels == 0) | (labels == 1)).all(1) & (labels.sum(1) == 1)).all())

    def _mixed_probabilities(self, labels: Tensor, params: Params, execution: Execution) -> Tensor:
        """Probabilities (B, K) of the classes of images, as much of each partner as the result has."""
        stored = labels.dtype if labels.is_floating_point() else torch.float32
        values = labels.to(torch.promote_types(stored, torch.float32))
        if not execution.applied:
            return values.to(stored)
        mixed = values
        for index, part in self._partners(params) or ():
            mixed = mixed + (values[index.to(values.device)] - values) * part.to(values)[:, None]
        return where_chosen(execution.chosen, mixed, values).to(stored)

    def _check_labels(self, key: DataKey, labels: Any, count: int) -> None:
        op, name = type(self).__name__, key.name.lower()
        _check.is_tensor(op, name, labels)
        if labels.dim() == 0 or labels.shape[0] != count:
            raise ShapeError(f"{op}: expected {name} of {count} images, got {tuple(labels.shape)}")

    @staticmethod
    def _chosen(mixed: Tensor, unmixed: Tensor, execution: Execution) -> Tensor:
        """Mixed samples where they are chosen; all of them in classes of users that change the size."""
        return where_chosen(execution.chosen, mixed, unmixed) if mixed.shape == unmixed.shape else mixed

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        size = self._output_size(execution.shape)
        if not execution.applied or x.shape[0] == 0:
            return self._unmixed(x, size)
        pieces = self._drawn_pieces(execution)
        if pieces is not None:
            y: Tensor = paste_pieces(x, pieces, size)
            return y if size == list(x.shape[-2:]) else self._chosen(y, self._unmixed(x, size), execution)
        params = self._params_on_device(x, execution)
        stored = x.dtype
        image = x.float() if stored == torch.uint8 else x
        y = self.apply_transform(image, params, flags, None)
        y = y.round().clamp(0, 255).to(stored) if stored == torch.uint8 else y.to(stored)
        return self._chosen(y, self._unmixed(x, size), execution)

    def _unmixed(self, x: Tensor, size: Sequence[int], is_mask: bool = False) -> Tensor:
        """Samples that are not chosen, in the size of the mixed ones."""
        return x

    def _drawn_pieces(self, execution: Execution) -> Tensor | None:
        """The pieces of images by one operator, from the columns of a call; None where methods or gradients need parameters."""
        columns = execution.columns
        if columns is None or columns.drawn.requires_grad or columns.drawn.dtype != torch.float32:
            return None
        plan = None if self._is_overridden("apply_transform") else self._mix_plan(execution.shape)
        if plan is None:
            return None
        kind, count, grid, numbers = plan
        span, shape = columns.span, execution.shape
        chosen = span.first if span.has_chosen else -1
        sizes = [*grid, *shape[-2:], *self._output_size(shape)]
        pieces: Tensor = mix_pieces(columns.drawn, [MIX_KIND[kind], span.first_value, chosen, count, *sizes], numbers)
        return pieces

    def _copied_pieces(self, execution: Execution) -> Tensor | None:
        has_size = self._output_size(execution.shape) == list(execution.shape[-2:])
        return self._drawn_pieces(execution) if execution.applied and has_size else None

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]] | None:
        """The kind of `MIX_KIND`, how many pieces, rows and columns, and numbers; None for classes without pieces."""
        return None

    def _output_size(self, shape: Sequence[int]) -> list[int]:
        return [int(n) for n in shape[-2:]]

    def _from_params(self, params: Params, x: Tensor) -> Execution:
        execution = super()._from_params(params, x)
        execution.columns = None
        return execution

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        unmixed = self._unmixed(masks, self._output_size(execution.shape), is_mask=True)
        if not execution.applied:
            return unmixed
        params = self._params_on_device(masks, execution)
        return self._chosen(self.apply_transform_mask(masks, params, flags), unmixed, execution)

    def _refuse(self, what: str) -> _UnsupportedKeyError:
        return _UnsupportedKeyError(f"{type(self).__name__}: {what} cannot be mixed")

    def _pasted_boxes(self, boxes: Tensor, windows: Sequence[tuple[Tensor, Tensor]], flags: dict[str, Any]) -> Tensor:
        """Boxes (B, N, 4), 0 if a window hides them, followed by what the windows show of those of the partners."""
        self._check_xyxy(flags)
        chosen = flags.get("chosen")
        parts = [boxes]
        for partners, window in windows:
            w = window.to(boxes)[:, None]
            inside = torch.cat(
                [boxes[partners][..., :2].maximum(w[..., :2]), boxes[partners][..., 2:].minimum(w[..., 2:])], -1
            )
            if chosen is not None:
                inside = torch.where(chosen[:, None, None], inside, 0)
                w = torch.where(chosen[:, None, None], w, 0)
            hidden = [(old[..., :2] >= w[..., :2]).all(-1) & (old[..., 2:] <= w[..., 2:]).all(-1) for old in parts]
            parts = [old.masked_fill(gone[..., None], 0) for old, gone in zip(parts, hidden)]
            parts.append(torch.where((_area(inside) > 0)[..., None], inside, 0).to(boxes.dtype))
        return torch.cat(parts, 1)

    def _check_xyxy(self, flags: dict[str, Any]) -> None:
        if flags.get("mode", DataKey.BBOX_XYXY) != DataKey.BBOX_XYXY:
            raise self._refuse("boxes other than bbox_xyxy")

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Mix masks (B, C, H, W)."""
        raise self._refuse("masks")

    def apply_transform_boxes(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """Mix boxes."""
        raise self._refuse("boxes")

    def apply_transform_keypoint(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """Mix key points (B, N, 2)."""
        raise self._refuse("key points")

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """Mix labels (B,)."""
        raise self._refuse("labels")

    def inverse(self, *args: Any, **kwargs: Any) -> Any:
        """Mixing has no inverse."""
        raise _NoMatrixError(f"{type(self).__name__}: mixed samples cannot be taken apart")

    inverse_images = inverse


def check_signed(op: str, labels: Tensor) -> None:
    """Labels of boxes that have the value -1, which those get that are not there."""
    if not labels.dtype.is_signed:
        raise TypeCheckError(
            f"{op}: expected labels of boxes of a signed type, since they become -1 where there is no box, got {labels.dtype}",
            actual_type=labels.dtype,
        )


def _of_boxes(op: str, labels: Tensor, partners: Sequence[Tensor], params: Params) -> Tensor:
    """Labels of boxes (B, N), followed by those of the partners' boxes; -1 for samples that are not chosen."""
    chosen = params.get("chosen")
    if chosen is not None:
        check_signed(op, labels)
    added = [where_chosen(chosen, labels[index.to(labels.device)], -1).to(labels.dtype) for index in partners]
    return torch.cat([labels, *added], 1)


def _labels(labels: Tensor, partners: Tensor, weights: Tensor, params: Params) -> Tensor:
    """(B, 3): the label, the partner's, and a weight; (y, y, 0) for samples that are not chosen."""
    weights = weights.to(labels.device, labels.dtype if labels.is_floating_point() else torch.float32)
    mixed = torch.stack([labels.to(weights), labels[partners.to(labels.device)].to(weights), weights], -1)
    chosen = params.get("chosen")
    if chosen is None:
        return mixed
    alone = torch.stack([labels.to(weights), labels.to(weights), torch.zeros_like(weights)], -1)
    return torch.where(chosen.to(labels.device)[:, None], mixed, alone)


class RandomMixUpV2(MixAugmentationBaseV2, keeps_contract=True):
    """Mix each image with another one of the batch: (1 - weight) * image + weight * partner.

    Labels (B,) become (B, 3): the label, that of the partner, and the weight of the partner. Labels (B, K), probabilities or
    integers with one 1 a row, are mixed, and so are masks.
    Source: Zhang, Cisse, Dauphin and Lopez-Paz, mixup: beyond empirical risk minimization, ICLR 2018.

    Args:
        lambda_val: range of the weight; None for 0 to 1.
        same_on_batch: all samples get the same weight.
        p: probability that a sample is mixed.
        keepdim: no effect; accepted as by the other classes.
        data_keys: what the arguments of a call are: "input", "class", "mask"; default: images alone.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> mix = K.augmentation.RandomMixUpV2((0.0, 0.0), data_keys=["input", "class"])
        >>> images, labels = mix(torch.ones(2, 1, 4, 4), torch.tensor([3, 5]))
        >>> labels[:, 0], labels[:, 2]
        (tensor([3., 5.]), tensor([0., 0.]))
    """

    def __init__(
        self,
        lambda_val: Numbers | None = None,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        data_keys: DataKeys | None = None,
        **options: Any,
    ) -> None:
        super().__init__(1.0, p, same_on_batch, keepdim, data_keys, **options)
        self.p, self.p_batch = self.p_batch, 1.0
        self._param_generator = MixupGenerator(lambda_val, p)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        weights, pairs = params["mixup_lambdas"], params["mixup_pairs"]
        if weights.requires_grad:
            weight = weights.to(input.dtype)[:, None, None, None]
            return input * (1 - weight) + input[pairs] * weight
        size = list(input.shape[-2:])
        mixed: Tensor = paste_pieces(input, mixup_pieces(pairs, weights, *size), size)
        return mixed

    def _copied_pieces(self, execution: Execution) -> None:
        return None  # which have weights

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]]:
        return "mixup", 1, (1, 1), [0.0, 0.0]

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        if not input.is_floating_point():
            raise self._refuse("masks of integers")
        return self.apply_transform(input, params, flags)

    def _partners(self, params: Params) -> list[tuple[Tensor, Tensor]]:
        return [(params["mixup_pairs"], params["mixup_lambdas"])]

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        if input.dim() > 1:
            raise ShapeError(
                f"{type(self).__name__}: expected labels (B,), or (B, K) of a floating-point type or with one 1 a row, "
                f"got {input.dtype} {tuple(input.shape)}"
            )
        return _labels(input, params["mixup_pairs"], params["mixup_lambdas"], params)


def _in_windows(windows: Tensor, height: int, width: int) -> Tensor:
    """(B, 1, H, W): which pixels are in the windows (B, 4): first column, first row, and the ends of both."""
    rows = torch.arange(height, device=windows.device)[:, None]
    columns = torch.arange(width, device=windows.device)
    x, y, right, bottom = windows[:, :, None, None].unbind(1)
    return ((columns >= x) & (columns < right) & (rows >= y) & (rows < bottom))[:, None]


class RandomCutMixV2(MixAugmentationBaseV2, keeps_contract=True):
    """Paste a window of another image of the batch into each image.

    Labels (B,) become (num_mix, B, 3): the label, that of the partner, and the fraction of the image that is kept. Labels (B,
    K), probabilities or integers with one 1 a row, are mixed by what is seen of each image. Masks are pasted as images. Boxes
    (B, N, 4) and their labels (B, N) are followed by those of the partners, clipped to the window.
    Source: Yun, Han, Oh, Chun, Choe and Yoo, CutMix, ICCV 2019.

    Args:
        num_mix: how many windows each sample gets.
        cut_size: range of the side of a window, as a fraction of the image's; None for 0 to 1.
        beta: parameter of the symmetric beta distribution of the fraction kept; None for 1, the uniform one.
        same_on_batch: all samples get the same window.
        p: probability that a sample is mixed.
        keepdim: no effect; accepted as by the other classes.
        data_keys: what the arguments of a call are: "input", "class", "mask", "bbox_xyxy"; default: images alone.
        use_correct_lambda: accepted for code written for Kornia: the weight is the fraction kept either way.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> cut = K.augmentation.RandomCutMixV2(cut_size=(0.5, 0.5), data_keys=["input", "class"])
        >>> images, labels = cut(torch.rand(2, 1, 4, 4), torch.tensor([3, 5]))
        >>> labels[0, :, 2]
        tensor([0.7500, 0.7500])
    """

    def __init__(
        self,
        num_mix: int = 1,
        cut_size: Numbers | None = None,
        beta: float | Tensor | None = None,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        data_keys: DataKeys | None = None,
        use_correct_lambda: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p, 1.0, same_on_batch, keepdim, data_keys, **options)
        self._param_generator: CutmixGenerator = CutmixGenerator(cut_size, beta, num_mix, p)

    @staticmethod
    def _windows(params: Params) -> list[tuple[Tensor, Tensor]]:
        """The partners and the windows, with their ends, of each round."""
        corners = params["crop_src"].long()
        windows = torch.cat([corners[:, :, 0], corners[:, :, 2] + 1], -1)
        return list(zip(params["mix_pairs"], windows))

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        pasted: Tensor = paste_pieces(input, cutmix_pieces(self._windows(params)), list(input.shape[-2:]))
        return pasted

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self.apply_transform(input, params, flags)

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]]:
        generator = self._param_generator
        return "cutmix", generator.num_mix, (1, 1), [generator._cut.low, generator._cut.high]

    def apply_transform_boxes(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        return self._pasted_boxes(input, self._windows(params), flags)

    def _partners(self, params: Params) -> list[tuple[Tensor, Tensor]]:
        height, width = (int(n) for n in params["image_shape"].tolist())
        windows = self._windows(params)
        last = windows[0][1].new_zeros(1)  # the round that a pixel is from: later windows cover earlier ones
        for number, (_, window) in enumerate(windows, start=1):
            last = torch.where(_in_windows(window, height, width), number, last)
        parts = [(last == number).double().mean((1, 2, 3)) for number in range(1, len(windows) + 1)]
        return [(partners, part) for (partners, _), part in zip(windows, parts)]

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        if input.dim() > 1:
            return _of_boxes(type(self).__name__, input, [partners for partners, _ in self._windows(params)], params)
        height, width = params["image_shape"].tolist()
        rounds = []
        for partners, windows in self._windows(params):
            area = (windows[:, 2] - windows[:, 0]) * (windows[:, 3] - windows[:, 1])
            rounds.append(_labels(input, partners, 1 - area / (height * width), params))
        return torch.stack(rounds)


class PatchMix(MixAugmentationBaseV2, keeps_contract=True):
    """Paste a square window of another image of the batch into each image; all windows have the same size.

    Labels (B,) become (B, 3): the label, that of the partner, and the fraction of the image that is kept. Labels (B, K),
    probabilities or integers with one 1 a row, are mixed by these fractions. Masks are pasted as images. Boxes (B, N, 4) and
    their labels (B, N) are followed by those of the partners, clipped to the window.

    Args:
        alpha: accepted for code written for Kornia: the window has one size.
        patch_size: side of the window in pixels.
        p: probability that a sample is mixed.
        same_on_batch: all samples get the same window.
        keepdim: no effect; accepted as by the other classes.
        data_keys: what the arguments of a call are: "input", "class", "mask"; default: images alone.

    Raises:
        ValueError: `alpha` or `patch_size` is not above 0.

    Example:
        >>> import torch, kvision as K
        >>> mix = K.augmentation.PatchMix(patch_size=2, data_keys=["input", "class"])
        >>> mix(torch.rand(2, 1, 4, 4), torch.tensor([3, 5]))[1][:, 2]
        tensor([0.7500, 0.7500])
    """

    def __init__(
        self,
        alpha: float = 1.0,
        patch_size: int | tuple[int, int] = 16,
        p: float = 1.0,
        same_on_batch: bool = False,
        keepdim: bool = False,
        data_keys: DataKeys | None = None,
        **options: Any,
    ) -> None:
        super().__init__(p, 1.0, same_on_batch, keepdim, data_keys, **options)
        self._param_generator: PatchMixGenerator = PatchMixGenerator(alpha, patch_size, p)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        pieces = cutmix_pieces([(params["mix_pairs"], params["patch_coords"])])
        pasted: Tensor = paste_pieces(input, pieces, list(input.shape[-2:]))
        return pasted

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]]:
        h, w = (min(a, b) for a, b in zip(self._param_generator.patch_size, shape[-2:]))
        return "patch_mix", 1, (h, w), [0.0, 0.0]

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self.apply_transform(input, params, flags)

    def apply_transform_boxes(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        return self._pasted_boxes(input, [(params["mix_pairs"], params["patch_coords"])], flags)

    def _partners(self, params: Params) -> list[tuple[Tensor, Tensor]]:
        return [(params["mix_pairs"], 1 - params["lam"])]

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        if input.dim() > 1:
            return _of_boxes(type(self).__name__, input, [params["mix_pairs"]], params)
        return _labels(input, params["mix_pairs"], params["lam"], params)


class RandomJigsaw(MixAugmentationBaseV2, keeps_contract=True):
    """Put the cells of a grid over each image in a random order; masks, key points and parts of boxes move with them.

    Args:
        grid: rows and columns of cells, which divide the sides of the images.
        data_keys: what the arguments of a call are: "input", "mask", "bbox_xyxy", "keypoints", "class"; default: images alone.
        p: probability that a sample is augmented.
        same_on_batch: all samples get the same order.
        keepdim: no effect; accepted as by the other classes.
        ensure_perm: no sample keeps all cells at their positions.

    Raises:
        TypeError, ValueError: `grid` is not two ints of at least 1.
        ValueError, RuntimeError: in a call, the grid does not divide the images.

    Example:
        >>> import torch, kvision as K
        >>> cells = K.augmentation.RandomJigsaw((1, 2), p=1.0)(torch.tensor([[[[1.0, 2.0]]]]))
        >>> cells
        tensor([[[[2., 1.]]]])
    """

    def __init__(
        self,
        grid: tuple[int, int] = (4, 4),
        data_keys: DataKeys | None = None,
        p: float = 0.5,
        same_on_batch: bool = False,
        keepdim: bool = False,
        ensure_perm: bool = True,
        **options: Any,
    ) -> None:
        super().__init__(p, 1.0, same_on_batch, keepdim, data_keys, **options)
        self._param_generator: JigsawGenerator = JigsawGenerator(grid, ensure_perm)
        self.grid = self._param_generator.grid

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        size = list(self._checked(input.shape)[-2:])
        moved: Tensor = paste_pieces(input, jigsaw_pieces(params["permutation"], self.grid, *size), size)
        return moved

    def _checked(self, shape: Sequence[int]) -> Sequence[int]:
        if shape[-2] % self.grid[0] or shape[-1] % self.grid[1]:
            raise _GridError(f"RandomJigsaw: expected images that a grid of {self.grid} divides, got {tuple(shape)}")
        return shape

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]]:
        self._checked(shape)
        ensures = float(self._param_generator.ensure_perm)
        return "jigsaw", self.grid[0] * self.grid[1], self.grid, [ensures, 0.0]

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self.apply_transform(input, params, flags)

    def apply_transform_boxes(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """The parts of boxes in each cell, (B, rows * columns * N, 4), at the new positions of the cells; 0 where there is none."""
        self._check_xyxy(flags)
        order, grid = params["permutation"], torch.arange(self.grid[0] * self.grid[1], device=input.device)
        chosen = flags.get("chosen")
        if chosen is not None:
            order = torch.where(chosen[:, None], order, grid)
        height, width = (int(n) for n in params["forward_input_shape"][-2:])
        size = constant((width // self.grid[1], height // self.grid[0]), input, torch.int64)
        corners = torch.stack([grid % self.grid[1], grid // self.grid[1]], -1) * size
        first = corners[order][:, :, None].to(input)  # where each cell of the result was
        parts = torch.cat([input[:, None, :, :2].maximum(first), input[:, None, :, 2:].minimum(first + size)], -1)
        shift = (corners[:, None] - first).to(input)
        parts = torch.where((_area(parts) > 0)[..., None], parts + torch.cat([shift, shift], -1), 0)
        return parts.flatten(1, 2).to(input.dtype)

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        if input.dim() < 2:
            return input  # of images, which keep their content
        return input.repeat(1, self.grid[0] * self.grid[1], *[1] * (input.dim() - 2))

    def apply_transform_keypoint(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        height, width = (int(n) for n in params["forward_input_shape"][-2:])
        rows, columns = self.grid
        h, w = height // rows, width // columns
        position = params["permutation"].argsort(1)  # where each cell goes
        column = (input[..., 0] + 0.5).div(w).floor().clamp(0, columns - 1).long()
        row = (input[..., 1] + 0.5).div(h).floor().clamp(0, rows - 1).long()
        to = position.gather(1, row * columns + column)
        shift = torch.stack([(to % columns - column) * w, (to // columns - row) * h], -1)
        return input + shift.to(input)


class RandomMosaic(MixAugmentationBaseV2, keeps_contract=True):
    """Join several images of the batch in a grid and cut a window out of them; boxes and masks follow.

    Args:
        output_size: height and width of the result; None for those of the images.
        mosaic_grid: rows and columns of images.
        start_ratio_range: where the window begins, as a fraction of the size of an image.
        min_bbox_size: boxes whose area in the window is below this fraction of theirs become (0, 0, 0, 0).
        data_keys: what the arguments of a call are: "input", "mask", "bbox_xyxy"; default: images alone.
        p: probability that a sample is augmented; the others are resized.
        keepdim: no effect; accepted as by the other classes.
        padding_mode: accepted for code written for Kornia: outside of the images there is 0.
        resample: how samples that are not chosen are resized: 'nearest', 'bilinear' or 'bicubic'.
        align_corners: accepted for code written for Kornia.
        cropping_mode: accepted for code written for Kornia; windows begin at pixels.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within 0 and 1; sizes that are not two
            ints of at least 1.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomMosaic((6, 6), p=1.0)(torch.rand(4, 3, 8, 8)).shape
        torch.Size([4, 3, 6, 6])
    """

    def __init__(
        self,
        output_size: tuple[int, int] | None = None,
        mosaic_grid: tuple[int, int] = (2, 2),
        start_ratio_range: tuple[float, float] = (0.3, 0.7),
        min_bbox_size: float = 0.0,
        data_keys: DataKeys | None = None,
        p: float = 0.7,
        keepdim: bool = False,
        padding_mode: str = "constant",
        resample: AnyResample = Resample.BILINEAR.name,
        align_corners: bool = True,
        cropping_mode: CroppingMode = "slice",
        **options: Any,
    ) -> None:
        super().__init__(p, 1.0, False, keepdim, data_keys, **options)
        self._param_generator: MosaicGenerator = MosaicGenerator(output_size, mosaic_grid, start_ratio_range)
        self.min_bbox_size = float(min_bbox_size)
        _check.choice("RandomMosaic", "cropping_mode", cropping_mode, get_args(CroppingMode))
        self.flags = {
            "output_size": output_size,
            "mosaic_grid": mosaic_grid,
            "min_bbox_size": min_bbox_size,
            "padding_mode": padding_mode,
            "resample": Resample.get(resample),
            "align_corners": align_corners,
            "cropping_mode": cropping_mode,
        }

    def _output_size(self, shape: Sequence[int]) -> list[int]:
        return list(self._param_generator.output_size or (int(n) for n in shape[-2:]))

    def _mix_plan(self, shape: Sequence[int]) -> tuple[str, int, tuple[int, int], list[float]]:
        generator = self._param_generator
        return "mosaic", generator.cells + 1, generator.mosaic_grid, [0.0, 0.0]

    def _window(self, input: Tensor, params: Params) -> Tensor:
        """The window of each mosaic, without the mosaic."""
        source, size = (input.shape[-2], input.shape[-1]), self._output_size(params["forward_input_shape"].tolist())
        permutation, start = (params[name].to(input.device) for name in ("permutation", "src"))
        grid = self._param_generator.mosaic_grid
        pieces = mosaic_pieces(permutation, start[:, 0].round(), grid, source, (size[0], size[1]))
        window: Tensor = paste_pieces(input, pieces, size)
        return window

    def _unmixed(self, x: Tensor, size: Sequence[int], is_mask: bool = False) -> Tensor:
        if list(x.shape[-2:]) == list(size):
            return x
        mode: Any = "nearest" if is_mask else Resample.get(self.flags["resample"]).name.lower()
        align_corners = None if mode == "nearest" else self.flags["align_corners"]
        return geometry.resize(x, (size[0], size[1]), mode, align_corners=align_corners)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._window(input, params)

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._window(input, params)

    def apply_transform_boxes(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        self._check_xyxy(flags)
        input = floats(input)
        b, n = input.shape[:2]
        height, width = (int(k) for k in params["forward_input_shape"][-2:])
        h, w = self._output_size(params["forward_input_shape"].tolist())
        rows, columns = self._param_generator.mosaic_grid
        cell = torch.arange(rows * columns, device=input.device)
        corner = torch.stack([cell % columns * width, cell // columns * height], -1)[None, :, None]
        corner = (corner - params["src"][:, None, None, 0]).to(input.dtype)
        boxes = input[params["permutation"]] + torch.cat([corner, corner], -1)
        limit = constant((w, h, w, h), input)
        inside = torch.minimum(boxes.clamp(min=0), limit).reshape(b, -1, 4)
        boxes = boxes.reshape(b, -1, 4)
        visible = _area(inside) / _area(boxes).clamp(min=torch.finfo(input.dtype).tiny)
        inside = torch.where(((visible > 0) & (visible >= self.min_bbox_size))[..., None], inside, 0)
        chosen = flags.get("chosen")
        if chosen is None:
            return inside
        scale = constant((w / width, h / height) * 2, input)
        alone = torch.cat([input * scale, input.new_zeros(b, inside.shape[1] - n, 4)], 1)
        return torch.where(chosen[:, None, None], inside, alone)

    def apply_transform_class(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        if input.dim() < 2:
            raise self._refuse("labels of images")
        mixed = input[params["permutation"].to(input.device)].flatten(1, 2)  # of boxes (B, N)
        chosen = params.get("chosen")
        if chosen is None:
            return mixed
        check_signed(type(self).__name__, input)
        gone = input.new_full((len(input), mixed.shape[1] - input.shape[1], *input.shape[2:]), -1)
        return where_chosen(chosen, mixed, torch.cat([input, gone], 1))


def _area(boxes: Tensor) -> Tensor:
    return (boxes[..., 2] - boxes[..., 0]).clamp(min=0) * (boxes[..., 3] - boxes[..., 1]).clamp(min=0)
