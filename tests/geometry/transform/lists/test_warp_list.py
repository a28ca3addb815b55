"""Warps of lists of images: each image as by itself, equal sizes as a batch, and gradients to each image."""

from __future__ import annotations

import pytest
import torch

import kvision as K
from kvision.core.exceptions import DeviceError, ShapeError, TypeCheckError, ValueCheckError
from op_tests import assert_close

SIZES = ((20, 30), (41, 17), (5, 64), (1, 1), (12, 9))
TYPES = (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.uint8)


def pictures(device, dtype=torch.float32, sizes=SIZES, channels=3):
    """Images of different sizes and layouts: planes, rows of a larger image, interleaved pixels and a part of these."""
    images = []
    for i, (h, w) in enumerate(sizes):
        pixels = torch.randint(0, 256, (channels, h, w + 2), device=device)
        image = pixels.to(dtype) if dtype == torch.uint8 else (pixels / 255).to(dtype)
        if i % 2:
            image = image.permute(1, 2, 0).contiguous().permute(2, 0, 1)
        images.append(image[..., 1:-1] if i % 3 else image[..., 2:].clone())
    return images


def homographies(count, device):
    scale = torch.tensor([[0.05, 0.05, 2], [0.05, 0.05, 2], [1e-3, 1e-3, 0]])
    return (torch.eye(3) + torch.randn(count, 3, 3) * scale).to(device)


def one_by_one(function, images, *parameters, **options):
    samples = zip(images, *(p.split(1) for p in parameters))
    return torch.cat([function(x[None], *rest, **options) for x, *rest in samples])


@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("mode", ["bilinear", "nearest", "bicubic"])
def test_samples_are_those_of_single_images(dtype, mode, device):
    images, matrices = pictures(device, dtype), homographies(len(SIZES), device)
    for padding in ("zeros", "border", "reflection", "fill"):
        options = {"dsize": (33, 37), "mode": mode, "padding_mode": padding, "fill_value": 0.5}
        results = K.geometry.warp_perspective(images, matrices, **options)
        assert torch.equal(results, one_by_one(K.geometry.warp_perspective, images, matrices, **options))
    with K.backend("reference"):
        assert_close(
            K.geometry.warp_perspective(images, matrices, **options), results, atol=1 if dtype == torch.uint8 else 2e-2
        )


def test_equal_sizes_have_the_bits_of_a_batch(device):
    for dtype in (torch.float32, torch.uint8):
        images = [x.contiguous() for x in pictures(device, dtype, [(40, 50)] * 6)]
        matrices = homographies(6, device)
        corners = (
            torch.tensor([[0.0, 0], [20, 0], [20, 30], [0, 30]], device=device) + torch.rand(6, 1, 2, device=device) * 9
        )
        results, expected = (
            [
                K.geometry.warp_perspective(x, matrices, (24, 31), "bicubic"),
                K.geometry.warp_affine(x, matrices[:1, :2], (24, 31), "nearest"),
                K.geometry.crop_and_resize(x, corners, (24, 31)),
                K.geometry.center_crop(x, (25, 31)),
                K.geometry.center_crop(x, (24, 30)),
            ]
            for x in (images, torch.stack(images))
        )
        assert all(map(torch.equal, results, expected))


@pytest.mark.derivatives
@pytest.mark.parametrize("padding", ["fill", "border"])
def test_gradients(padding, device):
    images = [x.detach().requires_grad_() for x in pictures(device, torch.float64, ((3, 4), (5, 2), (2, 2)), 2)]
    matrices = homographies(3, device).double().requires_grad_()
    fill = torch.tensor([0.3, 0.7], dtype=torch.float64, device=device, requires_grad=True)

    def warped(*tensors, matrices=matrices, fill=fill):
        return K.geometry.warp_perspective(list(tensors), matrices, (6, 7), "bicubic", padding, fill_value=fill)

    inputs = (*images, matrices) if padding == "border" else (*images, matrices, fill)
    by_tensors = lambda *t: warped(*t[:3], matrices=t[3], fill=t[4] if len(t) > 4 else fill)  # noqa: E731
    assert torch.autograd.gradcheck(by_tensors, inputs, nondet_tol=1e-12)
    with torch.no_grad():
        fixed = matrices.clone()
    assert torch.autograd.gradgradcheck(lambda *t: warped(*t, matrices=fixed, fill=0.0), images, nondet_tol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16], ids=str)
