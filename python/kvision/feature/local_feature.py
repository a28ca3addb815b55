"""Detectors with descriptors, and matches of the features of two images."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor, nn

from kvision import _check
from kvision._dtype import as_dtype, floats
from kvision.color import rgb_to_grayscale
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError
from kvision.feature.adalam import GeometryAwareDescriptorMatcher
from kvision.feature.affnet import LAFAffNetShapeEstimator
from kvision.feature.hardnet import HardNet
from kvision.feature.keynet import KeyNetDetector
from kvision.feature.laf import check_lafs, get_laf_center, laf_is_filled, scale_laf
from kvision.feature.multi_resolution_detector import Detector_config, MultiResolutionDetector
from kvision.feature.opencv_sift import OpenCVSIFT, root_sift
from kvision.feature.orientation import LAFOrienter, dominant_orientations, orientation_slots
from kvision.feature.orinet import OriNet
from kvision.feature.patches import extract_patches_from_pyramid
from kvision.feature.responses import BlobDoG, BlobDoGSingle, BlobHessian, CornerGFTT
from kvision.feature.scale_space_detector import PassLAF, ScaleSpaceDetector
from kvision.feature.sift import (
    LAYOUTS,
    Layout,
    SIFTDescriptor,
    SIFTDescriptorFromPyramid,
    convert_sift_descriptor_layout,
)
from kvision.geometry.subpix import ConvQuadInterp3d
from kvision.geometry.transform.pyramid import ScalePyramid

__all__ = [
    "DoGAffNetHardNet",
    "DoGHardNet",
    "GFTTAffNetHardNet",
    "HesAffNetHardNet",
    "KeyNetAffNetHardNet",
    "KeyNetHardNet",
    "LAFDescriptor",
    "LocalFeature",
    "LocalFeatureMatcher",
    "SIFTFeature",
    "SIFTFeatureScaleSpace",
    "get_laf_descriptors",
]

Backend: TypeAlias = Literal["patch", "pyramid"]
_BACKENDS = get_args(Backend)
Device = str | torch.device | None

# --- descriptors of frames ------------------------------------------------------------------------------------------


def get_laf_descriptors(
    img: Tensor,
    lafs: Tensor,
    patch_descriptor: Callable[[Tensor], Tensor],
    patch_size: int = 32,
    grayscale_descriptor: bool = True,
) -> Tensor:
    """Describe frames by the patches that they cover.

    The descriptor runs in evaluation mode, so that a feature does not depend on the others, and in the type of its
    parameters.

    Args:
        img: images (B, C, H, W); integers give float32.
        lafs: frames (B, N, 2, 3) in pixels.
        patch_descriptor: a module or function from patches (n, C, patch_size, patch_size) to descriptors (n, D).
        patch_size: side of the patches.
        grayscale_descriptor: convert images of three channels to gray.

    Returns:
        (B, N, D); 0, with a gradient of 0, for empty slots.

    Raises:
        TypeCheckError: an argument is of the wrong type.
        ShapeError: a shape is not as in Args.
        DeviceError: the tensors are on different devices.

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[12.0, 0, 32], [0, 12, 32]]]])
        >>> K.feature.get_laf_descriptors(torch.rand(1, 3, 64, 64), laf, K.feature.SIFTDescriptor(32)).shape
        torch.Size([1, 1, 128])
    """
    op = "get_laf_descriptors"
    _check.images(op, "img", img)
    frames = check_lafs(op, lafs, "lafs")
    _check.same_device(op, img=img, lafs=lafs)
    _check.function(op, "patch_descriptor", patch_descriptor)
    _check.ints(op, "patch_size", patch_size, 1)
    if img.shape[0] != lafs.shape[0]:
        raise ShapeError(f"{op}: expected lafs of shape ({img.shape[0]}, N, 2, 3), got {tuple(lafs.shape)}")
    image = floats(img)
    if grayscale_descriptor and image.shape[1] == 3:
        image = rgb_to_grayscale(image)
    if lafs.shape[0] * lafs.shape[1] == 0:
        with torch.no_grad():
            width = _described(patch_descriptor, image.new_zeros(1, image.shape[1], patch_size, patch_size)).numel()
        return image.flatten()[:0].reshape(0, width).reshape(*lafs.shape[:2], width)
    patches = extract_patches_from_pyramid(image, frames, patch_size)
    descriptors = _described(patch_descriptor, patches.flatten(0, 1)).reshape(*lafs.shape[:2], -1)
    return torch.where(laf_is_filled(frames)[..., None], descriptors, 0)


def _described(module: Callable[[Tensor], Tensor], patches: Tensor) -> Tensor:
    if not isinstance(module, nn.Module):
        return module(patches)
    parameters = itertools.chain(module.parameters(), module.buffers())
    dtype = next((x.dtype for x in parameters if x.is_floating_point()), patches.dtype)
    with _evaluating(module):
        return as_dtype(module(as_dtype(patches, dtype)), patches.dtype)


@contextlib.contextmanager
def _evaluating(module: nn.Module) -> Iterator[None]:
    """Modules in evaluation mode, and back in the mode of each."""
    training = [m for m in module.modules() if m.training]
    for m in training:
        m.training = False
    try:
        yield
    finally:
        for m in training:
            m.training = True


class LAFDescriptor(nn.Module):
    """Module form of :func:`get_laf_descriptors`.

    Args:
        patch_descriptor_module: the descriptor of patches; None for HardNet(pretrained=True).
        patch_size: side of the patches.
        grayscale_descriptor: convert images of three channels to gray.

    Raises:
        TypeCheckError: `patch_descriptor_module` is no module or function, `patch_size` no int.
        ValueCheckError: `patch_size` is below 1.

    Example:
        >>> import torch, kvision as K
        >>> laf = torch.tensor([[[[12.0, 0, 32], [0, 12, 32]]]])
        >>> K.feature.LAFDescriptor(K.feature.SIFTDescriptor(41), 41)(torch.rand(1, 1, 64, 64), laf).shape
        torch.Size([1, 1, 128])
    """

    def __init__(
        self,
        patch_descriptor_module: Callable[[Tensor], Tensor] | None = None,
        patch_size: int = 32,
        grayscale_descriptor: bool = True,
    ) -> None:
        super().__init__()
        if patch_descriptor_module is not None:
            _check.function("LAFDescriptor", "patch_descriptor_module", patch_descriptor_module)
        _check.ints("LAFDescriptor", "patch_size", patch_size, 1)
        self.descriptor = HardNet(True) if patch_descriptor_module is None else patch_descriptor_module
        self.patch_size = patch_size
        self.grayscale_descriptor = grayscale_descriptor

    def extra_repr(self) -> str:
        return f"patch_size={self.patch_size}, grayscale_descriptor={self.grayscale_descriptor}"

    def forward(self, img: Tensor, lafs: Tensor) -> Tensor:
        return get_laf_descriptors(img, lafs, self.descriptor, self.patch_size, self.grayscale_descriptor)


# --- detectors with descriptors -------------------------------------------------------------------------------------


class LocalFeature(nn.Module):
    """Detect and describe features.

    Args:
        detector: a module from images and a mask or None to frames (B, N, 2, 3) and responses (B, N).
        descriptor: a module from images and frames to descriptors (B, N, D).
        scaling_coef: frames are multiplied by it before they are described, above 0.

    `forward(img, mask=None)` returns frames, responses and descriptors.

    Raises:
        TypeCheckError: `detector` or `descriptor` is no module or function, `scaling_coef` no number.
        ValueCheckError: `scaling_coef` is not above 0.

    Example:
        >>> import torch, kvision as K
        >>> F = K.feature
        >>> feature = F.LocalFeature(F.ScaleSpaceDetector(10), F.LAFDescriptor(F.SIFTDescriptor(32)))
        >>> [x.shape for x in feature(torch.rand(2, 1, 64, 64))]
        [torch.Size([2, 10, 2, 3]), torch.Size([2, 10]), torch.Size([2, 10, 128])]
    """

    def __init__(self, detector: nn.Module, descriptor: nn.Module, scaling_coef: float = 1.0) -> None:
        super().__init__()
        _check.function("LocalFeature", "detector", detector)
        _check.function("LocalFeature", "descriptor", descriptor)
        self.detector = detector
        self.descriptor = descriptor
        self.scaling_coef = _check.number("LocalFeature", "scaling_coef", scaling_coef)
        if self.scaling_coef <= 0:
            raise ValueCheckError(f"LocalFeature: expected scaling_coef above 0, got {scaling_coef!r}")

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        lafs, responses = self.detector(img, mask)
        lafs = scale_laf(lafs, self.scaling_coef)
        return lafs, responses, self.descriptor(img, lafs)


class _OfGrayImages(LocalFeature):
    """A combination that converts images of three channels to gray first."""

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        _check.images(type(self).__name__, "img", img)
        return super().forward(rgb_to_grayscale(floats(img)) if img.shape[1] == 3 else img, mask)


class _Magnitude(nn.Module):
    """The size of the difference of two Gaussians: both bright and dark blobs are features."""

    def __init__(self) -> None:
        super().__init__()
        self.dog = BlobDoGSingle(1.0, 1.6)

    def forward(self, input: Tensor) -> Tensor:
        return self.dog(input).abs()


class _SeveralOrientations(nn.Module):
    """The frames of a detector rotated to each of the two largest peaks of their gradients' directions.

    Of these it keeps the strongest, as many as the detector has slots. A second peak has 80% of the first one at least.
    """

    _peaks, _patch_size = 2, 19

    def __init__(self, detector: nn.Module) -> None:
        super().__init__()
        self.detector = detector

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor]:
        lafs, responses = self.detector(img, mask)
        patches = extract_patches_from_pyramid(img, lafs, self._patch_size).flatten(0, 1)
        angles = dominant_orientations(patches, self._peaks).reshape(*lafs.shape[:2], self._peaks)
        return orientation_slots(lafs, responses, angles)


class _SIFT(_OfGrayImages):
    """SIFT descriptors of a detector's frames, from patches or from a pyramid."""

    def __init__(
        self,
        detector: nn.Module,
        rootsift: bool,
        device: Device,
        backend: Backend,
        layout: Layout,
        scaling_coef: float = 1.0,
    ) -> None:
        op = type(self).__name__
        _check.choice(op, "descriptor_backend", backend, _BACKENDS)
        _check.choice(op, "descriptor_layout", layout, LAYOUTS)
        descriptor: nn.Module
        if backend == "pyramid":
            descriptor = SIFTDescriptorFromPyramid(rootsift=rootsift)
        else:
            descriptor = LAFDescriptor(SIFTDescriptor(41, rootsift=rootsift), 41)
        super().__init__(detector, descriptor, scaling_coef)
        self.descriptor_layout = layout
        self.to(_check.device(type(self).__name__, device) or "cpu")

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        lafs, responses, descriptors = super().forward(img, mask)
        if self.descriptor_layout == "opencv":
            descriptors = convert_sift_descriptor_layout(descriptors, "kornia", "opencv")
        return lafs, responses, descriptors


