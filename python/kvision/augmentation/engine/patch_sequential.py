"""Augmentations of the cells of a grid over images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, get_args

import torch
import torch.nn.functional as F
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._choices import OutputType, WindowPadding
from kvision.augmentation.engine.call_context import CallContext
from kvision.augmentation.engine.chain_executor import checked_items
from kvision.augmentation.engine.image_sequential import ImageSequential
from kvision.augmentation.engine.record import AnyParamItem, Child, ParamItem, Record, item_of
from kvision.augmentation.engine.result_types import in_wider_type
from kvision.augmentation.engine.runs import execute
from kvision.augmentation.engine.sized import Sizes
from kvision.augmentation.engine.stages import Cells, Chain
from kvision.augmentation.engine.turns import execute_turns
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.keys import Seed, frame_seeds
from kvision.augmentation.sample_rows import numbers_by
from kvision.augmentation.warp_and_color import SAME
from kvision.core.exceptions import ShapeError, ValueCheckError
from kvision.core.pixels import to_unit

Padding = tuple[int, int, int, int]


class PatchParamItem(NamedTuple):
    """The parameters of a child for some cells, by their numbers row by row; None stands for all."""

    indices: list[int] | None
    param: AnyParamItem


class PatchSequential(ImageSequential):
    """Cut images into the cells of a grid, augment the cells, and join them again.

    Cells are views of the images; those that get the same children are one batch. Augmentations have to keep their size. Inside an
    AugmentationSequential labels stay where they are; if cells are moved, or cropped by padding 'valid', they are refused.

    Args:
        *args: augmentations, or any modules of images.
        grid_size: rows and columns of cells.
        padding: 'same' pads images with 0 to a multiple of the grid and removes that from the result; 'valid' crops them to
            one. Both are centered.
        same_on_batch: if not None, that of all children.
        keepdim: if not None, that of all children.
        patchwise_apply: each cell is augmented for itself: without `random_apply` by the child of its number, with it by
            children drawn for the cell. False: all children, one after the other, augment a batch of all cells.
        random_apply: False runs all children in order; True a random number of them in random order; n that many; (n, m) at
            least n and fewer than m.
        random_apply_weights: relative probabilities of the children with `random_apply`.
        generator: draws the keys of each call; default: torch's generator.
        return_transform: calls return the images and identity matrices; refused where cells move.

    Raises:
        TypeError: a child is not a module; `grid_size` is not two ints.
        ValueError: `padding` is unknown; with `patchwise_apply` and without `random_apply`, another number of children than
            of cells.

    Example:
        >>> import torch, kvision as K
        >>> invert = K.augmentation.RandomInvert(p=1.0)
        >>> halves = K.augmentation.PatchSequential(invert, torch.nn.Identity(), grid_size=(1, 2))
        >>> halves(torch.zeros(1, 1, 1, 4))
        tensor([[[[1., 1., 0., 0.]]]])
    """

    _item_field = "param"

    def __init__(
        self,
        *args: nn.Module,
        grid_size: tuple[int, int] = (4, 4),
        padding: WindowPadding = "same",
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        patchwise_apply: bool = True,
        random_apply: int | bool | tuple[int, int] = False,
        random_apply_weights: Sequence[float] | None = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
    ) -> None:
        super().__init__(
            *args,
            same_on_batch=same_on_batch,
            keepdim=keepdim,
            random_apply=random_apply,
            random_apply_weights=random_apply_weights,
            generator=generator,
            return_transform=return_transform,
        )
        self.grid_size = parse_size("PatchSequential", grid_size)
        _check.choice("PatchSequential", "padding", padding, get_args(WindowPadding))
        cells = self.grid_size[0] * self.grid_size[1]
        if patchwise_apply and random_apply is False and len(args) != cells:
            raise ValueCheckError(
                f"PatchSequential: expected {cells} children, one of each cell, got {len(args)}; use random_apply, or "
                "patchwise_apply=False"
            )
        self.padding, self.patchwise_apply = padding, patchwise_apply

    def _result_dtype(self, dtype: torch.dtype) -> torch.dtype:
        return self._type_of_choices(dtype) if self.patchwise_apply else super()._result_dtype(dtype)

    @property
    def _always_chooses(self) -> bool:
        return not self._draws_choices or super()._always_chooses  # a child of its own in each cell

    def _sizes_after(self, sizes: Sizes) -> Sizes | None:
        return sizes if self.padding == "same" else None

    # --- cells ---

    def compute_padding(
        self, input: Tensor, padding: WindowPadding, grid_size: tuple[int, int] | None = None
    ) -> Padding:
        """Left, right, top and bottom padding of images; negative where they are cropped."""
        sides: list[int] = []
        for n, cells in zip(reversed(input.shape[-2:]), reversed(grid_size or self.grid_size)):
            extra = -(n % cells) if padding == "valid" else -n % cells
            before = -(-extra // 2) if extra < 0 else extra // 2
            sides += [before, extra - before]
        return sides[0], sides[1], sides[2], sides[3]

    def extract_patches(
        self, input: Tensor, grid_size: tuple[int, int] | None = None, pad: Padding | None = None
    ) -> Tensor:
        """The cells (B, N, C, h, w) of images, by rows."""
        rows, columns = grid_size or self.grid_size
        x = input if pad is None or not any(pad) else F.pad(input, pad)
        b, c, h, w = x.shape
        self._check_grid(x, (rows, columns))
        cells = x.reshape(b, c, rows, h // rows, columns, w // columns)
        return cells.permute(0, 2, 4, 1, 3, 5).flatten(1, 2)

    @staticmethod
    def _check_grid(x: Tensor, grid_size: tuple[int, int]) -> None:
        rows, columns = grid_size
        h, w = x.shape[-2:]
        if h % rows or w % columns or not h or not w:
            raise ShapeError(
                f"PatchSequential: expected images that a grid {rows, columns} divides, got {tuple(x.shape)}"
            )

    def restore_from_patches(
        self, patches: Tensor, grid_size: tuple[int, int] | None = None, pad: Padding | None = None
    ) -> Tensor:
        """The images of cells (B, N, C, h, w); what `pad` has added is removed."""
        rows, columns = grid_size or self.grid_size
        b, _, c, h, w = patches.shape
        cells = patches.reshape(b, rows, columns, c, h, w).permute(0, 3, 1, 4, 2, 5)
        images = cells.reshape(b, c, rows * h, columns * w)
        return images if pad is None else F.pad(images, [-max(n, 0) for n in pad])

    # --- execution ---

    def forward(  # type: ignore[override]  # parameters of cells
        self,
        input: Tensor | tuple[Tensor, Tensor],
        params: Sequence[PatchParamItem] | None = None,
        extra_args: dict[Any, Any] | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
        return_transform: bool | None = None,
        output_type: OutputType = "pt",
    ) -> Any:
        """Augment the cells of images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8; a list of images (C, H, W) of
                different sizes, each of which has a grid of its own; or a pair of images and matrices.
            params: the `_params` of an earlier call, to repeat it on these images.
            extra_args: accepted for code written for Kornia.
            seed: an int, or int64 (B,) with one of a sample, from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.
            return_transform: also return the matrices; default: as the constructor says.
            output_type: "pt" for tensors, "numpy" for arrays with the channels last, "pil" for a list of PIL images.

        Returns:
            Images of the size of `input`, cropped to a multiple of the grid with padding 'valid'; with `return_transform` a pair
            of them and the matrices (B, 3, 3).

        Raises:
            TypeError: `input` is not a tensor of a floating-point type or uint8.
            ValueError: `input` has another number of axes; an augmentation changes the size of a cell.
        """
        options: dict[str, Any] = {"seed": seed, "generator": generator, "return_transform": return_transform}
        return super().forward(input, params, extra_args, output_type=output_type, **options)  # type: ignore[arg-type]

    def _execute(self, x: Tensor, params: Any, context: CallContext) -> tuple[Tensor, Record]:
        pad = self.compute_padding(x, self.padding)
        dtype = self._result_dtype(x.dtype)
        if dtype != x.dtype == torch.uint8 and self._draws_choices:  # in all cells, whichever gets that child
            x = to_unit(x)
        cells = self._cells(x, pad)
        items = params if params is None else [item.param for item in checked_items("PatchSequential", params, "param")]
        in_turns = self._in_turns(range(len(cells) * len(x)), items, context)
        if in_turns is not None:
            everything = list(range(len(cells)))
            batch, own = self._taken(cells, everything, context)
            y, _, children = execute_turns(batch, in_turns[0], own)
            self._put(cells, everything, batch, y)
            executed: list[tuple[list[int] | None, Child]] = [(None, child) for child in children]
        else:
            count = len(cells)
            chains = self._chains(count, context) if params is None else self._replayed_chains(count, params)
            executed = self._run_chains(cells, chains, context)
        is_cropped = any(pad) and self.padding == "valid"
        moves = is_cropped or any(getattr(child.module, "_moves_labels", False) for _, child in executed)
        cells = [in_wider_type(cell, dtype) for cell in cells]
        y = self.restore_from_patches(torch.stack(cells, 1), pad=pad)
        stages, items = Chain([Cells()] if moves else []), None if params is None else list(params)
        return y, Record(tuple(x.shape), (), stages, size=tuple(y.shape[2:]), cells=executed, items=items)

    def _run_chains(
        self, cells: list[Tensor], chains: Sequence[Sequence[Child]], context: CallContext
    ) -> list[tuple[list[int] | None, Child]]:
        """Run the children of each cell; cells with the same ones are one batch. Gives them with the numbers of their cells."""
        executed: list[tuple[list[int] | None, Child]] = []
        position = context.position
        for numbers in _groups(chains):
            children = [replace(child) for child in chains[numbers[0]]]
            executed += [(None if len(numbers) == len(cells) else numbers, child) for child in children]
            x, own = self._taken(cells, numbers, context)
            self._put(cells, numbers, x, execute(x, children, own, position)[0])
            position += len(children)
        return executed

    def _sequences_of_samples(self, context: CallContext, samples: int) -> Sequence[Sequence[int]]:
        """The numbers of the children of each sample of each cell, of which there are so many together, or one."""
        count = self.grid_size[0] * self.grid_size[1]
        samples = max(samples, count)
        if not self.patchwise_apply:
            return [*super()._sequences_of_samples(context, samples // count)] * count
        sequences: list[Sequence[int]] = []
        for of_cell in self._contexts_of_cells(count, context):
            sequences += super()._sequences_of_samples(of_cell, samples // count)
        return sequences

    def _contexts_of_cells(self, count: int, context: CallContext) -> list[CallContext]:
        """The contexts with the seeds by which each cell gets children of its own."""
        seed, first = context.seed, context.position * count + 1
        seeds = [seed if seed is None else seed + ((first + i) << 32) for i in range(count)]
        return [context._replace(seed=own, position=0) for own in seeds]

    def _cells(self, x: Tensor, pad: Padding) -> list[Tensor]:
        """The cells (B, C, h, w), by rows: views of the images."""
        rows, columns = self.grid_size
        x = F.pad(x, pad) if any(pad) else x
        h, w = x.shape[-2] // rows, x.shape[-1] // columns
        self._check_grid(x, (rows, columns))
        return [x[..., r * h : (r + 1) * h, c * w : (c + 1) * w] for r in range(rows) for c in range(columns)]

    def _chains(self, count: int, context: CallContext) -> list[list[Child]]:
        """The children of each cell, in their order."""
        if not self.patchwise_apply:
            return [self._children_of_call(None, context)] * count
        if self.random_apply is None:
            return [[child] for child in self._own_children()]
        return [self._children_of_call(None, of_cell) for of_cell in self._contexts_of_cells(count, context)]

    def _replayed_chains(self, count: int, params: Sequence[PatchParamItem]) -> list[list[Child]]:
        modules = dict(self.named_children())
        chains: list[list[Child]] = [[] for _ in range(count)]
        checked_items(type(self).__name__, params, "param")
        for indices, item in params:
            child = Child(item.name, modules[item.name], item.data)
            for cell in range(count) if indices is None else indices:
                chains[cell].append(child)
        return chains

    def _taken(
        self, cells: Sequence[Tensor], numbers: Sequence[int], context: CallContext
    ) -> tuple[Tensor, CallContext]:
        """Some cells as one batch, and the context of what runs on it."""
        x = cells[numbers[0]] if len(numbers) == 1 else torch.cat([cells[n] for n in numbers])
        seed = context.seed
        if isinstance(seed, Tensor) and seed.dim() == 1:
            of_cells = frame_seeds(seed, len(cells)).unflatten(0, (len(seed), len(cells)))
            seed = torch.cat([of_cells[:, n] for n in numbers])
        return x, context._replace(seed=seed, output=SAME, plans=self._plans, has_labels=False)

    @staticmethod
    def _put(cells: list[Tensor], numbers: Sequence[int], x: Tensor, y: Tensor) -> None:
        """Let what a batch of cells became be the cells."""
        if y.shape != x.shape:
            raise ShapeError(
                f"PatchSequential: expected augmentations that keep the size of cells, got {tuple(y.shape)} from "
                f"{tuple(x.shape)}"
            )
        parts = y.split(len(x) // len(numbers)) if len(x) else [y] * len(numbers)
        for n, cell in zip(numbers, parts):
            cells[n] = cell

    def forward_parameters(self, batch_shape: Sequence[int]) -> list[PatchParamItem]:  # type: ignore[override]
        """Draw the parameters of a call on images of a shape (B, C, H, W), without executing it; `forward` takes them."""
        cells = self.grid_size[0] * self.grid_size[1]
        b, c, *sides = batch_shape
        keep = self.padding == "valid"
        cell = [n // parts if keep else -(-n // parts) for n, parts in zip(sides, self.grid_size)]
        chains, items = self._chains(cells, self._context(None, None)), []
        for numbers in _groups(chains):
            indices = None if len(numbers) == cells else numbers
            for child in chains[numbers[0]]:
                draw = getattr(child.module, "forward_parameters", None)
                data = None if draw is None else draw((b * len(numbers), c, *cell))
                items.append(PatchParamItem(indices, ParamItem(child.name, data)))
        return items

    def _items(self, record: Record) -> list[Any]:
        return [PatchParamItem(indices, item_of(child)) for indices, child in record.cells]


def _groups(chains: Sequence[Sequence[Child]]) -> list[list[int]]:
    """The numbers of cells that get the same children: one batch each."""
    return list(numbers_by(tuple((child.name, id(child.params)) for child in chain) for chain in chains).values())
