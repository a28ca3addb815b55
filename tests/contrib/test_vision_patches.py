"""Model inputs: the values of transformers, lists, the kernel against the operators that define it, gradients, errors."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.contrib.vision_patches import LAYOUTS
from op_tests import assert_close
from tests.contrib import vision_patches_values as peer

vision_patches = K.contrib.vision_patches
module = sys.modules[vision_patches.__module__]


def random_image(*shape: int, dtype: torch.dtype = torch.uint8, device: Any = "cpu") -> Tensor:
    x = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(sum(shape)))
    return (x if dtype == torch.uint8 else x.to(dtype) / 255).to(device)


@pytest.mark.parametrize("i", range(len(peer.CASES)))
def test_values_of_transformers(i, device):
    """Within a level of 255; committed values, see vision_patches_values.py."""
    layout, size, options = peer.CASES[i]
    expected = json.loads(peer.FILE.read_text())[i]
    image = peer.image(*size).to(device)
    patches, grids, mask = vision_patches(image, layout, mean=0, std=1, **options)
    assert grids.tolist() == expected["grid"] and grids.device.type == "cpu"
    if mask is not None:
        assert mask.sum().item() == expected["count"]
        assert not patches[~mask].any()
        patches = patches[:, : expected["count"]]
    levels = patches * 255
    assert_close(peer.sampled(levels).cpu(), torch.tensor(expected["levels"]).float(), 0, 1.001)
    assert abs(levels.mean().item() - expected["mean"]) < 0.05


@pytest.mark.parametrize("layout", LAYOUTS)
def test_normalization_is_that_of_the_model(layout, device):
    x = random_image(3, 60, 90, device=device)
    plain, _, mask = vision_patches(x, layout, mean=0, std=1)
    patches = vision_patches(x, layout).patches
    model = LAYOUTS[layout]
    mean, std = torch.tensor(model.mean, device=device), torch.tensor(model.std, device=device)
    if mask is not None:
        plain, patches = plain[mask].reshape(-1, 256, 3), patches[mask].reshape(-1, 256, 3)
    else:
        plain, patches = (p.reshape(-1, 3, 392).transpose(1, 2) for p in (plain, patches))
    assert_close(patches, (plain - mean) / std, 1e-5, 1e-5)


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_lists_are_their_images(layout, dtype, device):
    """Of any sizes and layouts: also a view of interleaved pixels, a slice, and one image twice."""
    x = random_image(3, 70, 101, dtype=dtype, device=device)
    interleaved = random_image(41, 160, 3, dtype=dtype, device=device).permute(2, 0, 1)
    images = [x, interleaved, random_image(3, 300, 40, dtype=dtype, device=device)[:, 3:, 1::2], x]
    patches, grids, mask = vision_patches(images, layout, dtype=torch.bfloat16)
    single = [vision_patches(image.contiguous(), layout, dtype=torch.bfloat16) for image in images]
    assert_close(patches, torch.cat([s.patches for s in single]))
    assert torch.equal(grids, torch.cat([s.grids for s in single]))
    assert mask is None or torch.equal(mask, torch.cat([s.mask for s in single]))
    assert patches.dtype == torch.bfloat16


@pytest.mark.parametrize("size", [(1, 7), (2, 40), (5, 300), (37, 41), (50, 64), (200, 130), (700, 33)], ids=str)
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32], ids=str)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_kernel_is_its_definition(channels, dtype, size, device, monkeypatch):
    """In a level of bytes, whose weights have 16 bits, or 11 on CUDA; few pixels differ at all."""
    x = random_image(channels, *size, dtype=dtype, device=device)
    calls = [
        {"temporal_patch_size": 1, "patch_size": 4, "merge_size": 3},
        {"min_pixels": 100, "max_pixels": 5000, "patch_size": 7},
        {"layout": "siglip2", "max_num_patches": 50, "patch_size": 5},
        {"layout": "siglip2", "max_num_patches": 9},
    ]
    for call in calls:
        monkeypatch.undo()
        actual = vision_patches(x, mean=0, std=1, **call)
        monkeypatch.setattr(module, "_serves", lambda *_: False)
        expected = vision_patches(x, mean=0, std=1, **call)
        assert torch.equal(actual.grids, expected.grids)
        assert actual.mask is None or torch.equal(actual.mask, expected.mask)
        if dtype == torch.float32:
            assert_close(actual.patches, expected.patches, 1e-5, 1e-5)
        else:
            apart = (actual.patches - expected.patches).abs() * 255
            # Patches round halves up, the operators to even: sizes of small ratios have many.
            assert apart.max() < 2.01 and (apart > 0.01).float().mean() < 0.12
            assert (apart > 1.01).float().mean() < 2e-3


def test_halves_round_up(backend, device):
    if backend == "reference":
        pytest.skip("torch's sums of floats are not exact")
    x = random_image(3, 408, 32)
    doubled = x.int()
    for dim in (2, 1):
        at = torch.arange(2 * doubled.shape[dim])
        far = (at // 2 + at % 2 * 2 - 1).clamp(0, doubled.shape[dim] - 1)
        doubled = (3 * doubled.index_select(dim, at // 2) + doubled.index_select(dim, far) + 2) // 4
    actual, expected = (vision_patches(y.to(device), "siglip2") for y in (x, doubled.byte()))
    assert torch.equal(actual.grids, expected.grids)
    assert torch.equal(actual.patches, expected.patches)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_gradients(layout, device):
    """Those of a linear map: <f(u) - f(0), g> = <u, f'(g)>, for each image of a list, also one that is in it twice."""
    images = [random_image(3, n, 50, dtype=torch.float64, device=device).requires_grad_() for n in (30, 47)]
    options = {"min_pixels": 784, "max_pixels": 3000} if layout == "qwen2_vl" else {"max_num_patches": 9}
    batch = [*images, images[0]]
    patches = vision_patches(batch, layout, mean=0, std=0.5, **options).patches
    grad = torch.rand(patches.shape, dtype=patches.dtype, device=device)
    (patches * grad).sum().backward()
    total = sum((x * x.grad).sum() for x in images)
    assert_close(total.float(), (patches.detach() * grad).sum(), 1e-4, 1e-3)


