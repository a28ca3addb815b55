"""The decorators that flatten and restore leading axes."""

from __future__ import annotations

import kornia
import pytest
import torch

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError


def halve(input, factor=0.5):
    """Keeps the batch, changes everything else; remembers the rank it was given."""
    halve.rank = input.dim()
    return input[..., :2, ::2] * factor


@pytest.mark.parametrize(
    ("name", "rank"), [("perform_keep_shape_image", 4), ("perform_keep_shape_video", 5)], ids=["image", "video"]
)
@pytest.mark.parametrize("extra", [-2, -1, 0, 1, 2])
def test_agrees_with_kornia(name, rank, extra, device):
    x = torch.rand([2, 3, 2, 3, 4, 5, 6][-(rank + extra) :], device=device)
    f = getattr(K.image, name)(halve)
    assert torch.equal(f(x, factor=2.0), getattr(kornia.image, name)(halve)(x, factor=2.0))
    assert halve.rank == rank and f.__name__ == "halve" and f.__doc__ == halve.__doc__


def test_empty_batches_pass():
    assert K.image.perform_keep_shape_image(halve)(torch.zeros(0, 3, 4, 6)).shape == (0, 3, 2, 3)
    assert K.image.perform_keep_shape_image(halve)(torch.zeros(2, 0, 3, 4, 6)).shape == (2, 0, 3, 2, 3)


@pytest.mark.tracing
def test_compiles_for_any_shape():
    crop = K.image.perform_keep_shape_image(lambda input: input[..., :2, ::2])
    compiled = torch.compile(crop, fullgraph=True, dynamic=True, backend="eager")
    for shape in [(4, 6), (2, 4, 6), (5, 2, 4, 6), (3, 5, 2, 4, 6)]:
        x = torch.rand(shape)
        assert torch.equal(compiled(x), crop(x))


@pytest.mark.parametrize(
    ("x", "error", "text"),
    [
        ([1], TypeCheckError, "halve: expected input to be a Tensor, got list"),
        (torch.zeros(3), ShapeError, r"halve: expected input of shape \(\*, C, H, W\) with at least one pixel, got"),
        (torch.zeros(3, 0, 4), ShapeError, r"got \(3, 0, 4\)"),
    ],
)
def test_errors(x, error, text):
    with pytest.raises(error, match=text):
        K.image.perform_keep_shape_image(halve)(x)
    with pytest.raises(error, match="halve"):
        K.image.perform_keep_shape_video(halve)(x)
