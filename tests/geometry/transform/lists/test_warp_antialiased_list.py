"""Antialiased warps of lists of images: each image as by itself, equal sizes as a batch, and gradients to each image."""

from __future__ import annotations

import pytest
import torch

import kvision as K
import kvision.augmentation as A
from geometry.transform.lists.test_warp_list import SIZES, TYPES, one_by_one, pictures
from op_tests import assert_close


def shrinking(count, device):
    """Homographies to a half to a fifth, turned, of which the last one keeps all pixels."""
    scale = torch.tensor([[0.05, 0.1, 2], [0.1, 0.05, 2], [1e-3, 1e-3, 0]])
    matrices = torch.diag(torch.tensor([0.3, 0.4, 1.0])) + torch.randn(count, 3, 3) * scale
    matrices[-1] = torch.eye(3)
    return matrices.to(device)


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("padding", ["zeros", "border", "reflection", "fill"])
def test_samples_are_those_of_single_images(dtype, padding, device):
    images, matrices = pictures(device, dtype), shrinking(len(SIZES), device)
    options = {"dsize": (33, 37), "padding_mode": padding, "fill_value": 0.5, "antialias": True}
    results = K.geometry.warp_perspective(images, matrices, **options)
    assert torch.equal(results, one_by_one(K.geometry.warp_perspective, images, matrices, **options))
    with K.backend("reference"):
        expected = K.geometry.warp_perspective(images, matrices, **options)
    assert_close(expected, results, atol=1 if dtype == torch.uint8 else 2e-2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
def test_equal_sizes_have_the_bits_of_a_batch(dtype, device, backend):
    images, matrices = [x.contiguous() for x in pictures(device, dtype, [(60, 70)] * 6)], shrinking(6, device)
    corners = torch.tensor([[0.0, 0], [58, 0], [58, 66], [0, 66]], device=device) + torch.rand(6, 1, 2, device=device)
    results, expected = (
        [
            K.geometry.warp_perspective(x, matrices, (24, 31), antialias=True),
            K.geometry.warp_affine(x, matrices[:1, :2], (24, 31), padding_mode="border", antialias=True),
            K.geometry.crop_and_resize(x, corners, (12, 15), antialias=True),
        ]
        for x in (images, torch.stack(images))
    )
    for of_list, of_batch in zip(results, expected):  # the reference adds the taps of a batch in another order
        assert_close(of_list, of_batch, 0, 1e-5 if backend == "reference" else 0)


@pytest.mark.derivatives
def test_gradients(device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, ((7, 9), (8, 5), (2, 2)), 2)]
    matrices = shrinking(4, device)[:3].double().requires_grad_()
    fill = torch.tensor([0.3, 0.7], dtype=torch.float64, device=device, requires_grad=True)

    def warped(*tensors):
        *images, matrices, fill = tensors
        return K.geometry.warp_perspective(
            images, matrices, (3, 4), padding_mode="fill", fill_value=fill, antialias=True
        )

    assert torch.autograd.gradcheck(warped, (*images, matrices, fill), nondet_tol=1e-12)
    assert torch.autograd.gradgradcheck(lambda *t: warped(*t, matrices, 0.0), images, nondet_tol=1e-12)
    by_matrices = lambda m: warped(*(x.detach() for x in images), m, 0.0)  # noqa: E731
    (of_matrices,) = torch.autograd.grad(by_matrices(matrices).square().sum(), matrices, create_graph=True)
    assert all(map(torch.isfinite, torch.autograd.grad(of_matrices.sum(), matrices)[0].flatten()))


@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16], ids=str)
def test_gradients_are_those_of_single_images(dtype, padding, device):
    matrices, leaves = shrinking(len(SIZES), device), [x.requires_grad_() for x in pictures(device, dtype)]
    images = [*leaves[:-1], leaves[0]]  # the first image twice
    options = {"dsize": (13, 17), "padding_mode": padding, "antialias": True}
    results = [
        K.geometry.warp_perspective(images, matrices, **options),
        one_by_one(K.geometry.warp_perspective, images, matrices, **options),
    ]
    weights = torch.rand_like(results[0])
    gradients = [torch.autograd.grad((y * weights).sum(), leaves[:-1]) for y in results]
    assert_close(*gradients, **({"atol": 2e-2} if dtype == torch.float16 else {"atol": 1e-6}))


@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_gradients_of_turned_images_are_those_of_the_reference(dtype, padding, device):
    """Of a list and of a batch, by affine maps: on CUDA they are gathered, in tiles of two sizes."""
    sizes = ((40, 56), (64, 31), (97, 130), (7, 1))
    matrices = shrinking(len(sizes), device)[:, :2].to(dtype)
    for images in (pictures(device, dtype, sizes), [torch.rand(4, 3, 97, 130, dtype=dtype, device=device)]):
        leaves = [x.requires_grad_() for x in images]

        def gradients(leaves=leaves):
            x = leaves if len(leaves) > 1 else leaves[0]
            y = K.geometry.warp_affine(x, matrices, (37, 45), padding_mode=padding, antialias=True)
            return torch.autograd.grad((y * torch.linspace(-1, 1, 45, dtype=dtype, device=device)).sum(), leaves)

        with K.backend("reference"):
            expected = gradients()
        assert_close(gradients(), expected, 1e-5, 1e-9 if dtype == torch.float64 else 2e-4)


def test_images_that_need_no_gradient_get_none(device):
    images = pictures(device)
    images[1].requires_grad_()
    K.geometry.warp_perspective(images, shrinking(len(SIZES), device), (13, 17), antialias=True).sum().backward()
    assert [x.grad is not None for x in images] == [False, True, False, False, False]


@pytest.mark.parametrize("change", [A.RandomAffine, A.RandomPerspective, "once"], ids=["affine", "perspective", "once"])
def test_gradients_of_results_of_different_sizes_are_those_of_single_images(change, device):
    if change == "once":
        chain = (
            A.RandomHorizontalFlip(),
            A.RandomAffine(20.0, antialias=True),
            A.RandomPerspective(antialias=True, p=0.7),
        )
        augmentation = A.ImageSequential(*chain, resample="once")
    else:
        augmentation = change(0.5, antialias=True) if change is A.RandomPerspective else change(20.0, antialias=True)
    images = [x.requires_grad_() for x in pictures(device)]
    seeds = torch.arange(len(images), device=device)
    results = augmentation(images, seed=seeds)
    weights = [torch.rand_like(y) for y in results]
    found = torch.autograd.grad(results, images, weights)
    for b, (x, weight) in enumerate(zip(images, weights)):
        own = augmentation(x[None], seed=seeds[b : b + 1])
        assert_close(found[b], torch.autograd.grad(own, x, weight[None])[0], 0, 1e-5)


def test_more_images_than_a_launch_takes(device):
    images = [torch.full((1, 2, 1 + i % 3), float(i), device=device) for i in range(1030)]
    results = K.geometry.warp_affine(images, torch.eye(2, 3)[None], (1, 1), antialias=True)
    assert torch.equal(results.flatten().cpu(), torch.arange(1030.0))
