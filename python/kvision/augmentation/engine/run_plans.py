"""The plan of a run: what neighboring augmentations draw in one launch, and the steps that they are executed in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._constants import constant, on_device
from kvision.augmentation.columns import Columns, DrawPlan, Span, identity_of, plan_draws
from kvision.augmentation.displacements import NoiseField
from kvision.augmentation.drawn_links import DrawnLinks
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.draws import Request
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.drawing import decides, may_apply
from kvision.augmentation.engine.execution import Execution, Shape, matrix_type
from kvision.augmentation.engine.executor import Executor
from kvision.augmentation.engine.passes import Step, plan_steps
from kvision.augmentation.keys import Keys


class Call(NamedTuple):
    """What an augmentation of a run draws and whether it is applied, for images of one shape."""

    shape: Shape
    applies: bool
    is_certain: bool  # all samples are augmented
    number: int | None  # of its request among those of the run; None for one that draws nothing
    span: Span | None  # its columns among all, those that are derived behind all that are drawn
    derived_from: Span | None = None  # the drawn columns, of one whose columns are derived


class RunPlan(NamedTuple):
    """What a run of augmentations draws and executes, for images of one shape."""

    calls: Sequence[Call]
    draws: Sequence[DrawPlan]
    drawing: Sequence[Executor]  # the augmentation of each request
    steps: Sequence[Step]
    first: int  # number of the first key, or position in the chain
    derives: bool  # whether any has columns that are derived
    drawn: DrawnPass | DrawnLinks | None = None  # the draws together with the first step or its links, by one operator
    owners: Tensor | None = None  # (P,) on the CPU: the number of the augmentation that each column belongs to
    identity: tuple[float, ...] = ()  # what the columns hold for samples that do not get that augmentation

    @property
    def derived_columns(self) -> int:
        """How many columns are derived."""
        return sum(call.span.width for call in self.calls if call.derived_from is not None and call.span is not None)

    def columns(self, x: Tensor, keys: Keys | None, context: CallContext) -> Tensor | None:
        """The drawn columns of all augmentations."""
        if keys is None:
            return None
        frames = context.frames
        drawn = [draws.draw(x[::frames] if frames > 1 else x, keys) for draws in self.draws]
        columns = drawn[0] if len(drawn) == 1 else torch.cat(drawn, 1)
        columns = columns.repeat_interleave(frames, 0) if frames > 1 else columns
        return self.of_owners(columns, context.owners)

    def of_owners(self, columns: Tensor, owners: Tensor | None, identity: Tensor | None = None) -> Tensor:
        """Drawn columns, and others behind them, where samples get only the augmentations that `owners` (B,) says.

        `identity` (B, P) replaces what is the same for all samples.
        """
        if self.owners is None or owners is None:
            return columns
        own = on_device(owners[:, None] == self.owners, columns.device)
        drawn = columns[:, : len(self.identity)]
        chosen = torch.where(own, drawn, constant(self.identity, columns) if identity is None else identity)
        return chosen if drawn.shape == columns.shape else torch.cat([chosen, columns[:, len(self.identity) :]], 1)

    def executions(self, x: Tensor, columns: Tensor | None, keys: Keys | None, frames: int = 1) -> list[Execution]:
        """The execution of each augmentation."""
        executions, identity = [], matrix_type(x)
        for shape, applies, is_certain, number, span, _ in self.calls:
            if number is None or span is None or columns is None or keys is None:
                execution = Execution(shape, applied=applies)
            else:
                # Keys would give the columns of owners to all samples.
                redraw = (keys, self.first + number) if self.owners is None else None
                execution = Execution(shape, Columns(columns, span), None, applies, None, redraw, frames, is_certain)
            execution.identity = identity
            executions.append(execution)
        return executions


def plan_run(
    x: Tensor, modules: Sequence[Executor], context: CallContext, position: int, chains_of_list: Any = None
) -> tuple[RunPlan, Keys | None]:
    """The plan of a run. If it depends on keys, these are drawn and returned for all requests; otherwise they are None.

    Where x stands for a list, `chains_of_list(modules, spans, columns)` gives chains by the numbers of augmentations, which read
    what depends on the sizes from columns behind those that are drawn.
    """
    has_seed, has_owners = context.seed is not None, context.owners is not None
    first, shape = position if has_seed else 0, tuple(x.shape)
    samples = -(-shape[0] // context.frames)  # which stays symbolic in a graph
    calls: list[Call] = []
    requests: list[Request] = []
    drawing: list[Executor] = []
    keys: Keys | None = None
    for module in modules:
        request = None
        if may_apply(module, context.is_certain):
            request = module._request((samples, *shape[1:]), context.is_certain, has_owners)
        number = len(requests)
        if request is not None:
            requests.append(request)
            drawing.append(module)
            if decides(module) and not context.is_certain:
                # What changes sizes by chance decides with its key on the host, before those after it are planned.
                keys = context.keys(drawing, x, keys)
        applies = context.is_certain or module._applies(None if request is None else keys, first + number)
        is_certain = not has_owners and (context.is_certain or module._is_certain)
        calls.append(Call(shape, applies, is_certain, None if request is None else number, None))
        if applies:
            shape = module.output_shape(shape, module.flags)
    if keys is not None:
        keys = context.keys(drawing, x, keys)
    draws = plan_draws(requests, has_seed, first) if requests else []
    calls, spans, width = _with_spans(calls, modules, draws)
    planned = [
        Execution(call.shape, None if call.span is None else Columns(x, call.span), applied=call.applies)
        for call in calls
    ]  # of their spans only
    chains = {} if chains_of_list is None else chains_of_list(modules, [call.span for call in calls], width)
    steps = plan_steps(modules, planned, context.once, x.dtype, context.output, chains)
    derives = any(call.derived_from is not None for call in calls)
    plan = RunPlan(calls, draws, drawing, steps, first, derives)
    if has_owners:
        owners, identity = _owners_of_columns(requests, spans)
        plan = plan._replace(owners=owners, identity=identity)
    elif steps and len(draws) == 1 and context.frames == 1 and not derives:

        def noise_field(number: int) -> NoiseField | None:
            module: Any = modules[number]  # a map
            call = calls[number]
            return None if call.number is None else module._noise_field(call.shape, first + call.number, has_seed)

        plan = plan._replace(drawn=steps[0].drawn_with(draws[0], x, noise_field))
    return plan, keys


def _with_spans(
    calls: Sequence[Call], modules: Sequence[Executor], draws: Sequence[DrawPlan]
) -> tuple[list[Call], list[Span], int]:
    """The calls with their columns, the columns of each request, and how many columns there are."""
    with_spans: list[Call] = []
    spans: list[Span] = []
    width = 0
    for draw in draws:
        spans += [span.moved(width) for span in draw.spans]
        width += draw.plan[0]
    for module, call in zip(modules, calls):
        span = None if call.number is None else spans[call.number]
        if span is not None and not module._derives:
            call = call._replace(span=span)
        elif span is not None and call.applies:
            count = len(module._identity_values(call.shape, torch.empty(0, device="cpu"))[0]) + span.has_chosen
            call = call._replace(span=Span(width, count, span.has_chosen), derived_from=span)
            width += count
        with_spans.append(call)
    return with_spans, spans, width


def _owners_of_columns(requests: Sequence[Request], spans: Sequence[Span]) -> tuple[Tensor, tuple[float, ...]]:
    """The number of the request of each column, and what the column holds for samples that are not chosen."""
    owners = [number for number, span in enumerate(spans) for _ in range(span.width)]
    return torch.tensor(owners, device="cpu"), tuple(identity_of(requests))
