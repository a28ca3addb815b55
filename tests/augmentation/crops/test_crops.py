"""Crops and padding: values of torchvision and Albumentations, crops that are resized with antialiasing."""

from __future__ import annotations

from typing import Any

import cv2
import pytest
import torch

import kvision as K
import kvision.augmentation as A
from kvision.augmentation.crops import views


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("size", [(12, 15), (45, 20), (1, 7)], ids=str)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8], ids=str)
def test_antialiased_crops(
    mode: str, align_corners: bool, size: tuple[int, int], dtype: torch.dtype, device: torch.device
) -> None:
    """They are antialiased resizing of each window."""
    x = torch.rand(4, 3, 40, 50, generator=torch.Generator().manual_seed(1)).to(device)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    crop = A.RandomResizedCrop(size, resample=mode, align_corners=align_corners, antialias=True)
    y = crop(x, seed=4)
    for image, result, corners in zip(x, y, crop._params["src"].long()):
        (left, top), (right, bottom) = corners[0].tolist(), corners[2].tolist()
        window = image[None, :, top : bottom + 1, left : right + 1]
        expected = K.geometry.resize(window, size, mode, align_corners=align_corners, antialias=True)[0]
        torch.testing.assert_close(result, expected, rtol=0, atol=1 if dtype == torch.uint8 else 1e-5)
    assert torch.equal(crop(x, params=crop._params), y)
    matrix = crop.transform_matrix
    assert torch.equal(crop.apply_transform(x, crop._params, crop.flags, matrix), y)
    nearest = A.RandomResizedCrop(size, resample="nearest", align_corners=align_corners)(x, seed=4)
    assert torch.equal(crop(x, seed=4, resample="nearest"), nearest)


@pytest.mark.parametrize("resample", ["each", "once"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8], ids=str)
def test_flips_around_antialiased_crops(dtype: torch.dtype, resample: str, device: torch.device) -> None:
    """Flips mirror the windows; the result is that of the separate calls, and so is its gradient."""
    x = torch.rand(9, 3, 40, 52, generator=torch.Generator().manual_seed(2)).to(device)
    x = (255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)
    x.requires_grad_(x.is_floating_point())
    children = [
        A.RandomHorizontalFlip(),
        A.RandomVerticalFlip(),
        A.RandomResizedCrop((24, 31), antialias=True, align_corners=False),
        A.RandomVerticalFlip(),
        A.RandomHorizontalFlip(),
    ]
    augment = A.ImageSequential(*children, resample=resample)
    torch.manual_seed(5)
    y = augment(x)
    torch.manual_seed(5)
    expected = x
    for child in children:
        expected = child(expected)
    torch.testing.assert_close(y, expected, rtol=0, atol=1 if dtype == torch.uint8 else 1e-5)
    if x.requires_grad:
        weights = torch.rand(y.shape, generator=torch.Generator().manual_seed(3)).to(y)
        (grad,) = torch.autograd.grad((y * weights).sum(), x)
        (expected_grad,) = torch.autograd.grad((expected * weights).sum(), x)
        torch.testing.assert_close(grad, expected_grad, rtol=0, atol=1e-5)


@pytest.mark.parametrize("resample", ["each", "once"])
def test_what_is_no_flip_is_not_joined(resample: str, device: torch.device) -> None:
    """A crop of an antialiased crop reads pixels beside its own window."""
    x = torch.rand(4, 3, 40, 52, device=device)
    children = [A.RandomResizedCrop((20, 20), antialias=True), A.CenterCrop((8, 10)), A.RandomInvert(p=1.0)]
    y = A.ImageSequential(*children, resample=resample)(x, seed=7)
    torch.testing.assert_close(y, 1 - children[0](x, seed=7)[:, :, 6:14, 5:15], rtol=0, atol=1e-6)


