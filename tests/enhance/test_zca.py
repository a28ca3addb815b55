"""ZCA: what whitening does to a covariance, and gradients where eigenvalues are equal."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from op_tests import assert_close

E = K.enhance


@pytest.mark.parametrize("dim", [0, 1, -1])
def test_whitened_features_are_uncorrelated(dim, device):
    x = torch.randn(60, 3, 2, dtype=torch.float64, device=device).cumsum(1).movedim(0, dim)
    y = E.zca_whiten(x, dim, eps=1e-12).movedim(dim, 0).flatten(1)
    assert_close(y.T.cov(), torch.eye(6, dtype=torch.float64, device=device))
    assert_close(y.mean(0), torch.zeros(6, dtype=torch.float64, device=device))


def test_inverse(device):
    x = torch.randn(30, 4, dtype=torch.float64, device=device)
    transform, _, inverse = E.zca_mean(x, return_inverse=True)
    assert_close(transform @ inverse, torch.eye(4, dtype=torch.float64, device=device))
    assert E.zca_mean(x)[2] is None


@pytest.mark.derivatives
@pytest.mark.parametrize("samples", [8, 3], ids=["full rank", "fewer samples than features"])
def test_derivatives(samples, device):
    x = torch.randn(samples, 4, dtype=torch.float64, device=device, requires_grad=True)

    def both(x):
        transform, mean, inverse = E.zca_mean(x, eps=0.1, return_inverse=True)
        return transform, mean, inverse

    assert torch.autograd.gradcheck(both, (x,))
    assert torch.autograd.gradgradcheck(both, (x,))


def test_gradient_where_eigenvalues_are_equal(device):
    x = torch.cat([torch.eye(3), -torch.eye(3)]).double().to(device).requires_grad_()
    f = lambda x: E.zca_whiten(x, eps=0.1).pow(3).sum()  # noqa: E731
    (grad,) = torch.autograd.grad(f(x), x)
    assert grad.isfinite().all()
    assert torch.autograd.gradcheck(f, (x,))
    assert_close(torch.func.grad(f)(x), grad)


def test_module(device):
    x = torch.randn(20, 3, 2, device=device)
    whiten = E.ZCAWhitening(compute_inv=True)
    y = whiten(x, include_fit=True)
    assert_close(y, E.zca_whiten(x), 1e-4, 1e-5)
    assert_close(whiten.inverse_transform(y), x, 1e-3, 1e-4)
    fresh = E.ZCAWhitening(compute_inv=True)
    fresh.load_state_dict(whiten.state_dict())
    assert fresh.fitted and torch.equal(fresh(x), y)
    assert not E.ZCAWhitening().fit(x.requires_grad_()).transform_matrix.requires_grad
    assert E.ZCAWhitening(detach_transforms=False).fit(x).transform_matrix.requires_grad


def test_halves_and_integers(device):
    x = torch.randn(40, 4, device=device)
    whitened = E.zca_whiten(x.half())
    assert whitened.dtype == torch.float16
    assert_close(whitened, E.zca_whiten(x.half().float()).half(), 5e-3, 5e-3)
    assert E.zca_whiten((10 * x).int()).dtype == torch.float32


@pytest.mark.derivatives
def test_forward_mode_and_hessians(device):
    x, v = torch.rand(2, 6, 3, dtype=torch.float64, device=device)

    def loss(x):
        return E.zca_whiten(x, eps=0.1).pow(3).sum()

    step = 1e-6
    _, tangent = torch.func.jvp(E.zca_whiten, (x,), (v,))
    assert_close(tangent, (E.zca_whiten(x + step * v) - E.zca_whiten(x - step * v)) / (2 * step), 1e-6, 1e-6)
    expected = torch.autograd.functional.hessian(loss, x)
    assert_close(torch.func.hessian(loss)(x), expected, 1e-9, 1e-9)
    assert_close(torch.func.jacrev(torch.func.grad(loss))(x), expected, 1e-9, 1e-9)


def test_data_far_from_zero(device):
    """The rounding of the mean is no part of the covariance, nor of the whitened data."""
    x = (torch.rand(200, 3, device=device) * torch.tensor([1.0, 0.2, 0.02], device=device) + 30000).requires_grad_()
    wide = x.detach().double().requires_grad_()
    whitened, expected = K.enhance.zca_whiten(x), K.enhance.zca_whiten(wide)
    assert (whitened - expected).abs().max() < 1e-4
    transform, exact = K.enhance.zca_mean(x)[0], K.enhance.zca_mean(wide)[0]
    assert (transform - exact).abs().max() < 1e-4 * exact.abs().max()
    weights = torch.rand(200, 3, device=device)
    (gradient,), (wide_gradient,) = (
        torch.autograd.grad((y * weights.to(y)).sum(), z) for y, z in ((whitened, x), (expected, wide))
    )
    assert (gradient - wide_gradient).abs().max() < 1e-3 * wide_gradient.abs().max()
