"""Operations of policies with learned magnitudes and probabilities, as Faster AutoAugment trains them.

Source: Hataya, Zdenek, Yoshizoe and Nakayama, Faster AutoAugment: learning augmentation strategies using backpropagation,
ECCV 2020.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

import kvision.augmentation as A
from kvision.augmentation.auto.operation_base import OperationBase
from kvision.augmentation.engine import (
    AugmentationBase2D,
    ImageSequential,
)
from kvision.core.exceptions import ValueCheckError

__all__ = [
    "AutoContrast",
    "Brightness",
    "Contrast",
    "Equalize",
    "Gray",
    "HorizontalFlip",
    "Hue",
    "Invert",
    "OperationBase",
    "PolicySequential",
    "Posterize",
    "Rotate",
    "Saturate",
    "Sharpness",
    "ShearX",
    "ShearY",
    "Solarize",
    "SolarizeAdd",
    "TranslateX",
    "TranslateY",
    "VerticalFlip",
]


class PolicySequential(ImageSequential):
    """A sub-policy: operations one after the other.

    Args:
        *operations: operations.

    Raises:
        ValueError: one is no operation.

    Example:
        >>> import torch, kvision as K
        >>> O = K.augmentation.auto.operations
        >>> policy = O.PolicySequential(O.Brightness(), O.Rotate())
        >>> policy(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, *operations: OperationBase) -> None:
        for operation in operations:
            if not isinstance(operation, OperationBase):
                raise ValueCheckError(f"PolicySequential: expected operations, got {type(operation).__name__}")
        super().__init__(*operations)


class _MagnitudeOperation(OperationBase):
    """An operation whose magnitude is a parameter of an augmentation."""

    def __init__(
        self,
        operation: AugmentationBase2D,
        parameter: str,
        initial_magnitude: float | None,
        magnitude_range: tuple[float, float],
        temperature: float,
        symmetric_megnitude: bool,
    ) -> None:
        self.magnitude_range = magnitude_range
        initial = [(parameter, initial_magnitude)]
        super().__init__(operation, initial, temperature, symmetric_megnitude=symmetric_megnitude)


class AutoContrast(OperationBase):
    """Stretch the values of images to 0 and 1.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.AutoContrast()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self, initial_probability: float = 0.5, temperature: float = 0.1, symmetric_megnitude: bool = False
    ) -> None:
        super().__init__(
            A.RandomAutoContrast(p=initial_probability), None, temperature, symmetric_megnitude=symmetric_megnitude
        )


class Brightness(_MagnitudeOperation):
    """Change the brightness of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: factors as `RandomBrightness` takes them.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Brightness()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.5,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.2, 1.8),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomBrightness(magnitude_range, p=initial_probability)
        super().__init__(
            operation, "brightness_factor", initial_magnitude, magnitude_range, temperature, symmetric_megnitude
        )


class Contrast(_MagnitudeOperation):
    """Change the contrast of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: factors as `RandomContrast` takes them.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Contrast()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.5,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.2, 1.8),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomContrast(magnitude_range, p=initial_probability)
        super().__init__(
            operation, "contrast_factor", initial_magnitude, magnitude_range, temperature, symmetric_megnitude
        )


class Equalize(OperationBase):
    """Equalize the histograms of images.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Equalize()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, initial_probability: float = 0.5, temperature: float = 0.1) -> None:
        super().__init__(A.RandomEqualize(p=initial_probability), None, temperature)


class Gray(OperationBase):
    """Make images gray.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Gray()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, initial_probability: float = 0.5, temperature: float = 0.1) -> None:
        super().__init__(A.RandomGrayscale(p=initial_probability), None, temperature)


class HorizontalFlip(OperationBase):
    """Flip images from left to right.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.HorizontalFlip()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, initial_probability: float = 0.5, temperature: float = 0.1) -> None:
        super().__init__(A.RandomHorizontalFlip(p=initial_probability), None, temperature)


class Hue(_MagnitudeOperation):
    """Rotate the hue of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: turns.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Hue()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.0,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (-0.5, 0.5),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomHue(magnitude_range, p=initial_probability)
        super().__init__(operation, "hue_factor", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class Invert(OperationBase):
    """Invert images.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Invert()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, initial_probability: float = 0.5, temperature: float = 0.1) -> None:
        super().__init__(A.RandomInvert(p=initial_probability), None, temperature)


