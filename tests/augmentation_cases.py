"""Augmentations with the arguments that the tests of all classes call them with."""

from __future__ import annotations

from typing import Any, NamedTuple

import kvision.augmentation as A


class Case(NamedTuple):
    """A class, its arguments, and what a test has to know of it."""

    name: str
    args: tuple[Any, ...] = ()
    kwargs: dict[str, Any] = {}
    fixed: bool = False  # draws nothing
    changes_size: bool = False
    any_channels: bool = True
    gradient: bool = True  # differentiable at random images, with respect to them
    one_kernel: bool = False  # a parameter is shared by the samples of a batch
    all_or_none: bool = False  # p is that of a batch

    def make(self, **kwargs: Any) -> Any:
        if self.name == "PadTo":
            kwargs.pop("p", None)  # it has no probability
        return getattr(A, self.name)(*self.args, **{**self.kwargs, **kwargs})


GEOMETRIC = [
    Case("RandomAffine", (30.0, (0.1, 0.2), (0.8, 1.2), 10.0)),
    Case("RandomHorizontalFlip"),
    Case("RandomVerticalFlip"),
    Case("RandomPerspective", (0.5,)),
    Case("RandomRotation", (30.0,)),
    Case("RandomRotation90", ((-1, 3),)),
    Case("RandomShear", ((-10.0, 20.0, -5.0, 5.0),)),
    Case("RandomTranslate", ((-0.1, 0.2), (0.0, 0.2))),
    Case("CenterCrop", ((9, 11),), fixed=True, changes_size=True),
    Case("LongestMaxSize", (14,), fixed=True, changes_size=True),
    Case("PadTo", ((24, 26),), fixed=True, changes_size=True),
    Case("RandomCrop", ((9, 11),), {"padding": 2}, changes_size=True),
    Case("RandomResizedCrop", ((9, 11),), changes_size=True),
    Case("Resize", ((9, 11),), fixed=True, changes_size=True),
    Case("SmallestMaxSize", (9,), fixed=True, changes_size=True),
]
RANGES = (-0.2, 0.2), (-0.2, 0.2), (0.9, 1.1)
MAPS = [
    Case("RandomElasticTransform", ((9, 9), (3.0, 3.0), (0.5, 0.5))),
    Case("RandomFisheye", RANGES),
    Case("RandomThinPlateSpline", (0.2,)),
]
INTENSITY = [
    Case("ColorJiggle", (0.2, 0.2, 0.2, 0.2)),
    Case("ColorJitter", (0.2, 0.2, 0.2, 0.2)),
    Case("Denormalize", ([0.5, 0.4, 0.3], [0.2, 0.3, 0.4]), fixed=True, any_channels=False, all_or_none=True),
    Case("Normalize", ([0.5, 0.4, 0.3], [0.2, 0.3, 0.4]), fixed=True, any_channels=False, all_or_none=True),
    Case("RandomAutoContrast", fixed=True),
    Case("RandomBoxBlur", fixed=True),
    Case("RandomBrightness", ((0.5, 1.5),)),
    Case("RandomChannelDropout"),
    Case("RandomChannelShuffle"),
    Case("RandomClahe", ((1.0, 40.0), (2, 2)), gradient=False),
    Case("RandomContrast", ((0.5, 1.5),)),
    Case("RandomEqualize", fixed=True, gradient=False),
    Case("RandomGamma", ((0.5, 1.5), (0.8, 1.0))),
    Case("RandomGaussianBlur", ((3, 5), (0.5, 2.0))),
    Case("RandomGrayscale", fixed=True),
    Case("RandomHue", ((-0.3, 0.3),)),
    Case("RandomInvert", fixed=True),
    Case("RandomJPEG", ((20.0, 60.0),), any_channels=False),
    Case("RandomMedianBlur", fixed=True),
    Case("RandomMotionBlur", ((3, 7), 35.0, 0.5), one_kernel=True),
    Case("RandomPlanckianJitter", any_channels=False),
    Case("RandomPosterize", (3,), gradient=False),
    Case("RandomRGBShift", any_channels=False),
    Case("RandomSaturation", ((0.5, 1.5),)),
    Case("RandomSharpness", ((0.2, 1.8),)),
    Case("RandomSolarize", (0.1, 0.1)),
    Case("RandomErasing"),
    Case("RandomGaussianIllumination"),
    Case("RandomGaussianNoise", (0.1, 0.2)),
    Case("RandomLinearCornerIllumination"),
    Case("RandomLinearIllumination"),
    Case("RandomSaltAndPepperNoise", ((0.1, 0.4),)),
    Case("RandomPlasmaBrightness", ((0.1, 0.7), (0.1, 0.2))),
    Case("RandomPlasmaContrast", gradient=False),
    Case("RandomPlasmaShadow", gradient=False),
    Case("RandomRain", ((10, 20), (3, 6), (-3, 3))),
    Case("RandomSnow", ((0.3, 0.7), (1.0, 2.0)), any_channels=False, gradient=False),
]
CASES = [*GEOMETRIC, *MAPS, *INTENSITY]
