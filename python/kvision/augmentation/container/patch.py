"""Augmentations of the cells of a grid over images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Generator, Tensor, nn

from kvision.augmentation.base import AugmentationBase
from kvision.augmentation.container.image import ImageSequential, ParamItem
from kvision.augmentation.container.runs import Child, Randomness, execute
from kvision.augmentation.keys import Seed
from kvision.augmentation.random_generator.crop import parse_size
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

__all__ = ["PatchParamItem", "PatchSequential"]

Padding = tuple[int, int, int, int]


class PatchParamItem(NamedTuple):
    """The parameters of a child for some cells, by their numbers row by row; None stands for all."""

    indices: list[int] | None
    param: ParamItem


torch.serialization.add_safe_globals([PatchParamItem])


class PatchSequential(ImageSequential):
    """Cut images into the cells of a grid, augment the cells, and join them again.

    Cells are views of the images; those that get the same child are one batch. Augmentations have to keep their size.

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

    Raises:
        TypeError: a child is no module; `grid_size` is not two ints.
        ValueError: `padding` is unknown; with `patchwise_apply` and without `random_apply`, another number of children than
            of cells.

    Example:
        >>> import torch, kvision as K
        >>> invert = K.augmentation.RandomInvert(p=1.0)
        >>> halves = K.augmentation.PatchSequential(invert, torch.nn.Identity(), grid_size=(1, 2))
        >>> halves(torch.zeros(1, 1, 1, 4))
        tensor([[[[1., 1., 0., 0.]]]])
    """

    _of_cells: list[tuple[list[int] | None, Child]]  # of the last call

    def __init__(
        self,
        *args: nn.Module,
        grid_size: tuple[int, int] = (4, 4),
        padding: str = "same",
        same_on_batch: bool | None = None,
        keepdim: bool | None = None,
        patchwise_apply: bool = True,
        random_apply: int | bool | tuple[int, int] = False,
        random_apply_weights: Sequence[float] | None = None,
        generator: Generator | None = None,
    ) -> None:
        super().__init__(
            *args,
            same_on_batch=same_on_batch,
            keepdim=keepdim,
            random_apply=random_apply,
            random_apply_weights=random_apply_weights,
            generator=generator,
        )
        self.grid_size = parse_size("PatchSequential", grid_size)
        if padding not in ("same", "valid"):
            raise ValueCheckError(f"PatchSequential: expected padding to be 'same' or 'valid', got {padding!r}")
        cells = self.grid_size[0] * self.grid_size[1]
        if patchwise_apply and random_apply is False and len(args) != cells:
            raise ValueCheckError(
                f"PatchSequential: expected {cells} children, one of each cell, got {len(args)}; use random_apply, or "
                "patchwise_apply=False"
            )
        self.padding, self.patchwise_apply = padding, patchwise_apply

    # --- cells ---

    def compute_padding(self, input: Tensor, padding: str, grid_size: tuple[int, int] | None = None) -> Padding:
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
        if h % rows or w % columns or not h or not w:
            raise ShapeError(
                f"PatchSequential: expected images that a grid {rows, columns} divides, got {tuple(x.shape)}"
            )
        cells = x.reshape(b, c, rows, h // rows, columns, w // columns)
        return cells.permute(0, 2, 4, 1, 3, 5).flatten(1, 2)

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
        input: Tensor,
        params: Sequence[PatchParamItem] | None = None,
        extra_args: dict[Any, Any] | None = None,
        *,
        seed: Seed = None,
        generator: Generator | None = None,
    ) -> Tensor:
        """Augment the cells of images.

        Args:
            input: images (B, C, H, W), (C, H, W) or (H, W) of a floating-point type or uint8.
            params: the `_params` of an earlier call, to repeat it on these images.
            extra_args: accepted for code written for Kornia.
            seed: an int from which all parameters follow.
            generator: draws the keys of this call; default: that of the constructor, or torch's.

        Returns:
            Images of the size of `input`, cropped to a multiple of the grid with padding 'valid'.

        Raises:
            TypeError: `input` is no tensor of a floating-point type or uint8.
            ValueError: `input` has another number of axes; an augmentation changes the size of a cell.
        """
        x = self.transform_tensor(input)
        pad = self.compute_padding(x, self.padding)
        patches = self.extract_patches(x, pad=pad)
        source = self._source(seed, generator)
        items = None if params is None else list(params)
        self._of_cells = []
        self._position = 0
        if not self.patchwise_apply:
            chosen = None if items is None else [item.param for item in items]
            cells = self._run(patches.flatten(0, 1), self._children_of_call(chosen, source), None, source)
            patches = cells.unflatten(0, patches.shape[:2])
        else:
            cells_of_all = []
            for i in range(patches.shape[1]):
                children = self._children_of_cell(i, items, source)
                cells_of_all.append(self._run(patches[:, i], children, [i], source))
            patches = torch.stack(cells_of_all, 1)
        self._shape, self._stages = tuple(x.shape), []
        self._given_params = items
        return self._restored(self.restore_from_patches(patches, pad=pad), input)

    def _children_of_cell(self, cell: int, items: list[PatchParamItem] | None, source: Randomness) -> list[Child]:
        modules = dict(self.named_children())
        if items is not None:
            return [
                Child(item.param.name, modules[item.param.name], item.param.data)
                for item in items
                if item.indices is not None and cell in item.indices
            ]
        if self.random_apply is None:
            return [Child(*list(self.named_children())[cell])]
        seed = source.seed
        if isinstance(seed, int):
            seed = seed + (cell << 32)  # other children for other cells
        chosen = self.get_random_forward_sequence(seed=seed, generator=source.generator)
        return [Child(name, module) for name, module in chosen]

    def _run(self, x: Tensor, children: Sequence[Child], indices: list[int] | None, source: Randomness) -> Tensor:
        """Run children one after the other, and keep their parameters: a child may run for several cells."""
        for child in children:
            y, _ = execute(x, [child], source, self._position)
            if y.shape != x.shape:
                raise ShapeError(
                    f"PatchSequential: expected augmentations that keep the size of cells, got {tuple(y.shape)} from "
                    f"{tuple(x.shape)}"
                )
            x, self._position = y, self._position + 1
            module = child.module
            execution = module._execution if isinstance(module, AugmentationBase) else None
            self._of_cells.append((indices, replace(child, params=execution)))
        return x

    @property
    def _params(self) -> list[Any]:
        """The parameters of the last call, in the order of execution."""
        if self._given_params is None and self._shape is not None:
            self._given_params = [
                PatchParamItem(indices, ParamItem(child.name, _read(child))) for indices, child in self._of_cells
            ]
        return self._given_params or []

    @_params.setter
    def _params(self, params: list[Any]) -> None:
        self._given_params = params

    def _execute_nested(self, x: Tensor, params: Any, source: Randomness) -> Any:
        raise TypeCheckError("PatchSequential: expected to be called by itself, not as the child of another container")


def _read(child: Child) -> Any:
    module = child.module
    if isinstance(module, AugmentationBase) and child.params is not None:
        return module._read_params(child.params)
    return None
