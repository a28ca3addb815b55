"""The engine of augmentations: bases, planner, executors, records and containers.

An augmentation declares what it draws (a generator of random_generator) and one of three effects:

    transforms   a chain of matrix formulas of the drawn columns: the image, masks, boxes and points follow the matrix
    color steps  a part of a color program
    methods      `apply_transform`, on the parameters by name

The first two are executed from drawn columns without parameters by name in between; containers join those of neighbors, which
they learn from one method, `_contribution`. A subclass that overrides `generate_parameters`, `compute_transformation` or
`apply_transform` is executed through them.

One augmentation:

    declaration    what a subclass declares and overrides
    contribution   what an augmentation adds to the passes that it shares
    drawing        draws parameters, or takes given ones
    executor       executes the declaration, by one pass where there is one; list_executor on a list
    augmentation   what users call, and the public bases
    execution      what one call drew and did

Neighbors in a container:

    passes         which neighbors share a pass over the images, and the steps that come out of it
    run_plans      what a run of neighbors draws together, and its steps; runs execute a plan
    choices        which children run, for the batch or for each sample
    turns          execution where each sample has children of its own; choice_base the containers that draw them
    call_context   what the children of a container have in common in one call
    stages, record what a call did to positions of pixels; all that it did
    label_moves    boxes and points behind the stages of a call; label_record those of one call
    *_sequential   the containers that users call

A list of images, for which the same steps are executed:

    sized          what draws, matrices and results take from the size of an image
    list_plans     plans of runs on a list, whatever its sizes; list_runs execute one, list_records say what it did
    list_moves     what the labels of a list follow together
    list_chains    containers whose children are such runs, or are chosen for each image
    list_calls     calls image by image, where there is no run; parts are the images that were one batch
    lists          what labels follow where an augmentation makes the list a batch

Operators that plans call (draws, columns, transforms, warp_and_color, drawn_pass, drawn_links, maps) are outside, in the folder
of their kernels: they know no augmentation. Other packages import this one alone, and none of its modules.
"""

from kvision.augmentation.engine.augmentation import (
    AugmentationBase,
    AugmentationBase2D,
    AugmentationBase3D,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
)
from kvision.augmentation.engine.augmentation_sequential import AugmentationSequential
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.chain_executor import checked_items
from kvision.augmentation.engine.choice_base import ChoiceBase, positional
from kvision.augmentation.engine.configuration import restored_format, settings_changed
from kvision.augmentation.engine.contribution import Colors, Contribution, Motion
from kvision.augmentation.engine.declaration import KeepsArguments
from kvision.augmentation.engine.execution import (
    Execution,
    Params,
    Shape,
    check_batch_of_params,
    check_images,
    matrix_type,
    replaying,
)
from kvision.augmentation.engine.image_sequential import ImageSequential
from kvision.augmentation.engine.list_moves import LabelStep, Move, Moves
from kvision.augmentation.engine.parts import PartsOfImages
from kvision.augmentation.engine.patch_sequential import PatchSequential
from kvision.augmentation.engine.record import Child, ParamItem, Record
from kvision.augmentation.engine.sequential_base import ImageSequentialBase
from kvision.augmentation.engine.stages import Applied, ByMatrix, Chain, Warp
from kvision.augmentation.engine.turns import Turn, joins
from kvision.augmentation.engine.video_sequential import VideoSequential

__all__ = [
    "Applied",
    "AugmentationBase",
    "AugmentationBase2D",
    "AugmentationBase3D",
    "AugmentationSequential",
    "ByMatrix",
    "CallContext",
    "Chain",
    "Child",
    "ChoiceBase",
    "Colors",
    "Contribution",
    "Execution",
    "ImageSequential",
    "ImageSequentialBase",
    "KeepsArguments",
    "LabelStep",
    "Motion",
    "Move",
    "Moves",
    "ParamItem",
    "Params",
    "PartsOfImages",
    "PatchSequential",
    "Record",
    "RigidAffineAugmentationBase2D",
    "RigidAffineAugmentationBase3D",
    "Shape",
    "Turn",
    "VideoSequential",
    "Warp",
    "check_batch_of_params",
    "check_images",
    "checked_items",
    "joins",
    "matrix_type",
    "positional",
    "replaying",
    "restored_format",
    "settings_changed",
]
