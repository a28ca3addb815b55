"""One augmentation on a list of images: by one launch if it gives all images one size, and otherwise image by image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from torch import Generator, Tensor

from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import Execution, replaying
from kvision.augmentation.engine.list_calls import (
    Part,
    PartedExecution,
    each_row,
    gives_one_size,
    join_images,
    of_rows,
    params_of_rows,
    part_seed,
    refuse_list,
    rows_of_parts,
    seeds_of_list,
    shapes_of_images,
    with_call,
)
from kvision.augmentation.engine.lists import execute_list, list_plan
from kvision.augmentation.engine.record import Child
from kvision.augmentation.inputs import WIDE_INTEGERS, check_image
from kvision.augmentation.keys import Seed
from kvision.constants import DataKey
from kvision.core.exceptions import TypeCheckError
from kvision.geometry.transform.lists.arguments import check_list, largest_shape, like_batch

_KEYS = {"boxes": DataKey.BBOX_XYXY, "masks": DataKey.MASK}  # of labels that draws read


def augment_list(
    module: Any,
    images: list[Tensor],
    params: Any,
    seed: Seed,
    generator: Generator | None,
    flags: Mapping[str, Any],
    labels: Any,
) -> tuple[Any, Execution]:
    """What an augmentation makes of images (C, H, W), a batch or a list, and the execution."""
    op, count = type(module).__name__, len(images)
    images = check_list(op, "input", images)
    check_image(module, images[0])
    if images[0].dtype in WIDE_INTEGERS:
        raise TypeCheckError(f"{op}: expected a list of images of bytes or floats, got {images[0].dtype}")
    if flags is module.flags and list_plan(module) is not None:
        return _at_once(module, images, params, seed, generator, labels)
    refuse_list(op, [module])
    rows_of = rows_of_parts(images, [module], False)
    if params is None and len(rows_of) > 1:
        seed = seeds_of_list(op, [module], count, seed, generator or module.generator)
    parts, results = [], []
    for rows in rows_of:
        x = of_rows(op, DataKey.INPUT, images, rows, count)
        if params is None:
            own = None if labels is None else of_rows(op, _KEYS[module.reads_labels], labels, rows, count)
            read = None if own is None else module._labels_of_call({module.reads_labels: own}, x)
            y, execution = module._draw_and_run(x, *part_seed(seed, generator, rows, count), flags, read)
        else:
            with replaying(op, params):
                execution = module._execution = module._from_params(params_of_rows(params, rows, count), x)
                y = module._run(x, execution, flags)
        parts.append(Part(rows, execution))
        results.append(y)
    return join_images(parts, results, count, gives_one_size(module)), PartedExecution(parts, count, module)


def _at_once(
    module: Any, images: list[Tensor], params: Any, seed: Seed, generator: Generator | None, labels: Any
) -> tuple[Tensor, Execution]:
    """The batch that an augmentation makes of images of any sizes."""
    shape, keys, call_labels = largest_shape(images), None, None
    if params is None and module._request(shape) is not None:
        keys = module._keys(like_batch(images), seed, generator)
    if labels is not None:
        call_labels = CallLabels([DataKey.INPUT, _KEYS[module.reads_labels]], [images, labels], None, shape, True)
    child = Child(type(module).__name__, module, params)
    with replaying(type(module).__name__, params or {}):
        y, _ = execute_list(images, child, module, keys, 0, call_labels)
    return y, child.record


def call_each_image(
    module: Any, output: Any, params: Mapping[str, Any], call: Callable[[Any, Tensor], Any]
) -> list[Any]:
    """What a call makes of the result of each image of a list, whose parameters are given."""
    op, last = type(module).__name__, module._execution
    shapes = shapes_of_images(params) or []
    parts = last.parts if isinstance(last, PartedExecution) and last.params is params else None
    if parts is None:
        parts = []
        for b, shape in enumerate(shapes):
            assert shape is not None
            image, own = output[b].new_empty(1).expand(1, *shape), params_of_rows(params, [b], len(shapes))
            parts.append(Part([b], module._execution_on(image, own, module.flags)))
    each = []
    for part in parts:
        x = of_rows(op, DataKey.INPUT, output, part.rows, len(shapes))
        each.append(call(with_call(module, "_execution", part.call), x))
    return each_row(each, parts, len(shapes))
