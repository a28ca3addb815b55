"""What a subclass of the augmentations declares: its settings, what it draws, and what it does to images.

A subclass sets `_param_generator` and flags in its constructor, and declares one of three effects (`base`). The methods here
have the defaults; none of them executes anything.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Mapping, Sequence
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Generator, Tensor, nn
from torch.compiler import is_compiling
from typing_extensions import Self

from kvision import _check
from kvision._constants import constant
from kvision._torch_compat import in_function_transform
from kvision.augmentation.columns import Columns, Names, Span, constant_values, identity_values, name_columns
from kvision.augmentation.draws import Draw, Request
from kvision.augmentation.engine.configuration import SWITCHES, Flags, Plans, kept, portable, settings_changed
from kvision.augmentation.engine.contribution import Colors, Contribution
from kvision.augmentation.engine.execution import Params, Shape
from kvision.augmentation.transforms import Transform
from kvision.augmentation.warp_and_color import ColorPart
from kvision.core.exceptions import TypeCheckError

if TYPE_CHECKING:
    from kvision.augmentation.random_generator.base import RandomGeneratorBase

_OVERRIDABLE = ("compute_transformation", "apply_transform")
_OTHERS = ("generate_parameters", "apply_transform_mask", "inverse_transform", "inverse", "displacements")


class KeepsArguments(nn.Module):
    """A module that keeps the arguments of its constructor, for `repr` and `to_json`."""

    _arguments: tuple[tuple[Any, ...], dict[str, Any]] = ((), {})

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        self = super().__new__(cls)
        self.__dict__["_arguments"] = (args, kwargs)
        return self

    def _portable_arguments(self) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """The arguments for copies and pickles: children that a container has by its own right are left out."""
        args, kwargs = self._arguments
        kept = args if not isinstance(self, nn.Sequential) else tuple(x for x in args if not isinstance(x, nn.Module))
        return kept, portable(kwargs)


class Declaration(KeepsArguments):
    """What an augmentation is: settings, and what subclasses override."""

    axes: ClassVar[int]  # of an image with its channels: 3, of a volume: 4
    whole_batch: ClassVar[bool] = False  # the size of the result changes, so that all samples are chosen or none
    has_known_size: bool = True  # the size of the result follows from that of the images, without what is drawn
    draws_for_batch: ClassVar[bool] = False  # a parameter is that of one sample for all, unless each has a seed
    needs_masks: ClassVar[bool] = False  # images are changed by their masks, which containers hand over
    # "boxes" or "masks" of the images, from which the generator derives columns: containers hand over those that are there by
    # then, and calls have an argument of this name.
    reads_labels: ClassVar[str | None] = None
    removes_boxes: ClassVar[bool] = False  # whose centers are outside of the results
    accepts_bytes: bool = True  # otherwise uint8 images are computed in float32, in [0, 1]
    accepts_wide_integers: ClassVar[bool] = False  # images of int16 and uint16, which are computed in float32
    keeps_lines: ClassVar[bool] = True  # straight lines stay straight, so that the corners of a box say where it is
    mixes_samples: ClassVar[bool] = False  # of the batch
    moves_by_map: ClassVar[bool] = False  # as MapAugmentation does
    keeps_positions: ClassVar[bool] = False  # of all pixels, so that labels stay as they are
    warps_lists_by_matrix: ClassVar[bool] = False  # where it runs by itself
    keeps_unchosen: ClassVar[bool] = False  # the drawn columns of samples that are not chosen leave them as they are
    filters_chosen: bool = False  # `_operation` is a filter, which copies images of a list that are not chosen
    fuses_noise: bool = False  # `apply_transform` takes "_noise" instead of the parameters of pixels

    _own_methods: ClassVar[
        dict[str, Any]
    ]  # by name, those of the class that may be replaced and keep the contract below

    def __init_subclass__(cls, keeps_contract: bool = False, **options: Any) -> None:
        """Let methods of the class replace those of its bases without being called by themselves.

        A method that replaces one of another class is run as it is, with parameters by name and a copy of the images: it may
        change the size of the batch, write to what it gets, or say something else than the formulas of its base. A class with
        `keeps_contract` promises that it does not: results have `output_shape`, and nothing is written to.
        """
        super().__init_subclass__(**options)
        if keeps_contract:
            cls._own_methods = {name: getattr(cls, name, None) for name in (*_OVERRIDABLE, *_OTHERS)}

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
        self.p, self.p_batch = _check.fraction(op, "p", float(p)), _check.fraction(op, "p_batch", float(p_batch))
        self.same_on_batch = _check.switch(op, "same_on_batch", same_on_batch)
        self.keepdim = _check.switch(op, "keepdim", keepdim)
        self.generator, self.return_transform = generator, return_transform
        self._plans = Plans()
        self.flags: dict[str, Any] = {}
        self._param_generator: RandomGeneratorBase | None = None
        self._rng: tuple[torch.device, torch.dtype] = (torch.device("cpu"), torch.float32)
        self.device, self.dtype = self._rng  # for users' classes, which may have others

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "_execution":
            self.__dict__[name] = value  # faster than Module.__setattr__, which looks for parameters
            return
        settings_changed()
        setting: Any = self._checked_flags(value) if name == "flags" else value
        super().__setattr__(name, setting)

    def _checked_flags(self, flags: Mapping[str, Any]) -> Flags:
        op = type(self).__name__
        checked = {
            name: _check.switch(op, name, value) if name in SWITCHES and value is not None else value
            for name, value in flags.items()
        }
        return Flags(checked)

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles have the settings, not the last call.
        state = {name: value for name, value in self.__dict__.items() if name != "_execution"}
        return portable({**state, "_arguments": self._portable_arguments()})

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
        args, kwargs = self._arguments
        bound = inspect.signature(type(self).__init__).bind_partial(self, *args, **kwargs)
        bound.apply_defaults()
        arguments: dict[str, Any] = {}
        for name, value in list(bound.arguments.items())[1:]:  # the first one is self
            is_options = bound.signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD
            arguments.update(value if is_options else {name: value})
        common = ("p", "p_batch", "same_on_batch", "keepdim", "generator", "return_transform")
        return {name: _shown(value) for name, value in arguments.items() if name not in common}

    # --- what is drawn ---

    def set_rng_device_and_dtype(self, device: torch.device | str, dtype: torch.dtype = torch.float32) -> None:
        """Choose where and in which type `_params` are given. The values do not depend on the device."""
        self._rng = self.device, self.dtype = torch.device(device), dtype
        if self._param_generator is not None:
            self._param_generator.set_rng_device_and_dtype(device, dtype)

    def _request(self, shape: Shape, is_certain: bool = False, has_chosen: bool = False) -> Request | None:
        """What this augmentation draws for images of a shape; None for nothing.

        `is_certain` stands for p = p_batch = 1; `has_chosen` asks for the column of chosen samples also then.
        """
        generator = None if self._draws_by_name else self._param_generator
        draws: list[Any] = [] if generator is None else list(generator.draws(shape))
        p, p_batch = (1.0, 1.0) if is_certain else (self.p, self.p_batch)
        if self.whole_batch:
            return Request(draws, 1.0, 1.0, self.same_on_batch) if draws or 0 < p_batch < 1 else None
        per_pixel = generator is not None and generator.per_pixel
        if has_chosen or p < 1 or p_batch < 1 or (per_pixel and not draws):
            draws.insert(0, Draw("chosen"))
        return Request(draws, p, p_batch, self.same_on_batch) if draws else None

    def generate_parameters(self, batch_shape: Sequence[int]) -> Params:
        """Draw the parameters of a batch by name, for all its samples."""
        if self._param_generator is None:
            return {}
        return self._param_generator(tuple(batch_shape), self.same_on_batch)

    @property
    def _derives(self) -> bool:
        """Whether columns follow from others that are drawn, as where labels take part."""
        generator = self._param_generator
        return generator is not None and generator.derives

    def _derived(self, drawn: Columns, sizes: Tensor, labels: Any = None, frames: int = 1) -> Columns:
        """The columns of images of sizes (B, 2), from drawn ones and labels; those of `frames` neighbors are the same."""
        assert self._param_generator is not None
        if labels is None and self.reads_labels is not None and not is_compiling():
            warnings.warn(
                f"{type(self).__name__}: this call has no {self.reads_labels}, by which windows are chosen: pass "
                f"`{self.reads_labels}=`, or in an AugmentationSequential their data key; images without any have empty ones",
                stacklevel=2,
            )
        values = drawn.values[::frames] if frames > 1 else drawn.values
        values = self._param_generator.derive(values, sizes, labels).to(drawn.drawn)
        values = values.repeat_interleave(frames, 0) if frames > 1 else values
        chosen = drawn.chosen
        if chosen is None:
            return Columns(values, Span(0, values.shape[1], False))
        values = torch.where(chosen[:, None] > 0.5, values, self._param_generator.identity(sizes).to(values))
        return Columns(torch.cat([chosen[:, None], values], 1), Span(0, values.shape[1] + 1, True))

    def _identity_values(self, shape: Shape, like: Tensor) -> Tensor:
        """What the columns (1, P) of the parameters hold for samples of a shape that are not chosen."""
        generator = self._param_generator
        if generator is not None and generator.derives:
            return generator.identity(size_of(shape, like))
        draws = [] if generator is None else list(generator.draws(shape))
        return constant(tuple(identity_values(draws)), like)[None]

    @property
    def _is_certain(self) -> bool:
        """Whether all samples of all batches are augmented."""
        return self.p == 1 and self.p_batch == 1

    def _names_of_columns(self, span: Span | None) -> Names:
        """The columns of the parameters by name, which are those of a span; None for columns of their own."""
        fields = () if self._param_generator is None else self._param_generator.fields
        return name_columns(fields, 0 if span is None else span.first_value)

    def _bound(self, chain: Sequence[Transform], span: Span | None) -> list[Transform]:
        """Transforms with their columns."""
        names = self._names_of_columns(span)
        return [transform._bound(names) for transform in chain]

    def _constants(self, shape: Shape, params: Params | None) -> Mapping[str, float]:
        """The fields whose values are the same in all draws for images of a shape, and in given parameters, as far as the host has
        them.
        """
        generator = self._param_generator
        if generator is None or generator.derives or self._draws_by_name or not self.keeps_positions:
            return {}
        names = name_columns(generator.fields)

        def find() -> dict[str, float]:
            values = constant_values(generator.draws(shape))
            each = {name: values[columns[0].position] for name, columns in names.items()}
            return {name: value for name, value in each.items() if value is not None}

        constants = self._plans.made(("constants", shape), find)
        if params is None or not constants:
            return constants
        tensors = [x for x in params.values() if isinstance(x, Tensor)]
        on_host = all(x.device.type == "cpu" and not x.requires_grad for x in tensors)
        if not on_host or is_compiling() or in_function_transform():
            return {}
        given = generator.to_columns(params, shape).double()
        return {n: value for n, value in constants.items() if bool((given[:, names[n][0].position] == value).all())}

    def _color_part(
        self, colors: Colors, span: Span | None, constants: Mapping[str, float] = MappingProxyType({})
    ) -> ColorPart:
        """Color steps with their columns. Where constant values of fields change nothing, cheaper ones replace them."""
        names = self._names_of_columns(span)
        steps, order = [step._reduced(constants)._bound(names) for step in colors.steps], None
        if colors.order is not None:
            order = [column.position for column in names[colors.order]]
        elif span is not None and span.has_chosen:  # the last columns, which `_request` of color augmentations adds
            end = span.first + span.width
            order = list(range(end - len(steps), end))
        return ColorPart(steps, order)

    # --- what is done to images ---

    def output_shape(self, shape: Shape, flags: dict[str, Any]) -> Shape:
        """The shape of the results for images of a shape."""
        return shape

    def _result_dtype(self, dtype: torch.dtype) -> torch.dtype:
        """The type of the results for images of a type; float32 for uint8 where values leave [0, 1]."""
        return dtype

    def identity_matrix(self, input: Tensor | Sequence[int]) -> Tensor:
        """An identity matrix for each sample of images, or of a shape (B, ...)."""
        n = self.axes
        if isinstance(input, Tensor):
            like, batch = input, input.shape[0]
            dtype = input.dtype if input.dtype in (torch.float32, torch.float64) else torch.float32
            return torch.eye(n, device=like.device, dtype=dtype).expand(batch, n, n)
        return torch.eye(n, device="cpu").expand(input[0], n, n)

    def compute_transformation(self, input: Tensor, params: Params, flags: dict[str, Any]) -> Tensor:
        """The matrices (B, 3, 3), (B, 4, 4) of volumes, from image pixels to result pixels."""
        return self.identity_matrix(input)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Apply the augmentation with given parameters to all samples."""
        raise NotImplementedError(f"{type(self).__name__}.apply_transform")

    def _contribution(self, shape: Shape, flags: dict[str, Any]) -> Contribution | None:
        """What this augmentation adds to passes with its neighbors; None where a method replaces what the class declares."""
        return None if self._is_customized() else self._declared(shape, flags)

    def _declared(self, shape: Shape, flags: dict[str, Any]) -> Contribution:
        """The contribution of the class for images of a shape: none to a pass, unless a subclass says more."""
        return Contribution()

    def _executes_columns(self, shape: Shape) -> bool:
        """Whether this augmentation is executed from columns, without parameters by name."""
        return False

    def _further_columns(self, shape: Shape, values: Tensor, chosen: Tensor | None) -> list[Tensor]:
        """Columns that follow those of the parameters."""
        return []

    # --- what is done to masks, boxes and points ---

    def apply_transform_mask(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Move the masks of all samples with given parameters, for subclasses to override."""
        return input

    # --- what replaces it ---

    def _is_overridden(self, name: str) -> bool:
        """Whether a method, of a class or of this object, replaces one that keeps the contract."""
        cls = type(self)
        return name in self.__dict__ or getattr(cls, name, None) is not cls._own_methods[name]

    @property
    def _draws_by_name(self) -> bool:
        """Whether a method or the generator draws parameters by name, without columns."""
        generator = self._param_generator
        return self._is_overridden("generate_parameters") or (generator is not None and generator._draws_by_name)

    @kept
    def _is_customized(self) -> bool:
        """Whether a method replaces what containers would join."""
        return self._draws_by_name or any(self._is_overridden(name) for name in _OVERRIDABLE)


def size_of(shape: Sequence[int], like: Tensor) -> Tensor:
    """Height and width of images of a shape as numbers (1, 2)."""
    return constant(tuple(shape[-2:]), like)[None]


def _shown(value: Any) -> str:
    return str(
        value.name.lower() if isinstance(value, Enum) else value.tolist() if isinstance(value, Tensor) else value
    )