class Posterize(_MagnitudeOperation):
    """Keep the high bits of the levels of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: bits.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Posterize()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 4.0,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (1.0, 8.0),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomPosterize(magnitude_range, p=initial_probability)
        super().__init__(operation, "bits_factor", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class Rotate(_MagnitudeOperation):
    """Rotate images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: degrees, counter-clockwise.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Rotate()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 15.0,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 30.0),
        temperature: float = 0.1,
        symmetric_megnitude: bool = True,
    ) -> None:
        operation = A.RandomRotation(magnitude_range, p=initial_probability)
        super().__init__(operation, "degrees", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class Saturate(_MagnitudeOperation):
    """Change the saturation of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: factors as `RandomSaturation` takes them.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Saturate()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.5,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.2, 1.8),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomSaturation(magnitude_range, p=initial_probability)
        super().__init__(
            operation, "saturation_factor", initial_magnitude, magnitude_range, temperature, symmetric_megnitude
        )


class Sharpness(_MagnitudeOperation):
    """Change the sharpness of images.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: factors as `RandomSharpness` takes them.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Sharpness()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.5,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.1, 1.9),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomSharpness(magnitude_range, p=initial_probability)
        super().__init__(operation, "sharpness", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class ShearX(_MagnitudeOperation):
    """Shear images along x.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: fractions of half a turn.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.ShearX()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    scale = 180.0  # degrees

    def __init__(
        self,
        initial_magnitude: float | None = 0.1,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 0.3),
        temperature: float = 0.1,
        symmetric_megnitude: bool = True,
    ) -> None:
        operation = A.RandomShear((0.0, 0.0), p=initial_probability)
        super().__init__(operation, "shear_x", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class ShearY(_MagnitudeOperation):
    """Shear images along y.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: fractions of half a turn.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.ShearY()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    scale = 180.0  # degrees

    def __init__(
        self,
        initial_magnitude: float | None = 0.1,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 0.3),
        temperature: float = 0.1,
        symmetric_megnitude: bool = True,
    ) -> None:
        operation = A.RandomShear((0.0, 0.0, 0.0, 0.0), p=initial_probability)
        super().__init__(operation, "shear_y", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class Solarize(_MagnitudeOperation):
    """Invert values from a threshold on.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: thresholds.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.Solarize()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.5,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 1.0),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomSolarize(magnitude_range, (0.0, 0.0), p=initial_probability)
        super().__init__(operation, "thresholds", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class SolarizeAdd(_MagnitudeOperation):
    """Add a number to images, and invert the values from 0.5 on.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: numbers.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.SolarizeAdd()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.0,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (-0.3, 0.3),
        temperature: float = 0.1,
        symmetric_megnitude: bool = False,
    ) -> None:
        operation = A.RandomSolarize((0.5, 0.5), magnitude_range, p=initial_probability)
        super().__init__(operation, "additions", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)


class TranslateX(_MagnitudeOperation):
    """Shift images along x.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: fractions of the width.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.TranslateX()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.2,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 0.5),
        temperature: float = 0.1,
        symmetric_megnitude: bool = True,
    ) -> None:
        operation = A.RandomTranslate((0.0, 0.0), (0.0, 0.0), p=initial_probability)
        super().__init__(operation, "translate_x", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)

    def _value(self, value: Tensor, drawn: Tensor, shape: Sequence[int]) -> Tensor:
        return value * shape[-1]


class TranslateY(_MagnitudeOperation):
    """Shift images along y.

    Args:
        initial_magnitude: its first value; None for the middle of the range.
        initial_probability: first probability that a sample is augmented.
        magnitude_range: lowest and highest magnitude: fractions of the height.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.TranslateY()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        initial_magnitude: float | None = 0.2,
        initial_probability: float = 0.5,
        magnitude_range: tuple[float, float] = (0.0, 0.5),
        temperature: float = 0.1,
        symmetric_megnitude: bool = True,
    ) -> None:
        operation = A.RandomTranslate((0.0, 0.0), (0.0, 0.0), p=initial_probability)
        super().__init__(operation, "translate_y", initial_magnitude, magnitude_range, temperature, symmetric_megnitude)

    def _value(self, value: Tensor, drawn: Tensor, shape: Sequence[int]) -> Tensor:
        return value * shape[-2]


class VerticalFlip(OperationBase):
    """Flip images upside down.

    Args:
        initial_probability: first probability that a sample is augmented.
        temperature: of the relaxed Bernoulli distribution, which gives the probability a gradient.

    Raises:
        ValueError: `temperature` is not above 0; a range or a probability out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.auto.operations.VerticalFlip()(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(self, initial_probability: float = 0.5, temperature: float = 0.1) -> None:
        super().__init__(A.RandomVerticalFlip(p=initial_probability), None, temperature)
