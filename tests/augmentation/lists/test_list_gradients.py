"""Gradients of colors, layers, noise and others on lists of images, in the launches of a batch: those of each image alone."""

from __future__ import annotations

import pytest
import torch

from augmentation.test_lists import pictures, seeds_of
from kvision import augmentation as A
from op_tests import assert_close

SIZES = ((16, 17), (33, 20), (5, 128), (40, 64))
PROGRAMS = {
    "values": lambda: A.RandomInvert(p=1.0),
    "affine": lambda: A.Normalize((0.2, 0.5, 0.3), (0.3, 0.4, 0.5)),
    "channels": lambda: A.RandomHue((-0.3, 0.3), p=1.0),
    "one mean": lambda: A.RandomContrast((0.5, 1.5), p=1.0),
    "jitter": lambda: A.ColorJitter(0.3, 0.3, 0.3, 0.1, p=0.8),
    "order": lambda: A.ColorJitter(0.3, 0.3, 0.3, 0.1, p=1.0),
    "grayscale": lambda: A.RandomGrayscale(p=1.0),
    "sharpness": lambda: A.RandomSharpness((0.2, 3.0), p=0.8),
    "medians": lambda: A.RandomMedianBlur((3, 3), p=0.8),
    "medians of 25": lambda: A.RandomMedianBlur((5, 5), p=0.8),
    "medians of 21": lambda: A.RandomMedianBlur((7, 3), p=0.8),
    "ringing": lambda: A.RingingOvershoot((3, 3), p=0.8),
    "glass": lambda: A.GlassBlur(p=0.8),
    "levels": lambda: A.RandomEqualize(p=0.8),
    "levels of tiles": lambda: A.RandomClahe((1.0, 40.0), (3, 2), p=0.8),
    "range": lambda: A.RandomAutoContrast(p=0.8),
    "means of channels": lambda: A.CommonCorruption("contrast", 2, p=0.8),
    "blocks": lambda: A.RandomJPEG((20.0, 80.0), p=0.8),
    "pixels of blocks": lambda: A.Downscale((0.2, 0.9), p=0.8),
    "means of blocks": lambda: A.Downscale((0.2, 0.9), antialias=True, p=0.8),
    "zoom": lambda: A.ZoomBlur(p=0.8),
    "illumination": lambda: A.RandomLinearIllumination(p=0.8),
    "fog": lambda: A.RandomFog(p=0.8),
    "frost": lambda: A.RandomFrost(torch.rand(2, 3, 70, 140), p=0.8),
    "plasma": lambda: A.RandomPlasmaShadow(p=1.0),
    "hue and light": lambda: A.ISONoise(p=0.8),
    "factors of images": lambda: A.MultiplicativeNoise((0.5, 1.5), p=0.8),
    "factors of channels": lambda: A.MultiplicativeNoise((0.5, 1.5), per_channel=True, p=0.8),
    "factors of noise": lambda: A.MultiplicativeNoise((0.5, 1.5), True, True, p=0.8),
    "speckle": lambda: A.SpeckleNoise((0.3, 0.5), p=1.0),
    "clamped noise": lambda: A.CommonCorruption("gaussian_noise", 5),
    "salt and pepper": lambda: A.RandomSaltAndPepperNoise((0.3, 0.5), p=0.8),
    "random pixels": lambda: A.PixelDropout(0.3, per_channel=True, drop_value="random", p=1.0),
    "erasing": lambda: A.RandomErasing((0.1, 0.5), value=0.5, p=0.8),
    "grid": lambda: A.GridMask(p=1.0),
    "erasing with noise": lambda: A.RandomErasing((0.1, 0.5), value="random", p=0.8),
    "grid of noise": lambda: A.GridMask(fill="random", p=1.0),
    "warp": lambda: A.ImageSequential(A.RandomAffine(20.0), A.ColorJitter(0.3, 0.3, 0.3, 0.1, p=1.0)),
    "size": lambda: A.ImageSequential(A.Pad(3), A.RandomSaturation((0.5, 1.5), p=1.0)),
}
COLORS = ("values", "affine", "channels", "one mean", "jitter", "order", "grayscale")
TYPES = [torch.float32, torch.float64, torch.float16]


