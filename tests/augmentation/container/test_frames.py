"""Frames of video in place of the images that they are."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import kvision as K
import kvision.augmentation as A
from kvision.color.frames import Frames
from kvision.core.exceptions import ShapeError, TypeCheckError
from op_tests import assert_close

MEAN, STD = (0.4, 0.5, 0.6), (0.2, 0.3, 0.25)


def nv12(dtype: torch.dtype, device: torch.device, batch: int = 2) -> tuple[Tensor, Tensor]:
    """Codes of colors that are far from black and white, so that none is clamped, whenever that is done."""
    y, uv = 0.4 + 0.2 * torch.rand(batch, 1, 60, 80), 0.45 + 0.1 * torch.rand(batch, 30, 40, 2)
    if dtype == torch.uint8:
        return (255 * y).to(device, dtype), (255 * uv).to(device, dtype)
    return y.to(device, dtype), uv.to(device, dtype)


class Counted:
    """How often frames were converted as a whole."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        rgb = Frames.rgb

        def counted(frames: Frames) -> Tensor:
            self.count += 1
            return rgb(frames)

        monkeypatch.setattr(Frames, "rgb", counted)


def normalize() -> A.Normalize:
    return A.Normalize(MEAN, STD)


# Children, and whether the first ones read the planes.
CHAINS: dict[str, tuple[tuple[Any, ...], bool]] = {
    "crop": ((A.RandomResizedCrop((24, 25)), A.RandomHorizontalFlip(), normalize()), True),
    "antialiased": ((A.RandomResizedCrop((24, 25), antialias=True), A.RandomHorizontalFlip(), normalize()), True),
    "edges": ((A.RandomResizedCrop((24, 25), antialias=True, align_corners=False),), True),
    "flipped": ((A.RandomHorizontalFlip(p=1.0), A.RandomResizedCrop((24, 25), antialias=True)), True),
    "jitter": ((A.RandomAffine(20.0), A.ColorJitter(0.2, 0.2, 0.2, 0.1), normalize()), True),
    "perspective": ((A.RandomPerspective(p=1.0), normalize()), True),
    "nearest": ((A.RandomRotation(30.0, resample="nearest"),), True),
    "pixels": ((A.RandomCrop((30, 31)), A.RandomVerticalFlip(p=1.0), normalize()), True),
    "center": ((A.CenterCrop((20, 20)), normalize()), True),
    "resize": ((A.Resize((30, 31)), normalize()), True),
    "small": ((A.Resize((30, 31), antialias=True), normalize()), True),
    "side": ((A.SmallestMaxSize(20),), True),
    "normalize": ((normalize(), A.RandomAffine(10.0)), True),
    "nested": ((A.ImageSequential(A.RandomAffine(20.0), normalize()), A.RandomHorizontalFlip()), True),
    "colors": ((A.ColorJitter(0.2, 0.2), A.RandomAffine(10.0)), False),
    "blur": ((A.RandomGaussianBlur((3, 3), (1.0, 1.0), p=1.0),), False),
    "elastic": ((A.RandomElasticTransform(p=1.0),), False),
    "module": ((torch.nn.Identity(), A.RandomAffine(10.0)), False),
    "none": ((), False),
}


@pytest.mark.parametrize("name", CHAINS)
def test_containers_read_planes(name, device, monkeypatch):
    children, reads = CHAINS[name]
    frames = Frames(nv12(torch.float64, device))
    images, converted = frames.rgb(), Counted(monkeypatch)
    chain = A.ImageSequential(*children)
    for call in range(2):  # the second one by its kept plan
        assert_close(chain(frames, seed=call), chain(images, seed=call))
    assert converted.count == (0 if reads else 2)
    replayed = chain(frames, params=chain._params)
    assert_close(replayed, chain(images, seed=1))
    assert_close(chain.inverse(replayed), chain.inverse(chain(images, seed=1)))
    of_images = A.AugmentationSequential(*children, data_keys=["input", "mask", "bbox_xyxy"])
    of_frames = A.AugmentationSequential(*children, data_keys=["input", "mask", "bbox_xyxy"])
    mask, boxes = torch.rand(2, 1, 60, 80, device=device), torch.tensor([[[3.0, 5, 40, 30]]] * 2, device=device)
    for a, b in zip(of_frames(frames, mask, boxes, seed=3), of_images(images, mask, boxes, seed=3)):
        assert_close(a, b)
    if of_images.transform_matrix is not None:
        assert_close(of_frames.transform_matrix, of_images.transform_matrix)
    named = A.AugmentationSequential(*children)({"image": frames, "number": 3}, seed=3)
    assert_close(named["image"], of_images(images, mask, boxes, seed=3)[0])


