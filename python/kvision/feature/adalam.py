"""AdaLAM: matches that agree with an affine map of their neighborhood."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import TypeCheckError, ValueCheckError
from kvision.feature.laf import get_laf_orientation, get_laf_scale
from kvision.feature.matching import _check_descriptors, _mode, _Neighbors, _no_matches, _one, _ratio, match_fginn

MatchMode: TypeAlias = Literal["fginn", "adalam"]
DEFAULTS: dict[str, Any] = {
    **{"area_ratio": 100, "search_expansion": 4, "ransac_iters": 128, "min_inliers": 6, "min_confidence": 200},
    **{"orientation_difference_threshold": 30, "scale_rate_threshold": 1.5, "detected_scale_rate_threshold": 5},
    **{"refit": True, "force_seed_mnn": True, "device": None},
}
LARGEST_SEED_RATIO = 0.8  # of the nearest distance to the second, for seeds
LARGEST_FALLBACK_RATIO = math.sqrt(0.95)  # where nothing can be verified
# The least squared residual, as a part of the neighborhood's: an exact fit has a finite confidence.
MIN_RESIDUAL = 2.0**-24
NUMBERS_AT_ONCE = 1 << 23  # of distances between key points and of residuals


class _Putative:
    """Matches to verify, of key points in pixels: a row each, so that one operator selects some of them."""

    def __init__(self, table: Tensor) -> None:
        self.table = table  # (N, 8) in float64
        self.xy1, self.xy2 = table[:, :2], table[:, 2:4]
        # Degrees from the frame in the first image to that in the second; logarithm of the ratio of their scales; ratio of
        # the two nearest distances; 1 for mutual nearest neighbors, else 0.
        self.rotation, self.growth, self.ratio, self.is_mutual = table[:, 4:].unbind(1)

    def take(self, rows: Tensor) -> _Putative:
        return _Putative(self.table.index_select(0, rows))


def match_adalam(
    desc1: Tensor,
    desc2: Tensor,
    lafs1: Tensor,
    lafs2: Tensor,
    config: Mapping[str, Any] | None = None,
    hw1: Sequence[int] | None = None,
    hw2: Sequence[int] | None = None,
    dm: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Match descriptors by their nearest ones, and keep the matches that agree with their neighborhood: AdaLAM.

    Distinctive matches that are far from each other are seeds. The matches around a seed are kept if they follow an
    affine map around it, found by random samples of two, much more closely than chance would have it. All seeds and all
    samples are processed at once. The samples are the same every call.

    The keys of `config`:

    - "area_ratio" (100): area of the image over that of a seed's neighborhood.
    - "search_expansion" (4): matches are verified within this many radii of the neighborhood.
    - "ransac_iters" (128): samples for each seed.
    - "min_inliers" (6): matches that a seed needs, itself included.
    - "min_confidence" (200): how many times more matches have to be within their residual than chance would place there.
    - "orientation_difference_threshold" (30): degrees by which a match's change of orientation may differ from its
      seed's; None for any.
    - "scale_rate_threshold" (1.5): factor by which its change of scale may; None for any.
    - "detected_scale_rate_threshold" (5): largest change of scale of a match; None for any.
    - "refit" (True): whether the map is fitted to its inliers again.
    - "force_seed_mnn" (True): whether only mutual nearest neighbors are seeds.

    Args:
        desc1: descriptors (N, D) of the first image.
        desc2: descriptors (M, D) of the second image. Fewer than two in either set give no match.
        lafs1: local affine frames (1, N, 2, 3) of the first image.
        lafs2: local affine frames (1, M, 2, 3) of the second image.
        config: values for some of the keys above; a warning for each other key names the nearest.
        hw1: (height, width) of the first image; default: the extent of its frames.
        hw2: the same of the second image.
        dm: distances (N, M) to choose from instead, at least 0.

    Returns:
        The inverse confidences (K, 1) in float32, at most 1 / min_confidence, and the int64 indices (K, 2) in desc1 and
        desc2, ordered by the first. Where no seed has enough neighbors to be verified, these are the matches with a ratio
        of squared distances of at most .95, and that ratio. Both without gradient.

    Raises:
        TypeCheckError: descriptors that are not tensors, or of two types; a config that is not a dict.
        ShapeError: descriptors that are not (N, D), or of two widths; frames or dm of another shape.
        ValueCheckError: a number in config that is not positive.
        DeviceError: tensors on several devices.

    Source: L. Cavalli et al., "AdaLAM: Revisiting handcrafted outlier detection" (2020).

    Example:
        >>> import torch, kvision as K
        >>> x, lafs = torch.rand(50, 32), torch.eye(2, 3).repeat(1, 50, 1, 1)
        >>> lafs[..., 2] = 100 * torch.rand(1, 50, 2)
        >>> scores, indices = K.feature.match_adalam(x, x, lafs, lafs, {"area_ratio": 2})
        >>> torch.equal(indices[:, 0], indices[:, 1]), bool((scores <= 1 / 200).all())
        (True, True)
    """
    op = "match_adalam"
    _check_descriptors(op, desc1, desc2, dm)
    _check.shape(op, "lafs1", lafs1, 1, desc1.shape[0], 2, 3)
    _check.shape(op, "lafs2", lafs2, 1, desc2.shape[0], 2, 3)
    _check.same_device(op, desc1=desc1, lafs1=lafs1, lafs2=lafs2)
    options = _checked_config(op, config)
    if desc1.shape[0] < 2 or desc2.shape[0] < 2:
        return _no_matches(desc1.new_empty(0, dtype=torch.float32))
    with torch.no_grad():
        neighbors = _Neighbors(desc1[None], desc2[None], _one(dm))
        nearest = neighbors.indices1[0, :, 0]
        ratio = _ratio(neighbors.distances1, neighbors.indices1)[0]
        at = nearest.clamp(min=0)  # rows without a neighbor are left out below
        frames1, frames2 = floats(lafs1).double(), floats(lafs2).double()
        frames = torch.cat([frames1, frames2.index_select(1, at)])
        rotation, growth = get_laf_orientation(frames)[..., 0], get_laf_scale(frames).log()[..., 0, 0]
        is_mutual = neighbors.indices2[0, :, 0].index_select(0, at) == torch.arange(len(at), device=at.device)
        distinctive = ratio.double().nan_to_num(nan=1.0)  # of two equal candidates, none is distinctive
        changes = [rotation[1] - rotation[0], growth[1] - growth[0], distinctive, is_mutual.double()]
        putative = torch.cat([*frames[..., 2], torch.stack(changes, 1)], 1)
        radii = _radii(op, options["area_ratio"], (hw1, hw2), (frames1, frames2))
        inverse = _verify(putative, nearest >= 0, radii, options)
        if inverse is None:
            kept = (ratio <= LARGEST_FALLBACK_RATIO).nonzero()[:, 0]
            scores = ratio[kept].square()
        else:
            kept = (inverse <= 1 / options["min_confidence"]).nonzero()[:, 0]
            scores = inverse[kept]
        return scores[:, None].float(), torch.stack([kept, nearest[kept]], 1)


