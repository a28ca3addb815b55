"""`resample="once"`: chains of matrices and maps are one resampling at the coordinates that they compose to."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

import kvision as K
import kvision.augmentation as A
from kvision import _backend
from kvision.augmentation.engine.stages import Composed
from op_tests import DispatchedOperators

H, W = 40, 52


def elastic(**options: Any) -> Any:
    return A.RandomElasticTransform((31, 31), (6.0, 6.0), (1.0, 1.4), **{"p": 1.0, **options})


def fisheye(**options: Any) -> Any:
    return A.RandomFisheye((-0.1, 0.1), (-0.1, 0.1), (1.9, 2.1), **{"p": 1.0, **options})


CHAINS = {
    "pipeline B": lambda: [
        A.RandomAffine(20.0, (0.1, 0.1), (0.9, 1.1), p=1.0),
        A.RandomPerspective(0.2, p=1.0),
        elastic(),
        A.RandomCrop((30, 36)),
    ],
    "a map first": lambda: [elastic(), A.RandomRotation(30.0, p=1.0), A.Resize((31, 47))],
    "two maps": lambda: [
        A.RandomThinPlateSpline(0.1, p=1.0),
        A.RandomHorizontalFlip(),
        fisheye(),
        A.CenterCrop((20, 30)),
    ],
    "maps side by side": lambda: [fisheye(), elastic(align_corners=True), A.RandomThinPlateSpline(0.1, p=1.0)],
    "by chance": lambda: [A.RandomAffine(20.0), elastic(p=0.5), A.RandomVerticalFlip(), fisheye(p=0.5)],
}
chains = pytest.mark.parametrize("make", CHAINS.values(), ids=list(CHAINS))


def images(device: Any = "cpu", batch: int = 4) -> Tensor:
    return torch.rand(batch, 3, H, W, generator=torch.Generator().manual_seed(batch)).to(device)


def smooth(device: Any) -> Tensor:
    y, x = torch.linspace(0, 3, H)[:, None], torch.linspace(0, 4, W)
    return torch.stack([(x + y).sin(), x.cos() * y.cos(), (x - y).sin()])[None].mul(0.4).add(0.5).to(device)


def coordinates(augment: Any, x: Tensor, size: tuple[int, int]) -> Tensor:
    """Where a call read the images, (B, h, w, 2) in float64, from the parameters of its children."""
    rows, columns = (torch.arange(n, dtype=torch.float64) for n in size)
    points = torch.stack([columns.expand(*size), rows[:, None].expand(*size)], -1).expand(len(x), -1, -1, -1)
    for item in reversed(augment._params):
        child, params = augment.get_submodule(item.name), item.data
        shape = tuple(int(n) for n in params["forward_input_shape"])
        chosen = params["batch_prob"] > 0.5
        if hasattr(child, "displacements"):
            moved = child.displacements(shape, params, child.flags, torch.empty(0, dtype=torch.float64))
            half = (torch.tensor([shape[-1], shape[-2]], dtype=torch.float64) - 1) / 2
            grid = points / half - 1
            before = points + F.grid_sample(moved, grid, padding_mode="border", align_corners=True).movedim(1, -1)
        else:
            matrix = child.compute_transformation(torch.empty(shape, dtype=torch.float64), params, child.flags)
            lifted = torch.cat([points, torch.ones_like(points[..., :1])], -1)
            back = lifted @ torch.linalg.inv(matrix.double()).mT[:, None]
            before = back[..., :2] / back[..., 2:]
        points = torch.where(chosen[:, None, None, None], before, points)
    return points


def sampled(x: Tensor, points: Tensor, mode: str = "bilinear") -> Tensor:
    half = (torch.tensor([x.shape[-1], x.shape[-2]], dtype=torch.float64) - 1) / 2
    return F.grid_sample(x, points / half - 1, mode=mode, padding_mode="zeros", align_corners=True)


@chains
def test_one_resampling_at_the_composed_coordinates(make: Any, device: torch.device) -> None:
    x, augment = images(device), A.ImageSequential(*make(), resample="once")
    y = augment(x)
    assert any(isinstance(stage, Composed) for stage in augment._record.stages)
    points = coordinates(augment, x, tuple(y.shape[-2:]))
    # Coordinates are float32 numbers up to 52, and neighboring pixels differ by up to 1.
    torch.testing.assert_close(y.cpu().double(), sampled(x.cpu().double(), points), atol=3e-4, rtol=0)


@chains
def test_masks_are_read_at_the_same_coordinates(make: Any, device: torch.device) -> None:
    x = images(device)
    augment = A.AugmentationSequential(*make(), data_keys=["image", "mask"], resample="once")
    masks = torch.randint(0, 250, (len(x), 2, H, W), generator=torch.Generator().manual_seed(1)).to(device)
    for dtype in (torch.int64, torch.uint8, torch.float32):
        y, moved = augment(x, masks.to(dtype), seed=5)
        points = coordinates(augment, x, tuple(y.shape[-2:]))
        expected = sampled(masks.cpu().double(), points, "nearest")
        near_tie = ((points - points.floor() - 0.5).abs() < 1e-3).any(-1)[:, None]
        assert moved.dtype == dtype and ((moved.cpu() == expected) | near_tie).all()
    ignored = A.AugmentationSequential(
        *make(),
        data_keys=["image", "mask"],
        resample="once",
        extra_args={"mask": {"resample": "nearest", "fill_value": 255}},
    )
    filled = ignored(x, masks, seed=5)[1]
    outside = ignored(x, torch.ones_like(masks), seed=5)[1] == 255
    assert torch.equal(filled == 255, outside) and torch.equal(filled[~outside], augment(x, masks, seed=5)[1][~outside])


@chains
def test_calls_are_replayed(make: Any, device: torch.device) -> None:
    x, augment = images(device), A.ImageSequential(*make(), resample="once")
    y = augment(x, seed=9)
    assert torch.equal(augment(x, seed=9), y)
    assert torch.equal(augment(x, params=augment._params), y)
    seeds = torch.arange(4)
    whole = augment(x, seed=seeds)
    torch.testing.assert_close(augment(x[2:], seed=seeds[2:]), whole[2:], atol=1e-6, rtol=0)
    for other in (copy.deepcopy(augment), pickle.loads(pickle.dumps(augment))):
        assert torch.equal(other(x, seed=9), y)
    assert augment(x[:0]).shape == (0, *y.shape[1:])


def test_samples_that_are_not_chosen_pass_unchanged(device: torch.device) -> None:
    x = images(device, 16)
    augment = A.ImageSequential(A.RandomAffine(30.0, p=0.3), elastic(p=0.3), resample="once")
    y = augment(x, seed=1)
    chosen = sum(item.data["batch_prob"] for item in augment._params) > 0
    assert 0 < chosen.sum() < 16 and torch.equal(y[~chosen], x[~chosen])


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.bfloat16, torch.float64], ids=str)
def test_types_and_layouts(dtype: torch.dtype, device: torch.device) -> None:
    x = images(device)
    stored = (255 * x).to(torch.uint8) if dtype == torch.uint8 else x.to(dtype)
    scale, atol = (  # the CPU samples bytes in fixed point
        (255, 0.53) if dtype == torch.uint8 else (1, {torch.float16: 1e-3, torch.bfloat16: 5e-3}.get(dtype, 1e-4))
    )
    augment = A.ImageSequential(A.RandomAffine(20.0, p=1.0), elastic(), resample="once")
    y, expected = augment(stored, seed=3), scale * augment(stored.float() / scale, seed=3)
    assert y.dtype == dtype
    torch.testing.assert_close(y.float(), expected, atol=atol, rtol=0)
    last = augment(stored.contiguous(memory_format=torch.channels_last), seed=3)
    torch.testing.assert_close(last, y, atol=1 if dtype == torch.uint8 else 1e-6, rtol=0)
    half = A.ImageSequential(
        *augment.children(), A.RandomInvert(p=1.0), resample="once", output_dtype=torch.float16,
        memory_format=torch.channels_last,
    )  # fmt: skip
    inverted = half(stored, seed=3)
    assert inverted.dtype == torch.float16 and inverted.is_contiguous(memory_format=torch.channels_last)
    torch.testing.assert_close(inverted.float(), 1 - expected / scale, atol=6e-3, rtol=0)


def test_padding_is_that_of_the_first_that_interpolates(device: torch.device) -> None:
    x = images(device)
    shift = A.RandomTranslate((0.5, 0.5), padding_mode="border", p=1.0)
    y = A.ImageSequential(A.RandomHorizontalFlip(p=1.0), shift, elastic(), resample="once")(x)
    left = y[..., : W // 4].amax(-1)
    assert (left > 0).all()
    fill = A.RandomAffine(0.0, (0.5, 0.5), padding_mode="fill", fill_value=[0.1, 0.2, 0.3], p=1.0)
    y = A.ImageSequential(fill, elastic(), resample="once")(torch.ones_like(x), seed=2)
    torch.testing.assert_close(y.amin((0, 2, 3)).cpu(), torch.tensor([0.1, 0.2, 0.3]))


def test_a_map_behind_a_crop_reads_the_image(device: torch.device) -> None:
    """Beyond the crop is the image, with or without another augmentation that interpolates; "each" reads padding there."""
    ones = torch.ones(2, 1, H, W, device=device)
    bend = A.RandomThinPlateSpline(0.3, p=1.0)
    for children in ([A.CenterCrop((20, 26)), bend], [A.CenterCrop((20, 26)), bend, A.RandomAffine(1.0, p=1.0)]):
        each, once = (A.ImageSequential(*children, resample=resample)(ones, seed=1) for resample in ("each", "once"))
        assert each.min() == 0 and once.min() > 1 - 1e-5


def test_composes_only_where_needed(device: torch.device) -> None:
    """What has one interpolation alone is computed as by itself; nothing that is kept grows with the images."""
    x = images(device)
    for children in (
        [elastic()],
        [A.RandomHorizontalFlip(), elastic(), A.RandomCrop((20, 20)), A.RandomInvert()],
        [A.RandomHorizontalFlip(), A.RandomResizedCrop((16, 16), antialias=True), A.RandomVerticalFlip()],
    ):
        each, once = (A.ImageSequential(*children, resample=resample) for resample in ("each", "once"))
        assert torch.equal(each(x, seed=4), once(x, seed=4))
    augment = A.AugmentationSequential(*CHAINS["pipeline B"](), resample="once", data_keys=["image", "mask"])
    augment(x, x)
    kept = [stage for stage in augment._record.stages if isinstance(stage, Composed)]
    assert len(kept) == 1 and kept[0]._links is None


# --- labels and the inverse -----------------------------------------------------------------------------------------


def gentle() -> list[Any]:
    return [
        A.RandomAffine(15.0, (0.05, 0.05), (0.95, 1.05), p=1.0),
        A.RandomElasticTransform((31, 31), (6.0, 6.0), (0.6, 0.6), p=1.0),
        A.RandomThinPlateSpline(0.05, p=1.0),
        A.Resize((60, 78)),
    ]


def test_points_boxes_and_masks_follow(device: torch.device) -> None:
    rows, columns = torch.arange(H)[:, None], torch.arange(W)
    image = torch.exp(-((columns - 28.0) ** 2 + (rows - 18.0) ** 2) / 8)[None, None].to(device)
    at = torch.tensor([[[28.0, 18.0]]], device=device)
    box = torch.tensor([[[24.0, 14.0, 33.0, 23.0]]], device=device)
    keys = ["image", "mask", "keypoints", "bbox_xyxy"]
    augment = A.AugmentationSequential(*gentle(), data_keys=keys, resample="once")
    for seed in range(4):
        moved, mask, point, moved_box = augment(image, (image > 0.14).long(), at, box, seed=seed)
        weight = moved[0, 0] ** 2
        rows, columns = (torch.arange(n, device=device) for n in moved.shape[-2:])
        center = torch.stack([(weight * columns).sum(), (weight * rows[:, None]).sum()]) / weight.sum()
        assert (center - point[0, 0]).abs().max() < 0.2, seed
        inside = mask[0, 0].nonzero().float()
        x0, y0, x1, y1 = moved_box[0, 0]
        assert x0 - 1 <= inside[:, 1].min() and inside[:, 1].max() <= x1
        assert y0 - 1 <= inside[:, 0].min() and inside[:, 0].max() <= y1
        assert augment.visible_points[0].all()
        back = augment.inverse(moved, mask, point, moved_box)
        torch.testing.assert_close(back[2], at, atol=0.01, rtol=0)
        again = augment(at, box, data_keys=["keypoints", "bbox_xyxy"])
        torch.testing.assert_close(again[0], point)
        torch.testing.assert_close(again[1], moved_box)
    assert augment.transform_matrix.shape == (1, 3, 3)


def test_inverse_of_a_composition(device: torch.device) -> None:
    """One resampling back; known are pixels that the result shows, also those that left an image in between."""
    image = smooth(device)
    mask = (image[:, :1] > 0.5).to(torch.uint8)
    augment = A.AugmentationSequential(*gentle(), data_keys=["image", "mask"], resample="once")
    for seed in range(3):
        moved = augment(image, mask, seed=seed)
        back, known = augment.inverse(*moved), augment.known_pixels(moved[0])
        assert back[0].shape == image.shape and known.shape == (1, 1, H, W)
        assert 0.6 < known.float().mean() <= 1 and ((back[0] - image).abs() * known).max() < 0.02
        assert ((back[1] != mask) & known).float().mean() < 0.03
        for a, b in zip(augment.inverse(*moved, params=augment._params), back):
            torch.testing.assert_close(a, b)
    away = A.RandomTranslate((0.3, 0.3), p=1.0), A.RandomTranslate((-0.3, -0.3), p=1.0)
    there_and_back = A.ImageSequential(away[0], A.RandomThinPlateSpline(0.0, p=1.0), away[1], resample="once")
    known = there_and_back.known_pixels(there_and_back(image))
    assert known[..., 1:-1].all()


def test_frames_of_a_video_get_the_same(device: torch.device) -> None:
    videos = images(device, 3)[:, None].expand(-1, 4, -1, -1, -1)
    augment = A.VideoSequential(A.RandomAffine(20.0, p=1.0), elastic(), same_on_frame=True)
    once = A.AugmentationSequential(augment, data_keys=["image", "mask"], resample="once")
    y, masks = once(videos, (videos[:, :, :1] > 0.5).long())
    assert torch.equal(y, y[:, :1].expand_as(y)) and torch.equal(masks, masks[:, :1].expand_as(masks))
    assert not torch.equal(y[0, 0], y[1, 0])


# --- antialiasing ---------------------------------------------------------------------------------------------------


def test_antialiased_where_it_shrinks(device: torch.device) -> None:
    """Noise whose mean is 0.5 becomes 0.5 where it shrinks; without antialiasing pixels are picked out of it."""
    noise = torch.rand(2, 1, 160, 160, generator=torch.Generator().manual_seed(0)).to(device)

    def result(antialias: bool) -> Tensor:
        chain = A.Resize((40, 40), antialias=antialias, align_corners=False), A.RandomRotation((30.0, 30.0), p=1.0)
        augment = A.ImageSequential(*chain, resample="once")
        y = augment(noise)
        assert len(augment._record.stages.stages) == 1
        return y[..., 12:28, 12:28]

    apart = A.ImageSequential(
        A.Resize((40, 40), antialias=True, align_corners=False), A.RandomRotation((30.0, 30.0), p=1.0)
    )
    expected = apart(noise)[..., 12:28, 12:28]
    averaged, picked = result(True), result(False)
    assert averaged.std() < 0.45 * picked.std()
    assert (averaged - expected).square().mean() < 0.1 * (picked - expected).square().mean()


def test_antialiased_chains_are_antialiased_warps(device: torch.device) -> None:
    """By the product of the matrices, of floats and bytes, and of one augmentation by itself."""
    x = images(device)
    for chain in (
        [A.RandomAffine(20.0, None, (0.3, 0.5), p=1.0, antialias=True)],
        [A.RandomAffine(20.0, None, (0.3, 0.5), p=1.0), A.RandomPerspective(0.3, p=1.0, antialias=True)],
        [A.RandomRotation(30.0, p=1.0), A.Resize((15, 20), antialias=True)],
    ):
        for image in (x, (255 * x).to(torch.uint8)):
            augment = A.ImageSequential(*chain, resample="once")
            y = augment(image)
            reading = augment._record.stages[0].resampling if len(chain) > 1 else chain[0].resampling(chain[0].flags)
            options = {"padding_mode": reading.padding, "align_corners": reading.align_corners, "antialias": True}
            expected = K.geometry.warp_perspective(image, augment.transform_matrix, tuple(y.shape[2:]), **options)
            torch.testing.assert_close(y, expected, rtol=0, atol=1e-5 if image is x else 1)
    with pytest.raises(ValueError, match="RandomAffine: expected resample 'bilinear' with antialias"):
        A.RandomAffine(20.0, resample="bicubic", antialias=True)


def test_antialiasing_keeps_images_that_grow(device: torch.device) -> None:
    """Also next to an augmentation of another batch's size, and for bytes."""
    x = images(device)
    chain = [A.RandomResizedCrop((20, 26), (0.05, 0.2), (1.2, 1.4), antialias=True), A.RandomRotation(20.0, p=1.0)]
    smooth_chain = A.ImageSequential(*chain, resample="once")
    plain = A.ImageSequential(A.RandomResizedCrop((20, 26), (0.05, 0.2), (1.2, 1.4)), chain[1], resample="once")
    torch.testing.assert_close(smooth_chain(x, seed=3), plain(x, seed=3), atol=2e-4, rtol=0)
    assert torch.equal(smooth_chain(x, params=smooth_chain._params), smooth_chain(x, seed=3))
    stored = (255 * x).to(torch.uint8)
    y = smooth_chain(stored, seed=3)
    assert y.dtype == torch.uint8
    torch.testing.assert_close(y.float(), 255 * smooth_chain(stored / 255.0, seed=3), atol=0.51, rtol=0)


