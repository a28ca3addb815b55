"""Modules that warp images by homographies to a fixed size."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._choices import Interpolation, Padding
from kvision.geometry.transform.warp import homography_warp

__all__ = ["BaseWarper", "HomographyWarper"]


class BaseWarper(nn.Module):
    """Base class of the modules that :class:`ImageRegistrator` warps images with.

    Subclasses define `forward(patch_src, src_homo_dst)`.

    Args:
        height: of the result, in pixels.
        width: of the result, in pixels.
        args: passed on to :class:`torch.nn.Module`.
        kwargs: passed on to :class:`torch.nn.Module`.

    Example:
        >>> import kvision as K
        >>> K.geometry.BaseWarper(4, 5).width
        5
    """

    def __init__(self, height: int, width: int, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.height = height
        self.width = width

    def forward(self, patch_src: Tensor, src_homo_dst: Tensor | None = None) -> Tensor:
        raise NotImplementedError(f"{type(self).__name__}: forward is for subclasses to define")


class HomographyWarper(BaseWarper):
    """Module form of :func:`homography_warp`, for results of one size.

    Args:
        height: of the result, in pixels.
        width: of the result, in pixels.
        mode: 'bilinear', 'nearest' or 'bicubic'.
        padding_mode: 'zeros', 'border' or 'reflection'.
        normalized_coordinates: coordinates are from -1 to 1; else they are pixels.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.

    Example:
        >>> import torch, kvision as K
        >>> image = torch.rand(1, 3, 4, 5)
        >>> K.geometry.HomographyWarper(4, 5)(image, torch.eye(3)[None]).shape
        torch.Size([1, 3, 4, 5])
    """

    def __init__(
        self,
        height: int,
        width: int,
        mode: Interpolation = "bilinear",
        padding_mode: Padding = "zeros",
        normalized_coordinates: bool = True,
        align_corners: bool = False,
    ) -> None:
        super().__init__(height, width)
        self.mode = mode
        self.padding_mode = padding_mode
        self.normalized_coordinates = normalized_coordinates
        self.align_corners = align_corners
        self._homography: Tensor | None = None
        if type(self).forward is HomographyWarper.forward:
            self(torch.empty(0, 1, 2, 2, device="cpu"), torch.empty(0, 3, 3, device="cpu"))  # which checks the settings

    def extra_repr(self) -> str:
        return (
            f"height={self.height}, width={self.width}, mode={self.mode!r}, padding_mode={self.padding_mode!r}, "
            f"normalized_coordinates={self.normalized_coordinates}, align_corners={self.align_corners}"
        )

    def precompute_warp_grid(self, src_homo_dst: Tensor) -> None:
        """Keep a homography (B, 3, 3) for calls without one. No grid is computed: reading it would take longer."""
        _check.shape("HomographyWarper", "src_homo_dst", src_homo_dst, "B", 3, 3)
        self._homography = src_homo_dst

    def forward(self, patch_src: Tensor, src_homo_dst: Tensor | None = None) -> Tensor:
        """Warp images (B, C, H, W) by homographies (B, 3, 3); None for those of precompute_warp_grid."""
        homography = self._homography if src_homo_dst is None else src_homo_dst
        if homography is None:
            raise RuntimeError("HomographyWarper: expected src_homo_dst, or a call of precompute_warp_grid before")
        return homography_warp(
            patch_src,
            homography,
            (self.height, self.width),
            self.mode,
            self.padding_mode,
            self.align_corners,
            self.normalized_coordinates,
        )
