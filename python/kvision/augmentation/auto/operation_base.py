"""What operations with learned magnitudes and probabilities have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._clamp import clamp
from kvision._tv_tensors import wrap
from kvision.augmentation.columns import draw_columns
from kvision.augmentation.draws import Request, uniform
from kvision.augmentation.engine import (
    Applied,
    AugmentationBase2D,
    CallContext,
    Execution,
    Params,
    check_batch_of_params,
)
from kvision.augmentation.inputs import check_matrix, image_and_matrix, plain_image
from kvision.augmentation.keys import Seed, check_seeds, draw_keys
from kvision.augmentation.samples import with_matrix
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.core.pixels import to_unit


class OperationBase(nn.Module):
    """An augmentation whose magnitude and probability are learned.

    A sample is augmented where a draw says so; the gradient to the probability is that of a relaxed Bernoulli variable, the
    one to the magnitude that of the augmentation.

    Args:
        operation: the augmentation; its `p` is the initial probability, the range of its parameter that of the magnitude.
        initial_magnitude: pairs of the parameter's name and its initial value; None for an operation without magnitude. The
            first pair is learned; a value of None stands for the middle of the range.
        temperature: of the relaxation: the lower, the closer the gradient to that of a step.
        is_batch_operation: the whole batch is augmented, or none of it.
        magnitude_fn: maps magnitudes to values of the parameter.
        symmetric_megnitude: the sign of the magnitude is drawn for each sample. (Spelling as in Kornia.)

    Raises:
        TypeError: `operation` is no augmentation of images.
        ValueError: `temperature` is not above 0.

    Example:
        >>> import torch, kvision as K
        >>> brighter = K.augmentation.auto.operations.Brightness(initial_magnitude=1.5, initial_probability=1.0)
        >>> [name for name, _ in brighter.named_parameters()]
        ['_probability', '_magnitude']
        >>> brighter(torch.full((1, 3, 1, 1), 0.25)).flatten().tolist()
        [0.75, 0.75, 0.75]
    """

    _call: tuple[Params, Execution] | None = None  # the last one
    magnitude_range: tuple[float, float] | None = None
    scale = 1.0  # from a magnitude to the parameter

    def __init__(
        self,
        operation: AugmentationBase2D,
        initial_magnitude: Sequence[tuple[str, float | None]] | None = None,
        temperature: float = 0.1,
        is_batch_operation: bool = False,
        magnitude_fn: Callable[[Tensor], Tensor] | None = None,
        symmetric_megnitude: bool = False,
    ) -> None:
        super().__init__()
        op = type(self).__name__
        if not isinstance(operation, AugmentationBase2D):
            raise TypeCheckError(f"{op}: expected operation to be an augmentation, got {type(operation).__name__}")
        temperature = _check.number(op, "temperature", temperature)
        if not temperature > 0:
            raise ValueCheckError(f"{op}: expected temperature above 0, got {temperature}")
        self.probability_range = (1e-7, 1 - 1e-7)
        self._probability = nn.Parameter(torch.tensor([float(operation.p)]))
        operation.p = 1.0
        self.op, self.temperature, self.is_batch_operation = operation, temperature, is_batch_operation
        self.magnitude_fn, self.symmetric_megnitude = magnitude_fn, symmetric_megnitude
        self._factor_name = None
        if initial_magnitude is not None:
            self._factor_name, value = initial_magnitude[0]
            if value is None:
                value = sum(self.magnitude_range or (0.0, 1.0)) / 2
            self._magnitude = nn.Parameter(torch.tensor([_check.number(op, "initial_magnitude", value)]))

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles have the settings, not the last call.
        return {name: value for name, value in self.__dict__.items() if name != "_call"}

    @property
    def same_on_batch(self) -> bool:
        """Whether all samples get the same choice, sign and parameters."""
        return bool(self.op.same_on_batch)

    @same_on_batch.setter
    def same_on_batch(self, value: bool) -> None:
        self.op.same_on_batch = value

    @property
    def magnitude(self) -> Tensor | None:
        """The magnitude within its range; None for an operation without one."""
        if self._factor_name is None:
            return None
        return self._magnitude if self.magnitude_range is None else clamp(self._magnitude, *self.magnitude_range)

    @property
    def probability(self) -> Tensor:
        """The probability, between 0 and 1."""
        return clamp(self._probability, *self.probability_range)

    @property
    def transform_matrix(self) -> Tensor | None:
        """The matrices (B, 3, 3) of the last call; None before the first one."""
        return None if self._call is None else self._matrix(*self._call)

    def _matrix(self, params: Params, execution: Execution) -> Tensor:
        matrix = self.op._matrix(execution)
        chosen = params["batch_prob"].detach().to(matrix.device) > 0.5
        return torch.where(chosen[:, None, None], matrix, torch.eye(3, dtype=matrix.dtype, device=matrix.device))

    @property
    def _params(self) -> Params:
        """The parameters of the last call."""
        return {} if self._call is None else self._call[0]

    def _read_params(self, params: Params) -> Params:
        """The parameters of a call in a container, which are its record."""
        return params

    def forward_parameters(
        self,
        batch_shape: Sequence[int],
        mag: Tensor | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
    ) -> Params:
        """Draw the parameters of a call on images of a shape.

        Args:
            batch_shape: (B, C, H, W).
            mag: magnitudes (B,) or (1,); default: the learned one.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the key of this call; default: torch's generator.

        Returns:
            Parameters by name, with `batch_prob` (B,), which has a gradient to the probability.
        """
        return self._draw(CallContext.of_module(type(self).__name__, seed, generator), tuple(batch_shape), mag)

    def _draw(self, context: CallContext, shape: tuple[int, ...], mag: Tensor | None = None) -> Params:
        """Draw the parameters of a call: first the choice and the sign, then what the augmentation draws."""
        device, generator = self._probability.device, self.op._param_generator
        of_op = None if generator is None or generator.per_pixel else self.op._request(shape)
        requests = [Request([uniform(0.0, 1.0), uniform(0.0, 1.0)], same_on_batch=self.same_on_batch)]
        if of_op is not None:
            requests.append(of_op)
        keys = draw_keys(context.op, len(requests), device, context.seed_of_samples, context.generator_of(self))
        samples = len(range(0, shape[0], context.frames))
        check_seeds(context.op, keys, samples)
        position = context.position if keys.has_seed else 0
        drawn = draw_columns(torch.empty(samples, device=device), keys, requests, position)
        words, *of_op_values = (columns.values.repeat_interleave(context.frames, 0) for columns in drawn)
        if self.is_batch_operation:
            words = words[:1].expand(shape[0], 2)
        if generator is not None and of_op_values:
            params = generator.to_params(of_op_values[0], shape)
        else:
            params = dict(self.op.generate_parameters(shape))
        params = {name: x.to(device) if isinstance(x, Tensor) else x for name, x in params.items()}
        magnitude = self.magnitude if mag is None else mag
        if self._factor_name is not None and magnitude is not None:
            value = magnitude.expand(shape[0])
            if self.magnitude_fn is not None:
                value = self.magnitude_fn(value)
            if self.symmetric_megnitude:
                value = torch.where(words[:, 1] < 0.5, -value, value)
            params[self._factor_name] = self._value(value, params[self._factor_name], shape)
        # A hard choice whose gradient is that of the relaxed one.
        u = words[:, 0].clamp(1e-6, 1 - 1e-6)
        relaxed = ((self.probability.logit() + u.logit()) / self.temperature).sigmoid()
        hard = (relaxed > 0.5).to(relaxed)
        params["batch_prob"] = hard + (relaxed - relaxed.detach()) if torch.is_grad_enabled() else hard
        params["forward_input_shape"] = torch.tensor(shape, device="cpu")
        return params

    def _value(self, value: Tensor, drawn: Tensor, shape: Sequence[int]) -> Tensor:
        """The parameter of magnitudes; those that count whole numbers have no gradient."""
        value = value * self.scale
        return value if drawn.is_floating_point() else value.detach().round().to(drawn.dtype)

    def forward(
        self,
        input: Tensor | tuple[Tensor, Tensor],
        params: Params | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> Any:
        """Augment images.

        Args:
            input: images (B, C, H, W) of a floating-point type. A pair of images and matrices (B, 3, 3) passes the matrices on,
                as chains with `return_transform` do.
            params: parameters of an earlier call.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the key of this call; default: torch's generator.
            return_transform: also return the matrices; default: as the augmentation says.

        Returns:
            Images of the shape of `input`; with `return_transform` a pair of them and the matrices (B, 3, 3).
        """
        given, before = image_and_matrix(self, input)
        image = plain_image(self, given)
        x = self.op.transform_tensor(image)
        if before is not None:
            check_matrix(self, before, x)
        if params is None:
            params = self.forward_parameters(tuple(x.shape), seed=seed, generator=generator)
        y, execution = self._augment(x, params)
        returns = self.op.return_transform if return_transform is None else return_transform
        transform = self._matrix(params, execution) if returns else None
        y = y if image is given else wrap(y, given)
        return with_matrix(y, before, None if transform is None else transform.to(y.device))

    def _execute_nested(self, x: Tensor, params: Params | None, context: CallContext) -> tuple[Tensor, Applied, Params]:
        """Run in a container: the images, what labels have to follow, and the parameters."""
        if params is None:
            params = self._draw(context._replace(op=type(self).__name__), tuple(x.shape))
        y, _ = self._augment(x, params)
        chosen = {**params, "batch_prob": params["batch_prob"].detach()}
        return y, Applied(self.op, self.op._execution_on(x, chosen, self.op.flags), self.op.flags), params

    def _augment(self, x: Tensor, params: Params) -> tuple[Tensor, Execution]:
        """Images augmented with parameters, and what the augmentation did to all of them."""
        check_batch_of_params(type(self).__name__, len(params["batch_prob"]), len(x))
        chosen = params["batch_prob"].to(x.device)[:, None, None, None]
        # Applied to all samples: the gradient to the probability needs the results of samples that are not chosen, too.
        of_all = {name: drawn for name, drawn in params.items() if name != "batch_prob"}
        execution = self.op.__dict__["_execution"] = self.op._from_params(of_all, x)
        self.__dict__["_call"] = params, execution
        augmented = self.op._run(x, execution, self.op.flags)
        x = x if x.dtype == augmented.dtype else to_unit(x)
        y = torch.where(chosen.detach() > 0.5, augmented, x)
        if not chosen.requires_grad:
            return y, execution
        # The weight is 0: it is there for its gradient.
        return y + (chosen - chosen.detach()).to(x.dtype) * (augmented - x).detach(), execution
