"""What callers hand to augmentations: pairs with matrices, lists, dictionaries, images of NumPy and PIL."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision import migrate

FLIP = A.RandomHorizontalFlip(p=1.0)
FLIP3D = A.RandomHorizontalFlip3D(p=1.0)


def images(*shape: int) -> Tensor:
    return torch.rand(*(shape or (2, 3, 4, 6)), generator=torch.Generator().manual_seed(0))


# --- pairs ----------------------------------------------------------------------------------------------------------

TAKERS: dict[str, Callable[..., Any]] = {
    "alone": FLIP,
    "operation": A.auto.operations.OperationBase(FLIP),
    "policy": A.auto.RandAugment(1, 1),
    "ImageSequential": A.ImageSequential(FLIP),
    "AugmentationSequential": A.AugmentationSequential(FLIP),
    "dict": lambda x: A.AugmentationSequential(FLIP, data_keys=None)({"image": x})["image"],
    "PatchSequential": A.PatchSequential(FLIP, patchwise_apply=False),
    "dispatcher": lambda x: A.ManyToManyAugmentationDispather(FLIP)(x)[0],
}
takers = pytest.mark.parametrize("name", TAKERS)


@takers
def test_a_tuple_with_matrices_is_a_pair(name: str) -> None:
    x = images()
    for matrix in (torch.eye(3), torch.eye(3).expand(2, 3, 3)):
        y, after = TAKERS[name]((x, matrix))
        assert y.shape == x.shape and after is matrix


def test_pairs_of_videos_and_volumes() -> None:
    videos, volumes = images(2, 5, 3, 4, 6), images(2, 1, 3, 4, 6)
    assert A.VideoSequential(FLIP)((videos, torch.eye(3).expand(10, 3, 3)))[0].shape == videos.shape
    assert FLIP3D((volumes, torch.eye(4)))[0].shape == volumes.shape
    chain = A.ImageSequential(FLIP3D, return_transform=True)
    assert chain((volumes, torch.eye(4).expand(2, 4, 4)))[1].shape == (2, 4, 4)
    with pytest.raises(
        ValueError, match=r"VideoSequential: expected a pair .* \(10, 3, 3\) or \(3, 3\), got \(2, 3, 3\)"
    ):
        A.VideoSequential(FLIP)((videos, torch.eye(3).expand(2, 3, 3)))
    with pytest.raises(ValueError, match=r"RandomHorizontalFlip3D: .* \(2, 4, 4\) or \(4, 4\), got \(3, 3\)"):
        FLIP3D((volumes, torch.eye(3)))


@takers
def test_other_sequences_are_refused(name: str) -> None:
    """`aug([image0, image1])` augmented the first one and returned the second untouched."""
    x, matrix = images(), torch.eye(3)
    for count in (1, 2, 3):
        with pytest.raises(TypeError, match=f"got a list of {count} images; stack them"):
            TAKERS[name]([x] * count)
    with pytest.raises(TypeError, match="got a list of 2 images"):
        TAKERS[name]([x, matrix])
    with pytest.raises(TypeError, match="got a tuple of 3 images"):
        TAKERS[name]((x, x, x))
    with pytest.raises(ValueError, match=r"expected a pair .* got \(2, 3, 4, 6\); stack images"):
        TAKERS[name]((x, x))
    with pytest.raises(ValueError, match=r"of shape \(2, 3, 3\) or \(3, 3\), got \(3, 3, 3\)$"):
        TAKERS[name]((x, matrix.expand(3, 3, 3)))
    with pytest.raises(TypeError, match="expected the matrices of a pair to be floating point, got torch.int64"):
        TAKERS[name]((x, matrix.long()))


def test_further_images_are_no_pairs() -> None:
    x = images()
    both = A.AugmentationSequential(FLIP, data_keys=["image", "image"])
    for second in ([x, x], (x, torch.eye(3))):
        with pytest.raises(
            TypeError, match=r"AugmentationSequential: expected input to be a Tensor, got a \w+ of 2 images"
        ):
            both(x, second)


def test_a_dispatcher_unpacks_for_what_takes_several() -> None:
    x, both = images(), A.AugmentationSequential(FLIP, data_keys=["image", "mask"])
    (y, mask), z = A.ManyToManyAugmentationDispather(both, FLIP)((x, x[:, :1]), x)
    assert torch.equal(y, x.flip(-1)) and torch.equal(mask, x[:, :1].flip(-1)) and torch.equal(z, y)


# --- dictionaries ---------------------------------------------------------------------------------------------------


def as_dict(data: dict[Any, Any], **options: Any) -> dict[Any, Any]:
    """Data flipped, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return A.AugmentationSequential(FLIP, data_keys=None, **options)(data)