def test_types_and_one_frame(device):
    planes = nv12(torch.uint8, device)
    chain = A.ImageSequential(*CHAINS["antialiased"][0], output_dtype=torch.float16)
    bytes_of, halves = Frames(planes, matrix="bt709"), Frames(planes, matrix="bt709", dtype=torch.float16)
    for frames in (bytes_of, halves):
        assert frames.shape == (2, 3, 60, 80) and frames.device == planes[0].device and len(frames) == 2
        actual, expected = chain(frames, seed=4), chain(frames.rgb(), seed=4)
        assert actual.dtype == torch.float16 and (actual - expected).abs().max() <= 1.5 / 255 / min(STD)
    assert A.ImageSequential(A.RandomAffine(10.0))(bytes_of).dtype == torch.uint8
    one = Frames((planes[0][0, 0], planes[1][0]))
    assert one.shape == (3, 60, 80)
    chain = A.ImageSequential(*CHAINS["antialiased"][0], keepdim=True)
    assert chain(one).shape == (3, 24, 25)
    assert "Frames((3, 60, 80), 'nv12', dtype=torch.uint8)" in repr(one)


def test_single_augmentations_convert(device):
    frames = Frames(nv12(torch.float32, device))
    for augment in (A.RandomAffine(10.0), A.ColorJitter(0.2), A.RandomGaussianBlur((3, 3), (1.0, 1.0), p=1.0)):
        assert_close(augment(frames, seed=1), augment(frames.rgb(), seed=1))


@pytest.mark.parametrize("chosen", [1, (1, 3)])
def test_choices(chosen, device):
    frames = Frames(nv12(torch.float64, device))
    children = (A.RandomAffine(20.0), A.RandomHorizontalFlip(p=1.0), normalize())
    chain = A.ImageSequential(*children, random_apply=chosen)
    assert_close(chain(frames, seed=5), chain(frames.rgb(), seed=5))
    seeds = torch.tensor([5, 7], device=device)
    assert_close(chain(frames, seed=seeds), chain(frames.rgb(), seed=seeds))


@pytest.mark.parametrize("program", ["normalize", "more"])
def test_color_programs(program, device):
    steps = [("normalize", MEAN, STD)] if program == "normalize" else [("brightness", 1.2), ("saturation", 0.5)]
    frames = Frames(nv12(torch.float64, device))
    run = K.enhance.ColorProgram(*steps)
    assert_close(run(frames), run(frames.rgb()))
    one = Frames(tuple(x[0, 0] if i == 0 else x[0] for i, x in enumerate(nv12(torch.float32, device))))
    assert_close(run(one), run(one.rgb()))
    bytes_of = Frames(nv12(torch.uint8, device))
    half = K.enhance.ColorProgram(*steps, dtype=torch.float16)(bytes_of)
    assert half.dtype == torch.float16
    assert (half - K.enhance.ColorProgram(*steps)(bytes_of.rgb() / 255)).abs().max() <= 1 / 255 / min(STD)
    assert (
        K.enhance.ColorProgram(*steps)(Frames(nv12(torch.uint8, device), dtype=torch.bfloat16)).dtype == torch.bfloat16
    )


def test_functions(device, monkeypatch):
    frames = Frames(nv12(torch.float64, device), chroma="linear")
    rgb, converted = frames.rgb(), Counted(monkeypatch)
    G = K.geometry
    for size in ((30, 41), 20, (90, 31), (1, 1)):
        for corners in (None, True):
            for antialias in (False, True):
                same: dict[str, Any] = {"align_corners": corners, "antialias": antialias}
                assert_close(G.resize(frames, size, **same), G.resize(rgb, size, **same))
    M = torch.tensor([[[0.83, 0.21, 3.3], [-0.12, 0.91, 2.1]]], dtype=torch.float64, device=device)
    homography = torch.cat([M, M.new_tensor([[[1e-3, 2e-3, 1]]])], 1)
    for mode in ("bilinear", "nearest"):
        for padding in ("zeros", "border"):
            assert_close(
                G.warp_affine(frames, M, (40, 50), mode, padding), G.warp_affine(rgb, M, (40, 50), mode, padding)
            )
            options = ((40, 50), mode, padding)
            assert_close(
                G.warp_perspective(frames, homography, *options), G.warp_perspective(rgb, homography, *options)
            )
    corners = torch.tensor(
        [[[3.0, 4], [30, 4], [30, 25], [3, 25]], [[5, 7], [60, 7], [60, 44], [5, 44]]], device=device
    ).double()
    assert_close(G.crop_and_resize(frames, corners, (24, 25)), G.crop_and_resize(rgb, corners, (24, 25)))
    assert_close(G.center_crop(frames, (20, 30)), G.center_crop(rgb, (20, 30)))
    assert converted.count == 0
    assert_close(G.resize(frames, (30, 41), "bicubic"), G.resize(rgb, (30, 41), "bicubic"))
    assert_close(G.center_crop(frames, (21, 30)), G.center_crop(rgb, (21, 30)))
    assert_close(G.warp_affine(frames, M, (40, 50), antialias=True), G.warp_affine(rgb, M, (40, 50), antialias=True))
    indices = torch.tensor([1, 1], device=device)
    cropped = G.crop_and_resize(frames, corners, (24, 25), box_indices=indices)
    assert_close(cropped, G.crop_and_resize(rgb, corners, (24, 25), box_indices=indices))
    assert converted.count == 4


