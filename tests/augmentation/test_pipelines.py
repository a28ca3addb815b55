"""Training pipelines as users of torchvision, Albumentations and Kornia write them, and what they must not do in silence."""

from __future__ import annotations

import copy
import io
import pickle
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision.augmentation as A


def images(device: Any = "cpu", batch: int = 4) -> Tensor:
    return torch.rand(batch, 3, 32, 48, generator=torch.Generator().manual_seed(batch)).to(device)


# --- masks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int64, torch.float32], ids=str)
@pytest.mark.parametrize(
    "child",
    [
        A.RandomTranslate((0.5, 0.5), p=1.0),
        A.RandomCrop((48, 64), pad_if_needed=True, fill=0.5),
        A.RandomErasing((0.2, 0.3), p=1.0),
        A.RandomElasticTransform((5, 5), (1.5, 1.5), (8.0, 8.0), p=1.0),
        A.ImageSequential(A.RandomTranslate((0.5, 0.5), p=1.0)),
        A.auto.PolicyAugmentBase([[("translate_x", 1.0, 0.4, 0.4)]]),
    ],
    ids=lambda child: type(child).__name__,
)
def test_ignore_value_of_masks(child: Any, dtype: torch.dtype, device: torch.device) -> None:
    """Pixels that a mask does not have get the value that the loss ignores; the others are not interpolated with it."""
    masks = torch.full((4, 32, 48), 7, dtype=dtype, device=device)
    flags = {"mask": {"fill_value": 255}}
    augment = A.AugmentationSequential(copy.deepcopy(child), data_keys=["image", "mask"], extra_args=flags)
    moved = augment(images(device), masks)[1]
    assert moved.dtype == dtype and set(moved.unique().tolist()) == {7, 255}
    zeros = A.AugmentationSequential(copy.deepcopy(child), data_keys=["image", "mask"])
    zeros(images(device), masks)
    again = zeros(images(device), masks, params=augment._params)[1]
    assert torch.equal(again == 0, moved == 255)


def test_stacks_of_instances(device: torch.device) -> None:
    """Each image has as many instances as it has; results keep their numbers."""
    stacks = [torch.rand(n, 32, 48, device=device) > 0.5 for n in (2, 0, 1, 5)]
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["image", "mask"])
    moved = augment(images(device), stacks)[1]
    assert isinstance(moved, list) and all(torch.equal(m, s.flip(-1)) for m, s in zip(moved, stacks))


@pytest.mark.parametrize(
    ("key", "label", "message"),
    [
        ("mask", torch.zeros(4, 1, 16, 24), r"expected mask of 4 images of \(32, 48\), got \(4, 1, 16, 24\)"),
        ("mask", torch.zeros(3, 1, 32, 48), r"expected mask of 4 images of \(32, 48\), got \(3, 1, 32, 48\)"),
        ("bbox_xyxy", torch.zeros(3, 2, 4), "expected bbox_xyxy of 4 images, got those of 3"),
        ("bbox_xyxy", torch.zeros(5, 4), "expected bbox_xyxy of 4 images, got those of 1"),
        ("bbox", [torch.zeros(2, 4, 2)] * 3, "expected bbox of 4 images, got those of 3"),
        ("keypoints", torch.zeros(2, 5, 2), "expected keypoints of 4 images, got those of 2"),
    ],
)
def test_labels_of_other_images(key: str, label: Any, message: str) -> None:
    augment = A.AugmentationSequential(A.RandomAffine(10.0, p=1.0), data_keys=["image", key])
    with pytest.raises(ValueError, match=message):
        augment(images(), label)


# --- mixing in containers -----------------------------------------------------------------------------------------------

BOXES = torch.tensor([[[2.0, 2, 20, 12], [24.0, 16, 46, 30]]]).expand(4, 2, 4)
MIXES = {
    "cut": lambda: A.RandomCutMixV2(cut_size=(0.6, 0.6), p=0.5),
    "patch": lambda: A.PatchMix(patch_size=20, p=0.5),
    "mosaic": lambda: A.RandomMosaic(p=0.5),
    "jigsaw": lambda: A.RandomJigsaw((2, 3), p=0.5),
}


