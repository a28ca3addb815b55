"""Augmentations of lists by an operator of layers, blocks or statistics of the image, which each image has alone, too."""

import pytest
import torch

from augmentation.test_list_runs import is_by_passes
from augmentation.test_lists import SMALL, pictures, seeds_of
from kvision import augmentation as A
from op_tests import assert_close

FROST = torch.rand(2, 3, 90, 90)
MAKE = {
    "gaussian light": lambda **o: A.RandomGaussianIllumination(**o),
    "linear light": lambda **o: A.RandomLinearIllumination(**o),
    "light of a corner": lambda **o: A.RandomLinearCornerIllumination(**o),
    "plasma brightness": lambda **o: A.RandomPlasmaBrightness(**o),
    "plasma contrast": lambda **o: A.RandomPlasmaContrast(**o),
    "plasma shadow": lambda **o: A.RandomPlasmaShadow(**o),
    "frost": lambda **o: A.RandomFrost(FROST, **o),
    "blocks": lambda **o: A.Downscale((0.2, 0.9), antialias=True, **o),
    "equalized": lambda **o: A.RandomEqualize(**o),
    "rain": lambda **o: A.RandomRain((10, 20), (3, 6), (-3, 3), **o),
    "equalized tiles": lambda **o: A.RandomClahe((1.0, 40.0), (3, 2), **o),
    "codec": lambda **o: A.RandomJPEG((20.0, 80.0), **o),
    "stretched": lambda **o: A.RandomAutoContrast(**o),
    "fog": lambda **o: A.RandomFog(**o),
    "pixels": lambda **o: A.Downscale((0.2, 0.9), **o),
    "photons": lambda **o: A.CommonCorruption("shot_noise", 2, **o),
    "impulses": lambda **o: A.CommonCorruption("impulse_noise", 2, **o),
    "normal factors": lambda **o: A.CommonCorruption("speckle_noise", 2, **o),
    "lens": lambda **o: A.CommonCorruption("defocus_blur", 1, **o),
    "smooth": lambda **o: A.CommonCorruption("gaussian_blur", 1, **o),
    "pixelate": lambda **o: A.CommonCorruption("pixelate", 3, **o),
    "common frost": lambda **o: A.CommonCorruption("frost", 3, FROST, **o),
    "common contrast": lambda **o: A.CommonCorruption("contrast", 3, **o),
    "ringing": lambda **o: A.RingingOvershoot((3, 9), **o),
    "snow": lambda **o: A.RandomSnow((0.4, 0.6), (1.2, 2.0), **o),
    "common snow": lambda **o: A.CommonCorruption("snow", 2, **o),
    "common fog": lambda **o: A.CommonCorruption("fog", 3, **o),
    "common codec": lambda **o: A.CommonCorruption("jpeg_compression", 3, **o),
    "glass": lambda **o: A.CommonCorruption("glass_blur", 3, **o),
    "motion": lambda **o: A.CommonCorruption("motion_blur", 1, **o),
    "zoom": lambda **o: A.CommonCorruption("zoom_blur", 3, **o),
}
NOISES = ("photons", "impulses", "normal factors", "glass", "common snow")
DTYPES = [torch.uint8, torch.float16, torch.bfloat16, torch.float32, torch.float64]


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("name", MAKE)
def test_each_image_gets_what_it_gets_alone(name, dtype, device):
    """In both layouts; its gradient, and a replay with the parameters, too."""
    augment = A.AugmentationSequential(MAKE[name](p=0.7), data_keys=["input"])
    is_byte = dtype == torch.uint8
    if dtype == torch.float64 and name in NOISES:
        pytest.skip("float64 has the noise of float32 images, a call for each size")
    images = pictures(device, SMALL if name in ("lens", "rain", "ringing") else [*SMALL, (1, 9), (7, 1)], dtype)
    seeds = seeds_of(images)
    for given in (images, [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in images]):
        given = given if is_byte else [x.requires_grad_() for x in given]
        results = augment(given, seed=seeds)
        assert is_by_passes(augment)
        params = augment._params
        alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(given)]
        assert all(torch.equal(a, b) for a, b in zip(results, alone))
        assert all(a.stride() == b.stride() for a, b in zip(results, alone) if 1 not in a.shape)
        if results[0].requires_grad:
            weights = [torch.rand_like(y) for y in results]
            of_list, of_images = (
                torch.autograd.grad(sum((y * w).sum() for y, w in zip(of, weights)), given) for of in (results, alone)
            )
            for a, b in zip(of_list, of_images):
                assert_close(a, b, *((1e-2, 1e-2) if dtype == torch.bfloat16 else (2e-3, 2e-3)))
        for a, b in zip(results, augment(given, params=params)):
            assert_close(a, b, *((0, 1) if is_byte else (8e-3, 8e-3)))


def test_some_given_maps_may_have_a_plane_of_each_channel(device):
    augment = A.AugmentationSequential(A.RandomLinearIllumination(p=1.0), data_keys=["input"])
    images = pictures(device, SMALL, torch.float32)
    expected = augment(images)
    maps = augment._params[0].data["gradient"]
    maps[1] = maps[1].contiguous()
    assert all(torch.equal(a, b) for a, b in zip(expected, augment(images, params=augment._params)))


@pytest.mark.parametrize("name", MAKE)
def test_equal_sizes_are_a_batch(name, device):
    augment, images = MAKE[name](p=0.7), [x[:, :15, :16].contiguous() for x in pictures(device, SMALL)]
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results = augment(images, **options)
        torch.manual_seed(0)
        assert all(torch.equal(a, b) for a, b in zip(results, augment(torch.stack(images), **options)))


def test_images_as_large_as_frost(device):
    with pytest.raises(ValueError, match="at least 95 x 20 pixels, got 90 x 90"):
        A.RandomFrost(FROST.to(device))(pictures(device, [(95, 20), (20, 20)]))