def test_names_of_data_keys_are_data() -> None:
    x = images()
    boxes, points, mask = (
        torch.tensor([[[1.0, 0, 3, 2]]]),
        torch.tensor([[[1.0, 1]]]),
        torch.arange(24).reshape(1, 1, 4, 6),
    )
    data = {
        "Image": x[:1],
        "image_2": x[1:],
        "image-left": x[:1].double(),
        "masks": mask,
        "mask_a": mask[0, 0],
        "mask-b": [mask[0]],
        "bbox_xyxy": boxes,
        "bbox_xyxy_old": [boxes[0]],
        "keypoints": points,
        "keypoints_3": points.double(),
        "label": torch.ones(1),
    }
    result = as_dict(data)
    assert list(result) == list(data)
    for name in ("Image", "image_2", "image-left", "masks", "mask_a"):
        assert torch.equal(result[name], data[name].flip(-1)), name
    assert torch.equal(result["mask-b"][0], mask[0].flip(-1))
    for moved in (result["bbox_xyxy"][0], result["bbox_xyxy_old"][0]):
        assert moved.tolist() == [[3, 0, 5, 2]]
    assert result["keypoints"].tolist() == [[[4, 1]]] and result["keypoints_3"].tolist() == [[[4, 1]]]
    assert result["label"] is data["label"]


@pytest.mark.parametrize("dtype", [torch.int16, torch.uint16], ids=str)
def test_images_of_16_bit_integers_follow_geometric_children(dtype: torch.dtype) -> None:
    depth = torch.arange(48).reshape(2, 1, 4, 6).to(dtype)
    data = {"image": images(), "image_depth": depth}
    assert torch.equal(as_dict(data)["image_depth"].int(), depth.int().flip(-1))
    assert as_dict({"image_left": depth})["image_left"].dtype == dtype  # the first image
    colors = A.AugmentationSequential(FLIP, A.RandomBrightness(p=1.0), data_keys=None)
    with pytest.warns(UserWarning, match="'image_depth' passes through unchanged"):
        assert colors(data)["image_depth"] is depth


def test_everything_else_passes_through() -> None:
    x, ids, features = images(), torch.arange(2), images(2, 512)
    data = {
        "path": "a.png",
        "meta": {"split": 1},
        "orig_size": torch.tensor([[480, 640], [480, 640]]),
        "image_id": ids,
        "image_ids": ids,
        "image_path": ["a.png", "b.png"],
        "mask_name": "a",
        "class_names": ["cat", "dog", "horse"],
        "bbox_size": torch.ones(2, 5, 4),
        "image_features": features,
        "image_caption": "a flip",
        "mask_weights": torch.ones(2),
        "keypoints_visible": torch.ones(2, 17, dtype=torch.bool),
        "class_weights": torch.ones(10),
        "input_ids": torch.ones(2, 7, dtype=torch.int64),
        7: "a number as a name",
        "image": x,
    }
    result = as_dict(data)
    assert list(result) == list(data) and torch.equal(result.pop("image"), x.flip(-1))
    assert all(value is data[name] for name, value in result.items())


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("image", "none.png", "none.png"),
        ("image", None, "expected input to be a Tensor, got NoneType"),
        ("mask", "a.png", "expected mask to be a Tensor, got str"),
        ("masks", torch.zeros(1, 1, 2, 2), "expected mask of 2 images of .* got"),
        ("bbox_xyxy", torch.ones(2, 3, 5), "expected boxes of shape"),
        ("keypoints", torch.ones(2, 5, 2, dtype=torch.int64), "expected keypoints of a floating-point type"),
    ],
)
def test_values_of_exact_names_have_to_fit(name: str, value: Any, text: str) -> None:
    with pytest.raises((TypeError, ValueError, FileNotFoundError), match=text):
        as_dict({"image": images(), name: value})


