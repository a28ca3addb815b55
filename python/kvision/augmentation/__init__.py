"""Random augmentation of images with their masks, boxes, key points and labels."""

from kvision import _torch_compat
from kvision.augmentation import auto, container, draws, presets, random_generator
from kvision.augmentation.adjustments import (
    RandomBrightness,
    RandomContrast,
    RandomGamma,
    RandomGrayscale,
    RandomHue,
    RandomInvert,
    RandomPosterize,
    RandomRGBShift,
    RandomSaturation,
    RandomSolarize,
)
from kvision.augmentation.affine import RandomAffine, RandomRotation, RandomRotation90, RandomShear, RandomTranslate
from kvision.augmentation.channels import RandomChannelDropout, RandomChannelShuffle, RandomPlanckianJitter
from kvision.augmentation.color_jitter import ColorJiggle, ColorJitter
from kvision.augmentation.container import (
    AugmentationSequential,
    ImageSequential,
    ManyToManyAugmentationDispather,
    ManyToOneAugmentationDispather,
    OneOf,
    PatchSequential,
    RandomApply,
    RandomOrder,
    SomeOf,
    VideoSequential,
)
from kvision.augmentation.container.saving import allow_loading as _allow_loading
from kvision.augmentation.container.saving import from_json, to_json
from kvision.augmentation.container.sheet import preview
from kvision.augmentation.corruption import (
    CommonCorruption,
    Defocus,
    Downscale,
    GlassBlur,
    ISONoise,
    MultiplicativeNoise,
    RandomFog,
    RandomFrost,
    RingingOvershoot,
    ShotNoise,
    Spatter,
    SpeckleNoise,
    ZoomBlur,
)
from kvision.augmentation.crops import (
    AtLeastOneBBoxRandomCrop,
    CenterCrop,
    CropNonEmptyMaskIfExists,
    FiveCrop,
    MultiCrop,
    RandomCrop,
    RandomCropNearBBox,
    RandomIoUCrop,
    RandomResizedCrop,
    RandomSizedBBoxSafeCrop,
    RandomZoomOut,
    TenCrop,
)
from kvision.augmentation.distortion import (
    ChromaticAberration,
    GridDistortion,
    OpticalDistortion,
    PiecewiseAffine,
    Swirl,
)
from kvision.augmentation.elastic import RandomElasticTransform, RandomFisheye, RandomThinPlateSpline
from kvision.augmentation.engine import (
    AugmentationBase2D,
    AugmentationBase3D,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
)
from kvision.augmentation.erasing import RandomErasing
from kvision.augmentation.filters import (
    RandomAutoContrast,
    RandomBoxBlur,
    RandomClahe,
    RandomEqualize,
    RandomGaussianBlur,
    RandomJPEG,
    RandomMedianBlur,
    RandomMotionBlur,
    RandomSharpness,
)
from kvision.augmentation.flip import D4, RandomHorizontalFlip, RandomVerticalFlip, Transpose
from kvision.augmentation.geometric3d_base import GeometricAugmentationBase3D
from kvision.augmentation.geometric_base import GeometricAugmentationBase2D
from kvision.augmentation.illumination import (
    RandomGaussianIllumination,
    RandomLinearCornerIllumination,
    RandomLinearIllumination,
)
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D, IntensityAugmentationBase3D
from kvision.augmentation.mixing import (
    MixAugmentationBaseV2,
    PatchMix,
    RandomCutMixV2,
    RandomJigsaw,
    RandomMixUpV2,
    RandomMosaic,
)
from kvision.augmentation.mixing.copy_paste import RandomCopyPaste
from kvision.augmentation.mixing.transplantation import RandomTransplantation, RandomTransplantation3D
from kvision.augmentation.normalize import Denormalize, Normalize
from kvision.augmentation.occlusion import (
    CoarseDropout,
    FrequencyMasking,
    GridDropout,
    GridMask,
    MaskDropout,
    PixelDropout,
    TimeMasking,
    XYMasking,
)
from kvision.augmentation.perspective import RandomPerspective
from kvision.augmentation.plasma import RandomPlasmaBrightness, RandomPlasmaContrast, RandomPlasmaShadow
from kvision.augmentation.random_noise import RandomGaussianNoise, RandomSaltAndPepperNoise
from kvision.augmentation.resize import LongestMaxSize, Pad, PadIfNeeded, PadTo, RandomScale, Resize, SmallestMaxSize
from kvision.augmentation.transforms import Transform
from kvision.augmentation.volume_crops import CenterCrop3D, RandomCrop3D, RandomResizedCrop3D, Resize3D
from kvision.augmentation.volumes import (
    RandomAffine3D,
    RandomDepthicalFlip3D,
    RandomEqualize3D,
    RandomHorizontalFlip3D,
    RandomMotionBlur3D,
    RandomPerspective3D,
    RandomRotation3D,
    RandomVerticalFlip3D,
)
from kvision.augmentation.warp_and_color import ColorStep
from kvision.augmentation.weather import RandomRain, RandomSnow

