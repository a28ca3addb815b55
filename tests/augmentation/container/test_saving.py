"""Pipelines in JSON and in files that torch.load reads with weights_only=True."""

from __future__ import annotations

import copy
import io
import json
from typing import Any

import pytest
import torch
from torch import nn

import kvision as K
import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import IMAGES, VOLUMES
from kvision.constants import DataKey, Resample

pytestmark = pytest.mark.interface

PIPELINES: dict[str, Any] = {
    "nested": lambda: A.AugmentationSequential(
        A.RandomAffine(30.0, (0.1, 0.1), padding_mode="border", resample=Resample.NEAREST, p=0.7),
        A.ImageSequential(A.ColorJitter(0.1, (0.8, 1.2), 0.1, 0.1), A.RandomInvert(p=0.5), random_apply=1),
        A.Normalize((0.5, 0.4, 0.3), torch.tensor([0.2, 0.2, 0.1])),
        data_keys=["image", DataKey.MASK],
        extra_args={DataKey.MASK: {"resample": Resample.NEAREST}},
        resample="once",
        output_dtype=torch.float32,
        memory_format=torch.channels_last,
        same_on_batch=True,
    ),
    "choices": lambda: A.ImageSequential(
        A.OneOf([A.RandomInvert(p=0.2), A.RandomHorizontalFlip(p=0.7)], 0.9),
        A.SomeOf([A.RandomAffine(30.0), A.RandomInvert()], (0, 3), True, 0.9, order=False, same_on_batch=False),
        A.RandomOrder(A.RandomInvert(), A.RandomApply([A.RandomJPEG(), A.Normalize(0.5, 0.5)], p=0.25), keepdim=True),
    ),
    "policies": lambda: A.ImageSequential(
        A.auto.RandAugment(2, 9), A.auto.AugMix(2), A.auto.PolicyAugmentBase([[("invert", 1.0, 0.0, 0.0)]])
    ),
    "patches": lambda: A.PatchSequential(A.RandomInvert(), A.RandomErasing(value=0.5), grid_size=(1, 2)),
    "noise": lambda: A.ImageSequential(
        A.RandomGaussianNoise(p=1.0),
        A.RandomElasticTransform(p=1.0),
        A.RandomMixUpV2(p=1.0),
        A.RandomCrop((8, 8), padding=1),
    ),
}


def result(pipeline: Any) -> torch.Tensor:
    x = torch.rand(2, 3, 16, 20, generator=torch.Generator().manual_seed(1))
    y = pipeline(x, x[:, :1], seed=3)[0] if getattr(pipeline, "data_keys", None) else pipeline(x, seed=3)
    return y[0] if isinstance(y, (tuple, list)) else y


@pytest.mark.parametrize("name", PIPELINES)
@pytest.mark.filterwarnings("error")
def test_saved_pipelines_do_the_same(name: str) -> None:
    pipeline = PIPELINES[name]()
    expected = result(pipeline)
    text = A.to_json(copy.deepcopy(pipeline), indent=1)
    again = A.from_json(text)
    assert A.to_json(again, indent=1) == text and repr(again) == repr(pipeline)
    file = io.BytesIO()
    torch.save(pipeline, file)
    file.seek(0)
    for other in (again, torch.load(file, weights_only=True)):
        assert type(other) is type(pipeline) and torch.equal(result(other), expected)


def test_every_class_is_saved() -> None:
    for sample in [*IMAGES, *VOLUMES]:
        options = {} if sample.fixed else {"p": 0.25, "same_on_batch": True, "keepdim": True}
        pipeline, file = A.ImageSequential(sample.make(**options)), io.BytesIO()
        torch.save(pipeline, file)
        file.seek(0)
        for other in (A.from_json(A.to_json(pipeline)), torch.load(file, weights_only=True)):
            assert repr(other) == repr(pipeline) and A.to_json(other) == A.to_json(pipeline)


