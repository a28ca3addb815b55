"""Elastic deformations of images."""

import pytest
import torch

import kvision as K

G = K.geometry

IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "elastic": (
        lambda x, n, s, a: G.elastic_transform2d(x, n, (3, 3), s, a),
        (IMAGE, IMAGE * 0.2, torch.tensor([1.0, 1.3]), torch.tensor([0.3, 0.4])),
    ),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.elastic_transform2d(X, X), ValueError, "elastic_transform2d: expected noise of shape"),
    (lambda: G.elastic_transform2d(X, X[:, :2], alpha=torch.ones(2, 2)), ValueError, "expected alpha of one or two numbers"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_one_noise_for_all_images(device):
    images, noise = torch.rand(3, 2, 7, 8, device=device), torch.rand(1, 2, 7, 8, device=device) - 0.5
    result = G.elastic_transform2d(images, noise, (3, 3), (2.0, 2.0))
    expected = G.elastic_transform2d(images, noise.expand(3, -1, -1, -1), (3, 3), (2.0, 2.0))
    torch.testing.assert_close(result, expected)
