"""ZCA whitening: the whitening transform that is closest to the identity."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.compiler import is_compiling

from kvision import _check
from kvision._dtype import as_dtype, compute_dtype
from kvision._ops import without_autocast_and_tf32
from kvision._torch_compat import carry_tangents, function_caller, in_function_transform
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


class _Root(torch.autograd.Function):
    """The square root R of a symmetric matrix without negative eigenvalues, and its inverse.

    The gradient of an eigendecomposition is infinite where eigenvalues are equal; that of a root is not. It solves
    R X + X R = G, and so does the gradient of that, hence derivatives of every order.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(a: Tensor, eps: float) -> tuple[Tensor, Tensor]:
        values, vectors = torch.linalg.eigh(a)
        root = (values.clamp(min=0) + eps).sqrt()
        return (vectors * root) @ vectors.mT, (vectors / root) @ vectors.mT

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
        ctx.save_for_backward(*output)
        ctx.save_for_forward(*output)

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, _: None) -> tuple[Tensor, Tensor]:
        root, inverse = ctx.saved_tensors
        root_tangent = _Solution.apply(root, tangent)
        return root_tangent, -inverse @ root_tangent @ inverse

    @staticmethod
    def backward(ctx: Any, grad_root: Tensor, grad_inverse: Tensor) -> tuple[Tensor, None]:
        root, inverse = ctx.saved_tensors
        return _Solution.apply(root, grad_root - inverse @ grad_inverse @ inverse), None


_apply_root = function_caller(_Root)


def _root(a: Tensor, eps: float) -> tuple[Tensor, Tensor]:
    if is_compiling() and carry_tangents(a):
        raise NotImplementedError(
            "zca_mean: torch.compile does not see its forward mode; call torch.func.jvp outside of the graph"
        )
    apply = _Root.apply if is_compiling() or in_function_transform() else _apply_root
    return apply(a, eps)


class _Solution(torch.autograd.Function):
    """X with R X + X R = G, for a symmetric positive R."""

    generate_vmap_rule = True

    @staticmethod
    def forward(root: Tensor, g: Tensor) -> Tensor:
        values, vectors = torch.linalg.eigh(root)
        inner = vectors.mT @ g @ vectors
        return vectors @ (inner / (values[:, None] + values)) @ vectors.mT

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
        ctx.save_for_backward(inputs[0], output)
        ctx.save_for_forward(inputs[0], output)

    @staticmethod
    def jvp(ctx: Any, root_tangent: Tensor | None, tangent: Tensor | None) -> Tensor:
        root, x = ctx.saved_tensors
        g = torch.zeros_like(x) if tangent is None else tangent
        if root_tangent is not None:
            g = g - root_tangent @ x - x @ root_tangent
        return _Solution.apply(root, g)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
        root, x = ctx.saved_tensors
        y = _Solution.apply(root, grad)
        return -(y @ x.mT + x.mT @ y), y


