"""NumPy images to tensors and back."""

from __future__ import annotations

import warnings

import kornia
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

DTYPES = ("uint8", "int8", "uint16", "int32", "int64", "bool", "float16", "float32", "float64")
IMAGES = hnp.arrays(st.sampled_from(DTYPES), hnp.array_shapes(min_dims=2, max_dims=4, min_side=0, max_side=5))


@given(IMAGES, st.booleans())
def test_image_to_tensor_agrees_with_kornia(image, keepdim):
    got, want = K.image.image_to_tensor(image, keepdim), kornia.image.image_to_tensor(image, keepdim)
    assert got.shape == want.shape and got.dtype == want.dtype
    assert np.array_equal(got.numpy(), want.numpy(), equal_nan=image.dtype.kind == "f")


@given(IMAGES)
def test_round_trip_from_numpy(image):
    back = K.image.tensor_to_image(K.image.image_to_tensor(image), keepdim=True)
    if image.ndim > 2 and image.shape[-1] == 1:  # a single channel loses its axis
        image = image[..., 0]
    assert back.shape == image.shape and back.dtype == image.dtype
    assert back.tobytes() == np.ascontiguousarray(image).tobytes()


@given(
    hnp.array_shapes(min_dims=2, max_dims=4, max_side=5),
    st.sampled_from([torch.uint8, torch.uint16, torch.int64, torch.bool, torch.bfloat16, torch.float16, torch.float64]),
    st.booleans(),
    st.booleans(),
)
def test_tensor_to_image_agrees_with_kornia(shape, dtype, keepdim, force_contiguous):
    tensor = torch.arange(int(np.prod(shape))).reshape(shape).to(dtype)
    got = K.image.tensor_to_image(tensor, keepdim, force_contiguous)
    want = kornia.image.tensor_to_image(tensor, keepdim, force_contiguous)
    assert got.shape == want.shape and got.dtype == want.dtype and np.array_equal(got, want)
    assert not force_contiguous or got.flags.c_contiguous


def test_memory_is_shared():
    image = np.zeros((4, 5, 3), np.uint8)
    tensor = K.image.image_to_tensor(image)
    tensor[0, 1, 2] = 9
    assert image[1, 2, 0] == 9
    assert np.shares_memory(K.image.tensor_to_image(tensor), image)


@pytest.mark.parametrize(
    "view",
    [
        lambda a: a[..., ::-1],
        lambda a: a[::-1, ::2],
        lambda a: a.astype(">f4"),
        lambda a: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    ],
    ids=["bgr", "upside-down", "big-endian", "read-only"],
)
def test_arrays_torch_cannot_view_are_copied(view):
    image = view(np.arange(60, dtype=np.float32).reshape(4, 5, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tensor = K.image.image_to_tensor(image)
    assert np.array_equal(tensor.movedim(0, -1).numpy(), image)


def test_tensor_to_image_takes_tensors_from_anywhere(device):
    tensor = torch.rand(3, 4, 5, device=device, requires_grad=True) * 2
    assert np.array_equal(K.image.tensor_to_image(tensor), tensor.detach().cpu().permute(1, 2, 0).numpy())
    assert K.image.tensor_to_image(tensor.to(torch.float8_e4m3fn)).dtype == np.float32


def test_image_list_to_tensor():
    images = [np.full((4, 5, 3), i, np.uint8) for i in range(3)]
    batch = K.image.image_list_to_tensor(images)
    assert batch.dtype == torch.uint8 and torch.equal(batch, kornia.image.image_list_to_tensor(images))
    assert torch.equal(K.image.image_list_to_tensor([image[:, ::-1] for image in images]), batch)


def test_module():
    image = np.random.rand(4, 5, 3)
    assert torch.equal(K.image.ImageToTensor()(image)[0], K.image.ImageToTensor(keepdim=True)(image))
    assert repr(K.image.ImageToTensor()) == "ImageToTensor(keepdim=False)"


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: K.image.image_to_tensor([[0.0]]), TypeCheckError, "image_to_tensor: expected image to be a numpy.nda"),
        (lambda: K.image.image_to_tensor(torch.zeros(2, 2)), TypeCheckError, "got Tensor"),
        (lambda: K.image.image_to_tensor(np.array([["a"]])), TypeCheckError, "of a number type torch has, got <U1"),
        (lambda: K.image.image_to_tensor(np.zeros(3)), ShapeError, r"or \(B, H, W, C\), got \(3,\)"),
        (lambda: K.image.image_to_tensor(np.zeros((1,) * 5)), ShapeError, r"got \(1, 1, 1, 1, 1\)"),
        (lambda: K.image.tensor_to_image(np.zeros((2, 2))), TypeCheckError, "expected tensor to be a Tensor, got nda"),
        (lambda: K.image.tensor_to_image(torch.zeros(3)), ShapeError, r"got \(3,\)"),
        (lambda: K.image.tensor_to_image(torch.zeros((1,) * 5)), ShapeError, r"got \(1, 1, 1, 1, 1\)"),
        (lambda: K.image.image_list_to_tensor([]), ValueCheckError, "at least one image"),
        (lambda: K.image.image_list_to_tensor(["x"]), TypeCheckError, r"images\[0\] to be a numpy.ndarray, got str"),
        (lambda: K.image.image_list_to_tensor([np.zeros((2, 2))]), ShapeError, r"images\[0\] of shape \(H, W, C\)"),
        (
            lambda: K.image.image_list_to_tensor([np.zeros((2, 2, 3)), np.zeros((2, 3, 3))]),
            ShapeError,
            r"images\[1\] of shape \(2, 2, 3\), as images\[0\], got \(2, 3, 3\)",
        ),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()
