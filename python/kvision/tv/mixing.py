"""v2's mixes of the samples of a batch, and policies."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from kvision import _check
from kvision._torch_compat import sample_dirichlet
from kvision._tv_tensors import kind_of, plain, wrap
from kvision.tv import draw
from kvision.tv import functional as F
from kvision.tv.functional.values import largest
from kvision.tv.geometry import Fill, Interpolation
from kvision.tv.inputs import IMAGES, LABELS, pil_to_tensor, to_pil_image
from kvision.tv.transform import Call, Transform, flatten, size_of, unflatten
from kvision.tv.values import labels_in

__all__ = ["AugMix", "AutoAugment", "AutoAugmentPolicy", "CutMix", "MixUp", "RandAugment", "TrivialAugmentWide"]


class _Mix(Transform, kw_only=True, kinds=IMAGES - {"pil"}):
    alpha: float = 1.0
    num_classes: int | None = None
    labels_getter: Any = "default"

    mixes_samples = True

    def _share(self) -> float:
        """A draw of the Beta distribution."""
        alpha = torch.tensor([float(self.alpha)], device="cpu")
        return float(torch.distributions.Beta(alpha, alpha).sample(()))

    def forward(self, *inputs: Any) -> Any:
        (flat, spec), name = flatten(inputs), type(self).__name__
        needed = self._needed(flat)
        if any(kind_of(x) in ("pil", "boxes", "mask", "points") for x in flat):
            raise ValueError(f"{name}: expected a sample without PIL images, boxes, masks and key points")
        labels = labels_in(inputs if len(inputs) > 1 else inputs[0], self.labels_getter)
        if not isinstance(labels, Tensor) or labels.dim() not in (1, 2):
            raise ValueError(f"{name}: expected labels (B,) or (B, classes), got {labels!r}")
        classes = self.num_classes if labels.dim() == 1 else labels.shape[1]
        if classes is None or self.num_classes not in (None, classes):
            raise ValueError(f"{name}: expected num_classes of labels {tuple(labels.shape)}, got {self.num_classes}")
        images = [x for x, is_needed in zip(flat, needed) if is_needed and x is not labels]
        for x in images:
            axes = 5 if kind_of(x) == "video" else 4
            if x.dim() != axes or x.shape[0] != labels.shape[0]:
                raise ValueError(f"{name}: expected {labels.shape[0]} images of {axes} axes, got {tuple(x.shape)}")
        params = self.make_params(images)
        outputs: list[Any] = []
        for x, is_needed in zip(flat, needed):
            if x is labels:
                shares = torch.nn.functional.one_hot(x, classes) if x.dim() == 1 else x
                outputs.append(_Mix._mixed(self, shares if x.is_floating_point() else shares.float(), params))
            else:
                outputs.append(wrap(self._mixed(plain(x), params), x) if is_needed else x)
        return unflatten(outputs, spec)

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {"share": self._share()}

    def _mixed(self, x: Tensor, params: dict[str, Any]) -> Tensor:
        return x.roll(1, 0).mul_(1 - params["share"]).add_(x, alpha=params["share"])


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
        output[..., top:bottom, left:right] = x[..., top:bottom, left:right].roll(1, 0)
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


Operation = tuple[str, float]  # a name and a magnitude


class _Range(NamedTuple):
    """The magnitudes of an operation: from one number to another, of which some have a random sign."""

    first: float
    last: float
    signed: bool = False
    of: int | None = None  # the axis of whose size they are fractions
    is_whole: bool = False


def _magnitudes(first: float, last: float, bins: int, is_whole: bool) -> list[float]:
    if is_whole:
        return [float(round(first - i / ((bins - 1) / (first - last)))) for i in range(bins)]
    numbers: list[float] = torch.linspace(first, last, bins, device="cpu").tolist()
    return numbers


_MOVES = "ShearX", "ShearY", "TranslateX", "TranslateY", "Rotate"
_COLORS = "Brightness", "Color", "Contrast", "Sharpness"
_LEVELS = "Posterize", "Solarize", "AutoContrast", "Equalize"
_USUAL = "Identity", *_MOVES, *_COLORS, *_LEVELS


def _space(
    names: Sequence[str], shear: float, shift: float, angle: float, color: float, bits: Sequence[int], by: str = "size"
) -> Mapping[str, _Range | None]:
    """The operations with their magnitudes, None for those that have none; the order is that of the draws."""
    ranges = dict.fromkeys(("ShearX", "ShearY"), _Range(0, shear, True))
    for axis, name in enumerate(("TranslateY", "TranslateX")):
        ranges[name] = _Range(0, shift, True, axis if by == "size" else None)
    ranges |= {"Rotate": _Range(0, angle, True), **dict.fromkeys(_COLORS, _Range(0, color, True))}
    ranges |= {"Posterize": _Range(bits[0], bits[1], is_whole=True), "Solarize": _Range(1, 0)}
    return {name: ranges.get(name) for name in names}


def _warp(**arguments: Any) -> Call:
    return F.affine, {"angle": 0.0, "translate": [0, 0], "scale": 1.0, "shear": [0.0, 0.0], **arguments}


_OPERATIONS: dict[str, Callable[[float], Call]] = {
    "ShearX": lambda m: _warp(shear=[math.degrees(math.atan(m)), 0.0], center=[0, 0]),
    "ShearY": lambda m: _warp(shear=[0.0, math.degrees(math.atan(m))], center=[0, 0]),
    "TranslateX": lambda m: _warp(translate=[int(m), 0]),
    "TranslateY": lambda m: _warp(translate=[0, int(m)]),
    "Rotate": lambda m: _warp(angle=-m),
    "Brightness": lambda m: (F.adjust_brightness, {"brightness_factor": 1.0 + m}),
    "Color": lambda m: (F.adjust_saturation, {"saturation_factor": 1.0 + m}),
    "Contrast": lambda m: (F.adjust_contrast, {"contrast_factor": 1.0 + m}),
    "Sharpness": lambda m: (F.adjust_sharpness, {"sharpness_factor": 1.0 + m}),
    "Posterize": lambda m: (F.posterize, {"bits": int(m)}),
    "Solarize": lambda m: (F.solarize, {"threshold": m}),
    "AutoContrast": lambda _: (F.autocontrast, {}),
    "Equalize": lambda _: (F.equalize, {}),
    "Invert": lambda _: (F.invert, {}),
}


class _Policy(Transform, function=F.affine, kinds=IMAGES, refused=LABELS | {"mask"}, draws=True):
    space: ClassVar[Mapping[str, _Range | None]] = _space(_USUAL, 0.3, 150 / 331, 30, 0.9, (8, 4))

    def check_inputs(self, flat_inputs: list[Any]) -> None:
        super().check_inputs(flat_inputs)
        if (images := sum(self._needed(flat_inputs))) != 1:
            raise TypeError(f"{type(self).__name__}: expected one image or video in the sample, got {images}")

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        white = largest(flat_inputs[0].dtype) if isinstance(flat_inputs[0], Tensor) else 255.0
        return {"operations": self._operations(size_of(flat_inputs)), "white": white}

    def _operations(self, size: tuple[int, int]) -> list[Operation]:
        """Names of operations and their magnitudes."""
        raise NotImplementedError

    def _operation(self, size: tuple[int, int], bins: int, index: int | None = None, name: str = "") -> Operation:
        """An operation and its magnitude with its sign; a random one without a name, of a random index without one."""
        name = name or tuple(self.space)[draw.integer(0, len(self.space))]
        magnitudes, is_signed = self._table(size, bins)[name]
        if not magnitudes:
            return name, 0.0
        number = magnitudes[draw.integer(0, bins) if index is None else index]
        return name, -number if is_signed and draw.unit() <= 0.5 else number

    @classmethod
    @functools.lru_cache(64)
    def _table(cls, size: tuple[int, int], bins: int) -> dict[str, tuple[list[float], bool]]:
        """The magnitudes of each operation for images of a size, and whether their sign is random."""
        table: dict[str, tuple[list[float], bool]] = dict.fromkeys(cls.space, ([], False))
        for name, numbers in cls.space.items():
            if numbers is not None:
                last = numbers.last if numbers.of is None else numbers.last * size[numbers.of]
                table[name] = _magnitudes(numbers.first, last, bins, numbers.is_whole), numbers.signed
        return table

    def _calls(self, options: dict[str, Any], params: dict[str, Any]) -> list[Call]:
        calls = []
        for name, magnitude in params["operations"]:
            if name in _OPERATIONS:
                function, own = _OPERATIONS[name](magnitude * params["white"] if name == "Solarize" else magnitude)
                calls.append((function, {**own, **options} if function is F.affine else own))
        return calls


_NAMES = {name.lower(): name for name in _OPERATIONS}  # by those of kvision.augmentation without "_"


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

    space = _space((*_MOVES, *_COLORS, *_LEVELS, "Invert"), 0.3, 150 / 331, 30, 0.9, (8, 4))

    def __post_init__(self) -> None:
        from kvision.augmentation.auto.policies import AUTO_POLICIES, parse_policy

        super().__post_init__()
        rows = parse_policy(AUTO_POLICIES[AutoAugmentPolicy(getattr(self.policy, "value", self.policy)).value])
        self._entries = [[(_NAMES[n.replace("_", "")], p, level) for n, p, level in row] for row in rows]

    def _operations(self, size: tuple[int, int]) -> list[Operation]:
        entry = self._entries[draw.integer(0, len(self._entries))]
        return [self._operation(size, 10, level, name) for name, p, level in entry if draw.unit() <= p]


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

    def _operations(self, size: tuple[int, int]) -> list[Operation]:
        return [self._operation(size, self.num_magnitude_bins, self.magnitude) for _ in range(self.num_ops)]


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

    space = _space(_USUAL, 0.99, 32, 135, 0.99, (8, 2), by="pixels")

    def _operations(self, size: tuple[int, int]) -> list[Operation]:
        return [self._operation(size, self.num_magnitude_bins)]


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

    space = _space((*_MOVES, *_LEVELS, *_COLORS), 0.3, 1 / 3, 30, 0.9, (4, 0))
    checks = {"severity": lambda op, name, value: _check.ints(op, name, value, 1, 1, 10)[0]}
    _applies_functions = False

    def make_params(self, flat_inputs: list[Any]) -> dict[str, Any]:
        return {}

    def _operations(self, size: tuple[int, int]) -> list[Operation]:
        names = [name for name in self.space if self.all_ops or name not in _COLORS]
        chain = []
        for _ in range(self.chain_depth if self.chain_depth > 0 else draw.integer(1, 4)):
            name = names[draw.integer(0, len(names))]
            index = None if self.space[name] is None else draw.integer(0, self.severity)
            chain.append(self._operation(size, 10, index, name))
        return chain

    def transform(self, inpt: Any, params: dict[str, Any]) -> Any:
        image, options = pil_to_tensor(inpt) if kind_of(inpt) == "pil" else plain(inpt), self._options_for(inpt)
        samples = image.shape[0] if image.dim() > (4 if kind_of(inpt) == "video" else 3) else 1
        weights = (samples, *(1,) * (image.dim() - 1)) if samples > 1 else ()

        def dirichlet(count: int) -> Tensor:
            alpha = torch.full((count,), float(self.alpha), device="cpu")
            return sample_dirichlet(alpha.expand(samples, -1)).to(image.device)

        kept, mixed = dirichlet(2).unbind(1)
        shares = dirichlet(self.mixture_width) * mixed[:, None]
        mix = kept.reshape(weights) * image
        for share in shares.unbind(1):
            chain = image
            for function, arguments in self._calls(options, super().make_params([image])):
                chain = function(chain, **arguments)
            mix += share.reshape(weights) * chain
        mix = mix.to(image.dtype)
        return to_pil_image(mix, inpt.mode) if kind_of(inpt) == "pil" else wrap(mix, inpt)
