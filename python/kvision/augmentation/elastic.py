"""Random deformations by maps: elastic, thin-plate and fisheye. Masks and key points follow the same map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision.augmentation.displacements import (
    NoiseField,
    blur_and_scale,
    blur_settings,
    elastic_displacements,
    elastic_displacements_of_list,
)
from kvision.augmentation.distortion.displacement_map import MapFormula
from kvision.augmentation.distortion.distortion_base import MapAugmentation
from kvision.augmentation.engine import Execution, Params
from kvision.augmentation.lists.pixels import given_maps
from kvision.augmentation.noise import PixelNoise, noise_plan
from kvision.augmentation.random_generator.elastic import ElasticGenerator, FisheyeGenerator, ThinPlateSplineGenerator
from kvision.augmentation.ranges import Numbers
from kvision.constants import AnyResample, AnySamplePadding, Resample, SamplePadding
from kvision.core.exceptions import TypeCheckError
from kvision.geometry import get_tps_transform

_WINDOW_SIZE = 256  # pixels along each side of the images that windows of `scale_window` are for

__all__ = ["RandomElasticTransform", "RandomFisheye", "RandomThinPlateSpline"]


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
        return blur_and_scale(*self._settings(flags), shape[-2], shape[-1])

    def _settings(self, flags: dict[str, Any]) -> tuple[Any, tuple[float, float], bool, int]:
        """The first arguments of blur_and_scale."""
        blur = blur_settings(flags["kernel_size"], flags["sigma"])
        return blur, flags["alpha"], flags["align_corners"], _WINDOW_SIZE if flags["scale_window"] else 0

    def _noise_field(self, shape: tuple[int, ...], number: int, has_seed: bool) -> NoiseField | None:
        blur, scale = self._blur_and_scale(shape, self.flags)
        if blur[3] is None or self._is_overridden("displacements"):  # standard deviations in a tensor; a user's map
            return None
        return NoiseField((shape[-2], shape[-1]), noise_plan(number, has_seed, self.same_on_batch), blur, scale)

    def _maps_of_list(self, sides: Sequence[int], execution: Execution, like: Tensor) -> Tensor:
        chosen, given = execution.chosen, execution.params
        noise: Any
        if given is None:
            noise = self._pixel_noise(execution, execution.redraw, like.device)
        else:
            noise = given_maps(given["noise"], like.device, like.dtype, chosen)
        return elastic_displacements_of_list(
            noise, *self._settings(self.flags), sides, like, None if chosen is None else chosen.float()
        )

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

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        source, destination = params["src"].to(like), params["dst"].to(like)
        parts = [destination, *get_tps_transform(destination, source)]
        return MapFormula("thin_plate", torch.cat([part.flatten(1) for part in parts], 1), (flags["align_corners"],))


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

    def _formula(self, params: Params, flags: dict[str, Any], like: Tensor) -> MapFormula:
        names = ("center_x", "center_y", "gamma")
        return MapFormula("fisheye", torch.cat([params[name].to(like) for name in names], 1))