def test_pipeline_of_an_antialiased_crop(device: torch.device) -> None:
    """One pass crops, flips, colors, normalizes and converts; its gradient is that of the separate calls."""

    def pipeline(**options: Any) -> A.ImageSequential:
        return A.ImageSequential(
            A.RandomResizedCrop((24, 32), antialias=True),
            A.RandomHorizontalFlip(),
            A.ColorJitter(0.2, 0.2, 0.2, 0.1),
            A.Normalize((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)),
            **options,
        )

    x = torch.rand(7, 3, 40, 52, generator=torch.Generator().manual_seed(2)).to(device).requires_grad_()
    augment = pipeline()
    for y in (augment(x, seed=3), augment(x.detach(), seed=3)):
        expected = x
        for child in augment.children():
            expected = child(expected, params=child._params)
        torch.testing.assert_close(y, expected, rtol=0, atol=2e-5)
    weights = torch.rand(expected.shape, generator=torch.Generator().manual_seed(3)).to(device)
    for layout in (torch.contiguous_format, torch.channels_last):
        (grad,) = torch.autograd.grad((augment(x, seed=3)), x, weights.contiguous(memory_format=layout))
        (expected_grad,) = torch.autograd.grad(expected, x, weights, retain_graph=True)
        torch.testing.assert_close(grad, expected_grad, rtol=1e-4, atol=1e-4)
    stored = (255 * x.detach()).to(torch.uint8)
    options: dict[str, Any] = {"output_dtype": torch.float16, "memory_format": torch.channels_last}
    half = pipeline(**options)(stored, seed=3)
    assert half.dtype == torch.float16 and half.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(half, pipeline(output_dtype=torch.float32)(stored, seed=3).half(), rtol=0, atol=4e-3)


def test_labels_of_antialiased_crops(device: torch.device) -> None:
    """Masks, points and the inverse follow the matrix of crops without antialiasing."""
    x = torch.rand(3, 1, 40, 50, device=device)
    points = 40 * torch.rand(3, 5, 2, device=device)
    smooth, sharp = (
        A.AugmentationSequential(
            A.RandomHorizontalFlip(),
            A.RandomResizedCrop((12, 15), antialias=a),
            data_keys=["image", "mask", "keypoints"],
        )
        for a in (True, False)
    )
    a, b = smooth(x, x > 0.5, points, seed=3), sharp(x, x > 0.5, points, seed=3)
    assert not torch.equal(a[0], b[0]) and a[0].std() < b[0].std()
    assert (a[1] != b[1]).float().mean() < 0.05  # rounded once or twice
    torch.testing.assert_close(a[2], b[2])
    torch.testing.assert_close(smooth.transform_matrix, sharp.transform_matrix)
    assert smooth.inverse(*a)[0].shape == x.shape
    x.requires_grad_()
    smooth(x, x.detach() > 0.5, points, seed=3)[0].square().sum().backward()
    assert x.grad is not None and (x.grad != 0).float().mean() > 0.1
    with pytest.raises(ValueError, match="'bilinear' or 'bicubic' with antialias"):
        A.RandomResizedCrop((4, 4), resample="nearest", antialias=True)


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("resample", ["nearest", "bilinear", "bicubic"])
def test_resize_module_equals_the_function(resample: str, align_corners: bool) -> None:
    x = torch.rand(2, 3, 17, 13)
    augment = A.Resize((9, 11), resample=resample, align_corners=align_corners)
    y = augment(x)
    torch.testing.assert_close(augment.apply_transform(x, augment._params, augment.flags, augment.transform_matrix), y)


def test_wrong_sizes_and_modes_of_resize() -> None:
    with pytest.raises(ValueError, match="Resize: expected size of at least one pixel, got 0"):
        A.Resize(0)
    with pytest.raises(ValueError, match="Resize: expected resample 'bilinear' or 'bicubic' with antialias"):
        A.Resize(8, resample="nearest", antialias=True)