@pytest.mark.parametrize("name", MIXES)
@pytest.mark.parametrize("nested", [False, True])
def test_boxes_follow_mixed_images(name: str, nested: bool, device: torch.device) -> None:
    """Where the result has the color of a label, a box with this label is around it, and boxes have nothing else."""
    flip, mix = A.RandomHorizontalFlip(), MIXES[name]()
    children: list[Any] = [flip, A.ImageSequential(mix) if nested else mix, A.RandomVerticalFlip()]
    augment = A.AugmentationSequential(*children, data_keys=["image", "bbox_xyxy", "class", "mask"])
    boxes = BOXES.to(device) + torch.arange(4, device=device)[:, None, None]  # other boxes in each image
    labels = 1 + torch.arange(8, device=device).view(4, 2)
    painted = torch.zeros(4, 1, 32, 48, device=device)
    for b, (own, names) in enumerate(zip(boxes.long().tolist(), labels.tolist())):
        for (x, y, right, bottom), label in zip(own, names):
            painted[b, :, y:bottom, x:right] = label
    for seed in range(4):
        moved, result, classes, mask = augment(painted, boxes, labels, painted.long(), seed=seed)
        assert torch.equal(moved.long(), mask) and result.shape[:2] == classes.shape
        for image, own, names in zip(moved[:, 0], result.round().long(), classes):
            covered = torch.zeros_like(image, dtype=torch.bool)
            for (x, y, right, bottom), label in zip(own.tolist(), names.tolist()):
                inside = image[max(y, 0) : max(bottom, 0), max(x, 0) : max(right, 0)]
                if inside.numel():
                    covered[max(y, 0) : bottom, max(x, 0) : right] |= inside == label
                    assert (inside == label).any(), (seed, label)
            assert ((image > 0) == covered).all(), seed


def test_labels_of_mixed_images(device: torch.device) -> None:
    """As the operation gives them by itself; an operation that cannot mix labels refuses them."""
    x, labels = images(device), torch.arange(4, device=device)
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(), A.RandomMixUpV2(p=1.0), data_keys=["image", "class"])
    mixed, mixed_labels = augment(x, labels)
    partners, weights = mixed_labels[:, 1].long(), mixed_labels[:, 2, None, None, None]
    assert torch.equal(mixed_labels[:, 0], labels.float())
    flipped = augment.get_submodule("RandomHorizontalFlip_0")(x, params=augment._params[0].data)
    torch.testing.assert_close(mixed, flipped * (1 - weights) + flipped[partners] * weights)
    for key, label in {"bbox_xyxy": BOXES.to(device), "keypoints": BOXES[..., :2].to(device)}.items():
        with pytest.raises(NotImplementedError, match="RandomMixUpV2: .* cannot be mixed"):
            augment(x, label, data_keys=["image", key])
    with pytest.raises(TypeError, match="expected bbox_xyxy to be a Tensor"):
        augment(x, list(BOXES.to(device)), data_keys=["image", "bbox_xyxy"])
    points = BOXES[..., :2].to(device)
    jigsaw = A.RandomJigsaw((2, 3), p=1.0)
    chain = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), jigsaw, data_keys=["image", "keypoints"])
    expected = jigsaw(
        x.flip(-1), torch.stack([47 - points[..., 0], points[..., 1]], -1), data_keys=["image", "keypoints"], seed=3
    )
    moved = chain(
        x,
        points,
        params=[*chain.forward_parameters(x.shape)[:1], A.container.ParamItem("RandomJigsaw_1", jigsaw._params)],
    )
    torch.testing.assert_close(moved[1], expected[1])
    with pytest.raises(ValueError, match="expected a mask among the data_keys"):
        A.AugmentationSequential(A.RandomTransplantation(p=1.0))(x)


# --- copies, saved parameters, arguments ----------------------------------------------------------------------------------


def test_copies_leave_the_last_call_behind() -> None:
    """After a call whose tensors carry gradients, modules can still be copied and pickled."""
    points = torch.rand(4, 2, 2).requires_grad_()
    degrees = nn.Parameter(torch.tensor([-10.0, 10.0]))
    augment = A.AugmentationSequential(
        A.RandomRotation(degrees, p=1.0), A.ColorJitter(0.2, 0.2, 0.2, 0.1), data_keys=["image", "keypoints"]
    )
    augment(images().requires_grad_(), points)
    assert augment.transform_matrix is not None
    for other in (copy.deepcopy(augment), pickle.loads(pickle.dumps(augment))):
        assert other.transform_matrix is None and other._params == []
        assert torch.equal(other(images(), points, seed=1)[0], augment(images(), points, seed=1)[0])
    policy = A.auto.RandAugment(2, 9)
    policy(images())
    assert copy.deepcopy(policy)._params is not None
    augment.clear_state()
    assert augment.transform_matrix is None and augment.kept_boxes == []
    alone = copy.deepcopy(augment.get_submodule("RandomRotation_0"))
    assert alone._params == {} and alone.transform_matrix is None


def test_saved_parameters_are_loaded_as_weights() -> None:
    """torch.load reads what torch.save wrote, without weights_only=False."""
    for augment in (
        A.AugmentationSequential(A.RandomAffine(30.0), A.ColorJitter(0.2, 0.2, 0.2, 0.1), A.auto.RandAugment(2, 9)),
        A.PatchSequential(A.RandomInvert(), A.RandomHorizontalFlip(), grid_size=(1, 2)),
    ):
        y = augment(images())
        file = io.BytesIO()
        torch.save(augment._params, file)
        file.seek(0)
        assert torch.equal(augment(images(), params=torch.load(file)), y)


