"""Random filters and histogram transforms of images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from kvision import _check, enhance, filters
from kvision._choices import Border
from kvision._dtype import compute_dtype
from kvision._modes import BORDER
from kvision.augmentation.engine import AugmentationBase, Execution, Params
from kvision.augmentation.intensity_base import IntensityAugmentationBase2D
from kvision.augmentation.keys import refuse_mapped
from kvision.augmentation.lists import statistics_lists
from kvision.augmentation.lists.filter_lists import box_blur, filter2d, gaussian_blur2d, median_blur, sharpness
from kvision.augmentation.random_generator.filters import (
    JPEGGenerator,
    MotionBlurGenerator,
    RandomGaussianBlurGenerator,
)
from kvision.augmentation.random_generator.plain import PlainUniformGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.sample_rows import read_rows
from kvision.constants import AnyBorderType, AnyResample, BorderType, Resample
from kvision.enhance.batch import as_batch, colors
from kvision.filters.smoothing.box import box_arguments
from kvision.filters.smoothing.gaussian import blur_arguments
from kvision.filters.smoothing.motion import motion_arguments
from kvision.geometry.transform.lists.arguments import smallest_batch
from kvision.geometry.transform.lists.kept_sizes import Operation, OperationsOfSome

__all__ = [
    "RandomAutoContrast",
    "RandomBoxBlur",
    "RandomClahe",
    "RandomEqualize",
    "RandomGaussianBlur",
    "RandomJPEG",
    "RandomMedianBlur",
    "RandomMotionBlur",
    "RandomSharpness",
]


class RandomBoxBlur(IntensityAugmentationBase2D, keeps_contract=True):
    """Replace pixels by the mean of a window.

    Args:
        kernel_size: height and width of the window, odd.
        border_type: 'reflect', 'replicate', 'constant' or 'circular'.
        normalized: accepted for code written for Kornia: windows are averaged.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: as `filters.box_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomBoxBlur((1, 3), p=1.0)(torch.tensor([[[[0.0, 3.0, 0.0]]]]))
        tensor([[[[2., 1., 2.]]]])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] = (3, 3),
        border_type: Border = "reflect",
        normalized: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.flags = {"kernel_size": kernel_size, "border_type": border_type, "normalized": normalized}
        filters.BoxBlur(kernel_size, border_name(border_type))  # whose constructor checks them

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return filters.box_blur(input, flags["kernel_size"], border_name(flags["border_type"]))

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        size, border = self.flags["kernel_size"], border_name(self.flags["border_type"])
        return Operation(box_blur, box_arguments("RandomBoxBlur", like, size, border)[1:])


class RandomGaussianBlur(IntensityAugmentationBase2D, keeps_contract=True):
    """Blur images by Gaussians, each by its own.

    Args:
        kernel_size: height and width of the window, odd; an int for both.
        sigma: range of the standard deviation in pixels.
        border_type: 'reflect', 'replicate', 'constant' or 'circular'.
        separable: accepted for code written for Kornia: the result is the same.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> blur = K.augmentation.RandomGaussianBlur((3, 3), (0.1, 2.0), p=1.0)
        >>> blur(torch.ones(2, 1, 4, 4)).mean().round(decimals=4)
        tensor(1.)
    """

    def __init__(
        self,
        kernel_size: int | tuple[int, int],
        sigma: Numbers,
        border_type: AnyBorderType = "reflect",
        separable: bool = True,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = RandomGaussianBlurGenerator(sigma)
        self.flags = {
            "kernel_size": kernel_size,
            "separable": separable,
            "border_type": BorderType.get(border_type),
        }
        filters.GaussianBlur2d(kernel_size, (1.0, 1.0), border_name(border_type))  # whose constructor checks them

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return filters.gaussian_blur2d(
            input, flags["kernel_size"], params["sigma"].unsqueeze(1).expand(-1, 2), border_name(flags["border_type"])
        )

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        size, border = self.flags["kernel_size"], border_name(self.flags["border_type"])
        sigma = params["sigma"].unsqueeze(1).expand(-1, 2)
        arguments = blur_arguments("RandomGaussianBlur", like, size, sigma, border)
        return Operation(gaussian_blur2d, arguments[1:])


class RandomMedianBlur(IntensityAugmentationBase2D, keeps_contract=True):
    """Replace pixels by the median of a window.

    Args:
        kernel_size: height and width of the window, odd.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: as `filters.median_blur`.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomMedianBlur((1, 3), p=1.0)(torch.tensor([[[[1.0, 9.0, 2.0, 3.0]]]]))[..., 1:3]
        tensor([[[[2., 3.]]]])
    """

    def __init__(
        self,
        kernel_size: tuple[int, int] = (3, 3),
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.flags = {"kernel_size": kernel_size}
        filters.MedianBlur(kernel_size)  # whose constructor checks it

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return filters.median_blur(input, flags["kernel_size"])

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        ky, kx = _check.pair("RandomMedianBlur", "kernel_size", self.flags["kernel_size"])
        _check.reflectable("RandomMedianBlur", like, (ky // 2, kx // 2), "reflect", "use a smaller kernel_size")
        return Operation(median_blur, (ky, kx, BORDER["reflect"]))


class DrawnKernelSize(AugmentationBase):
    """A blur whose kernel size is drawn for the batch, or for each sample by its seed."""

    _param_generator: MotionBlurGenerator
    draws_for_batch = True

    def _named(self, values: Tensor, execution: Execution) -> Params:
        params = super()._named(values, execution)
        if execution.redraw is not None and execution.redraw[0].seeds is not None:
            params["ksize_factor"] = self._param_generator._sizes_of_samples(values)
        return params

    def _params_on_device(self, x: Tensor, execution: Execution, for_users: bool = True) -> Params:
        is_drawn = execution.params is None and execution.redraw is not None
        params = super()._params_on_device(x, execution, for_users)
        if is_drawn and not for_users and x.is_cuda and not self._param_generator._has_one_size and len(x) > 0:
            params["ksize_factor"] = self._named(self._values_on_host(execution), execution)["ksize_factor"]
        return params

    def _keep_size(self, execution: Execution, size: int) -> None:
        """Let the columns of all images say what size the batch got, as those of some are read later."""
        redraw = execution.redraw
        if execution.columns is not None and not (redraw is None or redraw[0].seeds is not None):
            execution.columns.values[:, 0] = size

    def _blurred(self, input: Tensor, params: Params, blur: Callable[[Tensor, int, Tensor, Tensor], Tensor]) -> Tensor:
        """Images blurred by `blur`, all samples of a size at once."""
        ksize, angle, direction = (params[f"{name}_factor"] for name in ("ksize", "angle", "direction"))
        if not self._param_generator._has_one_size:
            refuse_mapped(type(self).__name__, ksize)
        sizes = self._param_generator._sizes_on_host(ksize)
        if len(sizes) == 1:
            return blur(input, sizes[0], angle, direction)
        y = torch.empty_like(input)
        for size in sorted(set(sizes)):
            own = torch.tensor([i for i, n in enumerate(sizes) if n == size], device=input.device)
            y = y.index_copy(0, own, blur(input[own], size, angle[own], direction[own]))
        return y


class RandomMotionBlur(DrawnKernelSize, IntensityAugmentationBase2D, keeps_contract=True):
    """Blur images along a random line.

    Args:
        kernel_size: length of the line, odd and at least 3, or a pair of lowest and highest; one is drawn for the batch, with a
            seed of each sample for each.
        angle: degrees: a number a for -a to a, or a pair.
        direction: a number d for -d to d, or a pair, within -1 and 1: where along the line the weight is.
        border_type: 'constant', 'reflect', 'replicate' or 'circular'.
        resample: 'nearest' or 'bilinear': how the line is rotated.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> blur = K.augmentation.RandomMotionBlur(3, (0.0, 0.0), (0.0, 0.0), p=1.0)
        >>> blur(torch.tensor([[[[0.0, 3.0, 0.0]]]]))
        tensor([[[[1., 1., 1.]]]])
    """

    def __init__(
        self,
        kernel_size: int | tuple[int, int],
        angle: Numbers,
        direction: Numbers,
        border_type: AnyBorderType = BorderType.CONSTANT.name,
        resample: AnyResample = Resample.NEAREST.name,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        generator = MotionBlurGenerator(kernel_size, angle, direction)
        self._param_generator: MotionBlurGenerator = generator
        self.flags = {"border_type": BorderType.get(border_type), "resample": Resample.get(resample)}

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        mode: Any = Resample.get(flags["resample"]).name.lower()
        border = border_name(flags["border_type"])
        return self._blurred(input, params, partial(filters.motion_blur, border_type=border, mode=mode))

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        (size,) = self._param_generator._sizes_on_host(params["ksize_factor"])
        line = size, params["angle_factor"], params["direction_factor"]
        mode: Any = Resample.get(self.flags["resample"]).name.lower()
        border = border_name(self.flags["border_type"])
        return Operation(filter2d, motion_arguments("RandomMotionBlur", like, *line, border, mode)[1:])

    def _operation_on_list(
        self, images: Sequence[Tensor], like: Tensor, execution: Execution
    ) -> Operation | OperationsOfSome:
        """One operator for the images of each kernel size that was drawn."""
        params = self._params_on_device(like, execution, for_users=False)
        sizes = self._param_generator._sizes_on_host(params["ksize_factor"])
        if len(sizes) == 1:
            self._keep_size(execution, sizes[0])
            return self._operation(like, params)
        each = []
        for size in sorted(set(sizes)):
            samples = [i for i, n in enumerate(sizes) if n == size]
            own = {name: read_rows(x, samples) for name, x in params.items() if len(x) == len(sizes)}
            each.append((samples, self._operation(smallest_batch([images[i] for i in samples]), own)))
        return OperationsOfSome(each)


class RandomSharpness(IntensityAugmentationBase2D, keeps_contract=True):
    """Sharpen images by a random factor.

    Args:
        sharpness: a number s for 0 to s, or a pair, of at least 0; 1 changes nothing, 0 blurs.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomSharpness((1.0, 1.0), p=1.0)(torch.tensor([[[[0.25, 0.75]]]]))
        tensor([[[[0.2500, 0.7500]]]])
    """

    takes_volumes = True

    def __init__(
        self,
        sharpness: Numbers = 0.5,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        is_range = isinstance(sharpness, (tuple, list)) or (isinstance(sharpness, Tensor) and sharpness.dim())
        values: Any = sharpness if is_range else (0.0, sharpness)
        self._param_generator = PlainUniformGenerator(
            (values, "sharpness", None, (0.0, float("inf"))), identity=[1.0], op="RandomSharpness"
        )

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.sharpness(input, params["sharpness"])

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        factor = params["sharpness"].to(like.device, compute_dtype(like))[:, None, None]
        return Operation(sharpness, (factor, 0.0))


class RandomEqualize(IntensityAugmentationBase2D, keeps_contract=True):
    """Equalize the histogram of each channel.

    Args:
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomEqualize(p=1.0)(torch.rand(2, 3, 8, 8)).shape
        torch.Size([2, 3, 8, 8])
    """

    takes_volumes = True

    def __init__(
        self,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.equalize(input)

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        return Operation(statistics_lists.equalize, (False,))


class RandomAutoContrast(IntensityAugmentationBase2D, keeps_contract=True):
    """Stretch the values of each channel to 0 and 1; those of one value stay.

    Args:
        clip_output: clamp the result to 0 and 1.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError: `p` is not a number.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomAutoContrast()(torch.tensor([[[[0.25, 0.5]]]])).round(decimals=3)
        tensor([[[[0., 1.]]]])
    """

    takes_volumes = True

    def __init__(
        self,
        clip_output: bool = True,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self.clip_output = _check.switch("RandomAutoContrast", "clip_output", clip_output)

    accepts_bytes = False

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return self._operation(input, params)(as_batch(input)).reshape(input.shape)

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        settings = (0.0, 1.0, 1e-6, self.clip_output, True)
        return Operation(statistics_lists.normalize_min_max, settings)


def has_range(x: Tensor) -> Tensor:
    """(*, 1, 1), whether a channel (H, W) has more than one value."""
    lowest, highest = x.detach().flatten(-2).aminmax(dim=-1)
    return (lowest != highest)[..., None, None]


class RandomClahe(IntensityAugmentationBase2D, keeps_contract=True):
    """Equalize images by contrast-limited adaptive histograms (CLAHE).

    Args:
        clip_limit: range of the limit of contrast; 0 for none.
        grid_size: rows and columns of tiles.
        slow_and_differentiable: with a gradient to the histogram.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomClahe(grid_size=(2, 2), p=1.0)(torch.rand(1, 1, 8, 8)).shape
        torch.Size([1, 1, 8, 8])
    """

    takes_volumes = True

    def __init__(
        self,
        clip_limit: Numbers = (40.0, 40.0),
        grid_size: tuple[int, int] = (8, 8),
        slow_and_differentiable: bool = False,
        same_on_batch: bool = False,
        p: float = 0.5,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = PlainUniformGenerator(
            (clip_limit, "clip_limit_factor", None, (0.0, float("inf"))), op="RandomClahe"
        )
        self.flags = {"grid_size": grid_size, "slow_and_differentiable": slow_and_differentiable}
        no_images = torch.empty(0, 1, 64, 64, device="cpu")  # a call on none checks the settings
        enhance.equalize_clahe(no_images, 1.0, grid_size, slow_and_differentiable)

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        limits = params["clip_limit_factor"]
        return enhance.equalize_clahe(input, limits, flags["grid_size"], flags["slow_and_differentiable"])

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        limits = params["clip_limit_factor"].detach().to(like.device, compute_dtype(like))[:, None, None]
        rows, columns = _check.pair("RandomClahe", "grid_size", tuple(self.flags["grid_size"]))
        return Operation(statistics_lists.equalize_clahe, (limits, 0.0, rows, columns, False))

    def _operates_on(self, dtype: torch.dtype) -> bool:
        return not self.flags["slow_and_differentiable"] and super()._operates_on(dtype)


class RandomJPEG(IntensityAugmentationBase2D, keeps_contract=True):
    """Compress RGB images by JPEG with a random quality, differentiably.

    Args:
        jpeg_quality: a number q for q to 100, or a pair, within 1 and 100.
        same_on_batch: all samples get the same parameters.
        p: probability that a sample is augmented.
        keepdim: an image (C, H, W) gives an image (C, H, W) instead of a batch of one.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import torch, kvision as K
        >>> K.augmentation.RandomJPEG((50.0, 50.0))(torch.rand(1, 3, 16, 16)).shape
        torch.Size([1, 3, 16, 16])
    """

    def __init__(
        self,
        jpeg_quality: Numbers = 50.0,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim, **options)
        self._param_generator = JPEGGenerator(jpeg_quality)

    accepts_bytes = False

    def apply_transform(
        self, input: Tensor, params: Params, flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        return enhance.jpeg_codec_differentiable(input, params["jpeg_quality"])

    filters_chosen = True

    def _operation(self, like: Tensor, params: Params) -> Operation:
        colors("RandomJPEG", "input", like)
        quality = params["jpeg_quality"].to(like.device, compute_dtype(like))
        return Operation(statistics_lists.jpeg, (quality, None, None, 0.0))


def border_name(border: Any) -> Any:
    """The name of a border as kvision.filters takes it."""
    return BorderType.get(border).name.lower()