def test_generators_are_loaded_as_weights() -> None:
    pipeline, file = A.RandomRotation(30.0, generator=torch.Generator().manual_seed(1)), io.BytesIO()
    torch.save(A.ImageSequential(pipeline, generator=torch.Generator()), file)
    file.seek(0)
    (child,) = torch.load(file, weights_only=True)
    assert torch.equal(child(torch.ones(1, 1, 8, 8)), pipeline(torch.ones(1, 1, 8, 8)))


def test_children_and_settings_are_those_of_the_pipeline() -> None:
    pipeline = A.ImageSequential(A.RandomInvert())
    pipeline.add_module("RandomHorizontalFlip_1", A.RandomHorizontalFlip())
    assert len(A.from_json(A.to_json(pipeline))) == 2
    pipeline[0].p = 0.1
    with pytest.raises(ValueError, match="RandomInvert was constructed with, but p was changed"):
        A.to_json(pipeline)
    affine = A.RandomAffine(30.0)
    affine.flags["resample"] = Resample.NEAREST
    with pytest.raises(ValueError, match="but flags was changed"):
        A.to_json(affine)


class _Dim(A.AugmentationBase2D):
    pass


@pytest.mark.parametrize(
    ("pipeline", "match"),
    [
        (A.ImageSequential(nn.Identity()), "got Identity: torch.save keeps other modules"),
        (_Dim(), "expected augmentations and containers of kvision, got _Dim"),
        (A.RandomInvert(generator=torch.Generator()), r"expected RandomInvert\(generator=\) to be .*, got Generator"),
        (1, "got int"),
    ],
)
def test_what_has_no_text(pipeline: Any, match: str) -> None:
    with pytest.raises(TypeError, match=match):
        A.to_json(pipeline)


@pytest.mark.parametrize(
    "part",
    [
        {"class": "os.system", "arguments": {"command": "true"}},
        {"class": "_Dim"},
        {"class": ["RandomInvert"]},
        {"class": "RandomInvert", "arguments": {"p": {"dtype": "nn"}}},
        {"class": "RandomInvert", "arguments": {"p": {"class": "RandomInvert"}}},
        {"class": "RandomInvert", "arguments": {"p": 2}},
        {"class": "ImageSequential", "children": [{"class": "print"}]},
        {"class": "ImageSequential", "call": "print"},
        {"class": "RandomInvert", "children": [{"class": "RandomInvert"}]},
        {"class": "RandomInvert", "arguments": {"p": {"enum": ["Resample"]}}},
        [],
    ],
)
def test_only_classes_of_kvision_are_made(part: Any) -> None:
    with pytest.raises(ValueError, match="expected"):
        A.from_json(json.dumps({"kvision": "0.1.0", "pipeline": part}))


@pytest.mark.parametrize("arguments", [{"degrees": 30.0, "angle": 1}, {}])
def test_arguments_that_a_class_does_not_have_or_lacks(arguments: dict[str, Any]) -> None:
    part = {"class": "RandomRotation", "arguments": arguments}
    with pytest.raises(TypeError, match="from_json: expected arguments of RandomRotation: .*(angle|degrees)"):
        A.from_json(json.dumps({"kvision": "0.1.0", "pipeline": part}))


@pytest.mark.parametrize("version", ["0.0.9", f"{K.__version__}+python"])
def test_versions_that_are_read(version: str) -> None:
    assert A.from_json(json.dumps({"kvision": version, "pipeline": {"class": "RandomInvert"}}))


@pytest.mark.parametrize("version", ["99.0.0", "new", "", 1])
def test_versions_that_are_not(version: Any) -> None:
    with pytest.raises(ValueError, match=f"from_json: expected .*got .*{version}"):
        A.from_json(json.dumps({"kvision": version, "pipeline": {"class": "RandomInvert"}}))


@pytest.mark.parametrize(
    ("text", "error"), [("{", ValueError), (b"\x80", ValueError), ("[]", ValueError), (None, TypeError)]
)
def test_texts_that_describe_nothing(text: Any, error: type[Exception]) -> None:
    with pytest.raises(error, match="from_json: expected text"):
        A.from_json(text)