class SIFTFeature(_SIFT):
    """Extrema of differences of Gaussians that are not on edges, up to two orientations each, and SIFT descriptors.

    The scale space begins with the image at twice its size. A position whose gradients have two dominant directions
    takes two slots. Frames have the size of what is described: 9 times the blur of their level.

    With a `config` the features are those of Kornia's SIFTFeature instead: maxima on copies of the image in several
    sizes, with one orientation.

    With `opencv` they are those of cv2.SIFT_create(num_features): its way to double the image, which moves key points by
    a quarter of a pixel, its threshold of contrast, its windows in pixels of the scale space, and descriptors rounded to
    integers up to 255 where `rootsift` is off. Images are in [0, 1] or of uint8. A key point has up to four orientations.
    The scale of a frame is three times the size of cv2.KeyPoint, and its orientation is the angle there, negated.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        rootsift: compute RootSIFT.
        device: of the modules; None for the CPU.
        config: options of :class:`MultiResolutionDetector`; None for the scale space.
        compile_model: torch.compile the response.
        score_threshold: responses of features are above it.
        descriptor_backend: 'patch', or 'pyramid' for :class:`SIFTDescriptorFromPyramid`.
        descriptor_layout: 'kornia' or 'opencv', as in :func:`convert_sift_descriptor_layout`.
        opencv: find the features of cv2.SIFT; without a `config`, and with the backend 'patch'.

    Raises:
        ValueCheckError: `num_features` is below 1, a backend or layout unknown, or `opencv` does not have an option.

    Example:
        >>> import torch, kvision as K
        >>> lafs, responses, descriptors = K.feature.SIFTFeature(10)(torch.rand(2, 1, 64, 64))
        >>> descriptors.shape
        torch.Size([2, 10, 128])
    """

    def __init__(
        self,
        num_features: int = 8000,
        upright: bool = False,
        rootsift: bool = True,
        device: Device = None,
        config: Detector_config | None = None,
        compile_model: bool = False,
        score_threshold: float = 0.0,
        descriptor_backend: Backend = "patch",
        descriptor_layout: Layout = "kornia",
        opencv: bool = False,
    ) -> None:
        detector: nn.Module
        _check.ints("SIFTFeature", "num_features", num_features, 1)
        _check.flag("SIFTFeature", "opencv", opencv)
        upright = _check.switch("SIFTFeature", "upright", upright)
        rootsift = _check.switch("SIFTFeature", "rootsift", rootsift)
        compile_model = _check.switch("SIFTFeature", "compile_model", compile_model)
        if opencv:
            if config is not None or not isinstance(descriptor_backend, str) or descriptor_backend != "patch":
                raise ValueCheckError("SIFTFeature: opencv takes no config, and no descriptor_backend but 'patch'")
            detector, scale = OpenCVSIFT(num_features, upright, score_threshold), 1.0
        elif config is None:
            options = {"edge_threshold": 10.0, "score_threshold": score_threshold}
            detector = _dog_detector("SIFTFeature", num_features, ("resp",) if compile_model else False, **options)
            detector, scale = detector if upright else _SeveralOrientations(detector), 1.5
        else:
            detector, scale = (
                MultiResolutionDetector(
                    _Magnitude(),
                    num_features,
                    config,
                    ori_module=_orienter("SIFTFeature", upright),
                    compile_model=compile_model,
                    score_threshold=score_threshold,
                ),
                1.0,
            )
        super().__init__(detector, rootsift, device, descriptor_backend, descriptor_layout, scale)
        self.rootsift = rootsift

    def forward(self, img: Tensor, mask: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        if not isinstance(self.detector, OpenCVSIFT):
            return super().forward(img, mask)
        _check.images("SIFTFeature", "img", img)
        gray = rgb_to_grayscale(floats(img) / 255 if img.dtype == torch.uint8 else img) if img.shape[1] == 3 else img
        lafs, responses, descriptors = self.detector(gray, mask)
        if self.rootsift:
            descriptors = root_sift(descriptors)
        if self.descriptor_layout == "kornia":
            descriptors = convert_sift_descriptor_layout(descriptors, "opencv", "kornia")
        return lafs, responses, descriptors


def _dog_detector(op: str, num_features: int, compile_modules: bool | Collection[str], **modules: Any) -> nn.Module:
    """Extrema of differences of Gaussians over position and scale, from twice the image on."""
    _check.ints(op, "num_features", num_features, 1)
    return ScaleSpaceDetector(
        num_features,
        resp_module=BlobDoG(),
        subpix_module=ConvQuadInterp3d(),
        scale_pyr_module=ScalePyramid(3, 1.6, 32, double_image=True),
        scale_space_response=True,
        minima_are_also_good=True,
        compile_modules=compile_modules,
        **modules,
    )


def _keynet_detector(
    op: str, num_features: int, upright: bool, compile_model: bool, score_threshold: float, **modules: Any
) -> nn.Module:
    """Maxima of Key.Net's response, with OriNet's orientations."""
    _check.ints(op, "num_features", num_features, 1)
    return KeyNetDetector(
        True,
        num_features,
        ori_module=PassLAF() if _check.switch(op, "upright", upright) else LAFOrienter(angle_detector=OriNet(True)),
        compile_model=compile_model,
        score_threshold=score_threshold,
        **modules,
    )


class SIFTFeatureScaleSpace(_SIFT):
    """Extrema of differences of Gaussians over position and scale, dominant gradients and SIFT descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        rootsift: compute RootSIFT.
        device: of the modules; None for the CPU.
        compile_modules: as in :class:`ScaleSpaceDetector`.
        descriptor_backend: 'patch', or 'pyramid' for :class:`SIFTDescriptorFromPyramid`.
        descriptor_layout: 'kornia' or 'opencv', as in :func:`convert_sift_descriptor_layout`.

    Raises:
        ValueCheckError: an unknown backend or layout.

    Example:
        >>> import torch, kvision as K
        >>> lafs, responses, descriptors = K.feature.SIFTFeatureScaleSpace(10)(torch.rand(2, 1, 64, 64))
        >>> descriptors.shape
        torch.Size([2, 10, 128])
    """

    def __init__(
        self,
        num_features: int = 8000,
        upright: bool = False,
        rootsift: bool = True,
        device: Device = None,
        compile_modules: bool | Collection[str] = False,
        descriptor_backend: Backend = "patch",
        descriptor_layout: Layout = "kornia",
    ) -> None:
        op = "SIFTFeatureScaleSpace"
        detector = _dog_detector(op, num_features, compile_modules, ori_module=_orienter(op, upright))
        super().__init__(detector, rootsift, device, descriptor_backend, descriptor_layout)


class _WithHardNet(_OfGrayImages):
    def __init__(self, detector: nn.Module, device: Device, scaling_coef: float = 1.0) -> None:
        super().__init__(detector, LAFDescriptor(), scaling_coef)
        self.to(_check.device(type(self).__name__, device) or "cpu").eval()


def _orienter(op: str, upright: bool) -> nn.Module:
    return PassLAF() if _check.switch(op, "upright", upright) else LAFOrienter(19)


def _affine() -> nn.Module:
    return LAFAffNetShapeEstimator(True, preserve_orientation=False)


def _affine_detector(
    op: str, response: nn.Module, num_features: int, upright: bool, compile_modules: bool | Collection[str]
) -> nn.Module:
    _check.ints(op, "num_features", num_features, 1)
    return ScaleSpaceDetector(
        num_features,
        resp_module=response,
        scale_pyr_module=ScalePyramid(3, 1.6, 32, double_image=True, extra_levels=2),
        ori_module=_orienter(op, upright),
        aff_module=_affine(),
        compile_modules=compile_modules,
    )


class GFTTAffNetHardNet(_WithHardNet):
    """Shi-Tomasi corners over scales with AffNet's shapes, dominant gradients and HardNet's descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        device: of the modules; None for the CPU.
        compile_modules: as in :class:`ScaleSpaceDetector`.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.GFTTAffNetHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 8000,
        upright: bool = False,
        device: Device = None,
        compile_modules: bool | Collection[str] = False,
    ) -> None:
        op = "GFTTAffNetHardNet"
        super().__init__(_affine_detector(op, CornerGFTT(), num_features, upright, compile_modules), device)


class HesAffNetHardNet(_WithHardNet):
    """Hessian blobs over scales with AffNet's shapes, dominant gradients and HardNet's descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        device: of the modules; None for the CPU.
        compile_modules: as in :class:`ScaleSpaceDetector`.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.HesAffNetHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 2048,
        upright: bool = False,
        device: Device = None,
        compile_modules: bool | Collection[str] = False,
    ) -> None:
        op = "HesAffNetHardNet"
        super().__init__(_affine_detector(op, BlobHessian(), num_features, upright, compile_modules), device)


