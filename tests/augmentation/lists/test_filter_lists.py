"""Filters of lists of images; chains with blurs are among those of test_list_runs.py."""

import pytest
import torch

from augmentation.test_list_runs import is_by_passes
from augmentation.test_lists import SMALL, pictures, seeds_of
from kvision import augmentation as A
from op_tests import assert_close


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64], ids=str)
def test_motion_over_a_list(dtype, device):
    augment = A.ImageSequential(
        A.RandomMotionBlur(5, 30.0, 0.5, p=0.7), A.RandomMotionBlur(3, 30.0, 0.5, "reflect", p=1.0)
    )
    images = [x.requires_grad_() for x in pictures(device, SMALL, dtype)]
    seeds = seeds_of(images)
    results, weights = augment(images, seed=seeds), [torch.rand_like(x) for x in images]
    assert is_by_passes(augment)
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    assert all(torch.equal(a, b) for a, b in zip(results, alone))
    grads = [torch.autograd.grad(sum((y * w).sum() for y, w in zip(of, weights)), images) for of in (results, alone)]
    for of_list, of_image in zip(*grads):
        assert_close(of_list, of_image, 2e-3, 2e-3)
    sizes = A.ImageSequential(A.RandomMotionBlur((3, 5), 30.0, 0.5, p=1.0))
    assert len(sizes(images)) == 4 and not is_by_passes(sizes)


def test_a_window_fits_the_smallest_image(device):
    images = pictures(device, [(20, 30), (20, 3)])
    for blur in (
        A.RandomGaussianBlur((7, 7), (0.5, 1.0), p=1.0),
        A.RandomBoxBlur((7, 7), p=1.0),
        A.RandomMedianBlur((7, 7), p=1.0),
    ):
        with pytest.raises(ValueError, match="20, 3"):
            blur(images)