def test_gradients_are_those_of_single_images(dtype, device):
    matrices = homographies(len(SIZES), device)
    for padding in ("zeros", "border"):
        leaves = [x.requires_grad_() for x in pictures(device, dtype)]
        images = [*leaves[:-1], leaves[0]]  # the first image twice
        results = [
            K.geometry.warp_perspective(images, matrices, (33, 37), "bilinear", padding),
            one_by_one(K.geometry.warp_perspective, images, matrices, dsize=(33, 37), padding_mode=padding),
        ]
        weights = torch.rand_like(results[0])
        gradients = [torch.autograd.grad((y * weights).sum(), leaves[:-1]) for y in results]
        assert_close(*gradients, **({"atol": 2e-2} if dtype == torch.float16 else {"atol": 1e-4}))


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("count", [1, len(SIZES)], ids=["one matrix", "one of each"])
def test_gradients_of_matrices_are_those_of_single_images(count, antialias, device):
    images, matrices = pictures(device), homographies(count, device).requires_grad_()
    fill = torch.rand(3, device=device, requires_grad=True)
    options = {"dsize": (33, 37), "padding_mode": "fill", "fill_value": fill, "antialias": antialias}
    warp, each = K.geometry.warp_perspective, matrices.expand(len(SIZES), -1, -1)
    results = warp(images, matrices, **options), one_by_one(warp, images, each, **options)
    weights = torch.rand_like(results[0])
    for weight in (weights, weights.contiguous(memory_format=torch.channels_last)):
        gradients = [torch.autograd.grad(y, (matrices, fill), weight, retain_graph=True) for y in results]
        for found, expected in zip(*gradients):
            assert_close(found, expected, rtol=0, atol=2e-6 * float(expected.abs().max()))


@pytest.mark.parametrize("antialias", [False, True])
def test_gradients_of_equal_sizes_have_the_bits_of_a_batch(antialias, device, backend):
    images = [x.contiguous().requires_grad_() for x in pictures(device, sizes=[(40, 50)] * 6)]
    matrices = homographies(6, device)[:, :2].requires_grad_()
    batch = torch.stack(images).detach().requires_grad_()
    results = [K.geometry.warp_affine(x, matrices, (24, 31), antialias=antialias) for x in (images, batch)]
    weights = torch.rand_like(results[0])
    *found, of_matrices = torch.autograd.grad(results[0], (*images, matrices), weights)
    expected, matrices_expected = torch.autograd.grad(results[1], (batch, matrices), weights)
    tolerance = 1e-5 if backend == "reference" else 0
    assert_close(torch.stack(found), expected, 0, tolerance)
    assert_close(of_matrices, matrices_expected, 0, tolerance * float(matrices_expected.abs().max()))


def test_more_images_than_a_launch_takes(device):
    images = [torch.full((1, 2, 1 + i % 3), float(i), device=device) for i in range(1030)]
    results = K.geometry.warp_affine(images, torch.eye(2, 3)[None], (1, 1))
    assert torch.equal(results.flatten().cpu(), torch.arange(1030.0))


@pytest.mark.parametrize("antialias", [False, True])
def test_gradients_of_more_images_than_a_launch_takes(antialias, device):
    images = [torch.rand(1, 3, 2 + i % 3, device=device, requires_grad=True) for i in range(1030)]
    matrices = homographies(len(images), device).requires_grad_()
    results = K.geometry.warp_perspective(images, matrices, (2, 3), antialias=antialias)
    weights = torch.rand_like(results)
    *found, of_matrices = torch.autograd.grad(results, (*images, matrices), weights)
    for b in (0, 511, 512, 1023, 1024, 1029):
        own = K.geometry.warp_perspective(images[b][None], matrices[b : b + 1], (2, 3), antialias=antialias)
        expected, of_matrix = torch.autograd.grad(own, (images[b], matrices), weights[b : b + 1])
        assert_close(found[b], expected, 0, 1e-6)
        assert_close(of_matrices[b], of_matrix[b], rtol=1e-4, atol=1e-5 * float(of_matrix.abs().max()))


