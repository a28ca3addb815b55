"""Features as maxima of a response on images of several sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import floats
from kvision.core.exceptions import ShapeError
from kvision.feature import _detection as detection
from kvision.feature.laf import laf_from_center_scale_ori, laf_is_filled
from kvision.feature.scale_space_detector import PassLAF
from kvision.geometry._formula import of_rows, register_formula
from kvision.geometry.subpix import NonMaximaSuppression2d
from kvision.geometry.transform.pyramid import pyrdown
from kvision.geometry.transform.resize import resize

__all__ = ["MultiResolutionDetector", "get_default_detector_config"]

_BORDER = 15  # pixels of a level without features


class Detector_config(TypedDict):
    """The options of MultiResolutionDetector; :func:`get_default_detector_config` describes them."""

    nms_size: int
    pyramid_levels: int
    up_levels: int
    scale_factor_levels: float
    s_mult: float


def get_default_detector_config() -> Detector_config:
    """Get the options of :class:`MultiResolutionDetector`, to change some of them.

    Returns:
        A dict: `nms_size`, the window in which a feature is the only maximum, 15; `pyramid_levels`, the number of
        smaller images, 4; `up_levels`, of larger ones, 1; `scale_factor_levels`, the ratio of their sizes, sqrt 2;
        `s_mult`, the scale of a frame in pixels of its level, 22.

    Example:
        >>> import kvision as K
        >>> K.feature.get_default_detector_config()["nms_size"]
        15
    """
    return {
        "nms_size": 15,
        "pyramid_levels": 4,
        "up_levels": 1,
        "scale_factor_levels": math.sqrt(2),
        "s_mult": 22.0,
    }


def _peak_reference(values: Tensor) -> Tensor:
    """The offset (x, y) of the top of the quadratic through 3 x 3 values (B, 9); 0 without a top within a pixel."""
    v = values.unbind(1)
    dx, dy = (v[5] - v[3]) / 2, (v[7] - v[1]) / 2
    xx, yy, xy = v[5] - 2 * v[4] + v[3], v[7] - 2 * v[4] + v[1], (v[8] - v[6] - v[2] + v[0]) / 4
    det = xx * yy - xy * xy
    has_top = (det > 0) & (xx < 0)
    divisor = torch.where(has_top, det, 1)
    x, y = (xy * dy - yy * dx) / divisor, (xy * dx - xx * dy) / divisor
    near = has_top & (x.abs() <= 1) & (y.abs() <= 1)
    return torch.stack([torch.where(near, x, 0), torch.where(near, y, 0)], 1)


_peak = register_formula("quadratic_peak2d", _peak_reference, lambda *args: (2,))


class MultiResolutionDetector(nn.Module):
    """Detect features at the maxima of a response on an image and on larger and smaller copies of it.

    A feature is above all other pixels of its window, above the threshold, and 15 pixels of its level inside of the
    image. Its position is the top of the quadratic through the 3 x 3 pixels around it, so that gradients pass through
    positions as well as responses. Nothing waits for the GPU. An image's features do not depend on the rest of its
    batch. There are none where pixels are not finite, and gradients that would not be are 0.

    Args:
        model: the response: images (B, C, H, W) to (B, 1, H, W).
        num_features: slots of each image, at least 1.
        config: the dict of :func:`get_default_detector_config`; None for its values.
        ori_module: gives frames an orientation, such as LAFOrienter; None for no change.
        aff_module: gives frames an affine shape, such as LAFAffineShapeEstimator; None for no change.
        compile_model: torch.compile the response and the suppression of pixels that are no maxima.
        score_threshold: responses of features are above it; not negative.

    `forward(img, mask=None)` takes images (B, C, H, W) and a mask (B, 1, H, W) or (1, 1, H, W): features are where it
    is not 0, and floating-point weights below 1 make responses weaker. It returns frames (B, num_features, 2, 3) and
    responses (B, num_features), strongest first. Empty slots are 0. Frames of half-type images are float32.

    Raises:
        TypeCheckError: a mask or an image is not a tensor of real numbers, `config` no dict, a module cannot be called.
        ShapeError: another shape of an image, of a mask or of a response.
        ValueCheckError: `num_features` is below 1, `score_threshold` negative, or `config` lacks an option.

    Example:
        >>> import torch, kvision as K
        >>> detector = K.feature.MultiResolutionDetector(K.feature.BlobHessian(), 10)
        >>> lafs, responses = detector(torch.rand(2, 1, 64, 80))
        >>> lafs.shape, responses.shape
        (torch.Size([2, 10, 2, 3]), torch.Size([2, 10]))
    """

    model: Any
    nms: Any
    ori: Any
    aff: Any

    def __init__(
        self,
        model: nn.Module,
        num_features: int = 2048,
        config: Detector_config | None = None,
        ori_module: nn.Module | None = None,
        aff_module: nn.Module | None = None,
        compile_model: bool = False,
        score_threshold: float = 0.0,
    ) -> None:
        super().__init__()
        op = "MultiResolutionDetector"
        options = get_default_detector_config() if config is None else config
        if not isinstance(options, Mapping):
            raise _check.TypeCheckError(f"{op}: expected config to be a dict, got {config!r}")
        missing = get_default_detector_config().keys() - options.keys()
        if missing:
            raise _check.ValueCheckError(f"{op}: expected config with {', '.join(sorted(missing))}, got {config!r}")
        (self.num_features,) = _check.ints(op, "num_features", num_features, 1)
        (self.num_pyramid_levels,) = _check.ints(op, "pyramid_levels", options["pyramid_levels"], 1, minimum=0)
        (self.num_upscale_levels,) = _check.ints(op, "up_levels", options["up_levels"], 1, minimum=0)
        (self.nms_size,) = _check.ints(op, "nms_size", options["nms_size"], 1)
        self.scale_factor_levels = options["scale_factor_levels"]
        self.mr_size = options["s_mult"]
        self.score_threshold = _check.number(op, "score_threshold", score_threshold, 0)
        _check.function(op, "model", model)
        modules = {"model": model, "nms": NonMaximaSuppression2d((self.nms_size, self.nms_size))}
        for name, module in detection.compiled(op, modules, compile_model).items():
            setattr(self, name, module)
        self.ori = ori_module or PassLAF()
        self.aff = aff_module or PassLAF()
        _check.function(op, "ori_module", self.ori)
        _check.function(op, "aff_module", self.aff)

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        responses, lafs = self.detect(img, mask)
        filled = laf_is_filled(lafs)
        lafs = self.ori(self.aff(lafs, img), img)
        return torch.where(filled[..., None, None], lafs, 0), responses

    def detect(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Find features before they have an affine shape and an orientation: responses (B, N) and frames."""
        op = "MultiResolutionDetector"
        _check.images(op, "img", img)
        detection.check_mask(op, mask, img)
        image = floats(img)
        height, width = image.shape[2:]
        scores, lafs = ([x] for x in detection.no_candidates(image))
        for level in self._levels(image):
            factor = (width / level.shape[3], height / level.shape[2])
            strongest, frames = self.detect_features_on_single_level(level, self.num_features, factor, mask=mask)
            scores.append(torch.where(laf_is_filled(frames), strongest, detection.EMPTY))
            lafs.append(frames)
        return detection.filled_slots(image, torch.cat(scores, 1), torch.cat(lafs, 1), self.num_features)

    def _levels(self, image: Tensor) -> list[Tensor]:
        """The image in all sizes that have room for a feature."""
        levels, level = [], image
        height, width = image.shape[2:]
        for i in range(self.num_upscale_levels):
            factor = self.scale_factor_levels ** (i + 1)
            level = resize(level, (int(height * factor), int(width * factor)), "bilinear", align_corners=False)
            levels.append(level)
        level = image
        levels.append(level)
        for _ in range(self.num_pyramid_levels):
            if min(level.shape[2:]) <= 2 * _BORDER:
                break
            level = pyrdown(level, factor=self.scale_factor_levels)
            levels.append(level)
        return [level for level in levels if min(level.shape[2:]) > 2 * _BORDER]

    def remove_borders(self, score_map: Tensor, borders: int = 15) -> Tensor:
        """Set the outermost pixels of scores (B, C, H, W) to 0."""
        height, width = score_map.shape[2:]
        if min(height, width) <= 2 * borders:
            return torch.zeros_like(score_map)
        inner = score_map[..., borders : height - borders, borders : width - borders]
        return F.pad(inner, (borders,) * 4)

    def detect_features_on_single_level(
        self, level_img: Tensor, num_kp: int, factor: tuple[float, float], *, mask: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Find the strongest `num_kp` features of one level: responses (B, N) and frames in pixels of the image.

        `factor` is how many pixels of the image one of the level is, along x and y. The mask has the image's size.
        """
        level_img = detection.with_finite_gradient(level_img)
        response = detection.with_finite_gradient(self.model(level_img))
        height, width = level_img.shape[2:]
        if response.shape != (level_img.shape[0], 1, height, width):
            raise ShapeError(
                f"MultiResolutionDetector: expected model to give one response for each image, "
                f"({level_img.shape[0]}, 1, {height}, {width}), got {tuple(response.shape)}"
            )
        peaks = self.remove_borders(self.nms(response), _BORDER)
        if mask is not None:
            weights = detection.resized_mask(mask, (height, width))
            peaks = detection.weighted(peaks, weights)
        ranked = torch.where(peaks > self.score_threshold, peaks, detection.EMPTY).flatten(1)
        scores, index = detection.strongest(ranked, num_kp)
        filled = scores > detection.EMPTY
        center = index.clamp(width + 1, height * width - width - 2)  # a feature is not at the edge
        compute = torch.promote_types(level_img.dtype, torch.float32)
        offset = _offsets(response.flatten(1), center, width).to(compute)
        x, y = index % width + offset[..., 0], index // width + offset[..., 1]
        # Pixels of a level and of the image have the same edges, not the same centers.
        xy = torch.stack([(x + 0.5) * factor[0] - 0.5, (y + 0.5) * factor[1] - 0.5], -1)
        scale = xy.new_full((*xy.shape[:2], 1, 1), (factor[0] + factor[1]) / 2 * self.mr_size)
        lafs = laf_from_center_scale_ori(xy, scale)
        return torch.where(filled, scores, 0), torch.where(filled[..., None, None], lafs, 0)


def _offsets(response: Tensor, center: Tensor, width: int) -> Tensor:
    """Where the peaks are from their pixels (B, N) of a response (B, H * W): (B, N, 2)."""
    around = [center + row * width + column for row in (-1, 0, 1) for column in (-1, 0, 1)]
    values = response.gather(1, torch.stack(around, -1).flatten(1)).unflatten(1, (-1, 9))
    return of_rows(_peak, values, 1)
