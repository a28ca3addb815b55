"""Lists of images in the passes of a batch: the bits of a batch, the gradients of each image, and tables of any length."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from augmentation.test_lists import SIZES, STARTS, chain, pictures
from benchmarks.timing import extra_bytes, launches
from kvision import augmentation as A
from op_tests import assert_close


@pytest.mark.parametrize("start", STARTS)
def test_equal_sizes_draw_and_give_what_a_batch_does(start, device):
    images, augment = pictures(device, [(40, 56)] * 5), chain(STARTS[start](), output_dtype=torch.float16)
    torch.manual_seed(0)
    results = augment(images)
    torch.manual_seed(0)
    assert_close(results, augment(torch.stack(images)), 1e-3, 1e-3)


@pytest.mark.parametrize("layout", ["planes", "pixels"])
@pytest.mark.parametrize("antialias", [False, True])
def test_equal_sizes_have_the_bits_of_a_batch(layout, antialias, device):
    batch = (255 * torch.rand(5, 60, 80, 3, device=device)).byte().permute(0, 3, 1, 2)
    batch = batch if layout == "pixels" else batch.contiguous()
    for step in (A.ColorJitter(0.2, 0.2, 0.2, 0.1), A.RandomBrightness((0.8, 1.2)), A.RandomGrayscale(p=0.5)):
        augment = A.ImageSequential(
            A.RandomResizedCrop((24, 20), antialias=antialias),
            A.RandomHorizontalFlip(),
            step,
            output_dtype=torch.float16,
        )
        assert torch.equal(augment(list(batch), seed=3), augment(batch, seed=3))


@pytest.mark.parametrize("start", ["crop", "antialiased crop", "resize"])
def test_gradients_are_those_of_each_image(start, device):
    images, augment = [x.requires_grad_() for x in pictures(device)], chain(STARTS[start]())
    seeds = torch.arange(len(SIZES), device=device)
    gradients = torch.autograd.grad(augment(images, seed=seeds).square().sum(), images)
    for b, x in enumerate(images):
        (alone,) = torch.autograd.grad(augment(x[None], seed=seeds[b : b + 1]).square().sum(), x)
        assert_close(gradients[b], alone, 1e-3, 1e-3)


def test_long_lists_are_those_of_their_parts(device):
    images = pictures(device, [(4 + i % 7, 5 + i % 3) for i in range(520)])
    augment, seeds = chain(A.RandomResizedCrop((6, 6))), torch.arange(520, device=device)
    assert torch.equal(augment(images, seed=seeds)[510:], augment(images[510:], seed=seeds[510:]))


@pytest.mark.parametrize("kind", ["list", "planes", "pixels"])
def test_a_program_around_a_mean_overwrites_antialiased_windows(kind, device):
    """On CUDA three launches, and nothing is allocated for the windows; samples without contrast wait for the others, too."""
    if device.type != "cuda":
        pytest.skip("only kernels on CUDA overwrite their input")
    batch = (255 * torch.rand(6, 90, 110, 3, device=device)).byte().permute(0, 3, 1, 2)
    batch = batch if kind == "pixels" else batch.contiguous()
    images = [x[:, i:] for i, x in enumerate(batch)] if kind == "list" else batch
    for p in (1.0, 0.5):
        augment = A.ImageSequential(
            A.RandomResizedCrop((64, 60), antialias=True),
            A.ColorJitter(0.4, 0.4, 0.4, 0.1, p=p),
            A.Normalize(0.4, 0.3),
            output_dtype=torch.float16,
        )
        call = partial(augment, images)
        assert extra_bytes(call) < 65536 and launches(call) == 3
        seeds = torch.arange(6, device=device)
        on_cpu = [x.cpu() for x in images] if kind == "list" else images.cpu()
        apart = augment(images, seed=seeds).cpu().float() - augment(on_cpu, seed=seeds.cpu()).float()
        assert apart.abs().mean() < 1e-3 and apart.abs().max() < 0.1  # a resized byte may be rounded to its neighbor
