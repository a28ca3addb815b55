"""The base of containers that choose the children of each sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision.augmentation.columns import DrawPlan, plan_draws
from kvision.augmentation.draws import Draw, Request, uniform
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.image_sequential import ImageSequential
from kvision.augmentation.engine.record import ParamItem
from kvision.augmentation.engine.sized import SIZES, Sizes, sizes_after
from kvision.augmentation.engine.turns import Turn
from kvision.augmentation.keys import check_seeds, draw_keys, refuse_capture, refuse_graphs, refuse_mapped
from kvision.core.exceptions import TypeCheckError, ValueCheckError

_CHOICE = 1 << 20  # the position in the chain of draws that choose children, behind those of all augmentations


class ChoiceBase(ImageSequential):
    """Base of the containers that choose children for each sample.

    The host draws the choices, so that nothing waits for the device and no child runs that no sample has. The samples that get a
    child are one batch, with draws of their own. Of images that children change in size, all samples must have one size in the end.

    Args:
        *children: augmentations, other containers, or any modules of images that do not mix samples; or one list of them.
        p: probability that a sample gets children at all.
        same_on_batch: all samples get the same children and parameters.
        keepdim: if not None, that of all children.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the image and the product of the matrices.
    """

    chooses_for_samples = _draws_choices = True
    _positional: ClassVar[tuple[str, ...]] = ("p",)  # settings that may follow a list of children
    children_are_certain = False  # a chosen child is executed, whatever its own p says

    def __init__(
        self,
        *children: Any,
        p: float = 1.0,
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        op, own = type(self).__name__, {"p": p}
        modules = positional(op, children, self._positional, own)
        options: dict[str, Any] = {
            "same_on_batch": same_on_batch,
            "keepdim": keepdim,
            "return_transform": return_transform,
            "generator": generator,
        }
        super().__init__(*modules, **options)
        self.p = _check.fraction(op, "p", own["p"])
        self._keep_arguments(**own, **options)
        if not modules:
            raise ValueCheckError(f"{op}: expected at least one child")
        for module in self.modules():
            if getattr(module, "mixes_samples", False):
                raise ValueCheckError(
                    f"{op}: expected children that keep samples apart, got {type(module).__name__}; "
                    "ImageSequential(..., random_apply=1) chooses one for the whole batch"
                )

    def _keep_arguments(self, **settings: Any) -> None:
        """Keep the arguments by name, and the children as they are, however they were passed."""
        self.__dict__["_arguments"] = (tuple(self.children()), settings)

    def extra_repr(self) -> str:
        return f"p={self.p}"

    # --- what subclasses say ---

    def _draws(self) -> list[Draw]:
        """What is drawn for a sample that gets children."""
        return []

    def _sequences_of(self, drawn: Sequence[Sequence[float]]) -> list[tuple[int, ...]]:
        """The numbers of the units that samples get, one after the other, for what was drawn for each behind its first number."""
        raise NotImplementedError

    # --- lists ---

    @property
    def _always_chooses(self) -> bool:
        return self.children_are_certain and self.p == 1

    def _sizes_after(self, sizes: Sizes) -> Sizes | None:
        after = [sizes_after(module, sizes) for module in self.children()]
        expected = after[0] if self._always_chooses else sizes
        return expected if all(own == expected for own in after) else None

    # --- a call ---

    def _chooses_for_samples(self, context: CallContext) -> bool:
        return True

    def _in_turns(self, x: Any, params: Sequence[Any] | None, context: CallContext) -> tuple[list[Turn], CallContext]:
        if params is not None:
            turns = self._turns_of_params(self._children_of_call(params, context), len(x))
            return turns, context._replace(is_certain=False)
        if context.frames == 1 and context.time:  # frames with parameters of their own are samples
            context = context._replace(seed=context.seed_of_samples, time=0)
        in_turns = super()._in_turns(x, None, context)
        assert in_turns is not None
        shape = tuple(x.shape) if isinstance(x, Tensor) else (len(x), x[0].shape[0], *SIZES[0])
        turns = self._joined(in_turns[0], shape, context.position)
        return turns, context._replace(is_certain=self.children_are_certain)

    def _joined(self, turns: list[Turn], shape: tuple[int, ...], position: int) -> list[Turn]:
        """The turns of a call on images of a shape, with those in one that are one pass."""
        return turns

    def _sequences_of_samples(self, context: CallContext, samples: int) -> Sequence[Sequence[int]]:
        op = type(self).__name__
        refuse_graphs(op)
        refuse_capture(op)
        keys = draw_keys(op, 1, torch.device("cpu"), context.seed, context.generator_of(self))
        refuse_mapped(op, keys.keys if keys.seeds is None else keys.seeds)
        check_seeds(op, keys, samples)
        keys = keys.cpu()
        position = context.position + _CHOICE if keys.has_seed else 0
        plan = self._plans.made(("choice", keys.has_seed, position), lambda: self._draw_plan(keys.has_seed, position))
        rows = plan.draw(torch.empty(samples, device="cpu"), keys).tolist()
        p = 1.0 if context.is_certain else self.p
        sequences = self._sequences_of(rows)
        return sequences if p == 1 else [own if row[0] < p else () for own, row in zip(sequences, rows)]

    def _draw_plan(self, has_seed: bool, position: int) -> DrawPlan:
        request = Request([uniform(0.0, 1.0), *self._draws()], same_on_batch=bool(self.same_on_batch))
        return plan_draws([request], has_seed, position)[0]

    def _inside(self, context: CallContext) -> CallContext:
        return super()._inside(context)._replace(is_certain=context.is_certain)

    def forward_parameters(self, batch_shape: Sequence[int]) -> list[ParamItem]:
        """Draw the parameters of a call on images of a shape, by a call on black ones, whose sizes depend on what is drawn."""
        images = torch.zeros(1, device="cpu").expand(tuple(batch_shape))
        return self._read_params(self._execute(images, None, self._context(None, None))[1])


def positional(
    op: str, arguments: Sequence[Any], names: Sequence[str], settings: dict[str, Any]
) -> Sequence[nn.Module]:
    """The children of a container that takes them as arguments, or as one list, and then settings by their positions.

    `settings` are those by name, and get those by position.
    """
    if not arguments or not isinstance(arguments[0], (list, tuple, nn.ModuleList)):
        return arguments
    children, *rest = arguments
    if len(rest) > len(names):
        raise TypeCheckError(
            f"{op}: expected at most {len(names)} arguments behind the list of children, got {len(rest)}"
        )
    settings.update(zip(names, rest))
    return list(children)
