"""Features as maxima of a response over position and scale, refined between pixels and levels."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import torch
from torch import Tensor, nn
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype, floats
from kvision._limits import MAX_OCTAVES, MAX_SCALES
from kvision._modes import DERIVATIVE_MODE
from kvision._ops import wants_derivative
from kvision._torch_compat import is_tracing
from kvision.core.exceptions import ShapeError
from kvision.feature import _detection as detection
from kvision.feature.laf import laf_is_filled, laf_of_peak
from kvision.feature.responses import BlobDoG, BlobHessian
from kvision.feature.scale_space.scale_space_features import DIFFERENCES, scale_space_features
from kvision.feature.scale_space.scale_space_peaks import scale_space_peaks, strongest_peaks
from kvision.geometry.subpix import AdaptiveQuadInterp3d, ConvQuadInterp3d, IterativeQuadInterp3d
from kvision.geometry.subpix.quad_interp3d import ANYWHERE
from kvision.geometry.transform.pyramid import ScalePyramid, ScaleSpacePlan

__all__ = ["PassLAF", "ScaleSpaceDetector"]

_BORDER = 5  # pixels of an octave between a feature's middle half and the edge of the image
_SMALLEST = 2 * _BORDER + 1  # side of an octave that has room for a feature
_MASKED_REFINEMENTS = (ConvQuadInterp3d, IterativeQuadInterp3d, AdaptiveQuadInterp3d)


class PassLAF(nn.Module):
    """Return frames as they are: the detectors' default for affine shapes and orientations.

    Example:
        >>> import torch, kvision as K
        >>> K.feature.PassLAF()(torch.ones(1, 1, 2, 3), torch.zeros(1, 1, 8, 8)).shape
        torch.Size([1, 1, 2, 3])
    """

    def __init__(self) -> None:
        super().__init__()

    def forward(self, laf: Tensor, img: Tensor) -> Tensor:
        return laf


class ScaleSpaceDetector(nn.Module):
    """Detect features at the maxima of a response over position and scale.

    The response of each level of a scale pyramid is searched for voxels above all of their 26 neighbors. These are
    refined between pixels and levels, and the strongest of all octaves get an affine shape and an orientation.
    Nothing waits for the GPU. An image's features do not depend on the rest of its batch. There are none where pixels are
    not finite, and gradients that would not be are 0.

    Args:
        num_features: slots of each image, at least 1.
        mr_size: scale of a frame over the blur of the level at which it is found.
        scale_pyr_module: makes the levels; None for ScalePyramid(3, 1.6, 16). Its octaves are resized with
            align_corners=True. The first `n_levels + 2` levels of an octave are used, or one more for the difference
            of Gaussians.
        resp_module: the response, called with images (B * L, 1, H, W) and their blurs (B * L); None for BlobHessian().
        subpix_module: refines maxima, returns coordinates (B, 1, 3, L, H, W) and values (B, 1, L, H, W); None for
            AdaptiveQuadInterp3d(). Gradients pass through it.
        ori_module: gives frames an orientation, such as LAFOrienter; None for no change.
        aff_module: gives frames an affine shape, such as LAFAffineShapeEstimator; None for no change.
        minima_are_also_good: minima are features, too, with their negative value as response.
        scale_space_response: call `resp_module` with whole octaves (B, 1, L, H, W), as BlobDoG needs it.
        compile_modules: True, or names out of scale_pyr, resp, subpix, ori, aff, for torch.compile.
        nms_module: another name of `subpix_module`.
        edge_threshold: leave out maxima on edges, where the response bends more than this many times as much along one
            direction as along another; None keeps them. SIFT has 10. At least 1.
        score_threshold: responses of features are above it; None for no threshold.

    `forward(img, mask=None)` takes images (B, 1, H, W) and a mask (B, 1, H, W) or (1, 1, H, W): features are where it
    is not 0, and floating-point weights below 1 make responses weaker. It returns frames (B, num_features, 2, 3) and
    responses (B, num_features), strongest first. Empty slots are 0. The middle half of a frame stays 5 pixels of its
    octave inside of the image. Frames of half-type images are float32.

    Raises:
        TypeCheckError: a mask or an image is not a tensor of real numbers, a module cannot be called.
        ShapeError: another shape of an image, of a mask or of a response.
        ValueCheckError: `num_features` is below 1, `edge_threshold` below 1, or an unknown name in
            `compile_modules`.

    Example:
        >>> import torch, kvision as K
        >>> lafs, responses = K.ScaleSpaceDetector(10)(torch.rand(2, 1, 48, 64))
        >>> lafs.shape, responses.shape
        (torch.Size([2, 10, 2, 3]), torch.Size([2, 10]))
    """

    scale_pyr: Any
    resp: Any
    subpix: Any
    ori: Any
    aff: Any

    def __init__(
        self,
        num_features: int = 500,
        mr_size: float = 6.0,
        scale_pyr_module: nn.Module | None = None,
        resp_module: nn.Module | None = None,
        subpix_module: nn.Module | None = None,
        ori_module: nn.Module | None = None,
        aff_module: nn.Module | None = None,
        minima_are_also_good: bool = False,
        scale_space_response: bool = False,
        compile_modules: bool | Collection[str] = False,
        nms_module: nn.Module | None = None,
        edge_threshold: float | None = None,
        score_threshold: float | None = None,
    ) -> None:
        super().__init__()
        op = "ScaleSpaceDetector"
        (self.num_features,) = _check.ints(op, "num_features", num_features, 1)
        self.mr_size = _check.number(op, "mr_size", mr_size)
        if subpix_module is not None and nms_module is not None:
            raise _check.ValueCheckError(f"{op}: expected one of subpix_module and nms_module, got both")
        given = dict(scale_pyr=scale_pyr_module, resp=resp_module, subpix=subpix_module, nms=nms_module)
        for name, module in {**given, "ori": ori_module, "aff": aff_module}.items():
            if module is not None:
                _check.function(op, f"{name}_module", module)
        subpix = subpix_module or nms_module or AdaptiveQuadInterp3d()
        self._takes_candidates = isinstance(subpix, _MASKED_REFINEMENTS)
        scale_space_response = _check.switch(op, "scale_space_response", scale_space_response)
        modules = {
            "scale_pyr": scale_pyr_module or ScalePyramid(3, 1.6, 16, extra_levels=3 if scale_space_response else 2),
            "resp": resp_module or BlobHessian(),
            "subpix": subpix,
            "ori": ori_module or PassLAF(),
            "aff": aff_module or PassLAF(),
        }
        for name, module in detection.compiled(op, modules, compile_modules).items():
            setattr(self, name, module)
        self.minima_are_also_good = _check.switch(op, "minima_are_also_good", minima_are_also_good)
        self.scale_space_response = scale_space_response
        self.edge_threshold = edge_threshold
        if edge_threshold is not None:
            self.edge_threshold = _check.number(op, "edge_threshold", edge_threshold, 1)
        self.score_threshold = score_threshold
        if score_threshold is not None:
            self.score_threshold = _check.number(op, "score_threshold", score_threshold)

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        responses, lafs = self.detect(img, self.num_features, mask)
        if isinstance(self.aff, PassLAF) and isinstance(self.ori, PassLAF):
            return lafs, responses
        filled = laf_is_filled(lafs)
        lafs = self.ori(self.aff(lafs, img), img)
        return torch.where(filled[..., None, None], lafs, 0), responses

    def detect(self, img: Tensor, num_feats: int, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Find features before they have an affine shape and an orientation: responses (B, N) and frames."""
        op = "ScaleSpaceDetector"
        _check.images(op, "img", img)
        detection.check_mask(op, mask, img)
        image = floats(img)
        if mask is None and self._has_operator(image):
            plan = self.scale_pyr._plan(*image.shape[2:])
            octaves = sum(min(size) >= _SMALLEST for size in zip(plan.sizes[::2], plan.sizes[1::2]))
            if 0 < octaves <= MAX_OCTAVES and plan.voxels() < 2**31:
                return self._detect_by_operator(image, num_feats, plan, octaves)
        octaves, sigmas, _ = self.scale_pyr(image)
        scores, lafs = ([x] for x in detection.no_candidates(image))
        voxels = [image.new_empty((image.shape[0], 0), dtype=torch.int64)]
        scales = self.mr_size * torch.stack([sigma[:, 0] for sigma in sigmas])
        for octave, sigma, scale in zip(octaves, sigmas, scales.unbind()):
            if min(octave.shape[3:]) < _SMALLEST:
                continue
            levels, are_levels = self._response(op, detection.with_finite_gradient(octave), sigma)
            levels = detection.with_finite_gradient(levels)
            strongest = self._strongest_of_octave(levels, are_levels, scale, image.shape[2:], num_feats, mask)
            for every, of_octave in zip((lafs, scores, voxels), strongest):
                every.append(of_octave)
        candidates = torch.cat(scores, 1).masked_fill(torch.cat(voxels, 1) < 0, detection.EMPTY)
        return detection.filled_slots(image, candidates, torch.cat(lafs, 1), num_feats)

    def _has_operator(self, image: Tensor) -> bool:
        """Whether `scale_space_features` computes what the modules compute, and has a kernel for this image."""
        if image.shape[1] != 1 or is_compiling() or is_tracing() or wants_derivative(image):
            return False
        if type(self.scale_pyr) is not ScalePyramid or _refinement_of(self.subpix) is None:
            return False
        if self.scale_pyr.n_levels + self.scale_pyr.extra_levels > MAX_SCALES:
            return False
        # The operator searches all levels of an octave.
        uses_differences = type(self.resp) is BlobDoG and self.scale_space_response and self.scale_pyr.extra_levels == 3
        uses_hessians = type(self.resp) is BlobHessian and not self.scale_space_response
        if not uses_differences and not (uses_hessians and self.scale_pyr.extra_levels == 2):
            return False
        return scale_space_features.is_native(image)

    def _detect_by_operator(
        self, image: Tensor, count: int, plan: ScaleSpacePlan, octaves: int
    ) -> tuple[Tensor, Tensor]:
        """`detect` by one operator, in the first `octaves` octaves of a scale space."""
        levels = self.scale_pyr.n_levels
        lafs, scores = scale_space_features(
            image,
            plan.sizes[: 2 * octaves],
            plan.windows[: octaves * len(plan.sigmas)],
            plan.sigmas,
            levels,
            plan.scales,
            DIFFERENCES if self.scale_space_response else DERIVATIVE_MODE[self.resp.grads_mode],
            self.minima_are_also_good,
            count,
            self.mr_size * plan.scales[0],
            float(levels),
            *self._filters(),
            *(_refinement_of(self.subpix) or ()),
        )
        return as_dtype(scores, image.dtype), lafs

    def _filters(self) -> tuple[float, float, float]:
        """The margin, the ratio of curvatures and the threshold of peaks."""
        ratio = 0.0 if self.edge_threshold is None else self.edge_threshold
        return float(_BORDER), ratio, detection.EMPTY if self.score_threshold is None else self.score_threshold

    def _response(self, op: str, octave: Tensor, sigmas: Tensor) -> tuple[Tensor, bool]:
        """The response (B, L, H, W) of the levels 0 to n_levels + 1 of an octave, or levels whose differences it is."""
        count = int(self.scale_pyr.n_levels) + 2
        batch, channels, _, height, width = octave.shape
        if self.scale_space_response:
            if type(self.resp) is BlobDoG and channels == 1:
                return octave[:, 0, : count + 1], True
            response = self.resp(octave, sigmas.reshape(-1))
            if response.dim() != 5 or response.shape[:2] != (batch, 1) or response.shape[3:] != (height, width):
                raise ShapeError(
                    f"{op}: expected resp_module to give ({batch}, 1, L, {height}, {width}), got {tuple(response.shape)}"
                )
            return response[:, 0, :count], False
        levels = octave[:, :, :count].transpose(1, 2)
        response = self.resp(levels.flatten(0, 1), sigmas[:, :count].reshape(-1))
        if response.shape != (levels.shape[0] * levels.shape[1], 1, height, width):
            raise ShapeError(
                f"{op}: expected resp_module to give one response for each image, (*, 1, {height}, {width}), got "
                f"{tuple(response.shape)} for {channels} channels"
            )
        return response.reshape(batch, levels.shape[1], height, width), False

    def _strongest_of_octave(
        self,
        levels: Tensor,
        are_differences: bool,
        scale: Tensor,
        image_size: torch.Size,
        count: int,
        mask: Tensor | None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Frames (B, N, 2, 3) in pixels of the image, scores (B, N) and voxels (B, N), -1 where there is no frame.

        `levels` (B, L, H, W) are the response, or it is their differences; `scale` (B,) is that of frames of level 0.
        """
        height, width = levels.shape[2:]
        dtype = compute_dtype(levels)
        weights = None if mask is None else as_dtype(detection.resized_mask(mask, (height, width))[:, 0], dtype)
        scale = as_dtype(scale, dtype)
        n_levels = float(self.scale_pyr.n_levels)
        filters = (self.minima_are_also_good, count, n_levels, *self._filters())
        refinement = _refinement_of(self.subpix)
        if refinement is not None:
            peaks, voxels = scale_space_peaks(levels, weights, scale, are_differences, *filters, *refinement)
        else:
            response = as_dtype(levels, dtype)
            response = response[:, 1:] - response[:, :-1] if are_differences else response
            peaks, voxels = strongest_peaks(response[:, None], weights, scale, *filters, self._refine)
        scores = peaks[..., 3]
        if weights is not None:
            at = voxels.clamp(min=0) % (height * width)
            scores = detection.weighted(scores, weights.flatten(1).expand(len(voxels), -1).gather(1, at))
        to_x, to_y = (image_size[1] - 1) / (width - 1), (image_size[0] - 1) / (height - 1)
        return laf_of_peak(peaks, scale, n_levels, to_x, to_y), as_dtype(scores, levels.dtype), voxels

    def _refine(self, response: Tensor, candidates: Tensor) -> tuple[Tensor, Tensor]:
        if self._takes_candidates:
            return self.subpix(response, precomputed_nms_mask=candidates)
        return self.subpix(response)


def _refinement_of(module: Any) -> tuple[int, float, int, bool] | None:
    """The arguments of the operator for a module that fits quadratics; None for any other module."""
    if type(module) not in _MASKED_REFINEMENTS or getattr(module, "max_candidates", None) is not None:
        return None
    is_local = type(module) is ConvQuadInterp3d or getattr(module, "mode", None) == "conv"
    radius = module.dilation_radius if is_local else ANYWHERE
    return module.n_iters, float(module.max_subpixel_shift), radius, module.allow_scale_steps