def test_integers_are_moved_exactly(device):
    images = [torch.randint(0, 2**40, (2, h, w), device=device) for h, w in SIZES]
    results = K.geometry.center_crop(images, (6, 6), "nearest")
    assert results.dtype == torch.int64
    assert torch.equal(results, one_by_one(K.geometry.center_crop, images, size=(6, 6), mode="nearest"))


def test_bad_lists_are_named():
    image, warp = torch.rand(3, 4, 5), K.geometry.warp_affine
    for images, error, message in (
        ([], ShapeError, "expected src with at least one image, got an empty list"),
        ([image, torch.rand(1, 4, 5)], ShapeError, "expected src with one number of channels, got 3 and, at 1, 1"),
        (
            [image, image.double()],
            TypeCheckError,
            "expected src of one type, got torch.float32 and, at 1, torch.float64",
        ),
        ([image, image.to("meta")], DeviceError, "expected src on one device, got cpu and, at 1, meta"),
        ([image, torch.rand(3, 0, 5)], ShapeError, r"expected src\[1\] with H, W of at least 1"),
        ([image, image[None]], ShapeError, r"expected src\[1\] of shape \(C, H, W\)"),
        ([image, 1], TypeCheckError, r"expected src\[1\] to be a Tensor"),
        ((image, image, image), TypeCheckError, "expected src to be a Tensor"),
    ):
        with pytest.raises(error, match=message):
            warp(images, torch.eye(2, 3)[None], (2, 2))
    with pytest.raises(ShapeError, match="batch size of 1 or 2"):
        warp([image, image], torch.eye(2, 3)[None].expand(3, 2, 3), (2, 2))
    with pytest.raises(ValueCheckError, match="a list takes no box_indices"):
        K.geometry.crop_and_resize([image], torch.rand(1, 4, 2), (2, 2), box_indices=torch.zeros(1, dtype=torch.int64))


def test_transforms_are_refused(backend):
    if backend == "reference":
        pytest.skip("plain torch has them")
    images, eye = [torch.rand(3, 4, 5), torch.rand(3, 6, 5)], torch.eye(2, 3)[None]
    with pytest.raises(NotImplementedError, match="no vmap"):
        torch.func.vmap(lambda m: K.geometry.warp_affine(images, m[None], (2, 2)))(eye.expand(3, 2, 3))
    with pytest.raises(NotImplementedError, match="no forward mode"):
        torch.func.jvp(lambda m: K.geometry.warp_affine(images, m, (2, 2)), (eye,), (eye,))


@pytest.mark.tracing
def test_compiles_twice_at_most_a_length(device):
    from torch._dynamo.testing import CompileCounter

    counter = CompileCounter()
    torch._dynamo.reset()
    warp = torch.compile(lambda x, m: K.geometry.warp_affine(x, m, (4, 5)), fullgraph=True, backend=counter)
    matrix = torch.eye(2, 3, device=device)[None]
    for sizes in (((20, 30), (41, 17), (5, 64)), ((12, 9), (21, 18), (15, 33)), ((8, 28), (51, 40), (6, 7))):
        images = pictures(device, sizes=sizes)
        assert torch.equal(warp(images, matrix), K.geometry.warp_affine(images, matrix, (4, 5)))
    assert counter.frame_count <= 2


@pytest.mark.skipif(not torch.cuda.is_available(), reason="CUDA graphs")
def test_a_captured_graph_keeps_its_list():
    device = torch.device("cuda")
    images, matrices = pictures(device), homographies(len(SIZES), device)

    def call():
        return K.geometry.warp_perspective(images, matrices, (33, 37))

    call()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        captured = call()
    K.geometry.warp_perspective(pictures(device), matrices, (33, 37))  # another table in between
    for x in images:
        x.mul_(0.5)
    graph.replay()
    assert torch.equal(captured, call())
