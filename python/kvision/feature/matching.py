"""Matches of descriptors: nearest neighbors, mutual ones, ratio tests, and tests of positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._ops import register
from kvision._torch_compat import is_tracing
from kvision.core.exceptions import ShapeError, TypeCheckError

MatchMode: TypeAlias = Literal["nn", "mnn", "snn", "smnn"]
# --- the two nearest ------------------------------------------------------------------------------------------------
#
# Without the distance matrix, so that memory grows with N + M. Descriptors that are left out, and those with NaN, have no
# neighbors: distance inf and index -1.


def _smallest_two(distances: Tensor) -> tuple[Tensor, Tensor]:
    """The two smallest entries of every row, the first of equal ones, and their columns; NaN is no entry."""
    distances = nn.functional.pad(torch.where(distances.isnan(), math.inf, distances), (0, 2), value=math.inf)
    first = distances.argmin(-1, keepdim=True)
    others = distances.scatter(-1, first, math.inf)
    second = others.argmin(-1, keepdim=True)
    values = torch.cat([distances.gather(-1, first), others.gather(-1, second)], -1)
    return values, torch.where(values < math.inf, torch.cat([first, second], -1), -1)


def _distances_of_pairs(desc: Tensor, others: Tensor, indices: Tensor) -> Tensor:
    """The distances (B, N, 2) of desc (B, N, D) from the rows of others (B, M, D) with these indices, inf for -1."""
    is_pair = indices >= 0
    if others.shape[1] == 0:
        return desc.new_full(indices.shape, math.inf)
    rows = torch.where(is_pair, indices, 0).flatten(1)[..., None].expand(-1, -1, others.shape[2])
    neighbors = others.gather(1, rows).unflatten(1, indices.shape[1:])
    differences = torch.where(is_pair[..., None], desc[:, :, None] - neighbors, 0)
    squares = differences.square().sum(-1)
    is_positive = squares > 0  # the gradient at 0 is 0
    distances = torch.where(is_positive, torch.where(is_positive, squares, 1).sqrt(), 0)
    return torch.where(is_pair, distances, math.inf)


def _reference(
    desc1: Tensor,
    desc2: Tensor,
    mask1: Tensor | None,
    mask2: Tensor | None,
    positions1: Tensor | None,
    positions2: Tensor | None,
    distance: float,
    both: bool,
) -> tuple[Tensor, ...]:
    batch = max(len(desc1), len(desc2)) if len(desc1) and len(desc2) else 0
    desc1, desc2 = (x.expand(batch, *x.shape[1:]) for x in (desc1, desc2))
    with torch.no_grad():
        distances = torch.cdist(desc1.detach(), desc2.detach(), compute_mode="donot_use_mm_for_euclid_dist")
        if mask1 is not None:
            distances = torch.where(mask1[:, :, None], distances, math.inf)
        if mask2 is not None:
            distances = torch.where(mask2[:, None, :], distances, math.inf)
        if positions1 is not None and positions2 is not None:
            x, y = (positions1[:, :, None] - positions2[:, None]).detach().unbind(-1)
            distances = torch.where(x * x + y * y < distance * distance, math.inf, distances)
        _, indices1 = _smallest_two(distances)
        _, indices2 = _smallest_two(distances.mT)
    if not both:
        indices2 = indices2[:, :0]
    backward = _distances_of_pairs(desc2, desc1, indices2) if both else desc2[..., :2][:, :0] * desc1.new_ones(2)
    return _distances_of_pairs(desc1, desc2, indices1), indices1, backward, indices2


def _reference_backward(
    grad1: Tensor, grad2: Tensor, desc1: Tensor, desc2: Tensor, indices1: Tensor, indices2: Tensor
) -> tuple[Tensor, Tensor]:
    batch = max(len(desc1), len(desc2)) if len(desc1) and len(desc2) else 0
    a, b = (x.expand(batch, *x.shape[1:]) for x in (desc1, desc2))

    def weighted(grad: Tensor, desc: Tensor, others: Tensor, indices: Tensor) -> tuple[Tensor, Tensor]:
        """The gradient of each pair to its descriptor, and the rows of the other one."""
        rows = torch.where(indices >= 0, indices, 0).flatten(1)[..., None].expand(-1, -1, others.shape[2])
        difference = desc[:, :, None] - others.gather(1, rows).unflatten(1, indices.shape[1:])
        squares = difference.square().sum(-1, keepdim=True)
        is_pair = (indices >= 0)[..., None] & (squares > 0)
        weights = torch.where(is_pair, grad[..., None] / torch.where(is_pair, squares, 1).sqrt(), 0)
        return weights * torch.where(is_pair, difference, 0), rows

    grad_a, grad_b = torch.zeros_like(a), torch.zeros_like(b)
    if indices1.numel() and b.shape[1]:
        pairs, rows = weighted(grad1, a, b, indices1)
        grad_a = grad_a + pairs.sum(2)
        grad_b = grad_b.scatter_add(1, rows, -pairs.flatten(1, 2))
    if indices2.numel() and a.shape[1]:
        pairs, rows = weighted(grad2, b, a, indices2)
        grad_b = grad_b + pairs.sum(2)
        grad_a = grad_a.scatter_add(1, rows, -pairs.flatten(1, 2))
    return grad_a, grad_b


def _fake(
    desc1: Tensor,
    desc2: Tensor,
    mask1: Tensor | None,
    mask2: Tensor | None,
    positions1: Tensor | None,
    positions2: Tensor | None,
    distance: float,
    both: bool,
) -> list[Any]:
    batch = desc2.shape[0] if desc1.shape[0] == 1 else desc1.shape[0]
    sizes = [(batch, desc1.shape[1], 2), (batch, desc2.shape[1] if both else 0, 2)]
    return [x for size in sizes for x in (desc1.new_empty(size), desc1.new_empty(size, dtype=torch.int64))]


def _fake_backward(grad1: Tensor, grad2: Tensor, desc1: Tensor, desc2: Tensor, *_: Tensor) -> list[Any]:
    return [(grad1.shape[0], *x.shape[1:]) for x in (desc1, desc2)]


def _backward(needs: Sequence[bool], *values: Any) -> list[Tensor | None]:
    # The gradients of the results, of which those of indices are None; the results; the arguments.
    (grad1, _, grad2, _), (distances1, indices1, distances2, indices2) = values[:4], values[4:8]
    desc1, desc2 = values[8:10]
    grad1 = torch.zeros_like(distances1) if grad1 is None else grad1
    grad2 = torch.zeros_like(distances2) if grad2 is None else grad2
    grads = _two_nearest_backward(grad1, grad2, desc1, desc2, indices1, indices2)
    return _summed(needs, grads, (desc1, desc2)) + [None] * 4


def _summed(needs: Sequence[bool], grads: Sequence[Tensor], inputs: Sequence[Tensor]) -> list[Tensor | None]:
    """The gradients that are needed; those to a batch of one are summed over the samples that it serves."""
    return [
        None if not need else g.sum(0, keepdim=True) if len(x) == 1 and len(g) != 1 else g
        for need, g, x in zip(needs, grads, inputs)
    ]


_two_nearest_backward = register("two_nearest_backward", _reference_backward, fake=_fake_backward, casts_outputs=True)
_two_nearest = register(
    "two_nearest",
    _reference,
    fake=_fake,
    backward=_backward,
    saves_results=True,
    non_differentiable=(1, 3),
    casts_outputs=True,
)

# --- the nearest one -------------------------------------------------------------------------------------------------


def _pairs(nearest: Tensor) -> Tensor:
    """Pairs (B, N, 2) of a descriptor's index and that of its nearest one, 0 where there is none."""
    own = torch.arange(nearest.shape[1], device=nearest.device).expand_as(nearest)
    return torch.stack([own, nearest.clamp(min=0)], 2)


