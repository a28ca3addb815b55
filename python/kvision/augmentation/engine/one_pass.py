"""Calls that one pass over the images executes, from columns alone: planned once for images of a shape."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor

from kvision.augmentation.columns import Columns, DrawPlan, Span
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.engine.execution import Execution, Shape, matrix_type
from kvision.augmentation.engine.executor import Engine
from kvision.augmentation.keys import Seed
from kvision.augmentation.warp_and_color import Pass


class CallPlan(NamedTuple):
    """The draws of a call on images of one shape, and the pass that executes the call, if a single pass can."""

    shape: Shape
    draws: DrawPlan | None
    is_certain: bool
    image_pass: Pass | None
    drawn: DrawnPass | None  # the draws and the pass by one operator


class OnePass(Engine):
    """Executes by one pass what has one, and by one kernel with its draws where nothing else is asked for."""

    def _plan(self, x: Tensor, has_seed: bool) -> CallPlan:
        key = (x.shape, x.dtype, has_seed)
        plan: CallPlan | None = self._plans.get(key)
        if plan is None:
            shape = tuple(x.shape)
            draws = self._draws(shape, has_seed)
            decides = self.whole_batch and 0 < self.p_batch < 1  # on the host, in each call
            applied = not decides and self._applies(None, 0)
            span = None if draws is None else draws.spans[0]
            image_pass = self._pass_of(x.dtype, shape, span, self.flags) if applied else None
            drawn = None if image_pass is None or draws is None else DrawnPass(draws, image_pass, shape, x.dtype)
            plan = CallPlan(shape, draws, self._is_certain, image_pass, drawn)
            if draws is None or draws.learned is None:
                self._plans.keep(key, plan)
        return plan

    def _pass_of(self, dtype: torch.dtype, shape: Shape, span: Span | None, flags: dict[str, Any]) -> Pass | None:
        """The pass that executes this augmentation by columns on images of a type."""
        image_pass, result = self._pass(shape, span, flags), self._result_dtype(dtype)
        return image_pass if image_pass is None or result == dtype else image_pass.giving(result)

    def _kept_pass(self, dtype: torch.dtype, shape: Shape, span: Span | None, flags: dict[str, Any]) -> Pass | None:
        """`_pass_of`, cached for the flags of the constructor."""
        if flags is not self.flags:
            return self._pass_of(dtype, shape, span, flags)
        key = (dtype, shape, span)
        kept: tuple[Pass | None] | None = self._plans.get(key)
        if kept is None:
            kept = (self._pass_of(dtype, shape, span, flags),)
            self._plans.keep(key, kept)
        return kept[0]

    def _draw_and_run(
        self, x: Tensor, seed: Seed, generator: Generator | None, flags: dict[str, Any]
    ) -> tuple[Tensor, Execution]:
        plan = self._plan(x, seed is not None)
        if plan.image_pass is None or flags is not self.flags:
            return super()._draw_and_run(x, seed, generator, flags)
        if plan.draws is None or plan.drawn is None:
            y, matrix = plan.image_pass.run(x, None)
            execution = Execution(plan.shape)
        else:
            keys = self._keys(x, seed, generator)
            y, matrix, drawn = plan.drawn.run(x, keys)
            columns = Columns(drawn, plan.draws.spans[0])
            execution = Execution(plan.shape, columns, None, True, None, (keys, 0), 1, plan.is_certain)
        if plan.image_pass.warps:
            execution.keep_matrix(matrix)
        if execution.matrix is None:
            execution.identity = matrix_type(x)
        self.__dict__["_execution"] = execution  # faster than Module.__setattr__, which looks for parameters
        return y, execution