class DoGHardNet(_WithHardNet):
    """Extrema of differences of Gaussians with dominant gradients and HardNet's descriptors of twice their size.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        device: of the modules; None for the CPU.
        compile_modules: as in :class:`ScaleSpaceDetector`.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.DoGHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 2048,
        upright: bool = False,
        device: Device = None,
        compile_modules: bool | Collection[str] = False,
    ) -> None:
        orienter = _orienter("DoGHardNet", upright)
        detector = _dog_detector("DoGHardNet", num_features, compile_modules, ori_module=orienter)
        super().__init__(detector, device, scaling_coef=2.0)


class DoGAffNetHardNet(_WithHardNet):
    """Extrema of differences of Gaussians with AffNet's shapes, dominant gradients and HardNet's descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the dominant gradients.
        device: of the modules; None for the CPU.
        compile_modules: as in :class:`ScaleSpaceDetector`.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.DoGAffNetHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 2048,
        upright: bool = False,
        device: Device = None,
        compile_modules: bool | Collection[str] = False,
    ) -> None:
        modules = {"ori_module": _orienter("DoGAffNetHardNet", upright), "aff_module": _affine()}
        detector = _dog_detector("DoGAffNetHardNet", num_features, compile_modules, **modules)
        super().__init__(detector, device, scaling_coef=2.0)