def _checked_config(op: str, config: Mapping[str, Any] | None) -> dict[str, Any]:
    if config is not None and not isinstance(config, Mapping):
        raise TypeCheckError(f"{op}: expected config to be a dict, got {type(config).__name__}")
    for name in config or {}:
        if name not in DEFAULTS:
            nearest = _check.nearest_name(str(name), DEFAULTS)
            advice = f"; did you mean {nearest!r}?" if nearest else ""
            warnings.warn(f"{op}: config has no {name!r}{advice}", stacklevel=3)
    options = {**DEFAULTS, **{name: value for name, value in (config or {}).items() if name in DEFAULTS}}
    for name, default in DEFAULTS.items():
        value = options[name]
        if isinstance(default, bool):
            _check.flag(op, name, value)
        elif default is not None and not (value is None and name.endswith("threshold")):
            if not _check.number(op, name, value) > 0:
                raise ValueCheckError(f"{op}: expected {name} to be positive, got {value!r}", actual_value=value)
    return options


def _radii(
    op: str, area_ratio: float, sizes: Sequence[Sequence[int] | None], frames: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """The radii of neighborhoods in both images, whose area is that of an image, or of the box around its frames, over a ratio."""
    extents = []
    for name, hw, of_image in zip(("hw1", "hw2"), sizes, frames):
        if hw is not None:
            extents.append(of_image.new_tensor(_check.pair(op, name, tuple(hw))))
        else:
            x = of_image[0, :, :, 2]
            extents.append(x.amax(0) - x.amin(0))
    areas = torch.stack(extents).prod(1).clamp(min=1.0)
    radius1, radius2 = torch.sqrt(areas / (area_ratio * math.pi)).unbind(0)
    return radius1, radius2


def _near(x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
    return (x[:, None] - y[None]).square().sum(-1) <= radius * radius


def _find_seeds(x: _Putative, radius: Tensor, mutual: bool) -> Tensor:
    """Rows of the most distinctive matches within a radius in the first image; the first of equal ones."""
    is_candidate = x.ratio <= LARGEST_SEED_RATIO
    candidates = (is_candidate & (x.is_mutual > 0) if mutual else is_candidate).nonzero()[:, 0]
    if not len(candidates):
        return candidates
    xy, ratio = x.xy1[candidates], x.ratio[candidates]
    order = torch.arange(len(candidates), device=xy.device)
    parts = []
    for part in order.split(max(1, NUMBERS_AT_ONCE // max(1, len(order)))):
        r = ratio[part, None]
        is_better = (ratio < r) | ((ratio == r) & (order < part[:, None]))
        parts.append(~(is_better & _near(xy[part], xy, radius)).any(1))
    return candidates[torch.cat(parts)]


def _neighborhoods(
    x: _Putative, seeds: Tensor, radius1: Tensor, radius2: Tensor, options: Mapping[str, Any]
) -> tuple[Tensor, Tensor]:
    """Rows of the other matches around each seed that change orientation and scale as it does: (S, K), and which are."""
    lists = []
    for part in seeds.split(max(1, NUMBERS_AT_ONCE // max(1, len(x.ratio)))):
        seed = x.take(part)
        near = _near(seed.xy1, x.xy1, radius1) & _near(seed.xy2, x.xy2, radius2)
        if options["orientation_difference_threshold"] is not None:
            rotation = torch.remainder(seed.rotation[:, None] - x.rotation + 180, 360) - 180
            near &= rotation.abs() <= options["orientation_difference_threshold"]
        if options["scale_rate_threshold"] is not None:
            growth = seed.growth[:, None] - x.growth
            near &= growth.abs() <= math.log(options["scale_rate_threshold"])
        near[torch.arange(len(part), device=part.device), part] = False
        size = int(near.sum(1).max())
        lists.append(
            near.byte().sort(dim=1, descending=True, stable=True)[1][:, :size] if size else part[:, None][:, :0]
        )
        lists[-1] = torch.where(near.gather(1, lists[-1]), lists[-1], -1)
    size = max(rows.shape[1] for rows in lists)
    rows = torch.cat([torch.nn.functional.pad(r, (0, size - r.shape[1]), value=-1) for r in lists])
    return rows.clamp(min=0), rows >= 0


def _maps(x: Tensor, y: Tensor) -> Tensor:
    """The linear maps (..., 2, 2) that take two or more offsets x (..., n, 2) to y by least squares; NaN if none does."""
    cross, gram = y.mT @ x, x.mT @ x
    a, b, c = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    adjugate = torch.stack([c, -b, -b, a], -1).unflatten(-1, (2, 2))
    determinant = a * c - b * b
    is_regular = determinant > 1e-12 * a * c
    return cross @ adjugate / torch.where(is_regular, determinant, math.nan)[..., None, None]


def _residuals(maps: Tensor, x: Tensor, y: Tensor, valid: Tensor) -> Tensor:
    """Squared residuals (T, S, K) of offsets (S, K, 2) under maps (T, S, 2, 2); inf if there is none."""
    squares = (x @ maps.mT - y).square().sum(-1)
    return torch.where(valid & (squares == squares), squares, math.inf)


def _count_inliers(squares: Tensor, counts: Tensor, min_confidence: float) -> tuple[Tensor, Tensor, Tensor]:
    """How many of the smallest residuals are inliers, the largest squared residual among them, and its confidence.

    If matches were spread over the neighborhood, a part r^2 of them would have a residual below r. The confidence of the
    k-th smallest residual is k over that number.
    """
    ordered = squares.sort(-1)[0].clamp(min=MIN_RESIDUAL)
    rank = torch.arange(1, squares.shape[-1] + 1, device=squares.device, dtype=squares.dtype)
    confidence = rank / (counts[:, None] * ordered)
    is_confident = confidence >= min_confidence
    inliers = torch.where(is_confident, rank, 0).amax(-1)
    last = (inliers.long() - 1).clamp(min=0)[..., None]
    limit = torch.where(inliers > 0, ordered.gather(-1, last)[..., 0], -1.0)
    return inliers, limit, confidence.gather(-1, last)[..., 0]


def _verify(
    putative: Tensor, is_match: Tensor, radii: tuple[Tensor, Tensor], options: Mapping[str, Any]
) -> Tensor | None:
    """The inverse confidence of every match, inf for those of no seed; None if no seed could be verified."""
    x = _Putative(putative)
    if options["detected_scale_rate_threshold"] is not None:
        is_match = is_match & (x.growth.abs() <= math.log(options["detected_scale_rate_threshold"]))
    rows = is_match.nonzero()[:, 0]
    x = x.take(rows)
    radius1, radius2 = radii
    seeds = _find_seeds(x, radius1, options["force_seed_mnn"])
    if not len(seeds):
        return None
    expansion = options["search_expansion"]
    neighbors, valid = _neighborhoods(x, seeds, expansion * radius1, expansion * radius2, options)
    counts = valid.sum(1)
    enough = counts + 1 >= max(3, options["min_inliers"])
    if not bool(enough.any()):
        return None
    seeds, neighbors, valid, counts = seeds[enough], neighbors[enough], valid[enough], counts[enough]
    # Offsets from the seed, in radii of the neighborhoods: the map has no translation.
    offsets1 = (x.xy1[neighbors] - x.xy1[seeds, None]) / (expansion * radius1)
    offsets2 = (x.xy2[neighbors] - x.xy2[seeds, None]) / (expansion * radius2)
    offsets1, offsets2 = (torch.where(valid[..., None], offsets, 0) for offsets in (offsets1, offsets2))

    generator = torch.Generator(offsets1.device).manual_seed(0)
    iterations, size = int(options["ransac_iters"]), len(seeds)
    uniform = torch.rand(iterations, size, 2, generator=generator, device=offsets1.device, dtype=offsets1.dtype)
    first = (uniform[..., 0] * counts).long()
    second = (uniform[..., 1] * (counts - 1)).long()
    samples = torch.stack([first, second + (second >= first)], -1)  # two different neighbors each
    best, best_maps = offsets1.new_full((size,), -1.0), offsets1.new_zeros(size, 2, 2)
    per_part = max(1, NUMBERS_AT_ONCE // max(1, offsets1[..., 0].numel()))
    sets = torch.arange(size, device=offsets1.device)[:, None]
    for part in samples.split(per_part):
        maps = _maps(offsets1[sets, part], offsets2[sets, part])
        score, _, confidence = _count_inliers(
            _residuals(maps[:, :, None].flatten(1, 2), offsets1, offsets2, valid), counts, options["min_confidence"]
        )
        score = score + confidence / (1 + confidence)  # the more confident of equal numbers
        score, index = score.max(0)
        maps = maps[index, sets[:, 0]]
        is_better = score > best
        best = torch.where(is_better, score, best)
        best_maps = torch.where(is_better[:, None, None], maps, best_maps)
    squares = _residuals(best_maps[None], offsets1, offsets2, valid)
    inliers, limit, confidence = _count_inliers(squares, counts, options["min_confidence"])
    if options["refit"]:
        weights = (squares.clamp(min=MIN_RESIDUAL) <= limit[..., None]).to(offsets1.dtype)[0, ..., None]
        refitted = _residuals(_maps(weights * offsets1, weights * offsets2)[None], offsets1, offsets2, valid)
        of_refit = _count_inliers(refitted, counts, options["min_confidence"])
        is_better = of_refit[0] >= inliers
        squares = torch.where(is_better[..., None], refitted, squares)
        inliers, limit, confidence = (
            torch.where(is_better, new, old) for new, old in zip(of_refit, (inliers, limit, confidence))
        )
    is_accepted = inliers[0] + 1 >= options["min_inliers"]
    is_inlier = is_accepted[:, None] & (squares[0].clamp(min=MIN_RESIDUAL) <= limit[0, :, None]) & valid
    # A match has the confidence of its best seed; a seed is one of its own inliers.
    values = (1 / confidence[0])[:, None].expand_as(squares[0])
    values = torch.where(is_inlier, values, math.inf)
    own = torch.where(is_accepted, 1 / confidence[0], math.inf)
    targets, values = torch.cat([neighbors.flatten(), seeds]), torch.cat([values.flatten(), own])
    inverse = putative.new_full((len(putative),), math.inf)
    return inverse.scatter_reduce(0, rows[targets], values, "amin")


class GeometryAwareDescriptorMatcher(nn.Module):
    """Match descriptors by a function of descriptors and local affine frames.

    Args:
        match_mode: 'fginn' or 'adalam', for the function `match_<mode>`.
        params: for 'fginn' its arguments `th` (default here .85), `spatial_th` and `mutual`; for 'adalam' its config.

    Its call takes descriptors (N, D) and (M, D) with their local affine frames (1, N, 2, 3) and (1, M, 2, 3), and returns
    what the function does.

    Raises:
        ValueCheckError: another mode, which is a NotImplementedError, too.

    Example:
        >>> import torch, kvision as K
        >>> matcher = K.feature.GeometryAwareDescriptorMatcher("fginn", {"spatial_th": 5.0})
        >>> x, lafs = torch.eye(3), torch.zeros(1, 3, 2, 3)
        >>> lafs[0, :, 0, 2] = torch.arange(3) * 10.0
        >>> matcher(x, x, lafs, lafs)[1].tolist()
        [[0, 0], [1, 1], [2, 2]]
    """

    known_modes = get_args(MatchMode)

    def __init__(self, match_mode: MatchMode = "fginn", params: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.match_mode = _mode("GeometryAwareDescriptorMatcher", match_mode, self.known_modes)
        if not isinstance(params, dict) and params is not None:
            raise TypeCheckError(f"GeometryAwareDescriptorMatcher: expected params to be a dictionary, got {params!r}")
        self.params = dict(params or {})

    def extra_repr(self) -> str:
        return f"match_mode={self.match_mode!r}, params={self.params}"

    def forward(self, desc1: Tensor, desc2: Tensor, lafs1: Tensor, lafs2: Tensor) -> tuple[Tensor, Tensor]:
        if self.match_mode == "adalam":
            return match_adalam(desc1, desc2, lafs1, lafs2, config=self.params)
        known = {name: self.params[name] for name in ("spatial_th", "mutual") if name in self.params}
        return match_fginn(desc1, desc2, lafs1, lafs2, self.params.get("th", 0.85), **known)
