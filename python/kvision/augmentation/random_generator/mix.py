"""Generators of operations that mix the samples of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from kvision import _check
from kvision._constants import constant
from kvision.augmentation import ranges
from kvision.augmentation.draws import Draw, uniform
from kvision.augmentation.inputs import parse_size
from kvision.augmentation.random_generator.base import RandomGeneratorBase, Shape
from kvision.augmentation.ranges import Numbers
from kvision.core.exceptions import TypeCheckError, ValueCheckError

__all__ = ["CutmixGenerator", "JigsawGenerator", "MixupGenerator", "MosaicGenerator", "PatchMixGenerator"]


_PARTNER = Draw("uniform_of_sample", (0.0, 1.0, -1.0))  # orders the samples; -1 for those that are not chosen


def partners(order: Tensor) -> Tensor:
    """A random permutation of the chosen samples, from a draw `_PARTNER` of each; the others keep themselves."""
    # Both begin with the samples that are not chosen, as sorting is stable.
    return torch.empty_like(order, dtype=torch.int64).scatter(
        0, (order >= 0).int().argsort(stable=True), order.argsort(stable=True)
    )


def cutmix_window(kept: Tensor, u: Tensor, v: Tensor, low: float, high: float, height: int, width: int) -> Tensor:
    """Windows (B, 4), whose ends are not included, from draws (B,): the fraction kept and the positions."""
    side = (1 - kept).sqrt().clamp(low, high)
    w, h = (side * width).floor(), (side * height).floor()
    x, y = (u * (width - w + 1)).floor(), (v * (height - h + 1)).floor()
    return torch.stack([x, y, x + w, y + h], -1)


def jigsaw_order(columns: Tensor, ensure_perm: bool) -> Tensor:
    """The cells (B, rows * columns) in the order that was drawn."""
    order = columns.long()
    if ensure_perm and order.shape[1] > 1:
        # One draw in n! is the identity: it becomes a rotation of the cells.
        kept = (order == torch.arange(order.shape[1], device=order.device)).all(1, keepdim=True)
        order = torch.where(kept, order.roll(1, 1), order)
    return order


def mosaic_start(
    u: Tensor, v: Tensor, grid: tuple[int, int], source: tuple[int, int], size: tuple[int, int]
) -> tuple[Tensor, Tensor]:
    """Where the windows begin, from draws (B,)."""
    (rows, columns), (height, width), (h, w) = grid, source, size
    x, y = (u * width).floor(), (v * height).floor()
    return x.clamp(max=max(columns * width - w, 0)), y.clamp(max=max(rows * height - h, 0))


def mosaic_permutation(orders: Tensor) -> Tensor:
    """(B, cells): each sample itself, and partners by draws (B, cells - 1)."""
    own = torch.arange(orders.shape[0], device=orders.device)
    return torch.stack([own, *(partners(order) for order in orders.unbind(1))], 1)


class MixupGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomMixUpV2`.

    Args:
        lambda_val: range of the weight of the partner; None for 0 to 1.
        p: probability that a sample is mixed; the others have a weight of 0.

    Returns:
        mixup_pairs (B,), int64, the partners; mixup_lambdas (B,), their weights.

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within 0 and 1.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.MixupGenerator((0.5, 0.5))
        >>> draw((3, 1, 4, 4))["mixup_lambdas"]
        tensor([0.5000, 0.5000, 0.5000])
    """

    def __init__(self, lambda_val: Numbers | None = None, p: float = 1.0) -> None:
        super().__init__()
        (lambda_val,) = ranges.keep_parameters(self, lambda_val=lambda_val)
        value = (0.0, 1.0) if lambda_val is None else lambda_val
        self._lambda = ranges.parse("RandomMixUpV2", "lambda_val", value, bounds=(0.0, 1.0))
        self.p = p

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [_PARTNER, self._lambda.uniform()]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"mixup_pairs": partners(columns[:, 0]), "mixup_lambdas": columns[:, 1]}


class CutmixGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomCutMixV2`.

    Args:
        cut_size: range of the side of a window, as a fraction of the image's; None for 0 to 1.
        beta: parameter of the symmetric beta distribution of the area kept; None for 1, the uniform one.
        num_mix: how many windows each sample gets.
        p: probability that a sample is mixed.

    Returns:
        mix_pairs (num_mix, B), int64, the partners; crop_src (num_mix, B, 4, 2), corners of the windows, clockwise from top
        left, both ends inclusive; image_shape (2,).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is out of bounds.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.CutmixGenerator(num_mix=2)((3, 1, 4, 4))["mix_pairs"].shape
        torch.Size([2, 3])
    """

    def __init__(
        self, cut_size: Numbers | None = None, beta: float | Tensor | None = None, num_mix: int = 1, p: float = 1.0
    ) -> None:
        super().__init__()
        op = "RandomCutMixV2"
        num_mix = _check.scalar(op, "num_mix", num_mix)
        if type(num_mix) is not int or num_mix < 1:
            raise ValueCheckError(f"{op}: expected num_mix to be an int of at least 1, got {num_mix!r}")
        self._cut = ranges.parse(op, "cut_size", (0.0, 1.0) if cut_size is None else cut_size, bounds=(0.0, 1.0))
        self._beta = 1.0 if beta is None else float(beta)
        if not self._beta > 0:
            raise ValueCheckError(f"{op}: expected beta above 0, got {beta}")
        self.num_mix, self.p = num_mix, p

    def draws(self, shape: Shape) -> Sequence[Draw]:
        # A partner, the area kept, and the position of the window's center.
        return [
            _PARTNER,
            Draw("beta", (self._beta, self._beta, 1.0)),
            uniform(0.0, 1.0),
            uniform(0.0, 1.0),
        ] * self.num_mix

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        height, width = shape[-2:]
        pairs, windows = [], []
        for order, kept, u, v in columns.reshape(-1, self.num_mix, 4).permute(1, 2, 0):
            x, y, right, bottom = cutmix_window(kept, u, v, self._cut.low, self._cut.high, height, width).unbind(-1)
            right, bottom = right - 1, bottom - 1
            pairs.append(partners(order))
            windows.append(torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(-1, 4, 2))
        return {
            "mix_pairs": torch.stack(pairs),
            "crop_src": torch.stack(windows),
            "image_shape": torch.tensor([height, width], device="cpu"),
        }


class PatchMixGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`PatchMix`.

    Args:
        alpha: parameter of the symmetric beta distribution of the weight.
        patch_size: side of the window in pixels.
        p: probability that a sample is mixed.

    Returns:
        mix_pairs (B,), int64, the partners; patch_coords (B, 4), int64: first column, first row, and the ends of both;
        lam (B,), the weight of the labels that are kept: 1 less the area of the window.

    Raises:
        ValueError: `alpha` or `patch_size` is not above 0.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.PatchMixGenerator(patch_size=2)((3, 1, 4, 4))["lam"]
        tensor([0.7500, 0.7500, 0.7500])
    """

    def __init__(self, alpha: float = 1.0, patch_size: int | tuple[int, int] = 16, p: float = 1.0) -> None:
        super().__init__()
        self.alpha, self.p = _check.number("PatchMix", "alpha", alpha), p
        if not self.alpha > 0:
            raise ValueCheckError(f"PatchMix: expected alpha above 0, got {alpha}")
        self.patch_size = parse_size("PatchMix", patch_size)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        h, w = (min(a, b) for a, b in zip(self.patch_size, shape[-2:]))
        return [
            _PARTNER,
            Draw("integer", (0, 1, shape[-1] - w + 1, 0)),
            Draw("integer", (0, 1, shape[-2] - h + 1, 0)),
        ]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        h, w = (min(a, b) for a, b in zip(self.patch_size, shape[-2:]))
        x, y = columns[:, 1].long(), columns[:, 2].long()
        kept = 1 - h * w / (shape[-2] * shape[-1])
        return {
            "mix_pairs": partners(columns[:, 0]),
            "patch_coords": torch.stack([x, y, x + w, y + h], -1),
            "lam": torch.full_like(columns[:, 0], kept),
        }


class JigsawGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomJigsaw`.

    Args:
        grid: rows and columns of cells.
        ensure_perm: no sample keeps all cells at their positions.

    Returns:
        permutation (B, rows * columns), int64: which cell of the image comes at each position, by rows.

    Raises:
        TypeError, ValueError: `grid` is not two ints of at least 1.

    Example:
        >>> import kvision as K
        >>> K.augmentation.random_generator.JigsawGenerator((2, 2))((1, 1, 4, 4))["permutation"].sort().values
        tensor([[0, 1, 2, 3]])
    """

    def __init__(self, grid: tuple[int, int] = (4, 4), ensure_perm: bool = True) -> None:
        super().__init__()
        self.grid = parse_size("RandomJigsaw", grid)
        self.ensure_perm = _check.switch("RandomJigsaw", "ensure_perm", ensure_perm)

    def draws(self, shape: Shape) -> Sequence[Draw]:
        return [Draw("permutation", (self.grid[0] * self.grid[1], 0, 1))]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        return {"permutation": jigsaw_order(columns, self.ensure_perm)}


class MosaicGenerator(RandomGeneratorBase):
    """Draws the parameters of :class:`RandomMosaic`.

    Args:
        output_size: height and width of the result; None for those of the images.
        mosaic_grid: rows and columns of images.
        start_ratio_range: where the crop begins, as a fraction of the size of an image.

    Returns:
        permutation (B, rows * columns), int64, which samples are joined, the sample itself first; src and dst
        (B, 4, 2), corners of the crop with both ends inclusive; batch_shapes (B, 3).

    Raises:
        TypeError, ValueError: a range does not have the form in Args, or is not within 0 and 1; sizes that are not two
            ints of at least 1.

    Example:
        >>> import kvision as K
        >>> draw = K.augmentation.random_generator.MosaicGenerator(start_ratio_range=(0.5, 0.5))
        >>> draw((1, 3, 4, 4))["src"][0, 0]
        tensor([2., 2.])
    """

    def __init__(
        self,
        output_size: tuple[int, int] | None = None,
        mosaic_grid: tuple[int, int] = (2, 2),
        start_ratio_range: tuple[float, float] = (0.3, 0.7),
    ) -> None:
        super().__init__()
        self.output_size = None if output_size is None else parse_size("RandomMosaic", output_size)
        if isinstance(mosaic_grid, int):
            raise TypeCheckError(f"RandomMosaic: expected mosaic_grid to be (rows, columns), got {mosaic_grid!r}")
        self.mosaic_grid = parse_size("RandomMosaic", mosaic_grid)
        self._start = ranges.parse("RandomMosaic", "start_ratio_range", start_ratio_range, bounds=(0.0, 1.0))

    def draws(self, shape: Shape) -> Sequence[Any]:
        return [self._start.uniform(), self._start.uniform(), *[_PARTNER] * (self.cells - 1)]

    @property
    def cells(self) -> int:
        return self.mosaic_grid[0] * self.mosaic_grid[1]

    def to_params(self, columns: Tensor, shape: Shape) -> dict[str, Tensor]:
        h, w = self.output_size or (shape[-2], shape[-1])
        x, y = mosaic_start(columns[:, 0], columns[:, 1], self.mosaic_grid, (shape[-2], shape[-1]), (h, w))
        right, bottom = x + w - 1, y + h - 1
        src = torch.stack([x, y, right, y, right, bottom, x, bottom], -1).reshape(-1, 4, 2)
        dst = constant(((0, 0), (w - 1, 0), (w - 1, h - 1), (0, h - 1)), columns, torch.float32)
        return {
            "permutation": mosaic_permutation(columns[:, 2:]),
            "src": src,
            "dst": dst.repeat(columns.shape[0], 1, 1),
            "batch_shapes": torch.tensor(tuple(shape[1:]), device="cpu").expand(columns.shape[0], len(shape) - 1),
        }
