"""Calls of a chain on a list of images of different sizes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Generator, Tensor

from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.chain_executor import ChainExecutor, checked_items
from kvision.augmentation.engine.configuration import kept
from kvision.augmentation.engine.list_calls import call_in_parts
from kvision.augmentation.engine.list_chains import ChainParts, run_chain
from kvision.augmentation.engine.list_records import ListParts, replayed_record
from kvision.augmentation.engine.list_runs import run_list
from kvision.augmentation.engine.parts import Parts, shapes_of_images
from kvision.augmentation.engine.record import ParamItem, Record
from kvision.augmentation.engine.sized import SIZES, Sizes, gives_one_size, makes_batch, sizes_after
from kvision.augmentation.inputs import is_image_list
from kvision.augmentation.keys import Seed
from kvision.constants import DataKey


class ListCaller(ChainExecutor):
    """Runs the children of a container on a list of images: in the launches of a batch where they allow it, or image by image."""

    _item_field = "name"  # that each item of `_params` has

    @kept
    def _reads_lists(self) -> bool:
        """Whether the first child makes a list a batch by one launch, so that the list is not taken image by image."""
        runs_all = self._reads_frames and not self._draws_choices and len(self) > 0  # and does nothing else
        return runs_all and self.resample == "each" and makes_batch(next(iter(self._modules.values())))

    @property
    def _runs_lists(self) -> bool:
        """Whether the children run one after the other, or are chosen, so that they can be run on a list."""
        own = type(self)
        return own._execute is ChainExecutor._execute and own._execute_nested is ChainExecutor._execute_nested

    def _sizes_after(self, sizes: Sizes) -> Sizes | None:
        """What the children make of two sizes; None where it depends on more than these."""
        if self.random_apply is not None:
            return sizes if all(sizes_after(module, sizes) == sizes for module in self.children()) else None
        after: Sizes | None = sizes
        for module in self.children():
            after = sizes_after(module, SIZES if after is None else after)
        return after

    def _call_list(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Any], Record]:
        """The results of a call on a list of images, in the launches of a batch or image by image, and its record."""
        if params is not None:
            params = list(checked_items(type(self).__name__, params, self._item_field))
        of_passes = self._call_list_by_passes(keys, inputs, params, seed, generator)
        if of_passes is not None:
            return of_passes
        call = self._call_of_parts(keys, inputs)
        outputs, parts = call_in_parts(list(self.modules()), keys, inputs, params, seed, generator, call)
        return outputs, Record(parts=parts)

    def _call_list_by_passes(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Any], Record] | None:
        """The same of a call whose children are passes over all images; None of others."""
        if (
            not self._runs_lists or not len(self) or list(keys).count(DataKey.INPUT) != 1
        ):  # others replay the parameters
            return None
        images, labels = inputs[keys.index(DataKey.INPUT)], None
        if params is None and len(keys) > 1 and self._label_settings is not None:
            labels = CallLabels.of(keys, inputs, self._label_settings, images)
        context = self._context(seed, generator, labels=labels)
        children = self._own_children() if params is None else self._children_of_call(params, context)
        self._check_batch_of(children, len(images))
        record: Callable[..., Record] = partial(replayed_record, children, context)
        results: tuple[Any, ListParts | ChainParts] | None = None
        if params is not None or not self._draws_choices:
            results = run_list(images, children, context)
        if results is None:
            results, record = run_chain(self, images, params, context, generator), self._record_of_part
        if results is None:
            return None
        y, moving = results
        parts: Parts = moving
        if params is not None:
            parts = Parts.of_params(context.op, params, [tuple(x.shape) for x in images], images, record)
        own = Record(parts=parts, items=params)
        return self._with_labels_of_list(keys, inputs, self._as_batch(y), own, moving), own

    def _as_batch(self, y: Any) -> Any:
        """Results on a list of images as a batch, where the children give all of them one size."""
        return torch.stack(y) if isinstance(y, list) and gives_one_size(self) else y

    def _with_labels_of_list(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], y: Any, record: Record, moving: ListParts | ChainParts
    ) -> list[Any]:
        """What the inputs of a call on a list become, whose images became y, by what moves all of them together."""
        return [y]

    def _call_of_parts(self, keys: Sequence[DataKey], inputs: Sequence[Any]) -> Callable[..., Any]:
        """What gives the results of a call on some images of a list as a batch, and its record, for their inputs."""

        def call(own: list[Any], params: Any, seed: Seed, generator: Generator | None) -> tuple[list[Any], Record]:
            y, record = self._execute(own[0], params, self._context(seed, generator))
            record.stages.forget()
            return [y], record

        return call

    def _parts_of(
        self, params: Sequence[ParamItem] | None, outputs: Any = None, like: Tensor | None = None
    ) -> Parts | None:
        """The parts of the last call, or of given parameters, if it was one on a list; None of others.

        Without `outputs` images stand for them that are `like` one, or on the CPU.
        """
        if params is None:
            return self._record.parts
        shapes = shapes_of_images(params)
        if shapes is None and is_image_list(self, outputs):
            shapes = [None] * len(outputs)
        if shapes is None:
            return None
        if outputs is None and like is not None:
            outputs = [like[0]] * len(shapes)
        return Parts.of_params(type(self).__name__, list(params), shapes, outputs, self._record_of_part)