@pytest.mark.parametrize("layout", ["planes", "pixels", "scalars"])
@pytest.mark.parametrize("dtype", TYPES, ids=str)
@pytest.mark.parametrize("name", PROGRAMS)
def test_gradients_are_those_of_each_image(name, dtype, layout, device, backend):
    images = pictures(device, SIZES, dtype)
    if layout == "pixels":
        images = [x.movedim(0, -1).contiguous().movedim(-1, 0) for x in images]
    images = [x.requires_grad_() for x in images]
    augment, seeds = PROGRAMS[name](), seeds_of(images)
    results = augment(images, seed=seeds)
    grads = [
        torch.ones_like(y[:1, :1, :1]).expand_as(y) if layout == "scalars" else torch.rand_like(y) for y in results
    ]
    found = torch.autograd.grad(results, images, grads)
    tolerance = 2e-2 if dtype == torch.float16 else 1e-4
    for b, x in enumerate(images):
        (alone,) = torch.autograd.grad(augment(x[None], seed=seeds[b : b + 1]), x, grads[b][None])
        assert found[b].dtype == dtype
        if backend != "reference" and name in COLORS:  # the gradients of others may be planes
            assert found[b].stride() == x.stride()
        assert_close(found[b], alone, tolerance, tolerance)


def test_other_channels_and_long_lists(device):
    """One gradient for each image of more than a table has."""
    images = [torch.rand(4, 3 + i % 5, 4 + i % 3, device=device, requires_grad=True) for i in range(520)]
    results = A.RandomInvert(p=1.0)(images)
    for gradient, x in zip(torch.autograd.grad(results, images, [y.detach() for y in results]), images):
        assert_close(gradient, x.detach() - 1)


LONG = [
    *("jitter", "sharpness", "medians", "ringing", "glass", "levels", "range", "means of channels"),
    *("blocks", "fog", "hue and light", "means of blocks", "zoom", "illumination", "speckle", "erasing"),
]


@pytest.mark.parametrize("name", LONG)
def test_lists_longer_than_a_table(name, device):
    images = [torch.rand(3, 6 + i % 5, 7 + i % 3, device=device, requires_grad=True) for i in range(520)]
    augment, seeds = PROGRAMS[name](), seeds_of(images)
    found = torch.autograd.grad([y.square().sum() for y in augment(images, seed=seeds)], images)
    for b in (0, 255, 256, 257, 511, 512, 519):
        (alone,) = torch.autograd.grad(augment(images[b][None], seed=seeds[b : b + 1]).square().sum(), images[b])
        assert_close(found[b], alone, 1e-4, 1e-4)


@pytest.mark.parametrize("name", ["levels", "levels of tiles"])
def test_pixels_that_stay_pass_their_gradients(name, device):
    """NaN, and those of images with too few pixels for as many levels."""
    images = pictures(device, [(40, 64), (9, 20)])
    images[0][:, 3, 5] = torch.nan
    images = [x.requires_grad_() for x in images]
    results = {"levels": A.RandomEqualize(p=1.0), "levels of tiles": A.RandomClahe(p=1.0)}[name](images)
    grads = [torch.rand_like(y) for y in results]
    found, expected = torch.autograd.grad(results, images, grads), torch.zeros_like(images[0])
    expected[:, 3, 5] = grads[0][:, 3, 5]
    assert torch.equal(found[0], expected)
    assert torch.equal(found[1], grads[1] if name == "levels" else torch.zeros_like(grads[1]))


