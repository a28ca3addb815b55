"""Kernels that are disks with blurred edges, as of lenses out of focus."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision._ops import register, without_autocast_and_tf32

_WINDOW = 8  # pixels to each side; larger disks have larger windows, and are blurred by five taps, not three


def _reach(largest: int) -> int:
    return largest + 1 if largest < _WINDOW else largest


@without_autocast_and_tf32
def _reference(alias_blur: Tensor, radius: Tensor, largest: int) -> Tensor:
    """Disks (B, K, K) of radii (B,) int64, at most `largest`, whose edges are blurred by Gaussians of deviations (B,).

    The blur sees a window of 8 pixels to each side, or of the radius, which it reflects, as in Albumentations and ImageNet-C: the
    sum of larger disks is up to 1.01.
    """
    reach = _reach(largest)
    at = torch.arange(-reach, reach + 1, device=radius.device, dtype=alias_blur.dtype)
    radius, deviation = radius.to(alias_blur)[:, None, None], alias_blur[:, None, None]
    edge = radius.clamp(min=_WINDOW)
    disk = (at[:, None] ** 2 + at**2 <= radius**2).to(radius)

    def taps_to(other: Tensor) -> Tensor:
        distance = (at[:, None] - other).abs()
        most = torch.where(radius > _WINDOW, 2, 1)  # taps to each side
        of_all = torch.arange(-2, 3, device=at.device, dtype=at.dtype)
        total = ((-0.5 * (of_all / deviation) ** 2).exp() * (of_all.abs() <= most)).sum(2, keepdim=True)
        return (-0.5 * (distance / deviation) ** 2).exp() * (distance <= most) / total

    reflected = taps_to(2 * edge - at) * (at < edge) + taps_to(-2 * edge - at) * (at > -edge)
    taps = (taps_to(at) + reflected) * (at[:, None].abs() <= edge)
    return taps @ (disk / disk.sum((1, 2), keepdim=True)) @ taps.mT


disk_kernels = register(
    "disk_kernels",
    _reference,
    fake=lambda alias_blur, radius, largest: (alias_blur.shape[0], *[2 * _reach(largest) + 1] * 2),
)