def whole(height: int, width: int, device: torch.device) -> torch.Tensor:
    return torch.arange(float(height * width), device=device).reshape(1, 1, height, width)


# torchvision 0.29.1: pad(x, [1, 2, 0, 1], padding_mode=).
PADDED = {
    "constant": [[9] * 5, [9] * 5, [9, 0, 1, 2, 3], [9, 4, 5, 6, 7], [9, 8, 9, 10, 11], [9] * 5],
    "edge": [[0, 0, 1, 2, 3]] * 3 + [[4, 4, 5, 6, 7]] + [[8, 8, 9, 10, 11]] * 2,
    "reflect": [[4 * k + i for i in (1, 0, 1, 2, 3)] for k in (2, 1, 0, 1, 2, 1)],
    "symmetric": [[4, 4, 5, 6, 7], *[[0, 0, 1, 2, 3]] * 2, [4, 4, 5, 6, 7], *[[8, 8, 9, 10, 11]] * 2],
}


@pytest.mark.parametrize("mode", PADDED)
def test_pad_is_torchvisions(mode: str, device: torch.device) -> None:
    x = whole(3, 4, device)
    assert A.Pad((1, 2, 0, 1), fill=9, padding_mode=mode)(x)[0, 0].tolist() == PADDED[mode]
    assert A.Pad((1, -1, -2, 1))(x)[0, 0].tolist() == [[0, 4, 5], [0, 8, 9], [0, 0, 0]]
    with pytest.raises(ValueError, match="Pad: expected padding that leaves pixels"):
        A.Pad((-2, 0))(x)


@pytest.mark.parametrize(
    "position, left, top",
    [("center", 1, 2), ("top_left", 0, 0), ("top_right", 3, 0), ("bottom_left", 0, 4), ("bottom_right", 3, 4)],
)
def test_pad_if_needed_is_albumentations(position: str, left: int, top: int, device: torch.device) -> None:
    """The odd pixels of 'center' are on the right and at the bottom; a divisor rounds up; larger images stay."""
    x = whole(4, 6, device)
    expected = torch.full((8, 9), -1.0, device=device)
    expected[top : top + 4, left : left + 6] = x[0, 0]
    assert torch.equal(A.PadIfNeeded(8, 9, position=position, fill=-1)(x)[0, 0], expected)
    by_divisors = A.PadIfNeeded(None, None, 8, 9, position=position, fill=-1)
    assert torch.equal(by_divisors(x)[0, 0], expected) and torch.equal(by_divisors(by_divisors(x))[0, 0], expected)
    assert torch.equal(A.PadIfNeeded(3, 6, position=position)(x), x)


def test_random_positions_take_labels_with_them(device: torch.device) -> None:
    x = whole(4, 6, device).expand(64, 1, 4, 6) + 1
    boxes = torch.tensor([[[0.0, 0, 6, 4]]], device=device).expand(64, 1, 4)
    augment = A.AugmentationSequential(
        A.PadIfNeeded(6, 8, position="random"), data_keys=["image", "mask", "bbox_xyxy", "keypoints"]
    )
    padded, masks, moved, points = augment(x, x, boxes, boxes[..., :2])
    assert torch.equal(padded, masks) and torch.equal(moved[..., :2], points)
    for image, (left, top, right, bottom) in zip(padded, moved[:, 0].long().tolist()):
        assert torch.equal(image[:, top:bottom, left:right], x[0]) and image.count_nonzero() == 24
    assert {tuple(corner) for corner in moved[:, 0, :2].tolist()} == {(i, j) for i in range(3) for j in range(3)}


