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
from kvision.feature.scale_space.scale_space_peaks import is_off_edges, scale_space_peaks
from kvision.filters import gaussian_blur2d
from kvision.geometry.subpix.quad_interp3d import ANYWHERE
from kvision.geometry.transform.resize import resize

# The defaults of cv2.SIFT_create, and its constants.
_LEVELS, _SIGMA, _CONTRAST, _EDGE_RATIO = 3, 1.6, 0.04, 10.0
_BORDER = 5  # pixels of an octave without key points
_FITS, _LARGEST_SHIFT = 5, 0.5
_BINS, _PEAKS = 36, 4  # of the histogram of directions; OpenCV has no limit to the number of its peaks
_PEAK_RATIO = 0.8  # of a peak's height to the highest one's
_CELLS, _ANGLES, _CLIP, _UNIT = 4, 8, 0.2, 512.0  # of descriptors, whose length is about _UNIT
_OF_FRAME = 6.0  # scale of a frame over the blur of its level: the side of the 4 x 4 cells is twice that
# Windows around key points: half their side over the blur, which is refined by at most half a level.
_RADIUS_OF_DIRECTIONS, _RADIUS_OF_CELLS = 4.5, 3 * math.sqrt(2) * (_CELLS + 1) / 2
_LARGEST_BLUR = _SIGMA * 2 ** ((_LEVELS + 0.5) / _LEVELS)
_MARGIN = math.ceil(_RADIUS_OF_CELLS * _LARGEST_BLUR) + 1
_SAMPLES_IN_CACHE, _SAMPLES = 2**15, 2**18  # of windows that are held at a time, on the CPU and elsewhere


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


