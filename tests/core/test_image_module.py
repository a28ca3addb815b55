"""Modules that take and return NumPy arrays, PIL images and file names."""

from __future__ import annotations

import pickle

import numpy as np
import PIL.Image
import pytest
import torch

import kvision as K
from kvision.core import ImageModule, ImageModuleMixIn, ImageSequential
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError


class Invert(ImageModule):
    def forward(self, x, y=None):
        return 1 - x if y is None else y - x


class Scale(ImageModule):
    def __init__(self):
        super().__init__()
        self.factor = torch.nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

    def forward(self, x):
        return x * self.factor


ARRAY = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
TENSOR = torch.from_numpy(ARRAY).movedim(-1, 0) / 255


def test_all_kinds_of_input(tmp_path):
    K.io.write_image(tmp_path / "x.png", TENSOR)
    for x in (TENSOR, ARRAY, PIL.Image.fromarray(ARRAY), str(tmp_path / "x.png"), tmp_path / "x.png"):
        assert torch.allclose(Invert()(x), 1 - TENSOR)
    assert torch.allclose(Invert()(ARRAY, y=ARRAY), torch.zeros(3, 4, 6))
    assert torch.equal(Invert()(TENSOR[None]), 1 - TENSOR[None])


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16", "F"])
def test_pil_modes(mode):
    picture = PIL.Image.fromarray(ARRAY)
    picture = PIL.Image.fromarray(ARRAY[..., 0].astype(np.uint16) * 257) if mode == "I;16" else picture.convert(mode)
    tensor = ImageModuleMixIn().to_tensor(picture)
    assert tensor.is_floating_point() and tensor.shape[1:] == (4, 6)
    assert tensor.max() <= (255 if mode == "F" else 1) and len(tensor) == {"LA": 2, "P": 3, "RGB": 3, "RGBA": 4}.get(
        mode, 1
    )


def test_all_kinds_of_output():
    array = Invert()(ARRAY, output_type="numpy")
    assert isinstance(array, np.ndarray) and np.allclose(array, 1 - ARRAY / 255)
    picture = Invert()(ARRAY, output_type="pil")
    assert isinstance(picture, PIL.Image.Image) and np.array_equal(np.array(picture), 255 - ARRAY)
    assert [p.size for p in Invert()(TENSOR.expand(2, 3, 4, 6), output_type="pil")] == [(6, 4)] * 2
    assert Invert()(TENSOR[None].bfloat16(), output_type="numpy").dtype == np.float32
    assert Invert()(TENSOR[:1], output_type="pil").mode == "L"


def test_sequential_and_state(device):
    chain = ImageSequential(torch.nn.ReLU(), Scale()).to(device)
    out = chain(ARRAY)
    assert out.dtype == torch.float64 and out.device.type == device.type  # those of the parameter
    assert torch.allclose(out.cpu(), TENSOR.double() / 2)
    out.sum().backward()
    assert chain[1].factor.grad is not None
    assert list(chain.state_dict()) == ["1.factor"]


def test_only_named_inputs():
    class Pick(ImageModule):
        def forward(self, a, b):
            assert isinstance(a, torch.Tensor) and isinstance(b, np.ndarray)
            return a

    assert Pick()(ARRAY, ARRAY, input_names_to_handle=["a"]).shape == (3, 4, 6)
    assert Pick()(ARRAY, b=ARRAY, input_names_to_handle=["a", "absent"]).shape == (3, 4, 6)


def test_show_and_save(tmp_path, monkeypatch):
    module = Invert()
    batch = torch.rand(5, 3, 4, 6)
    module(batch)
    assert module.show(display=False).size == (3 * 6 + 4, 2 * 4 + 2)
    assert module.show(n_row=5, display=False).size == (5 * 6 + 8, 4)
    module.save(tmp_path / "grid.png", n_row=1)
    assert K.io.load_image(tmp_path / "grid.png").shape == (3, 5 * 4 + 8, 6)
    monkeypatch.chdir(tmp_path)
    module(TENSOR)
    module.save()
    assert K.io.load_image("kvision.jpg").shape == (3, 4, 6)


def test_disable_features():
    module = Invert()
    module(TENSOR)
    module.disable_features = True
    assert module.disable_features and torch.equal(module(TENSOR), 1 - TENSOR)
    with pytest.raises(ValueCheckError, match="show: expected a result to show, got none"):
        module.show()


def test_pickle_omits_the_last_image():
    module = Scale()
    module(TENSOR)
    copy = pickle.loads(pickle.dumps(module))
    assert copy._output_image is None and torch.equal(copy(TENSOR), module(TENSOR))


def test_compile():
    module = torch.compile(Invert(), backend="eager")
    assert torch.equal(module(TENSOR), 1 - TENSOR)


def test_decorator():
    mixin = ImageModuleMixIn()

    @mixin.convert_input_output(output_type="numpy", cache_output=True)
    def halves(x):
        return x / 2, [x, "text"]

    half, (same, text) = halves(ARRAY)
    assert np.allclose(half, ARRAY / 510) and np.allclose(same, ARRAY / 255) and text == "text"
    assert halves.__name__ == "halves" and len(mixin._output_image) == 2


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: ImageModuleMixIn().to_tensor(3), TypeCheckError, "to_tensor: expected x to be .* got int"),
        (lambda: ImageModuleMixIn().to_numpy(3), TypeCheckError, "to_numpy: expected x to be .* got int"),
        (lambda: ImageModuleMixIn().to_pil(3), TypeCheckError, "expected images to be .* got int"),
        (lambda: ImageModuleMixIn().to_pil(torch.zeros(2)), ShapeError, r"to_pil: .* got \(2,\)"),
        (
            lambda: Invert()(TENSOR, output_type="jax"),
            ValueCheckError,
            "output_type must be one of pt, numpy, pil; got",
        ),
        (lambda: Invert()("none.png"), FileNotFoundError, "none.png"),
    ],
)
def test_errors(call, error, text):
    with pytest.raises(error, match=text):
        call()


def test_filters_take_images_that_are_converted(tmp_path):
    path = tmp_path / "image.png"
    PIL.Image.fromarray(ARRAY).save(path)
    blur = K.filters.GaussianBlur2d((3, 3), (1.0, 1.0))
    module = ImageSequential(blur, K.filters.Sobel())
    expected = module(torch.from_numpy(ARRAY).permute(2, 0, 1)[None] / 255)[0]
    for image in (ARRAY, PIL.Image.fromarray(ARRAY), str(path), path):
        torch.testing.assert_close(module(image), expected)
        assert ImageSequential(blur)(image, output_type="numpy").shape == ARRAY.shape
    batch = np.stack([ARRAY, ARRAY])
    assert module(batch).shape == (2, *expected.shape)
