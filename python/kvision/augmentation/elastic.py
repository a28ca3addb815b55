"""Random deformations by maps: elastic, thin-plate and fisheye. Masks and key points follow the same map."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._ops import match_layout
from kvision._torch_compat import linspace
from kvision.augmentation import maps
from kvision.augmentation.displacements import NoiseField, blur_settings, elastic_displacements, scaled_blur
from kvision.augmentation.engine import AugmentationBase2D, Contribution, Execution, Motion, Params
from kvision.augmentation.maps import vector
from kvision.augmentation.noise import PixelNoise, noise_plan
from kvision.augmentation.preimages import find_positions
from kvision.augmentation.random_generator.elastic import ElasticGenerator, FisheyeGenerator, ThinPlateSplineGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.samples import where_chosen
from kvision.augmentation.warp_and_color import Resampling
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding
from kvision.core.exceptions import TypeCheckError
from kvision.geometry import get_tps_transform, warp_points_tps
from kvision.geometry.linalg import root

_WINDOW_SIZE = 256  # pixels along each side of the images that windows of `scale_window` are for

__all__ = ["RandomElasticTransform", "RandomFisheye", "RandomThinPlateSpline"]


class MapAugmentation(AugmentationBase2D, keeps_contract=True):
    """A deformation by a map: where each pixel of the result reads the image."""

    accepts_bytes = accepts_wide_integers = True
    keeps_lines = False
    moves_by_map = True

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map (B, 2, H, W), as maps.py stores it."""
        raise NotImplementedError

    def _noise_field(self, shape: tuple[int, ...], number: int, has_seed: bool) -> NoiseField | None:
        """The map for kernels that draw its noise; None if it is another map.

        `number` is that of the augmentation, as draw_columns counts.
        """
        return None

    def _declared(self, shape: tuple[int, ...], flags: dict[str, Any]) -> Contribution:
        return Contribution(Motion((shape[-2], shape[-1]), self.resampling(flags), None))

    def resampling(self, flags: dict[str, Any]) -> Resampling:
        """How images are read."""
        mode = Resample.get(flags.get("resample", Resample.BILINEAR)).name.lower()
        padding = SamplePadding.get(flags.get("padding_mode", SamplePadding.ZEROS)).name.lower()
        return Resampling(mode, padding, flags.get("align_corners", True))

    def _run(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or not execution.keeps_map or self._is_customized():
            return super()._run(x, execution, flags)
        y = maps.read_displaced(x, self._map_of(execution, flags, x), self.resampling(flags))
        return where_chosen(execution.chosen, match_layout(y, x), x)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        like = input.new_empty(0, dtype=compute_dtype(input))
        moved = self.displacements(tuple(input.shape), params, flags, like)
        return maps.read_displaced(input, moved, self.resampling(flags))

    def displacements_of(self, execution: Execution, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map of an execution, 0 for samples that are not chosen, on the device of `like` and in the type it computes in."""
        return where_chosen(execution.chosen, self._map_of(execution, flags, like), 0.0)

    def _map_of(self, execution: Execution, flags: dict[str, Any], like: Tensor) -> Tensor:
        """The map as drawn for all samples. The first one of an execution that keeps its map serves later ones of its type."""
        dtype, kept = compute_dtype(like), execution.map
        if kept is not None and kept.device == like.device and kept.dtype == dtype:
            return kept
        params = self._params_on_device(like, execution, for_users=False)
        like = like if like.dtype == dtype else like.new_empty(0, dtype=dtype)
        moved = self.displacements(execution.shape, params, flags, like)
        if execution.keeps_map and kept is None:
            execution.map = moved
        return moved

    def transform_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or masks.shape[0] == 0:
            return masks
        resampling = self.resampling(flags).for_labels(fill=flags.get("mask_fill"))
        moved = maps.read_labels_displaced(masks, self.displacements_of(execution, flags, masks), resampling)
        return where_chosen(execution.chosen, moved, masks)

    def transform_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        with torch.no_grad():
            moved, _ = find_positions(self.displacements_of(execution, self.flags, points), points)
        return where_chosen(execution.chosen, moved.to(points), points)

    # --- inverse ---

    def inverse_images(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or 0 in x.shape:
            return x
        back, converged = self._inverse_map(x, execution, flags)
        y = torch.where(converged, maps.read(x, back, self.resampling(flags).for_inverse()), 0).to(x.dtype)
        return where_chosen(execution.chosen, y, x)

    def inverse_masks(self, masks: Tensor, execution: Execution, flags: dict[str, Any]) -> Tensor:
        if not execution.applied or 0 in masks.shape:
            return masks
        back, converged = self._inverse_map(masks, execution, flags)
        read = maps.read_labels(masks, back, self.resampling(flags).for_inverse("nearest"))
        return where_chosen(execution.chosen, torch.where(converged, read, 0).to(masks.dtype), masks)

    def _inverse_map(self, x: Tensor, execution: Execution, flags: dict[str, Any]) -> tuple[Tensor, Tensor]:
        """Where the pixels of the image are in the result, (B, H, W, 2), and whether they are there, (B, 1, H, W)."""
        moved = self.displacements_of(execution, flags, x)
        h, w = moved.shape[-2:]
        pixels = maps.pixel_positions(h, w, moved).unflatten(1, (h, w)).expand(len(moved), -1, -1, -1)
        back, converged = maps.find_everywhere(moved, pixels)
        return back, converged[:, None]

    def inverse_points(self, points: Tensor, execution: Execution) -> Tensor:
        if not execution.applied or 0 in points.shape:
            return points
        moved = maps.read_positions(self.displacements_of(execution, self.flags, points), points)
        return where_chosen(execution.chosen, moved, points)


def _grid(height: int, width: int, like: Tensor) -> Tensor:
    """(2, H, W): the coordinates x and y of the pixels, from -1 to 1 at the centers of the outermost ones."""
    y, x = (linspace(-1, 1, n, like) for n in (height, width))
    return torch.stack([x.expand(height, width), y[:, None].expand(height, width)])


def _half_sizes(height: int, width: int, align_corners: bool, like: Tensor) -> Tensor:
    """(2, 1, 1): half of what coordinates from -1 to 1 extend over, in pixels."""
    less = 1 if align_corners else 0
    return vector(like, (width - less) / 2, (height - less) / 2)[:, None, None]


class RandomElasticTransform(MapAugmentation, keeps_contract=True):
    """Deform images by smooth random displacements: noise after a Gaussian blur.

    `alpha` scales with the image and the window of the blur does not, as in Kornia. So the default deforms a small image little,
    and folds 13% of one of 1024x1024 pixels: there pixels read the image in reverse order. With `scale_window` the deformation
    looks alike in all sizes.

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
        scale_window: `kernel_size` and `sigma` are those for images of 256x256 pixels, and scale with height and width. Images
            of other sizes get the deformation of these, enlarged.

    Raises:
        TypeError, ValueError: as `filters.gaussian_blur2d`.

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
        resample: AnyResample = Resample.BILINEAR.name,
        padding_mode: AnySamplePadding = "zeros",
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        scale_window: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ElasticGenerator()
        if not isinstance(alpha, (tuple, list)) or len(alpha) != 2:
            raise TypeCheckError(f"RandomElasticTransform: expected alpha to be two numbers, got {alpha!r}")
        alpha = (
            _check.number("RandomElasticTransform", "alpha", alpha[0]),
            _check.number("RandomElasticTransform", "alpha", alpha[1]),
        )
        self.flags = {
            "kernel_size": kernel_size,
            "sigma": sigma,
            "alpha": alpha,
            "align_corners": align_corners,
            "resample": Resample.get(resample),
            "padding_mode": padding_mode,
            "scale_window": scale_window,
        }
        blur_settings(kernel_size, sigma)
        SamplePadding.get(padding_mode)

    def _params_on_device(self, x: Tensor, execution: Execution, for_users: bool = True) -> Params:
        if execution.params is None and execution.redraw and execution.frames == 1 and not self._is_customized():
            # There are no other parameters: no columns are read.
            return {"_noise": (None, PixelNoise(*execution.redraw, self.same_on_batch, x.device))}
        return super()._params_on_device(x, execution, for_users)

    def _blur_and_scale(self, shape: tuple[int, ...], flags: dict[str, Any]) -> tuple[Any, tuple[float, float]]:
        less = 1 if flags["align_corners"] else 0
        scale_x, scale_y = (alpha * (n - less) / 2 for alpha, n in zip(flags["alpha"], (shape[-1], shape[-2])))
        blur = blur_settings(flags["kernel_size"], flags["sigma"])
        if flags["scale_window"]:
            height, width = (n / _WINDOW_SIZE for n in shape[-2:])
            blur = scaled_blur(blur, height, width)
            more = math.sqrt(height * width)  # the mean of more noise is that much smaller
            scale_x, scale_y = scale_x * more, scale_y * more
        return blur, (scale_x, scale_y)

    def _noise_field(self, shape: tuple[int, ...], number: int, has_seed: bool) -> NoiseField | None:
        blur, scale = self._blur_and_scale(shape, self.flags)
        if blur[3] is None or self._is_overridden("displacements"):  # standard deviations in a tensor; a user's map
            return None
        return NoiseField((shape[-2], shape[-1]), noise_plan(number, has_seed, self.same_on_batch), blur, scale)

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        key = ("displacements", shape[-2:])
        plan = self._plans.get(key) if flags is self.flags else None
        if plan is None:
            plan = self._blur_and_scale(shape, flags)
            if flags is self.flags:
                self._plans.keep(key, plan)
        if "_noise" in params:
            size = like.new_empty_strided((shape[0], 2, *shape[-2:]), (0, 0, 0, 0))  # one element
            return elastic_displacements(size, params["_noise"][1], *plan)
        return elastic_displacements(params["noise"].to(like), None, *plan)


class RandomThinPlateSpline(MapAugmentation, keeps_contract=True):
    """Deform images by thin-plate splines through the corners and the center, which move at random.

    Args:
        scale: how far the points move at most, in units of half the image's width and height.
        align_corners: -1 and 1 are the centers of the outermost pixels, not their outer edges.
        padding_mode: values out of bounds: 'zeros', 'border' or 'reflection'.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: `scale` is not a number of at least 0.

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
        padding_mode: AnySamplePadding = SamplePadding.ZEROS.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = ThinPlateSplineGenerator(scale)
        self.flags = {"align_corners": align_corners, "padding_mode": SamplePadding.get(padding_mode)}

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        source, destination = params["src"].to(like), params["dst"].to(like)
        weights, affine = get_tps_transform(destination, source)
        height, width = shape[-2:]
        align_corners = flags["align_corners"]
        grid = _grid(height, width, like)
        if not align_corners:  # the centers of the outermost pixels are half a pixel inside
            grid = grid * vector(like, (width - 1) / width, (height - 1) / height)[:, None, None]
        points = grid.flatten(1).mT.expand(shape[0], -1, 2)
        moved = warp_points_tps(points, destination, weights, affine).mT.unflatten(2, (height, width))
        return (moved - grid) * _half_sizes(height, width, align_corners, like)


_NEAREST = 2.0**-10


class RandomFisheye(MapAugmentation, keeps_contract=True):
    """Deform images as a fisheye lens does: pixels read the image farther from a center, more so at larger distances.

    The pixel at g, in coordinates from -1 to 1, reads the image at g (1 + |g - center| ** gamma). With a negative gamma it is
    those near the center that read far away.

    Args:
        center_x: range of the center along x, in coordinates from -1 to 1.
        center_y: range of the center along y.
        gamma: range of the exponent.
        same_on_batch: all samples get the same deformation.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> ranges = torch.tensor([-0.3, 0.3]), torch.tensor([-0.3, 0.3]), torch.tensor([0.9, 1.1])
        >>> K.augmentation.RandomFisheye(*ranges, p=1.0)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    def __init__(
        self,
        center_x: Numbers,
        center_y: Numbers,
        gamma: Numbers,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = FisheyeGenerator(center_x, center_y, gamma)
        self.flags = {"align_corners": True}

    def displacements(self, shape: tuple[int, ...], params: Params, flags: dict[str, Any], like: Tensor) -> Tensor:
        height, width = shape[-2:]
        grid = _grid(height, width, like)
        center = torch.cat([params["center_x"], params["center_y"]], 1).to(like)[:, :, None, None]
        radius = root((grid - center).square().sum(1, keepdim=True))
        gamma = params["gamma"].to(like)[:, :, None, None]
        radius = torch.where(
            gamma < 0, radius.clamp(min=_NEAREST), radius
        )  # so that the center reads a finite position
        displaced = grid * radius**gamma
        return displaced * _half_sizes(height, width, True, like)