__all__ = [
    "D4",
    "AtLeastOneBBoxRandomCrop",
    "AugmentationBase2D",
    "AugmentationBase3D",
    "AugmentationSequential",
    "CenterCrop",
    "CenterCrop3D",
    "ChromaticAberration",
    "CoarseDropout",
    "ColorJiggle",
    "ColorJitter",
    "ColorStep",
    "CommonCorruption",
    "CropNonEmptyMaskIfExists",
    "Defocus",
    "Denormalize",
    "Downscale",
    "FiveCrop",
    "FrequencyMasking",
    "GeometricAugmentationBase2D",
    "GeometricAugmentationBase3D",
    "GlassBlur",
    "GridDistortion",
    "GridDropout",
    "GridMask",
    "ISONoise",
    "ImageSequential",
    "IntensityAugmentationBase2D",
    "IntensityAugmentationBase3D",
    "LongestMaxSize",
    "ManyToManyAugmentationDispather",
    "ManyToOneAugmentationDispather",
    "MaskDropout",
    "MixAugmentationBaseV2",
    "MultiCrop",
    "MultiplicativeNoise",
    "Normalize",
    "OneOf",
    "OpticalDistortion",
    "Pad",
    "PadIfNeeded",
    "PadTo",
    "PatchMix",
    "PatchSequential",
    "PiecewiseAffine",
    "PixelDropout",
    "RandomAffine",
    "RandomAffine3D",
    "RandomApply",
    "RandomAutoContrast",
    "RandomBoxBlur",
    "RandomBrightness",
    "RandomChannelDropout",
    "RandomChannelShuffle",
    "RandomClahe",
    "RandomContrast",
    "RandomCopyPaste",
    "RandomCrop",
    "RandomCrop3D",
    "RandomCropNearBBox",
    "RandomCutMixV2",
    "RandomDepthicalFlip3D",
    "RandomElasticTransform",
    "RandomEqualize",
    "RandomEqualize3D",
    "RandomErasing",
    "RandomFisheye",
    "RandomFog",
    "RandomFrost",
    "RandomGamma",
    "RandomGaussianBlur",
    "RandomGaussianIllumination",
    "RandomGaussianNoise",
    "RandomGrayscale",
    "RandomHorizontalFlip",
    "RandomHorizontalFlip3D",
    "RandomHue",
    "RandomInvert",
    "RandomIoUCrop",
    "RandomJPEG",
    "RandomJigsaw",
    "RandomLinearCornerIllumination",
    "RandomLinearIllumination",
    "RandomMedianBlur",
    "RandomMixUpV2",
    "RandomMosaic",
    "RandomMotionBlur",
    "RandomMotionBlur3D",
    "RandomOrder",
    "RandomPerspective",
    "RandomPerspective3D",
    "RandomPlanckianJitter",
    "RandomPlasmaBrightness",
    "RandomPlasmaContrast",
    "RandomPlasmaShadow",
    "RandomPosterize",
    "RandomRGBShift",
    "RandomRain",
    "RandomResizedCrop",
    "RandomResizedCrop3D",
    "RandomRotation",
    "RandomRotation3D",
    "RandomRotation90",
    "RandomSaltAndPepperNoise",
    "RandomSaturation",
    "RandomScale",
    "RandomSharpness",
    "RandomShear",
    "RandomSizedBBoxSafeCrop",
    "RandomSnow",
    "RandomSolarize",
    "RandomThinPlateSpline",
    "RandomTranslate",
    "RandomTransplantation",
    "RandomTransplantation3D",
    "RandomVerticalFlip",
    "RandomVerticalFlip3D",
    "RandomZoomOut",
    "Resize",
    "Resize3D",
    "RigidAffineAugmentationBase2D",
    "RigidAffineAugmentationBase3D",
    "RingingOvershoot",
    "ShotNoise",
    "SmallestMaxSize",
    "SomeOf",
    "Spatter",
    "SpeckleNoise",
    "Swirl",
    "TenCrop",
    "TimeMasking",
    "Transform",
    "Transpose",
    "VideoSequential",
    "XYMasking",
    "ZoomBlur",
    "auto",
    "container",
    "from_json",
    "presets",
    "preview",
    "random_generator",
    "to_json",
]

_allow_loading()

for _package in (globals(), vars(auto), vars(auto.operations)):
    _torch_compat.refuse_script(dict(_package))