def _pairs_reference(desc1: Tensor, desc2: Tensor) -> tuple[Tensor, Tensor]:
    distances, indices, _, _ = _reference(desc1, desc2, None, None, None, None, 0.0, False)
    return distances[..., :1], _pairs(indices[..., 0])


def _pairs_reference_backward(grad: Tensor, desc1: Tensor, desc2: Tensor, pairs: Tensor) -> tuple[Tensor, Tensor]:
    nearest = pairs[..., 1:]
    if desc2.shape[1]:  # the index of no neighbor is that of a descriptor at no finite distance
        others = desc2.expand(len(nearest), -1, -1).gather(1, nearest.expand(-1, -1, desc2.shape[2]))
        is_pair = (desc1 - others).square().sum(2, keepdim=True).isfinite()
        nearest = torch.where(is_pair, nearest, -1)
    return _reference_backward(grad, grad[:, :0], desc1, desc2, nearest, nearest[:, :0])


def _fake_pairs(desc1: Tensor, desc2: Tensor) -> list[Any]:
    batch = desc2.shape[0] if desc1.shape[0] == 1 else desc1.shape[0]
    sizes = (batch, desc1.shape[1])
    return [desc1.new_empty((*sizes, 1)), desc1.new_empty((*sizes, 2), dtype=torch.int64)]


