"""Registration of images."""

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from op_tests import assert_close

G = K.geometry

X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.ImageRegistrator("affine"), ValueError, "ImageRegistrator: model_type must be one of"),
    (lambda: G.ImageRegistrator(G.Homography()), ValueError, "ImageRegistrator: expected a warper"),
    (lambda: G.ImageRegistrator().register(X, X[:1]), ValueError, "ImageRegistrator: expected images of one shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


def blobs(size: int, device: torch.device) -> Tensor:
    picture = torch.zeros(1, 1, size, size, device=device)
    generator = torch.Generator().manual_seed(3)
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, size, device=device)] * 2, indexing="ij")
    for cx, cy, height in (torch.rand(12, 3, generator=generator) * 1.6 - 0.8).tolist():
        picture += height * torch.exp(-25 * ((x - cx) ** 2 + (y - cy) ** 2))
    return picture


@pytest.mark.parametrize("model", ["translation", "similarity", "homography"])
def test_registration_finds_the_transform(model, device):
    source = blobs(64, device)
    truth = torch.eye(3, device=device)[None]
    truth[0, :2, 2] = torch.tensor([0.06, -0.04])
    if model == "similarity":
        truth[0, :2, :2] *= 1.05
    if model == "homography":
        truth[0, 0, 1], truth[0, 1, 0], truth[0, 2, 0] = 0.04, -0.04, 0.01
    target = G.homography_warp(source, truth, (64, 64))
    rate = 2e-3 if model == "homography" else 5e-3
    registrator = G.ImageRegistrator(model, pyramid_levels=3, lr=rate, num_iterations=80, tolerance=0).to(device)
    result, levels = registrator.register(source, target, output_intermediate_models=True)
    corners = torch.tensor([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], device=device).T
    moved, expected = result[0] @ corners, truth[0] @ corners
    error = (moved[:2] / moved[2] - expected[:2] / expected[2]).norm(dim=0).mean() * 32
    assert len(levels) == 3
    assert error < 0.5  # pixels
    there_and_back = registrator.model() @ registrator.model.forward_inverse()
    assert_close(there_and_back / there_and_back[:, 2:, 2:], torch.eye(3, device=device)[None], 0, 1e-5)
    inside = (slice(None), slice(None), slice(8, -8), slice(8, -8))
    assert (registrator.warp_src_into_dst(source) - target)[inside].abs().mean() < 0.02
    assert (registrator.warp_dst_into_src(target) - source)[inside].abs().mean() < 0.02


def test_registration_with_any_loss(device):
    """Losses that are not computed in one pass are computed step by step, with the same result.

    The model shows the middle of the image: at its border rounding would decide which pixels are inside.
    """
    source, target = blobs(48, device), blobs(48, device).roll((1, 2), (2, 3))
    model = torch.diag(torch.tensor([0.9, 0.9, 1.0], device=device))[None]
    fused = G.ImageRegistrator().get_single_level_loss(source, target, model)
    plain = G.ImageRegistrator(loss_fn=lambda a, b, reduction: F.l1_loss(a, b, reduction=reduction))
    assert_close(plain.get_single_level_loss(source, target, model), fused)