class KeyNetHardNet(_WithHardNet):
    """Key.Net's features with OriNet's orientations and HardNet's descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the orientations.
        device: of the modules; None for the CPU.
        scale_laf: frames are multiplied by it before they are described.
        compile_model: torch.compile the response.
        score_threshold: responses of features are above it.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.KeyNetHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 8000,
        upright: bool = False,
        device: Device = None,
        scale_laf: float = 1.0,
        compile_model: bool = False,
        score_threshold: float = 0.0,
    ) -> None:
        detector = _keynet_detector("KeyNetHardNet", num_features, upright, compile_model, score_threshold)
        super().__init__(detector, device, scale_laf)


class KeyNetAffNetHardNet(_WithHardNet):
    """Key.Net's features with AffNet's shapes, OriNet's orientations and HardNet's descriptors.

    Args:
        num_features: slots of each image.
        upright: leave out the orientations.
        device: of the modules; None for the CPU.
        scale_laf: frames are multiplied by it before they are described.
        compile_model: torch.compile the response.
        score_threshold: responses of features are above it.

    Raises:
        RuntimeError: there are no weights on disk and no network.

    Example:
        >>> import torch, kvision as K
        >>> feature = K.feature.KeyNetAffNetHardNet(500)  # doctest: +SKIP
        >>> lafs, responses, descriptors = feature(torch.rand(2, 1, 64, 64))  # doctest: +SKIP
    """

    def __init__(
        self,
        num_features: int = 8000,
        upright: bool = False,
        device: Device = None,
        scale_laf: float = 1.0,
        compile_model: bool = False,
        score_threshold: float = 0.0,
    ) -> None:
        op, affine = "KeyNetAffNetHardNet", _affine()
        detector = _keynet_detector(op, num_features, upright, compile_model, score_threshold, aff_module=affine)
        super().__init__(detector, device, scale_laf)


# --- matches --------------------------------------------------------------------------------------------------------


class LocalFeatureMatcher(nn.Module):
    """Match the features of pairs of images.

    Args:
        local_feature: a module like :class:`LocalFeature`.
        matcher: a module from two sets of descriptors to distances (K, 1) and indices (K, 2), such as DescriptorMatcher;
            GeometryAwareDescriptorMatcher gets the frames, too.

    `forward(data)` takes a dict with `image0` and `image1` (B, C, H, W), and optionally `mask0` and `mask1`, or
    `lafs0` with `descriptors0` and `lafs1` with `descriptors1`. It returns a dict of the matches of all pairs, one
    after another: `keypoints0` and `keypoints1` (K, 2), `lafs0` and `lafs1` (1, K, 2, 3), `confidence` (K,), 1 less the
    distances, and `batch_indexes` (K,). Empty slots do not match.

    Raises:
        TypeCheckError: `local_feature` or `matcher` is no module or function, `data` no dict.
        ValueCheckError: `data` lacks an image and its features.
        ShapeError: the numbers of frames and of descriptors of an image differ.

    Example:
        >>> import torch, kvision as K
        >>> F = K.feature
        >>> matcher = F.LocalFeatureMatcher(F.SIFTFeature(20), F.DescriptorMatcher("mnn"))
        >>> image = torch.rand(2, 1, 64, 64)
        >>> matches = matcher({"image0": image, "image1": image})
        >>> bool((matches["keypoints0"] == matches["keypoints1"]).all())
        True
    """

    def __init__(self, local_feature: nn.Module, matcher: nn.Module) -> None:
        super().__init__()
        _check.function("LocalFeatureMatcher", "local_feature", local_feature)
        _check.function("LocalFeatureMatcher", "matcher", matcher)
        self.local_feature = local_feature
        self.matcher = matcher
        self.eval()

    def extract_features(self, image: Tensor, mask: Tensor | None = None) -> dict[str, Tensor]:
        """Detect and describe: a dict with `lafs`, `responses`, `descriptors`."""
        return dict(zip(("lafs", "responses", "descriptors"), self.local_feature(image, mask)))

    def no_match_output(self, device: Device, dtype: torch.dtype) -> dict[str, Tensor]:
        """The dict of no matches."""
        none = torch.empty(0, device=device, dtype=dtype)
        points, lafs = none.reshape(0, 2), none.reshape(1, 0, 2, 3)
        indices = torch.empty(0, device=device, dtype=torch.long)
        return {
            "keypoints0": points,
            "keypoints1": points.clone(),
            "lafs0": lafs,
            "lafs1": lafs.clone(),
            "confidence": none,
            "batch_indexes": indices,
        }

    def forward(self, data: dict[str, Tensor]) -> dict[str, Tensor]:
        if not isinstance(data, Mapping):
            raise TypeCheckError(f"LocalFeatureMatcher: expected data to be a dict, got {type(data).__name__}")
        lafs, descriptors = zip(*(self._features(data, i) for i in "01"))
        matches = []
        filled = [laf_is_filled(x) for x in lafs]
        for i in range(lafs[0].shape[0]):
            frames = [x[i][used[i]] for x, used in zip(lafs, filled)]
            vectors = [x[i][used[i]] for x, used in zip(descriptors, filled)]
            if not all(map(len, vectors)):
                continue
            aware = isinstance(self.matcher, GeometryAwareDescriptorMatcher)
            distances, index = self.matcher(*vectors, *(x[None] for x in frames if aware))
            pair = [x[index[:, k]] for k, x in enumerate(frames)]
            matches.append((*pair, 1 - distances.reshape(-1), torch.full_like(index[:, 0], i)))
        if not matches:
            return self.no_match_output(lafs[0].device, lafs[0].dtype)
        lafs0, lafs1, confidence, batch = (torch.cat(x) for x in zip(*matches))
        return {
            "keypoints0": get_laf_center(lafs0[None])[0],
            "keypoints1": get_laf_center(lafs1[None])[0],
            "lafs0": lafs0[None],
            "lafs1": lafs1[None],
            "confidence": confidence,
            "batch_indexes": batch,
        }

    def _features(self, data: dict[str, Tensor], i: str) -> tuple[Tensor, Tensor]:
        if f"lafs{i}" in data and f"descriptors{i}" in data:
            lafs, descriptors = data[f"lafs{i}"], data[f"descriptors{i}"]
        else:
            if f"image{i}" not in data:
                raise ValueCheckError(
                    f"LocalFeatureMatcher: expected data with image{i}, or lafs{i} and descriptors{i}, "
                    f"got {', '.join(map(str, data)) or 'nothing'}"
                )
            mask = data.get(f"mask{i}")
            if mask is not None and mask.dim() == 3:
                mask = mask[:, None]
            features = self.extract_features(data[f"image{i}"], mask)
            lafs, descriptors = features["lafs"], features["descriptors"]
        if lafs.shape[:2] != descriptors.shape[:2]:
            raise ShapeError(
                f"LocalFeatureMatcher: expected as many descriptors{i} as lafs{i}, got {tuple(descriptors.shape)} and "
                f"{tuple(lafs.shape)}"
            )
        return lafs, descriptors
