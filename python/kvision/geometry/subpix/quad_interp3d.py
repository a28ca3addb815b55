"""Subvoxel peaks of volumes: the extremum of the quadratic through 3 x 3 x 3 voxels."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from kvision import _check
from kvision._dtype import compute_dtype, floats
from kvision._modules import VOLUME, FunctionModule
from kvision._ops import on_cuda, register
from kvision.core.exceptions import ShapeError, TypeCheckError
from kvision.geometry.subpix.nms import nms3d
from kvision.geometry.subpix.soft_argmax import warn_of_bonus

__all__ = [
    "AdaptiveQuadInterp3d",
    "ConvQuadInterp3d",
    "IterativeQuadInterp3d",
    "conv_quad_interp3d",
    "iterative_quad_interp3d",
]

Mode: TypeAlias = Literal["patch", "conv", "auto"]
_MODES = get_args(Mode)
ANYWHERE = 2**31 - 1  # an unlimited search radius

# --- the definition -------------------------------------------------------------------------------------------------


def _reference(x, chosen, steps, largest_shift, radius, along_scale):
    grid = _grid(x)
    if min(x.shape[2:]) < 3:
        return torch.stack([g.expand(x.shape) for g in grid], 2).to(x.dtype), x.clone()
    center, settled = _search(x.detach(), chosen, steps, largest_shift, radius, along_scale)
    value, gradient, hessian = _quadratic(x, center)
    shift, _ = _solve(hessian, [-g for g in gradient], settled)
    rise = sum(g * s for g, s in zip(gradient, shift)) / 2
    coords = [torch.where(settled, c + s, g) for c, s, g in zip(center, shift, grid)]
    return torch.stack(coords, 2).to(x.dtype), torch.where(settled, value + rise, x)


def _grid(x):
    """Indices of the voxels along scale, x, y, in shapes that broadcast."""
    d, h, w = (torch.arange(n, device=x.device) for n in x.shape[2:])
    return d[:, None, None], w, h[:, None]


def _search(x, chosen, steps, largest_shift, radius, along_scale):
    """The voxel (scale, x, y) at which the search from each voxel ends, and whether the search converges there."""
    start, last = _grid(x), (x.shape[2] - 2, x.shape[4] - 2, x.shape[3] - 2)
    center = [g.expand(x.shape) for g in start]
    searching = nms3d(x, (3, 3, 3), mask_only=True) if chosen is None else chosen != 0
    settled = torch.zeros_like(searching)
    final = [c.clamp(1, n) for c, n in zip(center, last)]
    for _ in range(steps):
        inside = [c.clamp(1, n) for c, n in zip(center, last)]
        for c, i, s in zip(center, inside, start):
            searching = searching & (c == i) & ((c - s).abs() <= radius)
        _, gradient, hessian = _quadratic(x, inside)
        shift, solved = _solve(hessian, [-g for g in gradient], searching)
        searching = searching & solved
        by = [(s > largest_shift).long() - (s < -largest_shift).long() for s in shift]
        if not along_scale:
            by[0] = torch.zeros_like(by[0])
        moved = (by[0] != 0) | (by[1] != 0) | (by[2] != 0)
        near = (shift[0].abs() <= 1.5) & (shift[1].abs() <= 1.5) & (shift[2].abs() <= 1.5)
        here = searching & ~moved & near
        settled = settled | here
        final = [torch.where(here, c, f) for c, f in zip(inside, final)]
        searching = searching & moved
        center = [c + b for c, b in zip(center, by)]
    return final, settled


def _quadratic(x, center):
    """Value, gradient along scale, x, y and Hessian of x at voxels `center`, by finite differences."""
    (_, h, w), (cz, cx, cy) = x.shape[2:], center
    flat, middle = x.flatten(2), ((cz * h + cy) * w + cx).flatten(2)
    units = (h * w, 1, w)

    def at(offset):
        return flat.gather(2, middle + offset).view(x.shape)

    value = at(0)
    around = [(at(-u), at(u)) for u in units]
    gradient = [(after - before) / 2 for before, after in around]
    hessian = [[None] * 3 for _ in units]
    for i, u in enumerate(units):
        hessian[i][i] = around[i][1] - 2 * value + around[i][0]
        for j, v in enumerate(units[:i]):
            hessian[i][j] = hessian[j][i] = (at(u + v) - at(u - v) - at(v - u) + at(-u - v)) / 4
    return value, gradient, hessian


def _solve(hessian, right, mask):
    """Solve a symmetric system where `mask` is set, else return 0; and return whether the solution exists."""
    h = hessian
    largest = torch.stack([abs(h[i][j]) for i in range(3) for j in range(i + 1)]).amax(0).detach()
    unit = torch.where(mask & (largest > 0), largest, 1)
    h = [[torch.where(mask, v, 0) / unit for v in row] for row in h]
    after = (1, 2, 0), (2, 0, 1)
    cofactors = [[h[i1][j1] * h[i2][j2] - h[i1][j2] * h[i2][j1] for j1, j2 in zip(*after)] for i1, i2 in zip(*after)]
    determinant = sum(v * c for v, c in zip(h[0], cofactors[0]))
    solved = mask & (determinant.abs() > 1e-7)
    scale = torch.where(solved, 1, 0) / (torch.where(solved, determinant, 1) * unit)
    right = [torch.where(solved, r, 0) for r in right]
    return [sum(c * r for c, r in zip(row, right)) * scale for row in cofactors], solved


def _gradient(grad_coords, grad_values, x, chosen, *options):
    computes = compute_dtype(x)
    x, grads = x.to(computes), (grad_coords.to(computes), grad_values.to(computes))
    _, vjp_fn = torch.func.vjp(lambda x: _reference(x, chosen, *options), x)
    return vjp_fn(grads)[0]


_peaks = register(
    "conv_quad_interp3d",
    _reference,
    fake=lambda x, *options: [(*x.shape[:2], 3, *x.shape[2:]), x.shape],
    gradients="input: conv_quad_interp3d_backward",
)
register(
    "conv_quad_interp3d_backward",
    _gradient,
    fake=lambda coords, values, x, *options: x.new_empty(x.shape, dtype=compute_dtype(x)),
    casts_outputs=True,
    nondeterministic=on_cuda,
)

# --- functions ------------------------------------------------------------------------------------------------------


def conv_quad_interp3d(
    input: Tensor,
    n_iters: int = 5,
    strict_maxima_bonus: float | None = None,
    max_subpixel_shift: float = 0.6,
    precomputed_nms_mask: Tensor | None = None,
    dilation_radius: int = 1,
    allow_scale_steps: bool = True,
) -> tuple[Tensor, Tensor]:
    """Refine the maxima of volumes to subvoxel accuracy, at the top of the quadratic through 3 x 3 x 3 voxels.

    Where the top is more than `max_subpixel_shift` away along an axis, the center moves by a voxel in that
    direction and the quadratic is fitted again. A maximum keeps its voxel if it has not converged after `n_iters`
    fits, if its quadratic has no top, or if its center moves away by more than `dilation_radius`. All other voxels
    keep their coordinates and values. Gradients are those of the last fit.

    Args:
        input: volumes (B, C, D, H, W), scale along D. Integers are computed in float32.
        n_iters: maximum number of fits, at least 0.
        strict_maxima_bonus: no effect, kept for compatibility; a value other than None gives a DeprecationWarning.
        max_subpixel_shift: largest offset from the center along an axis at which a fit is accepted, in voxels.
        precomputed_nms_mask: bool (B, C, D, H, W), the voxels to refine. None for the strict maxima of 3 x 3 x 3
            voxels.
        dilation_radius: largest distance along an axis that a center may move, in voxels.
        allow_scale_steps: let centers move along D, too.

    Returns:
        Coordinates (B, C, 3, D, H, W) in the order scale, x, y, in voxels, and the values there (B, C, D, H, W).

    Raises:
        TypeError: `input` is not a tensor of real numbers; the mask is not bool; `n_iters` or `dilation_radius` is not an int;
            `max_subpixel_shift` or `strict_maxima_bonus` is not a number; `allow_scale_steps` is not a bool.
        ValueError: `input` is not (B, C, D, H, W); the mask does not have the shape and device of `input`; `n_iters`,
            `max_subpixel_shift` or `dilation_radius` is negative.

    Source: M. Brown and D. Lowe, "Invariant features from interest point groups" (2002).

    Example:
        >>> import torch, kvision as K
        >>> z, y, x = torch.meshgrid([torch.arange(5.0)] * 3, indexing="ij")
        >>> bump = -((x - 2.25) ** 2 + (y - 2) ** 2 + (z - 1.75) ** 2)
        >>> coords, values = K.geometry.conv_quad_interp3d(bump[None, None])
        >>> coords[0, 0, :, 2, 2, 2], values[0, 0, 2, 2, 2].round(decimals=4) + 0
        (tensor([1.7500, 2.2500, 2.0000]), tensor(0.))
    """
    op = "conv_quad_interp3d"
    x, chosen = _arguments(
        op, input, n_iters, strict_maxima_bonus, max_subpixel_shift, precomputed_nms_mask, allow_scale_steps
    )
    (radius,) = _check.ints(op, "dilation_radius", dilation_radius, 1, minimum=0)
    return _peaks(x, chosen, n_iters, float(max_subpixel_shift), radius, allow_scale_steps)


def iterative_quad_interp3d(
    input: Tensor,
    n_iters: int = 5,
    strict_maxima_bonus: float | None = None,
    max_subpixel_shift: float = 0.6,
    allow_scale_steps: bool = True,
    precomputed_nms_mask: Tensor | None = None,
    max_candidates: int | None = None,
) -> tuple[Tensor, Tensor]:
    """Refine the maxima of volumes as :func:`conv_quad_interp3d`, without a limit to the distance that centers move.

    Args:
        input: volumes (B, C, D, H, W), scale along D. Integers are computed in float32.
        n_iters: maximum number of fits, at least 0.
        strict_maxima_bonus: no effect, kept for compatibility; a value other than None gives a DeprecationWarning.
        max_subpixel_shift: largest offset from the center along an axis at which a fit is accepted, in voxels.
        allow_scale_steps: let centers move along D, too.
        precomputed_nms_mask: bool (B, C, D, H, W), the voxels to refine. None for the strict maxima of 3 x 3 x 3
            voxels.
        max_candidates: number of maxima of a volume, the largest ones, that are refined. None for all.

    Returns:
        Coordinates (B, C, 3, D, H, W) in the order scale, x, y, in voxels, and the values there (B, C, D, H, W).

    Raises:
        TypeError: `input` is not a tensor of real numbers; the mask is not bool; `n_iters` or `max_candidates` is not an int;
            `max_subpixel_shift` or `strict_maxima_bonus` is not a number; `allow_scale_steps` is not a bool.
        ValueError: `input` is not (B, C, D, H, W); the mask does not have the shape and device of `input`; `n_iters`,
            `max_subpixel_shift` or `max_candidates` is negative.

    Example:
        >>> import torch, kvision as K
        >>> coords, values = K.geometry.iterative_quad_interp3d(torch.rand(1, 2, 4, 5, 6))
        >>> coords.shape, values.shape
        (torch.Size([1, 2, 3, 4, 5, 6]), torch.Size([1, 2, 4, 5, 6]))
    """
    op = "iterative_quad_interp3d"
    x, chosen = _arguments(
        op, input, n_iters, strict_maxima_bonus, max_subpixel_shift, precomputed_nms_mask, allow_scale_steps
    )
    if max_candidates is not None:
        (count,) = _check.ints(op, "max_candidates", max_candidates, 1, minimum=0)
        chosen = _largest(x.detach(), chosen, count)
    return _peaks(x, chosen, n_iters, float(max_subpixel_shift), ANYWHERE, allow_scale_steps)


def _arguments(op, input, n_iters, bonus, max_subpixel_shift, mask, allow_scale_steps):
    _check.volumes(op, "input", input)
    warn_of_bonus(op, bonus, stacklevel=4)
    _check.ints(op, "n_iters", n_iters, 1, minimum=0)
    _check.number(op, "max_subpixel_shift", max_subpixel_shift, minimum=0)
    _check.flag(op, "allow_scale_steps", allow_scale_steps)
    if mask is not None:
        _check.numbers(op, "precomputed_nms_mask", mask)
        if mask.dtype != torch.bool:
            raise TypeCheckError(f"{op}: expected precomputed_nms_mask to be bool, got {mask.dtype}")
        if mask.shape != input.shape:
            raise ShapeError(
                f"{op}: expected precomputed_nms_mask of shape {tuple(input.shape)}, got {tuple(mask.shape)}",
                actual_shape=mask.shape,
            )
        _check.same_device(op, input=input, precomputed_nms_mask=mask)
        mask = mask.to(torch.uint8)
    return floats(input), mask


def _largest(x: Tensor, chosen: Tensor | None, count: int) -> Tensor:
    """The `count` largest of the chosen voxels of each volume."""
    mask = nms3d(x, (3, 3, 3), mask_only=True) if chosen is None else chosen != 0
    ranked = torch.where(mask, x, -torch.inf).flatten(2)
    best = ranked.topk(min(count, ranked.shape[2]), 2).indices
    return mask.to(torch.uint8) * torch.zeros_like(ranked, dtype=torch.uint8).scatter(2, best, 1).view(x.shape)


# --- modules --------------------------------------------------------------------------------------------------------


class ConvQuadInterp3d(FunctionModule):
    """Module form of :func:`conv_quad_interp3d`.

    Example:
        >>> import torch, kvision as K
        >>> coords, values = K.ConvQuadInterp3d(10)(torch.rand(1, 1, 3, 5, 6))
        >>> coords.shape
        torch.Size([1, 1, 3, 3, 5, 6])
    """

    samples = (VOLUME,)

    def __init__(
        self,
        n_iters: int = 5,
        strict_maxima_bonus: float | None = None,
        max_subpixel_shift: float = 0.6,
        dilation_radius: int = 1,
        allow_scale_steps: bool = True,
    ) -> None:
        warn_of_bonus("ConvQuadInterp3d", strict_maxima_bonus)
        super().__init__(
            n_iters=n_iters,
            max_subpixel_shift=max_subpixel_shift,
            dilation_radius=dilation_radius,
            allow_scale_steps=allow_scale_steps,
        )

    def forward(self, x: Tensor, precomputed_nms_mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return conv_quad_interp3d(
            x,
            self.n_iters,
            None,
            self.max_subpixel_shift,
            precomputed_nms_mask,
            self.dilation_radius,
            self.allow_scale_steps,
        )


class IterativeQuadInterp3d(FunctionModule):
    """Module form of :func:`iterative_quad_interp3d`.

    Example:
        >>> import torch, kvision as K
        >>> coords, values = K.geometry.IterativeQuadInterp3d(max_candidates=8)(torch.rand(1, 1, 3, 5, 6))
        >>> values.shape
        torch.Size([1, 1, 3, 5, 6])
    """

    samples = (VOLUME,)

    def __init__(
        self,
        n_iters: int = 5,
        strict_maxima_bonus: float | None = None,
        max_subpixel_shift: float = 0.6,
        allow_scale_steps: bool = True,
        max_candidates: int | None = None,
    ) -> None:
        warn_of_bonus("IterativeQuadInterp3d", strict_maxima_bonus)
        super().__init__(
            n_iters=n_iters,
            max_subpixel_shift=max_subpixel_shift,
            allow_scale_steps=allow_scale_steps,
            max_candidates=max_candidates,
        )

    def forward(self, x: Tensor, precomputed_nms_mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        return iterative_quad_interp3d(
            x,
            self.n_iters,
            None,
            self.max_subpixel_shift,
            self.allow_scale_steps,
            precomputed_nms_mask,
            self.max_candidates,
        )


class AdaptiveQuadInterp3d(FunctionModule):
    """:func:`conv_quad_interp3d` or :func:`iterative_quad_interp3d`; both take the same time in kvision.

    Args:
        mode: 'conv' for the first, 'patch' or 'auto' for the second. Kornia's 'auto' is the first on CUDA; here all
            devices give the same peaks.
        n_iters, strict_maxima_bonus, max_subpixel_shift, allow_scale_steps: arguments of both functions.
        dilation_radius: argument of :func:`conv_quad_interp3d`.
        max_candidates: argument of :func:`iterative_quad_interp3d`.

    Raises:
        ValueError: `mode` is unknown.

    Example:
        >>> import torch, kvision as K
        >>> coords, values = K.geometry.AdaptiveQuadInterp3d()(torch.rand(1, 1, 3, 5, 6))
        >>> values.shape
        torch.Size([1, 1, 3, 5, 6])
    """

    samples = (VOLUME,)

    def __init__(
        self,
        mode: Mode = "auto",
        n_iters: int = 5,
        strict_maxima_bonus: float | None = None,
        max_subpixel_shift: float = 0.6,
        dilation_radius: int = 1,
        allow_scale_steps: bool = True,
        max_candidates: int | None = None,
    ) -> None:
        warn_of_bonus("AdaptiveQuadInterp3d", strict_maxima_bonus)
        _check.choice("AdaptiveQuadInterp3d", "mode", mode, _MODES)
        super().__init__(
            mode=mode,
            n_iters=n_iters,
            max_subpixel_shift=max_subpixel_shift,
            dilation_radius=dilation_radius,
            allow_scale_steps=allow_scale_steps,
            max_candidates=max_candidates,
        )

    def forward(self, x: Tensor, precomputed_nms_mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        _check.volumes("AdaptiveQuadInterp3d", "x", x)
        shared: dict[str, Any] = {
            "n_iters": self.n_iters,
            "max_subpixel_shift": self.max_subpixel_shift,
            "precomputed_nms_mask": precomputed_nms_mask,
            "allow_scale_steps": self.allow_scale_steps,
        }
        if self.mode == "conv":
            return conv_quad_interp3d(x, dilation_radius=self.dilation_radius, **shared)
        return iterative_quad_interp3d(x, max_candidates=self.max_candidates, **shared)
