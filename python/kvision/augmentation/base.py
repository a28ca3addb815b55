"""The engine of augmentations: probabilities, parameters, replay, matrices, types and ranks, once for all classes.

An augmentation declares what it draws (a generator of random_generator) and one of three effects:

    transforms   a chain of matrix formulas of the drawn columns: the image, masks, boxes and points follow the matrix
    color steps  a part of a color program
    an operator  `apply_transform`, on the parameters by name

The first two are executed from the columns of the drawing operator without parameters by name in between; containers
join those of neighbors. A subclass that overrides `generate_parameters`, `compute_transformation` or `apply_transform` is
executed through them.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Generator, Tensor, nn

from kvision._ops import match_layout
from kvision.augmentation.columns import Columns, DrawPlan, Span, draw_columns, identity_values, plan_draws
from kvision.augmentation.configuration import Flags, Plans, settings_changed
from kvision.augmentation.drawn_pass import DrawnPass
from kvision.augmentation.draws import Draw, Request, is_chosen_batch
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys
from kvision.augmentation.maps import exact
from kvision.augmentation.noise import PixelNoise
from kvision.augmentation.random_generator.base import RandomGeneratorBase
from kvision.augmentation.warp_and_color import Pass
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

Shape = tuple[int, ...]
Params = dict[str, Any]
_OVERRIDABLE = ("compute_transformation", "apply_transform")


class Execution:
    """One call of an augmentation: what was drawn, for `_params`, `transform_matrix`, labels, inverse and replay."""

    def __init__(
        self,
        shape: Shape,
        columns: Columns | None = None,
        chosen: Tensor | None = None,
        applied: bool = True,
        params: Params | None = None,
        redraw: tuple[Keys, int] | None = None,
        frames: int = 1,
        is_certain: bool = False,
    ) -> None:
        self.shape = shape  # of the images, (B, C, H, W)
        self.columns = columns  # of the parameters, on their device
        self._chosen = chosen
        self.applied = applied  # False where the whole batch passes unchanged
        self.params = params  # by name, where they were given or have been read
        self.redraw = redraw  # the keys, and the index of this augmentation's
        self.frames = frames  # neighboring samples that share what was drawn
        self.is_certain = is_certain  # all samples are chosen, which is known without the columns
        self.matrix: Tensor | None = None
        # Device and type of identity matrices, if these are made only when they are read.
        self.identity: tuple[torch.device, torch.dtype] | None = None

    def keep_matrix(self, matrix: Tensor) -> None:
        """Keep the matrices of an operator, which carry no gradients; where parameters do, they are computed when asked for."""
        if self.columns is None or not self.columns.drawn.requires_grad:
            self.matrix = matrix

    @property
    def chosen(self) -> Tensor | None:
        """(B,) bool, the samples that are augmented; None for all."""
        if self.is_certain:
            return None
        if self._chosen is None and self.columns is not None and self.columns.chosen is not None:
            self._chosen = self.columns.chosen > 0.5
        return self._chosen


class CallPlan(NamedTuple):
    """The draws of a call on images of one shape, and the pass that executes the call, if a single pass can."""

    shape: Shape
    draws: DrawPlan | None
    is_certain: bool
    image_pass: Pass | None
    drawn: DrawnPass | None  # the draws and the pass by one operator


class _KeepsArguments(nn.Module):
    """A module that knows what its constructor was given, for `repr`."""

    _arguments: Any = ((), {})  # or their text by name

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        self = super().__new__(cls)
        self.__dict__["_arguments"] = (args, kwargs)
        return self


class AugmentationBase(_KeepsArguments):
    """What augmentations of images and of volumes share; see the module."""

    axes: ClassVar[int]  # of an image with its channels: 3, of a volume: 4
    whole_batch: ClassVar[bool] = False  # the size of the result changes, so that all samples are chosen or none
    accepts_bytes: ClassVar[bool] = True  # otherwise uint8 images are computed in float32, in [0, 1]
    keeps_lines: ClassVar[bool] = True  # straight lines stay straight, so that the corners of a box say where it is
    _execution: Execution | None = None  # of the last call
    fuses_noise: ClassVar[bool] = False  # `apply_transform` takes "_noise" instead of the parameters of pixels

    def __init__(
        self,
        p: float = 0.5,
        p_batch: float = 1.0,
        same_on_batch: bool = False,
        keepdim: bool = False,
        *,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__()
        op = type(self).__name__
        for name, value in (("p", p), ("p_batch", p_batch)):
            if isinstance(value, bool) or not hasattr(value, "__float__"):
                raise TypeCheckError(f"{op}: expected {name} to be a number, got {value!r}")
            if not 0 <= float(value) <= 1:
                raise ValueCheckError(f"{op}: expected {name} within 0 and 1, got {value}")
        self.p, self.p_batch = float(p), float(p_batch)
        self.same_on_batch, self.keepdim = same_on_batch, keepdim
        self.generator, self.return_transform = generator, return_transform
        self._plans = Plans()
        self.flags: dict[str, Any] = {}
        self._param_generator: RandomGeneratorBase | None = None
        self._rng: tuple[torch.device, torch.dtype] = (torch.device("cpu"), torch.float32)
        self.device, self.dtype = self._rng  # for users' classes, which may have others

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "_execution":
            self.__dict__[name] = value  # torch looks for parameters in what it sets
            return
        settings_changed()
        setting: Any = Flags(value) if name == "flags" else value
        super().__setattr__(name, setting)

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles have the settings, not the last call.
        state = {name: value for name, value in self.__dict__.items() if name != "_execution"}
        return {**state, "_arguments": self._constructor_arguments()}

    def __repr__(self) -> str:
        if any(name != "_param_generator" for name, _ in self.named_children()):
            return super().__repr__()
        return f"{self._get_name()}({self.extra_repr()})"

    def extra_repr(self) -> str:
        now = {"p": self.p, "p_batch": self.p_batch, "same_on_batch": self.same_on_batch, **self.flags}
        shown = {**self._constructor_arguments(), **{name: _shown(value) for name, value in now.items()}}
        return ", ".join(f"{name}={text}" for name, text in shown.items())

    def _constructor_arguments(self) -> dict[str, str]:
        """The arguments of the constructor as text, without those that all augmentations have."""
        if isinstance(self._arguments, dict):
            return self._arguments
        args, kwargs = self._arguments
        bound = inspect.signature(type(self).__init__).bind_partial(self, *args, **kwargs)
        bound.apply_defaults()
        arguments: dict[str, Any] = {}
        for name, value in list(bound.arguments.items())[1:]:  # the first one is self
            is_options = bound.signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
            arguments.update(value if is_options else {name: value})
        common = ("p", "p_batch", "same_on_batch", "keepdim", "generator", "return_transform")
        return {name: _shown(value) for name, value in arguments.items() if name not in common}

    # --- what was drawn ---

    @property
    def _params(self) -> Params:
        """The parameters of the last call by name, with `batch_prob` and `forward_input_shape`."""
        if self._execution is None:
            return {}
        return self._read_params(self._execution)

    @_params.setter
    def _params(self, params: Params) -> None:
        self._execution = Execution(tuple(params["forward_input_shape"].tolist()), params=params)

    def _read_params(self, execution: Execution) -> Params:
        if execution.params is None:
            device, dtype = self._rng
            shape, columns = execution.shape, execution.columns
            chosen = torch.full((shape[0],), float(execution.applied))
            request = self._request(shape)
            redraw = execution.redraw
            if request is not None and redraw is not None and columns is not None and columns.drawn.is_cuda:
                # Drawn again on the host, which gives the same numbers and waits for nothing but a key on the device.
                keys, index = redraw
                host = Keys(keys.keys.cpu(), None if keys.seeds is None else keys.seeds.cpu(), keys.one_key)
                (columns,) = draw_columns(torch.empty(shape[0] // execution.frames), host, [request], index)
                if execution.frames > 1:
                    columns = columns._replace(drawn=columns.drawn.repeat_interleave(execution.frames, 0))
                redraw = (host, index)
            params: Params = {}
            if columns is not None:
                if columns.chosen is not None:
                    chosen = columns.chosen.detach().cpu() * chosen
                values = columns.values.detach()
            else:
                values = torch.empty(shape[0], 0)
            is_drawn = columns is not None or request is None or not request.draws
            if self._param_generator is not None and is_drawn and not self._draws_by_name:
                params = self._param_generator.to_params(values, shape)
                if self._param_generator.per_pixel and redraw is not None:
                    noise = PixelNoise(*redraw, self.same_on_batch, values.device)
                    params.update(self._pixel_params(values, execution, noise))
            params["batch_prob"] = chosen
            params["forward_input_shape"] = torch.tensor(shape)
            execution.params = {
                name: x.to(device, dtype if x.is_floating_point() else None) if isinstance(x, Tensor) else x
                for name, x in params.items()
            }
        return execution.params

    @property
    def transform_matrix(self) -> Tensor | None:
        """The matrices (B, 3, 3) of the last call, from image pixels to result pixels; None before the first call."""
        return None if self._execution is None else self._matrix(self._execution)

    def _matrix(self, execution: Execution) -> Tensor:
        if execution.matrix is None:
            identity = self.identity_matrix(execution.shape)
            execution.matrix = identity if execution.identity is None else identity.to(*execution.identity)
        return execution.matrix

    def identity_matrix(self, input: Tensor | Sequence[int]) -> Tensor:
        """An identity matrix for each sample of images, or of a shape (B, ...)."""
        n = self.axes
        if isinstance(input, Tensor):
            like, batch = input, input.shape[0]
            dtype = input.dtype if input.dtype in (torch.float32, torch.float64) else torch.float32
            return torch.eye(n, device=like.device, dtype=dtype).expand(batch, n, n)
        return torch.eye(n).expand(input[0], n, n)

    def set_rng_device_and_dtype(self, device: torch.device | str, dtype: torch.dtype = torch.float32) -> None:
        """Choose where and in which type `_params` are given. The values do not depend on the device."""
        self._rng = self.device, self.dtype = torch.device(device), dtype
        if self._param_generator is not None:
            self._param_generator.set_rng_device_and_dtype(device, dtype)

    def output_shape(self, shape: Shape, flags: dict[str, Any]) -> Shape:
        """The shape of the results for images of a shape."""
        return shape

    # --- drawing ---

    def _request(self, shape: Shape) -> Request | None:
        """What this augmentation draws for images of a shape; None for nothing."""
        generator = None if self._draws_by_name else self._param_generator
        draws: list[Any] = [] if generator is None else list(generator.draws(shape))
        if self.whole_batch:
            return Request(draws, 1.0, 1.0, self.same_on_batch) if draws or 0 < self.p_batch < 1 else None
        per_pixel = generator is not None and generator.per_pixel
        if self.p < 1 or self.p_batch < 1 or (per_pixel and not draws):
            draws.insert(0, Draw("chosen"))
        return Request(draws, self.p, self.p_batch, self.same_on_batch) if draws else None

    def _applies(self, keys: Keys | None, index: int) -> bool:
        """Whether the batch is augmented at all, as far as the host knows."""
        if self.p == 0 or self.p_batch == 0:
            return False
        if not self.whole_batch or self.p_batch == 1 or keys is None:
            return True
        key = keys.on_host(type(self).__name__)[0 if keys.one_key else index]
        return is_chosen_batch(key, index if keys.one_key else 0, self.p_batch)

    def _plan(self, x: Tensor, has_seed: bool) -> CallPlan:
        key = (x.shape, has_seed)
        plan: CallPlan | None = self._plans.get(key)
        if plan is None:
            shape = tuple(x.shape)
            request = self._request(shape) if self.p > 0 and self.p_batch > 0 else None
            draws = None if request is None else plan_draws([request], has_seed)[0]
            decides = self.whole_batch and 0 < self.p_batch < 1  # on the host, in each call
            applied = not decides and self._applies(None, 0)
            image_pass = self._pass(shape, None if draws is None else draws.spans[0], self.flags) if applied else None
            drawn = None if image_pass is None or draws is None else DrawnPass(draws, image_pass)
            plan = CallPlan(shape, draws, self._is_certain, image_pass, drawn)
            if draws is None or draws.learned is None:
                self._plans.keep(key, plan)
        return plan

    def _keys(self, x: Tensor, seed: Seed, generator: Generator | None) -> Keys:
        op = type(self).__name__
        keys = draw_keys(op, 1, x.device, seed, generator or self.generator)
        if keys.seeds is not None:
            check_seeds(op, keys, x.shape[0])
        return keys

    def _draw(self, x: Tensor, seed: Seed, generator: Generator | None) -> Execution:
        plan = self._plan(x, seed is not None)
        if plan.draws is None:
            return Execution(plan.shape, applied=self._applies(None, 0))
        keys = self._keys(x, seed, generator)
        columns = Columns(plan.draws.draw(x, keys), plan.draws.spans[0])
        applied = self._applies(keys, 0)
        return Execution(plan.shape, columns, applied=applied, redraw=(keys, 0), is_certain=plan.is_certain)

    def _pass(self, shape: Shape, span: Span | None, flags: dict[str, Any]) -> Pass | None:
        """The pass that executes this augmentation by columns instead of parameters by name; None if there is no such pass."""
        return None

    def _kept_pass(self, shape: Shape, span: Span | None, flags: dict[str, Any]) -> Pass | None:
        """The pass of `_pass`, cached for the flags of the constructor."""
        if flags is not self.flags:
            return self._pass(shape, span, flags)
        kept: tuple[Pass | None] | None = self._plans.get((shape, span))
        if kept is None:
            kept = (self._pass(shape, span, flags),)
            self._plans.keep((shape, span), kept)
        return kept[0]

    def _draw_and_run(
        self, x: Tensor, seed: Seed, generator: Generator | None, flags: dict[str, Any]
    ) -> tuple[Tensor, Execution]:
        """Draw parameters and execute with them. The execution is stored for `_params` and `transform_matrix`."""
        plan = self._plan(x, seed is not None)
        state = self.__dict__  # faster than Module.__setattr__, which looks for parameters
        if plan.image_pass is None or flags is not self.flags:
            # Stored before it runs, because a user's method may add to `_params`.
            execution = state["_execution"] = self._draw(x, seed, generator)
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
        state["_execution"] = execution
        return y, execution

    @property
    def _is_certain(self) -> bool:
        """Whether all samples of all batches are augmented."""
        return self.p == 1 and self.p_batch == 1

    def _from_params(self, params: Params, x: Tensor) -> Execution:
        """An execution that replays given parameters."""
        shape = tuple(x.shape)
        chosen = params.get("batch_prob")
        if chosen is not None and len(chosen) != shape[0]:
            raise ShapeError(
                f"{type(self).__name__}: expected params of a batch of {shape[0]}, got those of {len(chosen)} images"
            )
        applied = True
        if chosen is None:
            params = {**params, "batch_prob": torch.ones(shape[0])}
        elif chosen.device.type == "cpu":
            is_chosen = chosen > 0.5
            applied = bool(is_chosen.any()) or shape[0] == 0 or self._was_planned(params)
            chosen = None if bool(is_chosen.all()) else is_chosen
        else:
            chosen = chosen > 0.5
        if "forward_input_shape" not in params:
            params = {**params, "forward_input_shape": torch.tensor(shape)}
        chosen = None if chosen is None else chosen.to(x.device)
        columns = None
        if applied and not self._is_customized() and self._executes_columns(shape):
            columns = self._columns_of(params, shape, x.device, chosen)
        return Execution(shape, columns, chosen, applied, params)

    def _was_planned(self, params: Params) -> bool:
        """Whether a call with these parameters planned for this augmentation, although no sample was chosen.

        What is joined with neighbors takes part in their pass, which has to be the same in a replay.
        """
        if self.whole_batch or self.p == 0 or self.p_batch == 0 or self._is_customized():
            return False
        return self._param_generator is None or not params.keys() <= {"batch_prob", "forward_input_shape"}

    def _executes_columns(self, shape: Shape) -> bool:
        """Whether this augmentation is executed from columns, without parameters by name."""
        return False

    def _columns_of(self, params: Params, shape: Shape, device: torch.device, chosen: Tensor | None) -> Columns | None:
        """The columns that would have been drawn for given parameters."""
        if self._param_generator is None:
            values, draws = torch.empty(shape[0], 0, device=device), []
        else:
            try:
                values = self._param_generator.to_columns(self._on_device(params, device), shape).to(device)
            except KeyError as error:
                raise ValueCheckError(
                    f"{type(self).__name__}: expected params with {error.args[0]!r}, got {', '.join(params)}"
                ) from None
            draws = list(self._param_generator.draws(shape))
        if values.dtype != torch.float64:
            values = values.float()
        parts = [values, *self._further_columns(shape, values, chosen)]
        if chosen is not None and not self.whole_batch:
            identity = torch.tensor(identity_values(draws), dtype=values.dtype).to(device, non_blocking=True)
            parts[0] = torch.where(chosen[:, None], values, identity)
            parts.insert(0, chosen[:, None].to(values.dtype))
        drawn = torch.cat(parts, 1) if len(parts) > 1 else values
        return Columns(drawn, Span(0, drawn.shape[1], len(parts) > 1 and parts[0] is not values and chosen is not None))

    def _further_columns(self, shape: Shape, values: Tensor, chosen: Tensor | None) -> list[Tensor]:
        """Columns that follow those of the parameters."""
        return []

    @staticmethod
    def _on_device(params: Params, device: torch.device) -> Params:
        return {name: x.to(device) if isinstance(x, Tensor) else x for name, x in params.items()}

    def forward_parameters(self, batch_shape: Sequence[int]) -> Params:
        """Draw the parameters of a batch by name, with `batch_prob` and `forward_input_shape`."""
        shape = tuple(batch_shape)
        execution = self._draw(torch.empty(1, device=self._rng[0]).expand(shape), None, None)
        if self._draws_by_name:
            execution.params = None
            return {**self._read_params(execution), **self.generate_parameters(shape)}
        return self._read_params(execution)

    def generate_parameters(self, batch_shape: Sequence[int]) -> Params:
        """Draw the parameters of a batch by name, for all its samples."""
        if self._param_generator is None:
            return {}
        return self._param_generator(tuple(batch_shape), self.same_on_batch)

    def _is_overridden(self, name: str) -> bool:
        if name in self.__dict__:
            return True
        return _is_of_user(getattr(type(self), name, None))

    @property
    def _draws_by_name(self) -> bool:
        """Whether a user's method or generator draws parameters by name, without columns."""
        generator = self._param_generator
        return self._is_overridden("generate_parameters") or (
            generator is not None and _is_of_user(type(generator).forward)
        )

    def _is_customized(self) -> bool:
        """Whether a user's class or instance overrides what containers join."""
        return self._draws_by_name or any(self._is_overridden(name) for name in _OVERRIDABLE)

    # --- applying ---

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """The matrices (B, 3, 3), (B, 4, 4) of volumes, from image pixels to result pixels."""
        return self.identity_matrix(input)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Apply the augmentation with given parameters to all samples."""
        raise NotImplementedError(f"{type(self).__name__}.apply_transform")

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Execute on images (B, C, H, W): by the methods that users override."""
        if not execution.applied:
            return x
        stored = x.dtype
        transform: Tensor | None = None
        if self._needs_no_matrix():
            params = self._params_on_device(x, execution, for_users=False)
            execution.identity = x.device, stored if stored in (torch.float32, torch.float64) else torch.float32
        else:
            params = self._params_on_device(x, execution)
            transform = self.compute_transformation(x, params, flags)
        image = x
        if stored == torch.uint8 and not self.accepts_bytes:
            image = x.float().div_(255)
        elif execution.chosen is not None and self._is_overridden("apply_transform"):
            image = x.clone()  # which may write to it, and samples that are not chosen stay
        y = self.apply_transform(image, params, flags, transform)
        if stored == torch.uint8 and y.dtype != torch.uint8:
            y = (y * 255).round_().clamp_(0, 255).to(torch.uint8)
        elif y.dtype != stored and stored.is_floating_point:
            y = y.to(stored)
        if y.dim() == 4 and y.shape == x.shape:
            y = match_layout(y, x)
        if execution.chosen is not None and y.shape == x.shape:
            y = where_chosen(execution.chosen, y, x)
            if transform is not None:
                identity = self.identity_matrix(x).to(transform)
                transform = torch.where(execution.chosen[:, None, None], transform, identity)
        execution.matrix = transform
        return y

    def _needs_no_matrix(self) -> bool:
        """Whether positions are kept and no method is a user's: then the identity matrix is made only when it is read."""
        needs_no_matrix: bool | None = self._plans.get("needs_no_matrix")
        if needs_no_matrix is None:
            keeps_positions = type(self).compute_transformation is AugmentationBase.compute_transformation
            needs_no_matrix = keeps_positions and not self._is_customized()
            self._plans.keep("needs_no_matrix", needs_no_matrix)
        return needs_no_matrix

    def _params_on_device(self, x: Tensor, execution: Execution, for_users: bool = True) -> Params:
        if execution.params is not None:
            return self._on_device(execution.params, x.device)
        if self._draws_by_name:
            execution.params = {**self._read_params(execution), **self.generate_parameters(execution.shape)}
            return self._on_device(execution.params, x.device)
        params: Params = {"forward_input_shape": torch.tensor(execution.shape)} if for_users else {}
        generator = self._param_generator
        if execution.columns is None or generator is None:
            return params
        values, shape = execution.columns.values, execution.shape
        params.update(generator.to_params(values, shape))
        if generator.per_pixel and execution.redraw is not None:
            noise = PixelNoise(*execution.redraw, self.same_on_batch, x.device)
            if self.fuses_noise and execution.frames == 1 and not self._is_customized():
                params["_noise"] = (values, noise)
            else:
                params.update(self._pixel_params(values, execution, noise))
        return params

    def _pixel_params(self, values: Tensor, execution: Execution, noise: PixelNoise) -> Params:
        """The parameters with numbers of their own for each pixel, the same for the frames of a video."""
        assert self._param_generator is not None
        shape, frames = execution.shape, execution.frames
        if frames == 1:
            return self._param_generator.pixel_params(values, shape, noise)
        drawn = self._param_generator.pixel_params(values[::frames], (shape[0] // frames, *shape[1:]), noise)
        return {name: x.repeat_interleave(frames, 0) for name, x in drawn.items()}

    # --- calling ---

    def validate_tensor(self, input: Tensor) -> None:
        """Raise unless `input` is a tensor of a floating-point type or uint8 with at most a batch of images."""
        op = type(self).__name__
        if not isinstance(input, Tensor):
            raise TypeCheckError(f"{op}: expected input to be a Tensor, got {type(input).__name__}")
        if not input.is_floating_point() and input.dtype != torch.uint8:
            raise TypeCheckError(f"{op}: expected input of a floating-point type or uint8, got {input.dtype}")
        if not self.axes - 1 <= input.dim() <= self.axes + 1:
            layout = ("(H, W), (C, H, W) or (B, C, H, W)", "(D, H, W), (C, D, H, W) or (B, C, D, H, W)")[self.axes - 3]
            raise ShapeError(f"{op}: expected input of shape {layout}, got {tuple(input.shape)}")

    def transform_tensor(self, input: Tensor, **_: Any) -> Tensor:
        """The input as a batch: (H, W) and (C, H, W) become (1, C, H, W)."""
        self.validate_tensor(input)
        while input.dim() < self.axes + 1:
            input = input[None]
        return input

    def _flags_of(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        return {**self.flags, **overrides} if overrides else self.flags

    def forward(
        self,
        input: Tensor | tuple[Tensor, Tensor],
        params: Params | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        **kwargs: Any,
    ) -> Any:
        """Augment images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8; volumes have one more axis. A
                pair of images and matrices (B, 3, 3) passes the matrices on, as chains with `return_transform` do.
            params: parameters of an earlier call, its `_params`, to repeat it on these images.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow; torch's generator is not used.
            generator: draws the key of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            **kwargs: flags of this call, such as `resample`.

        Returns:
            Images (B, C, h, w) of the type of `input`, with fewer axes if `keepdim` and the input has; with
            `return_transform` a pair of them and the matrices (B, 3, 3).

        Raises:
            TypeError: `input` is not a tensor of a floating-point type or uint8.
            ValueError: `input` has another number of axes.
        """
        image: Any
        matrix = None
        if isinstance(input, (tuple, list)) and len(input) == 2 and all(isinstance(x, Tensor) for x in input):
            image, matrix = input
        else:
            image = input
        x = self.transform_tensor(image)
        flags = self._flags_of(kwargs)
        if params is None:
            y, execution = self._draw_and_run(x, seed, generator, flags)
        else:
            execution = self._execution = self._from_params(params, x)  # before it runs, as in _draw_and_run
            y = self._run(x, execution, flags)
        if self.keepdim:
            y = self._restored(y, image)
        returns = self.return_transform if return_transform is None else return_transform
        if not returns:
            return y if matrix is None else (y, matrix)
        transform = self._matrix(execution).to(y.device)
        return y, transform if matrix is None else transform @ matrix.to(transform)

    # --- labels ---

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks (B, C, H, W) of any type, moved as the images were."""
        return self._masks_by_name(masks, execution, flags) if self._is_overridden("apply_transform_mask") else masks

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Move the masks of all samples with given parameters, for subclasses to override."""
        return input

    def _masks_by_name(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks moved by a method that a user's class overrides, which gets parameters by name."""
        if not execution.applied:
            return masks
        params, matrix = self._params_on_device(masks, execution), self._matrix(execution).to(masks.device)
        y = self.apply_transform_mask(exact(masks), params, flags, matrix).to(masks.dtype)
        return where_chosen(execution.chosen, y, masks) if y.shape == masks.shape else y

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        """Points (B, N, 2), (B, N, 3) of volumes, moved as the images were."""
        return points

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """Masks (B, C, h, w) of results, moved back."""
        return masks

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        """Points (B, N, 2), (B, N, 3) of volumes, of results, moved back."""
        return points

    def inverse(self, output: Tensor, params: Params | None = None, **kwargs: Any) -> Tensor:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            output: images (B, C, h, w) as that call returned them.
            params: the `_params` of the call.
            **kwargs: flags, such as `resample`.

        Returns:
            Images of the size that the input had; 0 where the result knows nothing of them.
        """
        return output

    def known_pixels(self, output: Tensor, params: Params | None = None) -> Tensor:
        """Which pixels of the images :meth:`inverse` finds in a result; the others were lost in the call, or in part.

        Args:
            output: images (B, C, h, w) as that call returned them, of which only the device counts.
            params: the `_params` of the call.

        Returns:
            bool (B, 1, H, W), of the size that the input had.
        """
        x = self.transform_tensor(output)
        execution = self._execution_of(params, x, self.flags)
        if execution is None:
            return is_known(known_everywhere(x.shape, x.device))
        ones = known_everywhere(execution.shape, x.device)
        moved = self.transform_masks(ones, execution, {**self.flags, "resample": "bilinear"})
        return is_known(self.inverse(moved, params).reshape(ones.shape))

    def _restored(self, y: Tensor, input: Tensor) -> Tensor:
        """A result with as many axes as the input, where `keepdim` asks for it."""
        return without_added_axes(y, input) if self.keepdim else y

    def _call_to_invert(self, output: Tensor, params: Params | None, flags: dict[str, Any]) -> tuple[Tensor, Execution]:
        """Results as a batch, and the call that they came from: the last one, or that of given parameters."""
        x = self.transform_tensor(output)
        execution = self._execution_of(params, x, flags)
        if execution is None:
            raise RuntimeError(f"{type(self).__name__}.inverse: there was no call yet; pass its params")
        return x, execution

    def _execution_of(self, params: Params | None, x: Tensor, flags: dict[str, Any]) -> Execution | None:
        """The last execution, or that of given parameters, for an inverse on the device of results x."""
        if params is None:
            return self._execution
        return self._from_params(params, x.new_empty(1).expand(tuple(int(n) for n in params["forward_input_shape"])))


def without_added_axes(y: Tensor, input: Tensor) -> Tensor:
    """The result of a batch of one with as many axes as the input had."""
    return y.reshape(y.shape[y.dim() - input.dim() :]) if y.dim() > input.dim() else y


def per_sample(values: Tensor, like: Tensor) -> Tensor:
    """Values (B,) that broadcast with the samples of `like`, (B, 1, ...) on its device."""
    return values.to(like.device).reshape(-1, *[1] * (like.dim() - 1))


def where_chosen(chosen: Tensor | None, y: Tensor, x: Tensor | float) -> Tensor:
    """`y` of the samples that are chosen, None for all, and `x` of the others."""
    return y if chosen is None else torch.where(per_sample(chosen, y), y, x)


def known_everywhere(shape: Shape, device: torch.device) -> Tensor:
    """One channel of ones for images of a shape (B, C, H, W)."""
    return torch.ones((shape[0], 1, *shape[2:]), device=device)


def is_known(back: Tensor) -> Tensor:
    """Pixels that were read from ones alone."""
    return back > 1 - 1e-3


def _is_of_user(method: Any) -> bool:
    """Whether a method is not one of this library."""
    return not (getattr(method, "__module__", None) or "").startswith("kvision.")


def _shown(value: Any) -> str:
    return str(
        value.name.lower() if isinstance(value, Enum) else value.tolist() if isinstance(value, Tensor) else value
    )


class AugmentationBase2D(AugmentationBase):
    """Base of the augmentations of images: a subclass overrides `apply_transform`, and what it needs besides.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Raises:
        TypeError: `p` or `p_batch` is not a number.
        ValueError: `p` or `p_batch` is not within 0 and 1.

    Example:
        >>> import torch, kvision as K
        >>> class Dim(K.augmentation.AugmentationBase2D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return input / 2
        >>> Dim(p=1.0)(torch.ones(1, 1, 1, 2))
        tensor([[[[0.5000, 0.5000]]]])
    """

    axes = 3


class RigidAffineAugmentationBase2D(AugmentationBase2D):
    """Base of augmentations with a matrix (B, 3, 3): geometric ones, and those that leave pixels in place.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import kvision as K
        >>> issubclass(K.augmentation.RandomAffine, K.augmentation.RigidAffineAugmentationBase2D)
        True
    """


class AugmentationBase3D(AugmentationBase):
    """Base of the augmentations of volumes (B, C, D, H, W); as :class:`AugmentationBase2D`.

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import torch, kvision as K
        >>> class Dim(K.augmentation.AugmentationBase3D):
        ...     def apply_transform(self, input, params, flags, transform=None):
        ...         return input / 2
        >>> Dim(p=1.0)(torch.ones(1, 1, 1, 1, 2))
        tensor([[[[[0.5000, 0.5000]]]]])
    """

    axes = 4


class RigidAffineAugmentationBase3D(AugmentationBase3D):
    """Base of augmentations of volumes with a matrix (B, 4, 4).

    Args:
        p: probability that a sample is augmented.
        p_batch: probability that a batch is.
        same_on_batch: all samples get the same parameters.
        keepdim: an image (C, H, W) gives an image (C, h, w) instead of a batch of one.
        generator: draws the key of each call; default: torch's generator.
        return_transform: calls return the image and its matrix.

    Example:
        >>> import kvision as K
        >>> issubclass(K.augmentation.IntensityAugmentationBase3D, K.augmentation.RigidAffineAugmentationBase3D)
        True
    """
