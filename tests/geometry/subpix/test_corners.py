"""Corners between pixels: OpenCV's cornerSubPix, where corners really are, and gradients to the image."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

import kvision as K

G = K.geometry


def board(batch: int = 2, size: int = 96, noise: float = 0.01) -> tuple[Tensor, Tensor]:
    """Smooth pictures (B, 1, H, W) of turned chessboards and their inner corners (B, N, 2)."""
    random = torch.Generator().manual_seed(0)
    coords = G.create_meshgrid(size, size, normalized_coordinates=False, dtype=torch.float64)[0]
    images, corners = [], []
    for i in range(batch):
        angle, shift = 0.2 + 0.3 * i, torch.tensor([47.3 + i, 48.6])
        R = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=torch.float64)
        p = (coords - shift) @ R / 13.0  # squares of 13 pixels
        images.append((0.5 + 0.5 * torch.tanh(3 * torch.sin(math.pi * p)).prod(-1))[None])
        grid = torch.cartesian_prod(*(torch.arange(-2.0, 3.0, dtype=torch.float64),) * 2)
        corners.append(13 * grid @ R.T + shift)
    image = torch.stack(images)
    return image + noise * torch.randn(image.shape, generator=random, dtype=torch.float64), torch.stack(corners)


def test_equals_opencv(device: torch.device) -> None:
    cv2 = pytest.importorskip("cv2")
    image, truth = board()
    start = truth + 3 * torch.rand(truth.shape, generator=torch.Generator().manual_seed(1)).double() - 1.5
    byte = (255 * image.clamp(0, 1)).round().byte()
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    for radius in (4, 6):
        ours = G.refine_corners(byte.to(device), start.float().to(device), radius, 60, 1e-4).cpu()
        for i in range(2):
            theirs = start[i].numpy().astype(np.float32)
            cv2.cornerSubPix(byte[i, 0].numpy(), theirs, (radius, radius), (-1, -1), criteria)
            assert (ours[i] - torch.from_numpy(theirs)).abs().max() < 0.01
        assert (ours - truth).norm(dim=-1).mean() < 0.05
    back = G.refine_corners(image.to(device), ours.double().to(device), 6, 60, 1e-6).cpu()
    assert back.dtype == torch.float64 and (back - ours).abs().max() < 0.02


def test_no_corner_stays_where_it_is(device: torch.device) -> None:
    image = torch.zeros(1, 1, 40, 40, device=device)
    image[..., :20, :20] = image[..., 20:, 20:] = 1
    start = torch.tensor([[[18.0, 21.0], [6.0, 6.0], [19.0, 6.0], [60.0, 6.0], [math.nan, 3.0]]], device=device)
    image.requires_grad_()
    found, valid = G.refine_corners(image, start, return_valid=True)
    assert valid.tolist() == [[True, False, False, False, False]]  # flat, an edge, outside, no number
    torch.testing.assert_close(found[0, 0].cpu().detach(), torch.tensor([19.5, 19.5]), atol=1e-3, rtol=0)
    torch.testing.assert_close(found[:, 1:].detach(), start[:, 1:], equal_nan=True)
    (grad,) = torch.autograd.grad(found.nan_to_num().sum(), image)
    assert grad.isfinite().all()
    assert G.refine_corners(image[:0], start[:0]).shape == (0, 5, 2)


def test_gradients(device: torch.device) -> None:
    """The gradient of a fixed point against differences of refined corners."""
    image, truth = (t.to(device) for t in board(1, noise=0.0))
    change = torch.nn.functional.avg_pool2d(torch.rand(image.shape, dtype=torch.float64), 5, 1, 2).to(device)

    def found(image: Tensor) -> Tensor:
        return (G.refine_corners(image, truth, 5, 100, 1e-12) * torch.tensor([1.0, 0.5], device=device)).sum()

    (grad,) = torch.autograd.grad(found(image.requires_grad_()), image)
    with torch.no_grad():
        difference = (found(image + 1e-5 * change) - found(image - 1e-5 * change)) / 2e-5
    torch.testing.assert_close((grad * change).sum(), difference, rtol=1e-3, atol=1e-6)


def test_errors() -> None:
    image, corners = torch.rand(1, 1, 9, 9), torch.rand(1, 3, 2)
    with pytest.raises(ValueError, match="refine_corners: expected image"):
        G.refine_corners(image.expand(1, 3, 9, 9), corners)
    with pytest.raises(ValueError, match="refine_corners: expected corners"):
        G.refine_corners(image, corners[0])
    with pytest.raises(ValueError, match="refine_corners: expected radius"):
        G.refine_corners(image, corners, 0)
