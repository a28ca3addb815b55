"""Calls on lists of images of different sizes, image by image: those of one size are a batch, each with a seed of its own.

A call is one of batches, whose images, labels and parameters are joined in the order of the list. So whatever runs on a batch
runs on a list, and an image of a list becomes what it becomes alone with its seed. A list of one size is one batch, with the draws
of that batch. What a list becomes follows from the augmentations: a batch if all images have one size in the end, whatever
they had before, and a list otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision.augmentation.engine.parts import Parts, are_of_samples, params_of_rows
from kvision.augmentation.engine.sized import SIZES, gives_one_size
from kvision.augmentation.keys import Seed, check_seeds, draw_keys, seeds_of_samples
from kvision.augmentation.sample_rows import numbers_by
from kvision.constants import DataKey
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import check_list


def call_in_parts(
    modules: Sequence[Any],
    keys: Sequence[DataKey],
    inputs: Sequence[Any],
    params: Any,
    seed: Seed,
    generator: Generator | None,
    call: Callable[..., tuple[list[Any], Any]],
) -> tuple[list[Any], Parts]:
    """The results of a call on a list of images and what belongs to them, image by image.

    `modules` are what is called and what is in it. `call` gives the results of a part, and what was drawn and done, for its
    inputs, parameters, seed and generator.
    """
    module = modules[0]
    op, images = type(module).__name__, check_list(type(module).__name__, "input", inputs[keys.index(DataKey.INPUT)])
    refuse_list(op, modules)
    chooses_for_each = are_of_samples(params) or (isinstance(seed, Tensor) and seed.dim() == 1)
    calls: list[Any] = []
    parts, each, seeds = Parts(op, _rows_of_parts(images, modules, chooses_for_each), calls), [], None
    if params is None and len(parts.rows) > 1:
        seeds, generator = seeds_of_list(op, modules, parts.count, seed, generator or module.generator), None
    for rows in parts.rows:
        replayed = None if params is None else params_of_rows(params, rows, parts.count)
        own_seed = seed if seeds is None else seeds[list(rows)]
        outputs, done = call(parts.inputs(rows, keys, inputs), replayed, own_seed, generator)
        calls.append(done)
        each.append(outputs)
    return parts.outputs(keys, inputs, each, gives_one_size(module)), parts


# --- the parts of a call --------------------------------------------------------------------------------------------


def refuse_list(op: str, modules: Any) -> None:
    """Raise where a list cannot be augmented image by image."""
    for module in modules:
        if getattr(module, "mixes_samples", False):
            raise TypeCheckError(
                f"{op}: expected a batch for {type(module).__name__}, which mixes samples, got a list of images; begin "
                "with a crop or resize to a fixed size, or mix the batch that another container makes of the list"
            )
    if is_compiling():
        raise RuntimeError(
            f"{op}: a list of images that no crop or resize to a fixed size makes a batch has no graph; call it outside of "
            "torch.compile, or without fullgraph=True"
        )


def _rows_of_parts(images: Sequence[Tensor], modules: Sequence[Any], chooses_for_each: bool) -> list[list[int]]:
    """The numbers of the images of each part: those of one size, or one image where samples of a batch would not be alone.

    A chance may decide for a batch, as may a size that is drawn, and what is chosen for samples may give them sizes of their own.
    """
    by_size = numbers_by(x.shape for x in images)
    draws_for_batch = len(by_size) > 1 and any(_draws_for_batch(m) for m in modules)
    if draws_for_batch or any(_gives_samples_sizes(m, chooses_for_each or len(by_size) > 1) for m in modules):
        return [[i] for i in range(len(images))]
    return list(by_size.values())


def _draws_for_batch(module: Any) -> bool:
    """Whether a chance decides for a batch, or a size that is drawn is that of a batch."""
    has_chance = getattr(module, "whole_batch", False) and 0 < module.p_batch < 1
    return has_chance or not getattr(module, "has_known_size", True)


def _gives_samples_sizes(module: Any, chooses_for_each: bool) -> bool:
    """Whether a container chooses children for samples which give these different sizes; by `random_apply` where it says so."""
    chooses = getattr(module, "chooses_for_samples", False)
    chooses = chooses or (chooses_for_each and getattr(module, "random_apply", None))
    return bool(chooses) and module._sizes_after(SIZES) is None


def seeds_of_list(op: str, modules: Sequence[Any], count: int, seed: Seed, generator: Generator | None) -> Tensor:
    """A seed of each image (B,): those that are given, or what follows from one seed or from the key of a generator.

    They are one for all where all that draws has `same_on_batch`.
    """
    if seed is None and torch.cuda.is_initialized() and torch.cuda.is_current_stream_capturing():
        raise RuntimeError(
            f"{op}: a CUDA graph would repeat the draws of a list of images of several sizes; give a seed, or begin with a crop or "
            "resize to a fixed size"
        )
    keys = draw_keys(op, 1, torch.device("cpu"), seed, generator)
    if keys.seeds is not None:
        check_seeds(op, keys, count)
        return keys.seeds
    samples = torch.arange(count, device=keys.keys.device)
    same = {is_same for is_same in map(_draws_same, modules) if is_same is not None}
    if len(same) > 1:
        raise ValueCheckError(
            f"{op}: expected one same_on_batch of all that draws for images of several sizes, got True and False; give a seed of "
            "each image"
        )
    return seeds_of_samples(keys.keys, torch.zeros_like(samples) if same == {True} else samples)


def _draws_same(module: Any) -> bool | None:
    """Whether a module draws the same for all samples; None if it draws nothing."""
    if hasattr(module, "output_shape"):
        request = module._request((1, 3, *SIZES[0])) if module.p > 0 and not module._draws_by_name else None
        draws = module._draws_by_name or (request is not None and len(request.draws) > 0)
    else:
        draws = getattr(module, "_draws_choices", False)
    return bool(module.same_on_batch) if draws else None