def test_symmetries_of_the_square(device: torch.device) -> None:
    x = torch.rand(1, 2, 5, 5, device=device).expand(128, 2, 5, 5)
    turns = [torch.rot90(y, k, (1, 2)) for k in range(4) for y in (x[0], x[0].flip(-1))]
    found = [[torch.equal(y, turned) for turned in turns].index(True) for y in A.D4()(x)]
    assert set(found) == set(range(8))
    oblong = torch.rand(1, 2, 4, 5, device=device).expand(64, 2, 4, 5)
    kept = [oblong[0].flip(axes) for axes in ((), (-1,), (-2,), (-2, -1))]
    assert {[torch.equal(y, turned) for turned in kept].index(True) for y in A.D4()(oblong)} == set(range(4))
    transpose = A.AugmentationSequential(A.Transpose(p=1.0), data_keys=["image", "bbox_xyxy"])
    y, boxes = transpose(oblong, torch.tensor([[[1.0, 0, 3, 4]]], device=device).expand(64, 1, 4))
    assert torch.equal(y, oblong.mT) and boxes[0, 0].tolist() == [0, 1, 4, 3]
    assert torch.equal(transpose.inverse(y, boxes)[0], oblong)


def test_five_and_ten_crops_are_torchvisions(device: torch.device) -> None:
    # torchvision 0.29.1: TenCrop((2, 2), vertical_flip=True).
    x = whole(5, 5, device)
    first = [crop[0, 0, 0, 0].item() for crop in A.TenCrop((2, 2), vertical_flip=True)(x)]
    assert first == [0, 3, 15, 18, 12, 20, 23, 5, 8, 12]
    five = A.FiveCrop((2, 3))(x)
    assert [crop.shape for crop in five] == [(1, 1, 2, 3)] * 5 and five[3].data_ptr() == x[..., 3:, 2:].data_ptr()
    mirrored = A.TenCrop((2, 3))(x)[5:]
    assert all(torch.equal(a, b) for a, b in zip(mirrored, A.FiveCrop((2, 3))(x.flip(-1))))
    with pytest.raises(ValueError, match="FiveCrop: expected images of at least"):
        A.FiveCrop(6)(x)
    images = [x[0], whole(7, 9, device)[0]]
    for crop in (A.FiveCrop((2, 3)), A.TenCrop((2, 3))):
        each = [torch.stack(windows) for windows in zip(*map(crop, images))]
        assert all(torch.equal(a, b) for a, b in zip(crop(images), each, strict=True))
    with pytest.raises(ValueError, match="TenCrop: expected input with at least one image"):
        A.TenCrop(2)([])


@pytest.mark.parametrize("antialias", [False, True])
def test_views_are_windows_of_their_images(antialias: bool, device: torch.device) -> None:
    """Of a ramp, which linear resampling keeps: the slopes are those of the windows, and the samples are not mixed up."""
    y, x = torch.meshgrid(torch.arange(60.0), torch.arange(80.0), indexing="ij")
    sample = torch.arange(3.0)[:, None, None].expand(3, 60, 80)
    images = torch.stack([x.expand_as(sample), y.expand_as(sample), sample], 1).to(device)
    views = A.MultiCrop(12, (6, 8), local_crops=3, antialias=antialias)(images.requires_grad_())
    assert [v.shape[1:] for v in views] == [(3, 12, 12)] * 2 + [(3, 6, 8)] * 3
    torch.autograd.grad(sum(v.sum() for v in views), images)
    areas = []
    for view in views:
        assert torch.equal(view[:, 2].round(), torch.arange(3.0, device=device)[:, None, None].expand_as(view[:, 2]))
        h, w = view.shape[-2:]
        across, down = view[:, 0, h // 2, 2:-2].diff(dim=-1), view[:, 1, 2:-2, w // 2].diff(dim=-1)
        assert_near = torch.testing.assert_close
        assert_near(across, across.mean(1, keepdim=True).expand_as(across), rtol=0.02, atol=1e-3)
        areas.append(across.mean(1) * w * down.mean(1) * h / 4800)
    large, small = torch.cat(areas[:2]), torch.cat(areas[2:])
    assert large.min() > 0.35 and large.max() < 1.01 and small.min() > 0.03 and small.max() < 0.45
    whole_image = A.MultiCrop((60, 80), local_crops=0, global_scale=(1.0, 1.0), ratio=(4 / 3, 4 / 3))(images.detach())
    assert len(whole_image) == 2 and all(torch.equal(v, images) for v in whole_image)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8, torch.bfloat16])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_views_by_one_kernel_are_those_of_each(dtype, layout, device: torch.device, monkeypatch) -> None:
    images = (255 * torch.rand(5, 3, 40, 50, device=device)).to(dtype).contiguous(memory_format=layout)
    crop = A.MultiCrop((14, 15), (6, 8), local_crops=3)
    torch.manual_seed(2)
    together = crop(images)
    monkeypatch.setattr(views.resized_views, "serves", lambda x: False)
    torch.manual_seed(2)
    each = crop(images)
    assert len(together) == len(each) == 5 and all(torch.equal(a, b) for a, b in zip(together, each))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8, torch.float16])