register(
    "nearest_pairs_backward",
    _pairs_reference_backward,
    fake=lambda grad, desc1, desc2, _: [(grad.shape[0], *x.shape[1:]) for x in (desc1, desc2)],
    casts_outputs=True,
)
# From descriptors (B, N, D) and (B, M, D) to the distances (B, N, 1) of the nearest ones, and pairs (B, N, 2) of a descriptor's
# index and that of its nearest one, 0 where there is none.
_nearest_pairs = register(
    "nearest_pairs",
    _pairs_reference,
    fake=_fake_pairs,
    gradients="desc1, desc2: nearest_pairs_backward(indices=result1)",
    non_differentiable=(1,),
    casts_outputs=True,
)

# --- neighbors of both sets, or from a distance matrix --------------------------------------------------------------


class _Neighbors:
    """The two nearest of the other set for every descriptor: distances and indices (B, N, 2), and (B, M, 2) the way back.

    In float32 for half types, so that ratios are those of the descriptors and not of rounded distances.
    """

    def __init__(
        self,
        desc1: Tensor,
        desc2: Tensor,
        dm: Tensor | None = None,
        mask1: Tensor | None = None,
        mask2: Tensor | None = None,
        positions: tuple[Tensor, Tensor, float] | None = None,
        both: bool = True,
    ) -> None:
        self.dtype = floats(desc1 if dm is None else dm).dtype  # of the results
        self.both, self.count2 = both, desc2.shape[1]
        if dm is None:
            x, y = (as_dtype(floats(d), compute_dtype(desc1)) for d in (desc1, desc2))
            p, q, distance = positions if positions is not None else (None, None, 0.0)
            neighbors = _two_nearest(x, y, mask1, mask2, p, q, distance, both)
        else:
            d = as_dtype(floats(dm), compute_dtype(dm))
            if mask1 is not None and mask2 is not None:
                d = torch.where(mask1[:, :, None] & mask2[:, None, :], d, math.inf)
            if positions is not None:
                p, q, distance = positions
                offsets = p[:, :, None] - q[:, None]
                d = torch.where(offsets.square().sum(-1) < distance * distance, math.inf, d)
            neighbors = (*_smallest_two(d), *(_smallest_two(d.mT) if both else (d[:, :0, :2], d[:, :0, :2].long())))
        self.distances1, self.indices1, self.distances2, self.indices2 = neighbors


def _ratio(distances: Tensor, indices: Tensor) -> Tensor:
    """The nearest distance over the second nearest; NaN, which passes no test, with fewer than two neighbors."""
    return torch.where(indices[..., 1] >= 0, distances[..., 0] / distances[..., 1], math.nan)


def _at(x: Tensor, indices: Tensor) -> Tensor:
    """The entries of x (B, M) at indices (B, N). Entries at -1 are not defined."""
    return x.gather(1, indices.clamp(min=0))


def _is_mutual(nearest: Tensor, nearest_back: Tensor) -> Tensor:
    """Whether the nearest neighbor of the nearest neighbor is the descriptor itself: (B, N)."""
    own = torch.arange(nearest.shape[1], device=nearest.device)
    return (nearest >= 0) & (_at(nearest_back, nearest) == own)


# --- the list of matches --------------------------------------------------------------------------------------------


