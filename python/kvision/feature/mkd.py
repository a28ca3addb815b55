"""Multiple-kernel descriptors of patches."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args

import torch
import torch.nn.functional as F
from torch import Tensor

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._torch_compat import ConstantModule
from kvision.core.exceptions import ValueCheckError
from kvision.feature._patch_gradient import check_patches, patch_gradients, to_polar
from kvision.feature._weights import Weights, read_weights
from kvision.filters import gaussian_blur2d

__all__ = ["MKDDescriptor"]

KernelType: TypeAlias = Literal["cart", "polar", "concat"]
Whitening: TypeAlias = Literal["lw", "pca", "pcawt", "pcaws"]
_WHITENINGS = get_args(Whitening)
TrainingSet: TypeAlias = Literal["liberty", "notredame", "yosemite"]
_TRAINING_SETS = get_args(TrainingSet)
# Fourier coefficients of von Mises kernels: of concentration 1 with one frequency, of 8 with two and three.
_COEFFICIENTS = {
    "xy": (0.38214156, 0.48090413),
    "polar": (0.14343168, 0.268285, 0.21979234),
    "angle": (0.14343168, 0.268285, 0.21979234, 0.15838885),
}
_KERNELS: dict[KernelType, tuple[str, ...]] = {"cart": ("cart",), "polar": ("polar",), "concat": ("polar", "cart")}
_EPSILON = 1e-8
_ATTENUATION = 0.7  # of eigenvalues, by pcawt
_SHRINKAGE = 40  # the eigenvalue that pcaws shrinks others with


def _embedding(x: Tensor, coefficients: tuple[float, ...], dim: int) -> Tensor:
    """Features of angles whose products are values of a von Mises kernel: a constant, cosines, sines, along `dim`."""
    frequencies = range(1, len(coefficients))
    parts = [torch.full_like(x, math.sqrt(coefficients[0]))]
    parts += [math.sqrt(coefficients[k]) * (k * x).cos() for k in frequencies]
    parts += [math.sqrt(coefficients[k]) * (k * x).sin() for k in frequencies]
    return torch.stack(parts, dim)


def _positions(n: int, kernel: str) -> tuple[Tensor, Tensor]:
    """Features (n * n, d) of the pixels of a patch, weighted by a Gaussian, and the angles (n, n) of the pixels."""
    device = torch.get_default_device()
    device = torch.device("cpu") if device.type == "meta" else device  # a state dict does not have these
    options: dict[str, Any] = dict(dtype=torch.float64, device=device)
    u = torch.linspace(-1, 1, n, **options) if n > 1 else torch.zeros(1, **options)
    y, x = torch.meshgrid(u, u, indexing="ij")
    radius, angle = (x * x + y * y + _EPSILON).sqrt(), torch.atan2(y, x)
    if kernel == "cart":
        first, second, coefficients = x * (math.pi / 2), y * (math.pi / 2), _COEFFICIENTS["xy"]
    else:
        first, second, coefficients = angle, radius * (math.pi / math.sqrt(2)), _COEFFICIENTS["polar"]
    a, b = (_embedding(t.flatten(), coefficients, 1) for t in (first, second))
    window = (-((radius / radius.max()) ** 2)).exp().flatten()[:, None, None]
    return (a[:, :, None] * b[:, None, :] * window).flatten(1), angle


class MKDDescriptor(ConstantModule):
    """Multiple-kernel descriptors of square gray patches.

    The gradients of a patch, blurred a little, are compared by a kernel on their angle and one on their position, in
    Cartesian coordinates, in polar ones with angles relative to the direction from the center, or in both. The
    descriptor is an explicit feature map of the kernel, whitened by statistics of a training set; its length is 1.

    Args:
        patch_size: side of the patches in pixels.
        kernel_type: 'cart', 'polar' or 'concat', both.
        whitening: 'pca', 'pcawt' (attenuated), 'pcaws' (shrunk), 'lw' (learned), or None.
        training_set: 'liberty', 'notredame' or 'yosemite'.
        output_dims: length of whitened descriptors, at most 63 for 'cart', 175 for 'polar' and 238 for 'concat'.
        pretrained: the whitening. True takes the published file from torch.hub's folder or downloads it; otherwise the
            path of that file, or what it holds: {training set: {'pca' or 'lw': {'mean', 'eigvecs', 'eigvals'}}}.

    Returns:
        Of patches (B, 1, patch_size, patch_size), descriptors (B, output_dims), of the same dtype; without whitening
        (B, 63), (B, 175) or (B, 238).

    Raises:
        TypeError: an argument is of the wrong type; the patches are not tensors of real numbers.
        ValueError: an unknown name; patches of another shape; a number is out of range.
        RuntimeError: the published file cannot be downloaded; the message says where to put it.

    Source: A. Mukundan, G. Tolias, A. Bursuc, H. Jegou, O. Chum, "Understanding and improving kernel local descriptors"
    (2019).

    Example:
        >>> import torch, kvision as K
        >>> K.feature.MKDDescriptor(32, "polar", whitening=None)(torch.rand(5, 1, 32, 32)).shape
        torch.Size([5, 175])
    """

    angles: Tensor
    mean: Tensor
    projection: Tensor

    def __init__(
        self,
        patch_size: int = 32,
        kernel_type: KernelType = "concat",
        whitening: Whitening | None = "pcawt",
        training_set: TrainingSet = "liberty",
        output_dims: int = 128,
        pretrained: Weights = True,
    ) -> None:
        super().__init__()
        op = "MKDDescriptor"
        _check.ints(op, "patch_size", patch_size, 1)
        _check.choice(op, "kernel_type", kernel_type, tuple(_KERNELS))
        _check.choice(op, "training_set", training_set, _TRAINING_SETS)
        _check.ints(op, "output_dims", output_dims, 1)
        self.patch_size = patch_size
        self.kernel_type = kernel_type
        self.whitening = whitening
        self.training_set = training_set
        size = 0
        for kernel in _KERNELS[kernel_type]:
            features, angles = _positions(patch_size, kernel)
            self.register_buffer(f"{kernel}_positions", features.float(), persistent=False)
            if kernel == "polar":
                self.register_buffer("angles", angles.float(), persistent=False)
            size += (2 * len(_COEFFICIENTS["angle"]) - 1) * features.shape[1]
        self.output_dims = size if whitening is None else min(output_dims, size)
        if whitening is not None:
            _check.choice(op, "whitening", whitening, _WHITENINGS)
            model = _whitening_model(pretrained, kernel_type, training_set, "lw" if whitening == "lw" else "pca", size)
            mean, projection = _whitening(model, whitening, self.output_dims)
            self.register_buffer("mean", mean)
            self.register_buffer("projection", projection)

    def extra_repr(self) -> str:
        return (
            f"patch_size={self.patch_size}, kernel_type={self.kernel_type!r}, whitening={self.whitening!r}, "
            f"training_set={self.training_set!r}, output_dims={self.output_dims}"
        )

    def forward(self, patches: Tensor) -> Tensor:
        x = check_patches("MKDDescriptor", "patches", patches, self.patch_size)
        constants = self.get_buffer(f"{_KERNELS[self.kernel_type][0]}_positions")
        _check.same_device("MKDDescriptor", patches=patches, constants=constants)
        image = as_dtype(x, compute_dtype(x))
        sigma = 1.4 * self.patch_size / 64
        blurred = gaussian_blur2d(image, (5, 5), (sigma, sigma), "replicate")
        gx, gy = (-2 * g for g in patch_gradients(blurred, sobel=False))
        magnitude, angle = to_polar(gx, gy, _EPSILON)
        magnitude = torch.where(magnitude == 0, math.sqrt(_EPSILON), magnitude)
        weights = (magnitude + _EPSILON).sqrt()[:, None]
        parts = []
        for kernel in _KERNELS[self.kernel_type]:
            relative = angle - as_dtype(self.angles, angle.dtype) if kernel == "polar" else angle
            gradients = _embedding(relative, _COEFFICIENTS["angle"], 1) * weights
            positions = as_dtype(self.get_buffer(f"{kernel}_positions"), angle.dtype)
            parts.append(F.normalize((gradients.flatten(2) @ positions).flatten(1), dim=1))
        descriptors = F.normalize(torch.cat(parts, 1), dim=1)
        if self.whitening is not None:
            descriptors = (descriptors - as_dtype(self.mean, angle.dtype)) @ as_dtype(self.projection, angle.dtype)
            if self.whitening == "pca":  # the power law
                descriptors = descriptors.sign() * (descriptors.abs() + 1e-12).sqrt()
            descriptors = F.normalize(descriptors, dim=1)
        return as_dtype(descriptors, x.dtype)


def _whitening_model(
    pretrained: Weights, kernel_type: KernelType, training_set: TrainingSet, kind: str, size: int
) -> Mapping[str, Tensor]:
    """The statistics of descriptors of a training set."""
    models = read_weights("MKDDescriptor", f"MKDDescriptor-{kernel_type}", pretrained)
    try:
        model: Mapping[str, Tensor] = models[training_set][kind]
        sizes = [tuple(model[name].shape) for name in ("mean", "eigvecs", "eigvals")]
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueCheckError(
            f"MKDDescriptor: expected pretrained to have mean, eigvecs and eigvals of {training_set!r}, {kind!r}"
        ) from error
    if sizes != [(size,), (size, size), (size,)]:
        raise ValueCheckError(f"MKDDescriptor: expected pretrained for descriptors of {size} numbers, got {sizes}")
    return model


def _whitening(model: Mapping[str, Tensor], whitening: str, size: int) -> tuple[Tensor, Tensor]:
    """The mean, and the projection (size of the descriptor, `size`) after it."""
    mean, vectors, values = (model[name].float() for name in ("mean", "eigvecs", "eigvals"))
    projection = vectors[:, :size]
    if whitening == "pcawt":
        projection = projection * values[:size] ** (-_ATTENUATION / 2)
    elif whitening == "pcaws":
        alpha = values[_SHRINKAGE]
        projection = projection * ((1 - alpha) * values[:size] + alpha) ** -0.5
    return mean, projection
