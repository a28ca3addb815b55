"""make_grid against a loop over the images."""

from __future__ import annotations

import math

import kornia
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


def paste(images, columns, padding):
    """The definition: image i goes to row i // columns and column i % columns."""
    b, c, h, w = images.shape
    rows = math.ceil(b / columns)
    grid = torch.zeros(c, max(rows * (h + padding) - padding, 0), columns * (w + padding) - padding, dtype=images.dtype)
    for i, image in enumerate(images):
        y, x = i // columns * (h + padding), i % columns * (w + padding)
        grid[:, y : y + h, x : x + w] = image
    return grid


@given(
    st.tuples(st.integers(0, 10), st.integers(1, 4), st.integers(1, 5), st.integers(1, 5)),
    st.none() | st.integers(1, 12),
    st.integers(0, 3),
    st.sampled_from([torch.uint8, torch.float32, torch.bfloat16]),
)
def test_against_a_loop(shape, n_row, padding, dtype):
    images = torch.randint(1, 200, shape).to(dtype)
    columns = n_row or max(1, math.ceil(math.sqrt(shape[0])))
    assert torch.equal(K.image.make_grid(images, n_row, padding), paste(images, columns, padding))


@pytest.mark.parametrize("batch", range(18))
def test_agrees_with_kornia(batch, device):
    images = torch.rand(batch, 3, 4, 6, device=device)
    for n_row, padding in [(None, 2), (None, 0), (4, 1)]:
        assert torch.equal(
            K.image.make_grid(images, n_row, padding), kornia.image.make_grid(images, n_row=n_row, padding=padding)
        )


def test_layouts_gradient_and_untouched_input(device):
    images = torch.rand(5, 3, 4, 6, device=device, dtype=torch.float64)
    before = images.clone()
    expected = K.image.make_grid(images)
    assert torch.equal(K.image.make_grid(images.contiguous(memory_format=torch.channels_last)), expected)
    assert torch.equal(K.image.make_grid(images.repeat(1, 1, 1, 2)[..., :6]), expected)
    assert torch.equal(images, before)
    assert torch.autograd.gradcheck(K.image.make_grid, images.requires_grad_())


@pytest.mark.tracing
def test_compiles_for_any_batch():
    compiled = torch.compile(K.image.make_grid, fullgraph=True, dynamic=True, backend="eager")
    for batch in (2, 3, 10):
        images = torch.rand(batch, 3, 4, 6)
        assert torch.equal(compiled(images), K.image.make_grid(images))


@pytest.mark.parametrize(
    ("args", "error", "text"),
    [
        (([1],), TypeCheckError, "make_grid: expected tensor to be a Tensor, got list"),
        ((torch.zeros(3, 4, 5),), ShapeError, r"make_grid: expected tensor of shape \(B, C, H, W\), got \(3, 4, 5\)"),
        ((torch.zeros(1, 1, 1, 1), 0), ValueCheckError, "expected n_row .* at least 1, got 0"),
        ((torch.zeros(1, 1, 1, 1), 2.0), TypeCheckError, "expected n_row"),
        ((torch.zeros(1, 1, 1, 1), 2, -1), ValueCheckError, "expected padding .* at least 0, got -1"),
        ((torch.zeros(1, 1, 1, 1), 2, True), TypeCheckError, "expected padding"),
    ],
)
def test_errors(args, error, text):
    with pytest.raises(error, match=text):
        K.image.make_grid(*args)