def _select_reference(
    distances1: Tensor,
    indices1: Tensor,
    distances2: Tensor | None,
    indices2: Tensor | None,
    count2: int,
    ratios: bool,
    threshold: float,
) -> tuple[Tensor, Tensor, Tensor]:
    nearest, scores = indices1[..., 0], distances1[..., 0]
    kept = (nearest >= 0) & (nearest < count2)
    if ratios:
        scores = _ratio(distances1, indices1)
        if distances2 is not None and indices2 is not None and count2:
            scores = torch.maximum(scores, _at(_ratio(distances2, indices2), nearest))
        kept = kept & (scores <= threshold)
    if indices2 is not None and count2:
        kept = kept & _is_mutual(nearest, indices2[..., 0])
    own = (~kept).to(torch.uint8).sort(dim=1, stable=True)[1]
    is_match = kept.gather(1, own)
    pairs = torch.stack([own, nearest.gather(1, own)], 2)
    return torch.where(is_match, scores.gather(1, own), 0), torch.where(is_match[..., None], pairs, -1), kept.sum(1)


def _fake_selection(distances1: Tensor, indices1: Tensor, *_: Any) -> list[Tensor]:
    return [torch.empty_like(distances1[..., 0]), torch.empty_like(indices1), indices1.new_empty(len(indices1))]


def _select_reference_backward(
    grad: Tensor, indices: Tensor, distances1: Tensor, distances2: Tensor | None, count2: int, ratios: bool
) -> tuple[Tensor, Tensor]:
    own, nearest = indices.clamp(min=0).unbind(2)
    grad = torch.where(indices[..., 0] >= 0, grad, 0)
    empty = distances1[:, :0] if distances2 is None else torch.zeros_like(distances2)
    if not ratios or count2 == 0:
        return torch.zeros_like(distances1).scatter_add(1, own[..., None], grad[..., None]), empty

    def through_ratio(distances: Tensor, at: Tensor, grad: Tensor) -> Tensor:
        pair = at[..., None].expand(-1, -1, 2)
        first, second = torch.where(indices >= 0, distances.gather(1, pair), 1).unbind(2)
        grads = torch.stack([grad / second, -grad * first / (second * second)], 2)
        return torch.zeros_like(distances).scatter_add(1, pair, grads)

    if distances2 is None:
        return through_ratio(distances1, own, grad), empty
    one, other = (
        _at(distances1[..., 0] / distances1[..., 1], own),
        _at(distances2[..., 0] / distances2[..., 1], nearest),
    )
    weight = torch.where(one > other, 1.0, torch.where(one < other, 0.0, 0.5)).to(grad.dtype)
    return through_ratio(distances1, own, grad * weight), through_ratio(distances2, nearest, grad * (1 - weight))


def _fake_selection_backward(
    grad: Tensor, indices: Tensor, distances1: Tensor, distances2: Tensor | None, count2: int, ratios: bool
) -> list[Any]:
    return [distances1.shape, (len(grad), 0 if distances2 is None else count2, 2)]


register("select_matches_backward", _select_reference_backward, fake=_fake_selection_backward, casts_outputs=True)
# From the neighbors (B, N, 2) of the first set and, if matches are mutual, those of the second set, which has count2
# descriptors, to the matches of each sample: scores (B, N), indices (B, N, 2), and the count of matches (B,).
_select = register(
    "select_matches",
    _select_reference,
    fake=_fake_selection,
    gradients="distances1, distances2: select_matches_backward(indices=result1)",
    non_differentiable=(1, 2),
    casts_outputs=True,
)


def _padded_matches(neighbors: _Neighbors, th: float | None) -> tuple[Tensor, Tensor, Tensor]:
    """The matches of each sample: scores (B, N) and indices (B, N, 2) in N slots, and the count of filled slots (B,).

    Matches are mutual if `neighbors` has those of both sets. With `th` scores are ratios of distances, and at most `th`;
    without it they are distances.
    """
    second_set = (neighbors.distances2, neighbors.indices2) if neighbors.both else (None, None)
    options = (neighbors.count2, th is not None, math.inf if th is None else float(th))
    return _select(neighbors.distances1, neighbors.indices1, *second_set, *options)


def _matches(neighbors: _Neighbors, th: float | None = None) -> tuple[Tensor, Tensor]:
    """The list of matches of a single sample: scores (K, 1) and indices (K, 2).

    The number of matches depends on the values, so the host waits for a GPU.
    """
    scores, indices, sizes = _padded_matches(neighbors, th)
    # In a graph the size of the list must come from an operator such as nonzero, not from a Python int.
    kept = (indices[0, :, 0] >= 0).nonzero()[:, 0] if is_compiling() or is_tracing() else slice(int(sizes))
    return as_dtype(scores.view(-1, 1)[kept], neighbors.dtype), indices.squeeze(0)[kept]


