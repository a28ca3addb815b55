"""Calls for the sweep against Kornia besides those of sample_calls.py: functions of features, and modules of features and
augmentations, which each library makes itself, with the same arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

import kvision as K
from benchmarks.sample_calls import SampleCall, Size, channels, each, gray, homographies, image, labels, volume


@dataclass(frozen=True)
class ModuleCall:
    """The forward of a module on tensors; `library.package.name(*args, **kwargs)` makes it, once for each library."""

    name: str
    makers: Mapping[str, Callable[[Size], Tensor]]
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    modules: dict[str, Any] = field(default_factory=dict)

    def tensors(self, size: Size, device: torch.device | str = "cpu") -> dict[str, Tensor]:
        torch.manual_seed(0)
        return {name: make(size).to(device) for name, make in self.makers.items()}

    def function(self, library: ModuleType | Any = K) -> Any:
        package, name = self.name.split(".")
        return getattr(getattr(library, package, None), name, None)

    def call(self, library: ModuleType | Any, tensors: Mapping[str, Tensor]) -> Any:
        tensors = list(tensors.values())
        key = f"{library.__name__} {tensors[0].device}"
        if key not in self.modules:
            self.modules[key] = self.function(library)(*self.args, **self.kwargs).to(tensors[0].device)
        return self.modules[key](*tensors)


# --- features -------------------------------------------------------------------------------------------------------


def frames(s: Size) -> Tensor:
    """Half as many local affine frames as an image has columns, a tenth of its height in size, inside of it."""
    shape = 0.05 * s.h * (torch.eye(2) + 0.2 * torch.rand(s.b, s.w // 2, 2, 2))
    center = torch.tensor([s.w, s.h]) * (0.2 + 0.6 * torch.rand(s.b, s.w // 2, 2))
    return torch.cat([shape, center[..., None]], -1)


def frames_of_one(s: Size) -> Tensor:
    return frames(Size(1, *s[1:]))


def angles(s: Size) -> Tensor:
    return 360 * torch.rand(s.b, s.w // 2, 1)


def ellipses(s: Size) -> Tensor:
    a, b, c = torch.rand(3, s.b, s.w // 2)
    return torch.stack([s.w * a, s.h * b, 0.1 + a, 0.1 * b, 0.1 + c], -1)


def descriptors(s: Size) -> Tensor:
    return torch.nn.functional.normalize(torch.rand(s.w // 2, 128), dim=1)


def batched_descriptors(s: Size) -> Tensor:
    return torch.nn.functional.normalize(torch.rand(s.b, s.w // 2, 128), dim=2)


def patches(size: int) -> Callable[[Size], Tensor]:
    return lambda s: torch.rand(16 * s.b, 1, size, size)


_PAIR = {"desc1": descriptors, "desc2": descriptors}
_FRAMES = {"lafs1": frames_of_one, "lafs2": frames_of_one}
FEATURE_FUNCTIONS: dict[str, dict[str, Any]] = {
    **each(("denormalize_laf", "normalize_laf"), {"LAF": frames, "images": image}),
    "ellipse_to_laf": {"ells": ellipses},
    **each(("get_laf_center", "get_laf_orientation", "get_laf_scale", "laf_to_boundary_points"), {"LAF": frames}),
    "laf_from_center_scale_ori": {"xy": lambda s: frames(s)[..., 2]},
    "laf_from_three_points": {"threepts": frames},
    **each(("laf_is_filled", "laf_is_valid", "laf_to_three_points", "make_upright"), {"laf": frames}),
    "laf_is_inside_image": {"laf": frames, "images": image},
    "perspective_transform_lafs": {"trans_01": homographies, "lafs_1": frames},
    **each(("rotate_laf", "set_laf_orientation"), {"LAF": frames, "angles_degrees": angles}),
    "scale_laf": {"laf": frames, "scale_coef": 2.0},
    **each(("match_nn", "match_mnn", "match_snn", "match_smnn"), _PAIR),
    "match_smnn_batched": {"desc1": batched_descriptors, "desc2": batched_descriptors},
    **each(("match_fginn", "match_adalam"), {**_PAIR, **_FRAMES}),
    **each(("extract_patches_from_pyramid", "extract_patches_simple"), {"img": gray, "laf": frames}),
    "dog_response": {"input": volume},
    **each(("dog_response_single", "gftt_response", "harris_response", "hessian_response"), {"input": gray}),
    "convert_sift_descriptor_layout": {"descriptors": descriptors, "source": "kornia", "target": "opencv"},
}
_FRAMES_OF_IMAGE = {"laf": frames, "img": gray}
FEATURE_MODULES = [
    ModuleCall("feature.SIFTDescriptor", {"input": patches(41)}),
    ModuleCall("feature.DenseSIFTDescriptor", {"input": gray}),
    ModuleCall("feature.MKDDescriptor", {"patches": patches(32)}, (), {"output_dims": 64, "whitening": None}),
    ModuleCall("feature.PatchDominantGradientOrientation", {"patch": patches(32)}),
    ModuleCall("feature.PatchAffineShapeEstimator", {"patch": patches(19)}),
    ModuleCall("feature.LAFOrienter", _FRAMES_OF_IMAGE, (32,)),
    ModuleCall("feature.LAFAffineShapeEstimator", _FRAMES_OF_IMAGE, (32,)),
    ModuleCall("feature.HardNet", {"input": patches(32)}, (False,)),
    ModuleCall("feature.HyNet", {"patch": patches(32)}, (False,)),
    ModuleCall("feature.SOSNet", {"input": patches(32)}, (False,)),
    ModuleCall("feature.TFeat", {"input": patches(32)}, (False,)),
    ModuleCall("feature.OriNet", {"patch": patches(32)}, (False,)),
    ModuleCall("feature.KeyNet", {"x": gray}, (False,)),
    ModuleCall("feature.ScaleSpaceDetector", {"img": gray}, (100,)),
]

# --- augmentations --------------------------------------------------------------------------------------------------

_MEAN, _STD = torch.tensor([0.5, 0.4, 0.3]), torch.tensor([0.2, 0.3, 0.4])
IMAGE_AUGMENTATIONS: dict[str, tuple[Any, ...]] = {
    "RandomAffine": (30.0, (0.1, 0.2), (0.8, 1.2), 10.0),
    "RandomHorizontalFlip": (),
    "RandomVerticalFlip": (),
    "RandomPerspective": (0.5,),
    "RandomRotation": (30.0,),
    "RandomRotation90": ((-1, 3),),
    "RandomShear": ((-10.0, 20.0, -5.0, 5.0),),
    "RandomTranslate": ((-0.1, 0.2), (0.0, 0.2)),
    "CenterCrop": ((96, 110),),
    "LongestMaxSize": (140,),
    "RandomCrop": ((96, 110),),
    "RandomResizedCrop": ((96, 110),),
    "Resize": ((96, 110),),
    "SmallestMaxSize": (90,),
    "RandomElasticTransform": ((31, 31), (8.0, 8.0)),
    "RandomFisheye": (torch.tensor([-0.2, 0.2]), torch.tensor([-0.2, 0.2]), torch.tensor([0.9, 1.1])),
    "RandomThinPlateSpline": (0.2,),
    "ColorJiggle": (0.2, 0.2, 0.2, 0.2),
    "ColorJitter": (0.2, 0.2, 0.2, 0.2),
    "Denormalize": (_MEAN, _STD),
    "Normalize": (_MEAN, _STD),
    "RandomAutoContrast": (),
    "RandomBoxBlur": (),
    "RandomBrightness": ((0.5, 1.5),),
    "RandomChannelDropout": (),
    "RandomChannelShuffle": (),
    "RandomClahe": ((2.0, 4.0), (4, 4)),
    "RandomContrast": ((0.5, 1.5),),
    "RandomEqualize": (),
    "RandomGamma": ((0.5, 1.5), (0.8, 1.0)),
    "RandomGaussianBlur": ((5, 5), (0.5, 2.0)),
    "RandomGrayscale": (),
    "RandomHue": ((-0.3, 0.3),),
    "RandomInvert": (),
    "RandomJPEG": ((20.0, 60.0),),
    "RandomMedianBlur": (),
    "RandomMotionBlur": ((3, 7), 35.0, 0.5),
    "RandomPlanckianJitter": (),
    "RandomPosterize": (3,),
    "RandomRGBShift": (),
    "RandomSaturation": ((0.5, 1.5),),
    "RandomSharpness": (0.8,),
    "RandomSolarize": (0.1, 0.1),
    "RandomErasing": (),
    "RandomGaussianIllumination": (),
    "RandomGaussianNoise": (0.1, 0.2),
    "RandomLinearCornerIllumination": (),
    "RandomLinearIllumination": (),
    "RandomSaltAndPepperNoise": ((0.1, 0.4),),
    "RandomPlasmaBrightness": ((0.1, 0.7), (0.1, 0.2)),
    "RandomPlasmaContrast": (),
    "RandomPlasmaShadow": (),
    "RandomRain": ((10, 20), (3, 6), (-3, 3)),
    "RandomSnow": ((0.3, 0.7), (1.0, 2.0)),
}
VOLUME_AUGMENTATIONS: dict[str, tuple[Any, ...]] = {
    "CenterCrop3D": ((4, 32, 40),),
    "RandomAffine3D": ((10.0, 20.0, 30.0),),
    "RandomCrop3D": ((4, 32, 40),),
    "RandomDepthicalFlip3D": (),
    "RandomEqualize3D": (),
    "RandomHorizontalFlip3D": (),
    "RandomMotionBlur3D": (3, (10.0, 20.0, 30.0), 0.5),
    "RandomPerspective3D": (0.3,),
    "RandomRotation3D": ((10.0, 20.0, 30.0),),
    "RandomVerticalFlip3D": (),
}
_CLASSES = {"input": image, "labels": lambda s: torch.arange(s.b)}
MIXES = [
    ModuleCall("augmentation.RandomMixUpV2", _CLASSES, (), {"data_keys": ["input", "class"], "p": 1.0}),
    ModuleCall("augmentation.RandomCutMixV2", _CLASSES, (), {"data_keys": ["input", "class"], "p": 1.0}),
    ModuleCall("augmentation.RandomJigsaw", {"input": lambda s: channels(3)(Size(s.b, s.c, 64, 64))}, (), {"p": 1.0}),
    ModuleCall("augmentation.RandomMosaic", {"input": image}, ((96, 110),), {"data_keys": ["input"], "p": 1.0}),
    ModuleCall("augmentation.RandomTransplantation", {"input": image, "mask": labels}, (), {"p": 1.0}),
]


def sample_modules() -> Iterator[SampleCall | ModuleCall]:
    """Functions and modules of features, then augmentations, each applied to all samples."""
    for name, arguments in FEATURE_FUNCTIONS.items():
        makers = {k: v for k, v in arguments.items() if inspect.isfunction(v)}
        yield SampleCall(f"feature.{name}", makers, {k: v for k, v in arguments.items() if k not in makers})
    yield from FEATURE_MODULES
    for name, args in IMAGE_AUGMENTATIONS.items():
        yield ModuleCall(f"augmentation.{name}", {"input": channels(3)}, args, {"p": 1.0})
    yield ModuleCall("augmentation.PadTo", {"input": image}, ((400, 520),))
    for name, args in VOLUME_AUGMENTATIONS.items():
        yield ModuleCall(f"augmentation.{name}", {"input": volume}, args, {"p": 1.0})
    yield from MIXES
