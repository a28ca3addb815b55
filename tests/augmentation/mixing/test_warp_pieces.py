"""Passes that read pieces of images where these are, against the same passes on images that are pasted first."""

import pytest
import torch

import kvision as K
from drawn_tests import UNSERVED, assert_equal_params, call_unserved, has_kernels, random_images, record_kernel
from kvision.augmentation import warp_and_color
from op_tests import assert_close

A = K.augmentation

MIXES = {
    "mosaic": lambda p: A.RandomMosaic(p=p),
    "mosaic of six": lambda p: A.RandomMosaic(mosaic_grid=(3, 2), start_ratio_range=(0.0, 1.0), p=p),
    "cutmix": lambda p: A.RandomCutMixV2(num_mix=2, p=p),
    "jigsaw": lambda p: A.RandomJigsaw((4, 2), p=p),
    "patches": lambda p: A.PatchMix(patch_size=11, p=p),
    "jigsaw of many": lambda p: A.RandomJigsaw((8, 10), p=p),  # more pieces than the kernel reads
}
PASSES = {
    "perspective, jiggle": lambda: [A.RandomPerspective(0.5, p=1.0), A.ColorJiggle(0.0, 0.0, 0.5, 0.1)],
    "perspective": lambda: [A.RandomPerspective(0.4, p=0.7)],
    "affine, gamma, normalize": lambda: [
        A.RandomAffine(180.0, (0.2, 0.2), (0.15, 2.0), p=1.0),  # some of which read too many pixels for shared memory
        A.RandomGamma((0.8, 1.2)),
        A.Normalize((0.5, 0.4, 0.3), (0.2, 0.3, 0.4)),
    ],
    "affine of the border": lambda: [A.RandomAffine(30.0, padding_mode="border", p=1.0), A.RandomGrayscale(p=0.5)],
    "crop, contrast": lambda: [A.RandomResizedCrop((40, 72)), A.ColorJitter(0.2, 0.2, 0.2, 0.1)],
    "nearest": lambda: [A.RandomRotation(90.0, resample="nearest", p=1.0)],
    "filled crop": lambda: [A.RandomCrop((70, 100), padding=9, fill=0.5)],
}
SIZES = {"even": (96, 160), "odd": (72, 90)}
RESULTS = {"bytes": {}, "float16": {"output_dtype": torch.float16, "memory_format": torch.channels_last}}


@pytest.fixture
def kernel_calls(monkeypatch):
    return record_kernel(monkeypatch, warp_and_color, "_on_pieces")


def images(device, dtype=torch.float32, size="even", layout=torch.contiguous_format):
    x = random_images((6, 3, *SIZES[size]), device, torch.float32)
    x = torch.nn.functional.avg_pool2d(x, 5, 1, 2)  # photographs change less than noise
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    return x.contiguous(memory_format=layout)


def both_ways(augment, x, kernel_calls, seed=5):
    results = []
    for reads in (False, True):
        kernel_calls[1].append(reads)
        y = augment(x, seed=seed)
        results.append((y, augment.transform_matrix, augment._params))
    return results


def assert_same(results, dtype, device):
    (y, matrix, params), (fused, fused_matrix, fused_params) = results
    tolerances = {torch.float32: 2e-5, torch.float16: 2e-3, torch.bfloat16: 2e-2}
    assert fused.dtype == y.dtype and fused.stride() == y.stride()
    assert_close(fused, y, 0.0, tolerances[dtype] if device.type == "cuda" else 0.0)
    if matrix is not None:
        assert_close(fused_matrix, matrix, 0.0, 0.0)
    assert_equal_params(fused_params, params)


@pytest.mark.parametrize("warp", PASSES)
@pytest.mark.parametrize("mix", MIXES)
def test_pieces_are_read_as_if_pasted(mix, warp, device, backend, kernel_calls):
    augment, x = A.AugmentationSequential(MIXES[mix](0.8), *PASSES[warp](), data_keys=["input"]), images(device)
    if mix == "jigsaw of many":
        x = x.repeat(1, 1, 2, 1)[..., :160, :]
    results = both_ways(augment, x, kernel_calls)
    assert bool(kernel_calls[0]) == has_kernels(device, backend)
    assert_same(results, x.dtype, device)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
