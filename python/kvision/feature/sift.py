"""SIFT descriptors of patches, of all pixels of images, and of frames in image pyramids."""

from __future__ import annotations

import functools
import math
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.compiler import is_compiling

from kvision import _check
from kvision._clamp import clamp
from kvision._constants import constant
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._limits import LARGEST_SIFT, MAX_SIFT_BINS, MAX_SIFT_CELLS, SIFT_EPSILON
from kvision._ops import behind_grad, register, vjp
from kvision.core.exceptions import ShapeError
from kvision.feature._patch_gradient import (
    angular_votes,
    centered_gaussian,
    check_patches,
    patch_gradients,
    to_polar,
    too_large,
)
from kvision.feature.affine_shape import replace_invalid
from kvision.feature.laf import laf_is_valid, rotate_laf
from kvision.feature.orientation import peak_of
from kvision.feature.patches import build_levels, check_frames, levels_of_frames, sample_levels
from kvision.filters import filter2d_separable, gaussian_blur2d

__all__ = ["DenseSIFTDescriptor", "SIFTDescriptor", "SIFTDescriptorFromPyramid", "convert_sift_descriptor_layout"]

Layout: TypeAlias = Literal["kornia", "opencv"]
LAYOUTS = get_args(Layout)
# --- the operator ---------------------------------------------------------------------------------------------------


def _grid(op: str, n: int, cells: int) -> tuple[int, int]:
    """The distance of the centers of `cells` cells of a patch of n pixels, and the width of their windows."""
    stride, width = n // cells, 2 * (n // (cells + 1))
    width += (width - n + (cells - 1) * stride) % 2  # the cells are symmetric around the center of the patch
    if stride == 0 or width == 0 or width - n + (cells - 1) * stride < 0:
        raise ShapeError(f"{op}: expected patch_size to fit {cells} spatial bins, got {n}", actual_shape=(n, n))
    return stride, width


def _tent(distance: Tensor, width: int) -> Tensor:
    return clamp(1 - distance.abs() * (2 / width), 0)


def _pooling(n: int, cells: int, like: Tensor) -> Tensor:
    """The weight of each pixel of a row for each cell, (cells, n)."""
    stride, width = _grid("sift", n, cells)
    centers = (torch.arange(cells, dtype=like.dtype, device=like.device) - (cells - 1) / 2) * stride + (n - 1) / 2
    pixels = torch.arange(n, dtype=like.dtype, device=like.device)
    return _tent(pixels - centers[:, None], width) * centered_gaussian(n, n / math.sqrt(2), like)


def _normalized(h: Tensor, clip: float, root: bool, dim: int = 1) -> Tensor:
    """Histograms as descriptors: L2, clipped, L2; RootSIFT. Empty ones stay empty and have no gradient."""
    empty = (h == 0).all(dim, keepdim=True)
    h = clamp(F.normalize(torch.where(empty, 1, h), dim=dim), high=clip)
    h = torch.where(empty, 0, F.normalize(h, dim=dim))
    return (h / h.sum(dim, keepdim=True).clamp(min=1e-12) + SIFT_EPSILON).sqrt() if root else h


def _reference(patches: Tensor, bins: int, cells: int, clip: float, root: bool) -> Tensor:
    votes = angular_votes(*to_polar(*patch_gradients(patches, sobel=False), SIFT_EPSILON), bins)
    pooling = _pooling(patches.shape[-1], cells, patches)
    return _normalized((pooling @ votes @ pooling.T).flatten(1), clip, root)


def _supports(patches: Tensor, bins: int, cells: int, *_: Any) -> str | None:
    """Patches have at most 88 pixels a side on CUDA, descriptors at most 1024 numbers."""
    if bins > MAX_SIFT_BINS or cells > MAX_SIFT_CELLS or bins * cells * cells > LARGEST_SIFT:
        return f"no kernel has {bins} angular and {cells} spatial bins"
    return too_large(patches)


