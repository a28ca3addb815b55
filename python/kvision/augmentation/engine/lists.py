"""Lists of images that an augmentation makes a batch by one launch, with which a container goes on.

A parameter of an augmentation is drawn for the size of its image: a launch has numbers of its own for each image. Equal sizes
draw what a batch draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision._dtype import compute_dtype
from kvision.augmentation import labels
from kvision.augmentation.columns import Columns, Span, plan_draws
from kvision.augmentation.draws import SIZED
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import Execution, ListExecution, Params, matrix_type
from kvision.augmentation.engine.list_calls import SIZES
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.sized import NumbersOfEach, Reading, Sized, SizedNumbers, listed
from kvision.augmentation.engine.stages import Applied, MaskReading, Warp
from kvision.augmentation.maps import exact, warp_each
from kvision.augmentation.transforms import transform_matrix
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform.lists.arguments import like_batch
from kvision.geometry.transform.lists.arguments import sizes as sides_of


class ListPlan(NamedTuple):
    """What an augmentation does to images of any sizes, of which all results have one."""

    size: tuple[int, int]  # of the results
    sized: Sized
    draws: SizedNumbers | NumbersOfEach | None  # the numbers of its draws that depend on the size
    inputs: SizedNumbers | NumbersOfEach | None  # and those of its matrix
    only_windows_differ: bool  # draws and matrix have nothing of an image but its size, where windows of it are drawn


def list_plan(module: Any) -> ListPlan | None:
    """The plan of an augmentation for lists; None if it does not give images of any sizes one size, in every call."""
    plan: ListPlan | None = (
        module._plans.made("list", lambda: _list_plan(module)) if hasattr(module, "_plans") else None
    )
    return plan


def _list_plan(module: Any) -> ListPlan | None:
    if not hasattr(module, "_warp_list") or module._is_customized() or module._draws_by_name:
        return None
    shapes, flags = [(1, 3, *size) for size in SIZES], module.flags
    if not module.whole_batch or module.p_batch < 1 or module.matrix_transforms(shapes[0], flags) is None:
        return None
    height, width = module.output_size(shapes[0], flags)
    if (height, width) != tuple(module.output_size(shapes[1], flags)):
        return None
    sized = Sized(Reading([module], [True], 1, 3, CallContext.of_module("", None, None)), 0, ())
    draws = zip(*map(sized.reading.draws, SIZES))
    only_windows = all(a == b or (a.kind in SIZED and a.numbers[:-2] == b.numbers[:-2]) for a, b in draws)
    numbers = sized.numbers(has_inputs=False), sized.numbers(has_draws=False)
    return ListPlan((int(height), int(width)), sized, *numbers, only_windows and not sized.count)


# --- the call -------------------------------------------------------------------------------------------------------


@dataclass
class ListWarp(Warp):
    """The warp of a list."""

    source: Any  # the ListCall, which has height and width of each image

    @property
    def sides(self) -> list[int]:
        return list(self.source.sides)

    def source_size(self) -> Any:
        return None  # of all images

    def move_masks(self, masks: Any, reading: MaskReading) -> Any:
        """Masks (1, H, W) of each image as a batch."""
        resampling = self.resampling.for_labels(reading.mode, reading.fill)
        return warp_each([exact(m) for m in masks], self.matrix, list(self.size), resampling)[0].to(masks[0].dtype)

    def move_masks_back(self, masks: Tensor) -> Any:
        back = warp_each(list(exact(masks)), self.matrix, self.sides, self.resampling.for_inverse("nearest"), False)
        return [m.to(masks.dtype) for m in _as_list(back)]

    def invert(self, x: Tensor) -> Any:
        return _as_list(warp_each(list(x), self.matrix, self.sides, self.resampling.for_inverse(), False))

    def move_mask_list(self, op: str, masks: Any, reading: MaskReading) -> list[Tensor]:
        """Masks (N, H, W) or (H, W) of each image, moved: (N, h, w) of each."""
        sides = self.sides
        count = len(sides) // 2
        if not isinstance(masks, (list, tuple)) or len(masks) != count:
            got = len(masks) if isinstance(masks, (list, tuple)) else type(masks).__name__
            raise ShapeError(f"{op}: expected mask to be a list of {count}, one of each image, got {got}")
        labels.check_tensors("the masks of an image", masks)
        planes, counts = [], []
        for b, mask in enumerate(masks):
            size = tuple(sides[2 * b : 2 * b + 2])
            if mask.dim() not in (2, 3) or tuple(mask.shape[-2:]) != size:
                raise ShapeError(
                    f"{op}: expected mask[{b}] of shape (N, {size[0]}, {size[1]}), got {tuple(mask.shape)}"
                )
            own = mask if mask.dim() == 3 else mask[None]
            planes += list(own[:, None])
            counts.append(own.shape[0])
        if not planes:
            return [mask.new_empty(0, *self.size) for mask in masks]
        samples = torch.arange(count, device="cpu").repeat_interleave(torch.tensor(counts, device="cpu"))
        of_planes = replace(self, matrix=self.matrix[samples.to(self.matrix.device)])
        return list(of_planes.move_masks(planes, reading)[:, 0].split(counts))


class ListCall:
    """A call of the augmentation that makes a list of images a batch: what it draws for their sizes, and has drawn."""

    columns: Columns
    dtype: torch.dtype  # of matrices

    def __init__(self, batch: int, channels: int, sides: Sequence[int] | Tensor, module: Any) -> None:
        plan = list_plan(module)
        assert plan is not None
        self.plan, self.module, self._batch, self._sides = plan, module, (batch, channels), sides

    @property
    def sides(self) -> Sequence[int]:
        """Height and width of each image."""
        if isinstance(self._sides, Tensor):
            self._sides = self._sides.flatten().tolist()
        return self._sides

    @property
    def shape(self) -> tuple[int, ...]:
        """(B, C, H, W) with the largest sides."""
        return (*self._batch, max(self.sides[::2]), max(self.sides[1::2]))

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """(B, C, H, W) with the size of each image."""
        return [(*self._batch, h, w) for h, w in zip(self.sides[::2], self.sides[1::2])]

    def listed_draws(self) -> tuple[Sequence[int], list[float]]:
        """The draws that depend on the size, by their positions, and their numbers for the first image, the second, ..."""
        numbers = self.plan.draws
        return self.plan.sized.draws, [] if numbers is None else listed(numbers, self.sides)

    def with_sizes(self, columns: Tensor | None, like: Tensor) -> Tensor | None:
        """Columns (B, P), and behind them the inputs of the matrix that depend on the size."""
        if self.plan.inputs is None:
            return columns
        numbers = torch.tensor(listed(self.plan.inputs, self.sides), dtype=compute_dtype(like), device="cpu")
        own = on_device(numbers.view(self._batch[0], -1), like.device)
        return own if columns is None else torch.cat([columns.to(own.dtype), own], 1)

    def execution(
        self, columns: Columns, type_of_matrix: tuple[torch.device, torch.dtype], matrix: Tensor | None = None
    ) -> Execution:
        """The record of the call. Its parameters, and its matrices if they are not given, are computed when they are asked for."""
        execution = ListExecution(self, columns, is_certain=True)
        execution.identity, execution.matrix = type_of_matrix, matrix
        self.columns, self.dtype = columns, type_of_matrix[1]
        return execution

    def params(self, read: Any = None) -> Params:
        """The parameters by name, read from the device."""
        generator, shapes = self.module._param_generator, [(1, *shape[1:]) for shape in self.shapes]
        values, each = self.columns.values.detach().cpu(), []
        for b, shape in enumerate(shapes if generator is not None else ()):
            each.append(generator.to_params(values[b : b + 1], shape))
        params: Params = {name: torch.cat([own[name] for own in each]) for name in (each[0] if each else ())}
        params["batch_prob"] = torch.ones(len(shapes), device="cpu")
        params["forward_input_shape"] = torch.tensor(shapes, device="cpu")
        return params

    def matrix(self, read: Any = None) -> Tensor:
        """The matrices (B, 3, 3)."""
        columns, span = self.columns.drawn.to(self.dtype), self.columns.span
        values = columns if span.width == columns.shape[1] else columns[:, span.first : span.first + span.width]
        own, sized = Span(0, span.width, span.has_chosen), self.plan.sized
        (chain,) = sized.reading.chains(SIZES[0])
        bound = sized.bound([self.module], [own], values.shape[1]) or {0: self.module._bound(chain, own)}
        with_sizes = self.with_sizes(values, values)
        assert with_sizes is not None
        return transform_matrix(with_sizes, bound[0])


def execute_list(
    images: Sequence[Tensor], child: Child, context: CallContext, position: int = 0
) -> tuple[Tensor, ListWarp, bool]:
    """The batch that the first augmentation makes of a list, what labels have to follow, and whether anything was drawn."""
    module: Any = child.module
    own = ListCall(len(images), images[0].shape[0], sides_of(images), module)
    flags, like = module.flags, like_batch(images)
    values = torch.empty(len(images), 0, device=like.device)
    generator, request = module._param_generator, module._request(own.shapes[0])
    draws = child.params is None and request is not None
    if child.params is not None and generator is not None:
        values = generator.to_columns(child.params, own.shapes[0]).to(like.device)
    elif draws:
        keys = context.keys([module], like)
        context.check_seeds(keys, len(images))
        (plan,) = plan_draws([request], keys.has_seed, position if keys.has_seed else 0)
        values = plan.draw_list(like, keys, *own.listed_draws())
        if module._derives:
            values = _derived(module, values, images, context.labels)
    columns = Columns(values.to(compute_dtype(like)), Span(0, values.shape[1], False))
    execution = child.record = module.__dict__["_execution"] = own.execution(columns, matrix_type(like))
    matrix, size = module._matrix(execution), list(own.plan.size)
    batch = module._warp_list(list(images), matrix, size, flags)
    parts = [Applied(module, execution, flags)] if module.removes_boxes else ()
    warp = ListWarp(matrix, own, size, module.resampling(flags), parts=parts)
    return batch, warp, draws


def _derived(module: Any, drawn: Tensor, images: Sequence[Tensor], call_labels: CallLabels | None) -> Tensor:
    """The columns (B, P) that an augmentation derives from drawn ones and the labels of each image."""
    hw = on_device(torch.tensor([x.shape[-2:] for x in images], dtype=drawn.dtype, device="cpu"), drawn.device)
    read = None
    if module.reads_labels is not None and call_labels is not None:
        read = call_labels.read(module.reads_labels, (len(images), *images[0].shape))
    span = Span(0, drawn.shape[1], False)
    if not isinstance(read, list):
        return module._derived(Columns(drawn, span), hw, None if read is None else read.to(drawn.device)).drawn
    rows = []
    for b in range(len(images)):
        masks = [
            labels.masks_as_batch(of_input[b][None] if of_input[b].dim() == 3 else of_input[b]) for of_input in read
        ]
        rows.append(module._derived(Columns(drawn[b : b + 1], span), hw[b : b + 1], masks).drawn)
    return torch.cat(rows)


def _as_list(results: Sequence[Tensor]) -> list[Tensor]:
    return list(results[0]) if results[0].dim() == 4 else list(results)