def zca_mean(
    inp: Tensor, dim: int = 0, unbiased: bool = True, eps: float = 1e-6, return_inverse: bool = False
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Compute the ZCA transform of data: the inverse square root of its covariance.

    Args:
        inp: data of any shape; integers are computed in float32.
        dim: the axis of the samples; the D entries of the others are the features.
        unbiased: divide the covariance by the number of samples less one.
        eps: added to the eigenvalues of the covariance.
        return_inverse: give the inverse of the transform, too.

    Returns:
        The symmetric transform (D, D), the mean (1, D), and the inverse (D, D) or None. Differentiable to any order,
        also where eigenvalues are equal. Half types give float32.

    Raises:
        TypeCheckError: inp is not a real tensor; another argument of the wrong type.
        IndexError: inp has no axis dim.
        ShapeError: no sample, or with unbiased only one.

    Source: A. J. Bell and T. J. Sejnowski, "The independent components of natural scenes are edge filters" (1997).

    Example:
        >>> import torch, kvision as K
        >>> transform, mean, _ = K.enhance.zca_mean(torch.tensor([[0., 1.], [1., 0.], [-1., 0.], [0., -1.]]))
        >>> transform
        tensor([[1.2247, 0.0000],
                [0.0000, 1.2247]])
    """
    _check.numbers("zca_mean", "inp", inp)
    dim = _axis("zca_mean", inp, dim)
    _check.flag("zca_mean", "unbiased", unbiased)
    eps = _check.number("zca_mean", "eps", eps, minimum=0)
    _check.flag("zca_mean", "return_inverse", return_inverse)
    if inp.shape[dim] < 1 + unbiased:
        raise ShapeError(f"zca_mean: expected at least {1 + unbiased} samples along axis {dim}, got {tuple(inp.shape)}")
    samples = as_dtype(inp, compute_dtype(inp)).movedim(dim, 0)
    samples = samples.reshape(samples.shape[0], samples.shape[1:].numel())
    inverse, mean, root = _inverse_root(samples, samples.shape[0] - int(unbiased), eps)
    return inverse, mean, root if return_inverse else None


@without_autocast_and_tf32
def _inverse_root(samples: Tensor, count: int, eps: float) -> tuple[Tensor, Tensor, Tensor]:
    mean = samples.mean(0, keepdim=True)
    centered = samples - mean
    centered = centered - centered.mean(0, keepdim=True)  # what the mean lost where it was rounded
    root, inverse = _root(centered.mT @ centered / count, eps)
    return inverse, mean, root


def zca_whiten(inp: Tensor, dim: int = 0, unbiased: bool = True, eps: float = 1e-6) -> Tensor:
    """Make the features of data uncorrelated and of variance 1, with the transform of `zca_mean`.

    Args:
        inp: data of any shape; integers are computed in float32.
        dim: the axis of the samples; the entries of the others are the features.
        unbiased: divide the covariance by the number of samples less one.
        eps: added to the eigenvalues of the covariance.

    Returns:
        The whitened data, of the shape of inp.

    Raises:
        TypeCheckError, IndexError, ShapeError: as :func:`zca_mean`.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.zca_whiten(torch.tensor([[0., 1.], [1., 0.], [-1., 0.], [0., -1.]]))
        tensor([[ 0.0000,  1.2247],
                [ 1.2247,  0.0000],
                [-1.2247,  0.0000],
                [ 0.0000, -1.2247]])
    """
    _check.numbers("zca_whiten", "inp", inp)
    transform, mean, _ = zca_mean(inp, dim, unbiased, eps)
    whitened = linear_transform(inp, transform, mean, dim)
    return whitened - whitened.mean(dim, keepdim=True)  # 0, but for the rounding of the mean


def linear_transform(inp: Tensor, transform_matrix: Tensor, mean_vector: Tensor, dim: int = 0) -> Tensor:
    """Subtract a mean from every sample and multiply by a matrix: (x - mean) @ transform.

    Args:
        inp: data of any shape; integers are computed in float32.
        transform_matrix: (D, D), D being the number of features.
        mean_vector: (1, D).
        dim: the axis of the samples; the entries of the others are the features.

    Returns:
        The transformed data, of the shape of inp; differentiable in all three tensors.

    Raises:
        TypeCheckError: an argument is not a real tensor; dim not an int.
        IndexError: inp has no axis dim.
        ShapeError: matrix or mean does not fit the data.
        DeviceError: the tensors are on different devices; parameters in CPU memory are moved.

    Example:
        >>> import torch, kvision as K
        >>> K.enhance.linear_transform(torch.ones(1, 2), 3 * torch.eye(2), torch.tensor([[0.0, 1.0]]))
        tensor([[3., 0.]])
    """
    _check.numbers("linear_transform", "inp", inp)
    dim = _axis("linear_transform", inp, dim)
    samples = as_dtype(inp, compute_dtype(inp))
    samples = samples if dim == 0 else samples.movedim(dim, 0)
    features = samples.shape[1:].numel()
    _check.shape("linear_transform", "transform_matrix", transform_matrix, features, features)
    _check.shape("linear_transform", "mean_vector", mean_vector, 1, features)
    transform_matrix = _check.to_device_of("linear_transform", inp, "transform_matrix", transform_matrix, of="inp")
    mean_vector = _check.to_device_of("linear_transform", inp, "mean_vector", mean_vector, of="inp")
    rows = samples if samples.dim() == 2 else samples.reshape(-1, features)
    y = _transformed(rows, as_dtype(transform_matrix, samples.dtype), as_dtype(mean_vector, samples.dtype))
    y = y if y.dim() == inp.dim() else y.reshape(samples.shape)
    return as_dtype(y if dim == 0 else y.movedim(0, dim), inp.dtype if inp.is_floating_point() else torch.float32)


@without_autocast_and_tf32
def _transformed(rows: Tensor, matrix: Tensor, mean: Tensor) -> Tensor:
    return (rows - mean) @ matrix


class _NoAxisError(ValueCheckError, IndexError):
    """An axis that a tensor has not, where torch raises IndexError."""


def _axis(op: str, inp: Tensor, dim: int) -> int:
    dim = _check.scalar(op, "dim", dim)
    if not _check.is_int(dim):
        raise TypeCheckError(f"{op}: expected dim to be an int, got {dim!r}", actual_type=type(dim))
    if not -inp.dim() <= dim < inp.dim():
        raise _NoAxisError(f"{op}: expected dim to be an axis of {inp.dim()}, got {dim}")
    return dim % inp.dim()


class ZCAWhitening(nn.Module):
    """Learn a ZCA transform from data, and apply it.

    Args:
        dim: the axis of the samples; the entries of the others are the features.
        eps: added to the eigenvalues of the covariance.
        unbiased: divide the covariance by the number of samples less one.
        detach_transforms: learn without gradient.
        compute_inv: learn the inverse, too.

    The buffers mean_vector, transform_matrix and transform_inv are None until `fit`, and part of the state dict after it.

    Example:
        >>> import torch, kvision as K
        >>> x = torch.rand(20, 3)
        >>> whiten = K.enhance.ZCAWhitening(compute_inv=True).fit(x)
        >>> torch.allclose(whiten.inverse_transform(whiten(x)), x, atol=1e-4)
        True
    """

    def __init__(
        self,
        dim: int = 0,
        eps: float = 1e-6,
        unbiased: bool = True,
        detach_transforms: bool = True,
        compute_inv: bool = False,
    ) -> None:
        super().__init__()
        self.dim = dim
        self.eps = eps
        self.unbiased = unbiased
        self.detach_transforms = detach_transforms
        self.compute_inv = compute_inv
        for name in ("mean_vector", "transform_matrix", "transform_inv"):
            self.register_buffer(name, None)
        self.register_load_state_dict_pre_hook(_make_buffers)

    def extra_repr(self) -> str:
        return f"dim={self.dim}, eps={self.eps}, unbiased={self.unbiased}"

    @property
    def fitted(self) -> bool:
        """Whether there is a transform."""
        return self.transform_matrix is not None

    def fit(self, x: Tensor) -> ZCAWhitening:
        """Learn mean and transform of the data, and return the module."""
        transform, mean, inverse = zca_mean(x, self.dim, self.unbiased, self.eps, self.compute_inv)
        if self.detach_transforms:
            transform, mean, inverse = transform.detach(), mean.detach(), None if inverse is None else inverse.detach()
        self.transform_matrix, self.mean_vector, self.transform_inv = transform, mean, inverse
        return self

    def forward(self, x: Tensor, include_fit: bool = False) -> Tensor:
        """Whiten the data; with include_fit, fit to them first. RuntimeError without any fit."""
        if include_fit:
            self.fit(x)
        self._need_fit()
        return linear_transform(x, self.transform_matrix, self.mean_vector, self.dim)

    def inverse_transform(self, x: Tensor) -> Tensor:
        """Undo `forward`. RuntimeError without fit or without compute_inv."""
        self._need_fit()
        if self.transform_inv is None:
            raise RuntimeError("ZCAWhitening: there is no inverse without compute_inv=True")
        shift = -self.mean_vector @ self.transform_matrix
        return linear_transform(x, self.transform_inv, shift, self.dim)

    def _need_fit(self) -> None:
        if not self.fitted:
            raise RuntimeError("ZCAWhitening: call fit first, or give include_fit=True")


def _make_buffers(module: nn.Module, state_dict: dict[str, Tensor], prefix: str, *_: Any) -> None:
    """Create buffers before a state is loaded: a module that was not fitted has none."""
    for name in ("mean_vector", "transform_matrix", "transform_inv"):
        if prefix + name in state_dict and getattr(module, name) is None:
            setattr(module, name, torch.empty_like(state_dict[prefix + name]))
