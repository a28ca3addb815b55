"""Drops of rain: their depth against SciPy's distance transform, their relief against OpenCV."""

import cv2
import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from kvision.augmentation.corruption.drops import drop_depths, drop_reliefs, mark_stains
from kvision.geometry.transform.lists.kept_sizes import Operation
from op_tests import OpTests


def layer(x: Tensor) -> Tensor:
    """(B, 1, H, W) of float32 or float64, between the steps of levels, with values below 0 and above 1."""
    own = torch.float64 if x.dtype == torch.float64 else torch.float32
    return ((x.to(own) * 300).floor() - 19.5)[:, :1] / 255


def parameters(x: Tensor) -> Tensor:
    """Thresholds, for layers as they are."""
    return of(torch.linspace(0.2, 0.8, x.shape[0]) if len(x) else torch.empty(0))


def scaled(x: Tensor) -> Tensor:
    """The same for a quarter of layers and a half, which is exact in all types."""
    return parameters(x) * torch.tensor([1.0, 0.25, 1.0]) + torch.tensor([0.5, 0.0, 0.0])


def of(thresholds: Tensor) -> Tensor:
    return torch.stack([torch.zeros_like(thresholds), torch.ones_like(thresholds), thresholds], 1)


def depths(x: Tensor) -> Tensor:
    return torch.randint(0, 256, (x.shape[0], 1, *x.shape[2:]))


class DropTests(OpTests):
    differentiable = False
    channels = 1
    mixed = ("parameters", "layers")

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the classes that call the operator check its input")


class TestDropDepths(DropTests):
    operators = ("drop_depths",)
    variants = [{"parameters": parameters}, {"parameters": scaled}]

    @staticmethod
    def function(x: Tensor, parameters: Tensor) -> Tensor:
        layers = layer(x)
        return drop_depths(layers, parameters.to(layers)).to(x.dtype if x.is_floating_point() else torch.float32)


class TestDropReliefs(DropTests):
    operators = ("drop_reliefs",)
    variants = [{"parameters": parameters, "depths": depths}, {"parameters": scaled, "depths": depths}]

    @staticmethod
    def function(x: Tensor, parameters: Tensor, depths: Tensor) -> Tensor:
        layers = layer(x)
        return (drop_reliefs(layers, parameters.to(layers), depths.to(torch.uint8)) / 65025).to(
            x.dtype if x.is_floating_point() else torch.float32
        )


class TestMarkStains(DropTests):
    operators = ("mark_stains",)
    variants = [{"parameters": parameters}, {"parameters": scaled}]

    @staticmethod
    def function(x: Tensor, parameters: Tensor) -> Tensor:
        layers = layer(x)
        return mark_stains(layers, parameters.to(layers)).to(x.dtype if x.is_floating_point() else torch.float32)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_layers_of_a_list_are_those_of_single_layers(dtype, device):
    """Also of more layers than a launch takes."""
    for sizes in ([(1, 1), (70, 130), (33, 1), (64, 128), (5, 65)], [(3, 4), (2, 7)] * 300):
        layers = [torch.rand(1, h, w, dtype=dtype, device=device) for h, w in sizes]
        layers[1] = layers[1].mT.contiguous().mT
        own = scaled(torch.empty(len(sizes), 1)).to(layers[0])
        depths = [(255 * x).to(torch.uint8) for x in layers]
        for operator, more in ((drop_depths, ()), (drop_reliefs, (depths,)), (mark_stains, ())):
            results = Operation(operator, (own, *more)).on_list(layers)
            for b, y in enumerate(results):
                alone = operator(layers[b][None], own[b : b + 1], *(z[b][None] for z in more))
                assert torch.equal(y, alone[0]) and y.dtype == alone.dtype


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (33, 1), (2, 3), (31, 65), (70, 130), (64, 128), (97, 224)])
def test_depths_are_distances_to_outlines(size, device):
    """Layers of few outlines, and of many."""
    x = torch.rand(3, 1, *size)
    wide = torch.from_numpy(ndimage.gaussian_filter(torch.rand(size).numpy(), 6))[None, None]
    x = torch.cat(
        [x, torch.zeros_like(x[:1]), torch.ones_like(x[:1]), (wide - wide.amin()) / (wide.amax() - wide.amin())]
    )
    limits = torch.tensor([0.01, 0.5, 0.99, 0.5, 0.5, 0.5])
    y = drop_depths(x.to(device), of(limits).to(device)).cpu()
    assert torch.equal(y, drop_depths.reference(x, of(limits)))
    for image, limit, result in zip(x[:, 0].numpy(), limits.tolist(), y[:, 0].numpy()):
        inside = image * 255 >= max(255 * limit, 1)
        cross = ndimage.generate_binary_structure(2, 1)
        outline = inside & ~ndimage.binary_erosion(inside, cross, border_value=1)
        distances = np.full(size, 20.0)
        if outline.any():
            distances = ndimage.distance_transform_edt(~outline).clip(0, 20)
        means = ndimage.uniform_filter(distances, 3, mode="mirror") if min(size) > 1 else None
        if means is not None:
            np.testing.assert_array_equal(result, np.floor(means + 1e-5))


def test_reliefs_are_lit_from_the_corner(device):
    x, z = torch.rand(2, 1, 70, 101), torch.randint(0, 256, (2, 1, 70, 101), dtype=torch.uint8)
    limits = torch.tensor([0.3, 0.6])
    y = drop_reliefs(x.to(device), of(limits).to(device), z.to(device)).cpu()
    assert torch.equal(y, drop_reliefs.reference(x, of(limits), z))
    kernel = np.array([[-2, -1, 0], [-1, 1, 1], [0, 1, 2]])
    for b in range(2):
        light = cv2.blur(cv2.filter2D(z[b, 0].numpy(), cv2.CV_8U, kernel), (3, 3)).astype(np.float32)
        levels = np.where(x[b, 0] < limits[b], 0, np.floor(x[b, 0].numpy() * 255))
        np.testing.assert_array_equal(y[b, 0].numpy(), light * levels)
