"""Letterboxes and padded batches, against the arithmetic of Ultralytics' LetterBox and against single images."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from geometry.transform.lists.test_warp_list import SIZES, pictures
from kvision.core.exceptions import TypeCheckError
from op_tests import assert_close


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_letterbox(dtype, device):
    images, (h, w) = pictures(device, dtype), (48, 64)
    boxed = K.geometry.letterbox(images, (h, w))
    fill = 114 if dtype == torch.uint8 else 114 / 255
    for b, x in enumerate(images):
        height, width = x.shape[1:]
        ratio = min(h / height, w / width)
        inner_w, inner_h = max(1, round(width * ratio)), max(1, round(height * ratio))
        left, top = round((w - inner_w) / 2 - 0.1), round((h - inner_h) / 2 - 0.1)
        expected = torch.full((3, h, w), fill, dtype=dtype, device=device)
        expected[:, top : top + inner_h, left : left + inner_w] = K.geometry.resize(x, (inner_h, inner_w))
        assert_close(boxed.images[b], expected, atol=1 if dtype == torch.uint8 and device.type == "cuda" else None)
        corners = torch.tensor([[0.0, 0], [width, height]], device=device) * boxed.scale[b] + boxed.offset[b]
        assert_close(corners.cpu(), torch.tensor([[left, top], [left + inner_w, top + inner_h]]).float())
    batch = torch.stack(pictures(device, dtype, [(20, 30)] * 2))
    assert torch.equal(K.geometry.letterbox(batch, 40).images, K.geometry.letterbox(list(batch), 40).images)


def test_pad_to_batch(device):
    images = pictures(device)
    batch, sizes = K.geometry.pad_to_batch(images, multiple=16, fill_value=0.25)
    assert batch.shape == (len(SIZES), 3, 48, 64)
    assert sizes.tolist() == [list(size) for size in SIZES]
    for x, padded in zip(images, batch):
        expected = torch.full_like(padded, 0.25)
        expected[:, : x.shape[1], : x.shape[2]] = x
        assert torch.equal(padded, expected)
    with pytest.raises(TypeCheckError, match="expected images to be a list of Tensors"):
        K.geometry.pad_to_batch(tuple(images))


@pytest.mark.derivatives
def test_gradients(device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, ((3, 4), (5, 2)), 2)]
    assert torch.autograd.gradcheck(lambda *t: K.geometry.letterbox(list(t), 6).images, images)
    assert torch.autograd.gradcheck(lambda *t: K.geometry.pad_to_batch(list(t), 4).images, images)
