"""Chains of augmentations of images."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from typing import Any, get_args

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._choices import EachOrOnce, OutputType
from kvision._modules import give_own_forward
from kvision._ops import FLOATS
from kvision._tv_tensors import wrap
from kvision.augmentation.engine.augmentation import AugmentationBase
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.call_labels import CallLabels
from kvision.augmentation.engine.choices import Choices
from kvision.augmentation.engine.configuration import Plans, kept, portable, settings_changed
from kvision.augmentation.engine.declaration import KeepsArguments
from kvision.augmentation.engine.execution import check_batch_of_params, matrix_type
from kvision.augmentation.engine.list_calls import (
    SIZES,
    Parts,
    Sizes,
    call_in_parts,
    gives_one_size,
    shapes_of_images,
    sizes_after,
)
from kvision.augmentation.engine.list_chains import replay_chain, run_chain
from kvision.augmentation.engine.list_replays import ReplayedParts, replay_list
from kvision.augmentation.engine.list_runs import run_list
from kvision.augmentation.engine.lists import list_plan
from kvision.augmentation.engine.record import Child, ParamItem, Record, child_of, item_of
from kvision.augmentation.engine.result_types import common_dtype, in_wider_type, result_dtype
from kvision.augmentation.engine.runs import execute, images_of
from kvision.augmentation.engine.stages import KNOWN, ByMatrix, Chain, LabelSettings, Nested, Stage
from kvision.augmentation.engine.turns import SomeSamples, Turn, execute_turns, turns_of
from kvision.augmentation.inputs import (
    WIDE_INTEGERS,
    as_batch,
    as_output_type,
    check_batch,
    check_matrix,
    check_output_type,
    checked_images,
    image_and_matrix,
    image_of,
    in_type_of,
    is_image_list,
    plain_image,
)
from kvision.augmentation.keys import Seed, check_seeds, draw_keys, refuse_capture, refuse_graphs
from kvision.augmentation.samples import (
    at_scale,
    inverse_at,
    is_known,
    known_everywhere,
    with_matrix,
    without_added_axes,
)
from kvision.augmentation.warp_and_color import SAME, Output
from kvision.color.frames import Frames
from kvision.constants import DataKey
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.core.pixels import to_unit

Children = Iterator[tuple[str, nn.Module]]


class ImageSequentialBase(KeepsArguments, nn.Sequential):
    """Base of the containers: children in order, with what they share.

    Args:
        *args: augmentations, other containers, or any modules of images.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children, and of the container.

    Raises:
        TypeError: a child is not a module.

    Example:
        >>> import kvision as K
        >>> len(K.augmentation.container.ImageSequentialBase(K.augmentation.RandomHorizontalFlip()))
        1
    """

    _record: Record = Record()  # of the last call; nothing else of a call is kept
    generator: Generator | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        give_own_forward(cls)

    def __init__(self, *args: nn.Module, same_on_batch: bool | None = None, keepdim: bool | None = None) -> None:
        op = type(self).__name__
        for module in args:
            if not isinstance(module, nn.Module):
                raise TypeCheckError(f"{op}: expected children to be modules, got {type(module).__name__}")
        super().__init__()
        for i, module in enumerate(args):
            name = f"{type(module).__name__}_{i}"
            # A module that the chain has twice has two states.
            known = any(module is other for other in self.children())
            self.add_module(name, copy.deepcopy(module) if known else module)
        self._same_on_batch, self._keepdim = same_on_batch, keepdim
        self._plans = Plans()
        self._set_options_of_children()

    def __setattr__(self, name: str, value: Any) -> None:
        settings_changed()
        super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, Any]:
        # Copies and pickles have the settings, not the last call.
        state = {name: value for name, value in self.__dict__.items() if name != "_record"}
        return portable({**state, "_arguments": self._portable_arguments()})

    def _set_options_of_children(self) -> None:
        for child in self.children():
            for name in ("same_on_batch", "keepdim"):
                value = getattr(self, f"_{name}")
                if value is not None and hasattr(child, name):
                    setattr(child, name, value)

    @property
    def same_on_batch(self) -> bool | None:
        """Whether all samples get the same parameters; None leaves it to the children."""
        return self._same_on_batch

    @same_on_batch.setter
    def same_on_batch(self, value: bool | None) -> None:
        self._same_on_batch = value
        self._set_options_of_children()

    @property
    def keepdim(self) -> bool | None:
        """Whether results have the number of axes of the input; None leaves it to the children."""
        return self._keepdim

    @keepdim.setter
    def keepdim(self, value: bool | None) -> None:
        self._keepdim = value
        self._set_options_of_children()

    def clear_state(self) -> None:
        """Forget the last call."""
        self.__dict__.pop("_record", None)

    def _keep(self, record: Record) -> None:
        self.__dict__["_record"] = record  # Module.__setattr__ is slow, because it looks for parameters

    def identity_matrix(self, input: Tensor) -> Tensor:
        """An identity matrix (3, 3) for each sample."""
        return torch.eye(3, device=input.device).expand(input.shape[0], 3, 3)


class ImageSequential(ImageSequentialBase):
    """Run augmentations one after the other on images, joined into few passes over memory.

    Args:
        *args: augmentations, other containers, or any modules of images.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children.
        random_apply: False runs all children in order; True a random number of them in random order; n that many; (n, m) at
            least n and fewer than m. More than there are children means drawing with replacement.
        random_apply_weights: relative probabilities of the children with `random_apply`.
        if_unsupported_ops: accepted for code written for Kornia; any module may be a child.
        disable_item_features, disable_sequential_features: accepted for code written for Kornia.
        resample: "each" interpolates in every geometric augmentation; "once" multiplies the matrices of neighboring ones,
            composes them with elastic, thin-plate and fisheye maps between them, and interpolates once: beyond a crop is
            the image. Pixels from outside of it are those of the first one that interpolates. With antialiased resizing among
            them, a pixel is the mean of what it covers where that is more than a pixel.
        generator: draws the keys of each call; default: torch's generator.
        output_dtype: type of the results; default: that of the images. Floating-point types have uint8 images in [0, 1].
        memory_format: `torch.channels_last` or `torch.contiguous_format` for the results; default: that of the images.
        return_transform: calls return the image and the product of the matrices.

    Raises:
        TypeError: a child is not a module; `random_apply` is neither a bool nor one or two ints; `output_dtype` is no
            type of images.
        ValueError: `random_apply_weights` has another length; `resample` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> augment = K.augmentation.ImageSequential(
        ...     K.augmentation.RandomHorizontalFlip(p=1.0), K.augmentation.Normalize(mean=1.0, std=1.0)
        ... )
        >>> augment(torch.tensor([[[[1.0, 2.0, 3.0]]]]))
        tensor([[[[2., 1., 0.]]]])
    """

    transformation_matrix_mode = "silent"
    takes_lists = True  # of images of different sizes
    _item_field = "name"  # that each item of `_params` has

    @property
    def accepts_wide_integers(self) -> bool:
        """Whether all children move pixels and nothing else, so that images may be int16 or uint16."""
        return len(self) > 0 and all(getattr(child, "accepts_wide_integers", False) for child in self.children())

    def __init__(
        self,
        *args: nn.Module,
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        random_apply: int | bool | tuple[int, int] | tuple[int] = False,
        random_apply_weights: Sequence[float] | None = None,
        if_unsupported_ops: str = "raise",
        disable_item_features: bool = True,
        disable_sequential_features: bool = False,
        resample: EachOrOnce = "each",
        generator: Generator | None = None,
        output_dtype: torch.dtype | None = None,
        memory_format: torch.memory_format | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__(*args, same_on_batch=same_on_batch, keepdim=keepdim)
        op = type(self).__name__
        _check.choice(op, "resample", resample, get_args(EachOrOnce))
        if random_apply_weights is not None and len(random_apply_weights) != len(self):
            raise ValueCheckError(
                f"{op}: expected {len(self)} random_apply_weights, one of each child, got {len(random_apply_weights)}"
            )
        self.random_apply = self._counts(random_apply)
        self.random_apply_weights = None if random_apply_weights is None else list(random_apply_weights)
        if output_dtype is not None and output_dtype not in (*FLOATS, torch.uint8):
            raise TypeCheckError(
                f"{op}: expected output_dtype to be uint8 or a floating-point type, got {output_dtype!r}"
            )
        if memory_format not in (None, torch.contiguous_format, torch.channels_last):
            raise ValueCheckError(
                f"{op}: expected memory_format to be torch.contiguous_format or torch.channels_last, got {memory_format!r}"
            )
        self.resample, self.generator = resample, generator
        self.output_dtype, self.memory_format = output_dtype, memory_format
        self.return_transform = return_transform

    def _counts(self, random_apply: Any) -> tuple[int, int] | None:
        """The lowest number of children that run, and the end of the range of numbers; None for all in order."""
        if random_apply is False:
            return None
        if random_apply is True:
            return (1, len(self) + 1)
        if isinstance(random_apply, int):
            random_apply = (random_apply, random_apply + 1)
        numbers = random_apply if isinstance(random_apply, (tuple, list)) else ()
        if len(numbers) == 1:
            numbers = (numbers[0], len(self) + 1)
        if len(numbers) != 2 or not all(isinstance(n, int) for n in numbers) or not 0 <= numbers[0] < numbers[1]:
            raise ValueCheckError(
                f"{type(self).__name__}: expected random_apply to be a bool, a number of children or a range of "
                f"numbers, got {random_apply!r}"
            )
        return (numbers[0], numbers[1])

    # --- which children run ---

    def get_children_by_params(self, params: Sequence[ParamItem]) -> Children:
        """The children that the parameters of a call name, in its order."""
        modules = dict(self.named_children())
        for item in checked_items(type(self).__name__, params):
            if item.name not in modules:
                raise ValueCheckError(
                    f"{type(self).__name__}: there is no child {item.name!r}, of which params has parameters"
                )
            yield item.name, modules[item.name]

    def get_forward_sequence(self, params: Sequence[ParamItem] | None = None) -> Children:
        """The children of a call in the order of execution."""
        if params is not None:
            return self.get_children_by_params(params)
        if self.random_apply is None:
            return iter(self._modules.items())
        return self.get_random_forward_sequence()

    def get_random_forward_sequence(
        self, with_mix: bool = True, seed: Seed = None, generator: Generator | None = None
    ) -> Children:
        """Children drawn as `random_apply` says, at most one of which mixes samples."""
        children = list(self.named_children())
        op = type(self).__name__
        if seed is None:
            refuse_capture(op)
        keys = draw_keys(op, 1, torch.device("cpu"), seed, generator or self.generator)
        return iter([children[at] for at in self._choices().of_key(keys.on_host(op)[0], with_mix)])

    def _choices(self) -> Choices:
        """Which children may run, as `random_apply` says."""
        children = list(self.children())
        low, end = self.random_apply or (len(children), len(children) + 1)
        mixes = [bool(getattr(child, "mixes_samples", False)) for child in children]
        return Choices(low, end, self.random_apply_weights or [1.0] * len(children), mixes)

    def _chooses_for_samples(self, context: CallContext) -> bool:
        """Whether each sample gets children of its own. What mixes samples runs for the batch or not at all."""
        seed = context.seed
        if self.random_apply is None or not isinstance(seed, Tensor) or seed.dim() != 1:
            return False
        return not any(getattr(module, "mixes_samples", False) for module in self.modules())

    def _sequences_of_samples(self, context: CallContext, samples: int) -> Sequence[Sequence[int]]:
        """The numbers of the children of each sample, whose seeds the call has."""
        refuse_graphs(context.op)
        check_seeds(context.op, draw_keys(context.op, 1, torch.device("cpu"), context.seed, None), samples)
        assert isinstance(context.seed, Tensor)
        return self._choices().of_seeds(_moved(context.seed, context.position))

    # --- lists ---

    @kept
    def _runs_all(self) -> bool:
        """Whether a call runs all children in their order, and does nothing else."""
        return self._reads_frames and not self._draws_choices and len(self) > 0

    @kept
    def _reads_lists(self) -> bool:
        """Whether the first child makes a list a batch by one launch, so that the list is not taken image by image."""
        return (
            self._runs_all() and self.resample == "each" and list_plan(next(iter(self._modules.values()))) is not None
        )

    @property
    def _runs_lists(self) -> bool:
        """Whether the children run one after the other, or are chosen, so that they can be run on a list."""
        own = type(self)
        return own._execute is ImageSequential._execute and own._execute_nested is ImageSequential._execute_nested

    @property
    def _reads_frames(self) -> bool:
        """Whether frames of video are handed to the children."""
        return type(self)._execute is ImageSequential._execute

    @property
    def _draws_choices(self) -> bool:
        """Whether the container draws by itself, beside its children."""
        return self.random_apply is not None

    def _result_dtype(self, dtype: torch.dtype) -> torch.dtype:
        """The type of the results for images of a type."""
        if self.output_dtype is not None:
            return self.output_dtype
        if self._draws_choices:
            return self._type_of_choices(dtype)
        for module in self.children():
            dtype = result_dtype(module, dtype)
        return dtype

    def _type_of_choices(self, dtype: torch.dtype) -> torch.dtype:
        """The type of what the children give for images of a type, the same whichever of them are drawn."""

        def find() -> torch.dtype:
            types = [result_dtype(module, dtype) for module in self.children()]
            return common_dtype(types if self._always_chooses else [dtype, *types])

        return self._plans.made(("type", dtype), find)

    @property
    def _always_chooses(self) -> bool:
        """Whether each sample gets a child for certain, where children are drawn."""
        return self.random_apply is not None and self.random_apply[0] > 0

    def _sizes_after(self, sizes: Sizes) -> Sizes | None:
        """What the children make of two sizes; None where it depends on more than these."""
        if self.random_apply is not None:
            return sizes if all(sizes_after(module, sizes) == sizes for module in self.children()) else None
        after: Sizes | None = sizes
        for module in self.children():
            after = sizes_after(module, SIZES if after is None else after)
        return after

    def _call_list(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Any], Record]:
        """The results of a call on a list of images, in the launches of a batch or image by image, and its record."""
        if params is not None:
            params = list(checked_items(type(self).__name__, params, self._item_field))
        of_passes = self._call_list_by_passes(keys, inputs, params, seed, generator)
        if of_passes is not None:
            return of_passes
        call = self._call_of_parts(keys, inputs)
        outputs, parts = call_in_parts(list(self.modules()), keys, inputs, params, seed, generator, call)
        return outputs, Record(parts=parts)

    def _call_list_by_passes(
        self, keys: Sequence[DataKey], inputs: Sequence[Any], params: Any, seed: Seed, generator: Generator | None
    ) -> tuple[list[Any], Record] | None:
        """The same of a call whose children are passes over all images; None of others."""
        if not self._runs_lists or not len(self):
            return None
        if params is not None:
            return self._replay_list_by_passes(inputs, params) if len(keys) == 1 else None
        if list(keys).count(DataKey.INPUT) != 1:  # others replay the parameters
            return None
        context = self._context(seed, generator)._replace(has_labels=len(keys) > 1)
        images = inputs[keys.index(DataKey.INPUT)]
        results: tuple[Any, Parts] | None = None
        if not self._draws_choices:
            results = run_list(images, self._own_children(), context)
        if results is None:
            results = run_chain(self, images, context, generator)
        if results is None:
            return None
        y, parts = results
        if isinstance(y, list) and gives_one_size(self):
            y = torch.stack(y)
        return self._with_labels_of_list(keys, inputs, y, parts), Record(parts=parts)

    def _replay_list_by_passes(self, inputs: Sequence[Any], params: list[Any]) -> tuple[list[Any], Record] | None:
        """The same with given parameters."""
        context, (images,) = self._context(None, None), inputs
        children = self._children_of_call(params, context)
        for child in children:
            if child.samples is not None:
                check_batch_of_params(context.op, child.batch, len(images))
        y = replay_list(images, children, context)
        if y is None:
            y = replay_chain(self, images, params, context)
        if y is None:
            return None
        if isinstance(y, list) and gives_one_size(self):
            y = torch.stack(y)
        return [y], Record(parts=ReplayedParts(context.op, images, params, self._record_of_part), items=params)

    def _with_labels_of_list(self, keys: Sequence[DataKey], inputs: Sequence[Any], y: Any, parts: Any) -> list[Any]:
        """What the inputs of a call on a list become, whose images became y."""
        return [y]

    def _call_of_parts(self, keys: Sequence[DataKey], inputs: Sequence[Any]) -> Callable[..., Any]:
        """What gives the results of a call on some images of a list as a batch, and its record, for their inputs."""

        def call(own: list[Any], params: Any, seed: Seed, generator: Generator | None) -> tuple[list[Any], Record]:
            y, record = self._execute(own[0], params, self._context(seed, generator))
            record.stages.forget()
            return [y], record

        return call

    def _parts_of(
        self, params: Sequence[ParamItem] | None, outputs: Any = None, like: Tensor | None = None
    ) -> Parts | None:
        """The parts of the last call, or of given parameters, if it was one on a list; None of others.

        Without `outputs` images stand for them that are `like` one, or on the CPU.
        """
        if params is None:
            return self._record.parts
        shapes = shapes_of_images(params)
        if shapes is None and is_image_list(self, outputs):
            shapes = [None] * len(outputs)
        if shapes is None:
            return None
        if outputs is None and like is not None:
            outputs = [like[0]] * len(shapes)
        return Parts.of_params(type(self).__name__, list(params), shapes, outputs, self._record_of_part)

    def _record_of_part(self, like: Tensor, shape: tuple[int, ...], params: Any) -> Record:
        return self._replayed(torch.zeros(1, device=like.device).expand(shape), params)

    def _replayed(self, x: Tensor, params: Any) -> Record:
        """A call with given parameters."""
        return self._execute(x, params, self._context(None, None))[1]

    # --- execution ---

    def transform_tensor(self, input: Tensor) -> Tensor:
        """The input as a batch, lists as they are: (H, W) and (C, H, W) become (1, C, H, W); integers of 16 bits become float32."""
        if isinstance(input, list) and is_image_list(self, input):
            images: Any = checked_images(self, input)
            return images
        axes = self._axes()
        check_batch(self, input, axes)
        return as_batch(input, axes)

    @kept
    def _axes(self) -> int:
        """The axes of an image with its channels; of a volume, where a child takes these."""
        return max([3, *(m.axes for m in self.modules() if isinstance(m, AugmentationBase))])

    def _own_children(self) -> list[Child]:
        """All children in their order."""
        return [Child(name, module) for name, module in self._modules.items()]

    def _children_of_call(self, params: Sequence[ParamItem] | None, context: CallContext) -> list[Child]:
        if params is not None:
            by_name = self.get_children_by_params(params)
            return [child_of(item, module) for (_, module), item in zip(by_name, params)]
        if self.random_apply is None:
            sequence = self.get_forward_sequence()
        else:
            seed = None if context.seed is None else _moved(context.seed, context.position)
            sequence = self.get_random_forward_sequence(seed=seed, generator=context.generator_of(self))
        return [Child(name, module) for name, module in sequence]

    def _execute(self, x: Tensor, params: Sequence[ParamItem] | None, context: CallContext) -> tuple[Tensor, Record]:
        """Run the children on images (B, C, H, W); gives the images and what the call did."""
        dtype = self._type_of_choices(x.dtype) if self._draws_choices else None
        if dtype is not None and dtype != x.dtype == torch.uint8:  # for all samples, whichever gets that child
            x, context = (
                to_unit(x if context.source is None else images_of(context.source)),
                context._replace(source=None),
            )
        in_turns = self._in_turns(x, params, context)
        if in_turns is not None:
            turns, own = in_turns
            if own.source is not None:
                x, own = images_of(own.source), own._replace(source=None)
            y, stages, children = execute_turns(x, turns, own)
        else:
            children = self._children_of_call(params, context)
            y, stages = execute(x, children, context)
        if dtype is not None and self.output_dtype is None:
            y = in_wider_type(y, dtype)
        size, is_of_list = tuple(y.shape[2:]), isinstance(x, list)
        values: dict[str, Any] = {"size": size, "is_of_list": is_of_list, "identity": matrix_type(y)}
        return y, Record(None if is_of_list else tuple(x.shape), children, Chain(stages), **values)

    def _in_turns(
        self, x: Any, params: Sequence[Any] | None, context: CallContext
    ) -> tuple[list[Turn], CallContext] | None:
        """The turns of a call in which samples have children of their own, and their context; None where all have the same."""
        if params is not None:
            children = self._children_of_call(params, context)
            turns = self._turns_of_params(children, len(x))
            return (turns, context) if any(child.samples is not None for child in children) else None
        if not self._chooses_for_samples(context):
            return None
        frames = max(context.time, context.frames, 1)
        sequences = self._sequences_of_samples(context, len(x) // frames)
        units = self._units(self._own_children())
        return turns_of(units, sequences, frames, context.position), context

    def _turns_of_params(self, children: Sequence[Child], batch: int) -> list[Turn]:
        """The turns of a call that is replayed."""
        for child in children:
            if child.samples is not None:
                check_batch_of_params(type(self).__name__, child.batch, batch)
        return [Turn(unit, range(batch) if (s := unit[0].samples) is None else s) for unit in self._units(children)]

    def _units(self, children: Sequence[Child]) -> list[Sequence[Child]]:
        """What samples choose from, by its number: children by themselves, or several that run together."""
        return [[child] for child in children]

    def _inside(self, context: CallContext) -> CallContext:
        """The context of the children in a call of the container around this one."""
        return context.inside(self, context.once or self.resample == "once", self._plans, self._output)

    def _execute_nested(self, x: Tensor, params: Any, context: CallContext) -> tuple[Tensor, Stage, Record]:
        y, record = self._execute(x, params, self._inside(context))
        self._keep(record)
        return y, Nested(record.stages.stages, self._label_settings), record

    @property
    def _label_settings(self) -> LabelSettings | None:
        """What the container says about labels; None for what has no such settings."""
        return None

    @property
    def _output(self) -> Output:
        """The type and the layout of results."""
        is_same = self.output_dtype is None and self.memory_format is None
        return SAME if is_same else Output(self.output_dtype, self.memory_format)

    def _context(
        self,
        seed: Seed,
        generator: Generator | None,
        time: int = 0,
        labels: CallLabels | None = None,
        source: Frames | None = None,
    ) -> CallContext:
        op, once, plans, own = type(self).__name__, self.resample == "once", self._plans, self.generator
        has_labels = labels is not None
        context = CallContext(op, seed, generator, once, plans, self._output, 1, 0, time, has_labels, labels, own)
        context = context if source is None else context._replace(source=source)
        return self._of_frames(context) if time else context

    def _of_frames(self, context: CallContext) -> CallContext:
        """The context of frames of videos, which may share their parameters."""
        return context

    @property
    def _params(self) -> list[ParamItem]:
        """The names and parameters of the children of the last call, in its order."""
        return self._read_params(self._record)

    @_params.setter
    def _params(self, params: list[ParamItem]) -> None:
        self._keep(self._record.replaced(items=params, children=()))

    def _read_params(self, record: Record) -> list[Any]:
        """The parameters of a call by name."""
        if record.items is None:
            items = self._items(record) if record.parts is None else record.parts.params(self._read_params)
            record.items = items
        return record.items

    def _items(self, record: Record) -> list[Any]:
        return [item_of(child) for child in record.children]

    def forward(
        self,
        input: Tensor | tuple[Tensor, Tensor] | Frames,
        params: Sequence[ParamItem] | None = None,
        extra_args: dict[Any, Any] | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8. Images (C, H, W) of different sizes
                are a list; :class:`kvision.color.Frames` are read where they are by crops, resizes and warps at the start. A
                tuple of images and matrices (B, 3, 3) passes the matrices on, as chains with `return_transform` do.
                Images of NumPy and PIL and files become floating point in [0, 1].
            params: the `_params` of an earlier call, to repeat it on these images.
            extra_args: accepted for code written for Kornia.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays with the channels last, "pil" for a list of PIL images.

        Returns:
            Images (B, C, h, w) of the type of `input`; with `return_transform` a pair of them and the matrices (B, 3, 3). A
            list becomes a batch if the children give all images one size, as RandomResizedCrop does, and a list otherwise.

        Raises:
            TypeError: `input` is not a tensor of a floating-point type or uint8, nor what becomes one; it is a list, and a child
                mixes samples.
            ValueError: `input` has another number of axes; `params` names a child that there is not; matrices have another
                shape; `output_type` is unknown.
        """
        if output_type != "pt":
            check_output_type(self, output_type)
        source = input if isinstance(input, Frames) and self._reads_frames else None
        if isinstance(input, Frames):
            input = input.rgb() if source is None else self._like(source)
        given, before = (input, None) if isinstance(input, Tensor) else image_and_matrix(self, image_of(self, input))
        image = plain_image(self, given)
        x = self.transform_tensor(image)
        if before is not None:
            check_matrix(self, before, x)
        if isinstance(x, list) and not self._reads_lists():
            (y,), record = self._call_list([DataKey.INPUT], [x], params, seed, generator)
        else:
            y, record = self._execute(x, params, self._context(seed, generator, self._time(image), source=source))
            record.stages.forget()
        self._keep(record)
        y = self._restored(y, image)
        output = self._with_matrix(y if image is given else wrap(y, given), before, return_transform, record)
        return output if output_type == "pt" else as_output_type(output, output_type)

    def _with_matrix(self, y: Any, before: Tensor | None, return_transform: bool | None, record: Record) -> Any:
        """The result of a call, with its matrix if that is asked for, or with those that containers inside return."""
        returns = self.return_transform if return_transform is None else return_transform
        if returns is None:
            transform = self._matrix_of_inner(record)
        else:
            transform = self._matrix(record) if returns else None
        device = y[0].device if isinstance(y, list) else y.device
        return with_matrix(y, before, None if transform is None else transform.to(device))

    def _matrix_of_inner(self, record: Record) -> Tensor | None:
        """The product of the matrices that containers inside return, as one after the other does; None if none returns one."""
        if not self._has_inner_that_return() or record.shape is None:
            return None
        if record.parts is not None:
            return record.parts.matrix(self._matrix_of_inner)
        matrix = record.identity_matrix()
        for child in record.children:
            module = child.module
            if isinstance(module, ImageSequential) and module.return_transform is not False:
                own = module._matrix(child.record) if module.return_transform else module._matrix_of_inner(child.record)
                if own is not None:
                    stages = [ByMatrix(own)]
                    stage = Chain(stages) if child.samples is None else SomeSamples(stages, child.samples, child.batch)
                    matrix = stage.product(matrix)
        return matrix

    @kept
    def _has_inner_that_return(self) -> bool:
        inner = [m for m in self.modules() if m is not self and isinstance(m, ImageSequential)]
        return any(m.return_transform for m in inner)

    def _like(self, frames: Frames) -> Tensor:
        """What has the shape and the type of the images that frames are, but no values."""
        return frames._like()

    def _time(self, images: Tensor) -> int:
        """How many neighbors in a batch are frames of a video; 0 for images."""
        return 0

    def _restored(self, y: Tensor, input: Tensor) -> Tensor:
        """A result of the type and with the axes of the input."""
        if isinstance(input, list) or isinstance(y, list):
            return y
        if input.dtype in WIDE_INTEGERS and self.output_dtype is None:
            y = in_type_of(y, input)
        return without_added_axes(y, input) if y.dim() > input.dim() and self._keeps_axes() else y

    def _keeps_axes(self) -> bool:
        """Whether results have no more axes than the images."""
        if self.keepdim is not None:
            return self.keepdim
        augmentations = [m for m in self.children() if isinstance(m, AugmentationBase)]
        return bool(augmentations) and all(m.keepdim for m in augmentations)

    # --- matrices and the inverse ---

    @property
    def transform_matrix(self) -> Tensor | None:
        """The product (B, 3, 3) of the matrices of the last call; None before the first one, and where these are skipped."""
        return self._matrix(self._record)

    def _matrix(self, record: Record) -> Tensor | None:
        if record.parts is not None:
            return record.parts.matrix(self._matrix)
        if record.shape is None or self.transformation_matrix_mode == "skip":
            return None
        return record.stages.product(record.identity_matrix())

    def get_transformation_matrix(
        self,
        input: Tensor,
        params: Sequence[ParamItem] | None = None,
        recompute: bool = False,
        extra_args: dict[Any, Any] | None = None,
    ) -> Tensor | None:
        """The product (B, 3, 3) of the matrices of a call on `input`: the last one, or that of the given parameters."""
        if params is None and not recompute:
            return self.transform_matrix
        x, params = self.transform_tensor(input), self._params if params is None else params
        if isinstance(x, list) and not self._reads_lists():
            return self._matrix(self._call_list([DataKey.INPUT], [x], params, None, None)[1])
        record = self._replayed(x, params)
        return record.stages.product(record.identity_matrix())

    def inverse(
        self, input: Tensor, params: Sequence[ParamItem] | None = None, extra_args: dict[Any, Any] | None = None
    ) -> Tensor:
        """Undo the geometric part of a call, the last one unless parameters are given.

        Args:
            input: images (B, C, h, w) as that call returned them.
            params: the `_params` of the call.
            extra_args: accepted for code written for Kornia.

        Returns:
            Images of the size that the input had, of a list a list; 0 where the result has no data of them.
        """
        parts = self._parts_of(params, input)
        if parts is not None:
            return parts.each_result(self, input, lambda own, x: own.inverse(x))
        x = self.transform_tensor(input)
        record = self._record_to_invert(x, params)
        return self._restored(inverse_at(x, record.size, record.stages.invert), input)

    def known_pixels(self, output: Tensor, params: Sequence[ParamItem] | None = None) -> Tensor:
        """Which pixels of the images :meth:`inverse` finds in a result; the others were lost in the call, or in part.

        Args:
            output: images (B, C, h, w) as that call returned them, of which only the size and the device count.
            params: the `_params` of the call.

        Returns:
            bool (B, 1, H, W), of the size that :meth:`inverse` gives; of a list a list of (1, H, W).
        """
        if params is None and self._record.is_of_list:
            params = self._params
        parts = self._parts_of(params, output)
        if parts is not None:
            return parts.each_result(self, output, lambda own, x: own.known_pixels(x))
        x = self.transform_tensor(output)
        record = self._record_of(x, params)
        moved = record.stages.move_masks(known_everywhere(record.shape or tuple(x.shape), x.device), KNOWN)
        return at_scale(is_known(record.stages.invert(moved)), x.shape[2:], moved.shape[2:])

    def _record_of(self, x: Tensor, params: Sequence[ParamItem] | None) -> Record:
        """The last call, or one with given parameters on images of which only the size counts."""
        last = self._record
        params = last.items if params is None and last.shape is None else params  # given without a call
        if params is None:
            return last
        return self._replayed(x.new_zeros(1).expand(_input_shape(params) or last.shape or tuple(x.shape)), params)

    def _record_to_invert(self, x: Tensor, params: Sequence[ParamItem] | None) -> Record:
        record = self._record_of(x, params)
        if record.shape is None:
            raise RuntimeError(f"{type(self).__name__}.inverse: there was no call yet; pass its params")
        return record

    @property
    def _moves_labels(self) -> bool:
        return not self.is_intensity_only(strict=False)

    def is_intensity_only(self, strict: bool = True) -> bool:
        """Whether all children keep the positions of pixels; other modules count as moving them if `strict`."""
        return all(
            m.is_intensity_only(strict) if isinstance(m, ImageSequential) else getattr(m, "keeps_positions", not strict)
            for m in self.children()
        )

    def forward_parameters(self, batch_shape: Sequence[int]) -> list[ParamItem]:
        """Draw the parameters of a call on images of a shape, without executing it."""
        shape, items = tuple(batch_shape), []
        module: Any
        for name, module in self.get_forward_sequence():
            data = module.forward_parameters(shape) if hasattr(module, "forward_parameters") else None
            if isinstance(module, AugmentationBase):
                shape = module.output_shape(shape, module.flags)
            items.append(ParamItem(name, data))
        return items


def _moved(seed: Any, position: int) -> Any:
    """Another seed at each position in the chain, for the choices of other containers."""
    return seed + (position << 32) if position else seed


def checked_items(op: str, params: Any, field: str = "name") -> Sequence[Any]:
    """The parameters of children, as `_params` lists them: items with a field of this name."""
    if not isinstance(params, (list, tuple)) or not all(hasattr(item, field) for item in params):
        raise TypeCheckError(f"{op}: expected params to be the _params of a call, got {params!r:.80}")
    return params


def _input_shape(params: Sequence[ParamItem]) -> tuple[int, ...] | None:
    """The shape of the images of a call."""
    for item in params:
        data = getattr(item, "data", None)  # cells of a grid say nothing about the image
        samples = getattr(item, "samples", None)
        shape: tuple[int, ...] | None = None
        if isinstance(data, dict) and "forward_input_shape" in data:
            shape = tuple(int(n) for n in data["forward_input_shape"])
        elif isinstance(data, (list, tuple)):
            shape = _input_shape(data)
        if shape is not None:
            return shape if samples is None else (len(samples), *shape[1:])
    return None