@pytest.mark.parametrize("shape", [(3, 40, 60), (1, 3, 40, 60), (2, 3, 40, 60), (0, 3, 40, 60)], ids=str)
def test_shapes(shape, device):
    x = random_image(*shape, dtype=torch.float32, device=device)
    count = 1 if len(shape) == 3 else shape[0]
    patches, grids, mask = vision_patches(x)
    assert patches.shape == (count * 24, 1176) and grids.shape == (count, 3) and mask is None
    patches, grids, mask = vision_patches(x, "siglip2", max_num_patches=20)
    assert patches.shape == (count, 20, 768) and grids.shape == (count, 2) and mask.shape == (count, 20)
    assert (
        x.dim() == 3 or count < 2 or torch.equal(patches[1], vision_patches(x[1], "siglip2", max_num_patches=20)[0][0])
    )


IMAGE = torch.zeros(3, 40, 40)


@pytest.mark.parametrize(
    "images, options, error, message",
    [
        ([], {}, ValueError, "at least one image"),
        ((IMAGE, IMAGE), {}, TypeError, "expected images to be a Tensor"),
        ([IMAGE[0]], {}, ValueError, r"images\[0\] of shape \(C, H, W\)"),
        ([IMAGE, IMAGE[:, :0]], {}, ValueError, r"images\[1\] with H, W of at least 1"),
        ([IMAGE, IMAGE[:2]], {}, ValueError, "got 3 and, at 1, 2"),
        ([IMAGE, IMAGE.byte()], {}, TypeError, "got torch.float32 and, at 1, torch.uint8"),
        (IMAGE.int(), {}, TypeError, "floating point or uint8"),
        (IMAGE[:1], {}, ValueError, "one for each of 1 channels"),
        ([IMAGE, torch.zeros(3, 1, 201)], {}, ValueError, "200 times as long as wide.*of image 1"),
        (IMAGE, {"layout": "clip"}, ValueError, "qwen2_vl, siglip2"),
        (IMAGE, {"max_num_patches": 4}, TypeError, "no max_num_patches with layout 'qwen2_vl'"),
        (IMAGE, {"layout": "siglip2", "merge_size": 4}, TypeError, "no merge_size"),
        (IMAGE, {"patch_size": 0}, ValueError, "patch_size"),
        (IMAGE, {"min_pixels": 100, "max_pixels": 99}, ValueError, "at most max_pixels 99"),
        (IMAGE, {"std": 0}, ValueError, "std above 0"),
        (IMAGE, {"dtype": torch.uint8}, TypeError, "expected dtype"),
    ],
)
def test_errors(images, options, error, message):
    with pytest.raises(error, match=f"vision_patches: .*{message}"):
        vision_patches(images, **options)
