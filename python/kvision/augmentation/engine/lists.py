"""Lists of images that an augmentation makes a batch by one launch, with which a container goes on.

A parameter of an augmentation is drawn for the size of its image: a launch has numbers of its own for each image. Equal sizes
draw what a batch draws.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation import labels
from kvision.augmentation.columns import Columns, Span, split_inputs
from kvision.augmentation.draws import KINDS, SIZED, Request, draw_list_parameters, draw_parameters
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.execution import Execution, matrix_type
from kvision.augmentation.engine.list_calls import SIZES
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.stages import MaskReading, Warp
from kvision.augmentation.keys import Keys
from kvision.augmentation.maps import exact, warp_each
from kvision.augmentation.transforms import KINDS as TRANSFORMS
from kvision.augmentation.transforms import Transform, _transform_matrix
from kvision.core.exceptions import ShapeError
from kvision.geometry.transform.lists.arguments import like_batch


class ListPlan(NamedTuple):
    """What an augmentation does to images of any sizes, of which all results have one."""

    size: tuple[int, int]  # of the results
    numbers: (
        list[float] | None
    )  # of all draws, but for the sizes in those of SIZED; None if others depend on the size, too
    sizes_at: list[int]  # where the heights are among the numbers, before the widths
    chain: Sequence[Transform] | None  # of the matrix; None if it depends on the size


def list_plan(module: Any) -> ListPlan | None:
    """The plan of an augmentation for lists; None if it does not give images of any sizes one size, in every call."""
    kept: tuple[ListPlan | None] | None = module._plans.get("list") if hasattr(module, "_plans") else (None,)
    if kept is None:
        kept = (_list_plan(module),)
        module._plans.keep("list", kept)
    return kept[0]


def _list_plan(module: Any) -> ListPlan | None:
    if not hasattr(module, "_warp_list") or module._is_customized() or module._draws_by_name:
        return None
    shapes, flags = [(1, 3, *size) for size in SIZES], module.flags
    if not module.whole_batch or module.p_batch < 1 or module.matrix_transforms(shapes[0], flags) is None:
        return None
    first, second = (tuple(module.output_size(shape, flags)) for shape in shapes)
    if first != second:
        return None
    chains = [module.matrix_transforms(shape, flags) for shape in shapes]
    formulas = [[(transform.kind, transform.inputs) for transform in chain] for chain in chains]
    rows, sizes_at = [_numbers(module._request(shape)) for shape in shapes], []
    for at, draw in _numbered(module._request(shapes[0])):
        if draw.kind in SIZED:
            sizes_at.append(at + len(draw.numbers) - 2)
    for row in rows:
        for at in sizes_at:
            row[at : at + 2] = rows[0][at : at + 2]
    numbers = rows[0] if rows[0] == rows[1] else None
    return ListPlan(
        (int(first[0]), int(first[1])), numbers, sizes_at, chains[0] if formulas[0] == formulas[1] else None
    )


def _numbered(request: Request | None) -> Iterator[tuple[int, Any]]:
    """The draws of a request, each with the position of its numbers."""
    at = 2
    for draw in request.draws if request else ():
        yield at, draw
        at += len(draw.numbers)


def _numbers(request: Request | None) -> list[float]:
    return [] if request is None else [request.p, request.p_batch, *(n for draw in request.draws for n in draw.numbers)]


# --- the call -------------------------------------------------------------------------------------------------------


@dataclass
class ListWarp(Warp):
    """The warp of a list; `source` has height and width of each image."""

    def source_size(self) -> Any:
        return None  # of all images

    def move_masks(self, masks: Any, reading: MaskReading) -> Any:
        """Masks (1, H, W) of each image as a batch."""
        resampling = self.resampling.for_labels(reading.mode, reading.fill)
        return warp_each([exact(m) for m in masks], self.matrix, list(self.size), resampling)[0].to(masks[0].dtype)

    def move_masks_back(self, masks: Tensor) -> Any:
        back = warp_each(list(exact(masks)), self.matrix, self.source, self.resampling.for_inverse("nearest"), False)
        return [m.to(masks.dtype) for m in _as_list(back)]

    def invert(self, x: Tensor) -> Any:
        return _as_list(warp_each(list(x), self.matrix, self.source, self.resampling.for_inverse(), False))

    def move_mask_list(self, op: str, masks: Any, reading: MaskReading) -> list[Tensor]:
        """Masks (N, H, W) or (H, W) of each image, moved: (N, h, w) of each."""
        count = len(self.source) // 2
        if not isinstance(masks, (list, tuple)) or len(masks) != count:
            got = len(masks) if isinstance(masks, (list, tuple)) else type(masks).__name__
            raise ShapeError(f"{op}: expected mask to be a list of {count}, one of each image, got {got}")
        labels.check_tensors("the masks of an image", masks)
        planes, counts = [], []
        for b, mask in enumerate(masks):
            size = tuple(self.source[2 * b : 2 * b + 2])
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


class ListExecution(Execution):
    """The call of the first augmentation on a list; its parameters are read from the device when they are asked for."""

    is_of_list = True

    def __init__(self, shapes: Sequence[tuple[int, ...]], sizes: Sequence[int], module: Any, values: Tensor) -> None:
        self._sizes, self._module, self._values = sizes, module, values
        self._named: dict[str, Any] | None = None
        super().__init__((*shapes[0][:2], max(sizes[::2]), max(sizes[1::2])))

    @property
    def params(self) -> Any:
        if self._named is None:
            generator, count = self._module._param_generator, self.shape[0]
            values, each = self._values.detach().cpu(), []
            for b in range(count) if generator is not None else ():
                each.append(generator.to_params(values[b : b + 1], (1, self.shape[1], *self._sizes[2 * b : 2 * b + 2])))
            self._named = {name: torch.cat([params[name] for params in each]) for name in (each[0] if each else ())}
            self._named["batch_prob"] = torch.ones(count, device="cpu")
            sides, channels = self._sizes, self.shape[1]
            shapes = [[1, channels, *sides[2 * b : 2 * b + 2]] for b in range(count)]
            self._named["forward_input_shape"] = torch.tensor(shapes, device="cpu")
        return self._named

    @params.setter
    def params(self, params: Any) -> None:
        self._named = params


def execute_list(
    images: Sequence[Tensor],
    child: Child,
    module: Any,
    keys: Keys | None,
    position: int,
    call_labels: CallLabels | None = None,
) -> tuple[Tensor, ListWarp]:
    """The batch that the first augmentation makes of a list, and what labels have to follow."""
    own, flags, like = list_plan(module), module.flags, like_batch(images)
    assert own is not None
    shapes = [(len(images), *x.shape) for x in images]
    span = Span(0, 0, False)
    values = torch.empty(len(images), 0, device=like.device)
    generator = module._param_generator
    if child.params is not None and generator is not None:
        values = generator.to_columns(child.params, shapes[0]).to(like.device)
    elif keys is not None:
        values = _draw(like, module, own, shapes, keys, position)
        if module._derives:
            values = _derived(module, values, images, call_labels)
    if values.shape[1]:
        span = Span(0, values.shape[1], False)
    values = values.to(compute_dtype(like))
    chains = [own.chain] if own.chain is not None else [module.matrix_transforms(shape, flags) for shape in shapes]
    matrix = _matrix(values, [module._bound(chain, span) for chain in chains])
    batch = module._warp_list(list(images), matrix, list(own.size), flags)
    sides = [n for shape in shapes for n in shape[2:]]
    execution = ListExecution(shapes, sides, module, values)
    execution.columns, execution.matrix, execution.is_certain = Columns(values, span), matrix, True
    execution.identity = matrix_type(like)
    child.record = module.__dict__["_execution"] = execution
    return batch, ListWarp(matrix, sides, list(own.size), module.resampling(flags))


def _draw(
    like: Tensor, module: Any, own: ListPlan, shapes: Sequence[Sequence[int]], keys: Keys, position: int
) -> Tensor:
    """The columns (B, P) of one augmentation, for the size of each image."""
    request = module._request(shapes[0])
    width = sum(draw.columns for draw in request.draws)
    head = (0, position if keys.has_seed else 0, int(request.same_on_batch), 1, len(request.draws))
    plan = [width, *head, *(KINDS[draw.kind].number for draw in request.draws)]
    seeds = keys.seeds_on(like.device)
    if own.numbers is not None and not own.sizes_at:
        drawn: Tensor = draw_parameters(like, keys.keys, seeds, plan, own.numbers)
        return drawn
    numbers: list[float] = []
    for shape in shapes:
        if own.numbers is None:
            numbers += _numbers(module._request(shape))
            continue
        first = len(numbers)
        numbers += own.numbers
        for at in own.sizes_at:
            numbers[first + at : first + at + 2] = shape[2:]
    drawn = draw_list_parameters(like, keys.keys, seeds, plan, numbers)
    return drawn


def _derived(module: Any, drawn: Tensor, images: Sequence[Tensor], call_labels: CallLabels | None) -> Tensor:
    """The columns (B, P) that an augmentation derives from drawn ones and the labels of each image."""
    hw = torch.tensor([x.shape[-2:] for x in images], device="cpu").to(drawn, non_blocking=True)
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


def _matrix(values: Tensor, chains: Sequence[Sequence[Transform]]) -> Tensor:
    """The matrices (B, 3, 3) of one chain, or of one of the same kinds for each sample, from columns (B, P).

    Numbers that differ become columns.
    """
    plans = []
    for chain in chains:
        inputs = [split_inputs(transform.inputs) for transform in chain]
        plans.append(([n for numbers, _ in inputs for n in numbers], [columns for _, columns in inputs]))
    numbers, columns = plans[0]
    differ = any(own != numbers for own, _ in plans)
    if differ:
        own = torch.tensor([row for row, _ in plans], dtype=values.dtype, device="cpu").to(
            values.device, non_blocking=True
        )
        at = values.shape[1]
        values = torch.cat([values, own], 1)
    plan: list[int] = []
    for transform, of_transform in zip(chains[0], columns):
        if differ:
            of_transform = [at + i if column < 0 else column for i, column in enumerate(of_transform)]
            at += len(of_transform)
        plan += [TRANSFORMS[transform.kind][0], *of_transform]
    matrix: Tensor = _transform_matrix(values, plan, numbers)
    return matrix


def _as_list(results: Sequence[Tensor]) -> list[Tensor]:
    return list(results[0]) if results[0].dim() == 4 else list(results)
