"""Maps of grids, lenses and vortices, which move labels as well. What users import is in `kvision.augmentation`."""

from kvision.augmentation.distortion.chromatic import ChromaticAberration
from kvision.augmentation.distortion.grids import GridDistortion, PiecewiseAffine
from kvision.augmentation.distortion.lenses import OpticalDistortion
from kvision.augmentation.distortion.swirl import Swirl

__all__ = ["ChromaticAberration", "GridDistortion", "OpticalDistortion", "PiecewiseAffine", "Swirl"]
