"""What a call of one augmentation draws or is given: keys, columns and parameters by name."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import torch
from torch import Generator, Tensor
from torch.compiler import is_compiling

from kvision.augmentation.columns import Columns, DrawPlan, Span, draw_columns, plan_draws
from kvision.augmentation.draws import is_chosen_batch
from kvision.augmentation.engine.declaration import Declaration, size_of
from kvision.augmentation.engine.execution import (
    Execution,
    Params,
    Shape,
    check_batch_of_params,
    matrix_type,
    replaying,
)
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys
from kvision.augmentation.noise import PixelNoise
from kvision.geometry.transform.lists.arguments import sizes


class Drawing(Declaration):
    """Draws the parameters of a call, or takes given ones."""

    # --- drawing ---

    def _applies(self, keys: Keys | None, index: int) -> bool:
        """Whether the batch may be augmented: False only if that is known on the host."""
        if self.p == 0 or self.p_batch == 0:
            return False
        if not self.whole_batch or self.p_batch == 1 or keys is None:
            return True
        key = keys.on_host(type(self).__name__)[0 if keys.has_seed else index]
        return is_chosen_batch(key, index if keys.has_seed else 0, self.p_batch)

    def _keys(self, x: Tensor, seed: Seed, generator: Generator | None) -> Keys:
        op = type(self).__name__
        keys = draw_keys(op, 1, x.device, seed, generator or self.generator)
        if keys.seeds is not None:
            check_seeds(op, keys, x.shape[0])
        return keys

    def _draws(self, shape: Shape, has_seed: bool, is_certain: bool = False) -> DrawPlan | None:
        """The launch that draws for images of a shape, kept for them; None for nothing."""
        key = ("draws", shape, has_seed, is_certain)
        kept: tuple[DrawPlan | None] | None = self._plans.get(key)
        if kept is not None:
            return kept[0]
        request = self._request(shape, is_certain) if may_apply(self, is_certain) else None
        draws = None if request is None else plan_draws([request], has_seed)[0]
        if draws is None or draws.learned is None:
            self._plans.keep(key, (draws,))
        return draws

    def _draw(
        self, x: Tensor, seed: Seed, generator: Generator | None, labels: Any = None, is_certain: bool = False
    ) -> Execution:
        """Draw the columns of a call, by its labels where the draw reads some; `is_certain` stands for p = p_batch = 1."""
        shape, is_certain = tuple(x.shape), is_certain or self._is_certain
        draws = self._draws(shape, seed is not None, is_certain)
        if draws is None:
            execution = Execution(shape, applied=is_certain or self._applies(None, 0))
        else:
            keys = self._keys(x, seed, generator)
            drawn, applied = Columns(draws.draw(x, keys), draws.spans[0]), is_certain or self._applies(keys, 0)
            execution = Execution(shape, drawn, applied=applied, redraw=(keys, 0), is_certain=is_certain)
            if self._derives:
                execution.redraw = None
                execution.columns = self._derived(drawn, size_of(shape, drawn.drawn), labels) if applied else None
        execution.identity = matrix_type(x)
        return execution

    # --- parameters by name ---

    def _read_params(self, execution: Execution) -> Params:
        if execution.params is None:
            of_list = execution.of_list
            execution.params = self._find_params(execution) if of_list is None else of_list.params(self._read_params)
        return execution.params

    def _find_params(self, execution: Execution) -> Params:
        """The parameters that a call has drawn."""
        shape, columns, redraw = execution.shape, execution.columns, execution.redraw
        if columns is not None and columns.drawn.is_cuda:
            columns = self._columns_on_host(execution) or columns
            redraw = None if redraw is None else (redraw[0].cpu(), redraw[1])
        chosen = torch.full((shape[0],), float(execution.applied), device="cpu")
        if columns is not None and columns.chosen is not None:
            chosen = columns.chosen.detach().cpu() * chosen
        params: Params = {}
        if self._param_generator is not None and not self._draws_by_name:
            if columns is None:  # nothing was drawn, as at p = 0: what stands for samples that are not chosen
                values = self._identity_values(shape, torch.empty(0, dtype=torch.float32, device="cpu")).expand(
                    shape[0], -1
                )
            else:
                values = columns.values.detach()
            params = self._named(values, execution)
            if self._param_generator.per_pixel:
                redraw = redraw or (draw_keys(type(self).__name__, 1, values.device, 0, None), 0)
                noise = self._pixel_noise(execution, redraw, values.device)
                params.update(self._pixel_params(values, execution, noise))
        params["batch_prob"] = chosen
        params["forward_input_shape"] = torch.tensor(shape, device="cpu")
        return self._as_given(params)

    def _as_given(self, params: Params) -> Params:
        """Parameters where and in which type `_params` are given."""
        device, dtype = self._rng
        return {
            name: x.to(device, dtype if x.is_floating_point() else None) if isinstance(x, Tensor) else x
            for name, x in params.items()
        }

    def _named(self, values: Tensor, execution: Execution) -> Params:
        """Parameters by name from their columns (B, P)."""
        generator = self._param_generator
        assert generator is not None
        return generator.to_params(values, execution.shape)

    def _values_on_host(self, execution: Execution) -> Tensor:
        """The values (B, P) for decisions of the host, without waiting for what the device has drawn."""
        assert execution.redraw is not None
        execution.redraw[0].on_host(type(self).__name__)  # which raises where it cannot be read
        columns = self._columns_on_host(execution)
        assert columns is not None
        return columns.values

    def _columns_on_host(self, execution: Execution) -> Columns | None:
        """The columns drawn again: the same numbers, which wait for nothing but keys on the device. None where there were none."""
        request = self._request(execution.shape, execution.is_certain)
        if request is None or execution.redraw is None:
            return None
        (keys, index), frames = execution.redraw, execution.frames
        images = torch.empty(execution.shape[0] // frames, device="cpu")
        (columns,) = draw_columns(images, keys.cpu(), [request], index)
        return columns if frames == 1 else columns._replace(drawn=columns.drawn.repeat_interleave(frames, 0))

    def _params_on_device(self, x: Tensor, execution: Execution, for_users: bool = True) -> Params:
        if execution.params is not None:
            return self._on_device(execution.params, x.device)
        if self._draws_by_name:
            execution.params = {**self._read_params(execution), **self.generate_parameters(execution.shape)}
            return self._on_device(execution.params, x.device)
        params: Params = {"forward_input_shape": torch.tensor(execution.shape, device="cpu")} if for_users else {}
        generator = self._param_generator
        if execution.columns is None or generator is None:
            return params
        values = execution.columns.values
        params.update(self._named(values, execution))
        if generator.per_pixel and (execution.redraw or execution.noise):
            noise = self._pixel_noise(execution, execution.redraw, x.device)
            is_fused = self.fuses_noise and execution.frames == 1 and not self._draws_maps(x.dtype)
            if is_fused and not self._is_customized():
                chosen = None if execution.is_certain else execution.columns.chosen
                params["_noise"] = (values, noise._replace(chosen=chosen))
            else:
                params.update(self._pixel_params(values, execution, noise))
        return params

    def _draws_maps(self, dtype: torch.dtype) -> bool:
        """Whether images of a type get the numbers of pixels of `_params`, float32, and not those that its operator draws."""
        generator = self._param_generator
        if generator is None or not generator.per_pixel or generator.is_exact:
            return False
        return self.fuses_noise and dtype == torch.float64

    def _with_maps(self, images: Sequence[Tensor], execution: Execution) -> Execution:
        """The execution on a list, with numbers of pixels as parameters where it draws maps of them."""
        if execution.params is not None or execution.columns is None or not self._draws_maps(images[0].dtype):
            return execution
        own, generator, values = copy(execution), self._param_generator, execution.columns.values
        assert generator is not None
        noise = self._pixel_noise(execution, execution.redraw, images[0].device)
        maps = generator.pixel_params(values, (*execution.shape[:2], *sizes(images)), noise)
        own.params = {**self._named(values, execution), **maps}
        return own

    def _drawn_params(self, x: Tensor, execution: Execution) -> Params:
        """The same without numbers of pixels, but those that are given."""
        if execution.params is not None or execution.columns is None or self._draws_by_name:
            return self._params_on_device(x, execution, for_users=False)
        return self._named(execution.columns.values, execution)

    def _pixel_noise(self, execution: Execution, redraw: tuple[Keys, int] | None, device: torch.device) -> PixelNoise:
        """The source of the numbers of pixels."""
        if execution.noise is not None:
            return execution.noise._replace(device=device)
        assert redraw is not None
        return PixelNoise(*redraw, self.same_on_batch, device)

    def _pixel_params(self, values: Tensor, execution: Execution, noise: PixelNoise) -> Params:
        """The parameters with numbers of their own for each pixel, the same for the frames of a video."""
        assert self._param_generator is not None
        shape, frames = execution.shape, execution.frames
        if frames == 1:
            return self._param_generator.pixel_params(values, shape, noise)
        drawn = self._param_generator.pixel_params(values[::frames], (shape[0] // frames, *shape[1:]), noise)
        return {name: x.repeat_interleave(frames, 0) for name, x in drawn.items()}

    @staticmethod
    def _on_device(params: Params, device: torch.device) -> Params:
        return {name: x.to(device) if isinstance(x, Tensor) else x for name, x in params.items()}

    # --- replay ---

    def _from_params(self, params: Params, x: Tensor) -> Execution:
        """An execution that replays given parameters."""
        shape = tuple(x.shape)
        chosen = params.get("batch_prob")
        applied = True
        if chosen is None:
            params = {**params, "batch_prob": torch.ones(shape[0], device="cpu")}
        else:
            check_batch_of_params(type(self).__name__, len(chosen), shape[0])
            chosen = chosen > 0.5
            if chosen.device.type == "cpu" and not is_compiling():
                applied = bool(chosen.any()) or shape[0] == 0 or self._was_planned(params)
                chosen = None if bool(chosen.all()) else chosen
            chosen = None if chosen is None else chosen.to(x.device)
        if "forward_input_shape" not in params:
            params = {**params, "forward_input_shape": torch.tensor(shape, device="cpu")}
        columns = None
        if applied and not self._is_customized() and self._executes_columns(shape):
            columns = self._columns_of(params, shape, x.device, chosen)
        execution = Execution(shape, columns, chosen, applied, params)
        execution.identity = matrix_type(x)
        return execution

    def _was_planned(self, params: Params) -> bool:
        """Whether a call with these parameters planned for this augmentation, although no sample was chosen.

        What is joined with neighbors takes part in their pass, which has to be the same in a replay.
        """
        if self.whole_batch or self.p == 0 or self.p_batch == 0 or self._is_customized():
            return False
        generator = self._param_generator
        has_names = generator is not None and generator.has_names
        return not has_names or not params.keys() <= {"batch_prob", "forward_input_shape"}

    def _columns_of(self, params: Params, shape: Shape, device: torch.device, chosen: Tensor | None) -> Columns | None:
        """The columns that would have been drawn for given parameters."""
        if self._param_generator is None:
            values = torch.empty(shape[0], 0, device=device)
        else:
            with replaying(type(self).__name__, params):
                values = self._param_generator.to_columns(self._on_device(params, device), shape).to(device)
        if values.dtype != torch.float64:
            values = values.float()
        parts = [values, *self._further_columns(shape, values, chosen)]
        if chosen is not None and not self.whole_batch:
            parts[0] = torch.where(chosen[:, None], values, self._identity_values(shape, values))
            parts.insert(0, chosen[:, None].to(values.dtype))
        drawn = torch.cat(parts, 1) if len(parts) > 1 else values
        return Columns(drawn, Span(0, drawn.shape[1], len(parts) > 1 and parts[0] is not values and chosen is not None))


def decides(module: Drawing) -> bool:
    """Whether the host decides in each call if a batch is augmented, whose size changes."""
    return module.whole_batch and 0 < module.p_batch < 1


def may_apply(module: Drawing, is_certain: bool) -> bool:
    """Whether a call may augment anything, by the chances of its module."""
    return is_certain or (module.p > 0 and module.p_batch > 0)
