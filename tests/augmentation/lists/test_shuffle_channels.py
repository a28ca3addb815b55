"""Channels of the images of a list in another order: the bits of indexing, from any strides."""

import pytest
import torch

from kvision.augmentation.lists.shuffle_channels import shuffle_channels_list

TYPES = (torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64)


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("layout", ["planar", "interleaved", "sliced"])
def test_channels_are_copied(dtype, layout, device):
    images = [(255 * torch.rand(4, h, w, device=device)).to(dtype) for h, w in ((1, 1), (65, 97), (7, 300), (31, 2))]
    if layout == "interleaved":
        images = [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in images]
    elif layout == "sliced":
        images = [x.repeat(1, 2, 2)[:, ::2, ::2] for x in images]
    orders = torch.stack([torch.randperm(4) for _ in images]).to(device)
    for of_each in (orders, orders[:1]):
        results = shuffle_channels_list(images, of_each)
        assert all(torch.equal(y, x[order]) for y, x, order in zip(results, images, of_each.expand(4, 4)))


def test_gradients_go_back(device):
    images = [
        torch.rand(3, 5, 6, device=device, requires_grad=True),
        torch.rand(3, 2, 1, device=device, requires_grad=True),
    ]
    orders = torch.tensor([[2, 0, 1], [1, 0, 2]], device=device)
    weights = [torch.rand_like(x) for x in images]
    loss = sum((w * y).sum() for w, y in zip(weights, shuffle_channels_list(images, orders)))
    for order, w, gradient in zip(orders, weights, torch.autograd.grad(loss, images)):
        assert torch.equal(gradient[order], w)