def test_keys_name_further_data() -> None:
    x, boxes = images(), torch.tensor([[1.0, 0, 3, 2]]).expand(2, 1, 4)
    data = {"pixel_values": x, "boxes": boxes, "labels": torch.tensor([[1], [2]]), "mask": x[:, :1]}
    keys = {"boxes": "bbox_xyxy", "labels": "class", "pixel_values": "image"}
    result = as_dict(data, keys=keys, min_box_area=100)
    assert torch.equal(result["pixel_values"], x.flip(-1)) and torch.equal(result["mask"], x[:, :1].flip(-1))
    assert not result["boxes"].any() and (result["labels"] == -1).all()  # too small, with their classes
    flip = A.AugmentationSequential(FLIP, data_keys=None, keys=keys)
    moved = flip(data)
    assert moved["boxes"][0].tolist() == [[3, 0, 5, 2]]
    back = flip.inverse({**moved, "path": "a"})
    assert torch.equal(back["pixel_values"], x) and torch.equal(back["boxes"], boxes) and back["path"] == "a"
    with pytest.raises(
        ValueError, match=r"AugmentationSequential: expected the values of keys to be of .* got \{'a': 'b'\}"
    ):
        A.AugmentationSequential(FLIP, keys={"a": "b"})
    with pytest.raises(TypeError, match="AugmentationSequential: expected keys to be a dict"):
        A.AugmentationSequential(FLIP, keys=["boxes"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("depth", images(2, 1, 4, 6), "it has the size of the image"),
        ("maks", torch.ones(2), "its name is like 'mask'"),
        ("labels", torch.ones(2), "its name is like 'label'"),
        ("boxes", [torch.ones(1, 4), torch.ones(2, 4)], "its name is like 'boxes'"),
        ("image2", torch.ones(2), "its name is like 'image'"),
    ],
)
def test_what_looks_like_data_warns_once(name: str, value: Any, reason: str) -> None:
    flip = A.AugmentationSequential(FLIP, data_keys=None)
    with pytest.warns(
        UserWarning, match=f"AugmentationSequential: '{name}' passes through unchanged, although {reason}"
    ):
        assert flip({"image": images(), name: value})[name] is value
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flip({"image": images(), name: value})


def test_an_exact_name_decides_what_the_image_is() -> None:
    features, x = images(2, 3, 2, 2), images()
    augment = A.AugmentationSequential(A.CenterCrop((2, 2)), data_keys=None)
    result = augment({"image_features": features, "image": x, "mask": x[:, :1]})
    assert list(result) == ["image_features", "image", "mask"] and torch.equal(result["mask"], x[:, :1, 1:3, 2:4])


# --- images of NumPy and PIL ----------------------------------------------------------------------------------------

PHOTO = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
EXPECTED = torch.from_numpy(PHOTO).movedim(-1, 0)[None].flip(-1) / 255
CONTAINERS = {
    "ImageSequential": A.ImageSequential(FLIP),
    "AugmentationSequential": A.AugmentationSequential(FLIP),
    "PatchSequential": A.PatchSequential(FLIP, patchwise_apply=False, grid_size=(1, 1)),
}


@pytest.mark.parametrize("name", CONTAINERS)
def test_containers_take_pictures(name: str, tmp_path: Path) -> None:
    container = CONTAINERS[name]
    path = tmp_path / "photo.png"
    PIL.Image.fromarray(PHOTO).save(path)
    for picture in (PHOTO, PIL.Image.fromarray(PHOTO), str(path), PHOTO.astype(np.uint16) * 257):
        torch.testing.assert_close(container(picture), EXPECTED)
    assert container(PHOTO[..., 0]).shape == (1, 1, 4, 6) and container(PHOTO[None]).shape == (1, 3, 4, 6)
    assert container(PHOTO.astype(np.float64)).dtype == torch.float64
    array = container(PHOTO, output_type="numpy")
    np.testing.assert_allclose(array, (PHOTO[:, ::-1] / 255)[None], rtol=1e-6)
    (picture,) = container(PIL.Image.fromarray(PHOTO), output_type="pil")
    assert np.array_equal(np.asarray(picture), PHOTO[:, ::-1])
    with pytest.raises(ValueError, match="output_type must be one of pt, numpy, pil; got 'jax'"):
        container(PHOTO, output_type="jax")


def test_pictures_as_kornia_takes_them() -> None:
    kornia = pytest.importorskip("kornia.augmentation")
    theirs, ours = kornia.RandomHorizontalFlip(p=1.0), FLIP
    palette = PIL.Image.fromarray(PHOTO[..., 0]).convert("P")
    box, point = np.ones((1, 1, 4), np.float32), np.ones((1, 1, 2), np.float32)
    for picture in (PIL.Image.fromarray(PHOTO), PHOTO, PHOTO[..., 0], palette, np.stack([PHOTO, PHOTO])):
        for kind in ("pt", "numpy"):
            expected = kornia.ImageSequential(theirs)(picture, output_type=kind)
            result = A.ImageSequential(ours)(picture, output_type=kind)
            assert type(result) is type(expected)
            np.testing.assert_allclose(np.asarray(result), np.asarray(expected), rtol=1e-6)
    keys = ["input", "mask", "keypoints"]
    for mask in (palette, PHOTO[..., 0].astype(np.int64)):
        expected = kornia.AugmentationSequential(theirs, data_keys=keys)(PHOTO, mask, point)
        result = A.AugmentationSequential(ours, data_keys=keys)(PHOTO, mask, point)
        for a, b in zip(result, expected):
            torch.testing.assert_close(a, b.to(a.dtype))
    assert A.AugmentationSequential(ours, data_keys=["input", "bbox_xyxy"])(PHOTO, box)[1].tolist() == [[[5, 1, 5, 1]]]