def _matches_of_batch(neighbors: _Neighbors, th: float) -> tuple[Tensor, Tensor]:
    """The list of matches of all samples: scores (K, 1) and indices (K, 3), the sample first."""
    scores, indices, _ = _padded_matches(neighbors, th)
    sample, slot = (indices[..., 0] >= 0).nonzero().unbind(1)
    pairs = torch.cat([sample[:, None], indices[sample, slot]], 1)
    return as_dtype(scores[sample, slot, None], neighbors.dtype), pairs


def _no_matches(*sources: Tensor | None, columns: int = 2) -> tuple[Tensor, Tensor]:
    """No scores, of the type of the first source and with gradients of 0 to all, and no indices."""
    none = [floats(x).flatten()[:0] for x in sources if x is not None]
    scores = torch.cat([x.to(none[0].dtype) for x in none]).reshape(0, 1)
    return scores, torch.zeros(0, columns, dtype=torch.int64, device=scores.device)


def _check_descriptors(op: str, desc1: Any, desc2: Any, dm: Any, *batch: str) -> None:
    _check.shape(op, "desc1", desc1, *batch, "N", "D")
    _check.shape(op, "desc2", desc2, *batch, "M", "D")
    if desc1.shape[-1] != desc2.shape[-1] or desc1.shape[: len(batch)] != desc2.shape[: len(batch)]:
        raise ShapeError(
            f"{op}: expected descriptors of one {'batch and ' if batch else ''}width, got {tuple(desc1.shape)} and "
            f"{tuple(desc2.shape)}",
            actual_shape=desc2.shape,
        )
    if desc1.dtype != desc2.dtype:
        raise TypeCheckError(f"{op}: expected descriptors of one type, got {desc1.dtype} and {desc2.dtype}")
    _check.same_device(op, desc1=desc1, desc2=desc2)
    if dm is not None:
        _check.shape(op, "dm", dm, *desc1.shape[:-1], desc2.shape[-2])
        _check.same_device(op, desc1=desc1, dm=dm)


def _one(x: Tensor | None) -> Tensor | None:
    return None if x is None else x[None]


# --- functions ------------------------------------------------------------------------------------------------------