def _blurred(image: Tensor, sigma: float) -> Tensor:
    size = [min(round(8 * sigma + 1) | 1, (side - 1) // 2 * 2 + 1) for side in image.shape[2:]]
    return gaussian_blur2d(image, (size[0], size[1]), (sigma, sigma), "reflect")


class _KeyPoints:
    """Key points (B, N) in the pixels of their octaves, and where their gradients are.

    `x`, `y` and `sigma` are refined; `column`, `row` and `start`, the first pixel of the level in _Gradients, are
    integers.
    """

    def __init__(self, fields: dict[str, Tensor]) -> None:
        self.fields = fields

    def __getattr__(self, name: str) -> Tensor:
        return self.fields[name]

    def take(self, index: Tensor) -> _KeyPoints:
        return _KeyPoints({name: x.gather(1, index) for name, x in self.fields.items()})

    def part(self, begin: int, end: int) -> _KeyPoints:
        return _KeyPoints({name: x[:, begin:end] for name, x in self.fields.items()})


class _Gradients:
    """Differences (B, P) of the neighbors of pixels along x and upwards, of all levels that have key points.

    They are 0 at the border of a level and in a margin around it, so that windows need no rule for what is outside.
    """

    def __init__(self, octaves: _Octaves) -> None:
        middle = [levels[:, 1 : _LEVELS + 1] for levels in octaves.levels]
        self.along_x = self._flat([x[..., 1:-1, 2:] - x[..., 1:-1, :-2] for x in middle])
        self.upwards = self._flat([x[..., :-2, 1:-1] - x[..., 2:, 1:-1] for x in middle])

    @staticmethod
    def _flat(differences: list[Tensor]) -> Tensor:
        return torch.cat([nn.functional.pad(x, (_MARGIN + 1,) * 4).flatten(1) for x in differences], 1)

    @staticmethod
    def pixels(height: int, width: int) -> int:
        """Of a level of this size."""
        return (height + 2 * _MARGIN) * (width + 2 * _MARGIN)

    def windows(self, points: _KeyPoints, row: Tensor, column: Tensor, dy: Tensor, dx: Tensor) -> tuple[Tensor, Tensor]:
        """Magnitudes and angles (B, N, S) at offsets (S,) from pixels; both are constants where there is no gradient."""
        width = points.width + 2 * _MARGIN
        row, column = row.clamp(min=0).minimum(points.height - 1), column.clamp(min=0).minimum(points.width - 1)
        center = points.start + (row + _MARGIN) * width + column + _MARGIN
        index = center[..., None] + (dy * width[..., None] + dx)
        x, y = (d.gather(1, index.flatten(1)).view(index.shape) for d in (self.along_x, self.upwards))
        squares = x * x + y * y
        has_direction = squares > 0
        magnitudes = torch.where(has_direction, torch.where(has_direction, squares, 1).sqrt(), 0)
        return magnitudes, torch.atan2(torch.where(has_direction, y, 0), torch.where(has_direction, x, 1))


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
            "start": start + (layer.clamp(1, _LEVELS) - 1) * _Gradients.pixels(height, width),
            **{name: torch.full_like(voxels, value) for name, value in constant.items()},
        }
        inside = (layer >= 1) & (layer <= _LEVELS) & (voxels >= 0) & is_refined
        off_edges = _are_off_edges(levels.detach(), layer.clamp(0, depth - 2), row, column)
        is_kept = inside & off_edges & ~_is_repeated((layer * height + row) * width + column, inside)
        point["score"] = torch.where(is_kept, contrast.detach(), detection.EMPTY)
        parts.append(point)
        start += _LEVELS * _Gradients.pixels(height, width)
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


def _directions(points: _KeyPoints, gradients: _Gradients, largest: int) -> tuple[Tensor, Tensor]:
    """The angles (B, N, peaks) of dominant gradients, counter-clockwise as seen in the image, and which there are."""
    sigma = points.sigma.detach()
    dy, dx = _square(largest, sigma)
    magnitude, angle = gradients.windows(points, points.row, points.column, dy, dx)
    weight = torch.exp((dx * dx + dy * dy) / (-2 * (1.5 * points.sigma[..., None]) ** 2))
    inside = torch.maximum(dx.abs(), dy.abs()) <= (_RADIUS_OF_DIRECTIONS * sigma).round()[..., None]
    votes = torch.where(inside, weight * magnitude, 0)
    bin_of_vote = (angle.detach() * (_BINS / (2 * math.pi))).round().long() % _BINS
    counts = torch.zeros(*sigma.shape, _BINS, dtype=votes.dtype, device=votes.device)
    if votes.is_cuda or votes.requires_grad:  # the same bits every run
        counts = torch.stack([torch.where(bin_of_vote == b, votes, 0).sum(2) for b in range(_BINS)], 2)
    else:
        counts = counts.scatter_add(2, bin_of_vote, votes)
    smooth = (6 * counts + 4 * (counts.roll(1, 2) + counts.roll(-1, 2)) + counts.roll(2, 2) + counts.roll(-2, 2)) / 16
    left, right = smooth.roll(1, 2), smooth.roll(-1, 2)
    is_peak = (smooth > left) & (smooth > right) & (smooth >= _PEAK_RATIO * smooth.amax(2, keepdim=True))
    # The peaks in the order of their bins.
    bins = torch.arange(_BINS, device=votes.device).expand_as(is_peak)
    order = torch.where(is_peak, bins, _BINS).sort(2)[0][..., :_PEAKS]
    present, index = order < _BINS, order.clamp(max=_BINS - 1)
    before, middle, after = (v.gather(2, index) for v in (left, smooth, right))
    bend = torch.where(present, before - 2 * middle + after, 1)
    peak = index + 0.5 * (before - after) / torch.where(bend == 0, 1, bend)
    return (peak % _BINS) * (2 * math.pi / _BINS), present


def _described(points: _KeyPoints, gradients: _Gradients, largest: int) -> tuple[Tensor]:
    """Histograms (B, N, 128) of gradients in 4 x 4 cells around key points, before they are normalized."""
    sigma, angles = points.sigma, points.angle
    cell = 3 * sigma[..., None]  # side in pixels
    dy, dx = _square(largest, sigma)
    row, column = (x.detach().round().long() for x in (points.y, points.x))
    magnitude, angle = gradients.windows(points, row, column, dy, dx)
    cosine, sine = (f(angles)[..., None] / cell for f in (torch.cos, torch.sin))
    # Axes are those of the key point: its direction, counter-clockwise as seen, becomes x.
    across, down = dx * cosine - dy * sine, dx * sine + dy * cosine
    inside = torch.maximum(dx.abs(), dy.abs()) <= (_RADIUS_OF_CELLS * sigma.detach()).round()[..., None]
    weight = torch.exp((dx * dx + dy * dy) / (-(_CELLS**2) / 2 * cell**2))
    votes = torch.where(inside, weight * magnitude, 0)
    turned = (angle - angles[..., None]) * (_ANGLES / (2 * math.pi)) % _ANGLES
    middle = (_CELLS - 1) / 2
    of_row, of_column = _bin_weights(down, _CELLS, middle) * votes[..., None, :], _bin_weights(across, _CELLS, middle)
    of_cell = (of_row[..., None, :] * of_column[..., None, :, :]).flatten(2, 3)  # (B, N, 16, S)
    histograms = of_cell @ _bin_weights(turned, _ANGLES + 1, 0.0).mT
    # The angle after the last is the first.
    first, rest = histograms[..., :1] + histograms[..., _ANGLES:], histograms[..., 1:_ANGLES]
    return (torch.cat([first, rest], -1).flatten(2),)


def _bin_weights(position: Tensor, bins: int, zero: float) -> Tensor:
    """The weights (B, N, bins, S) of bins in votes at positions (B, N, S), of which 0 is in the middle of bin `zero`."""
    centers = torch.arange(bins, dtype=position.dtype, device=position.device) - zero
    return (1 - (position[..., None, :] - centers[:, None]).abs()).relu()


def _quantized(histograms: Tensor) -> Tensor:
    """Normalized, clipped, and rounded to 0 ... 255; the gradient is that without rounding."""
    length = histograms.norm(dim=2, keepdim=True)
    clipped = histograms.minimum(_CLIP * length)
    again = clipped.norm(dim=2, keepdim=True)
    x = (clipped * (_UNIT / again.clamp(min=torch.finfo(again.dtype).eps))).clamp(max=255)
    return x + (x.round() - x).detach()


def root_sift(descriptors: Tensor) -> Tensor:
    """The roots of the fractions of the sum, of descriptors (B, N, D) that are not negative; 0 for those of 0."""
    total = descriptors.sum(2, keepdim=True)
    fractions = descriptors / torch.where(total > 0, total, 1)
    return torch.where(total > 0, (fractions + 1e-10).sqrt(), 0)


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
        image = detection.with_finite_gradient(as_dtype(image, compute_dtype(image)))
        batch, count = len(image), self.num_features
        octaves = _Octaves(image)
        if not octaves.levels:
            scores, lafs = detection.no_candidates(image)
            lafs, responses = detection.filled_slots(image, scores, lafs, count)[::-1]
            return lafs, responses, torch.cat([responses[..., None]] * 128, 2)
        points, gradients = _find(octaves, count, self.score_threshold, mask), _Gradients(octaves)
        if self.upright:
            angles, present = (
                torch.zeros_like(points.x)[..., None],
                torch.ones_like(points.x, dtype=torch.bool)[..., None],
            )
        else:
            angles, present = _in_chunks(_directions, points, gradients, _RADIUS_OF_DIRECTIONS)
        peaks = angles.shape[2]
        scores = torch.where(present, points.score[..., None], detection.EMPTY).flatten(1)
        scores, index = scores.sort(dim=1, descending=True, stable=True)
        index = index[:, :count]
        index = torch.cat([index, index.new_zeros(batch, count - index.shape[1])], 1)
        filled = scores[:, :count] > detection.EMPTY
        filled = torch.cat([filled, filled.new_zeros(batch, count - filled.shape[1])], 1)
        points, angles = points.take(index // peaks), angles.flatten(1).gather(1, index)
        points.fields["angle"] = angles
        (histograms,) = _in_chunks(_described, points, gradients, _RADIUS_OF_CELLS)
        size = torch.exp2(points.octave.to(image.dtype) - 1)  # of a pixel of the octave in pixels of the image
        xy = torch.stack([points.x * size, points.y * size], 2)
        scale = (_OF_FRAME * points.sigma * size)[..., None, None]
        lafs = laf_from_center_scale_ori(xy, scale, torch.rad2deg(angles)[..., None])
        lafs = torch.where(filled[..., None, None], lafs, 0)
        responses = torch.where(filled, points.contrast, 0)
        return lafs, responses, torch.where(filled[..., None], _quantized(histograms), 0)


def _in_chunks(
    f: Callable[..., Sequence[Tensor]], points: _KeyPoints, gradients: _Gradients, radius: float
) -> list[Tensor]:
    """The results of f for all key points, of which the windows of a few are held at a time.

    On the CPU key points take their turns by the size of their windows, largest first. Elsewhere the host would have to
    wait for the sizes, and all windows are as large as the largest.
    """
    batch, count = points.x.shape
    by_size = points.x.is_cpu and batch > 0 and not torch.compiler.is_compiling()
    largest, limit, order = math.ceil(radius * _LARGEST_BLUR), _SAMPLES, None
    if by_size:
        limit, order = _SAMPLES_IN_CACHE, points.sigma.detach().argsort(1, descending=True)
        points = points.take(order)
    parts, i = [], 0
    while i < count:
        if by_size:
            largest = math.ceil(radius * float(points.sigma[:, i].detach().max()))
        step = max(1, limit // ((2 * largest + 1) ** 2 * max(1, batch)))
        parts.append(f(points.part(i, i + step), gradients, largest))
        i += step
    results = [torch.cat(part, 1) for part in zip(*parts)]
    if order is None:
        return results
    back = order.argsort(1)[..., None]
    return [x.gather(1, back.expand(-1, -1, x.shape[2])) for x in results]


def opencv_key_points(lafs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Position (B, N, 2), size (B, N) and angle (B, N) as cv2.KeyPoint has them, of frames of OpenCVSIFT."""
    angle = (-get_laf_orientation(lafs)[..., 0]) % 360
    return get_laf_center(lafs), get_laf_scale(lafs)[..., 0, 0] * (2 / _OF_FRAME), angle
