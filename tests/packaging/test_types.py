"""A user's script, as type checkers see it: `make lint` has mypy and basedpyright read this file, as editors do.

Wrong arguments are marked: a checker that no longer finds one reports the mark.
"""

from __future__ import annotations

import inspect
from typing import Any, get_type_hints

import pytest
import torch
from torch import Tensor
from typing_extensions import assert_type

import kvision as K
from kvision.constants import DataKey

pytestmark = pytest.mark.interface


def test_right_arguments() -> None:
    image = torch.rand(1, 3, 8, 8)
    assert_type(K.filters.box_blur(image, 3, border_type="replicate"), Tensor)
    assert_type(K.filters.motion_blur(image, 3, 30.0, 0.5, mode="bilinear"), Tensor)
    assert_type(K.geometry.warp_affine(image, torch.eye(3)[None, :2], (4, 4), padding_mode="border"), Tensor)
    assert_type(K.losses.ssim_loss(image, image, 3, reduction="sum"), Tensor)

    assert_type(K.tv.RandomAffine(10, scale=(0.8, 1.2)), K.tv.RandomAffine)  # by its fields
    assert_type(K.tv.functional.crop(image, 0, 0, height=4, width=4), Tensor)

    affine = K.augmentation.RandomAffine((-10.0, 10.0), scale=(0.8, 1.2), resample="nearest", padding_mode="FILL")
    assert_type(affine, K.augmentation.RandomAffine)
    jitter = K.augmentation.ColorJitter(0.1, [0.9, 1.1], torch.tensor([0.9, 1.1]), hue=0.1)
    keys = ["input", "mask"]  # a list[str]
    augment = K.augmentation.AugmentationSequential(affine, jitter, data_keys=keys, resample="once")
    assert_type(augment, K.augmentation.AugmentationSequential)
    assert len(augment(image, image[:, :1], data_keys=["image", DataKey.MASK])) == 2


def test_wrong_arguments_are_found_before_they_run() -> None:
    image = torch.rand(1, 3, 8, 8)
    with pytest.raises(ValueError):
        K.filters.box_blur(image, 3, "mirror")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError):
        K.geometry.resize(image, 4, "bilinar")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError):
        K.losses.ssim_loss(image, image, 3, reduction="avg")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError):
        K.augmentation.RandomCrop((2, 2), cropping_mode="cut")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError):
        K.augmentation.RandomRotation(9.0, resample="cubic")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError):
        K.augmentation.RandomGamma(gamma="dark")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError):
        K.tv.ColorJitter(brightnes=0.1)  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError):
        K.tv.functional.crop(image, 0, 0, 4)  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]


def test_editors_complete_the_arguments_of_augmentations() -> None:
    classes = [value for name in dir(K.augmentation) if inspect.isclass(value := getattr(K.augmentation, name))]
    loose = set()
    for cls in classes:
        if not issubclass(cls, torch.nn.Module):
            continue
        types = get_type_hints(cls.__init__)
        for name, parameter in inspect.signature(cls.__init__).parameters.items():
            is_variadic = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
            if not is_variadic and types.get(name) in (Any, str):
                loose.add(f"{cls.__name__}.{name}")
    kornias = "ImageSequential.if_unsupported_ops", "VideoSequential.if_unsupported_ops", "RandomMosaic.padding_mode"
    assert loose == {*kornias}  # are taken, and change nothing
