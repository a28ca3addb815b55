"""Plans of runs on a list of images, whatever its length and sizes.

What a draw or a matrix takes from the size of its image is a number of each image: a linear function of height and width, or one
that is read for each size (sized.py). Those of draws replace their numbers, those of matrices are columns behind the drawn ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.compiler import is_compiling

from kvision._constants import on_device
from kvision._dtype import compute_dtype
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.drawn_pass import DrawnListPass, DrawnPass, SizedDraws
from kvision.augmentation.draws import HEADER, MAX_DRAWS, MAX_NUMBERS, SIZED, Draw, Request, make_plan
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.execution import Execution, Params
from kvision.augmentation.engine.parts import params_of_rows
from kvision.augmentation.engine.passes import Alone, Composition, Covering, Joined, Step
from kvision.augmentation.engine.record import Child
from kvision.augmentation.engine.run_plans import RunPlan, plan_run
from kvision.augmentation.engine.sized import (
    CORNERS,
    SIZES,
    NumbersOfEach,
    Size,
    Sized,
    SizedNumbers,
    columns_of_sides,
    find_sized,
    listed,
)
from kvision.augmentation.keys import Keys
from kvision.augmentation.sample_rows import numbers_by, read_rows
from kvision.augmentation.transforms import MatrixPlan
from kvision.geometry.transform.lists.arguments import like_batch
from kvision.geometry.transform.lists.arguments import sizes as sides_of

_ANY = 2  # images of a batch in plans, which do not depend on it


class ListPlan(NamedTuple):
    """A run on lists."""

    run: RunPlan
    sized: Sized
    draws: DrawPlan | None  # of all columns; None if there are none
    listed: Sequence[int]  # the draws with numbers of each image, by their positions among all
    numbers: SizedNumbers | NumbersOfEach | None
    drawn: DrawnListPass | DrawnPass | None  # the draws with the first step, which gives a list or a batch
    drawn_alone: SizedDraws | None  # the draws
    begins_with_batch: bool  # the first augmentation makes one
    reads_executions: bool  # what each augmentation has drawn is read in the call
    identity: SizedNumbers | None = None  # columns of images with another child, where they depend on sizes
    numbers_of_labels: SizedNumbers | NumbersOfEach | None = None  # inputs of matrices that labels alone read
    before: Mapping[int, Sequence[Alone]] = MappingProxyType(
        {}
    )  # what labels that an augmentation reads follow before it

    def keys(self, images: Sequence[Tensor], context: CallContext) -> Keys | None:
        """What the columns of a call are drawn from."""
        if self.draws is None:
            return None
        drawing = self.run.drawing
        keys = context.keys(drawing, images[0]) if drawing else Keys(torch.zeros(1, dtype=torch.int64, device="cpu"))
        context.check_seeds(keys, len(images))
        return keys

    def draw(
        self, images: list[Tensor], keys: Keys | None, owners: Tensor | None
    ) -> tuple[tuple[Any, Tensor | None] | None, Tensor | None, Any]:
        """What the first step gives if one kernel computes it, the columns, and height and width of each image."""
        if isinstance(self.drawn, DrawnListPass) and self.drawn.serves(images):
            y, columns, sides = self.drawn.run(images, keys)
            return (y, None), None if self.draws is None else columns, sides
        if isinstance(self.drawn, DrawnPass) and keys is not None:
            done = self.drawn.run_list(images, keys)
            if done is not None:
                return done[:2], *done[2:]
        alone = None if keys is None or is_compiling() else self.drawn_alone
        of_sizes: Any = None if alone is None or keys is None else alone.run(images, keys)
        if of_sizes is None:
            own = sides_of(images)  # which checks them
            of_sizes = self._columns(images, keys, own), own
        columns, sides = of_sizes
        if columns is None:
            return None, None, sides
        identity = None
        if self.identity is not None:
            identity = on_device(self.identity.of_sides(sides_of(images)).to(columns.dtype), columns.device)
        return None, self.run.of_owners(columns, owners, identity), sides

    def _columns(self, images: Sequence[Tensor], keys: Keys | None, sides: Sequence[int]) -> Tensor | None:
        if self.draws is None or keys is None:
            return None
        like = like_batch(images)
        if self.numbers is None:
            return self.draws.draw(like, keys)
        return self.draws.draw_list(like, keys, self.listed, listed(self.numbers, sides))

    def executions(self, images: Sequence[Tensor], columns: Tensor | None, keys: Keys | None) -> list[Execution]:
        """The execution of each augmentation."""
        executions, count = self.run.executions(images[0], columns, keys), len(images)
        for execution in executions:
            execution.shape = (count, *execution.shape[1:])
        return executions


def kept_plan(
    images: Sequence[Tensor], modules: Sequence[Any], applied: Sequence[bool], context: CallContext
) -> ListPlan | None:
    """The plan of a run; None where it is not made of passes: others draw for the pixels of a batch, or are found in it."""
    first = images[0]
    own = (
        first.shape[0],
        first.dtype,
        context.position,
        context.seed is None,
        context.once,
        context.output,
        context.is_certain,
        context.owners is None,
    )
    key = ("list run", *own, *applied, *map(id, modules))
    return context.plans.made(key, lambda: _make_plan(images, modules, applied, context))


def _make_plan(
    images: Sequence[Tensor], modules: Sequence[Any], applied: Sequence[bool], context: CallContext
) -> ListPlan | None:
    batch, channels = _ANY, images[0].shape[0]
    sized = find_sized(modules, applied, channels, context)
    if sized is None or not sized.has_same_draws:
        return None
    has_one_size, begins_with_batch = sized.own < len(modules), sized.own == 0
    like = images[0].detach().new_empty(1).expand(batch, channels, *SIZES[0])
    run, _ = plan_run(like, modules, context, context.position, sized.bound)
    if len(run.draws) > 1 or any(draws.learned is not None for draws in run.draws):
        return None
    steps = len(run.steps)  # which read lists: all, or those up to the one that gives one size
    if has_one_size:
        numbers_of = [[step.number] if isinstance(step, Alone) else step.geometric for step in run.steps]
        steps = 1 + next(i for i, numbers in enumerate(numbers_of) if sized.own in numbers)
    # The records of parts are made of passes; a batch from the first step on has its own.
    read = run.steps[:steps] if begins_with_batch and not context.once else run.steps
    if not all(takes_list(step, modules, like.dtype) for step in read):
        return None
    if context.output.memory_format is not None and not has_one_size:
        return None
    has_inputs = (
        begins_with_batch
        or any(  # others read sizes themselves
            not isinstance(s, Alone) or modules[s.number].warps_lists_by_matrix for s in run.steps[:steps]
        )
    )
    numbers = sized.numbers(has_inputs=has_inputs)
    draws, places = run.draws[0] if run.draws else None, list(sized.draws)
    if sized.count and has_inputs:
        places += [_count_draws(draws) + i for i in range(sized.count)]
        draws = _with_numbers(draws, sized.count)
    if draws is not None and not draws.plan[0]:  # nothing but a chance, which the host knows
        draws = None
    if draws is not None and (_count_draws(draws) > MAX_DRAWS or len(draws.numbers) > MAX_NUMBERS):
        return None
    identity = None
    if run.identity:
        identity = SizedNumbers.of(sized.reading.identity)
        if identity is None or len(identity.constant) != len(run.identity):
            return None
        identity = identity if identity.at(*SIZES[0]) != identity.at(*SIZES[1]) else None
    drawn: DrawnListPass | DrawnPass | None = None
    sized_draws = None
    if draws is not None and not isinstance(numbers, NumbersOfEach):
        sized_draws = SizedDraws(draws, places, _linear(numbers))
    first = run.steps[0] if run.steps else None
    if isinstance(first, Joined) and context.owners is None and not run.derives:
        if steps > 1 or not has_one_size:
            changes = sized.changes(first.geometric)
            if draws is not None or changes:
                of_pass = sized.numbers(draws is not None, then=first.geometric) if changes else numbers
                of_each = of_pass if isinstance(of_pass, NumbersOfEach) else _linear(of_pass)
                own = draws or _NO_DRAWS
                drawn = DrawnListPass(own, places, of_each, changes, first.image_pass, like.shape, like.dtype)
        elif begins_with_batch and isinstance(run.drawn, DrawnPass) and run.calls[0].number is not None:
            drawn = run.drawn if _draws_windows(sized) else None
    reads_executions = (
        run.derives or len(run.steps) > steps or any(isinstance(step, (Alone, Composition)) for step in run.steps)
    )
    flags = begins_with_batch, begins_with_batch or reads_executions
    of_labels = None if has_inputs else sized.numbers(has_draws=False)
    before = _steps_before(modules, run, sized) if run.derives else {}
    return ListPlan(run, sized, draws, places, numbers, drawn, sized_draws, *flags, identity, of_labels, before)


def _steps_before(modules: Sequence[Any], run: RunPlan, sized: Sized) -> dict[int, list[Alone]]:
    """Those that are applied before each augmentation that derives columns, one by one, as `with_derived` has them."""
    spans = [call.span for call in run.calls]
    chains = sized.bound(modules, spans, run.draws[0].plan[0] + run.derived_columns)
    steps: list[Alone] = []
    before: dict[int, list[Alone]] = {}
    for number, (module, call) in enumerate(zip(modules, run.calls)):
        if call.derived_from is not None:
            before[number] = [*steps]
        if call.applies:
            contribution = module._contribution(call.shape, module.flags)
            motion = None if contribution is None else contribution.motion
            own = () if motion is None else module._bound(motion.chain or (), call.span)
            steps.append(Alone(number, chains.get(number) or own))
    return before


def _draws_windows(sized: Sized) -> bool:
    """Whether nothing depends on the size of an image but windows that are drawn in it."""
    draws = zip(*map(sized.reading.draws, SIZES))
    return not sized.count and all(
        a.numbers == b.numbers or (a.kind in SIZED and a.numbers[:-2] == b.numbers[:-2]) for a, b in draws
    )


def takes_list(step: Step, modules: Sequence[Any], dtype: torch.dtype) -> bool:
    """Whether a step, of those of a run on images of a type, is one operator on the images of a list."""
    if isinstance(step, (Joined, Covering)):
        return True
    if isinstance(step, Composition):
        return not step.antialias and all(
            isinstance(link, MatrixPlan) or modules[link]._knows_maps_of_lists for link in step.links
        )
    for module in modules[: step.number]:
        dtype = module._result_dtype(dtype)
    takes: bool = modules[step.number]._operates_on(dtype)
    return takes


def _count_draws(draws: DrawPlan | None) -> int:
    """How many draws a plan has: what is left of it without the number of columns and the headers of requests."""
    return 0 if draws is None else sum(draws.plan[at + HEADER - 1] for at in _headers(draws.plan))


def _headers(plan: Sequence[int]) -> Iterator[int]:
    at = 1
    while at < len(plan):
        yield at
        at += HEADER + plan[at + HEADER - 1]


def _with_numbers(draws: DrawPlan | None, count: int) -> DrawPlan:
    """The same draws, and behind them columns of numbers."""
    more = make_plan([Request([Draw("number", (0.0,))] * count)])  # of the first key, which takes no part
    if draws is None:
        return DrawPlan(0, 1, more.plan, more.numbers, [], None)
    plan = [draws.plan[0] + count, *draws.plan[1:], *more.plan[1:]]
    return draws._replace(plan=plan, numbers=[*draws.numbers, *more.numbers])


def _linear(numbers: SizedNumbers | None) -> Tensor:
    return torch.empty(3, 0, dtype=torch.float64, device="cpu") if numbers is None else numbers.linear()


_NO_DRAWS = DrawPlan(0, 1, [0], [], [], None)


def with_numbers(
    columns: Tensor | None, numbers: SizedNumbers | NumbersOfEach, sides: Sequence[int], like: Tensor
) -> Tensor:
    """Columns of images like a batch, and behind them numbers of the sizes of each."""
    own = on_device(numbers.of_sides(sides).to(compute_dtype(like)), like.device)
    return own if columns is None else torch.cat([columns.to(own), own], 1)


# --- replays --------------------------------------------------------------------------------------------------------


class ReplayPlan(NamedTuple):
    """A run with given parameters on lists."""

    sized: Sized
    numbers: SizedNumbers | NumbersOfEach | None  # inputs of matrices


def kept_replay(
    images: Sequence[Tensor], children: Sequence[Child], applied: Sequence[bool], context: CallContext
) -> ReplayPlan | None:
    """The plan of a run with the parameters of its children; None where others replay it."""
    first = images[0]
    own = (first.shape[0], first.dtype, context.once, context.output)
    key = ("list replay", *own, *applied, *[id(child.module) for child in children])
    return context.plans.made(key, lambda: _make_replay(images, children, applied, context))


def _make_replay(
    images: Sequence[Tensor], children: Sequence[Child], applied: Sequence[bool], context: CallContext
) -> ReplayPlan | None:
    modules: list[Any] = [child.module for child in children]
    sized = find_sized(modules, applied, images[0].shape[0], context)
    if sized is None or context.output.memory_format is not None:
        return None
    each = [sized.reading.shapes(size) for size in SIZES]
    if any(m._executes_columns(a) != m._executes_columns(b) for m, a, b in zip(modules, *each)):
        return None
    return ReplayPlan(sized, sized.numbers(has_draws=False))


def columns_of_sizes(
    sized: Sized, children: Sequence[Child], executions: Sequence[Execution], columns: Tensor, sides: Sequence[int]
) -> Tensor:
    """The columns of given parameters, which are those of a size: of each image by its own where they depend on it.

    Whether they do is asked in each call: those of numbers that are 0, say, may be the same for all sizes, and others not.
    """

    def columns_at(size: Size, rows: Sequence[int], given: Sequence[Params], device: torch.device) -> Tensor:
        parts = []
        for child, params, execution, shape in zip(children, given, executions, sized.reading.shapes(size)):
            if execution.columns is not None:
                chosen = None if execution.chosen is None else (params["batch_prob"] > 0.5).to(device)
                module: Any = child.module
                parts.append(module._columns_of(params, (len(rows), *shape[1:]), device, chosen).drawn)
        return torch.cat(parts, 1) if parts else torch.empty(len(rows), 0, device=device)

    given, count, host = [child.params for child in children], len(sides) // 2, torch.device("cpu")
    on_host, least = [*map(_on_host, given)], (min(sides[::2]), min(sides[1::2]))
    probes = {size: columns_at(size, range(count), on_host, host) for size in (*SIZES, least)}
    one, *others = probes.values()
    if all(torch.equal(one, other) for other in others):
        return columns
    is_read = all(a is b for a, b in zip(on_host, given))
    at = host if is_read else columns.device
    own = columns_of_sides([columns_at(size, range(count), on_host, host) for size in CORNERS], probes, sides)
    if own is not None and not is_read:  # linear as those of other numbers are
        own = columns_of_sides([columns_at(size, range(count), given, at) for size in CORNERS], {}, sides)
    if own is None:
        if (
            not is_read and not torch.cuda.is_current_stream_capturing()
        ):  # waits once, in place of launches for each size
            given = [{k: x.cpu() if isinstance(x, Tensor) else x for k, x in params.items()} for params in given]
            at = host
        groups = numbers_by(zip(sides[::2], sides[1::2]))
        each = [
            columns_at(size, rows, [params_of_rows(params, rows, count) for params in given], at)
            for size, rows in groups.items()
        ]
        own = read_rows(torch.cat(each), sorted(range(count), key=[*chain(*groups.values())].__getitem__))
    return torch.cat([on_device(own, columns.device), columns[:, one.shape[1] :]], 1)  # those behind have one size


def _on_host(params: Params) -> Params:
    """Parameters that the host can read: in place of those on a device, for which it does not wait, any others."""
    is_there = any(isinstance(x, Tensor) and x.is_cuda for x in params.values())
    if not is_there:
        return params
    others = torch.Generator("cpu").manual_seed(0)  # that of torch is for what users draw
    return {
        k: torch.rand(x.shape, generator=others, device="cpu") if isinstance(x, Tensor) else x
        for k, x in params.items()
    }
