"""Key points and descriptors as cv2.SIFT finds them, on batches, on any device, with gradients."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision.feature import _detection as detection
from kvision.feature.laf import get_laf_center, get_laf_orientation, get_laf_scale, laf_from_center_scale_ori
from kvision.feature.scale_space_peaks import is_off_edges, scale_space_peaks
from kvision.filters import gaussian_blur2d
from kvision.geometry.subpix.quad_interp3d import ANYWHERE
from kvision.geometry.transform.resize import resize

# The defaults of cv2.SIFT_create, and its constants.
_LEVELS, _SIGMA, _CONTRAST, _EDGE_RATIO = 3, 1.6, 0.04, 10.0
_BORDER = 5  # pixels of an octave without key points
_FITS, _LARGEST_SHIFT = 5, 0.5
_BINS, _PEAKS, _SHARE = 36, 4, 0.8  # of the histogram of directions; OpenCV has no limit to the number of its peaks
_CELLS, _ANGLES, _CLIP, _UNIT = 4, 8, 0.2, 512.0  # of descriptors, whose length is about _UNIT
_OF_FRAME = 6.0  # scale of a frame over the blur of its level: the side of the 4 x 4 cells is twice that
_SAMPLES = 2**18  # that are held at a time


class _Octaves:
    """Levels (B, n_levels + 3, H, W) of octaves, of which the first has twice the size of the image."""

    def __init__(self, image: Tensor) -> None:
        h, w = image.shape[2:]
        first = resize(image, (2 * h, 2 * w), "bilinear", align_corners=False)
        level = _blurred(first, math.sqrt(max(_SIGMA**2 - 4 * 0.5**2, 0.01)))
        count = round(math.log2(min(2 * h, 2 * w)) - 2) + 1
        self.levels: list[Tensor] = []
        while len(self.levels) < count and min(level.shape[2:]) > 2 * _BORDER:
            levels = [level]
            for i in range(1, _LEVELS + 3):
                before = _SIGMA * 2 ** ((i - 1) / _LEVELS)
                levels.append(_blurred(levels[-1], before * math.sqrt(2 ** (2 / _LEVELS) - 1)))
            self.levels.append(torch.cat(levels, 1))
            h, w = (side // 2 for side in level.shape[2:])
            level = levels[_LEVELS][..., : 2 * h : 2, : 2 * w : 2]

    def flat(self) -> Tensor:
        """All levels of all octaves one after the other, (B, P)."""
        return torch.cat([x.flatten(1) for x in self.levels], 1)


def _blurred(image: Tensor, sigma: float) -> Tensor:
    size = [min(round(8 * sigma + 1) | 1, (side - 1) // 2 * 2 + 1) for side in image.shape[2:]]
    return gaussian_blur2d(image, (size[0], size[1]), (sigma, sigma), "reflect")


class _KeyPoints:
    """Key points (B, N) in the pixels of their octaves, and where these are in the flat pyramid.

    `x`, `y` and `sigma` are refined; `column`, `row` and `start`, the first pixel of the level, are integers.
    """

    def __init__(self, fields: dict[str, Tensor]) -> None:
        self.fields = fields

    def __getattr__(self, name: str) -> Tensor:
        return self.fields[name]

    def take(self, index: Tensor) -> _KeyPoints:
        return _KeyPoints({name: x.gather(1, index) for name, x in self.fields.items()})

    def part(self, begin: int, end: int) -> _KeyPoints:
        return _KeyPoints({name: x[:, begin:end] for name, x in self.fields.items()})

    def pixels(self, flat: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        """The pixels (B, N, S) of the key points' levels; indices out of bounds are clamped."""
        width, height = self.width[..., None], self.height[..., None]
        rows, columns = rows.clamp(min=0).minimum(height - 1), columns.clamp(min=0).minimum(width - 1)
        index = self.start[..., None] + rows * width + columns
        return flat.gather(1, index.flatten(1)).view(index.shape)


