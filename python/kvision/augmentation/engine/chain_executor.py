"""Execution of a chain: which of its children run, on what types, and what they have in common in a call."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Generator, Tensor, nn

from kvision._choices import EachOrOnce
from kvision.augmentation.engine.augmentation import (
    AugmentationBase,
    RigidAffineAugmentationBase2D,
    RigidAffineAugmentationBase3D,
)
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.choices import Choices
from kvision.augmentation.engine.configuration import kept
from kvision.augmentation.engine.execution import check_batch_of_params, matrix_type
from kvision.augmentation.engine.label_settings import LabelSettings
from kvision.augmentation.engine.list_runs import execute_list
from kvision.augmentation.engine.record import Child, ParamItem, Record, child_of
from kvision.augmentation.engine.result_types import common_dtype, in_wider_type, result_dtype
from kvision.augmentation.engine.runs import execute, images_of
from kvision.augmentation.engine.sequential_base import ImageSequentialBase
from kvision.augmentation.engine.stages import Chain, Nested, Stage
from kvision.augmentation.engine.turns import Turn, execute_turns, turns_of
from kvision.augmentation.inputs import as_batch, check_batch, checked_images, is_image_list
from kvision.augmentation.keys import Seed, check_seeds, draw_keys, refuse_capture, refuse_graphs
from kvision.augmentation.warp_and_color import SAME, Output
from kvision.color.frames import Frames
from kvision.core.exceptions import BaseError, TypeCheckError, ValueCheckError
from kvision.core.pixels import to_unit

Children = Iterator[tuple[str, nn.Module]]


class ChainExecutor(ImageSequentialBase):
    """Runs the children of a container on images (B, C, H, W), all in order or those that are drawn."""

    random_apply: tuple[int, int] | None
    random_apply_weights: list[float] | None
    resample: EachOrOnce
    output_dtype: torch.dtype | None
    memory_format: torch.memory_format | None

    # --- which children run ---

    def get_children_by_params(self, params: Sequence[ParamItem]) -> Children:
        """The children that the parameters of a call name, in its order."""
        modules = dict(self.named_children())
        for item in checked_items(type(self).__name__, params):
            if item.name not in modules:
                raise ValueCheckError(
                    f"{type(self).__name__}: there is no child {item.name!r}, of which params has parameters"
                )
            yield item.name, modules[item.name]

    def get_forward_sequence(self, params: Sequence[ParamItem] | None = None) -> Children:
        """The children of a call in the order of execution."""
        if params is not None:
            return self.get_children_by_params(params)
        if self.random_apply is None:
            return iter(self._modules.items())
        return self.get_random_forward_sequence()

    def get_random_forward_sequence(
        self, with_mix: bool = True, seed: Seed = None, generator: Generator | None = None
    ) -> Children:
        """Children drawn as `random_apply` says, at most one of which mixes samples."""
        children = list(self.named_children())
        op = type(self).__name__
        if seed is None:
            refuse_capture(op)
        keys = draw_keys(op, 1, torch.device("cpu"), seed, generator or self.generator)
        return iter([children[at] for at in self._choices().of_key(keys.on_host(op)[0], with_mix)])

    def _choices(self) -> Choices:
        """Which children may run, as `random_apply` says."""
        children = list(self.children())
        low, end = self.random_apply or (len(children), len(children) + 1)
        mixes = [bool(getattr(child, "mixes_samples", False)) for child in children]
        return Choices(low, end, self.random_apply_weights or [1.0] * len(children), mixes)

    def _chooses_for_samples(self, context: CallContext) -> bool:
        """Whether each sample gets children of its own. What mixes samples runs for the batch or not at all."""
        seed = context.seed
        if self.random_apply is None or not isinstance(seed, Tensor) or seed.dim() != 1:
            return False
        return not any(getattr(module, "mixes_samples", False) for module in self.modules())

    def _sequences_of_samples(self, context: CallContext, samples: int) -> Sequence[Sequence[int]]:
        """The numbers of the children of each sample, whose seeds the call has."""
        refuse_graphs(context.op)
        check_seeds(context.op, draw_keys(context.op, 1, torch.device("cpu"), context.seed, None), samples)
        assert isinstance(context.seed, Tensor)
        return self._choices().of_seeds(_moved(context.seed, context.position))

    # --- types ---

    @property
    def _draws_choices(self) -> bool:
        """Whether the container draws by itself, beside its children."""
        return self.random_apply is not None

    @property
    def _always_chooses(self) -> bool:
        """Whether each sample gets a child for certain, where children are drawn."""
        return self.random_apply is not None and self.random_apply[0] > 0

    def _result_dtype(self, dtype: torch.dtype) -> torch.dtype:
        """The type of the results for images of a type."""
        if self.output_dtype is not None:
            return self.output_dtype
        if self._draws_choices:
            return self._type_of_choices(dtype)
        for module in self.children():
            dtype = result_dtype(module, dtype)
        return dtype

    def _type_of_choices(self, dtype: torch.dtype) -> torch.dtype:
        """The type of what the children give for images of a type, the same whichever of them are drawn."""

        def find() -> torch.dtype:
            types = [result_dtype(module, dtype) for module in self.children()]
            return common_dtype(types if self._always_chooses else [dtype, *types])

        return self._plans.made(("type", dtype), find)

    @property
    def _output(self) -> Output:
        """The type and the layout of results."""
        is_same = self.output_dtype is None and self.memory_format is None
        return SAME if is_same else Output(self.output_dtype, self.memory_format)

    # --- execution ---

    def transform_tensor(self, input: Tensor) -> Tensor:
        """The input as a batch, lists as they are: (H, W) and (C, H, W) become (1, C, H, W); integers of 16 bits become float32."""
        if isinstance(input, list) and is_image_list(self, input):
            images: Any = checked_images(self, input)
            return images
        axes = self._axes()
        check_batch(self, input, axes)
        return as_batch(input, axes)

    @kept
    def _axes(self) -> int:
        """The axes of an image with its channels; of a volume, where a child takes these."""
        return max([3, *(m.axes for m in self.modules() if isinstance(m, AugmentationBase))])

    def _own_children(self) -> list[Child]:
        """All children in their order."""
        return [Child(name, module) for name, module in self._modules.items()]

    def _children_of_call(self, params: Sequence[ParamItem] | None, context: CallContext) -> list[Child]:
        if params is not None:
            by_name = self.get_children_by_params(params)
            return [child_of(item, module) for (_, module), item in zip(by_name, params)]
        if self.random_apply is None:
            sequence = self.get_forward_sequence()
        else:
            seed = None if context.seed is None else _moved(context.seed, context.position)
            sequence = self.get_random_forward_sequence(seed=seed, generator=context.generator_of(self))
        return [Child(name, module) for name, module in sequence]

    def _execute(self, x: Tensor, params: Sequence[ParamItem] | None, context: CallContext) -> tuple[Tensor, Record]:
        """Run the children on images (B, C, H, W); gives the images and what the call did."""
        dtype = self._type_of_choices(x.dtype) if self._draws_choices else None
        if dtype is not None and dtype != x.dtype == torch.uint8:  # for all samples, whichever gets that child
            x = to_unit(x if context.source is None else images_of(context.source))
            context = context._replace(source=None)
        in_turns = self._in_turns(x, params, context)
        if in_turns is not None:
            turns, own = in_turns
            if own.source is not None:
                x, own = images_of(own.source), own._replace(source=None)
            y, stages, children = execute_turns(x, turns, own)
        else:
            children = self._children_of_call(params, context)
            y, stages = (execute_list if isinstance(x, list) else execute)(x, children, context)
        if dtype is not None and self.output_dtype is None:
            y = in_wider_type(y, dtype)
        size, is_of_list = tuple(y.shape[2:]), isinstance(x, list)
        values: dict[str, Any] = {"size": size, "is_of_list": is_of_list, "identity": matrix_type(y)}
        return y, Record(None if is_of_list else tuple(x.shape), children, Chain(stages), **values)

    def _in_turns(
        self, x: Any, params: Sequence[Any] | None, context: CallContext
    ) -> tuple[list[Turn], CallContext] | None:
        """The turns of a call in which samples have children of their own, and their context; None where all have the same."""
        if params is not None:
            children = self._children_of_call(params, context)
            turns = self._turns_of_params(children, len(x))
            return (turns, context) if any(child.samples is not None for child in children) else None
        if not self._chooses_for_samples(context):
            return None
        frames = max(context.time, context.frames, 1)
        # An empty batch gets the size that a sample would get.
        seeds = context if len(x) else context._replace(seed=torch.zeros(1, dtype=torch.int64, device="cpu"))
        sequences = self._sequences_of_samples(seeds, len(x) // frames or 1)
        units = self._units(self._own_children())
        return turns_of(units, sequences, frames, context.position), context

    def _check_batch_of(self, children: Sequence[Child], batch: int) -> None:
        """Raise unless children that replay parameters of some samples are those of a batch of this size."""
        for child in children:
            if child.samples is not None:
                check_batch_of_params(type(self).__name__, child.batch, batch)

    def _turns_of_params(self, children: Sequence[Child], batch: int) -> list[Turn]:
        """The turns of a call that is replayed."""
        self._check_batch_of(children, batch)
        return [Turn(unit, range(batch) if (s := unit[0].samples) is None else s) for unit in self._units(children)]

    def _units(self, children: Sequence[Child]) -> list[Sequence[Child]]:
        """What samples choose from, by its number: children by themselves, or several that run together."""
        return [[child] for child in children]

    def _execute_nested(self, x: Tensor, params: Any, context: CallContext) -> tuple[Tensor, Stage, Record]:
        y, record = self._execute(x, params, self._inside(context))
        self._keep(record)
        return y, Nested(record.stages.stages, self._label_settings), record

    @property
    def _reads_frames(self) -> bool:
        """Whether frames of video are handed to the children."""
        return type(self)._execute is ChainExecutor._execute

    def _replayed(self, x: Tensor, params: Any) -> Record:
        """A call with given parameters."""
        return self._execute(x, params, self._context(None, None))[1]

    def _record_of_part(self, like: Tensor, shape: tuple[int, ...], params: Any) -> Record:
        return self._replayed(torch.zeros(1, device=like.device).expand(shape), params)

    # --- what the children have in common ---

    def _context(
        self,
        seed: Seed,
        generator: Generator | None,
        time: int = 0,
        labels: CallLabels | None = None,
        source: Frames | None = None,
    ) -> CallContext:
        op, once, plans, own = type(self).__name__, self.resample == "once", self._plans, self.generator
        has_labels = labels is not None
        context = CallContext(op, seed, generator, once, plans, self._output, 1, 0, time, has_labels, labels, own)
        context = context if source is None else context._replace(source=source)
        return self._of_frames(context) if time else context

    def _of_frames(self, context: CallContext) -> CallContext:
        """The context of frames of videos, which may share their parameters."""
        return context

    def _inside(self, context: CallContext) -> CallContext:
        """The context of the children in a call of the container around this one."""
        return context.inside(self, context.once or self.resample == "once", self._plans, self._output)

    @property
    def _label_settings(self) -> LabelSettings | None:
        """What the container says about labels; None for what has no such settings."""
        return None


def _moved(seed: Any, position: int) -> Any:
    """Another seed at each position in the chain, for the choices of other containers."""
    return seed + (position << 32) if position else seed


def checked_items(op: str, params: Any, field: str = "name") -> Sequence[Any]:
    """The parameters of children, as `_params` lists them: items with a field of this name."""
    if not isinstance(params, (list, tuple)) or not all(hasattr(item, field) for item in params):
        raise TypeCheckError(f"{op}: expected params to be the _params of a call, got {params!r:.80}")
    return params


class _NotRigidError(BaseError, RuntimeError):
    """Kornia raises a RuntimeError."""


def check_rigid(op: str, container: nn.Module) -> None:
    """Raise unless all children have matrices."""
    for child in container.children():
        if isinstance(child, ChainExecutor):
            check_rigid(op, child)
        elif not isinstance(child, (RigidAffineAugmentationBase2D, RigidAffineAugmentationBase3D)):
            raise _NotRigidError(
                f"{op}: expected children with matrices for transformation_matrix_mode 'rigid', got {type(child).__name__}"
            )
