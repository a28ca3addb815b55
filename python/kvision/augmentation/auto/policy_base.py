"""What policies share: one choice a sample, drawn with its values, and executed without a loop over samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision import _check
from kvision._choices import MatrixMode
from kvision._ops import FastPath
from kvision.augmentation.auto.operation_table import OPERATIONS, execute_steps, execute_steps_on_list
from kvision.augmentation.auto.policy_parts import Drawn, PolicyParts
from kvision.augmentation.columns import DrawPlan, fits_one_launch, plan_draws
from kvision.augmentation.draws import MAX_DRAWS, Draw, Request
from kvision.augmentation.engine import (
    CallContext,
    Chain,
    ImageSequential,
    ParamItem,
    Record,
    check_batch_of_params,
    check_images,
    checked_items,
)
from kvision.augmentation.keys import Seed, check_seeds, draw_keys
from kvision.constants import DataKey
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import check_list, like_batch

__all__ = ["PolicyAugmentBase"]

LEVELS = 30  # the highest level of magnitude; the lowest is 0
_MODES = get_args(MatrixMode)

_choose_operations = FastPath("choose_operations", (torch.float32,))


class Entry(NamedTuple):
    """An operation of a sub-policy: its probability, and its values at the lowest and the highest level."""

    name: str
    probability: float
    low: float
    high: float


class PolicyAugmentBase(ImageSequential):
    """Base of the policies: each sample gets one of some sub-policies, whose operations run one after the other.

    The choices and the values of all samples are drawn at once, and one kernel runs a step on the batch, each sample's
    operation alone, so that nothing waits for the device; another one has its gradient. For images of float64, an operation runs
    on the whole batch, without effect on samples with another one. Color leaves images of other than three channels as they
    are, and contrast is about the mean of all their channels.

    Values in which an operation has a direction (rotate, shear, translate) or a neutral factor (color, contrast,
    brightness, sharpness) are mirrored about the value that changes nothing for a random half of the samples.

    Args:
        policy: sub-policies: lists of entries (name, probability, low, high). A level between 0 and 30 is drawn for each
            sample, and the value is `low` at level 0 and `high` at level 30.
        transformation_matrix_mode: 'skip' for a `transform_matrix` of None; 'silent' and 'rigid' are the same, as all operations
            have matrices.
        count: how many sub-policies each sample gets, each drawn for itself.
        same_on_batch: all samples get the same operations and values.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and the product of the matrices.

    Raises:
        TypeError: an entry does not have the form in Args; `count` is not an int.
        ValueError: the policy is empty; `count` is below 1; an operation is unknown; a probability is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> policy = [[("invert", 1.0, 0.0, 0.0)], [("brightness", 1.0, 1.0, 1.0)]]
        >>> augment = K.augmentation.auto.PolicyAugmentBase(policy)
        >>> augment(torch.ones(8, 3, 1, 1), seed=1).amax((1, 2, 3)).unique()
        tensor([0., 1.])
    """

    _top_level = LEVELS  # levels from 0 to this one are drawn
    _draws_choices = True

    def __init__(
        self,
        policy: Sequence[Sequence[Sequence[Any]]],
        transformation_matrix_mode: MatrixMode = "silence",
        *,
        count: int = 1,
        same_on_batch: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        if same_on_batch is not None:
            same_on_batch = _check.switch(type(self).__name__, "same_on_batch", same_on_batch)
        if generator is not None and not isinstance(generator, torch.Generator):
            raise TypeCheckError(
                f"{type(self).__name__}: expected generator to be a torch.Generator, got {generator!r}"
            )
        super().__init__(same_on_batch=same_on_batch, generator=generator, return_transform=return_transform)
        op = type(self).__name__
        _check.choice(op, "transformation_matrix_mode", transformation_matrix_mode, _MODES)
        count = check_integer(op, "count", count)
        if count < 1:
            raise ValueCheckError(f"{op}: expected count of at least 1, got {count}")
        self.transformation_matrix_mode, self.count = transformation_matrix_mode, count
        self.policy = [[_entry(op, entry) for entry in part] for part in sub_policies(op, policy)]
        if not self.policy or not all(self.policy):
            raise ValueCheckError(f"{op}: expected policy to be sub-policies with at least one operation each")
        self._length = max(len(part) for part in self.policy)
        # By sub-policy and step: number of the operation, probability, lowest and highest value, neutral value.
        rows = [[_row(part[i] if i < len(part) else None) for i in range(self._length)] for part in self.policy]
        self._table = torch.tensor(rows, dtype=torch.float32, device="cpu")
        names = [{part[i].name for part in self.policy if i < len(part)} for i in range(self._length)]
        self._names = [tuple(sorted(of_step)) for of_step in names] * count

    def extra_repr(self) -> str:
        return f"{len(self.policy)} sub-policies, count={self.count}"

    # --- drawing ---

    def _request(self) -> Request:
        """For each sub-policy of a sample its index, then for each of its operations chance, level and mirroring."""
        choice = Draw("integer", (0, 1, len(self.policy), 0))
        level = Draw("integer", (0, 1, self._top_level + 1, 0))
        step = [Draw("uniform", (0.0, 1.0, 0.0)), level, Draw("integer", (0, 1, 2, 0))]
        return Request([choice, *step * self._length] * self.count, same_on_batch=bool(self.same_on_batch))

    def _draw(self, x: Tensor, context: CallContext) -> Drawn:
        keys = draw_keys(context.op, 1, x.device, context.seed_of_samples, context.generator_of(self))
        (plan,) = self._plan(keys.has_seed, context.position if keys.has_seed else 0)
        check_seeds(context.op, keys, len(range(0, len(x), context.frames)))
        drawn = plan.draw(x[:: context.frames], keys)
        if context.frames > 1:
            drawn = drawn.repeat_interleave(context.frames, 0)
        return self._of_columns(drawn)

    def _of_columns(self, columns: Tensor) -> Drawn:
        """What the columns (B, P) of the request say."""
        top, table = float(max(self._top_level, 1)), self._table
        if table.device != columns.device:
            table = table.to(columns.device)
            if not is_compiling():  # a graph changes no settings
                self._table = table
        if _choose_operations.serves(columns):
            return Drawn(*_choose_operations.kernel(columns, table, self.count, top))
        columns = columns.unflatten(1, (self.count, 1 + 3 * self._length))
        number, probability, low, high, neutral = table[columns[..., 0].long()].unbind(-1)
        chance, level, mirrored = columns[..., 1:].unflatten(-1, (self._length, 3)).unbind(-1)
        value = low + (high - low) * level / top
        value = torch.where((mirrored > 0.5) & ~neutral.isnan(), 2 * neutral - value, value)
        operation = torch.where(chance < probability, number, -1.0).long()
        return Drawn(operation.flatten(1), value.flatten(1))

    def _check_draws(self, arguments: str) -> None:
        """Raise unless one launch draws all that a sample gets."""
        request = self._request()
        if not fits_one_launch(request):
            raise ValueCheckError(
                f"{type(self).__name__}: expected {arguments} to take at most {MAX_DRAWS} random numbers a sample, got "
                f"{len(request.draws)}"
            )

    def _plan(self, has_seed: bool, position: int) -> Sequence[DrawPlan]:
        key = ("draw", has_seed, position, bool(self.same_on_batch))
        plan: list[DrawPlan] | None = self._plans.get(key)
        if plan is None:
            plan = plan_draws([self._request()], has_seed, position)
            self._plans.keep(key, plan)
        return plan

    def _redrawn(self, params: Sequence[ParamItem], x: Tensor) -> Drawn:
        """What was drawn for an earlier call, from its parameters."""
        if len(checked_items(type(self).__name__, params, "data")) != self.count * self._length:
            raise ValueCheckError(
                f"{type(self).__name__}: expected params of {self.count * self._length} steps, got {len(params)}"
            )
        operation, value = (torch.stack([item.data[key] for item in params], 1) for key in ("operation", "magnitude"))
        check_batch_of_params(type(self).__name__, len(operation), len(x))
        return Drawn(operation.to(x.device), value.to(x.device))

    def _items(self, record: Record) -> list[Any]:
        """What each step of a call did: numbers of operations, -1 for none, and their magnitudes, on the CPU."""
        drawn, items = record.drawn, []
        if drawn is None:
            return []
        shape = torch.tensor(record.shape, device="cpu")
        for i, (operation, value) in enumerate(zip(drawn.operation.cpu().unbind(1), drawn.value.cpu().unbind(1))):
            data = {"operation": operation, "magnitude": value, "batch_prob": (operation >= 0).float()}
            items.append(ParamItem(f"step_{i}", {**data, "forward_input_shape": shape}))
        return items

    def forward_parameters(self, batch_shape: Sequence[int]) -> list[ParamItem]:
        """Draw the parameters of a call on images of a shape, without executing it."""
        drawn = self._draw(torch.empty(batch_shape[0], device="cpu"), self._context(None, None))
        self._keep(Record(tuple(batch_shape), drawn=drawn))
        return self._params

    # --- execution ---

    def _sizes_after(self, sizes: Any) -> Any:
        return sizes

    def _execute(self, x: Tensor, params: Sequence[ParamItem] | None, context: CallContext) -> tuple[Tensor, Record]:
        drawn = self._draw(x, context) if params is None else self._redrawn(params, x)
        y, stages = self._run(x, drawn)
        return y, Record(tuple(x.shape), (), stages, drawn=drawn, size=tuple(y.shape[2:]))

    def _call_list_by_passes(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Any], Record]:
        y, parts = self._execute_list(inputs[0], params, self._context(seed, generator))
        return [y], Record(parts=parts)

    def _execute_list(
        self, images: list[Tensor], params: Sequence[ParamItem] | None, context: CallContext
    ) -> tuple[list[Tensor], PolicyParts]:
        """The results on a list of images of any sizes, and its parts. The draws are those of a batch."""
        images = check_list(context.op, "input", images)
        like = like_batch(images)
        drawn = self._draw(like, context) if params is None else self._redrawn(params, like)
        y, matrices = self._run_list(images, drawn)
        return y, PolicyParts(context.op, images, drawn, matrices)

    def _run_list(self, images: Sequence[Tensor], drawn: Drawn) -> tuple[list[Tensor], list[Tensor]]:
        """Execute what was drawn for the images (C, H, W) of a list; gives these, and the matrices (B, 3, 3) of steps."""
        return execute_steps_on_list(images, self._names[: drawn.operation.shape[1]], drawn.operation, drawn.value)

    def _run(self, x: Tensor, drawn: Drawn) -> tuple[Tensor, Chain]:
        """Execute what was drawn; gives the images, and what labels have to follow."""
        check_images(type(self).__name__, x.shape)
        y, stages = execute_steps(x, self._names[: drawn.operation.shape[1]], drawn.operation, drawn.value)
        return y, Chain(stages)

    def get_transformation_matrix(
        self,
        input: Tensor,
        params: Sequence[ParamItem] | None = None,
        recompute: bool = False,
        extra_args: dict[Any, Any] | None = None,
    ) -> Tensor | None:
        if params is None and not recompute:
            return self.transform_matrix
        x = self.transform_tensor(input)
        if isinstance(x, list):
            return super().get_transformation_matrix(input, params, recompute, extra_args)
        stages = self._run(x, self._redrawn(params or self._params, x))[1]
        return self._matrix(Record(tuple(x.shape), (), stages))

    def is_intensity_only(self, strict: bool = True) -> bool:
        return all(OPERATIONS[name].neutral != 0 for names in self._names for name in names)


def check_integer(op: str, name: str, value: Any) -> int:
    """An int, or an integer of NumPy or torch, as an int."""
    value = _check.scalar(op, name, value)
    if not isinstance(value, int) or isinstance(value, bool):
        raise TypeCheckError(f"{op}: expected {name} to be an int, got {value!r}")
    return value


def sub_policies(op: str, policy: Any) -> Sequence[Sequence[Any]]:
    """A policy, if it is a sequence of sequences."""
    for part in (policy, *policy) if isinstance(policy, Sequence) else (policy,):
        if isinstance(part, str) or not isinstance(part, Sequence):
            raise TypeCheckError(f"{op}: expected policy to be sub-policies, lists of entries, got {policy!r}")
    checked: Sequence[Sequence[Any]] = policy
    return checked


def _entry(op: str, entry: Sequence[Any]) -> Entry:
    """An entry that was checked."""
    if isinstance(entry, str) or not isinstance(entry, Sequence) or len(entry) != 4:
        raise TypeCheckError(f"{op}: expected entries of a policy to be (name, probability, low, high), got {entry!r}")
    name, probability, low, high = entry
    if name not in OPERATIONS:
        raise ValueCheckError(f"{op}: expected operations to be one of {', '.join(OPERATIONS)}, got {name!r}")
    probability = _check.fraction(op, f"the probability of {name!r}", probability)
    low, high = (_check.number(op, f"the values of {name!r}", value) for value in (low, high))
    return Entry(name, probability, low, high)


def _row(entry: Entry | None) -> list[float]:
    """The row of an entry in the table; of None for a step that a sub-policy has not."""
    if entry is None:
        return [-1.0, 0.0, 0.0, 0.0, float("nan")]
    operation = OPERATIONS[entry.name]
    neutral = float("nan") if operation.neutral is None else operation.neutral
    return [float(operation.number), entry.probability, entry.low, entry.high, neutral]