def test_fill_of_bytes(device: torch.device) -> None:
    """Fill values are those of images in [0, 1]: bytes get 255 times as much."""
    stored = torch.full((2, 3, 8, 8), 51, dtype=torch.uint8, device=device)
    for augment in (
        A.RandomCrop((12, 12), pad_if_needed=True, fill=0.4),
        A.PadTo((12, 12), pad_value=0.4),
        A.RandomAffine(0.0, (0.5, 0.5), padding_mode="fill", fill_value=torch.full((3,), 0.4), p=1.0),
        A.ImageSequential(
            A.RandomHorizontalFlip(), A.RandomCrop((12, 12), pad_if_needed=True, fill=0.4), A.RandomInvert(p=0.0)
        ),
    ):
        y = augment(stored, seed=2)
        assert {51, 102} <= set(y.unique().tolist()), augment
        torch.testing.assert_close(augment(stored / 255.0, seed=2) * 255, y.float(), atol=0.51, rtol=0)


@pytest.mark.parametrize("channels", [1, 2, 4, 13])
def test_images_without_colors_have_brightness_and_contrast(channels: int, device: torch.device) -> None:
    x = torch.rand(6, channels, 8, 9, device=device, generator=torch.Generator(device).manual_seed(1))
    order = (1, 3, 0, 2)
    jitter, jiggle = (f((0.8, 1.2), (0.5, 0.9), 0.5, 0.3, p=0.7, order=order) for f in (A.ColorJitter, A.ColorJiggle))
    for augment in (jitter, jiggle):
        y = augment(x, seed=4)
        factor = {name: augment._params[f"{name}_factor"].to(device) for name in ("brightness", "contrast")}
        brightness, contrast = (factor[name][:, None, None, None] for name in ("brightness", "contrast"))
        if augment is jitter:
            mean = x.mean((1, 2, 3), keepdim=True)
            expected = ((mean + (x - mean) * contrast).clamp(0, 1) * brightness).clamp(0, 1)
        else:
            expected = ((x * contrast).clamp(0, 1) + brightness - 1).clamp(0, 1)
        chosen = augment._params["batch_prob"].to(device)[:, None, None, None] > 0.5
        torch.testing.assert_close(y, torch.where(chosen, expected, x))
        assert torch.equal(augment(x, params=augment._params), y)
        flipped = A.ImageSequential(A.RandomHorizontalFlip(p=1.0), augment)
        z = flipped(x, seed=4)
        torch.testing.assert_close(z, augment(x.flip(-1), params=flipped._params[1].data))
    for augment in (A.RandomHue((0.2, 0.3)), A.RandomSaturation((0.2, 0.3))):
        assert torch.equal(augment(x), x)


def test_refusals() -> None:
    jitter, shift = A.ColorJitter(0.2, 0.2, 0.2, 0.1), A.RandomRGBShift(p=1.0)
    with pytest.raises(ValueError, match=r"RandomRGBShift: expected images with 3 channels, got 1"):
        A.ImageSequential(A.RandomHorizontalFlip(), shift)(torch.rand(2, 1, 8, 8))
    with pytest.raises(ValueError, match="RandomRGBShift: expected images with 3 channels"):
        shift(torch.rand(2, 4, 8, 8))
    with pytest.raises(TypeError, match="ImageSequential: expected input of a floating-point type or uint8"):
        A.ImageSequential(A.RandomHorizontalFlip())(torch.zeros(1, 3, 8, 8, dtype=torch.int64))
    container = A.ImageSequential(jitter)
    with pytest.raises(ValueError, match="expected seeds of 4 samples, got 3"):
        container(images(), seed=torch.arange(3))
    with pytest.raises(ValueError, match="ColorJitter: expected seeds of 4 samples, got 3"):
        jitter(images(), seed=torch.arange(3))
    container(images())
    with pytest.raises(ValueError, match="ColorJitter: expected params of a batch of 2, got those of 4 images"):
        container(images()[:2], params=container._params)


def test_classes_of_a_program_without_a_name() -> None:
    """Code that exec runs, as notebooks and tools do, may have no module."""
    scope: dict[str, Any] = {"A": A}
    exec(
        "class Double(A.IntensityAugmentationBase2D):\n"
        "    def apply_transform(self, input, params, flags, transform=None):\n"
        "        return 2 * input\n",
        scope,
    )
    x = images()
    assert torch.equal(A.ImageSequential(A.RandomHorizontalFlip(p=1.0), scope["Double"](p=1.0))(x), 2 * x.flip(-1))