def test_types_and_layouts(dtype, size, layout, device, kernel_calls):
    augment = A.ImageSequential(MIXES["mosaic"](1.0), *PASSES["perspective, jiggle"]())
    x = images(device, dtype, size, layout)
    assert_same(both_ways(augment, x, kernel_calls), dtype, device)


@pytest.mark.parametrize("result", RESULTS)
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("size", SIZES)
def test_bytes(size, layout, result, device, kernel_calls):
    """CUDA warps batches in fixed point and pieces in floats, and colors may triple the level that these differ by.

    So the warps are compared with each other, and colors with those of what the same warp has rounded.
    """
    x, options = images(device, torch.uint8, size, layout), RESULTS[result]
    mosaic, (perspective, jiggle) = MIXES["mosaic"](1.0), PASSES["perspective, jiggle"]()
    results = both_ways(A.ImageSequential(mosaic, perspective, jiggle, **options), x, kernel_calls)
    if device.type != "cuda":
        return assert_same(results, x.dtype, device)
    warps = both_ways(A.ImageSequential(mosaic, perspective), x, kernel_calls)
    for (warped, _, drawn), (y, _, params) in zip(warps, results):
        assert_equal_params(params[:2], drawn)
        expected = A.ImageSequential(jiggle, **options)(warped, params=[params[2]._replace(name="ColorJiggle_0")])
        assert y.stride() == expected.stride()
        assert_close(y, expected, 0.0, 1.0 if y.dtype == torch.uint8 else 2e-3)
    error = (warps[0][0].float() - warps[1][0].float()).abs()
    # Where they are up to .02 levels apart before rounding, 4% of values may be rounded to another level.
    assert error.max() <= 1 and error.mean() <= 0.04


def test_pixels_that_are_no_numbers(device, kernel_calls):
    """A tap of weight 0 contributes nothing, even if it is inf or NaN."""
    x = images(device)
    x[1, :, 40:44, 60], x[2, 1, 10, 10:90], x[3, :, -1] = torch.inf, torch.nan, -torch.inf
    augment = A.ImageSequential(MIXES["mosaic"](1.0), A.RandomAffine(0.0, (0.1, 0.1), p=1.0))
    (y, *_), (fused, *_) = both_ways(augment, x, kernel_calls)
    finite = y.isfinite()
    assert torch.equal(finite, fused.isfinite()) and 0 < finite.sum() < finite.numel()
    assert_close(fused[finite], y[finite], 0.0, 2e-5 if device.type == "cuda" else 0.0)


def test_labels_follow(device, kernel_calls):
    keys = ["input", "mask", "bbox_xyxy"]
    augment = A.AugmentationSequential(MIXES["mosaic"](1.0), *PASSES["perspective, jiggle"](), data_keys=keys)
    x = images(device)
    boxes = torch.tensor([[[10.0, 12.0, 60.0, 50.0], [0.0, 0.0, 30.0, 90.0]]], device=device).expand(6, 2, 4)
    results = []
    for reads in (False, True):
        kernel_calls[1].append(reads)
        results.append(augment(x, (x[:, :1] > 0.5).float(), boxes, seed=3))
    for pasted, fused in zip(*results):
        assert_close(fused, pasted, 0.0, 2e-5 if device.type == "cuda" else 0.0)


@pytest.mark.parametrize("case", UNSERVED[:2] + UNSERVED[3:])
def test_calls_that_the_kernel_does_not_serve(case, device, kernel_calls):
    call_unserved(case, A.ImageSequential(MIXES["mosaic"](1.0), *PASSES["perspective"]()), images(device))
    assert not kernel_calls[0]


def test_mixtures_with_weights_and_other_sizes_are_made_first(device, kernel_calls):
    for mix in (A.RandomMixUpV2(p=1.0), A.RandomMosaic((64, 80), p=1.0)):
        A.ImageSequential(mix, *PASSES["perspective"]())(images(device))
    assert not kernel_calls[0]