_sift = register(
    "sift",
    _reference,
    fake=lambda patches, bins, cells, *_: (patches.shape[0], bins * cells * cells),
    gradients="patches: sift_backward",
    supports=_supports,
)
register(
    "sift_backward",
    vjp(_reference),
    fake=lambda grad, patches, *_: patches.shape,
    layout_of=1,
    supports=behind_grad(_supports),
)

# --- descriptors of patches -----------------------------------------------------------------------------------------


def check_bins(op: str, num_ang_bins: int, num_spatial_bins: int, clipval: float, rootsift: bool) -> None:
    _check.ints(op, "num_ang_bins", num_ang_bins, 1, minimum=2)
    _check.ints(op, "num_spatial_bins", num_spatial_bins, 1)
    _check.number(op, "clipval", clipval, minimum=0)
    _check.flag(op, "rootsift", rootsift)


class SIFTDescriptor(nn.Module):
    """SIFT descriptors of square gray patches.

    Central differences vote, bilinearly, for two of the angular bins and for the spatial bins around the pixel, with a
    Gaussian window of sigma patch_size / sqrt 2. The descriptor is normalized, clipped and normalized again; RootSIFT is
    the square root of its fractions of the sum. It does not change with brightness and contrast.

    Entry (a * S + y) * S + x counts gradients of angle 2 pi a / A, from x to y, in spatial bin (y, x): the layout of
    Kornia. `convert_sift_descriptor_layout` reorders it as OpenCV's. A flat patch gives zeros, with RootSIFT 1e-5. A
    gradient that is not finite counts as none.

    Args:
        patch_size: side of the patches in pixels.
        num_ang_bins: number A of angular bins, at least 2.
        num_spatial_bins: number S of spatial bins along each side.
        rootsift: compute RootSIFT.
        clipval: the largest entry after the first normalization.

    Returns:
        Of patches (B, 1, patch_size, patch_size), descriptors (B, A S^2) of length 1, of the same dtype.

    Raises:
        TypeError: an argument is of the wrong type; the patches are not tensors of real numbers.
        ValueError: patches of another shape; `patch_size` is too small for the spatial bins; a number is out of range.

    Source: D. Lowe, "Distinctive image features from scale-invariant keypoints" (2004); R. Arandjelovic and A. Zisserman,
    "Three things everyone should know to improve object retrieval" (2012).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.SIFTDescriptor(32)(torch.rand(5, 1, 32, 32)).shape
        torch.Size([5, 128])
    """

    def __init__(
        self,
        patch_size: int = 41,
        num_ang_bins: int = 8,
        num_spatial_bins: int = 4,
        rootsift: bool = True,
        clipval: float = 0.2,
    ) -> None:
        super().__init__()
        op = "SIFTDescriptor"
        _check.ints(op, "patch_size", patch_size, 1)
        check_bins(op, num_ang_bins, num_spatial_bins, clipval, rootsift)
        _grid(op, patch_size, num_spatial_bins)
        self.patch_size = patch_size
        self.num_ang_bins = num_ang_bins
        self.num_spatial_bins = num_spatial_bins
        self.rootsift = rootsift
        self.clipval = clipval

    def extra_repr(self) -> str:
        return (
            f"patch_size={self.patch_size}, num_ang_bins={self.num_ang_bins}, num_spatial_bins={self.num_spatial_bins}, "
            f"rootsift={self.rootsift}, clipval={self.clipval}"
        )

    def get_pooling_kernel(self) -> Tensor:
        """The weights (1, 1, k, k) of the pixels of a spatial bin."""
        _, width = _grid("SIFTDescriptor", self.patch_size, self.num_spatial_bins)
        return tent_kernel(width)[None, None]

    def get_weighting_kernel(self) -> Tensor:
        """The Gaussian window (1, patch_size, patch_size), of sum 1."""
        g = centered_gaussian(self.patch_size, self.patch_size / math.sqrt(2), torch.empty(0, dtype=torch.float32))
        return torch.outer(g, g)[None] / g.sum() ** 2

    def forward(self, input: Tensor) -> Tensor:
        x = check_patches("SIFTDescriptor", "input", input, self.patch_size)
        return _sift(x, self.num_ang_bins, self.num_spatial_bins, float(self.clipval), self.rootsift)