@pytest.mark.parametrize(
    "name", ["medians", "range", "means of channels", "blocks", "hue and light", "means of blocks"]
)
def test_gradients_of_images_of_one_size_are_those_of_a_batch(name, device):
    images = [x[:, :16, :16].clone().requires_grad_() for x in pictures(device, [(16, 17), (33, 20), (40, 64)])]
    augment, batch = PROGRAMS[name](), torch.stack(images).detach().requires_grad_()
    grads = torch.rand_like(batch)
    (of_batch,) = torch.autograd.grad(augment(batch, seed=4), batch, grads)
    for own, expected in zip(torch.autograd.grad(augment(images, seed=4), images, list(grads)), of_batch):
        assert torch.equal(own, expected)


def test_an_image_that_appears_twice_gets_both_gradients(device):
    first, second = pictures(device, [(16, 17), (33, 20)])
    first.requires_grad_()
    names = ("medians", "ringing", "glass", "range", "levels", "means of channels", "sharpness", "blocks", "fog")
    for name in (*names, "hue and light", "pixels of blocks", "means of blocks", "zoom"):
        augment, seeds = PROGRAMS[name](), torch.arange(3, device=device)
        results = augment([first, second, first], seed=seeds)
        grads = [torch.rand_like(y) for y in results]
        (both,) = torch.autograd.grad(results[::2], first, grads[::2])
        each = [
            torch.autograd.grad(augment(first[None], seed=seeds[b : b + 1]), first, grads[b][None])[0] for b in (0, 2)
        ]
        assert_close(both, sum(each), 1e-5, 1e-5)


def test_gradients_of_factors_that_differ_by_the_number_of_the_image(device):
    """A list with one seed draws by the numbers of its images, as a batch does."""
    images = [(0.2 + 0.3 * x).requires_grad_() for x in pictures(device, SIZES)]
    results = A.MultiplicativeNoise((0.5, 1.5), elementwise=True, p=1.0)(images, seed=5)
    for gradient, x, y in zip(
        torch.autograd.grad(results, images, [torch.ones_like(y) for y in results]), images, results
    ):
        assert_close(gradient, (y / x).detach())


@pytest.mark.parametrize("options", [{}, {"per_channel": True}, {"elementwise": True}], ids=str)
def test_learned_ranges_of_factors(options, device):
    images, ends = pictures(device, SIZES), torch.tensor([0.5, 0.9], requires_grad=True)
    augment, seeds = A.MultiplicativeNoise(ends, **options, p=0.8), seeds_of(images)
    results = augment(images, seed=seeds)
    (found,) = torch.autograd.grad(sum(y.sum() for y in results), ends)
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    assert all(torch.equal(a, b) for a, b in zip(results, alone))
    (expected,) = torch.autograd.grad(sum(y.sum() for y in alone), ends)
    assert_close(found, expected, 1e-3, 1e-4)


@pytest.mark.derivatives
@pytest.mark.parametrize(
    "name", ["channels", "one mean", "jitter", "sharpness", "medians", "ringing", "range", "means of channels", "fog"]
)
def test_second_derivatives(name, device):
    augment, images = PROGRAMS[name](), pictures(device, SIZES[:2], torch.float64)
    images = [x[:, :3, :4].clone().requires_grad_() for x in images]
    images[0] = images[0].detach()[:, :2].clone().requires_grad_()

    def call(*xs):
        return tuple(augment(list(xs), seed=torch.arange(2)))

    assert torch.autograd.gradcheck(call, tuple(images), atol=1e-4)
    assert torch.autograd.gradgradcheck(call, tuple(images), atol=1e-4)


def test_what_does_not_fit_is_an_error(device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x, plan = torch.rand(3, 4, 5, device=device), [-1, -1, 0, 0, 0, 0, 0, 0, 0]
    operator = torch.ops.kvision.color_list_backward
    with pytest.raises(RuntimeError, match="gradient of each image"):
        operator([x], None, None, plan, [])
    with pytest.raises(RuntimeError, match="do not fit"):
        operator([x, x[:, 1:]], None, None, plan, [])
    with pytest.raises(RuntimeError, match="expected the means"):
        operator([x, x], None, torch.rand(1, 1, device=device), plan, [])
