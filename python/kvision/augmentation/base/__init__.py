"""Bases of augmentations: probabilities, parameters, replay, matrices, types and ranks, once for all classes.

An augmentation declares what it draws (a generator of random_generator) and one of three effects:

    transforms   a chain of matrix formulas of the drawn columns: the image, masks, boxes and points follow the matrix
    color steps  a part of a color program
    methods      `apply_transform`, on the parameters by name

The first two are executed from drawn columns without parameters by name in between; containers join those of neighbors, which
they learn from one method, `_contribution`. A subclass that overrides `generate_parameters`, `compute_transformation` or
`apply_transform` is executed through them.

    declaration   what a subclass declares and overrides
    contribution  what an augmentation adds to the passes that it shares
    engine        draws parameters, or takes given ones, and executes the declaration
    one_pass      the same by one pass over the images, where there is one
    augmentation  what users call, and the public bases
    execution     what one call drew and did
"""

from kvision.augmentation.base.augmentation import (
    AugmentationBase,
    AugmentationBase2D,
    AugmentationBase3D,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
)
from kvision.augmentation.base.execution import Execution, Params, Shape, matrix_type, replaying
from kvision.augmentation.base.samples import (
    at_scale,
    inverse_at,
    is_known,
    known_everywhere,
    per_sample,
    where_chosen,
    with_matrix,
    without_added_axes,
)

__all__ = [
    "AugmentationBase",
    "AugmentationBase2D",
    "AugmentationBase3D",
    "Execution",
    "Params",
    "RigidAffineAugmentationBase2D",
    "RigidAffineAugmentationBase3D",
    "Shape",
    "at_scale",
    "inverse_at",
    "is_known",
    "known_everywhere",
    "matrix_type",
    "per_sample",
    "replaying",
    "where_chosen",
    "with_matrix",
    "without_added_axes",
]
