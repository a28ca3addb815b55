"""Several views of each image: fixed windows, and those of self-supervised training."""

from __future__ import annotations

import torch
from torch import Generator, Tensor, nn

from kvision import _check
from kvision._dtype import compute_dtype
from kvision._modes import INTERPOLATION
from kvision.augmentation.columns import Column, DrawPlan, plan_draws
from kvision.augmentation.drawn_links import DrawnLinks
from kvision.augmentation.draws import Request
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.keys import Keys, Seed, check_seeds, draw_keys
from kvision.augmentation.maps import warp, warp_each
from kvision.augmentation.random_generator.crop import ResizedCropGenerator
from kvision.augmentation.ranges import Numbers
from kvision.augmentation.transforms import MatrixPlan, Transform
from kvision.augmentation.warp_and_color import Resampling
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.geometry.transform.lists.arguments import check_list, like_batch, unchecked_list
from kvision.geometry.transform.resize_windows import resized_views, resized_windows

__all__ = ["FiveCrop", "MultiCrop", "TenCrop"]


class FiveCrop(nn.Module):
    """Cut five windows of a size out of images: the four corners and the middle, as torchvision's `FiveCrop`.

    Nothing is copied: the windows are views. Where an odd number of rows or columns is left over, half of it is rounded to the
    even number, as torchvision does.

    Args:
        size: height and width of the windows; an int for both.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; in a call, images smaller than the window.

    Example:
        >>> import torch, kvision as K
        >>> [x.tolist() for x in K.augmentation.FiveCrop(1)(torch.arange(9).reshape(1, 3, 3))]
        [[[[0]]], [[[2]]], [[[6]]], [[[8]]], [[[4]]]]
    """

    def __init__(self, size: int | tuple[int, int]) -> None:
        super().__init__()
        self.size = parse_size(type(self).__name__, size)

    def extra_repr(self) -> str:
        return f"size={self.size}"

    def forward(self, input: Tensor | list[Tensor]) -> tuple[Tensor, ...]:
        """The windows of images (*, H, W): upper left, upper right, lower left, lower right, middle.

        Of a list of images (C, H, W) of different sizes each window is a batch (B, C, h, w), which is copied.
        """
        op, (h, w) = type(self).__name__, self.size
        if isinstance(input, list):
            each = [self(image) for image in check_list(op, "input", input)]
            return tuple(torch.stack(windows) for windows in zip(*each))
        _check.trailing_shape(op, "input", input, "H", "W")
        down, right = input.shape[-2] - h, input.shape[-1] - w
        if down < 0 or right < 0:
            raise ValueCheckError(f"{op}: expected images of at least {self.size}, got {tuple(input.shape[-2:])}")
        corners = (0, 0), (0, right), (down, 0), (down, right), (round(down / 2), round(right / 2))
        return tuple(input[..., y : y + h, x : x + w] for y, x in corners)


class TenCrop(FiveCrop):
    """Cut the windows of :class:`FiveCrop` out of images and out of their mirror images, as torchvision's `TenCrop`.

    Args:
        size: height and width of the windows; an int for both.
        vertical_flip: mirror images upside down instead of from left to right.

    Raises:
        TypeError: `size` is not one or two ints.
        ValueError: a size below 1; in a call, images smaller than the window.

    Example:
        >>> import torch, kvision as K
        >>> [x.item() for x in K.augmentation.TenCrop(1)(torch.arange(9).reshape(1, 3, 3))]
        [0, 2, 6, 8, 4, 2, 0, 8, 6, 4]
    """

    def __init__(self, size: int | tuple[int, int], vertical_flip: bool = False) -> None:
        super().__init__(size)
        self.vertical_flip = _check.switch("TenCrop", "vertical_flip", vertical_flip)

    def extra_repr(self) -> str:
        return f"{super().extra_repr()}, vertical_flip={self.vertical_flip}"

    def forward(self, input: Tensor | list[Tensor]) -> tuple[Tensor, ...]:
        """The windows of images (*, H, W), and those of the mirror images in the same order; of a list as batches."""
        if isinstance(input, list):
            return super().forward(input)
        windows = super().forward(input)
        return (*windows, *super().forward(input.flip(-2 if self.vertical_flip else -1)))


