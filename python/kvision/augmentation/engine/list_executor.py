"""Execution of one augmentation on a list of images: in the launches of a batch, or image by image."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

from torch import Generator, Tensor
from typing_extensions import Self

from kvision._tv_tensors import wrap
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import Execution, ListExecution, Params, Shape, replaying
from kvision.augmentation.engine.executor import Executor
from kvision.augmentation.engine.label_settings import LabelSettings
from kvision.augmentation.engine.list_calls import call_in_parts
from kvision.augmentation.engine.list_runs import run_list
from kvision.augmentation.engine.parts import Parts, shapes_of_images
from kvision.augmentation.engine.record import Child
from kvision.augmentation.inputs import checked_images, list_in_type_of, plain_image
from kvision.augmentation.keys import Seed
from kvision.augmentation.labels import box_edges, masks_as_batch
from kvision.constants import DataKey

_KEYS = {"boxes": DataKey.BBOX_XYXY, "masks": DataKey.MASK}  # of labels that draws read


class ListExecutor(Executor):
    """Executes an augmentation on a list of images (C, H, W)."""

    def _flags_of(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        return self._checked_flags({**self.flags, **overrides}) if overrides else self.flags

    def _call_on_list(
        self, given: list[Tensor], params: Any, seed: Seed, generator: Generator | None, kwargs: dict[str, Any]
    ) -> tuple[Any, Execution]:
        """Augment a list of images (C, H, W): in the launches of a batch, and where there are no such image by image."""
        op, labels = type(self).__name__, None if self.reads_labels is None else kwargs.pop(self.reads_labels, None)
        flags, plain = self._flags_of(kwargs), plain_image(self, given)
        images = checked_images(self, plain)
        keys, inputs = [DataKey.INPUT], [images]
        child, context = Child(op, self, params), CallContext.of_module(op, seed, generator, self._plans)
        if labels is not None:
            keys, inputs = [*keys, _KEYS[self.reads_labels or ""]], [images, labels]
            context = context._replace(labels=CallLabels.of(keys, inputs, LabelSettings(), images))
        with nullcontext() if params is None else replaying(op, params):
            done, parts = run_list(images, [child], context) if flags is self.flags else None, None
            if done is None:
                call = functools.partial(self._call_part, flags)
                (y, *_), parts = call_in_parts([self], keys, inputs, params, seed, generator, call)
            else:
                y, of_run = done
                if of_run is None:
                    parts = Parts.of_params(op, params, [x.shape for x in images], images, self._execution_of_part)
        if parts is not None:
            child.record = self._execution = ListExecution(parts)
        y = list_in_type_of(y, plain)
        return y if plain is given else wrap(y, given), child.record

    def _call_part(
        self, flags: dict[str, Any], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Tensor], Execution]:
        """The results of images of one size, and what was done."""
        x, *labels = inputs
        if params is not None:
            y, execution = self._replay_and_run(x, params, flags)
        else:
            read = self._labels_of_call({self.reads_labels or "": labels[0]}, x) if labels else None
            y, execution = self._draw_and_run(x, seed, generator, flags, read)
        return [y], execution

    def _each_part(self, output: Any, params: Params | None, call: Callable[[Self, Tensor], Any]) -> Any:
        """What a call makes of the results of a list, as a list; None if the last call, or that of params, was on a batch."""
        last = self._execution
        if params is None and last is not None:
            params = last.params if last.of_list is None else self._read_params(last)
        shapes = None if params is None else shapes_of_images(params)
        if shapes is None:
            return None
        parts = None if last is None or last.params is not params else last.of_list
        if parts is None:
            parts = Parts.of_params(type(self).__name__, params, shapes, output, self._execution_of_part)
        return parts.each_result(self, output, call)

    def _execution_of_part(self, like: Tensor, shape: Shape, params: Any) -> Execution:
        return self._execution_on(like.expand(shape), params, self.flags)

    def _labels_of_call(self, kwargs: dict[str, Any], x: Tensor) -> Any:
        """What a draw reads of the labels among the arguments of a call, which are taken out of them."""
        assert self.reads_labels is not None
        labels = kwargs.pop(self.reads_labels, None)
        if labels is None:
            return None
        if self.reads_labels == "masks":
            return [masks_as_batch(labels, tuple(x.shape))]
        return box_edges(labels, "xyxy", x.shape[0]).to(x.device)

    def _execution_on(self, x: Tensor, params: Params, flags: dict[str, Any]) -> Execution:
        """The execution of given parameters, with its matrices, on images of which only the shape and the device count."""
        return self._from_params(params, x)