def _find(octaves: _Octaves, count: int, threshold: float, mask: Tensor | None) -> _KeyPoints:
    """Extrema of differences of Gaussians, the `count` of the largest contrast, strongest first."""
    parts: list[dict[str, Tensor]] = []
    start = 0
    for number, levels in enumerate(octaves.levels):
        batch, depth, height, width = levels.shape
        nowhere = torch.zeros(batch, dtype=levels.dtype, device=levels.device)
        weights = None
        if mask is not None:
            weights = as_dtype(detection.resized_mask(mask, (height, width))[:, 0], levels.dtype)
        # A voxel that is 5 pixels from the border is refined by at most half a pixel. A fit that does not converge
        # leaves the coordinates of the voxel.
        filters = (float(_LEVELS), _BORDER - 0.5, 0.0, threshold)
        peaks, voxels = scale_space_peaks(
            levels, weights, nowhere, True, True, 4 * count, *filters, _FITS, _LARGEST_SHIFT, ANYWHERE, True
        )
        level, x, y, contrast = peaks.unbind(2)
        layer, column, row = (v.detach().round().long() for v in (level, x, y))
        is_refined = ((level != layer) | (x != column) | (y != row)).detach()
        constant = {"height": height, "width": width, "octave": number}
        point = {
            "x": x,
            "y": y,
            "sigma": _SIGMA * torch.exp2(level / _LEVELS),
            "contrast": contrast,
            "column": column,
            "row": row,
            "start": start + layer * height * width,
            **{name: torch.full_like(voxels, value) for name, value in constant.items()},
        }
        inside = (layer >= 1) & (layer <= _LEVELS) & (voxels >= 0) & is_refined
        off_edges = _are_off_edges(levels.detach(), layer.clamp(0, depth - 2), row, column)
        found = inside & off_edges & ~_is_repeated((layer * height + row) * width + column, inside)
        point["score"] = torch.where(found, contrast.detach(), detection.EMPTY)
        parts.append(point)
        start += depth * height * width
    points = _KeyPoints({name: torch.cat([p[name] for p in parts], 1) for name in parts[0]})
    return points.take(points.score.sort(dim=1, descending=True, stable=True)[1][:, :count])


