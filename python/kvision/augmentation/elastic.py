"""Random deformations by maps: elastic, thin-plate and fisheye. Masks and key points follow the same map."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision._dtype import compute_dtype
from kvision.augmentation.base import AugmentationBase2D, Execution, Params, where_chosen
from kvision.augmentation.random_generator.elastic import ElasticGenerator, FisheyeGenerator, ThinPlateSplineGenerator
from kvision.constants import Resample, SamplePadding
from kvision.filters import gaussian_blur2d
from kvision.geometry import get_tps_transform, remap, warp_points_tps

__all__ = ["RandomElasticTransform", "RandomFisheye", "RandomThinPlateSpline"]

_STEPS, _GUESSES = 20, 32  # of Newton's method, which begins at the best of 32 x 32 pixels


class _MapAugmentation(AugmentationBase2D):
    """A deformation by a map: where each pixel of the result reads the image."""

    accepts_bytes = True
    keeps_lines = False

    def coordinates(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map (B, 2, H, W): x and y in pixels."""
        raise NotImplementedError

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        coordinates = self.coordinates(
            tuple(input.shape), params, flags, input.new_empty(0, dtype=compute_dtype(input))
        )
        return _read(input, coordinates, _mode(flags), _padding(flags), flags.get("align_corners", True))

    def _map(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        """The map of an execution, for images, masks or points that follow it."""
        params = self._params_on_device(x, execution)
        like = x.new_empty(0, dtype=compute_dtype(x) if x.is_floating_point() else torch.float32)
        return self.coordinates((x.shape[0], 1, *execution.shape[-2:]), params, flags, like)

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or masks.shape[0] == 0:
            return masks
        coordinates, corners = self._map(masks, execution, flags), flags.get("align_corners", True)
        moved = _read_labels(masks, coordinates, _mode(flags), _padding(flags), corners, flags.get("mask_fill", 0))
        return where_chosen(execution.chosen, moved, masks)

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        return where_chosen(execution.chosen, invert_map(self._map(points, execution, self.flags), points), points)

    # --- inverse ---

    def inverse(self, output: Tensor, params: Params | None = None, **kwargs: Any) -> Tensor:
        flags = self._flags_of(kwargs)
        x, execution = self._call_to_invert(output, params, flags)
        if not execution.applied or 0 in x.shape:
            return output
        back, is_found = invert_map_everywhere(self._map(x, execution, flags))
        y = torch.where(is_found, _read(x, back, _mode(flags), "zeros", True), 0).to(x.dtype)
        return self._restored(where_chosen(execution.chosen, y, x), output)

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or 0 in masks.shape:
            return masks
        back, is_found = invert_map_everywhere(self._map(masks, execution, flags))
        moved = torch.where(is_found, _read_labels(masks, back, "nearest", "zeros", True), 0).to(masks.dtype)
        return where_chosen(execution.chosen, moved, masks)

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        return where_chosen(execution.chosen, _at(self._map(points, execution, self.flags), points), points)


def _mode(flags: dict[str, Any]) -> str:
    return Resample.get(flags.get("resample", Resample.BILINEAR)).name.lower()


def _read(x: Tensor, coordinates: Tensor, mode: str, padding: str, align_corners: bool) -> Tensor:
    map_x, map_y = coordinates.to(compute_dtype(x)).unbind(1)
    return remap(x, map_x, map_y, mode, padding, align_corners)


def _read_labels(
    masks: Tensor, coordinates: Tensor, mode: str, padding: str, align_corners: bool, fill: float = 0
) -> Tensor:
    """Masks of any type."""
    exact = masks if masks.is_floating_point() else masks.double()  # holds all integers up to 2^53
    if padding == "zeros" and fill:
        return (_read(exact - fill, coordinates, mode, padding, align_corners) + fill).to(masks.dtype)
    return _read(exact, coordinates, mode, padding, align_corners).to(masks.dtype)


def invert_map(coordinates: Tensor, points: Tensor) -> Tensor:
    """Where the pixels of a result are that read an image at `points` (B, N, 2), by Newton's method.

    `coordinates` (B, 2, H, W) is the map. Where it folds, one of several solutions is found; for points that no pixel
    reads, the nearest that the method comes to.
    """
    h, w = coordinates.shape[-2:]
    rows, columns = (torch.linspace(0, n - 1, min(n, _GUESSES), device=points.device).round().long() for n in (h, w))
    known = coordinates[:, :, rows][..., columns].flatten(2).mT  # (B, G, 2)
    best = torch.cdist(points, known.to(points)).argmin(-1)
    at = torch.stack([columns[best % len(columns)], rows[best // len(columns)]], -1).to(points)
    return _newton(coordinates, points, at)


def invert_map_everywhere(coordinates: Tensor) -> tuple[Tensor, Tensor]:
    """The map (B, 2, H, W) from the pixels of an image to those of the result, and bool (B, 1, H, W), which are there.

    `coordinates` (B, 2, H, W) is the map from the result to the image. The pixels of a coarse grid are searched for, and
    the method begins between these for all.
    """
    h, w = coordinates.shape[-2:]
    rows, columns = (torch.linspace(0, n - 1, min(n, _GUESSES), device=coordinates.device) for n in (h, w))
    coarse = torch.stack([columns.expand(len(rows), -1), rows[:, None].expand(-1, len(columns))], -1).flatten(0, 1)
    inverted = invert_map(coordinates, coarse.to(coordinates).expand(len(coordinates), -1, 2))
    between = inverted.mT.unflatten(2, (len(rows), len(columns)))
    start = F.interpolate(between, (h, w), mode="bilinear", align_corners=True).flatten(2).mT
    pixels = _pixels(_grid(h, w, coordinates), h, w, True)
    points = pixels.flatten(1).mT.expand_as(start)
    at = _newton(coordinates, points, start)
    is_found = (_at(coordinates, at) - points).abs().amax(-1) < 0.5
    return at.mT.unflatten(2, (h, w)), is_found.unflatten(1, (1, h, w))


def _newton(coordinates: Tensor, points: Tensor, at: Tensor) -> Tensor:
    """Where the map reads points (B, N, 2), by steps that begin at positions `at` near them."""
    h, w = coordinates.shape[-2:]
    for _ in range(_STEPS):
        here = _at(coordinates, at)
        step_x, step_y = at.new_tensor([0.5, 0.0]), at.new_tensor([0.0, 0.5])
        along = _at(coordinates, at + step_x) - _at(coordinates, at - step_x)
        down = _at(coordinates, at + step_y) - _at(coordinates, at - step_y)
        miss = points - here
        determinant = along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0]
        determinant = torch.where(determinant.abs() < 1e-3, 1e-3, determinant)
        move = (
            torch.stack(
                [
                    miss[..., 0] * down[..., 1] - miss[..., 1] * down[..., 0],
                    miss[..., 1] * along[..., 0] - miss[..., 0] * along[..., 1],
                ],
                -1,
            )
            / determinant[..., None]
        )
        at = at + move.clamp(-max(h, w) / 8, max(h, w) / 8)
        limit = at.new_tensor([w - 1.0, h - 1.0])
        at = torch.minimum(at.clamp(min=0), limit)
    return at


def _at(coordinates: Tensor, points: Tensor) -> Tensor:
    """The map (B, 2, H, W) between its pixels, at points (B, N, 2)."""
    x, y = points.unbind(-1)
    return remap(coordinates.to(points), x[:, None], y[:, None], "bilinear", "border", True)[:, :, 0].mT


def _padding(flags: dict[str, Any]) -> str:
    return SamplePadding.get(flags.get("padding_mode", SamplePadding.ZEROS)).name.lower()


def _pixels(normalized: Tensor, height: int, width: int, align_corners: bool) -> Tensor:
    """Coordinates (B, 2, H, W) from -1 to 1 as pixels."""
    sizes = normalized.new_tensor([float(width), float(height)])[:, None, None]
    half = (sizes - 1) / 2
    return normalized * (half if align_corners else sizes / 2) + half


def _grid(height: int, width: int, like: Tensor) -> Tensor:
    """(2, H, W): the coordinates x and y of the pixels, from -1 to 1 at the centers of the outermost ones."""
    y, x = (torch.linspace(-1, 1, n, dtype=like.dtype, device=like.device) for n in (height, width))
    return torch.stack([x.expand(height, width), y[:, None].expand(height, width)])


class RandomElasticTransform(_MapAugmentation):
    """Deform images by smooth random displacements: noise after a Gaussian blur.

    Args:
        kernel_size: height and width of the blur's window, odd.
        sigma: standard deviations of the blur along y and x.
        alpha: strength of the displacements along x and y, in units of half the image's width and height.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        resample: 'nearest', 'bilinear' or 'bicubic'.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: in a call, as `filters.gaussian_blur2d`.

    Example:
        >>> import torch, kvision as K
        >>> elastic = K.augmentation.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0)
        >>> elastic(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] = (63, 63),
        sigma: tuple[float, float] = (32.0, 32.0),
        alpha: tuple[float, float] = (1.0, 1.0),
        align_corners: bool = False,
        resample: str | int | Resample = Resample.BILINEAR.name,
        padding_mode: str = "zeros",
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ElasticGenerator()
        self.flags = {
            "kernel_size": kernel_size,
            "sigma": sigma,
            "alpha": alpha,
            "align_corners": align_corners,
            "resample": Resample.get(resample),
            "padding_mode": padding_mode,
        }

    def coordinates(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        noise = params["noise"].to(like) * like.new_tensor(flags["alpha"])[:, None, None]
        smooth = gaussian_blur2d(noise, flags["kernel_size"], flags["sigma"], "constant")
        sizes = like.new_tensor([shape[-1], shape[-2]])[:, None, None]
        half = (sizes - 1) / 2 if flags["align_corners"] else sizes / 2
        return smooth * half + _pixels(_grid(shape[-2], shape[-1], like), shape[-2], shape[-1], True)


class RandomThinPlateSpline(_MapAugmentation):
    """Deform images by thin-plate splines through the corners and the center, which move at random.

    Args:
        scale: how far the points move at most, in units of half the image's width and height.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `scale` is no number of at least 0.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(1, 1, 6, 6)
        >>> torch.allclose(K.augmentation.RandomThinPlateSpline(0.0, p=1.0)(x), x, atol=1e-4)
        True
    """

    def __init__(
        self,
        scale: float = 0.2,
        align_corners: bool = False,
        padding_mode: str | int | SamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ThinPlateSplineGenerator(scale)
        self.flags = {"align_corners": align_corners, "padding_mode": SamplePadding.get(padding_mode)}

    def coordinates(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        source, destination = params["src"].to(like), params["dst"].to(like)
        weights, affine = get_tps_transform(destination, source)
        height, width = shape[-2:]
        align_corners = flags["align_corners"]
        grid = _grid(height, width, like)
        if not align_corners:  # the centers of the outermost pixels are half a pixel inside
            grid = grid * ((like.new_tensor([width, height]) - 1) / like.new_tensor([width, height]))[:, None, None]
        points = grid.flatten(1).mT.expand(shape[0], -1, 2)
        moved = warp_points_tps(points, destination, weights, affine)
        return _pixels(moved.mT.unflatten(2, (height, width)), height, width, align_corners)


class RandomFisheye(_MapAugmentation):
    """Deform images as a fisheye lens does: pixels read further outward, the more the further they are from a center.

    The pixel at g, in coordinates from -1 to 1, reads the image at g (1 + |g - center| ** gamma).

    Args:
        center_x: range of the center along x, in coordinates from -1 to 1.
        center_y: range of the center along y.
        gamma: range of the exponent, at least 0.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range of another form, or out of its bounds.

    Example:
        >>> import torch, kvision as K
        >>> ranges = torch.tensor([-0.3, 0.3]), torch.tensor([-0.3, 0.3]), torch.tensor([0.9, 1.1])
        >>> K.augmentation.RandomFisheye(*ranges, p=1.0)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        center_x: Any,
        center_y: Any,
        gamma: Any,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = FisheyeGenerator(center_x, center_y, gamma)
        self.flags = {"align_corners": True}

    def coordinates(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        height, width = shape[-2:]
        grid = _grid(height, width, like)
        center = torch.cat([params["center_x"], params["center_y"]], 1).to(like)[:, :, None, None]
        radius = (grid - center).norm(dim=1, keepdim=True)
        moved = grid * (1 + radius ** params["gamma"].to(like)[:, :, None, None])
        return _pixels(moved, height, width, True)
