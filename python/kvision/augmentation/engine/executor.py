"""Execution of one augmentation: passes, methods that users override, replay, matrices and types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor

from kvision._ops import match_layout
from kvision.augmentation.columns import Columns, DrawPlan, Span
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.engine.configuration import kept
from kvision.augmentation.engine.contribution import Contribution
from kvision.augmentation.engine.declaration import Declaration
from kvision.augmentation.engine.drawing import Drawing, decides
from kvision.augmentation.engine.execution import (
    Execution,
    Params,
    Shape,
    check_maps_of_params,
    matrix_type,
)
from kvision.augmentation.keys import Seed
from kvision.augmentation.lists.conversions import bytes_of_float_images, in_type
from kvision.augmentation.samples import where_chosen
from kvision.augmentation.warp_and_color import SAME, Output, Pass, make_pass
from kvision.color.scale_shift import bytes_of_floats, floats_of_bytes
from kvision.geometry.transform.lists.arguments import like_batch, smallest_batch
from kvision.geometry.transform.lists.kept_sizes import Operation, Operations, OperationsOfSome


class CallPlan(NamedTuple):
    """The draws of a call on images of one shape, and the pass that executes the call, if a single pass can."""

    shape: Shape
    draws: DrawPlan | None
    is_certain: bool
    image_pass: Pass | None
    drawn: DrawnPass | None  # the draws and the pass by one operator


class Executor(Drawing):
    """Executes what a subclass declares.

    What one pass over the images executes is executed by it from the columns alone, and by one kernel with its draws where
    nothing else is asked for.
    """

    _execution: Execution | None = None  # of the last call

    # --- passes, planned once for images of a shape ---

    def _plan(self, x: Tensor, has_seed: bool) -> CallPlan:
        key = (x.shape, x.dtype, has_seed)
        plan: CallPlan | None = self._plans.get(key)
        if plan is None:
            shape = tuple(x.shape)
            draws = self._draws(shape, has_seed)
            applied = not decides(self) and self._applies(None, 0)
            span = None if draws is None else draws.spans[0]
            # Derived columns do not follow from the draws alone, so that no pass is planned with these.
            image_pass = None
            if applied and not self._derives:
                image_pass = self._pass_of(x.dtype, shape, span, self.flags)
            drawn = None if image_pass is None or draws is None else DrawnPass(draws, image_pass, shape, x.dtype)
            plan = CallPlan(shape, draws, self._is_certain, image_pass, drawn)
            if draws is None or draws.learned is None:
                self._plans.keep(key, plan)
        return plan

    def _pass_of(
        self, dtype: torch.dtype, shape: Shape, span: Span | None, flags: dict[str, Any], params: Params | None = None
    ) -> Pass | None:
        """The pass that executes this augmentation by columns on images of a type; None if there is no such pass."""
        motion, colors, _ = self._contribution(shape, flags) or Contribution()
        result = self._result_dtype(dtype)
        output = SAME if result == dtype else Output(result)
        if colors is not None:
            parts = [self._color_part(colors, span, self._constants(shape, params))]
            return make_pass(None, parts=parts, output=output)
        if motion is not None and motion.chain is not None and motion.reads_by_matrix:
            return make_pass(self._bound(motion.chain, span), motion.size, motion.resampling, output=output)
        return None

    def _kept_pass(self, dtype: torch.dtype, execution: Execution, flags: dict[str, Any]) -> Pass | None:
        """`_pass_of` an execution, cached for the flags of the constructor."""
        shape, params = execution.shape, execution.params
        span = None if execution.columns is None else execution.columns.span
        if flags is not self.flags:
            return self._pass_of(dtype, shape, span, flags, params)
        key = (dtype, shape, span, *self._constants(shape, params))
        return self._plans.made(key, lambda: self._pass_of(dtype, shape, span, flags, params))

    # --- execution ---

    def _draw_and_run(
        self, x: Tensor, seed: Seed, generator: Generator | None, flags: dict[str, Any], labels: Any = None
    ) -> tuple[Tensor, Execution]:
        """Draw parameters and execute with them. The execution is stored for `_params` and `transform_matrix`."""
        plan = self._plan(x, seed is not None)
        if plan.image_pass is None or flags is not self.flags:
            # Stored before it runs, because a user's method may add to `_params`; faster than Module.__setattr__.
            execution = self.__dict__["_execution"] = self._draw(x, seed, generator, labels)
            return self._run(x, execution, flags), execution
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
        self.__dict__["_execution"] = execution
        return y, execution

    def _replay_and_run(self, x: Tensor, params: Params, flags: dict[str, Any]) -> tuple[Tensor, Execution]:
        """Execute with given parameters."""
        execution = self._execution = self._from_params(params, x)  # before it runs, as above
        check_maps_of_params(self, params, x.shape[1], x.shape[-2:])
        return self._run(x, execution, flags), execution

    def _copied_pieces(self, execution: Execution) -> Tensor | None:
        """The pieces of images of which the results are copies, of the same size; None for all but some that mix samples."""
        return None

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Execute on images (B, C, H, W): by the methods that users override."""
        if not execution.applied:
            return x
        stored, result = x.dtype, self._result_dtype(x.dtype)
        needs_matrix = not self._needs_no_matrix()
        params = self._params_on_device(x, execution, for_users=needs_matrix)
        transform = self.compute_transformation(x, params, flags) if needs_matrix else None
        image = x
        if stored == torch.uint8 and (result != stored or not self.accepts_bytes):
            image = floats_of_bytes(x)
        elif execution.chosen is not None and self._is_overridden("apply_transform"):
            image = x.clone()  # which may write to it, and samples that are not chosen stay
        y = self.apply_transform(image, params, flags, transform)
        if result == torch.uint8 and y.dtype != torch.uint8:
            y = bytes_of_floats(y)
        elif y.dtype != result and result.is_floating_point:
            y = y.to(result)
        if y.dim() == 4 and y.shape == x.shape:
            y = match_layout(y, x)
        is_kept = self.keeps_unchosen and execution.params is None and not self._is_customized()
        is_kept = is_kept or ("_noise" in params and self.fuses_noise)
        if execution.chosen is not None and y.shape == x.shape and not is_kept:
            y = where_chosen(execution.chosen, y, x if result == stored else image)
            if transform is not None:
                identity = self.identity_matrix(x).to(transform)
                transform = torch.where(execution.chosen[:, None, None], transform, identity)
        execution.matrix = transform
        return y

    def _operation(self, like: Tensor, params: Params) -> Operation | Operations:
        """The operator that makes images like a batch the results, if :meth:`_operates_on` their type."""
        raise NotImplementedError(f"{type(self).__name__}._operation")

    def _operates_on(self, dtype: torch.dtype) -> bool:
        """Whether one operator is all that is done to images of a type, whatever is drawn, so that lists need no other call."""
        generator = self._param_generator
        is_per_pixel = generator is not None and generator.per_pixel
        return (
            type(self)._operation is not Executor._operation
            and not self._is_customized()
            and (self.filters_chosen or (self.fuses_noise if is_per_pixel else self.keeps_unchosen or self.fuses_noise))
            and self._result_dtype(dtype) == dtype
        )

    def _run_list(self, images: Sequence[Tensor], execution: Execution) -> list[Tensor]:
        """Execute on a list of images (C, H, W) of a type that it operates on."""
        if images[0].dtype == torch.uint8 and not self.accepts_bytes:
            return bytes_of_float_images(self._run_list(in_type(torch.float32, images), execution))
        like = smallest_batch(images) if self.filters_chosen else like_batch(images)
        columns = None if execution.is_certain else execution.columns
        chosen = execution.chosen if columns is None else columns.chosen
        chosen = None if chosen is None else chosen.float()
        return self._operation_on_list(images, like, execution).on_list(images, chosen)

    def _operation_on_list(
        self, images: Sequence[Tensor], like: Tensor, execution: Execution
    ) -> Operation | Operations | OperationsOfSome:
        """The operator for a list, like a batch: that of its images, or where it depends on their sizes another one."""
        return self._operation(like, self._params_on_device(like, execution, for_users=False))

    @kept
    def _needs_no_matrix(self) -> bool:
        """Whether positions are kept and no method is a user's: then the identity matrix is made only when it is read."""
        keeps_positions = type(self).compute_transformation is Declaration.compute_transformation
        return keeps_positions and not self._is_customized()

    def _matrix(self, execution: Execution) -> Tensor:
        if execution.matrix is None:
            of_list = execution.of_list
            execution.matrix = self._find_matrix(execution) if of_list is None else of_list.matrix(self._matrix)
        return execution.matrix

    def _find_matrix(self, execution: Execution) -> Tensor:
        """The matrices of a call that has kept none."""
        identity = self.identity_matrix(execution.shape)
        return identity if execution.identity is None else identity.to(*execution.identity)
