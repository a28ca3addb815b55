"""Augmentations of users: what they override is called, for images, masks and the inverse, and what they declare is joined."""

from __future__ import annotations

import copy
import functools
import inspect
import pickle
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import IMAGES
from kvision import _backend, geometry
from kvision.augmentation import columns, random_generator, transforms
from kvision.augmentation.engine import AugmentationBase
from op_tests import DispatchedOperators

pytestmark = pytest.mark.interface


def images(batch: int = 8) -> Tensor:
    return torch.rand(batch, 3, 12, 12, generator=torch.Generator().manual_seed(batch))


class SamplerGenerator(random_generator.RandomGeneratorBase):
    """Draws from distributions of torch, which `make_samplers` prepares."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__()
        self.low, self.high = low, high

    def make_samplers(self, device: torch.device, dtype: torch.dtype) -> None:
        low, high = (torch.tensor(x, device=device, dtype=dtype) for x in (self.low, self.high))
        self.sampler = random_generator.UniformDistribution(low, high)

    def forward(self, batch_shape: Any, same_on_batch: bool = False) -> dict[str, Tensor]:
        count = 1 if same_on_batch else batch_shape[0]
        return {"amount": self.sampler.rsample((count,)).expand(batch_shape[0])}


class Gain(A.IntensityAugmentationBase2D):
    def __init__(self, low: float, high: float, **options: Any) -> None:
        super().__init__(**options)
        self._param_generator = SamplerGenerator(low, high)

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        return input * params["amount"].view(-1, 1, 1, 1).to(input)


def test_a_generator_of_a_user_draws() -> None:
    x, augment = images(), Gain(0.5, 0.9, p=0.5)
    y = augment(x)
    amount, chosen = augment._params["amount"], augment._params["batch_prob"] > 0.5
    assert amount.shape == (8,) and 0.5 <= amount.min() < amount.max() <= 0.9
    torch.testing.assert_close(y[chosen], x[chosen] * amount[chosen, None, None, None])
    assert torch.equal(y[~chosen], x[~chosen])
    assert torch.equal(augment(x, params=augment._params), y)
    augment.set_rng_device_and_dtype("cpu", torch.float64)
    augment(x)
    assert augment._params["amount"].dtype == torch.float64 and augment.dtype == torch.float64
    same = Gain(0.5, 0.9, p=1.0, same_on_batch=True)
    same(x)
    assert (same._params["amount"] == same._params["amount"][0]).all()
    for other in (copy.deepcopy(augment), pickle.loads(pickle.dumps(augment))):
        assert other(x).shape == x.shape


class CropsGenerator(random_generator.CropGenerator):
    def forward(self, batch_shape: Any, same_on_batch: bool = False) -> dict[str, Tensor]:
        crops = [super(CropsGenerator, self).forward(batch_shape, same_on_batch) for _ in range(3)]
        return {**crops[0], "src": torch.stack([crop["src"] for crop in crops])}


class ThreeCrops(A.GeometricAugmentationBase2D):
    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__(p=1)
        self._param_generator = CropsGenerator(size)
        self.flags = {"size": size}

    def compute_transformation(self, input: Any, params: Any, flags: Any) -> Tensor:
        return self.identity_matrix(input)

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        return torch.cat([geometry.crop_by_indices(input, corners, flags["size"]) for corners in params["src"]])


def test_a_generator_that_extends_another_and_a_batch_that_grows() -> None:
    x, augment = images(2), ThreeCrops((5, 7))
    y = augment(x)
    assert y.shape == (6, 3, 5, 7)
    assert torch.equal(augment(x, params=augment._params), y)
    both = A.AugmentationSequential(ThreeCrops((5, 7)), data_keys=["image", "mask"])
    y, masks = both(x, x[:, :1])
    assert torch.equal(masks, y[:, :1])  # by the same method


class DiagonalFlip(A.GeometricAugmentationBase2D):
    def compute_transformation(self, input: Any, params: Any, flags: Any) -> Tensor:
        swap = torch.tensor([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])
        return swap.to(input.device).expand(len(input), 3, 3)

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        return input.mT

    def inverse_transform(self, input: Any, flags: Any, transform: Any = None, size: Any = None) -> Tensor:
        return self.apply_transform(input, self._params, flags, transform)


@pytest.mark.parametrize("dtype", [torch.float32, torch.int64, torch.bool, torch.uint8], ids=str)
def test_masks_follow_what_a_user_overrides(dtype: torch.dtype) -> None:
    x = images()
    masks = (10 * x[:, :1]).to(dtype)
    augment = A.AugmentationSequential(DiagonalFlip(p=0.5), data_keys=["image", "mask"])
    moved = augment(x, masks)[1]
    chosen = augment._params[0].data["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 8 and moved.dtype == dtype
    assert torch.equal(moved[chosen], masks[chosen].mT) and torch.equal(moved[~chosen], masks[~chosen])
    always = A.AugmentationSequential(DiagonalFlip(p=1.0), data_keys=["image", "mask"])
    back, masks_back = always.inverse(*always(x, masks))
    assert torch.equal(back, x) and torch.equal(masks_back, masks)


class Blank(A.IntensityAugmentationBase2D):
    """Writes to its input, and to masks."""

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        input[..., :4] = 0
        return input

    def apply_transform_mask(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        return torch.cat([torch.zeros_like(input[..., :4]), input[..., 4:]], -1)


def test_a_method_for_masks_and_samples_that_are_not_chosen() -> None:
    x, masks = images() + 1, torch.ones(8, 1, 12, 12, dtype=torch.int64)
    augment = A.AugmentationSequential(Blank(p=0.5), data_keys=["image", "mask"])
    y, moved = augment(x, masks)
    chosen = augment._params[0].data["batch_prob"] > 0.5
    assert 0 < chosen.sum() < 8
    assert not y[chosen][..., :4].any() and not moved[chosen][..., :4].any()
    assert (y[~chosen] >= 1).all() and (moved[~chosen] == 1).all()
    assert torch.equal(x, images() + 1)


class Remembered(A.IntensityAugmentationBase2D):
    """Draws where it is applied, and keeps what it drew in `_params`, on the device and in the type of `_params`."""

    def __init__(self, p: float) -> None:
        super().__init__(p=p)
        self.device = torch.device("cpu")  # as users set it

    def apply_transform(self, input: Any, params: Any, flags: Any, transform: Any = None) -> Tensor:
        if "noise" not in params:
            self._params["noise"] = torch.rand(input.shape, device=self.device, dtype=self.dtype)
        return input + params.get("noise", self._params["noise"]).to(input)


def test_parameters_that_are_added_in_a_call_are_replayed() -> None:
    x, augment = images(), Remembered(p=1.0)
    y = augment(x)
    assert torch.equal(augment(x, params=augment._params), y) and not torch.equal(augment(x), y)
    chain = A.ImageSequential(A.RandomHorizontalFlip(), Remembered(p=1.0))
    y = chain(x)
    assert torch.equal(chain(x, params=chain._params), y)


def test_repr_has_the_arguments() -> None:
    augment = A.RandomAffine(30.0, (0.1, 0.2), p=0.3, padding_mode="border")
    text = repr(augment)
    assert text.startswith("RandomAffine(degrees=30.0, translate=(0.1, 0.2), scale=None, shear=None, ")
    assert "padding_mode=border" in text and "p=0.3" in text and "\n" not in text
    augment.p = 0.7
    augment.flags["align_corners"] = True
    assert "p=0.7" in repr(augment) and "align_corners=True" in repr(augment)
    assert repr(copy.deepcopy(augment)) == repr(pickle.loads(pickle.dumps(augment))) == repr(augment)
    assert repr(Gain(0.5, high=0.9)) == "Gain(low=0.5, high=0.9, p=0.5, p_batch=1.0, same_on_batch=False)"
    assert repr(DiagonalFlip(0.2)) == "DiagonalFlip(p=0.2, p_batch=1.0, same_on_batch=False)"
    assert list(inspect.signature(A.AugmentationBase2D).parameters)[:2] == ["p", "p_batch"]
    inside = A.AugmentationSequential(A.RandomBrightness((0.5, 1.5)), data_keys=["image"])
    assert "RandomBrightness(brightness=(0.5, 1.5), clip_output=True, p=1.0" in repr(inside)


@functools.cache
def page() -> dict[str, Any]:
    """What docs/own_augmentation.md defines: Dim declares color steps, Tilt the formula of its matrix."""
    text = (Path(__file__).parents[2] / "docs" / "own_augmentation.md").read_text()
    scope: dict[str, Any] = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), scope)
    return scope


def test_declared_classes_are_joined_with_their_neighbors(device: torch.device, backend: str) -> None:
    scope, x = page(), torch.rand(32, 3, 16, 20, device=device)
    tilt, dim = scope["Tilt"](20.0, 0.0, p=0.7), scope["Dim"](0.2, 0.8, p=0.5)
    chain = A.ImageSequential(A.RandomHorizontalFlip(), tilt, dim, A.RandomInvert())
    labeled = scope["augment"].to(device)
    labels = [scope[name].to(device) for name in ("images", "masks", "boxes")]
    chain(x)  # which plans
    labeled(*labels)
    with DispatchedOperators() as called:
        y = chain(x)
    with DispatchedOperators() as called_with_labels:
        labeled(*labels)
    if backend != "reference" and device.type not in _backend.unserved:
        assert called.names == ["empty", "random_", "draw_warp_and_color"]
        names = called_with_labels.names
        assert names.count("draw_warp_and_color") == 1 and not {"warp_and_color", "draw_parameters"} & set(names)
    expected = x
    for child, item in zip(chain.children(), chain._params):
        expected = child(expected, params=item.data)
    torch.testing.assert_close(y, expected)
    factors, chosen = (chain._params[2].data[name].to(device) for name in ("factor", "batch_prob"))
    dimmed = torch.where(chosen > 0.5, factors, 1.0)[:, None, None, None] * x
    torch.testing.assert_close(chain[2](x, params=chain._params[2].data), dimmed)
    angles, chosen = (chain._params[1].data[name] for name in ("angle", "batch_prob"))
    cosines = torch.where(chosen > 0.5, angles.deg2rad().cos(), 1.0)
    torch.testing.assert_close(chain[1].transform_matrix[:, 0, 0].cpu(), cosines)


def test_names_of_columns() -> None:
    """A field names its columns, and what no field is called is refused where it is used."""
    names = columns.name_columns([("angle", 0), ("shift", 2)], 3)
    move = A.Transform.affine((0.0, 0.0), angle="angle", translation="shift", scale=("shift[1]", 1.0))._bound(names)
    assert transforms.make_plan([move])[0] == [0, 3, 4, 5, 5, -1, -1, -1, -1, -1]
    for make, message in (
        (lambda: A.Transform("shear", 1.0), "expected kind to be one of affine"),
        (lambda: A.Transform("crop", "shift")._bound(names), "expected 7 inputs of 'crop', got 2"),
        (lambda: A.Transform("crop", "window")._bound(names), "expected the name of a field, .*, got 'window'"),
        (lambda: A.ColorStep("brighten"), "expected name to be one of affine"),
        (lambda: A.ColorStep("hue", 1.0, 2.0), "expected at most 1 parameters of 'hue'"),
        (lambda: A.ColorStep("affine", "angle")._bound(names), "expected numbers as parameters of 'affine'"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


def test_fields_are_the_columns_that_are_drawn() -> None:
    """Of all generators that name their columns, for images of any size."""
    named = 0
    for case in IMAGES:
        generator: Any = case.make(p=0.7)._param_generator
        if generator is not None and generator.fields:
            drawn = sum(draw.columns for draw in generator.draws((2, 3, 12, 16)))
            if generator.derives:
                drawn = generator.derive(torch.zeros(2, drawn), torch.tensor([[12.0, 16.0]]), None).shape[1]
            assert sum(width or 1 for _, width in generator.fields) == drawn, case.name
            named += 1
    assert named > 20


def test_no_class_of_the_library_counts_as_a_users() -> None:
    """Every method of the library that replaces another keeps the contract; one of a user, or of an object, does not."""
    classes = [value for value in vars(A).values() if isinstance(value, type) and issubclass(value, AugmentationBase)]
    assert len(classes) > 60
    for cls in classes:
        assert all(getattr(cls, name, None) is method for name, method in cls._own_methods.items()), cls.__name__
    assert not A.RandomAffine(10.0)._is_customized() and not page()["dim"]._is_customized()
    assert Gain(0.5, 0.9)._is_customized() and DiagonalFlip()._is_customized()
    flip = A.RandomHorizontalFlip(p=1.0)
    flip.apply_transform = lambda input, *_: input + 1  # type: ignore[method-assign]
    assert torch.equal(flip(images()), images() + 1)
