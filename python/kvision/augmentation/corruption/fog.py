"""Images behind fog: a layer whose factors follow from the largest value of each image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from kvision._clamp import clamp
from kvision._dtype import compute_dtype
from kvision._list_ops import ListOperator
from kvision.augmentation.corruption.layer import add_layer, arguments_of_sample
from kvision.geometry.transform.lists import arguments as lists
from kvision.geometry.transform.lists.arguments import row
from kvision.geometry.transform.lists.kept_sizes import (
    by_samples,
    register_list_backward,
    wants_gradients_of_list,
    where_chosen,
)


def fog_factors(most: Tensor, numbers: Tensor, are_bytes: bool) -> Tensor:
    """The factors (B, 1, 4) of the clouds that leave the largest values (B,) as they are.

    Numbers (B or 1, 3) are the amount of fog, and the least and the most of the clouds, which are stretched to [0, 1].
    """
    amount, low, high = numbers.unbind(1)
    most = clamp(most, 0, 255 if are_bytes else 1).to(amount.dtype)
    if are_bytes:
        most = most / 255
    darker = most / (most + amount).clamp(min=1e-12)
    clouds = darker * amount / (high - low).clamp(min=1e-12)
    return torch.stack([darker, torch.zeros_like(darker), clouds, -low * clouds], -1)[:, None]


def _behind_fog(b: int, x: Tensor, layer: Tensor, numbers: Tensor) -> Tensor:
    """Sample b of a list, as a batch."""
    most = x.to(compute_dtype(x)).amax((1, 2, 3)).clamp(min=0)
    factors = fog_factors(most, row(numbers, b), x.dtype == torch.uint8)
    y: Tensor = add_layer.reference(x, *arguments_of_sample(b, layer, None, factors))
    return y


def _reference(images: Sequence[Tensor], chosen: Tensor | None, layer: Tensor, numbers: Tensor) -> list[Tensor]:
    each = [_behind_fog(b, x[None], layer, numbers)[0] for b, x in enumerate(images)]
    return each if chosen is None else where_chosen(chosen, each, images)


def _of_sample(b: int, grad: Tensor, x: Tensor, layer: Tensor, numbers: Tensor) -> Tensor:
    _, vjp = torch.func.vjp(lambda x: _behind_fog(b, x, layer, numbers), x)  # type: ignore[misc]
    of_image: Tensor = vjp(grad)[0]
    return of_image


_fog_list_backward = register_list_backward("fog_list_backward", add_layer, by_samples(_of_sample))


def _gradients(
    needs: Sequence[bool],
    grads: Sequence[Tensor | None],
    images: Sequence[Tensor],
    chosen: Tensor | None,
    layer: Tensor,
    numbers: Tensor,
) -> list[Any]:
    own = [torch.zeros_like(x) if g is None else g for g, x in zip(grads, images)]
    if not any(needs[1:]):
        return [_fog_list_backward([*images, *own], chosen, layer, numbers), None, None, None]

    def call(layer: Tensor, numbers: Tensor, *images: Tensor) -> tuple[Tensor, ...]:
        return tuple(_reference(images, chosen, layer, numbers))

    of_layer, of_numbers, *of_images = torch.func.vjp(call, layer, numbers, *images)[1](tuple(own))
    return [of_images, None, of_layer, of_numbers]


_fog_list = ListOperator(
    "fog_list",
    add_layer,  # which has kernels where this has them
    _reference,
    fake=lambda images, *args: lists.fake_results(images, [n for x in images for n in x.shape[-2:]]),
    backward=_gradients,
)


class Fog(NamedTuple):
    """What puts images behind layers (B or 1, 1, H, W) of fog by numbers, as an `Operation` does."""

    layer: Tensor
    numbers: Tensor

    def __call__(self, images: Tensor) -> Tensor:
        if not images.shape[1]:  # which have no largest value
            return images.clone()
        if wants_gradients_of_list(images, self.layer, self.numbers):
            return torch.stack(self.on_list(list(images.unbind())))  # whose gradient has a kernel
        factors = fog_factors(images.amax((1, 2, 3)), self.numbers, images.dtype == torch.uint8)
        y: Tensor = add_layer(images, self.layer, None, factors)
        return y

    def on_list(self, images: Sequence[Tensor], chosen: Tensor | None = None) -> list[Tensor]:
        """The results of images (C, H, W) of different sizes; those that are not `chosen`, (B,), stay as they are."""
        return list(_fog_list(images, chosen, self.layer, self.numbers))