def _are_off_edges(levels: Tensor, layer: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """`is_off_edges` for the differences of levels at voxels (B, N)."""
    flat, (height, width) = levels.flatten(1), levels.shape[2:]
    middle = (layer * height + row.clamp(1, height - 2)) * width + column.clamp(1, width - 2)

    def at(dy: int, dx: int) -> Tensor:
        index = middle + dy * width + dx
        return flat.gather(1, index + height * width) - flat.gather(1, index)

    v = at(0, 0)
    xx, yy = at(0, 1) + at(0, -1) - 2 * v, at(1, 0) + at(-1, 0) - 2 * v
    xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    return is_off_edges(xx, xy, yy, _EDGE_RATIO)


def _is_repeated(voxels: Tensor, counts: Tensor) -> Tensor:
    """Whether an earlier slot (B, N) that counts has the same voxel: two extrema may be refined to one."""
    ranked, index = torch.where(counts, voxels, -1).sort(dim=1, stable=True)
    same = torch.cat([torch.zeros_like(ranked[:, :1], dtype=torch.bool), ranked[:, 1:] == ranked[:, :-1]], 1)
    return torch.zeros_like(same).scatter(1, index, same) & counts


def _square(radius: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """The offsets (S,) of the pixels of a square along y and x."""
    side = torch.arange(-radius, radius + 1, device=like.device)
    return side.repeat_interleave(len(side)), side.repeat(len(side))


def _gradients(points: _KeyPoints, flat: Tensor, rows: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
    """Differences of the neighbors of pixels along x and upwards, 0 at the border of the level."""
    dx = points.pixels(flat, rows, columns + 1) - points.pixels(flat, rows, columns - 1)
    dy = points.pixels(flat, rows - 1, columns) - points.pixels(flat, rows + 1, columns)
    width, height = points.width[..., None], points.height[..., None]
    inside = (rows > 0) & (rows < height - 1) & (columns > 0) & (columns < width - 1)
    return torch.where(inside, dx, 0), torch.where(inside, dy, 0)


def _polar(dx: Tensor, dy: Tensor) -> tuple[Tensor, Tensor]:
    """Magnitudes and angles, both constants where there is no gradient."""
    has_direction = (dx != 0) | (dy != 0)
    dx, dy = torch.where(has_direction, dx, 1), torch.where(has_direction, dy, 0)
    return torch.where(has_direction, (dx * dx + dy * dy).sqrt(), 0), torch.atan2(dy, dx)


def _largest_radius(factor: float) -> int:
    """Of windows of `factor` times the blur of a key point, rounded; a level is refined by at most half a level."""
    return round(factor * _SIGMA * 2 ** ((_LEVELS + 0.5) / _LEVELS)) + 1


def _directions(points: _KeyPoints, flat: Tensor) -> tuple[Tensor, Tensor]:
    """The angles (B, N, peaks) of dominant gradients, counter-clockwise as seen in the image, and which there are."""
    sigma = points.sigma.detach()
    radius = (4.5 * sigma).round().long()[..., None]
    dy, dx = _square(_largest_radius(4.5), sigma)
    rows, columns = points.row[..., None] + dy, points.column[..., None] + dx
    magnitude, angle = _polar(*_gradients(points, flat, rows, columns))
    weight = torch.exp(-(dx * dx + dy * dy) / (2 * (1.5 * points.sigma[..., None]) ** 2))
    inside = (dx.abs() <= radius) & (dy.abs() <= radius)
    votes = torch.where(inside, weight * magnitude, 0)
    bin_of_vote = (angle.detach() * (_BINS / (2 * math.pi))).round().long() % _BINS
    counts = torch.zeros(*sigma.shape, _BINS, dtype=flat.dtype, device=flat.device)
    if flat.is_cuda or votes.requires_grad:  # the same bits every run
        counts = torch.stack([torch.where(bin_of_vote == b, votes, 0).sum(2) for b in range(_BINS)], 2)
    else:
        counts = counts.scatter_add(2, bin_of_vote, votes)
    smooth = (6 * counts + 4 * (counts.roll(1, 2) + counts.roll(-1, 2)) + counts.roll(2, 2) + counts.roll(-2, 2)) / 16
    left, right = smooth.roll(1, 2), smooth.roll(-1, 2)
    is_peak = (smooth > left) & (smooth > right) & (smooth >= _SHARE * smooth.amax(2, keepdim=True))
    # The peaks in the order of their bins.
    bins = torch.arange(_BINS, device=flat.device).expand_as(is_peak)
    order = torch.where(is_peak, bins, _BINS).sort(2)[0][..., :_PEAKS]
    present, index = order < _BINS, order.clamp(max=_BINS - 1)
    before, middle, after = (v.gather(2, index) for v in (left, smooth, right))
    bend = torch.where(present, before - 2 * middle + after, 1)
    peak = index + 0.5 * (before - after) / torch.where(bend == 0, 1, bend)
    return (peak % _BINS) * (2 * math.pi / _BINS), present


def _described(points: _KeyPoints, angles: Tensor, flat: Tensor) -> Tensor:
    """Histograms (B, N, 128) of gradients in 4 x 4 cells around key points, before they are normalized."""
    sigma = points.sigma
    cell = 3 * sigma[..., None]  # side in pixels
    reach = math.sqrt(2) * (_CELLS + 1) / 2
    radius = (cell.detach() * reach).round()
    dy, dx = _square(_largest_radius(3 * reach), sigma)
    rows = points.y.detach().round().long()[..., None] + dy
    columns = points.x.detach().round().long()[..., None] + dx
    cosine, sine = (f(angles)[..., None] / cell for f in (torch.cos, torch.sin))
    # Axes are those of the key point: its direction, counter-clockwise as seen, becomes x.
    across, down = dx * cosine - dy * sine, dx * sine + dy * cosine
    magnitude, angle = _polar(*_gradients(points, flat, rows, columns))
    inside = (dx.abs() <= radius) & (dy.abs() <= radius)
    weight = torch.exp(-(across**2 + down**2) / (_CELLS**2 / 2))
    votes = torch.where(inside, weight * magnitude, 0)
    cells = torch.arange(_CELLS, device=flat.device) - (_CELLS - 1) / 2
    of_row, of_column = ((1 - (v[..., None] - cells).abs()).clamp(min=0) for v in (down, across))
    turned = (angle - angles[..., None]) * (_ANGLES / (2 * math.pi)) % _ANGLES
    away = (turned[..., None] - torch.arange(_ANGLES, device=flat.device)).abs()
    of_angle = (1 - torch.minimum(away, _ANGLES - away)).clamp(min=0)
    of_cell = (of_row[..., None] * of_column[..., None, :] * votes[..., None, None]).flatten(3)  # (B, N, S, 16)
    return (of_cell.mT @ of_angle).flatten(2)


def _quantized(histograms: Tensor) -> Tensor:
    """Normalized, clipped, and rounded to 0 ... 255; the gradient is that without rounding."""
    length = histograms.norm(dim=2, keepdim=True)
    clipped = histograms.minimum(_CLIP * length)
    again = clipped.norm(dim=2, keepdim=True)
    x = (clipped * (_UNIT / again.clamp(min=torch.finfo(again.dtype).eps))).clamp(max=255)
    return x + (x.round() - x).detach()


def root_sift(descriptors: Tensor) -> Tensor:
    """The roots of the shares of the sum, of descriptors (B, N, D) that are not negative; 0 for those of 0."""
    total = descriptors.sum(2, keepdim=True)
    shares = descriptors / torch.where(total > 0, total, 1)
    return torch.where(total > 0, (shares + 1e-10).sqrt(), 0)


class OpenCVSIFT(nn.Module):
    """Frames, responses and descriptors of gray images (B, 1, H, W) in [0, 1] or of uint8, as cv2.SIFT finds them.

    Descriptors (B, N, 128) have OpenCV's order and values, integers up to 255.
    """

    def __init__(self, num_features: int, upright: bool = False, score_threshold: float = 0.0) -> None:
        super().__init__()
        self.score_threshold = max(
            _check.number("SIFTFeature", "score_threshold", score_threshold), _CONTRAST / _LEVELS
        )
        (self.num_features,) = _check.ints("SIFTFeature", "num_features", num_features, 1)
        self.upright = upright

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        detection.check_mask("SIFTFeature", mask, img)
        image = img / 255 if img.dtype == torch.uint8 else floats(img)
        image = as_dtype(image, compute_dtype(image))
        batch, count = len(image), self.num_features
        octaves = _Octaves(image)
        if not octaves.levels:
            scores, lafs = detection.no_candidates(image)
            lafs, responses = detection.filled_slots(image, scores, lafs, count)[::-1]
            return lafs, responses, torch.cat([responses[..., None]] * 128, 2)
        points, flat = _find(octaves, count, self.score_threshold, mask), octaves.flat()
        if self.upright:
            angles, present = (
                torch.zeros_like(points.x)[..., None],
                torch.ones_like(points.x, dtype=torch.bool)[..., None],
            )
        else:
            angles, present = _in_chunks(_directions, 4.5, points, (), flat)
        peaks = angles.shape[2]
        scores = torch.where(present, points.score[..., None], detection.EMPTY).flatten(1)
        scores, index = scores.sort(dim=1, descending=True, stable=True)
        index = index[:, :count]
        index = torch.cat([index, index.new_zeros(batch, count - index.shape[1])], 1)
        filled = scores[:, :count] > detection.EMPTY
        filled = torch.cat([filled, filled.new_zeros(batch, count - filled.shape[1])], 1)
        angles, points = angles.flatten(1).gather(1, index), points.take(index // peaks)
        (histograms,) = _in_chunks(
            lambda p, a, f: (_described(p, a, f),), 3 * math.sqrt(2) * (_CELLS + 1) / 2, points, (angles,), flat
        )
        size = torch.exp2(points.octave.to(flat.dtype) - 1)  # of a pixel of the octave in pixels of the image
        xy = torch.stack([points.x * size, points.y * size], 2)
        scale = (_OF_FRAME * points.sigma * size)[..., None, None]
        lafs = laf_from_center_scale_ori(xy, scale, torch.rad2deg(angles)[..., None])
        lafs = torch.where(filled[..., None, None], lafs, 0)
        responses = torch.where(filled, points.contrast, 0)
        return lafs, responses, torch.where(filled[..., None], _quantized(histograms), 0)


def _in_chunks(
    f: Callable[..., Sequence[Tensor]], factor: float, points: _KeyPoints, more: Sequence[Tensor], flat: Tensor
) -> list[Tensor]:
    """The results of f for all key points, of which windows of `factor` times the blur are held for a few at a time."""
    samples = (2 * _largest_radius(factor) + 1) ** 2 * max(1, len(flat))
    step, count = max(1, _SAMPLES // samples), points.x.shape[1]
    parts = [f(points.part(i, i + step), *(x[:, i : i + step] for x in more), flat) for i in range(0, count, step)]
    return [torch.cat(part, 1) for part in zip(*parts)]


def opencv_key_points(lafs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Position (B, N, 2), size (B, N) and angle (B, N) as cv2.KeyPoint has them, of frames of OpenCVSIFT."""
    angle = (-get_laf_orientation(lafs)[..., 0]) % 360
    return get_laf_center(lafs), get_laf_scale(lafs)[..., 0, 0] * (2 / _OF_FRAME), angle
