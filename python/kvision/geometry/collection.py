"""Base class of boxes and keypoints: items of a batch of images in one tensor, with a count for each image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, TypeVar

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry._transform_points import transformed

Self = TypeVar("Self", bound="Collection")


class Collection:
    """Items of a fixed shape, (N, *item) of one image or (B, N, *item), whose last axis is (x, y) or (x, y, z).

    A list of (N_i, *item) is padded to the most items of an image. Methods that change the object bind new tensors; they
    never write to those it was made of.
    """

    item: ClassVar[tuple[int, ...]]

    def __init__(self, name: str, items: Tensor | Sequence[Tensor], raise_if_not_floating_point: bool) -> None:
        op = type(self).__name__
        self._counts: list[int] | None = None  # items of each image, for list input
        self._valid: Tensor | None = None  # mask (B, N) or (N,) of items that are not padding; None for all
        if not isinstance(items, (list, tuple)):
            data: Any = items
        elif items:
            for part in items:
                _check.shape(op, name, part, "N", *self.item)
            self._counts = [part.shape[0] for part in items]
            data = pad_sequence(list(items), batch_first=True)
            self._valid = pad_sequence(
                [torch.ones_like(part.flatten(1)[:, 0]).bool() for part in items], batch_first=True
            )
        else:
            data, self._counts = torch.zeros(0, 0, *self.item), []
        _check.trailing_shape(op, name, data, *self.item)
        if data.dim() - len(self.item) not in (1, 2):
            shape = ", ".join(map(str, self.item))
            raise ShapeError(f"{op}: expected {name} of shape (N, {shape}) or (B, N, {shape}), got {tuple(data.shape)}")
        if raise_if_not_floating_point:
            _check.floating(op, name, data)
        self._data = floats(data)

    def _like(self: Self, data: Tensor, valid: Tensor | None, counts: list[int] | None) -> Self:
        """A collection of the same class with other items. Subclasses with more attributes extend it."""
        other = type(self)(data, False)  # type: ignore[call-arg]  # subclasses name this argument
        other._valid, other._counts = valid, counts
        return other

    def _changed(self: Self, data: Tensor, inplace: bool, valid: Tensor | None = None) -> Self:
        """Replace the items by `data`, in this object or in a copy."""
        valid = self._valid if valid is None else valid
        if not inplace:
            return self._like(data, valid, self._counts)
        self._data, self._valid = data, valid
        return self

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._data})"

    def __getitem__(self: Self, key: Any) -> Self:
        counts = None
        if self._counts is not None:
            chosen = torch.arange(len(self._counts), device="cpu")[key.cpu() if isinstance(key, Tensor) else key]
            counts = [self._counts[i] for i in chosen.tolist()] if chosen.dim() else None
        return self._like(self._data[key], None if self._valid is None else self._valid[key], counts)

    def __setitem__(self: Self, key: Any, value: Self) -> None:
        data = self._data.clone()
        data[key] = value._data
        self._valid = self._put(value, lambda mask, other: mask.__setitem__(key, other))
        self._data = data

    def _put(self: Self, value: Self, write: Any) -> Tensor | None:
        """The mask of valid items after `write` stores those of `value`; None if all are valid."""
        if self._valid is None and value._valid is None:
            return None
        valid = self._mask().clone()
        write(valid, value._mask())
        return valid

    def _mask(self) -> Tensor:
        if self._valid is not None:
            return self._valid
        return torch.ones(self._data.shape[: self._data.dim() - len(self.item)], dtype=torch.bool, device=self.device)

    @property
    def _is_batched(self) -> bool:
        return self._data.dim() - len(self.item) == 2

    @property
    def data(self) -> Tensor:
        """The items, (N, ...) or (B, N, ...)."""
        return self._data

    @property
    def shape(self) -> torch.Size:
        """The shape of :attr:`data`."""
        return self._data.shape

    @property
    def device(self) -> torch.device:
        """Where the items are."""
        return self._data.device

    @property
    def dtype(self) -> torch.dtype:
        """The type of the items."""
        return self._data.dtype

    def to(self: Self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Self:
        """Move this object to a device, or its items to a floating-point type."""
        if dtype is not None and not dtype.is_floating_point:
            raise TypeCheckError(f"{type(self).__name__}.to: expected dtype to be floating point, got {dtype}")
        self._data = self._data.to(device=device, dtype=dtype)
        self._valid = None if self._valid is None else self._valid.to(device=self._data.device)
        return self

    def type(self: Self, dtype: torch.dtype) -> Self:
        """Give the items of this object another floating-point type."""
        return self.to(dtype=dtype)

    def clone(self: Self) -> Self:
        """A copy."""
        return self._like(self._data.clone(), self._valid, self._counts)

    def index_put(
        self: Self, indices: tuple[Tensor, ...] | list[Tensor], values: Tensor | Self, inplace: bool = False
    ) -> Self:
        """Replace items at some positions, as :func:`torch.Tensor.index_put`.

        Args:
            indices: of positions in :attr:`data`, as torch.Tensor.index_put takes them.
            values: what comes there.
            inplace: change this object.

        Returns:
            This object or a new one.
        """
        indices = tuple(indices)
        if isinstance(values, Tensor):
            return self._changed(self._data.index_put(indices, values), inplace)
        valid = self._put(values, lambda mask, other: mask.index_put_(indices, other))
        return self._changed(self._data.index_put(indices, values._data), inplace, valid)

    def pad(self: Self, padding_size: Tensor) -> Self:
        """Shift the items by the padding of their images.

        Args:
            padding_size: (B, 4) as (left, right, top, bottom), or (B, 6) with (front, back) in space; (1, ...) for all.

        Returns:
            This object.
        """
        return self._changed(self._data + self._offsets("pad", padding_size), True)

    def unpad(self: Self, padding_size: Tensor) -> Self:
        """Shift the items back when the padding of their images is removed: the inverse of :meth:`pad`."""
        return self._changed(self._data - self._offsets("unpad", padding_size), True)

    def _offsets(self, method: str, padding_size: Tensor) -> Tensor:
        op = f"{type(self).__name__}.{method}"
        _check.shape(op, "padding_size", padding_size, "B", 2 * self.item[-1])
        return self._of_images(op, "padding_size", padding_size[:, ::2])

    def _of_images(self, op: str, name: str, vectors: Tensor) -> Tensor:
        """Reshape vectors (B, D) or (1, D) of images so that they broadcast with the items."""
        images = self._data.shape[0] if self._is_batched else 1
        if not _check.is_one_or(vectors.shape[0], images):
            raise ShapeError(f"{op}: expected {name} with a batch size of 1 or {images}, got {tuple(vectors.shape)}")
        vectors = vectors.to(self._data)
        if not self._is_batched:
            return vectors[0]
        return vectors.reshape(-1, *(1,) * len(self.item), self.item[-1])

    def _transformed(self: Self, method: str, M: Tensor, inplace: bool) -> Self:
        op, n = f"{type(self).__name__}.{method}", self.item[-1] + 1
        _check.trailing_shape(op, "M", M, n, n)
        images = self._data.shape[0] if self._is_batched else 1
        if M.dim() > 3 or (M.dim() == 3 and not _check.is_one_or(M.shape[0], images)):
            raise ShapeError(f"{op}: expected M of shape ({n}, {n}) or ({images}, {n}, {n}), got {tuple(M.shape)}")
        _check.same_device(op, data=self._data, M=M)
        return self._changed(transformed(self._data, M), inplace)

    def _unpadded(self, padded: Tensor) -> Tensor | list[Tensor]:
        """Return list input as a list without its padding."""
        if self._counts is None:
            return padded
        return [items[:n] for items, n in zip(padded, self._counts)]