@pytest.mark.parametrize("antialias", [True, False])
def test_views_of_a_list_are_those_of_each_image(antialias, dtype, device: torch.device) -> None:
    crop, seeds = A.MultiCrop(12, (6, 8), local_crops=3, antialias=antialias), torch.arange(5, device=device) + 3
    images = [(255 * torch.rand(3, 30 + 3 * i, 41 - 2 * i, device=device)).to(dtype) for i in range(5)]
    views_of_list = crop(images, seed=seeds)
    assert [v.shape for v in views_of_list] == [(5, 3, 12, 12)] * 2 + [(5, 3, 6, 8)] * 3
    for b, x in enumerate(images):
        alone = crop(x[None], seed=seeds[b : b + 1])
        for of_list, view in zip(views_of_list, alone, strict=True):
            if device.type == "cpu" or not antialias:
                assert torch.equal(of_list[b], view[0])
            else:  # kernels of CUDA add in another order
                atol = 0.25 if dtype == torch.float16 else 1 if dtype == torch.uint8 else 1e-2
                torch.testing.assert_close(of_list[b], view[0], rtol=0, atol=atol)
    equal = torch.stack([x[:, :30, :30] for x in images])
    pairs = [(crop(list(equal), seed=seed), crop(equal, seed=seed)) for seed in (7, seeds)]
    pairs.append(tuple(crop(x, generator=torch.Generator().manual_seed(1)) for x in (list(equal), equal)))
    for of_list, of_batch in pairs:
        for a, b in zip(of_list, of_batch, strict=True):
            torch.testing.assert_close(a.float(), b.float(), rtol=0, atol=0 if device.type == "cpu" else 1)
    with pytest.raises(ValueError, match="MultiCrop: expected .*seeds of 5 samples, got 3"):
        crop(images, seed=seeds[:3])


@pytest.mark.tracing
@pytest.mark.parametrize("antialias", [True, False])
def test_views_have_graphs(antialias, device):
    crop = A.MultiCrop(12, (6, 8), local_crops=3, antialias=antialias)
    batch = torch.rand(2, 3, 40, 50, device=device)
    for images in (batch, [batch[0], batch[1, :, :31, :45]]):
        torch._dynamo.reset()
        compiled = torch.compile(lambda x: crop(x, seed=3), fullgraph=True, backend="aot_eager")
        assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(compiled(images), crop(images, seed=3), strict=True))


def test_gradients_of_views_of_a_list(device: torch.device) -> None:
    crop, seeds = A.MultiCrop(12, 6, local_crops=2), torch.arange(3, device=device)
    images = [torch.rand(3, 20 + i, 31 - i, device=device, requires_grad=True) for i in range(3)]
    gradients = torch.autograd.grad(sum(v.square().sum() for v in crop(images, seed=seeds)), images)
    for b, x in enumerate(images):
        alone = sum(v.square().sum() for v in crop(x[None], seed=seeds[b : b + 1]))
        assert torch.allclose(gradients[b], torch.autograd.grad(alone, x)[0], atol=1e-5)


