"""Samples of a batch that may have different sizes: rows of the tensors that gave them, read together again."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import TypeVar

import torch
from torch import Tensor

from kvision._constants import on_device
from kvision._ops import FastPath
from kvision.core.pixels import to_unit

Key = TypeVar("Key", bound=Hashable)
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
        self._read_all(x)

    def _read_all(self, x: Tensor) -> None:
        self._tensors, self._firsts, self._end = [x], [0], len(x)
        self._owners = [0] * len(x)  # of each sample, the number of its tensor
        self._rows = list(range(len(x)))  # and of its row, as if the tensors were one

    def by_size(self, samples: Sequence[int]) -> list[list[int]]:
        """The samples in groups of one size."""
        if len({tensor.shape[1:] for tensor in self._tensors}) == 1:
            return [list(samples)] if samples else []
        return [[samples[i] for i in numbers] for numbers in numbers_by(map(self.size_of, samples)).values()]

    def size_of(self, sample: int) -> tuple[int, ...]:
        """Height and width of a sample; depth, height and width of volumes."""
        return tuple(self._tensors[self._owners[sample]].shape[2:])

    def take(self, samples: Sequence[int]) -> Tensor:
        """The samples, which have one size, as a batch."""
        owners, rows = [self._owners[sample] for sample in samples], [self._rows[sample] for sample in samples]
        read = sorted(set(owners))
        if len(read) < len(self._tensors):
            shifts, count = {}, 0
            for owner in read:
                shifts[owner] = count - self._firsts[owner]
                count += len(self._tensors[owner])
            rows = [row + shifts[owner] for row, owner in zip(rows, owners)]
        return _read_rows_of([self._tensors[owner] for owner in read], rows)

    def put(self, samples: Sequence[int], y: Tensor) -> None:
        """Let the samples, in ascending order, be the rows of `y`."""
        if len(samples) == len(self._owners):
            self._read_all(y)
            return
        owner, first = len(self._tensors), self._end
        before = {self._owners[sample] for sample in samples}
        for row, sample in enumerate(samples, first):
            self._owners[sample], self._rows[sample] = owner, row
        self._tensors.append(y)
        self._firsts.append(first)
        self._end += len(y)
        for unread in before.difference(self._owners):
            self._tensors[unread] = y.new_empty((0, *y.shape[1:]))  # the memory of that one is free then


def numbers_by(keys: Iterable[Key]) -> dict[Key, list[int]]:
    """The numbers of equal keys, in the order of the first ones."""
    groups: dict[Key, list[int]] = {}
    for number, key in enumerate(keys):
        groups.setdefault(key, []).append(number)
    return groups


def read_rows(x: Tensor, rows: Sequence[int]) -> Tensor:
    """Rows of `x` as a batch of the same layout: `x` itself or a view where they follow each other."""
    first, count = rows[0], len(rows)
    if rows[-1] - first == count - 1 and list(rows) == list(range(first, first + count)):
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
    return on_device(torch.tensor(rows, device="cpu"), like.device)


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