def test_masks_of_pictures() -> None:
    labels = np.array([[0, 1, 300, 2, 2, 5]] * 4)
    both = A.AugmentationSequential(FLIP, data_keys=["image", "mask"])
    _, mask = both(PIL.Image.fromarray(PHOTO), labels)
    assert mask.dtype == torch.int64 and np.array_equal(mask[0, 0], labels[:, ::-1])
    pictures, masks = both(PHOTO, labels, output_type="pil")
    assert np.array_equal(np.asarray(masks[0]), labels[:, ::-1]) and pictures[0].size == (6, 4)
    assert both(np.stack([PHOTO] * 2), np.stack([labels] * 2))[1].shape == (2, 1, 4, 6)
    keeps = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["image", "mask"], keepdim=True)
    assert [x.shape for x in keeps(PHOTO, labels)] == [(3, 4, 6), (1, 4, 6)]
    assert [x.shape for x in keeps(PHOTO, labels, output_type="numpy")] == [(4, 6, 3), (4, 6, 1)]


def test_dicts_of_pictures() -> None:
    data = {
        "image": PIL.Image.fromarray(PHOTO),
        "image_2": PHOTO,
        "mask": PHOTO[..., 0],
        "path": "a",
        "image_size": (4, 6),
    }
    result = as_dict(data)
    torch.testing.assert_close(result["image"], EXPECTED)
    torch.testing.assert_close(result["image_2"], EXPECTED)
    assert np.array_equal(result["mask"][0, 0], PHOTO[:, ::-1, 0]) and result["path"] == "a"
    arrays = A.AugmentationSequential(FLIP, data_keys=None)({**data, "keypoints": images(1, 2, 2)}, output_type="numpy")
    assert arrays["image_2"].shape == (1, 4, 6, 3) and arrays["keypoints"].shape == (1, 2, 2) and arrays["path"] == "a"


def test_matrices_stay_tensors() -> None:
    array, matrix = A.ImageSequential(FLIP, return_transform=True)(PHOTO, output_type="numpy")
    assert array.shape == (1, 4, 6, 3) and matrix[0].tolist() == [[-1, 0, 5], [0, 1, 0], [0, 0, 1]]


def test_volumes_videos_and_single_augmentations_take_tensors() -> None:
    """Kornia's take no arrays; the axes of volumes and videos are not those of images."""
    for augment, x in ((A.ImageSequential(FLIP3D), PHOTO), (A.VideoSequential(FLIP), PHOTO), (FLIP, PHOTO)):
        with pytest.raises(
            TypeError, match="got ndarray; kvision.to_tensor converts images, torch.from_numpy other arrays"
        ):
            augment(x)
    _, mask = A.AugmentationSequential(FLIP3D, data_keys=["image", "mask"])(
        images(1, 1, 2, 4, 6), np.ones((1, 1, 2, 4, 6))
    )
    assert mask.shape == (1, 1, 2, 4, 6)
    with pytest.raises(TypeError, match="got Image; kvision.to_tensor converts PIL images"):
        FLIP(PIL.Image.fromarray(PHOTO))


def test_migrate_knows_what_changes_silently() -> None:
    rows = migrate.differences()
    for name in ("Normalize", "AugmentationSequential"):
        assert any(row.values for row in rows if migrate.concerns(row, ("augmentation", name))), name


def test_bytes_of_some_samples_of_ada() -> None:
    x = (255 * images()).to(torch.uint8)
    augment = A.presets.ada.AdaptiveDiscriminatorAugmentation(A.Normalize(0.5, 0.5), initial_p=0.5, data_keys=["image"])
    y = augment(x, seed=3)
    values = x.float() / 255
    for sample, value in zip(y, values):
        assert torch.allclose(sample, value, atol=1e-6) or torch.allclose(sample, 2 * value - 1, atol=1e-6)
    assert K.to_tensor(x, torch.float32).dtype == y.dtype