@pytest.mark.native
def test_windows_outside_of_images_are_moved_inside(device: torch.device) -> None:
    images = torch.arange(24.0, device=device).reshape(1, 1, 4, 6)
    boxes = torch.tensor([[[-2.0, 1, 9, 2], [5, 3, 4, 4], [2, 0, 0.4, 1.6]]], device=device)
    cut = torch.ops.kvision.resize_views(images, boxes, [1, 1], 3)
    assert cut.flatten().tolist() == [pytest.approx(x) for x in (11.5, 23.0, 5.0)]


BAD = [
    (lambda: A.MultiCrop(8, 4, global_crops=0), ValueError, "MultiCrop: expected global_crops"),
    (lambda: A.Pad("4"), TypeError, "Pad: expected padding to be one, two or four ints"),
    (lambda: A.Pad(4, padding_mode="wrap"), ValueError, "Pad: expected padding_mode"),
    (lambda: A.PadIfNeeded(8, 8, 4), ValueError, "expected one of min_height and pad_height_divisor"),
    (lambda: A.PadIfNeeded(8, None), ValueError, "expected one of min_width and pad_width_divisor"),
    (lambda: A.PadIfNeeded(8, 8, position="left"), ValueError, "PadIfNeeded: position must be one of"),
    (lambda: A.FiveCrop("4"), TypeError, "FiveCrop: expected size"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors_of_sizes(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("antialias", [True, False])
def test_scaled_images_have_another_size(antialias: bool, device: torch.device) -> None:
    """OpenCV's resize of the same size; labels follow; a list has a factor of each image."""
    x = torch.rand(3, 3, 20, 30, device=device)
    augment = A.AugmentationSequential(
        A.RandomScale((0.4, 1.6), antialias=antialias, p=1.0), data_keys=["image", "mask", "bbox_xyxy"]
    )
    boxes, sizes = torch.tensor([[[3.0, 4, 21, 16]]], device=device).expand(3, 1, 4), set()
    for seed in range(12):
        y, masks, moved = augment(x, (x[:, :1] > 0.5).float(), boxes, seed=seed)
        h, w = y.shape[-2:]
        scale = float(augment._params[0].data["scale"][0])
        assert (h, w) == (round(20 * scale), round(30 * scale)) and masks.shape == (3, 1, h, w)
        torch.testing.assert_close(moved[0, 0].cpu(), torch.tensor([3 * w / 30, 4 * h / 20, 21 * w / 30, 16 * h / 20]))
        if scale > 1:
            expected = cv2.resize(x[0].movedim(0, -1).cpu().numpy(), (w, h), interpolation=cv2.INTER_LINEAR)
            torch.testing.assert_close(y[0].movedim(0, -1).cpu(), torch.from_numpy(expected), atol=1e-5, rtol=0)
        again = augment(x, params=augment._params, data_keys=["image"])
        assert torch.equal(again, y) and augment.inverse(y, data_keys=["image"]).shape == x.shape
        sizes.add((h, w))
    assert len(sizes) > 8
    results = A.RandomScale((0.4, 1.6), p=1.0)([x[0], x[1, :, :10]], seed=torch.tensor([1, 2]))
    alone = [
        A.RandomScale((0.4, 1.6), p=1.0)(i[None], seed=torch.tensor([s]))[0] for i, s in ((x[0], 1), (x[1, :, :10], 2))
    ]
    for result, own in zip(results, alone):
        torch.testing.assert_close(result, own, rtol=0, atol=1e-6 if device.type == "cuda" else 0)
    kept = A.RandomScale(p=0.0)(x)
    assert torch.equal(kept, x)
    with pytest.raises(ValueError, match="RandomScale: expected scale"):
        A.RandomScale((0.0, 1.0))
