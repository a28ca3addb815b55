"""Calls of the augmentations: the arguments that make each class, and what a test of all classes has to know of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

import kvision.augmentation as A
from benchmarks.sample_calls.model import Axes, SampleCall, made, rand
from benchmarks.sample_calls.tensors import IMAGE, LABELS, VOLUME


@dataclass(frozen=True)
class Augmentation:
    """A class and its arguments for small images: of 16 x 20 pixels, volumes of 6 x 7 x 8."""

    name: str
    args: tuple[Any, ...] = ()
    kwargs: dict[str, Any] = field(default_factory=dict)
    large: tuple[Any, ...] | None = None  # the arguments for images of at least 256 x 256 pixels, where they are others
    fixed: bool = False  # draws nothing, when all samples are chosen
    changes_size: bool = False
    any_channels: bool = True
    gradient: bool = True  # differentiable at random images, with respect to them
    one_kernel: bool = False  # a parameter is shared by the samples of a batch
    all_or_none: bool = False  # p is that of a batch
    warps: bool = False  # interpolates
    composed: bool = (
        False  # of operations of torch and of operators alone, so that a few stand for all where tests are slow
    )

    def make(self, **kwargs: Any) -> Any:
        if self.name == "PadTo":
            kwargs.pop("p", None)  # it has no probability
        return getattr(A, self.name)(*self.args, **{**self.kwargs, **kwargs})


COLOR = dict(any_channels=False)
SIZED = dict(fixed=True, changes_size=True)
COMPOSED = dict(composed=True)
STATISTICS = [0.5, 0.4, 0.3], [0.2, 0.3, 0.4]
GEOMETRIC = [
    Augmentation("RandomAffine", (30.0, (0.1, 0.2), (0.8, 1.2), 10.0)),
    Augmentation("RandomHorizontalFlip"),
    Augmentation("RandomVerticalFlip"),
    Augmentation("RandomPerspective", (0.5,)),
    Augmentation("RandomRotation", (30.0,)),
    Augmentation("RandomRotation90", ((-1, 3),)),
    Augmentation("RandomShear", ((-10.0, 20.0, -5.0, 5.0),)),
    Augmentation("RandomTranslate", ((-0.1, 0.2), (0.0, 0.2))),
    Augmentation("AtLeastOneBBoxRandomCrop", (7, 8), large=(96, 110), changes_size=True),
    Augmentation("CenterCrop", ((9, 11),), large=((96, 110),), **SIZED),
    Augmentation("CropNonEmptyMaskIfExists", (7, 8), large=(96, 110), changes_size=True),
    Augmentation("LongestMaxSize", (14,), large=(140,), **SIZED),
    Augmentation("D4"),
    Augmentation("Pad", ((2, 0, -1, 3),), large=((10, 20, 30, 40),), **SIZED),
    Augmentation("PadIfNeeded", (24, None, None, 32), {"position": "random"}, changes_size=True),
    Augmentation("PadTo", ((24, 26),), large=((400, 520),), **SIZED),
    Augmentation("RandomCrop", ((9, 11),), {"padding": 2}, large=((96, 110),), changes_size=True),
    Augmentation("RandomCropNearBBox", ((0.2, 0.3),), fixed=True),
    Augmentation("RandomIoUCrop", fixed=True),
    Augmentation("RandomSizedBBoxSafeCrop", (9, 11, 0.2), large=(96, 110, 0.2), changes_size=True),
    Augmentation("RandomZoomOut"),
    Augmentation("RandomScale", ((0.6, 0.9),), changes_size=True, one_kernel=True, all_or_none=True),
    Augmentation("RandomResizedCrop", ((9, 11),), large=((96, 110),), changes_size=True),
    Augmentation("Resize", ((9, 11),), large=((96, 110),), **SIZED),
    Augmentation("SmallestMaxSize", (9,), large=(90,), **SIZED),
    Augmentation("Transpose", (), {"p": 1.0}, **SIZED),
]
MAPS = [
    Augmentation("RandomElasticTransform", ((9, 9), (3.0, 3.0), (0.5, 0.5)), large=((31, 31), (8.0, 8.0))),
    Augmentation("RandomFisheye", tuple(map(torch.tensor, ((-0.2, 0.2), (-0.2, 0.2), (0.9, 1.1))))),
    Augmentation("RandomThinPlateSpline", (0.2,)),
]
INTENSITY = [
    Augmentation("ColorJiggle", (0.2, 0.2, 0.2, 0.2)),
    Augmentation("ColorJitter", (0.2, 0.2, 0.2, 0.2)),
    Augmentation("Denormalize", STATISTICS, fixed=True, all_or_none=True, **COLOR),
    Augmentation("Normalize", STATISTICS, fixed=True, all_or_none=True, **COLOR),
    Augmentation("RandomAutoContrast", fixed=True),
    Augmentation("RandomBoxBlur", fixed=True),
    Augmentation("RandomBrightness", ((0.5, 1.5),)),
    Augmentation("RandomChannelDropout"),
    Augmentation("RandomChannelShuffle"),
    Augmentation("RandomClahe", ((1.0, 40.0), (2, 2)), large=((2.0, 4.0), (4, 4)), gradient=False),
    Augmentation("RandomContrast", ((0.5, 1.5),)),
    Augmentation("RandomEqualize", fixed=True, gradient=False),
    Augmentation("RandomGamma", ((0.5, 1.5), (0.8, 1.0))),
    Augmentation("RandomGaussianBlur", ((3, 5), (0.5, 2.0)), large=((5, 5), (0.5, 2.0))),
    Augmentation("RandomGrayscale", fixed=True),
    Augmentation("RandomHue", ((-0.3, 0.3),)),
    Augmentation("RandomInvert", fixed=True),
    Augmentation("RandomJPEG", ((20.0, 60.0),), **COLOR),
    Augmentation("RandomMedianBlur", fixed=True),
    Augmentation("RandomMotionBlur", ((3, 7), 35.0, 0.5), one_kernel=True),
    Augmentation("RandomPlanckianJitter", **COLOR),
    Augmentation("RandomPosterize", (3,), gradient=False),
    Augmentation("RandomRGBShift", **COLOR),
    Augmentation("RandomSaturation", ((0.5, 1.5),)),
    Augmentation("RandomSharpness", ((0.2, 1.8),)),
    Augmentation("RandomSolarize", (0.1, 0.1)),
    Augmentation("RandomErasing"),
    Augmentation("RandomGaussianIllumination"),
    Augmentation("RandomGaussianNoise", (0.1, 0.2)),
    Augmentation("RandomLinearCornerIllumination"),
    Augmentation("RandomLinearIllumination"),
    Augmentation("RandomSaltAndPepperNoise", ((0.1, 0.4),)),
    Augmentation("RandomPlasmaBrightness", ((0.1, 0.7), (0.1, 0.2))),
    Augmentation("RandomPlasmaContrast", gradient=False),
    Augmentation("RandomPlasmaShadow", gradient=False),
    Augmentation("RandomRain", ((10, 20), (3, 6), (-3, 3))),
    Augmentation("RandomSnow", ((0.3, 0.7), (1.0, 2.0)), gradient=False, **COLOR),
]
OCCLUSION = [
    Augmentation("CoarseDropout", ((2, 5), (2, 5), (0.1, 0.4)), **COMPOSED),
    Augmentation("FrequencyMasking", (9,), **COMPOSED),
    Augmentation("GridDropout", (0.5,), {"unit_size_range": (4, 6)}, **COMPOSED),
    Augmentation("GridMask", ((2, 4), (0.2, 0.5), (-0.5, 0.5)), **COMPOSED),
    Augmentation("MaskDropout", ((1, 2),), fixed=True, **COMPOSED),
    Augmentation("PixelDropout", (0.3,), {"per_channel": True, "drop_value": "random"}, **COMPOSED),
    Augmentation("TimeMasking", (9,), **COMPOSED),
    Augmentation("XYMasking", ((1, 2), (0, 2), (1, 4), (0.1, 0.2)), **COMPOSED),
]
LARGE_FROST = torch.linspace(0, 1, 3).reshape(3, 1, 1).expand(3, 2048, 2048)
CORRUPTION = [
    Augmentation("CommonCorruption", ("gaussian_noise", 3), **COMPOSED),
    Augmentation("Defocus", ((1, 2), (0.1, 0.5)), large=(), **COMPOSED),
    Augmentation("Downscale", ((0.3, 0.9), True), **COMPOSED),
    Augmentation("GlassBlur", (0.4, 2), large=(), **COMPOSED),
    Augmentation("ISONoise", gradient=False, **COLOR, **COMPOSED),
    Augmentation("MultiplicativeNoise", ((0.9, 1.1), True, True), **COMPOSED),
    Augmentation("RandomFog", **COMPOSED),
    Augmentation(
        "RandomFrost",
        (torch.linspace(0, 1, 90).reshape(1, 3, 30, 1).expand(1, 3, 30, 40),),
        large=(LARGE_FROST,),
        **COMPOSED,
    ),
    Augmentation("RingingOvershoot", ((3, 7),), large=(), **COMPOSED),
    Augmentation("ShotNoise", gradient=False, **COMPOSED),
    Augmentation("Spatter", ((0.6, 0.7), (0.3, 0.3), (0.5, 0.7), (0.6, 0.7), (0.3, 0.4)), large=(), **COMPOSED),
    Augmentation("SpeckleNoise", ((0.1, 0.2),), **COMPOSED),
    Augmentation("ZoomBlur", ((1.0, 1.3), (0.05, 0.1)), large=(), **COMPOSED),
]
DISTORTION = [
    Augmentation("ChromaticAberration", ((-0.1, 0.1), (-0.2, 0.2)), **COLOR, **COMPOSED),
    Augmentation("GridDistortion", (3,), large=(), **COMPOSED),
    Augmentation("OpticalDistortion", ((-0.3, 0.3),), **COMPOSED),
    Augmentation("PiecewiseAffine", ((0.1, 0.2), (3, 4), (3, 4)), **COMPOSED),
    Augmentation("Swirl", **COMPOSED),
]
IMAGES = [*GEOMETRIC, *MAPS, *INTENSITY, *OCCLUSION, *CORRUPTION, *DISTORTION]
FLIPS3D = [Augmentation(f"Random{way}Flip3D", fixed=True) for way in ("Horizontal", "Vertical", "Depthical")]
GEOMETRIC3D = [
    Augmentation("RandomAffine3D", (30.0, (0.1, 0.2, 0.1), (0.8, 1.2), 10.0), warps=True),
    Augmentation("RandomRotation3D", ((20.0, 30.0, 40.0),), warps=True),
    Augmentation("RandomPerspective3D", (0.5,), warps=True),
    Augmentation("RandomCrop3D", ((4, 5, 5),), {"padding": 1}, large=((4, 32, 40),), changes_size=True),
    Augmentation("CenterCrop3D", ((4, 5, 5),), large=((4, 32, 40),), **SIZED),
    Augmentation("RandomResizedCrop3D", ((4, 5, 5),), large=((4, 32, 40),), changes_size=True, warps=True),
    Augmentation("Resize3D", ((4, 5, 5),), large=((4, 32, 40),), warps=True, **SIZED),
    *FLIPS3D,
]
VOLUMES = [
    *GEOMETRIC3D,
    Augmentation("RandomEqualize3D", fixed=True, gradient=False),
    Augmentation("RandomMotionBlur3D", ((3, 5), (10.0, 20.0, 30.0), 0.5), one_kernel=True),
]


def applied(augmentations: Sequence[Augmentation], tensor: Axes) -> list[SampleCall]:
    """The calls of these classes on large images, of all samples."""
    return [
        SampleCall(
            f"augmentation.{a.name}",
            {"input": tensor},
            {} if a.name == "PadTo" else {"p": 1.0},
            a.args if a.large is None else a.large,
        )
        for a in augmentations
    ]


CLASSES = dict(input=IMAGE, labels=made("B", lambda s: torch.arange(s.b)))
INSTANCES = made("B 2 H W", lambda s: (torch.rand(s.b, 2, s.h, s.w) > 0.5).to(torch.uint8))
MIXES = [
    SampleCall("augmentation.RandomMixUpV2", CLASSES, dict(data_keys=["input", "class"], p=1.0)),
    SampleCall("augmentation.RandomCutMixV2", CLASSES, dict(data_keys=["input", "class"], p=1.0)),
    SampleCall("augmentation.RandomJigsaw", dict(input=rand("B 3 64 64")), dict(p=1.0)),
    SampleCall("augmentation.RandomMosaic", dict(input=IMAGE), dict(data_keys=["input"], p=1.0), ((96, 110),)),
    SampleCall("augmentation.RandomTransplantation", dict(input=IMAGE, mask=LABELS), dict(p=1.0)),
    SampleCall("augmentation.RandomCopyPaste", dict(input=IMAGE, mask=INSTANCES), dict(p=1.0)),
]
CALLS = [*applied(IMAGES, rand("B 3 H W")), *applied(VOLUMES, VOLUME), *MIXES]
