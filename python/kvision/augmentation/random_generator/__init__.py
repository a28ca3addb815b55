"""Generators of random parameters: each has the ranges of one augmentation and draws its parameters for a batch."""

from kvision.augmentation.random_generator.affine import AffineGenerator, ShearGenerator, TranslateGenerator
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.random_generator.color import (
    ChannelDropoutGenerator,
    ChannelShuffleGenerator,
    PlanckianJitterGenerator,
    PosterizeGenerator,
)
from kvision.augmentation.random_generator.color_jitter import ColorJiggleGenerator, ColorJitterGenerator
from kvision.augmentation.random_generator.crop import (
    CropGenerator,
    ResizedCropGenerator,
    ResizeGenerator,
    center_crop_generator,
)
from kvision.augmentation.random_generator.erase import RectangleEraseGenerator
from kvision.augmentation.random_generator.filters import (
    JPEGGenerator,
    MotionBlurGenerator,
    RandomGaussianBlurGenerator,
)
from kvision.augmentation.random_generator.illumination import (
    GaussianIlluminationGenerator,
    LinearCornerIlluminationGenerator,
    LinearIlluminationGenerator,
)
from kvision.augmentation.random_generator.mix import (
    CutmixGenerator,
    JigsawGenerator,
    MixupGenerator,
    MosaicGenerator,
    PatchMixGenerator,
)
from kvision.augmentation.random_generator.noise import GaussianNoiseGenerator, SaltAndPepperGenerator
from kvision.augmentation.random_generator.perspective import PerspectiveGenerator
from kvision.augmentation.random_generator.plain import (
    DistributionWithMapper,
    PlainUniformGenerator,
    ProbabilityGenerator,
    UniformDistribution,
)
from kvision.augmentation.random_generator.volumes import (
    AffineGenerator3D,
    CropGenerator3D,
    MotionBlurGenerator3D,
    PerspectiveGenerator3D,
    ResizedCropGenerator3D,
    ResizeGenerator3D,
    RotationGenerator3D,
    center_crop_generator3d,
)
from kvision.augmentation.random_generator.weather import RainGenerator

__all__ = [
    "AffineGenerator",
    "AffineGenerator3D",
    "ChannelDropoutGenerator",
    "ChannelShuffleGenerator",
    "ColorJiggleGenerator",
    "ColorJitterGenerator",
    "CropGenerator",
    "CropGenerator3D",
    "CutmixGenerator",
    "DistributionWithMapper",
    "GaussianIlluminationGenerator",
    "GaussianNoiseGenerator",
    "JPEGGenerator",
    "JigsawGenerator",
    "LinearCornerIlluminationGenerator",
    "LinearIlluminationGenerator",
    "MixupGenerator",
    "MosaicGenerator",
    "MotionBlurGenerator",
    "MotionBlurGenerator3D",
    "PatchMixGenerator",
    "PerspectiveGenerator",
    "PerspectiveGenerator3D",
    "PlainUniformGenerator",
    "PlanckianJitterGenerator",
    "PosterizeGenerator",
    "ProbabilityGenerator",
    "RainGenerator",
    "RandomGaussianBlurGenerator",
    "RandomGeneratorBase",
    "RectangleEraseGenerator",
    "ResizeGenerator",
    "ResizeGenerator3D",
    "ResizedCropGenerator",
    "ResizedCropGenerator3D",
    "RotationGenerator3D",
    "SaltAndPepperGenerator",
    "ShearGenerator",
    "TranslateGenerator",
    "UniformDistribution",
    "center_crop_generator",
    "center_crop_generator3d",
]
