"""Images behind a layer."""

import pytest
import torch
from torch import Tensor

from augmentation.container.test_list_launches import Launches
from kvision import augmentation as A
from kvision.augmentation.corruption.layer import add_layer, layered
from kvision.geometry.transform.lists.kept_sizes import Operation
from kvision.geometry.transform.lists.remap_list import packed
from op_tests import OpTests, assert_close


def factors(x: Tensor) -> Tensor:
    """(B, 1, 4), whose results leave [0, 1] on both sides."""
    return torch.rand(x.shape[0], 1, 4) * torch.tensor([1.2, 0.7, -0.9, 0.4]) + torch.tensor([0.3, -0.2, 0.3, -0.1])


class TestAddLayer(OpTests):
    operators = ("add_layer",)
    bytes = True
    variants = [
        {"layer": lambda x: torch.rand(x.shape[0], 1, *x.shape[2:]), "factors": factors},
        {"layer": lambda x: torch.rand(1, *x.shape[1:]), "factors": lambda x: torch.rand(1, x.shape[1], 4)},
    ]
    mixed = ("layer", "factors", "images")
    tolerances = {torch.uint8: (0, 1)}  # sums in another order round to the other byte

    @staticmethod
    def function(x: Tensor, layer: Tensor, factors: Tensor) -> Tensor:
        x = x if x.is_floating_point() or x.dtype == torch.uint8 else x.float()
        own = torch.float64 if x.dtype == torch.float64 else torch.float32
        return add_layer(x, layer.to(own), None, factors.to(own))

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.uint8], ids=str)
def test_windows_of_layers(dtype, layout, device):
    """Each sample has a window of one of the layers; those that leave it end at its border."""
    own = torch.float64 if dtype == torch.float64 else torch.float32
    x = torch.rand(4, 3, 20, 36).to(memory_format=layout)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    layers, numbers = torch.rand(3, 3, 31, 40, dtype=own), torch.rand(4, 3, 4, dtype=own) / 4
    windows = torch.tensor([[0, 0, 0], [2, 11, 4], [1, 5, 3], [7, 12, -1]])
    y = add_layer(x.to(device), layers.to(device), windows.to(device), numbers.to(device)).cpu()
    assert y.is_contiguous(memory_format=layout)
    for b, (n, top, left) in enumerate([(0, 0, 0), (2, 11, 4), (1, 5, 3), (2, 11, 0)]):
        m = layers[n : n + 1, :, top : top + 20, left : left + 36]
        a, of_layer, added, offset = numbers[b, :, :, None, None].unbind(1)
        most = 255 if dtype == torch.uint8 else 1
        expected = most * ((x[b].to(own) / most) * (a + of_layer * m) + added * m + offset).clamp(0, 1)
        assert_close(
            y[b : b + 1].to(own),
            expected,
            0,
            0.51 if dtype == torch.uint8 else 1e-3 if dtype == torch.float16 else 1e-6,
        )


def test_what_is_clamped(device):
    x = torch.tensor([-1.0, 0.5, 2.0, float("nan")], device=device)[None, None, None]
    y = add_layer(x, torch.ones_like(x), None, torch.tensor([[[0.5, 0.5, -0.25, 0.5]]], device=device))
    assert_close(y.flatten().cpu(), torch.tensor([0.25, 0.75, 1.0, float("nan")]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.float16], ids=str)
def test_packed_layers_of_a_list_are_those_of_each_image(dtype, device):
    """Those of an odd and an even number of images, all but the chosen ones copied, and the gradients of all."""
    sides = [(5 + b % 4, 3 + b % 7) for b in range(7)]
    images = [torch.rand(3, *size, device=device).mul(255 if dtype == torch.uint8 else 1).to(dtype) for size in sides]
    layers = [torch.rand(1, *size, device=device) for size in sides]
    factors = torch.rand(len(sides), 3, 4, device=device)
    chosen = (torch.arange(len(sides), device=device) % 3 > 0).float()
    if dtype.is_floating_point:
        images = [x.requires_grad_() for x in images]
    results = Operation(add_layer, (packed(layers), None, factors)).on_list(images, chosen)
    expected = [
        add_layer(x[None], layer[None], None, own[None])[0] if is_chosen else x
        for x, layer, own, is_chosen in zip(images, layers, factors, chosen)
    ]
    assert all(map(torch.equal, results, expected))
    if dtype.is_floating_point:
        grads = [torch.rand_like(y) for y in results]
        mine, alone = (torch.autograd.grad(ys, images, grads) for ys in (results, expected))
        assert all(torch.allclose(a, b, atol=1e-3) for a, b in zip(mine, alone))


def test_packed_layers_of_other_sizes_are_refused(backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    images, layers = [torch.rand(3, 5, 4), torch.rand(3, 7, 9)], [torch.rand(1, 5, 4), torch.rand(1, 9, 9)]
    with pytest.raises(RuntimeError, match="expected packed layers of the sizes of images"):
        layered(packed(layers), 1.0, 0.0, 1.0, 0.0).on_list(images)


@pytest.mark.parametrize("has_windows", [False, True])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.float16], ids=str)
def test_gradients_of_batches_are_those_of_the_reference(dtype, has_windows, device):
    """Which is differentiated where a factor wants a gradient, too."""
    own = torch.float64 if dtype == torch.float64 else torch.float32
    x = torch.rand(3, 2, 12, 17).to(device, dtype).requires_grad_()
    layer = torch.rand(3, 1, *((19, 23) if has_windows else (12, 17)), dtype=own, device=device)
    windows = torch.tensor([[0, 1, 2], [2, 7, 6], [1, 0, 0]], device=device) if has_windows else None
    arguments = layer, windows, factors(x).to(device, own)
    y, weights = Operation(add_layer, arguments)(x), torch.rand(3, 2, 12, 17).to(device, dtype)
    assert_close(y, add_layer(x.detach(), *arguments), 1e-3, 1e-3)
    (found,) = torch.autograd.grad(y, x, weights)
    expected = add_layer.differentiate_reference((True, False, False, False), weights, x.detach(), *arguments)[0]
    rounding = 2e-3 if dtype == torch.float16 else 1e-5
    assert_close(found, expected, rounding, rounding)


@pytest.mark.parametrize("make", [lambda: A.RandomRain(p=1.0), lambda: A.RandomPlasmaShadow(p=1.0)])
def test_gradients_of_batches_take_one_call(make, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x = torch.rand(4, 3, 40, 50).requires_grad_()
    y = make()(x)
    with Launches() as counted:
        torch.autograd.grad(y, x, torch.ones_like(y))
    assert counted.count <= 3  # and the gradients of stacked images