def tent_kernel(width: int) -> Tensor:
    """The weights (width, width) of the pixels of a window, which fall to 0 outside of it."""
    x = _tent(torch.arange(width, dtype=torch.float32) - (width - 1) / 2, width)
    return torch.outer(x, x)


# --- descriptors of images ------------------------------------------------------------------------------------------


def _votes_of_image(image: Tensor, bins: int) -> Tensor:
    """The gradients of images (B, 1, H, W) by their angle, (B, bins, H, W)."""
    return angular_votes(*to_polar(*patch_gradients(image, sobel=False), SIFT_EPSILON), bins)


def _pooled(votes: Tensor, width: int) -> Tensor:
    """Sums over windows of `width` pixels with weights that fall to 0, at pixels, or between them where it is even."""
    x = torch.arange(width, dtype=votes.dtype, device=votes.device) - (width - 1) / 2
    tent = _tent(x, width)[None]
    margin = width // 2
    padded = F.pad(votes, (margin, margin, margin, margin))
    return filter2d_separable(padded, tent, tent, "constant", False, "valid")


class DenseSIFTDescriptor(nn.Module):
    """SIFT descriptors of the neighborhoods of all pixels of gray images.

    The S x S spatial bins of a descriptor are `spatial_bin_size` pixels apart and as wide, with weights that fall to 0;
    there is no Gaussian window. Channels are the entries of :class:`SIFTDescriptor`. Result (i, j) is centered on
    x = j stride - padding + (S - 1) spatial_bin_size / 2 - e / 2, and y likewise, where e is 1 for an even
    `spatial_bin_size`, else 0.

    Args:
        num_ang_bins: number A of angular bins, at least 2.
        num_spatial_bins: number S of spatial bins along each side.
        spatial_bin_size: distance and width of the spatial bins in pixels.
        rootsift: compute RootSIFT.
        clipval: the largest entry after the first normalization.
        stride: distance of the results in pixels.
        padding: pixels without gradients around the image.

    Returns:
        Of images (B, 1, H, W), descriptors (B, A S^2, h, w) with
        h = floor((H + e + 2 padding - (S - 1) spatial_bin_size - 1) / stride) + 1, of the same dtype.

    Raises:
        TypeError: an argument is of the wrong type; the images are not tensors of real numbers.
        ValueError: images of another shape, or too small for a descriptor; a number is out of range.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.DenseSIFTDescriptor()(torch.rand(2, 1, 20, 30)).shape
        torch.Size([2, 128, 11, 21])
    """

    def __init__(
        self,
        num_ang_bins: int = 8,
        num_spatial_bins: int = 4,
        spatial_bin_size: int = 4,
        rootsift: bool = True,
        clipval: float = 0.2,
        stride: int = 1,
        padding: int = 1,
    ) -> None:
        super().__init__()
        op = "DenseSIFTDescriptor"
        check_bins(op, num_ang_bins, num_spatial_bins, clipval, rootsift)
        _check.ints(op, "spatial_bin_size", spatial_bin_size, 1)
        _check.ints(op, "stride", stride, 1)
        _check.ints(op, "padding", padding, 1, minimum=0)
        self.num_ang_bins = num_ang_bins
        self.num_spatial_bins = num_spatial_bins
        self.spatial_bin_size = spatial_bin_size
        self.rootsift = rootsift
        self.clipval = clipval
        self.stride = stride
        self.padding = padding

    def extra_repr(self) -> str:
        return (
            f"num_ang_bins={self.num_ang_bins}, num_spatial_bins={self.num_spatial_bins}, "
            f"spatial_bin_size={self.spatial_bin_size}, rootsift={self.rootsift}, clipval={self.clipval}, "
            f"stride={self.stride}, padding={self.padding}"
        )

    def get_pooling_kernel(self) -> Tensor:
        """The weights (1, 1, k, k) of the pixels of a spatial bin."""
        return tent_kernel(self.spatial_bin_size)[None, None]

    def get_gradient_histograms(self, input: Tensor) -> Tensor:
        """The gradients of images (B, 1, H, W) by their angle, (B, A, H, W), before they are pooled."""
        _check.images("DenseSIFTDescriptor", "input", input)
        _check.channels("DenseSIFTDescriptor", "input", input, 1)
        image = floats(input)
        return as_dtype(_votes_of_image(as_dtype(image, compute_dtype(image)), self.num_ang_bins), image.dtype)

    def forward(self, input: Tensor) -> Tensor:
        op = "DenseSIFTDescriptor"
        _check.images(op, "input", input)
        _check.channels(op, "input", input, 1)
        image = floats(input)
        bins, cells, step = self.num_ang_bins, self.num_spatial_bins, self.spatial_bin_size
        extent = (cells - 1) * step + 1
        sides = [side + (step + 1) % 2 + 2 * self.padding for side in image.shape[2:]]
        if min(sides) < extent:
            raise ShapeError(
                f"{op}: expected input of at least {extent - (step + 1) % 2 - 2 * self.padding} pixels a side, got "
                f"{tuple(image.shape)}",
                actual_shape=image.shape,
            )
        pooled = _pooled(_votes_of_image(as_dtype(image, compute_dtype(image)), bins), step)
        columns = F.unfold(pooled, cells, dilation=step, padding=self.padding, stride=self.stride)
        size = [(side - extent) // self.stride + 1 for side in sides]
        descriptors = _normalized(columns, float(self.clipval), self.rootsift)
        return as_dtype(descriptors.unflatten(2, size), image.dtype)


class SIFTDescriptorFromPyramid(nn.Module):
    """SIFT descriptors of local affine frames from histograms of all pixels of an image pyramid, without patches.

    The gradients of each level are counted by their angle and pooled over windows of `spatial_bin_size` pixels. A frame
    reads these histograms at the centers of its S x S spatial bins, from the level where a window of 19 pixels covers it
    about once, and turns their angles into its own coordinates. For a frame that is no circle this is an approximation.

    Args:
        num_ang_bins: number A of angular bins, at least 2.
        num_spatial_bins: number S of spatial bins along each side.
        spatial_bin_size: side of the windows in pixels of a level.
        rootsift: compute RootSIFT.
        clipval: the largest entry after the first normalization.
        orientation_bins: bins of the histogram of `orient_and_describe`, at least 3.

    Returns:
        Of images (B, 1, H, W) and frames (B, N, 2, 3) in their pixels, descriptors (B, N, A S^2) with the entries of
        :class:`SIFTDescriptor`, of the dtype of the images. Frames that are not finite or have no area give zeros.

    Raises:
        TypeError: an argument is of the wrong type.
        ValueError: tensors of another shape; a number is out of range.

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[12.0, 0, 32], [0, 12, 32]]]])
        >>> K.feature.SIFTDescriptorFromPyramid()(torch.rand(1, 1, 64, 64), laf).shape
        torch.Size([1, 1, 128])
    """

    def __init__(
        self,
        num_ang_bins: int = 8,
        num_spatial_bins: int = 4,
        spatial_bin_size: int = 8,
        rootsift: bool = True,
        clipval: float = 0.2,
        orientation_bins: int = 36,
    ) -> None:
        super().__init__()
        op = "SIFTDescriptorFromPyramid"
        check_bins(op, num_ang_bins, num_spatial_bins, clipval, rootsift)
        _check.ints(op, "spatial_bin_size", spatial_bin_size, 1)
        _check.ints(op, "orientation_bins", orientation_bins, 1, minimum=3)
        self.num_ang_bins = num_ang_bins
        self.num_spatial_bins = num_spatial_bins
        self.spatial_bin_size = spatial_bin_size
        self.rootsift = rootsift
        self.clipval = clipval
        self.orientation_bins = orientation_bins

    def extra_repr(self) -> str:
        return (
            f"num_ang_bins={self.num_ang_bins}, num_spatial_bins={self.num_spatial_bins}, "
            f"spatial_bin_size={self.spatial_bin_size}, rootsift={self.rootsift}, clipval={self.clipval}, "
            f"orientation_bins={self.orientation_bins}"
        )

    def forward(self, image: Tensor, lafs: Tensor) -> Tensor:
        return self.orient_and_describe(image, lafs, upright=True)[1]

    def orient_and_describe(self, image: Tensor, lafs: Tensor, upright: bool = False) -> tuple[Tensor, Tensor]:
        """Rotate frames onto their dominant gradients, unless `upright`, and describe them.

        Args:
            image: images (B, 1, H, W).
            lafs: frames (B, N, 2, 3).
            upright: keep the orientations of the frames.

        Returns:
            Frames (B, N, 2, 3) and descriptors (B, N, A S^2).
        """
        op = "SIFTDescriptorFromPyramid"
        check_frames(op, image, lafs, "image", "lafs")
        _check.channels(op, "image", image, 1)
        _check.flag(op, "upright", upright)
        image = floats(image)
        dtype = compute_dtype(image)
        levels = build_levels(as_dtype(image, dtype), _WINDOW)
        frames = as_dtype(lafs, dtype)
        valid = laf_is_valid(frames)
        frames = replace_invalid(frames, valid)
        sizes = constant(tuple(tuple(level.shape[:1:-1]) for level in levels), image, dtype)
        scale = (sizes / sizes[:1])[levels_of_frames(frames, len(levels), _WINDOW)][..., None]  # (B, N, 2, 1): x, y
        if not upright:
            frames = rotate_laf(frames, -torch.rad2deg(self._orientations(levels, frames, scale)))
        descriptors = self._descriptors(levels, frames, scale)
        descriptors = torch.where(valid[..., None], descriptors, 0)
        oriented = torch.where(valid[..., None, None], as_dtype(frames, lafs.dtype), lafs)
        return lafs if upright else oriented, as_dtype(descriptors, image.dtype)

    def _orientations(self, levels: list[Tensor], frames: Tensor, scale: Tensor) -> Tensor:
        """The angles (B, N) of dominant gradients, from x to y in the coordinates of the frames."""
        smooth = [gaussian_blur2d(level, (7, 7), (1.0, 1.0), "replicate") for level in levels]
        maps = [torch.stack(patch_gradients(level, sobel=False), 1) for level in smooth]
        gradients = sample_levels(maps, frames, _WINDOW, _WINDOW).flatten(3)  # (B, N, 2, samples)
        local = (frames[..., :2] * scale).mT @ gradients
        window = centered_gaussian(_WINDOW, _WINDOW / 6, frames)
        magnitude, angle = to_polar(local[:, :, 0].flatten(0, 1), local[:, :, 1].flatten(0, 1), SIFT_EPSILON)
        weighted = magnitude * torch.outer(window, window).flatten()
        bins = self.orientation_bins
        peaks = peak_of(angular_votes(weighted, angle, bins).sum(2))
        return (2 * math.pi / bins * peaks).reshape(frames.shape[:2])

    def _descriptors(self, levels: list[Tensor], frames: Tensor, scale: Tensor) -> Tensor:
        batch, count = frames.shape[:2]
        bins, cells = max(_IMAGE_BINS, self.num_ang_bins), self.num_spatial_bins
        maps = [self._pooled_at_pixels(_votes_of_image(level, bins)) for level in levels]
        votes = sample_levels(maps, frames, cells, _WINDOW).flatten(3)  # (B, N, bins, S^2)
        # A bin stands for the gradients of its angle, which have others in the coordinates of a frame.
        angles = torch.arange(bins, dtype=frames.dtype, device=frames.device) * (2 * math.pi / bins)
        local = (frames[..., :2] * scale).mT @ torch.stack([angles.cos(), angles.sin()])
        magnitude, angle = to_polar(local[:, :, 0].flatten(0, 1), local[:, :, 1].flatten(0, 1), 0.0)
        bin_votes = angular_votes(magnitude, angle, self.num_ang_bins)
        h = (bin_votes @ votes.flatten(0, 1)).flatten(1)
        return _normalized(h, float(self.clipval), self.rootsift).reshape(batch, count, h.shape[1])

    def _pooled_at_pixels(self, votes: Tensor) -> Tensor:
        pooled = _pooled(votes, self.spatial_bin_size)
        if self.spatial_bin_size % 2 == 1:
            return pooled
        rows = pooled[:, :, :-1] + pooled[:, :, 1:]  # sums between pixels: their means are at pixels
        return (rows[..., :-1] + rows[..., 1:]) / 4


_WINDOW = 19  # pixels of a level that a frame covers
_IMAGE_BINS = 36  # at least, of the histograms of pixels

# --- layouts --------------------------------------------------------------------------------------------------------


def convert_sift_descriptor_layout(
    descriptors: Tensor, source: Layout, target: Layout, num_ang_bins: int = 8, num_spatial_bins: int = 4
) -> Tensor:
    """Reorder SIFT descriptors between the layouts of Kornia and OpenCV.

    The histogram has A angular bins for each of S x S spatial bins (y, x). Entry (a * S + y) * S + x of Kornia's layout
    is the number of gradients of angle 2 pi a / A from x to y, clockwise as seen in the image. OpenCV counts angles the
    other way round and has those of a spatial bin side by side: entry (y * S + x) * A + (-a mod A).

    Args:
        descriptors: (*, A S^2).
        source: layout of `descriptors`, 'kornia' or 'opencv'.
        target: layout of the result.
        num_ang_bins: A.
        num_spatial_bins: S.

    Returns:
        The same numbers in the other order, of the same shape and dtype.

    Raises:
        TypeError: `descriptors` is not a tensor; the numbers of bins are not ints.
        ValueError: an unknown layout; `descriptors` do not have A S^2 entries; a number of bins is not positive.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.convert_sift_descriptor_layout(torch.arange(8), "kornia", "opencv", 4, 1)
        Traceback (most recent call last):
            ...
        kvision.core.exceptions.ShapeError: convert_sift_descriptor_layout: expected descriptors of 4 numbers, got 8
        >>> K.feature.convert_sift_descriptor_layout(torch.arange(4), "kornia", "opencv", 4, 1)
        tensor([0, 3, 2, 1])
    """
    op = "convert_sift_descriptor_layout"
    _check.numbers(op, "descriptors", descriptors)
    _check.choice(op, "source", source, LAYOUTS)
    _check.choice(op, "target", target, LAYOUTS)
    _check.ints(op, "num_ang_bins", num_ang_bins, 1)
    _check.ints(op, "num_spatial_bins", num_spatial_bins, 1)
    bins, cells = num_ang_bins, num_spatial_bins
    entries = descriptors.shape[-1] if descriptors.dim() else 0
    if entries != bins * cells * cells:
        raise ShapeError(f"{op}: expected descriptors of {bins * cells * cells} numbers, got {entries}")
    if source == target:
        return descriptors.clone()
    if descriptors.is_cpu and not is_compiling():
        return descriptors.index_select(-1, torch.from_numpy(_order(source, bins, cells)))
    return _reordered(descriptors, source, bins, cells)


def _reordered(descriptors: Tensor, source: str, bins: int, cells: int) -> Tensor:
    sizes, angles = ((cells * cells, bins), -2) if source == "opencv" else ((bins, cells * cells), -1)
    swapped = descriptors.unflatten(-1, sizes).transpose(-1, -2)
    return swapped.flip(angles).roll(1, angles).flatten(-2)


@functools.lru_cache
def _order(source: str, bins: int, cells: int) -> np.ndarray:
    """Which number of a descriptor comes where in the other layout."""
    return _reordered(torch.arange(bins * cells * cells, device="cpu"), source, bins, cells).numpy()
