"""Mixtures of lists: the operator is its reference, and so are its gradients. test_policy_lists.py has calls of the class."""

import pytest
import torch

from augmentation.test_lists import pictures
from kvision.augmentation.auto import aug_mix
from kvision.augmentation.auto.operation_table import OPERATIONS
from op_tests import assert_close

SIZES = ((20, 28), (1, 1), (37, 41), (1, 9), (64, 32))
# Chains of two operations, which rounding carries across no level.
CHAINS = (("rotate", "contrast"), ("sharpness", "translate_y"), ("auto_contrast", "none"))
NUMBERS = {**{name: operation.number for name, operation in OPERATIONS.items()}, "none": -1}


def drawn(device, count):
    operation = torch.tensor([NUMBERS[name] for chain in CHAINS for name in chain], device=device)
    weights = torch.rand(count, 1 + len(CHAINS), generator=torch.Generator().manual_seed(0))
    value = torch.full((count, 6), 0.7, device=device)
    return operation.expand(count, -1), value, (weights / weights.sum(1, keepdim=True)).to(device)


@pytest.mark.native
@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
def test_mixtures_are_those_of_the_reference(dtype, device):
    images = pictures(device, SIZES, dtype)
    arguments = drawn(device, len(images))
    for y, own in zip(aug_mix._mix.kernel(images, *arguments), aug_mix._reference(images, *arguments)):
        assert_close(y, own, *{torch.uint8: (0, 1), torch.float16: (2e-3, 2e-3)}.get(dtype, (1e-5, 1e-5)))


@pytest.mark.native
def test_gradients_are_those_of_the_reference(device):
    images = [x.requires_grad_() for x in pictures(device, SIZES)]
    arguments = drawn(device, len(images))
    weights = [torch.rand_like(x) for x in images]
    of_kernel, of_reference = (
        torch.autograd.grad(sum((y * w).sum() for y, w in zip(mix(images, *arguments), weights)), images)
        for mix in (aug_mix._mix_operations_list, aug_mix._reference)
    )
    for a, b in zip(of_kernel, of_reference):
        assert_close(a, b, 1e-4, 1e-4)


def test_wrong_arguments(device):
    images = pictures(device, SIZES)
    operation, value, weights = drawn(device, len(images))
    if not aug_mix._mix.serves(images[0]):
        pytest.skip("this test is about the kernel")
    for wrong in (
        (operation[:, :5], value[:, :5], weights),
        (operation, value, weights[:2]),
        (operation, value.double(), weights),
        (operation, value, weights[:, :1]),
    ):
        with pytest.raises(RuntimeError, match="mix_operations_list: expected"):
            aug_mix._mix.kernel(images, *wrong)
    with pytest.raises(RuntimeError, match="mix_operations_list: expected images with channels"):
        aug_mix._mix.kernel([x[:0] for x in images], operation, value, weights)