def match_nn(desc1: Tensor, desc2: Tensor, dm: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Match every descriptor with its nearest one of the other set, by Euclidean distance.

    Descriptors are (N, D) and (M, D). Neighbors are found without storing the N x M distances. Half types are computed in
    float32. The gradient goes to both sets through the distances, not through the choice of neighbors. A descriptor with
    NaN is no neighbor; its own distance is inf, with index 0.

    Args:
        desc1: descriptors (N, D) of the first image.
        desc2: descriptors (M, D) of the second image.
        dm: distances (N, M) to choose from instead; smaller is better.

    Returns:
        The distances (N, 1), and the int64 indices (N, 2) in desc1 and desc2. Both are empty if either set is.

    Raises:
        TypeCheckError: descriptors that are not tensors, or of two types.
        ShapeError: descriptors that are not (N, D), or of two widths; dm that is not (N, M).
        DeviceError: tensors on several devices.

    Example:
        >>> import torch, kvision as K
        >>> distances, indices = K.feature.match_nn(torch.tensor([[0.0, 1.0]]), torch.tensor([[3.0, 1.0], [0.0, 3.0]]))
        >>> distances.tolist(), indices.tolist()
        ([[2.0]], [[0, 1]])
    """
    _check_descriptors("match_nn", desc1, desc2, dm)
    if 0 in (desc1.shape[0], desc2.shape[0]):
        return _no_matches(desc1, desc2, dm)
    if dm is None:
        dtype, result = compute_dtype(desc1), floats(desc1).dtype
        distances, pairs = _nearest_pairs(*(as_dtype(d, dtype).unsqueeze(0) for d in (desc1, desc2)))
        return as_dtype(distances.squeeze(0), result), pairs.squeeze(0)
    neighbors = _Neighbors(desc1[None], desc2[None], dm[None], both=False)
    return as_dtype(neighbors.distances1[0, :, :1], neighbors.dtype), _pairs(neighbors.indices1[..., 0])[0]


def match_mnn(desc1: Tensor, desc2: Tensor, dm: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Match descriptors that are each other's nearest ones, by Euclidean distance.

    Args:
        desc1: descriptors (N, D) of the first image.
        desc2: descriptors (M, D) of the second image.
        dm: distances (N, M) to choose from instead; smaller is better.

    Returns:
        The distances (K, 1), and the int64 indices (K, 2) in desc1 and desc2, ordered by those of the smaller set. Their
        number depends on the values, so a GPU is waited for.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as in `match_nn`.

    Example:
        >>> import torch, kvision as K
        >>> a, b = torch.tensor([[0.0], [1.0], [1.5]]), torch.tensor([[1.4], [0.1]])
        >>> K.feature.match_mnn(a, b)[1].tolist()
        [[2, 0], [0, 1]]
    """
    _check_descriptors("match_mnn", desc1, desc2, dm)
    if 0 in (desc1.shape[0], desc2.shape[0]):
        return _no_matches(desc1, desc2, dm)
    if desc1.shape[0] <= desc2.shape[0]:
        return _matches(_Neighbors(desc1[None], desc2[None], _one(dm)))
    distances, indices = _matches(_Neighbors(desc2[None], desc1[None], None if dm is None else dm.mT[None]))
    return distances, indices.flip(1)


def match_snn(desc1: Tensor, desc2: Tensor, th: float = 0.8, dm: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Match descriptors with their nearest ones where these are clearly nearer than the second nearest: Lowe's ratio test.

    A match has a ratio d1 / d2 of at most `th`. Where both distances are 0 there is none.

    Args:
        desc1: descriptors (N, D) of the first image.
        desc2: descriptors (M, D) of the second image. Fewer than two give no match.
        th: the largest ratio.
        dm: distances (N, M) to choose from instead, at least 0.

    Returns:
        The ratios (K, 1), and the int64 indices (K, 2) in desc1 and desc2, ordered by the first.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as in `match_nn`.

    Example:
        >>> import torch, kvision as K
        >>> ratios, indices = K.feature.match_snn(torch.tensor([[0.0], [5.0]]), torch.tensor([[1.0], [4.0]]), 0.5)
        >>> ratios.tolist(), indices.tolist()
        ([[0.25], [0.25]], [[0, 0], [1, 1]])
    """
    _check_descriptors("match_snn", desc1, desc2, dm)
    th = _check.number("match_snn", "th", th)
    if desc1.shape[0] == 0 or desc2.shape[0] < 2:
        return _no_matches(dm, desc1, desc2)
    return _matches(_Neighbors(desc1[None], desc2[None], _one(dm), both=False), th)


def match_smnn(desc1: Tensor, desc2: Tensor, th: float = 0.95, dm: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Match descriptors that are each other's nearest ones and pass the ratio test in both directions.

    Args:
        desc1: descriptors (N, D) of the first image. Fewer than two in either set give no match.
        desc2: descriptors (M, D) of the second image.
        th: the largest ratio of the nearest distance to the second.
        dm: distances (N, M) to choose from instead, at least 0.

    Returns:
        The larger one of both ratios (K, 1), and the int64 indices (K, 2) in desc1 and desc2, ordered by the first.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as in `match_nn`.

    Example:
        >>> import torch, kvision as K
        >>> ratios, indices = K.feature.match_smnn(torch.tensor([[0.0], [5.0]]), torch.tensor([[1.0], [4.0]]))
        >>> ratios.tolist(), indices.tolist()
        ([[0.25], [0.25]], [[0, 0], [1, 1]])
    """
    _check_descriptors("match_smnn", desc1, desc2, dm)
    th = _check.number("match_smnn", "th", th)
    if desc1.shape[0] < 2 or desc2.shape[0] < 2:
        return _no_matches(dm, desc1, desc2)
    return _matches(_Neighbors(desc1[None], desc2[None], _one(dm)), th)


def match_smnn_batched(
    desc1: Tensor,
    desc2: Tensor,
    th: float = 0.95,
    dm: Tensor | None = None,
    mask1: Tensor | None = None,
    mask2: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Match the descriptors of every sample of a batch as `match_smnn` does, all samples at once.

    Args:
        desc1: descriptors (B, N, D) of the first images.
        desc2: descriptors (B, M, D) of the second images.
        th: the largest ratio of the nearest distance to the second.
        dm: distances (B, N, M) to choose from instead, at least 0.
        mask1: bool (B, N), True for the descriptors to use; default: all.
        mask2: bool (B, M), the same of the second images.

    Returns:
        The larger one of both ratios (K, 1), and the int64 indices (K, 3): sample, in desc1, in desc2.

    Raises:
        TypeCheckError: descriptors that are not tensors, or of two types; masks that are not bool.
        ShapeError: descriptors that are not (B, N, D), or of two batches or widths; masks or dm of another shape.
        DeviceError: tensors on several devices.

    Example:
        >>> import torch, kvision as K
        >>> a, b = torch.tensor([[[0.0], [5.0]]]), torch.tensor([[[1.0], [4.0], [5.0]]])
        >>> mask = torch.tensor([[True, True, False]])
        >>> K.feature.match_smnn_batched(a, b, mask2=mask)[1].tolist()
        [[0, 0, 0], [0, 1, 1]]
    """
    op = "match_smnn_batched"
    _check_descriptors(op, desc1, desc2, dm, "B")
    th = _check.number(op, "th", th)
    for name, mask, desc in (("mask1", mask1, desc1), ("mask2", mask2, desc2)):
        if mask is not None:
            _check.shape(op, name, mask, *desc.shape[:2])
            if mask.dtype != torch.bool:
                raise TypeCheckError(f"{op}: expected {name} to be bool, got {mask.dtype}", actual_type=mask.dtype)
            _check.same_device(op, desc1=desc, mask=mask)
    if desc1.shape[0] == 0 or desc1.shape[1] < 2 or desc2.shape[1] < 2:
        return _no_matches(dm, desc1, desc2, columns=3)
    if dm is not None:
        mask1 = desc1.new_ones(desc1.shape[:2], dtype=torch.bool) if mask1 is None else mask1
        mask2 = desc2.new_ones(desc2.shape[:2], dtype=torch.bool) if mask2 is None else mask2
    return _matches_of_batch(_Neighbors(desc1, desc2, dm, mask1, mask2), th)


def match_fginn(
    desc1: Tensor,
    desc2: Tensor,
    lafs1: Tensor,
    lafs2: Tensor,
    th: float = 0.8,
    spatial_th: float = 10.0,
    mutual: bool = False,
    dm: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Match descriptors by a ratio test whose second neighbor is elsewhere in the image: first geometrically inconsistent.

    Where several features at one position have similar descriptors, the second nearest one is no wrong match, and the test of
    `match_snn` fails. Here the second neighbor is the nearest one whose center is at least `spatial_th` pixels from the
    center of the nearest. If there is none, the ratio is 0.

    Args:
        desc1: descriptors (N, D) of the first image.
        desc2: descriptors (M, D) of the second image. Fewer than two give no match.
        lafs1: local affine frames (1, N, 2, 3) of the first image; only their shape is read.
        lafs2: local affine frames (1, M, 2, 3) of the second image.
        th: the largest ratio.
        spatial_th: distance in pixels.
        mutual: whether matches have to be nearest ones in both directions.
        dm: distances (N, M) to choose from instead, at least 0.

    Returns:
        The ratios (K, 1), and the int64 indices (K, 2) in desc1 and desc2, ordered by the first.

    Raises:
        TypeCheckError, ShapeError, DeviceError: as in `match_nn`; frames of another shape.

    Source: D. Mishkin, J. Matas, M. Perdoch, "MODS: Fast and robust method for two-view matching" (2015).

    Example:
        >>> import torch, kvision as K
        >>> lafs = torch.zeros(1, 3, 2, 3)
        >>> lafs[0, :, 0, 2] = torch.tensor([0.0, 1.0, 90.0])
        >>> K.feature.match_fginn(torch.tensor([[0.0]]), torch.tensor([[1.0], [1.1], [4.0]]), lafs[:, :1], lafs)
        (tensor([[0.2500]]), tensor([[0, 0]]))
    """
    op = "match_fginn"
    _check_descriptors(op, desc1, desc2, dm)
    _check.shape(op, "lafs1", lafs1, 1, desc1.shape[0], 2, 3)
    _check.shape(op, "lafs2", lafs2, 1, desc2.shape[0], 2, 3)
    _check.same_device(op, desc1=desc1, lafs1=lafs1, lafs2=lafs2)
    th = _check.number(op, "th", th)
    spatial_th = _check.number(op, "spatial_th", spatial_th, 0.0)
    _check.flag(op, "mutual", mutual)
    if desc1.shape[0] == 0 or desc2.shape[0] < 2:
        return _no_matches(dm, desc1, desc2)
    x, y = desc1[None], desc2[None]
    neighbors = _Neighbors(x, y, _one(dm), both=mutual)
    nearest = neighbors.indices1[..., :1]
    centers = as_dtype(floats(lafs2[..., 2]), neighbors.distances1.dtype)
    if desc1.is_cuda and desc1.shape[0] <= _ALL_AT_ONCE:
        first = centers.index_select(1, nearest.flatten().clamp(min=0))
        others = _second_elsewhere(x, y, _one(dm), first, centers, spatial_th)
    else:  # only those whose second neighbor is near the first one look for another
        of_two = centers[0].index_select(0, neighbors.indices1.clamp(min=0).flatten())
        first, second = of_two.unflatten(0, (-1, 2)).unbind(1)
        again = ((first - second).square().sum(-1) < spatial_th * spatial_th).nonzero()[:, 0]
        rows = None if dm is None else dm.index_select(0, again)[None]
        of_first = first.index_select(0, again)[None]
        others = _second_elsewhere(x.index_select(1, again), y, rows, of_first, centers, spatial_th)
        others = neighbors.distances1[..., 1:].index_copy(1, again, others)
    # The list of matches by these ratios. An index of -1 in the second column would say that there is no ratio.
    neighbors.distances1 = torch.cat([neighbors.distances1[..., :1], others], 2)
    neighbors.indices1 = nearest.expand(-1, -1, 2)
    if mutual:  # without a ratio test on the way back: its ratios are 0 / 1
        zero_and_one = torch.arange(2.0, dtype=centers.dtype, device=centers.device)
        neighbors.distances2 = zero_and_one.expand_as(neighbors.distances2)
        neighbors.indices2 = neighbors.indices2[..., :1].expand(-1, -1, 2)
    return _matches(neighbors, th)


# So few descriptors are all searched again on a GPU: the host would have to wait for the number of those that need it. The limit
# was not measured.
_ALL_AT_ONCE = 1024


def _second_elsewhere(
    desc1: Tensor, desc2: Tensor, dm: Tensor | None, first: Tensor, centers: Tensor, spatial_th: float
) -> Tensor:
    """The distances (1, N, 1) to the nearest descriptors that are `spatial_th` or more from the centers `first` (1, N, 2)."""
    return _Neighbors(desc1, desc2, dm, positions=(first, centers, spatial_th), both=False).distances1[..., :1]


# --- modules --------------------------------------------------------------------------------------------------------


def _mode(op: str, match_mode: Any, modes: Sequence[str]) -> str:
    mode = match_mode.lower() if isinstance(match_mode, str) else match_mode
    _check.choice(op, "match_mode", mode, modes, _check.UnknownChoiceError)
    return mode


class DescriptorMatcher(nn.Module):
    """Match descriptors by one of the functions that need no positions.

    Args:
        match_mode: 'nn', 'mnn', 'snn' or 'smnn', for the function `match_<mode>`.
        th: the largest ratio of 'snn' and 'smnn'.

    Its call takes descriptors (N, D) and (M, D) and returns what the function does.

    Raises:
        ValueCheckError: another mode, which is a NotImplementedError, too.

    Example:
        >>> import torch, kvision as K
        >>> matcher = K.feature.DescriptorMatcher("mnn")
        >>> matcher(torch.tensor([[0.0], [5.0]]), torch.tensor([[4.0], [1.0]]))[1].tolist()
        [[0, 1], [1, 0]]
    """

    known_modes = get_args(MatchMode)

    def __init__(self, match_mode: MatchMode = "snn", th: float = 0.8) -> None:
        super().__init__()
        self.match_mode = _mode("DescriptorMatcher", match_mode, self.known_modes)
        self.th = _check.number("DescriptorMatcher", "th", th)

    def extra_repr(self) -> str:
        return f"match_mode={self.match_mode!r}, th={self.th}"

    def forward(self, desc1: Tensor, desc2: Tensor) -> tuple[Tensor, Tensor]:
        if self.match_mode == "nn":
            return match_nn(desc1, desc2)
        if self.match_mode == "mnn":
            return match_mnn(desc1, desc2)
        return (match_snn if self.match_mode == "snn" else match_smnn)(desc1, desc2, self.th)