class MultiCrop(nn.Module):
    """Cut several windows out of every image, large and small ones, and resize them: the views of self-supervised training.

    The windows of all views of every sample are drawn together, as those of :class:`RandomResizedCrop`, and each view is a
    resampling of the images, which are not copied for it. Edges of windows go to edges of views. With a seed of each image the
    views of a list are those of each image alone.

    Args:
        global_size: height and width of large views; an int for both.
        local_size: height and width of small views.
        global_crops: number of large views.
        local_crops: number of small views; 0 for none.
        global_scale: range of the area of large windows, as a fraction of the image's.
        local_scale: range of the area of small windows.
        ratio: range of width / height of windows.
        antialias: average the pixels that a pixel of a view covers.

    Raises:
        TypeError: a size or a count is not an int.
        ValueError: a size or `global_crops` below 1, `local_crops` below 0; a range does not have the form in Args.

    Source: M. Caron et al., "Emerging properties in self-supervised vision transformers" (2021).

    Example:
        >>> import torch, kvision as K
        >>> views = K.augmentation.MultiCrop(8, 4)(torch.rand(5, 3, 16, 20))
        >>> len(views), views[0].shape, views[9].shape
        (10, torch.Size([5, 3, 8, 8]), torch.Size([5, 3, 4, 4]))
    """

    def __init__(
        self,
        global_size: int | tuple[int, int] = 224,
        local_size: int | tuple[int, int] = 96,
        global_crops: int = 2,
        local_crops: int = 8,
        global_scale: Numbers = (0.4, 1.0),
        local_scale: Numbers = (0.05, 0.4),
        ratio: Numbers = (3.0 / 4.0, 4.0 / 3.0),
        antialias: bool = True,
    ) -> None:
        super().__init__()
        op = "MultiCrop"
        _check.ints(op, "global_crops", global_crops, 1)
        _check.ints(op, "local_crops", local_crops, 1, 0)
        self.counts = global_crops, local_crops
        self.global_generator = ResizedCropGenerator(parse_size(op, global_size), global_scale, ratio)
        self.local_generator = ResizedCropGenerator(parse_size(op, local_size), local_scale, ratio)
        self.antialias = _check.switch(op, "antialias", antialias)

    def forward(
        self, input: Tensor | list[Tensor], *, seed: Seed = None, generator: Generator | None = None
    ) -> list[Tensor]:
        """The views of images: first the large ones, then the small ones, each (B, C, h, w).

        Args:
            input: images (B, C, H, W), or a list of images (C, H, W) of different sizes.
            seed: an int, or int64 (B,) with one of a sample, from which all windows follow; torch's generator is not used.
            generator: draws the windows of this call; default: torch's.
        """
        op, generators = "MultiCrop", self._generators()
        if isinstance(input, list):
            return self._views_of_list(unchecked_list(op, "input", input), seed, generator)
        _check.images(op, "input", input)
        keys = draw_keys(op, len(generators), input.device, seed, generator)
        if keys.seeds is not None:
            check_seeds(op, keys, len(input))
        plans = plan_draws([Request(own.draws(tuple(input.shape))) for own in generators], keys.has_seed)
        if len(plans) == 1 and plans[0].learned is None and self.antialias and resized_views.serves(input):
            return self._views(input, plans[0], keys)
        sizes = [own.output_size for own in generators]
        matrices: list[Tensor] = []  # as graphs take it
        for draws in plans:
            chains = []
            for (h, w), span in zip(sizes[len(matrices) :], draws.spans):
                window = [Column(span.first + i) for i in range(4)]
                chains.append(MatrixPlan([Transform("crop", *window, float(w), float(h), 0.0)]))
            columns, _, links = DrawnLinks(draws, chains).draw(input, keys)
            if links is None:
                links = [chain.matrix(columns.to(compute_dtype(input))) for chain in chains]
            matrices += links
        return [self._view(input, matrix, size) for matrix, size in zip(matrices, sizes)]

    def _views(self, x: Tensor, draws: DrawPlan, keys: Keys) -> list[Tensor]:
        """One launch for the draws, and one for the views of each size."""
        columns = draws.draw(x, keys)
        views: list[Tensor] = []
        for count, generator in zip(self.counts, (self.global_generator, self.local_generator)):
            if count:
                spans = draws.spans[len(views) : len(views) + count]
                apart = spans[1].first - spans[0].first if count > 1 else 4
                boxes = columns.as_strided((len(x), count, 4), (columns.stride(0), apart, 1), spans[0].first)
                size = list(generator.output_size)
                views += resized_views.kernel(x, boxes, size, INTERPOLATION["bilinear"]).chunk(count)
        return views

    def _generators(self) -> list[ResizedCropGenerator]:
        """That of each view."""
        return [g for n, g in zip(self.counts, (self.global_generator, self.local_generator)) for _ in range(n)]

    def _views_of_list(self, images: list[Tensor], seed: Seed, generator: Generator | None) -> list[Tensor]:
        """One launch for the draws, and one for up to 512 views of a size."""
        op, generators, like = "MultiCrop", self._generators(), like_batch(images)
        if not like.is_floating_point() and like.dtype != torch.uint8:
            raise TypeCheckError(f"{op}: expected a list of bytes or floats, got {like.dtype}")
        keys = draw_keys(op, len(generators), like.device, seed, generator)
        if keys.seeds is not None:
            check_seeds(op, keys, len(images))
        requests = [[Request(own.draws(x.shape)) for own in generators] for x in check_list(op, "input", images)]
        plans, first = plan_draws(requests[0], keys.has_seed), 0
        windows: list[Tensor] = []
        views: list[Tensor] = []
        for draws in plans:
            own = range(first, first + len(draws.spans))
            numbers = [n for of_image in requests for i in own for draw in of_image[i].draws for n in draw.numbers]
            columns = draws.draw_list(like, keys, range(len(own)), numbers)
            windows += [columns[:, span.first : span.first + 4] for span in draws.spans]
            first += len(own)
        resampling = Resampling("bilinear", "border", False, None, self.antialias)
        for count, own_generator in zip(self.counts, (self.global_generator, self.local_generator)):
            if count:
                (h, w), of_views = own_generator.output_size, torch.cat(windows[len(views) : len(views) + count])
                chain = MatrixPlan([Transform("crop", *map(Column, range(4)), float(w), float(h), 0.0)])
                matrices = chain.matrix(of_views.to(compute_dtype(like)))
                views += warp_each(images * count, matrices, [h, w], resampling)[0].chunk(count)
        return views

    def _view(self, x: Tensor, matrix: Tensor, size: tuple[int, int]) -> Tensor:
        if self.antialias and (x.is_floating_point() or x.dtype == torch.uint8):
            y: Tensor = resized_windows(x, matrix, list(size), INTERPOLATION["bilinear"], False)
            return y
        return warp(x, matrix, size, Resampling("bilinear", "border", False, None, self.antialias))