# --- gradients and tracing ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pipeline B", "two maps"])
def test_gradient_to_the_image(name: str) -> None:
    augment = A.ImageSequential(*CHAINS[name](), resample="once")
    x = torch.rand(1, 1, H, W, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    y = augment(x, seed=2)
    probe = torch.rand(y.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    (grad,) = torch.autograd.grad((y * probe).sum(), x)
    step = torch.rand(x.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    change = ((augment(x + step, seed=2) - y) * probe).sum()  # the chain is linear in the image
    torch.testing.assert_close((grad * step).sum(), change)


@pytest.mark.parametrize("antialias", [False, True])
def test_gradient_to_ranges(antialias: bool) -> None:
    """Ranges of matrices and of maps in one chain, against differences."""
    degrees = nn.Parameter(torch.tensor([10.0, 20.0], dtype=torch.float64))
    gamma = nn.Parameter(torch.tensor([1.8, 2.2], dtype=torch.float64))
    y, x = torch.linspace(0, 3, H)[:, None], torch.linspace(0, 4, W)
    image = ((x + y).sin() * x.cos() + 2)[None, None].double()
    augment = A.ImageSequential(
        A.RandomRotation(degrees, p=1.0),
        A.RandomFisheye((-0.1, 0.1), (-0.1, 0.1), gamma, p=1.0),
        A.Resize((20, 24), antialias=antialias),
        resample="once",
    )
    middle = (slice(None), slice(None), slice(6, -6), slice(6, -6))
    augment(image, seed=1)[middle].square().sum().backward()
    for parameter in (degrees, gamma):
        for i in range(2):
            with torch.no_grad():
                values = []
                for step in (1e-4, -1e-4):
                    parameter[i] += step
                    values.append(augment(image, seed=1)[middle].square().sum())
                    parameter[i] -= step
            torch.testing.assert_close(parameter.grad[i], (values[0] - values[1]) / 2e-4, rtol=0.02, atol=0.02)
            assert parameter.grad[i] != 0


@pytest.mark.tracing
def test_compiles() -> None:
    augment = A.AugmentationSequential(*CHAINS["pipeline B"](), data_keys=["image", "mask"], resample="once")
    inputs = images(), images()[:, :1] > 0.5
    compiled = torch.compile(lambda *x: augment(*x, seed=4), fullgraph=True, backend="aot_eager")
    for y, expected in zip(compiled(*inputs), augment(*inputs, seed=4)):
        torch.testing.assert_close(y, expected)


def test_a_cuda_graph_draws_anew(device: torch.device) -> None:
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    augment = A.AugmentationSequential(*CHAINS["pipeline B"](), data_keys=["image", "mask"], resample="once")
    inputs = images(device), (images(device)[:, :1] > 0.5).to(torch.uint8)
    for _ in range(2):
        augment(*inputs)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        y, mask = augment(*inputs)
    graph.replay()
    before, mask_before = y.clone(), mask.clone()
    graph.replay()
    assert not torch.equal(y, before) and not torch.equal(mask, mask_before) and 0 < y.mean() < 1


def test_a_call_is_few_operators(backend: str) -> None:
    """Host time of small batches is that of operators: keys, the links of the chain, two reads."""
    if backend == "reference" or "cpu" in _backend.unserved:
        pytest.skip("the reference has operators of torch")
    augment = A.AugmentationSequential(*CHAINS["pipeline B"](), data_keys=["input", "mask"], resample="once")
    x = images()
    augment(x, x)  # which plans
    with DispatchedOperators() as called:
        augment(x, x)
    assert called.names == ["empty", "random_", "draw_links", "composed_warp", "composed_warp"]
