"""Random containers with batches for them, each drawn from a seed: of images, videos and volumes, and with mixes.

A batch shows blobs, of which masks, boxes and key points are known. Sizes and distances are those of images 64 pixels high, times
`scale`.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

import kvision.augmentation as A
from kvision.constants import DataKey

KINDS = ("images", "videos", "volumes", "mixes")
RADIUS = 6
FLOATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16)

Maker = Callable[[float, float], nn.Module]  # of a probability and a scale


def _size(scale: float, *sides: int) -> tuple[int, ...]:
    return tuple(round(scale * n) for n in sides)


def _odd(n: float) -> int:
    return 2 * round(n / 2) + 1


KEEP_SIZE: list[Maker] = [
    lambda p, s: A.RandomHorizontalFlip(p=p),
    lambda p, s: A.RandomVerticalFlip(p=p),
    lambda p, s: A.RandomRotation(25.0, p=p),
    lambda p, s: A.RandomAffine(20.0, (0.1, 0.1), (0.9, 1.1), p=p),
    lambda p, s: A.RandomPerspective(0.2, p=p),
    lambda p, s: A.RandomTranslate((-0.1, 0.1), (-0.1, 0.1), p=p),
    lambda p, s: A.RandomShear((-5.0, 5.0), p=p),
]
MAPS: list[Maker] = [
    lambda p, s: A.RandomThinPlateSpline(0.1, p=p),
    lambda p, s: A.RandomElasticTransform((_odd(20 * s),) * 2, (8.0 * s, 8.0 * s), (0.2, 0.2), p=p),
    lambda p, s: A.RandomFisheye((-0.1, 0.1), (-0.1, 0.1), (0.9, 1.2), p=p),
]
CHANGE_SIZE: list[Maker] = [
    lambda p, s: A.RandomResizedCrop(_size(s, 64, 80), scale=(0.7, 1.0), p=1.0),
    lambda p, s: A.RandomCrop(_size(s, 56, 64), p=1.0),
    lambda p, s: A.CenterCrop(_size(s, 56, 64), p=1.0),
    lambda p, s: A.Resize(_size(s, 60, 72), p=1.0),
    lambda p, s: A.PadTo(_size(s, 90, 100)),
]
PHOTOMETRIC: list[Maker] = [
    lambda p, s: A.RandomBrightness((0.8, 1.2), p=p),
    lambda p, s: A.RandomContrast((0.8, 1.2), p=p),
    lambda p, s: A.RandomGamma((0.8, 1.2), p=p),
    lambda p, s: A.RandomGaussianNoise(0.0, 0.02, p=p),
    lambda p, s: A.RandomGaussianBlur((3, 3), (0.5, 1.5), p=p),
    lambda p, s: A.RandomMotionBlur((3, 7), 20.0, 0.5, p=p),
    lambda p, s: A.RandomInvert(p=p),
    lambda p, s: A.RandomPosterize(4, p=p),
    lambda p, s: A.RandomSolarize(0.1, 0.1, p=p),
    lambda p, s: A.RandomGrayscale(p=p),
    lambda p, s: A.RandomSaturation((0.8, 1.2), p=p),
    lambda p, s: A.PatchSequential(
        A.RandomBrightness((0.8, 1.2), p=p), A.RandomGaussianNoise(0.0, 0.02, p=p), patchwise_apply=False
    ),
    lambda p, s: A.PatchSequential(
        *[A.RandomContrast((0.8, 1.2), p=p), A.RandomInvert(p=p)] * 3, grid_size=(2, 3), patchwise_apply=True
    ),
]
HUES: list[Maker] = [
    lambda p, s: A.ColorJitter(0.1, 0.1, 0.1, 0.1, p=p),
    lambda p, s: A.RandomHue((-0.1, 0.1), p=p),
]
# Masks of a disc are what its image is, so that what mixes images and masks alike can be seen.
MIXES: list[Maker] = [
    lambda p, s: A.RandomCutMixV2(data_keys=["input", "mask", "class"], p=p),
    lambda p, s: A.PatchMix(8, data_keys=["input", "mask", "class"], p=p),
    lambda p, s: A.RandomJigsaw((2, 2), p=p, data_keys=["input", "mask", "class"]),
    lambda p, s: A.RandomMosaic((64, 80), p=p, data_keys=["input", "mask"]),
    lambda p, s: A.RandomMixUpV2(data_keys=["input", "class"], p=p),
]
KEEP_SIZE_3D: list[Maker] = [
    lambda p, s: A.RandomHorizontalFlip3D(p=p),
    lambda p, s: A.RandomVerticalFlip3D(p=p),
    lambda p, s: A.RandomDepthicalFlip3D(p=p),
    lambda p, s: A.RandomRotation3D(20.0, p=p),
    lambda p, s: A.RandomAffine3D(10.0, (0.1, 0.1, 0.1), (0.9, 1.1), p=p),
    lambda p, s: A.RandomPerspective3D(0.1, p=p),
]
CHANGE_SIZE_3D: list[Maker] = [
    lambda p, s: A.RandomCrop3D((22, 28, 30), p=1.0),
    lambda p, s: A.CenterCrop3D((22, 28, 30), p=1.0),
    lambda p, s: A.RandomResizedCrop3D((24, 32, 36), scale=(0.8, 1.0), p=1.0),
    lambda p, s: A.Resize3D((26, 30, 34), p=1.0),
]
PHOTOMETRIC_3D: list[Maker] = [
    lambda p, s: A.RandomEqualize3D(p=p),
    lambda p, s: A.RandomMotionBlur3D((3, 5), 20.0, 0.5, p=p),
]

CHOICES: list[Any] = [
    A.OneOf,
    lambda *children: A.SomeOf(*children, n=(0, 2), replace=True),
    A.RandomOrder,
    A.RandomApply,
]


@dataclass
class Case:
    """A container and a batch for it."""

    kind: str
    augment: Any
    inputs: list[Any]
    keys: list[str]
    geometric: list[str]  # the names of the children that move pixels
    has_colors: bool
    as_dict: bool = False
    time_axis: int = 1  # of videos

    def call(self, augment: Any, inputs: list[Any] | None = None, **options: Any) -> list[Any]:
        inputs = self.inputs if inputs is None else inputs
        if self.as_dict:
            return list(augment(dict(zip(self.keys, inputs)), **options).values())
        return list(augment(*inputs, **options))

    def at(self, key: str) -> int | None:
        return next((i for i, k in enumerate(self.keys) if k.startswith(key)), None)

    def of_images(self, outputs: Sequence[Any]) -> list[Any]:
        """Outputs with videos as batches of frames."""
        if self.kind != "videos":
            return list(outputs)
        swapped = [x.transpose(1, self.time_axis) if k in ("image", "mask") else x for k, x in zip(self.keys, outputs)]
        return [x.flatten(0, 1) for x in swapped]


@dataclass
class Pool:
    """What children are drawn from: kinds of makers, each as often as it stands there."""

    moves: list[list[Maker]]
    changes: list[list[Maker]]
    colors: list[list[Maker]]
    scale: float = 1.0

    def children(
        self, rng: random.Random, depth: int, p: float | None, geometric: list[str], moves_only: bool
    ) -> list[nn.Module]:
        drawn: list[nn.Module] = []
        for _ in range(rng.randint(1, 3)):
            if depth > 1 and rng.random() < 0.4:
                make = rng.choice([A.ImageSequential, A.AugmentationSequential, *CHOICES])
                pool = replace(self, changes=[]) if make in CHOICES else self  # all samples end with one size
                inner = pool.children(rng, depth - 1, p, geometric, moves_only)
                drawn.append(make(*inner))
                continue
            kinds = self.moves + ([] if p == 0 else self.changes) + ([] if moves_only else self.colors)
            kind = rng.choice(kinds)
            module = rng.choice(kind)(rng.choice([0.3, 0.5, 1.0, 1.0]) if p is None else p, self.scale)
            if kind not in self.colors:
                geometric.append(type(module).__name__)
            drawn.append(module)
        return drawn


def pool_of(kind: str, scale: float = 1.0) -> Pool:
    if kind == "volumes":
        return Pool([KEEP_SIZE_3D], [CHANGE_SIZE_3D], [PHOTOMETRIC_3D])
    if kind == "mixes":  # which need results of one size
        return Pool([KEEP_SIZE[:2]], [], [PHOTOMETRIC[:3]])
    return Pool([KEEP_SIZE, KEEP_SIZE, MAPS], [CHANGE_SIZE], [PHOTOMETRIC, PHOTOMETRIC, HUES], scale)


def in_layout(x: Tensor, layout: str) -> Tensor:
    """The same values with other strides."""
    if layout == "channels_last":
        formats = {4: torch.channels_last, 5: torch.channels_last_3d}
        return x.contiguous(memory_format=formats[x.dim()])
    if layout == "transposed":
        return x.transpose(-2, -1).contiguous().transpose(-2, -1)
    if layout == "sliced":
        return F.pad(x, (1, 2, 3, 0))[..., 3:, 1:-2]
    return x


def boxes_around(centers: Tensor, key: str) -> Tensor:
    """Boxes (B, 1, 4 or 4, 2) of the discs at centers (B, 1, 2)."""
    near, end = centers - RADIUS, centers + RADIUS + 1.0
    if key == "bbox_xyxy":
        return torch.cat([near, end], -1)
    if key == "bbox_xyxy_plus":
        return torch.cat([near, end - 1], -1)
    if key == "bbox_xywh":
        return torch.cat([near, end - near], -1)
    left, top, right, bottom = torch.cat([near, end - 1], -1).unbind(-1)
    return torch.stack([left, top, right, top, right, bottom, left, bottom], -1).unflatten(-1, (4, 2))


def make_case(
    kind: str, seed: int, device: torch.device, p: float | None = None, size: tuple[int, int] | None = None
) -> Case:
    rng = random.Random(seed)
    geometric: list[str] = []
    moves_only = rng.random() < 0.5
    scale = 1.0 if size is None else min(size) / 64
    modules = pool_of(kind, scale).children(rng, 3, p, geometric, moves_only)
    random_apply, resample = rng.random() < 0.15, rng.choice(["each", "each", "once"])
    if kind == "mixes":
        random_apply = False
        at = rng.randint(0, len(modules))
        modules.insert(at, rng.choice(MIXES)(rng.choice([0.5, 1.0]) if p is None else p, scale))
    box_key = rng.choice(["bbox", "bbox_xyxy", "bbox_xyxy_plus", "bbox_xywh"])
    labels = ["mask", "keypoints", "class"]
    if kind != "volumes":
        labels.append(box_key)
    if kind == "mixes":
        mix = next(m for m in modules if isinstance(m, A.MixAugmentationBaseV2))
        labels = ["class" if key == DataKey.CLASS else key.name.lower() for key in mix.data_keys[1:]]
    rng.shuffle(labels)
    keys = ["image", *labels]
    as_dict = rng.random() < 0.3
    time = rng.randint(1, 3) if kind == "videos" else 1
    data_format = rng.choice(["BTCHW", "BCTHW"])
    if kind == "videos":
        modules = [A.VideoSequential(*modules, data_format=data_format, same_on_frame=rng.random() < 0.5)]
    options: dict[str, Any] = {"random_apply": random_apply, "resample": resample}
    augment = A.AugmentationSequential(*modules, data_keys=None if as_dict else keys, **options).to(device)

    sides = (24, 32, 36) if kind == "volumes" else size or (64, 80)
    batch = rng.randint(2, 4)
    radius, margin = (3, 9) if kind == "volumes" else (RADIUS, 23)
    count = batch * time
    centers = torch.tensor(
        [[[rng.uniform(margin, n - margin - 1) for n in reversed(sides)]] for _ in range(count)]
    )  # x, y and z
    axes = len(sides)
    squared = torch.zeros(count, *sides)
    for axis, n in enumerate(sides):
        at = centers[:, 0, axes - 1 - axis].reshape(-1, *[1] * axes)
        squared = squared + (torch.arange(n).reshape(-1, *[1] * (axes - 1 - axis)) - at).square()
    blobs = torch.exp(-squared / (2 * 2.0**2))[:, None]
    disc = squared <= radius**2
    ring = (squared <= (radius + 3) ** 2) & ~disc  # which shows where a disc was cut
    dtype = rng.choice([*FLOATS, torch.uint8])
    image = (blobs * 200).round().byte() if dtype == torch.uint8 else blobs.to(dtype)
    mask = torch.stack([disc, ring], 1)
    if kind == "mixes":
        image = disc[:, None].to(dtype) if dtype != torch.uint8 else disc[:, None].byte() * 255
        mask = mask[:, :1]
    image = image.repeat(1, 3, *[1] * axes).to(device)
    image = in_layout(image, rng.choice(["plain", "channels_last", "transposed", "sliced"]))
    mask = mask.to(device, rng.choice([torch.int64, torch.float32, torch.uint8, torch.bool]))
    values: dict[str, Any] = {
        "image": image,
        "mask": mask,
        "keypoints": centers.to(device),
        "class": torch.arange(count, device=device),
    }
    if kind != "volumes":
        values[box_key] = boxes_around(centers, box_key).to(device)
    time_axis = 1 if data_format == "BTCHW" else 2
    if kind == "videos":
        values = {key: x.unflatten(0, (batch, time)) for key, x in values.items()}
        for key in ("image", "mask"):
            values[key] = values[key].transpose(1, time_axis)
    elif kind == "images" and rng.random() < 0.25:
        values[box_key] = list(values[box_key])
    inputs = [values[key] for key in keys]
    return Case(kind, augment, inputs, keys, geometric, not moves_only, as_dict, time_axis)


def is_whole(mask: Tensor) -> bool:
    """Whether no image on the way cut the disc of a mask (2, H, W) or (2, D, H, W): its ring is around it."""
    disc, ring = mask.bool()
    edges = [disc.select(axis, end) for axis in range(disc.dim()) for end in (0, -1)]
    if not disc.any() or any(edge.any() for edge in edges):
        return False
    pool = F.max_pool2d if disc.dim() == 2 else F.max_pool3d
    dilated = pool(disc[None, None].float(), 3, 1, 1)[0, 0] > 0
    return not bool((dilated & ~disc & ~ring).any())


def center_of(image: Tensor) -> Tensor:
    """The center (x, y, ...) of a blob (H, W) or (D, H, W)."""
    weight = image.double()
    weight = weight * (weight > 0.1 * weight.max())
    at = []
    for axis, n in reversed(list(enumerate(weight.shape))):
        along = torch.arange(n, device=weight.device).reshape(-1, *[1] * (weight.dim() - 1 - axis))
        at.append((weight * along).sum() / weight.sum())
    return torch.stack(at)
