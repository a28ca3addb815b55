"""v2's mixes of the samples of a batch, and policies."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, ClassVar

import torch
from torch import Tensor

from kvision import _check
from kvision._torch_compat import sample_dirichlet, tree_flatten, tree_unflatten
from kvision._tv_tensors import kind_of, plain, wrap
from kvision.tv import draw
from kvision.tv import functional as F
from kvision.tv.functional.values import largest
from kvision.tv.geometry import Fill, Interpolation
from kvision.tv.inputs import pil_to_tensor, to_pil_image
from kvision.tv.transform import Transform, fill_of, size_of
from kvision.tv.values import labels_getter_of


class _Mix(Transform, kw_only=True):
    alpha: float = 1.0
    num_classes: int | None = None
    labels_getter: Any = "default"

    kinds = frozenset({"tensor", "image", "video"})
    mixes_samples = True

    def _share(self) -> float:
        """A draw of the Beta distribution."""
        alpha = torch.tensor([float(self.alpha)], device="cpu")
        return float(torch.distributions.Beta(alpha, alpha).sample(()))

    def forward(self, *inputs: Any) -> Any:
        sample, name = inputs if len(inputs) > 1 else inputs[0], type(self).__name__
        flat, spec = tree_flatten(sample)
        needed = self._needed(flat)
        if any(kind_of(x) in ("pil", "boxes", "mask", "points") for x in flat):
            raise ValueError(f"{name}: expected a sample without PIL images, boxes, masks and key points")
        labels = labels_getter_of(self.labels_getter)(sample)
        if not isinstance(labels, Tensor) or labels.dim() not in (1, 2):
            raise ValueError(f"{name}: expected labels (B,) or (B, classes), got {labels!r}")
        if labels.dim() == 1 and self.num_classes is None:
            raise ValueError(f"{name}: expected num_classes where labels are numbers of classes, (B,)")
        if labels.dim() == 2 and self.num_classes not in (None, labels.shape[1]):
            raise ValueError(f"{name}: expected labels of {self.num_classes} classes, got {tuple(labels.shape)}")
        images = [x for x, is_needed in zip(flat, needed) if is_needed and x is not labels]
        for x in images:
            axes = 5 if kind_of(x) == "video" else 4
            if x.dim() != axes or x.shape[0] != labels.shape[0]:
                raise ValueError(
                    f"{name}: expected a batch of {labels.shape[0]} with {axes} axes, got {tuple(x.shape)}"
                )
        params = self.make_params(images)
        outputs: list[Any] = []
        for x, is_needed in zip(flat, needed):
            if x is labels:
                outputs.append(self._mixed_labels(x, params["share"]))
            else:
                outputs.append(wrap(self._mixed(plain(x), params), x) if is_needed else x)
        return tree_unflatten(outputs, spec)

    def _mixed(self, x: Tensor, params: dict[str, Any]) -> Tensor:
        raise NotImplementedError

    def _mixed_labels(self, labels: Tensor, share: float) -> Tensor:
        if labels.dim() == 1:
            labels = torch.nn.functional.one_hot(labels, self.num_classes)  # type: ignore[arg-type]  # not None
        labels = labels if labels.is_floating_point() else labels.float()
        return labels.roll(1, 0).mul_(1 - share).add_(labels, alpha=share)


class MixUp(_Mix, kw_only=True):
    """Mix each sample of a batch with its neighbor, images and labels.

    Args:
        alpha: both parameters of the Beta distribution of the share.
        num_classes: of labels that are numbers of classes.
        labels_getter: "default" finds the entry of a dict named labels, in the second place of a tuple; a function of
            the sample that returns a tensor or several; None for no labels.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> images, labels = tv.MixUp(num_classes=3)(torch.zeros(2, 3, 8, 6), torch.tensor([0, 2]))
        >>> labels.shape
        torch.Size([2, 3])
    """

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"share": self._share()}

    def _mixed(self, x: Tensor, params: dict[str, Any]) -> Tensor:
        share = params["share"]
        return x.roll(1, 0).mul_(1 - share).add_(x.mul(share))


class CutMix(_Mix, kw_only=True):
    """Replace a window of each sample of a batch by its neighbor's, and mix the labels.

    Args:
        alpha: both parameters of the Beta distribution of the area.
        num_classes: of labels that are numbers of classes.
        labels_getter: "default" finds the entry of a dict named labels, in the second place of a tuple; a function of
            the sample that returns a tensor or several; None for no labels.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> images, labels = tv.CutMix(num_classes=3)(torch.zeros(2, 3, 8, 6), torch.tensor([0, 2]))
        >>> labels.shape
        torch.Size([2, 3])
    """

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        height, width = size_of(flat_inputs)
        r = 0.5 * math.sqrt(1 - self._share())
        x, y = draw.integer(0, width), draw.integer(0, height)
        w, h = int(r * width), int(r * height)
        left, top, right, bottom = max(x - w, 0), max(y - h, 0), min(x + w, width), min(y + h, height)
        share = 1.0 - (right - left) * (bottom - top) / (width * height)
        return {"box": (left, top, right, bottom), "share": share}

    def _mixed(self, x: Tensor, params: dict[str, Any]) -> Tensor:
        left, top, right, bottom = params["box"]
        output = x.clone()
        window = output[..., top:bottom, left:right]
        window.copy_(x[..., top:bottom, left:right].roll(1, 0))
        return output


# --- policies -------------------------------------------------------------------------------------------------------


class AutoAugmentPolicy(Enum):
    """The policies of AutoAugment, by the data on which they were found.

    Example:
        >>> from kvision import tv
        >>> tv.AutoAugmentPolicy.CIFAR10.value
        'cifar10'
    """

    IMAGENET = "imagenet"
    CIFAR10 = "cifar10"
    SVHN = "svhn"


# Magnitudes of an operation by the number of bins and the image's height and width, and whether their sign is drawn.
_Magnitudes = Callable[[int, int, int], Sequence[float] | None]
_Space = dict[str, tuple[_Magnitudes, bool]]


def _linear(low: float, high: float) -> _Magnitudes:
    return functools.lru_cache(64)(lambda bins, height, width: torch.linspace(low, high, bins, device="cpu").tolist())


def _posterize(most: int, lost: int) -> _Magnitudes:
    return lambda bins, height, width: [round(most - i / ((bins - 1) / lost)) for i in range(bins)]


def _none(bins: int, height: int, width: int) -> None:
    return None


def _space(shear: float, x: Any, y: Any, angle: float, color: float, bits: tuple[int, int], further: str) -> _Space:
    space: _Space = {} if further != "Identity" else {"Identity": (_none, False)}
    space |= {"ShearX": (_linear(0, shear), True), "ShearY": (_linear(0, shear), True)}
    space |= {"TranslateX": (x, True), "TranslateY": (y, True), "Rotate": (_linear(0, angle), True)}
    colors: _Space = {name: (_linear(0, color), True) for name in ("Brightness", "Color", "Contrast", "Sharpness")}
    levels: _Space = {"Posterize": (_posterize(*bits), False), "Solarize": (_linear(1, 0), False)}
    levels |= {"AutoContrast": (_none, False), "Equalize": (_none, False)}
    if further == "last":  # the order of AugMix, which may leave them out
        return space | levels | colors
    return space | colors | levels | ({"Invert": (_none, False)} if further == "Invert" else {})


def _share_of(side: str, share: float) -> _Magnitudes:
    @functools.lru_cache(64)
    def magnitudes(bins: int, height: int, width: int) -> list[float]:
        most = share * (width if side == "x" else height)
        values: list[float] = torch.linspace(0, most, bins, device="cpu").tolist()
        return values

    return magnitudes


_ROWS: dict[str, Callable[[float], dict[str, Any]]] = {
    "ShearX": lambda m: {"shear": [math.degrees(math.atan(m)), 0.0], "center": [0, 0]},
    "ShearY": lambda m: {"shear": [0.0, math.degrees(math.atan(m))], "center": [0, 0]},
    "TranslateX": lambda m: {"translate": [int(m), 0]},
    "TranslateY": lambda m: {"translate": [0, int(m)]},
}
_COLORS = {
    "Brightness": F.adjust_brightness,
    "Color": F.adjust_saturation,
    "Contrast": F.adjust_contrast,
    "Sharpness": F.adjust_sharpness,
}
_PLAIN = {"AutoContrast": F.autocontrast, "Equalize": F.equalize, "Invert": F.invert}


class _Policy(Transform):
    draws = True
    kinds = frozenset({"tensor", "image", "video", "pil"})
    refused = frozenset({"boxes", "mask", "points"})
    space: ClassVar[_Space] = _space(
        0.3, _share_of("x", 150 / 331), _share_of("y", 150 / 331), 30, 0.9, (8, 4), "Identity"
    )

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        super().check_inputs(flat_inputs)
        if (images := sum(self._needed(flat_inputs))) != 1:
            raise TypeError(f"{type(self).__name__}: expected one image or video in the sample, got {images}")

    def _drawn_magnitude(self, name: str, bins: int, index: int | None, size: tuple[int, int]) -> float:
        """The magnitude of an operation at an index, None for a random one, with its sign."""
        of_bins, signed = self.space[name]
        magnitudes = of_bins(bins, *size)
        if magnitudes is None:
            return 0.0
        number = float(magnitudes[draw.integer(0, bins) if index is None else index])
        return -number if signed and draw.unit() <= 0.5 else number

    def _choose(self, space: _Space) -> str:
        return tuple(space)[draw.integer(0, len(space))]

    def _operate(self, x: Any, name: str, magnitude: float) -> Any:
        fill = fill_of(self.fill, x)
        if name in _ROWS:
            options: dict[str, Any] = {
                "angle": 0.0,
                "translate": [0, 0],
                "scale": 1.0,
                "shear": [0.0, 0.0],
                **_ROWS[name](magnitude),
            }
            return self._call_kernel(F.affine, x, **options, interpolation=self.interpolation, fill=fill)
        if name == "Rotate":
            return self._call_kernel(F.rotate, x, magnitude, interpolation=self.interpolation, fill=fill)
        if name in _COLORS:
            return self._call_kernel(_COLORS[name], x, 1.0 + magnitude)
        if name == "Posterize":
            return self._call_kernel(F.posterize, x, int(magnitude))
        if name == "Solarize":
            return self._call_kernel(F.solarize, x, (largest(x.dtype) if isinstance(x, Tensor) else 255.0) * magnitude)
        return self._call_kernel(_PLAIN[name], x) if name in _PLAIN else x


_OPERATIONS = {"shear_x": "ShearX", "shear_y": "ShearY", "translate_x": "TranslateX", "translate_y": "TranslateY"}
_OPERATIONS |= {"auto_contrast": "AutoContrast"}


class AutoAugment(_Policy):
    """Apply one of 25 pairs of operations that were found for a data set.

    Args:
        policy: the data set.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.AutoAugment()(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    policy: AutoAugmentPolicy = AutoAugmentPolicy.IMAGENET
    interpolation: Interpolation = "nearest"
    fill: Fill = None

    space = _space(0.3, _share_of("x", 150 / 331), _share_of("y", 150 / 331), 30, 0.9, (8, 4), "Invert")

    def __post_init__(self) -> None:
        from kvision.augmentation.auto.policies import AUTO_POLICIES, parse_policy

        super().__post_init__()
        rows = parse_policy(AUTO_POLICIES[AutoAugmentPolicy(getattr(self.policy, "value", self.policy)).value])
        self._entries = [[(_OPERATIONS.get(n, n.title()), p, level) for n, p, level in row] for row in rows]

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        size = size_of([inpt])
        for name, p, level in self._entries[draw.integer(0, len(self._entries))]:
            if draw.unit() <= p:
                inpt = self._operate(inpt, name, self._drawn_magnitude(name, 10, level, size))
        return inpt


class RandAugment(_Policy):
    """Apply some random operations, all of one magnitude.

    Args:
        num_ops: how many.
        magnitude: index of the magnitude.
        num_magnitude_bins: how many magnitudes there are.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.RandAugment()(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    num_ops: int = 2
    magnitude: int = 9
    num_magnitude_bins: int = 31
    interpolation: Interpolation = "nearest"
    fill: Fill = None

    checks = {"num_ops": lambda op, name, value: _check.ints(op, name, value, 1, 0)[0]}

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        for _ in range(self.num_ops):
            name = self._choose(self.space)
            size = size_of([inpt])
            inpt = self._operate(inpt, name, self._drawn_magnitude(name, self.num_magnitude_bins, self.magnitude, size))
        return inpt


class TrivialAugmentWide(_Policy):
    """Apply one random operation of a random magnitude.

    Args:
        num_magnitude_bins: how many magnitudes there are.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.TrivialAugmentWide()(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    num_magnitude_bins: int = 31
    interpolation: Interpolation = "nearest"
    fill: Fill = None

    space = _space(0.99, _linear(0, 32), _linear(0, 32), 135, 0.99, (8, 6), "Identity")

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        name = self._choose(self.space)
        return self._operate(inpt, name, self._drawn_magnitude(name, self.num_magnitude_bins, None, size_of([inpt])))


class AugMix(_Policy):
    """Mix the image with chains of random operations of it.

    Args:
        severity: how many magnitudes to choose from, 1 to 10.
        mixture_width: how many chains.
        chain_depth: their length, -1 for a random one of 1 to 3.
        alpha: parameter of the Dirichlet distributions of the shares.
        all_ops: brightness, color, contrast and sharpness, too.
        interpolation: 'nearest' or 'bilinear', also as InterpolationMode or PIL's integer.
        fill: color of new pixels: a number, one of each channel, or a dict of them by class of input, with "others"
            for the rest.

    Example:
        >>> import torch
        >>> from kvision import tv
        >>> tv.AugMix()(torch.zeros(3, 8, 6, dtype=torch.uint8)).shape
        torch.Size([3, 8, 6])
    """

    severity: int = 3
    mixture_width: int = 3
    chain_depth: int = -1
    alpha: float = 1.0
    all_ops: bool = True
    interpolation: Interpolation = "bilinear"
    fill: Fill = None

    space = _space(0.3, _share_of("x", 1 / 3), _share_of("y", 1 / 3), 30, 0.9, (4, 4), "last")
    bins = 10
    checks = {"severity": lambda op, name, value: _check.ints(op, name, value, 1, 1, 10)[0]}
    _applies_functions = False

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        image = pil_to_tensor(inpt) if kind_of(inpt) == "pil" else plain(inpt)
        space = self.space if self.all_ops else {n: self.space[n] for n in self.space if n not in _COLORS}
        samples = image.shape[0] if image.dim() > (4 if kind_of(inpt) == "video" else 3) else 1
        weights = (samples, *(1,) * (image.dim() - 1)) if samples > 1 else ()

        def dirichlet(count: int) -> Tensor:
            return sample_dirichlet(torch.full((count,), float(self.alpha), device="cpu").expand(samples, -1)).to(
                image.device
            )

        kept, mixed = dirichlet(2).unbind(1)
        shares = dirichlet(self.mixture_width) * mixed[:, None]
        mix = kept.reshape(weights) * image
        for i in range(self.mixture_width):
            chain = image
            for _ in range(self.chain_depth if self.chain_depth > 0 else draw.integer(1, 4)):
                name = self._choose(space)
                index = None if space[name][0] is _none else draw.integer(0, self.severity)
                chain = self._operate(chain, name, self._drawn_magnitude(name, self.bins, index, size_of([image])))
            mix += shares[:, i].reshape(weights) * chain
        mix = mix.to(image.dtype)
        return to_pil_image(mix, inpt.mode) if kind_of(inpt) == "pil" else wrap(mix, inpt)