def test_gradients_reach_planes(device):
    y, uv = (plane.requires_grad_() for plane in nv12(torch.float64, device))
    chain = A.ImageSequential(*CHAINS["crop"][0])
    of_planes = torch.autograd.grad(chain(Frames((y, uv)), seed=3).square().sum(), (y, uv))
    of_images = torch.autograd.grad(chain(Frames((y, uv)).rgb(), seed=3).square().sum(), (y, uv))
    for a, b in zip(of_planes, of_images):
        assert_close(a, b)


def test_errors(device):
    planes = nv12(torch.uint8, device)
    with pytest.raises(TypeCheckError, match="^Frames: expected dtype"):
        Frames(planes, dtype=torch.int16)
    with pytest.raises(ShapeError, match="^Frames: expected chroma of shape"):
        Frames((planes[0], planes[1][:, :3]))
    one = Frames((planes[0][0, 0], planes[1][0]))
    with pytest.raises(ShapeError, match=r"^warp_affine: expected src of shape \(B, 3, H, W\), got Frames\(\(3, 60"):
        K.geometry.warp_affine(one, torch.eye(2, 3, device=device)[None], (4, 4))
    with pytest.raises(ShapeError, match="one row of M for each of 2 frames"):
        K.geometry.warp_affine(Frames(planes), torch.eye(2, 3, device=device).expand(3, 2, 3), (4, 4))
    with pytest.raises(TypeCheckError, match="^gaussian_blur2d: .*got Frames"):
        K.filters.gaussian_blur2d(Frames(planes), (3, 3), (1.0, 1.0))


@pytest.mark.parametrize("data_format", ["BTCHW", "BCTHW"])
@pytest.mark.parametrize("same", [True, False])
def test_videos(data_format, same, device, monkeypatch):
    frames = Frames(nv12(torch.float64, device, batch=3))
    video = frames.rgb()[None]
    video = video.transpose(1, 2) if data_format == "BCTHW" else video
    converted = Counted(monkeypatch)
    chain = A.VideoSequential(*CHAINS["antialiased"][0], data_format=data_format, same_on_frame=same)
    for seed in (1, torch.tensor([2], device=device)):
        assert_close(chain(frames, seed=seed), chain(video, seed=seed))
    assert converted.count == 0


def test_containers_that_choose_or_cut(device):
    """What does not hand its images to children in order converts them first."""
    frames = Frames(nv12(torch.float32, device))
    for chain in (
        A.OneOf(A.RandomAffine(20.0, p=1.0), A.RandomHorizontalFlip(p=1.0)),
        A.SomeOf(A.RandomAffine(20.0, p=1.0), A.RandomHorizontalFlip(p=1.0), n=2),
        A.PatchSequential(A.RandomAffine(20.0, p=1.0), grid_size=(2, 2), patchwise_apply=False),
        A.auto.TrivialAugment(),
        A.auto.RandAugment(2, 5),
        A.ImageSequential(A.auto.RandAugment(2, 5), A.RandomAffine(10.0)),
        A.ImageSequential(A.PatchSequential(A.RandomAffine(20.0, p=1.0), grid_size=(2, 2), patchwise_apply=False)),
        A.presets.ada.AdaptiveDiscriminatorAugmentation(A.RandomAffine(20.0, p=1.0), initial_p=0.5),
    ):
        assert_close(chain(frames, seed=1), chain(frames.rgb(), seed=1))
