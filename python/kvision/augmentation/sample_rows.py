"""Samples of a batch that may have different sizes: rows of the tensors that gave them, read together again."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from kvision._ops import FastPath
from kvision.core.pixels import to_unit

# Rows of batches (B, C, H, W) of one size and type as one batch, by their numbers as if these were one.
_copy_rows = FastPath(
    "copy_rows", (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.uint8, torch.int64, torch.bool)
)


class SampleRows:
    """The samples of a batch, each a row of a tensor: first of the batch itself, then of what turns gave.

    Args:
        x: images, masks or what else has a row of each sample.
    """

    def __init__(self, x: Tensor) -> None:
        self._whole: Tensor | None = x  # while all samples are the rows of one tensor
        self._count = len(x)
        self._at: list[tuple[Tensor, int]] = []

    def by_size(self, samples: Sequence[int]) -> list[list[int]]:
        """The samples in groups of one size."""
        if self._whole is not None:
            return [list(samples)] if samples else []
        groups: dict[torch.Size, list[int]] = {}
        of_tensors: dict[int, list[int]] = {}
        for sample in samples:
            tensor = self._at[sample][0]
            group = of_tensors.get(id(tensor))
            if group is None:
                group = of_tensors[id(tensor)] = groups.setdefault(tensor.shape[1:], [])
            group.append(sample)
        return list(groups.values())

    def size_of(self, sample: int) -> tuple[int, ...]:
        """Height and width of a sample; depth, height and width of volumes."""
        return tuple((self._at[sample][0] if self._whole is None else self._whole).shape[2:])

    def take(self, samples: Sequence[int]) -> Tensor:
        """The samples, which have one size, as a batch."""
        if self._whole is not None:
            return read_rows(self._whole, samples)
        tensors: list[Tensor] = []
        numbers: list[int] = []  # as if the tensors were one
        firsts: dict[int, int] = {}
        count = 0
        for sample in samples:
            tensor, row = self._at[sample]
            first = firsts.get(id(tensor))
            if first is None:
                first = firsts[id(tensor)] = count
                count += len(tensor)
                tensors.append(tensor)
            numbers.append(first + row)
        return _read_rows_of(tensors, numbers)

    def put(self, samples: Sequence[int], y: Tensor) -> None:
        """Let the samples, in ascending order, be the rows of `y`."""
        if len(samples) == self._count:
            self._whole, self._at = y, []
            return
        if self._whole is not None:
            whole, self._whole = self._whole, None
            self._at = [(whole, row) for row in range(self._count)]
        for row, sample in enumerate(samples):
            self._at[sample] = y, row


def read_rows(x: Tensor, rows: Sequence[int]) -> Tensor:
    """Rows of `x` as a batch of the same layout: `x` itself or a view where they follow each other."""
    first, count = rows[0], len(rows)
    if rows[-1] - first == count - 1 and all(row == first + i for i, row in enumerate(rows)):
        return x if count == len(x) else x[first : first + count]
    if x.dim() == 4 and _copy_rows.serves(x):
        copied: Tensor = _copy_rows.kernel([x], list(rows))
        return copied
    index = index_of(rows, x)
    if is_channels_last(x):
        return x.permute(0, 2, 3, 1).index_select(0, index).permute(0, 3, 1, 2)
    return x.index_select(0, index)


def is_channels_last(x: Tensor) -> bool:
    """Whether images have their channels last and no other layout."""
    return x.dim() == 4 and not x.is_contiguous() and x.is_contiguous(memory_format=torch.channels_last)


def index_of(rows: Sequence[int], like: Tensor) -> Tensor:
    """Numbers of rows on the device of a tensor."""
    return torch.tensor(rows, device="cpu").to(like.device, non_blocking=True)


def _read_rows_of(tensors: Sequence[Tensor], rows: Sequence[int]) -> Tensor:
    """Rows of tensors as one batch, by their numbers as if these were one."""
    if len(tensors) == 1:
        return read_rows(tensors[0], rows)
    if len({tensor.dtype for tensor in tensors}) > 1:
        tensors = [to_unit(tensor) if tensor.dtype == torch.uint8 else tensor for tensor in tensors]
    dtype = tensors[0].dtype
    if tensors[0].dim() == 4 and all(tensor.dtype == dtype and _copy_rows.serves(tensor) for tensor in tensors):
        copied: Tensor = _copy_rows.kernel(list(tensors), list(rows))
        return copied
    return read_rows(torch.cat(list(tensors)), rows)
