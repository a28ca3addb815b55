"""Containers: joined augmentations equal separate ones, and labels stay on their objects."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import GEOMETRIC, MAPS, Augmentation
from kvision.augmentation.engine.stages import Warp

JITTER = (0.2, 0.2, 0.2, 0.1)
CHAINS = {
    "flips and a warp": lambda: [
        A.RandomHorizontalFlip(),
        A.RandomAffine(30.0, (0.1, 0.1), p=0.7),
        A.RandomVerticalFlip(),
    ],
    "a warp and a crop": lambda: [A.RandomAffine(30.0, p=1.0), A.RandomCrop((9, 11))],
    "a padded crop after a warp": lambda: [A.RandomAffine(30.0, p=1.0), A.RandomCrop((9, 11), padding=4)],
    "a crop before a warp": lambda: [A.CenterCrop((10, 10)), A.RandomRotation(40.0, p=1.0)],
    "two warps": lambda: [A.RandomRotation(20.0, p=1.0), A.RandomPerspective(0.3, p=0.5)],
    "colors": lambda: [A.ColorJitter(*JITTER), A.RandomGamma((0.5, 1.5), p=0.5), A.Normalize([0.5] * 3, [0.2] * 3)],
    "two contrasts": lambda: [A.ColorJitter(*JITTER), A.ColorJitter(*JITTER, p=0.5)],
    "a crop that fits after padding alone": lambda: [
        A.PadTo((30, 40)),
        A.RandomCrop((25, 30)),
        A.RandomRotation(9.0, p=1.0),
    ],
    "sizes by chance": lambda: [
        A.RandomHorizontalFlip(),
        A.RandomCrop((12, 12), p=0.5),
        A.RandomTranslate((0.1, 0.4), p=1.0),
        A.RandomCrop((8, 8), p=0.5),
        A.ColorJitter(*JITTER),
    ],
    "everything": lambda: [
        A.RandomResizedCrop((12, 14)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(*JITTER, p=0.8),
        A.RandomGaussianBlur((3, 3), (0.1, 2.0)),
        A.RandomGrayscale(p=0.3),
        A.Normalize([0.5] * 3, [0.2] * 3),
    ],
}
chains = pytest.mark.parametrize("make", CHAINS.values(), ids=list(CHAINS))


def images(device: Any = "cpu", batch: int = 6) -> Tensor:
    return torch.rand(batch, 3, 16, 20, generator=torch.Generator().manual_seed(batch)).to(device)


@chains
def test_a_container_equals_its_children_one_after_the_other(make: Any, device: torch.device) -> None:
    x, container = images(device), A.ImageSequential(*make())
    torch.manual_seed(1)
    y = container(x)
    after = torch.get_rng_state()
    torch.manual_seed(1)
    expected = x
    for child in container.children():
        expected = child(expected)
    torch.testing.assert_close(y, expected, rtol=1e-4, atol=2e-5)
    assert torch.equal(torch.get_rng_state(), after)


@chains
def test_replay_and_seeds(make: Any, device: torch.device) -> None:
    x, container = images(device), A.ImageSequential(*make())
    y = container(x)
    assert torch.equal(container(x, params=container._params), y)
    y = container(x, seed=9)
    assert torch.equal(container(x, seed=9), y)
    seeds = torch.arange(6)
    if not any(0 < child.p_batch < 1 for child in make()):  # which is decided for the batch
        assert torch.equal(container(x[3:], seed=seeds[3:]), container(x, seed=seeds)[3:])
    for other in (copy.deepcopy(container), pickle.loads(pickle.dumps(container))):
        assert torch.equal(other(x, seed=9), y)


def test_a_child_that_runs_twice_is_replayed_with_both_draws(device: torch.device) -> None:
    x, container = images(device), A.ImageSequential(A.RandomAffine(90.0, p=1.0), A.RandomHue(p=1.0), random_apply=5)
    y = container(x, seed=3)
    names = [item.name for item in container._params]
    assert len(names) > len(set(names))
    assert torch.equal(container(x, params=container._params), y)


@pytest.mark.parametrize(("name", "warps"), [("flips and a warp", 1), ("a warp and a crop", 1), ("two warps", 0)])
def test_joined_operators(name: str, warps: int) -> None:
    container = A.ImageSequential(*CHAINS[name]())
    container(images())
    assert sum(isinstance(stage, Warp) for stage in container._record.stages) == warps


def test_one_resampling() -> None:
    """The product of the matrices, read once: a shift of a quarter pixel and back leaves no blur."""
    shift = A.RandomTranslate((0.0125, 0.0125), p=1.0)
    back = A.RandomTranslate((-0.0125, -0.0125), p=1.0)
    x = images()
    torch.testing.assert_close(A.ImageSequential(shift, back, resample="once")(x), x)
    assert (A.ImageSequential(shift, back)(x) - x).abs().max() > 0.01


def blob(x: float, y: float, h: int = 48, w: int = 64) -> Tensor:
    rows, columns = torch.arange(h)[:, None], torch.arange(w)
    return torch.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 2.0**2))[None, None]


LARGE = {"CenterCrop": ((40, 50),), "RandomCrop": ((40, 50),), "RandomResizedCrop": ((40, 50), (0.7, 1.0))}
LARGE |= {
    "Pad": ((20, 30),),
    "PadIfNeeded": (60, 80),
    "Resize": ((60, 70),),
    "LongestMaxSize": (80,),
    "SmallestMaxSize": (60,),
    "PadTo": ((60, 80),),
}


@pytest.mark.parametrize("case", GEOMETRIC, ids=lambda case: case.name)
def test_points_boxes_and_masks_follow_the_image(case: Augmentation, device: torch.device) -> None:
    augment = A.AugmentationSequential(
        getattr(A, case.name)(*LARGE.get(case.name, case.args), **({} if case.name == "PadTo" else {"p": 1.0})),
        data_keys=["input", "mask", "keypoints", "bbox_xyxy"],
    )
    at = torch.tensor([[[30.0, 22.0]]], device=device)
    image = blob(30.0, 22.0).to(device)
    box = torch.tensor([[[26.0, 18.0, 35.0, 27.0]]], device=device)  # nine pixels around the center
    for seed in range(3):
        moved, mask, point, moved_box = augment(image, (image > 0.14).long(), at, box, seed=seed)
        rows, columns = (torch.arange(n, device=device) for n in moved.shape[-2:])
        weight = moved[0, 0]
        center = torch.stack([(weight * columns).sum(), (weight * rows[:, None]).sum()]) / weight.sum()
        if moved[..., [0, -1], :].max() < 1e-3 and moved[..., [0, -1]].max() < 1e-3:  # all of the blob is there
            assert (center - point[0, 0]).abs().max() < 0.05, seed
            inside = mask[0, 0].nonzero().float()
            x0, y0, x1, y1 = moved_box[0, 0]
            assert x0 - 1 <= inside[:, 1].min() and inside[:, 1].max() <= x1 and y0 - 1 <= inside[:, 0].min()
            assert inside[:, 0].max() <= y1
        assert mask.dtype == torch.int64 and set(mask.unique().tolist()) <= {0, 1}
    back = augment.inverse(moved, mask, point, moved_box)
    torch.testing.assert_close(back[2], at, atol=1e-3, rtol=0)
    assert back[0].shape == image.shape


def test_boxes_of_every_kind() -> None:
    flip = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["input"])
    x = torch.zeros(2, 1, 10, 20)
    whole = torch.tensor([[0.0, 0.0, 20.0, 10.0]]).expand(2, 1, 4)
    corners = torch.tensor([[1.0, 2], [4, 2], [4, 5], [1, 5]]).expand(2, 1, 4, 2)
    pixels = torch.tensor([[0.0, 0.0, 19.0, 9.0]]).expand(2, 1, 4)
    keys = ["input", "bbox_xyxy", "bbox_xywh", "bbox_xyxy_plus", "bbox"]
    _, a, b, d, c = flip(x, whole, whole, pixels, corners, data_keys=keys)
    assert torch.equal(a, whole) and torch.equal(b, whole) and torch.equal(d, pixels)
    turned = A.AugmentationSequential(
        A.RandomRotation((30.0, 30.0), p=1.0), data_keys=["input", "bbox_xyxy_plus", "bbox_xyxy"]
    )
    _, plus, xyxy = turned(x, pixels, whole)
    torch.testing.assert_close(plus[..., :2], xyxy[..., :2])  # one object, named by its pixels or by its edges
    torch.testing.assert_close(plus[..., 2:] + 1, xyxy[..., 2:])
    dictionary = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=None)
    one = torch.tensor([[[2.0, 3.0, 2.0, 3.0]]]).expand(2, 1, 4)  # a box of one pixel
    moved = dictionary({"image": x, "bbox_xyxy_plus": one, "bbox_xyxy_plus_2": one, "bbox_xyxy": whole})
    for name in ("bbox_xyxy_plus", "bbox_xyxy_plus_2"):
        assert torch.equal(moved[name][0, 0], torch.tensor([17.0, 3.0, 17.0, 3.0]))
    assert torch.equal(c[0, 0], torch.tensor([[15.0, 2], [18, 2], [18, 5], [15, 5]]))
    lists = [torch.tensor([[1.0, 2, 3, 4]]), torch.zeros(0, 4)]
    moved = flip(x, lists, data_keys=["input", "bbox_xyxy"])[1]
    assert isinstance(moved, list) and torch.equal(moved[0], torch.tensor([[17.0, 2, 19, 4]])) and len(moved[1]) == 0
    assert flip(x, whole.int(), data_keys=["input", "bbox_xyxy"])[1].dtype == torch.int32


def test_keys() -> None:
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=None)
    x, label = images(), torch.arange(6)
    masks = {"mask": x[:, :1], "mask_2": x[:, :1].long()}
    inputs = {"image": x, **masks, "class": label, "keypoints": torch.zeros(6, 1, 2)}
    before = dict(inputs)
    out = augment(inputs)
    assert list(out) == list(inputs) and out["class"] is label
    assert all(inputs[name] is value for name, value in before.items())
    assert torch.equal(out["mask"], x[:, :1].flip(-1)) and torch.equal(
        out["keypoints"][..., 0], torch.full((6, 1), 19.0)
    )
    assert isinstance(A.AugmentationSequential(A.RandomHorizontalFlip())(x), Tensor)
    with pytest.raises(ValueError, match="to begin with 'input'"):
        A.AugmentationSequential(data_keys=["mask"])
    with pytest.raises(ValueError, match="expected 2 inputs"):
        A.AugmentationSequential(data_keys=["input", "mask"])(x)
    with pytest.raises(ValueError, match="sequence of keys"):
        A.AugmentationSequential(data_keys="input")


def test_random_apply() -> None:
    children = [A.RandomHorizontalFlip(p=1.0), A.RandomVerticalFlip(p=1.0), A.RandomInvert(p=1.0)]
    two = A.ImageSequential(*children, random_apply=2)
    for seed in range(20):
        two(images(), seed=seed)
        assert len({item.name for item in two._params}) == 2
    many = A.ImageSequential(*children, random_apply=True)
    counts = set()
    for seed in range(50):
        many(images(batch=1), seed=seed)
        counts.add(len(many._params))
    assert counts == {1, 2, 3}
    repeated = A.ImageSequential(*children, random_apply=5)
    repeated(images())
    assert len(repeated._params) == 5
    weighted = A.ImageSequential(*children, random_apply=1, random_apply_weights=[0.0, 1.0, 0.0])
    weighted(images())
    assert weighted._params[0].name == "RandomVerticalFlip_1"
    for wrong in (0.5, (3, 1), "all"):
        with pytest.raises(ValueError, match="random_apply"):
            A.ImageSequential(*children, random_apply=wrong)
    with pytest.raises(ValueError, match="random_apply_weights"):
        A.ImageSequential(*children, random_apply_weights=[1.0])


@pytest.mark.parametrize("views", [A.TenCrop(4), A.MultiCrop(4, 2)], ids=["TenCrop", "MultiCrop"])
def test_children_return_one_tensor(views):
    message = f"expected children that return a tensor of images, got a (tuple|list) from {type(views).__name__}"
    for container in (
        A.ImageSequential(views),
        A.ImageSequential(nn.Identity(), views),
        A.AugmentationSequential(views),
    ):
        with pytest.raises(TypeError, match=message):
            container(torch.rand(2, 3, 8, 8))


@pytest.mark.parametrize(
    "make",
    [
        lambda: A.RandomCrop((9, 9), p=0.5),
        lambda: A.ImageSequential(A.RandomHorizontalFlip(), A.RandomCrop((9, 9), p=0.5)),
        lambda: A.ImageSequential(A.RandomHorizontalFlip(), A.RandomInvert(), random_apply=1),
        lambda: A.OneOf(A.RandomHorizontalFlip(), A.RandomInvert()),
    ],
    ids=["crop", "crop in a chain", "random_apply", "OneOf"],
)
def test_choices_of_sizes_and_modules_are_not_captured(make: Any, device: torch.device) -> None:
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    augment, x = make(), images(device)
    augment(x)
    graph = torch.cuda.CUDAGraph()
    with pytest.raises(RuntimeError, match="cannot be captured in a CUDA graph"), torch.cuda.graph(graph):
        augment(x)


def test_random_apply_is_not_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its key is on the host, where a capture could not be noticed otherwise. A seed decides for all replays."""
    augment = A.ImageSequential(A.RandomHorizontalFlip(), A.RandomInvert(), random_apply=1)
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", lambda: True)
    with pytest.raises(RuntimeError, match="ImageSequential: .* cannot be captured in a CUDA graph"):
        augment(images())
    assert augment(images(), seed=1).shape == images().shape


def test_nested_containers_and_other_modules() -> None:
    class Double(nn.Module):
        def forward(self, x: Tensor) -> Tensor:
            return 2 * x

    nested = A.ImageSequential(
        A.RandomHorizontalFlip(p=1.0), A.ImageSequential(A.CenterCrop((8, 8)), Double()), Double()
    )
    x = images()
    assert torch.equal(nested(x), 4 * x.flip(-1)[..., 4:12, 6:14])
    assert nested.transform_matrix.shape == (6, 3, 3)
    assert nested.inverse(nested(x)).shape == x.shape


def test_user_classes() -> None:
    """A class that overrides Kornia's methods runs through them, in containers as well."""

    class Shift(A.GeometricAugmentationBase2D):
        def generate_parameters(self, batch_shape: Any) -> dict[str, Tensor]:
            return {"shift": torch.full((batch_shape[0],), 2.0)}

        def compute_transformation(self, input: Tensor, params: Any, flags: Any) -> Tensor:
            matrix = torch.eye(3).repeat(len(input), 1, 1)
            matrix[:, 0, 2] = params["shift"]
            return matrix

    x = images()
    expected = torch.zeros_like(x)
    expected[..., 2:] = x[..., :-2]
    augment = A.AugmentationSequential(Shift(p=1.0), A.RandomInvert(p=1.0), data_keys=["input", "keypoints"])
    y, points = augment(x, torch.zeros(6, 1, 2))
    torch.testing.assert_close(y, 1 - expected)
    assert torch.equal(points[..., 0], torch.full((6, 1), 2.0))
    flip = A.RandomHorizontalFlip(p=1.0)
    flip.apply_transform = lambda input, params, flags, transform=None: input + 1  # type: ignore[method-assign]
    assert torch.equal(flip(x), x + 1)


@pytest.mark.parametrize(
    "make",
    [
        lambda ends: A.GridDistortion(3, ends, p=1.0),
        lambda ends: A.GridDistortion(3, ends, normalized=False, p=1.0),
        lambda ends: A.MultiplicativeNoise(ends + 1, p=1.0),
        lambda ends: A.MultiplicativeNoise(ends + 1, elementwise=True, p=1.0),
        lambda ends: A.MultiplicativeNoise(ends + 1, per_channel=True, p=1.0),
    ],
    ids=range(5),
)
def test_learned_ranges_of_many_numbers(make: Any, device: torch.device) -> None:
    """Against differences: the numbers are those of plain ranges, and depend linearly on both ends."""
    columns = torch.linspace(0, 3, 40, dtype=torch.float64, device=device).sin()
    images = (columns * columns[:30, None]).expand(2, 3, 30, 40)
    ends = torch.tensor([-0.2, 0.3], requires_grad=True)

    def result(values: Tensor) -> Tensor:
        return make(values)(images, seed=7).square().sum()

    value = result(ends)
    torch.testing.assert_close(value, result(ends.detach()), rtol=1e-5, atol=0)
    (grad,) = torch.autograd.grad(value, ends)
    for i in range(2):
        step = 1e-3 * torch.eye(2)[i]
        expected = (result(ends.detach() + step) - result(ends.detach() - step)) / 2e-3
        torch.testing.assert_close(grad[i].double(), expected.cpu(), rtol=2e-2, atol=1e-3)


def test_learned_range() -> None:
    degrees = nn.Parameter(torch.tensor([-20.0, 20.0]))
    rotate = A.RandomRotation(degrees, p=1.0)
    assert [p is degrees for p in rotate.parameters()] == [True]
    rotate(images()).square().sum().backward()
    assert degrees.grad.abs().min() > 0
    A.ImageSequential(rotate, A.RandomHorizontalFlip())(images()).square().sum().backward()


def test_gradient_through_a_container() -> None:
    container = A.ImageSequential(A.RandomHorizontalFlip(), A.RandomRotation(30.0, p=1.0), A.ColorJitter(*JITTER))
    x = (0.3 + 0.4 * torch.rand(2, 3, 6, 7, generator=torch.Generator().manual_seed(0))).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: container(x, seed=3), x, eps=1e-7, atol=1e-4)


@pytest.mark.parametrize("format", ["BTCHW", "BCTHW"])
def test_frames_of_a_video_get_the_same(format: str, device: torch.device) -> None:
    frames = images(device, 3)[:, None].expand(-1, 4, -1, -1, -1)
    x = frames if format == "BTCHW" else frames.transpose(1, 2)
    children = [
        A.RandomCrop((10, 12)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(*JITTER),
        A.RandomGaussianBlur(3, (0.5, 2.0)),
    ]
    augment = A.VideoSequential(*children, data_format=format)
    y = augment(x)
    of_frames = y if format == "BTCHW" else y.transpose(1, 2)
    assert of_frames.shape == (3, 4, 3, 10, 12)
    assert torch.equal(of_frames, of_frames[:, :1].expand_as(of_frames))
    assert torch.equal(augment(x, params=augment._params), y)
    assert augment.inverse(y).shape == x.shape
    seeds = torch.tensor([5, 6, 7])
    assert torch.equal(augment(x[1:], seed=seeds[1:]), augment(x, seed=seeds)[1:])
    own = A.VideoSequential(*children, data_format=format, same_on_frame=False)(x)
    assert not torch.equal(own.flatten(), y.flatten())
    with pytest.raises(AssertionError, match="VideoSequential: expected input of shape"):
        augment(images())


def test_dispatchers() -> None:
    x = images()
    flips = A.RandomHorizontalFlip(p=1.0), A.RandomVerticalFlip(p=1.0)
    a, b = A.ManyToManyAugmentationDispather(*flips)(x, x)
    assert torch.equal(a, x.flip(-1)) and torch.equal(b, x.flip(-2))
    with pytest.raises(ValueError, match="expected 2 inputs"):
        A.ManyToManyAugmentationDispather(*flips)(x)
    with pytest.raises(ValueError, match="same data_keys"):
        A.ManyToOneAugmentationDispather(
            A.AugmentationSequential(flips[0]), A.AugmentationSequential(flips[1], data_keys=["input", "mask"])
        )


@pytest.mark.parametrize("case", MAPS, ids=lambda case: case.name)
def test_points_and_masks_follow_a_map(case: Augmentation, device: torch.device) -> None:
    gentle = {
        "RandomElasticTransform": ((47, 47), (8.0, 8.0), (1.5, 1.5)),
        "RandomThinPlateSpline": (0.1,),
        "RandomFisheye": ((-0.1, 0.1), (-0.1, 0.1), (1.9, 2.1)),
    }
    augment = A.AugmentationSequential(
        getattr(A, case.name)(*gentle[case.name], p=1.0), data_keys=["input", "mask", "keypoints"]
    )
    at = torch.tensor([[[40.0, 27.0]]], device=device)
    image = blob(40.0, 27.0).to(device)
    moved_by = []
    for seed in range(4):
        moved, mask, point = augment(image, (image > 0.5).long(), at, seed=seed)
        rows, columns = (torch.arange(n, device=device) for n in moved.shape[-2:])
        weight = moved[0, 0] ** 8  # around its center, where the map is straight
        center = torch.stack([(weight * columns).sum(), (weight * rows[:, None]).sum()]) / weight.sum()
        assert (center - point[0, 0]).abs().max() < 0.05, seed
        assert torch.equal(mask, (moved > 0.5).long()) or (mask - (moved > 0.5).long()).abs().sum() < 12
        moved_by.append(float((point - at).abs().max()))
    assert max(moved_by) > 0.5
    assert augment(image, mask, at[:, :0], seed=0)[2].shape == (1, 0, 2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8, torch.float64], ids=str)
@pytest.mark.parametrize("case", MAPS, ids=lambda case: case.name)
def test_labels_read_the_map_of_their_images(
    case: Augmentation, dtype: torch.dtype, device: torch.device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A map is computed once for an image and its labels, and freed at the end of a call."""
    calls = []
    computed = getattr(A, case.name).displacements

    def counted(self: Any, *args: Any) -> Tensor:
        calls.append(args)
        return computed(self, *args)

    monkeypatch.setattr(getattr(A, case.name), "displacements", counted)
    x = (255 * images(device)).to(dtype) if dtype == torch.uint8 else images(device).to(dtype)
    points = torch.rand(len(x), 3, 2, device=device) * 10
    augment = A.AugmentationSequential(
        A.RandomHorizontalFlip(), case.make(p=0.5), data_keys=["input", "mask", "mask", "keypoints"]
    )
    moved = augment(x, x, x.long(), points, seed=2)
    assert len(calls) == (5 if dtype == torch.float64 else 1)  # points are of float32
    assert all(child.record.map is None for child in augment._record.children)
    alone = A.AugmentationSequential(*augment.children(), data_keys=["input"])
    assert torch.equal(alone(x, seed=2), moved[0])
    again = augment(x, x, x.long(), points, params=augment._params)
    assert all(torch.equal(a, b) for a, b in zip(again, moved))
    by_call = (
        augment(x[:1], data_keys=["input"], seed=2),
        *augment(x[:1].long(), points[:1], data_keys=["mask", "keypoints"]),
    )
    whole = augment(x[:1], x[:1], x[:1].long(), points[:1], seed=2)
    assert all(torch.equal(a, b) for a, b in zip(by_call, (whole[0], *whole[2:])))


def test_cells_of_a_grid(device: torch.device) -> None:
    x = images(device)
    children = [A.RandomInvert(p=1.0), nn.Identity(), A.RandomHorizontalFlip(p=1.0), A.RandomBrightness((1.5, 1.5))]
    y = A.PatchSequential(*children, grid_size=(2, 2))(x)
    torch.testing.assert_close(y[..., :8, :10], 1 - x[..., :8, :10])
    assert torch.equal(y[..., :8, 10:], x[..., :8, 10:])
    assert torch.equal(y[..., 8:, :10], x[..., 8:, :10].flip(-1))
    torch.testing.assert_close(y[..., 8:, 10:], (x[..., 8:, 10:] + 0.5).clamp(0, 1))
    for options in ({"patchwise_apply": False}, {"random_apply": 2}, {"random_apply": True}):
        patches = A.PatchSequential(A.ColorJitter(*JITTER), A.RandomHorizontalFlip(), grid_size=(2, 4), **options)
        y = patches(x)
        assert y.shape == x.shape and not torch.equal(y, x)
        assert torch.equal(patches(x, params=patches._params), y)
        assert torch.equal(patches(x, seed=3), patches(x, seed=3))
    invert = A.RandomInvert(p=1.0)
    torch.testing.assert_close(A.PatchSequential(invert, grid_size=(3, 3), patchwise_apply=False)(x), 1 - x)
    for patchwise, grid in ((False, (2, 3)), (True, (1, 2))):
        inside = A.ImageSequential(A.RandomGamma(p=0.5), A.RandomSolarize(p=0.5))
        drawn = A.PatchSequential(A.RandomBrightness(p=0.5), inside, grid_size=grid, patchwise_apply=patchwise)
        params = drawn.forward_parameters(x.shape)
        assert torch.equal(drawn(x, params=params), drawn(x, params=params))
    valid = A.PatchSequential(invert, grid_size=(3, 3), patchwise_apply=False, padding="valid")(x)
    torch.testing.assert_close(valid, 1 - x[..., :15, 1:19])
    with pytest.raises(ValueError, match="expected 4 children"):
        A.PatchSequential(invert, grid_size=(2, 2))
    with pytest.raises(ValueError, match="keep the size of cells"):
        A.PatchSequential(A.CenterCrop(2), grid_size=(2, 2), patchwise_apply=False)(x)


@pytest.mark.tracing
@pytest.mark.parametrize("crop", [A.RandomResizedCrop((9, 11)), A.Resize((9, 11))], ids=["crop", "resize"])
def test_compiles_with_labels(crop: nn.Module) -> None:
    """Two graphs serve all sizes and seeds."""
    from torch._dynamo.testing import CompileCounterWithBackend

    torch.compiler.reset()
    augment = A.AugmentationSequential(
        crop,
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        data_keys=["image", "mask", "bbox_xyxy", "keypoints"],
    )
    backend = CompileCounterWithBackend("aot_eager")
    compiled = torch.compile(augment, fullgraph=True, backend=backend)
    for i in range(3):
        x, points = torch.rand(4 + i, 3, 16 + i, 20 + 2 * i), 10 * torch.rand(4 + i, 2, 2)
        inputs = x, x[:, :1] > 0.5, torch.cat([points, points + 2], -1), points
        for y, expected in zip(compiled(*inputs, seed=i), augment(*inputs, seed=i)):
            torch.testing.assert_close(y, expected)
    assert backend.frame_count <= 2


@pytest.mark.tracing
def test_choices_of_the_host_have_no_graph() -> None:
    """With fullgraph=True a sentence says so; without it the graph breaks and the result is the eager one."""
    torch.compiler.reset()
    blur, x = A.RandomMotionBlur((3, 7), 30.0, 0.5, p=1.0), images()
    chain = A.ImageSequential(A.RandomInvert(p=1.0), A.RandomHorizontalFlip(p=1.0), random_apply=True)
    one = A.OneOf(A.RandomInvert(), A.RandomHorizontalFlip())
    for augment in (chain, one, blur, A.RandomCrop((8, 8), p=0.5), A.RandomRotation(30.0, expand=True)):
        sentence = f"{type(augment).__name__}: a random choice that changes sizes or modules is made on the host"
        with pytest.raises(RuntimeError, match=sentence):
            torch.compile(augment, fullgraph=True, backend="eager")(x)
    results = []
    for call in (chain, torch.compile(chain, backend="eager"), one, torch.compile(one, backend="eager")):
        torch.manual_seed(1)
        results.append(call(x))
    torch.testing.assert_close(results[::2], results[1::2])
    by_seed = torch.compile(lambda x: chain(x, seed=4), fullgraph=True, backend="eager")
    assert torch.equal(by_seed(x), chain(x, seed=4))  # chosen when it is compiled


@pytest.mark.tracing
@pytest.mark.parametrize("compiler", ["aot_eager", "inductor"])
def test_compiled_calls_draw_what_eager_calls_draw(compiler: str) -> None:
    from torch._dynamo.testing import CompileCounterWithBackend

    torch.compiler.reset()
    nested = A.ImageSequential(A.ColorJitter(*JITTER), A.RandomGaussianNoise(0.0, 0.1, p=1.0))
    augment, x = A.ImageSequential(A.RandomAffine(30.0, p=0.5), A.RandomHorizontalFlip(), nested), images()
    backend = CompileCounterWithBackend(compiler)
    compiled = torch.compile(augment, fullgraph=True, backend=backend)
    for i in range(3):
        compiled(images()[:, :, : 16 - i])
    assert backend.frame_count <= 2
    torch.manual_seed(1)
    expected, state = [augment(x), augment(x)], torch.get_rng_state()
    torch.manual_seed(1)
    for y, eager in zip([compiled(x), compiled(x)], expected):
        torch.testing.assert_close(y, eager)
    assert torch.equal(torch.get_rng_state(), state) and not torch.equal(expected[0], expected[1])


def test_nested_containers_have_draws_of_their_own_under_a_seed(device: torch.device) -> None:
    """Neighbors with the same draws would always act together."""
    x, seeds = torch.rand(400, 3, 4, 4, device=device), torch.arange(400, device=device)
    flip, other = A.RandomHorizontalFlip(), A.RandomVerticalFlip()
    for children in (
        [flip, A.ImageSequential(other)],
        [A.ImageSequential(flip), A.ImageSequential(other)],
        [A.ImageSequential(flip, A.ImageSequential(other))],
        [A.ImageSequential(A.ImageSequential(flip)), A.ImageSequential(A.ImageSequential(other))],
    ):
        container = A.ImageSequential(*children)
        y = container(x, seed=seeds)
        flips = [m for m in container.modules() if isinstance(m, type(flip)) or isinstance(m, type(other))]
        a, b = (m._params["batch_prob"] > 0.5 for m in flips)
        assert 0.35 < (a == b).float().mean() < 0.65
        assert torch.equal(container(x, params=container._params), y)
        assert torch.equal(container(x[7:9], seed=seeds[7:9]), y[7:9])
    policies = A.ImageSequential(A.auto.TrivialAugment(), A.auto.TrivialAugment())
    policies(x, seed=seeds)
    a, b = (item.data[0].data["operation"] for item in policies._params)
    assert (a == b).float().mean() < 0.3
    ones = [A.ImageSequential(A.RandomInvert(p=1.0), A.RandomHorizontalFlip(p=1.0), random_apply=1) for _ in range(2)]
    both = A.ImageSequential(*ones)
    names = []
    for seed in range(40):
        both(x[:1], seed=seed)
        names.append([item.data[0].name for item in both._params])
    assert 5 < sum(first == second for first, second in names) < 35


def test_cells_with_the_same_children_are_one_batch(device: torch.device) -> None:
    """Each cell is what its children give for it alone; children run once for all cells that get them."""
    x = images(device)
    calls = []

    class Record(nn.Module):
        def forward(self, x: Tensor) -> Tensor:
            calls.append(len(x))
            return x

    children = [Record(), A.RandomInvert(p=1.0), A.RandomSolarize((0.5, 0.5), (0.0, 0.0), p=1.0)]
    patches = A.PatchSequential(*children, grid_size=(4, 5), random_apply=1)
    y = patches(x, seed=3)
    indices = {item.param.name: item.indices for item in patches._params}
    assert sorted(n for of_child in indices.values() for n in of_child) == list(range(20)) and len(patches._params) == 3
    assert calls == [6 * len(indices["Record_0"])]
    expected = {"Record_0": x, "RandomInvert_1": 1 - x, "RandomSolarize_2": torch.where(x > 0.5, 1 - x, x)}
    cells = {name: patches.extract_patches(value) for name, value in expected.items()}
    for name, cells_of_child in indices.items():
        for cell in cells_of_child:
            torch.testing.assert_close(patches.extract_patches(y)[:, cell], cells[name][:, cell])
    whole = A.PatchSequential(Record(), A.ColorJitter(*JITTER), grid_size=(4, 5), patchwise_apply=False)
    calls.clear()
    y = whole(x)
    assert calls == [120] and torch.equal(whole(x, params=whole._params), y)
    each = whole(x[:1].expand(6, -1, -1, -1), seed=torch.arange(6) * 0 + 4)
    assert torch.equal(each, each[:1].expand_as(each)) and torch.equal(
        whole(x[2:3], seed=torch.tensor([8])), whole(x, seed=torch.tensor([1, 2, 8, 3, 4, 5]))[2:3]
    )
    leaf = x.clone().requires_grad_()
    patches(leaf, seed=3).sum().backward()
    assert torch.equal(leaf.grad.abs(), torch.ones_like(leaf))


def test_cells_in_containers(device: torch.device) -> None:
    """Labels stay where they are; cells that move take none with them."""
    x, points, masks = (
        images(device),
        torch.rand(6, 2, 2, device=device),
        torch.ones(6, 1, 16, 20, device=device).long(),
    )
    colors = A.PatchSequential(A.ColorJitter(*JITTER), A.RandomInvert(), grid_size=(2, 2), random_apply=1)
    augment = A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), colors, data_keys=["image", "mask", "keypoints"])
    y, mask, moved = augment(x, masks, points)
    assert torch.equal(mask, masks) and torch.equal(moved[..., 0], 19 - points[..., 0])
    again = augment(x, masks, points, params=augment._params)
    assert torch.equal(again[0], y) and augment.inverse(y, mask, moved)[1].shape == masks.shape
    assert torch.equal(augment(x, masks, points, seed=1)[0], augment(x, masks, points, seed=1)[0])
    flips = A.PatchSequential(A.RandomHorizontalFlip(p=1.0), grid_size=(1, 2), patchwise_apply=False)
    augment = A.AugmentationSequential(flips, A.RandomInvert(p=1.0), data_keys=["image", "class"])
    y, _ = augment(x, torch.arange(6))
    torch.testing.assert_close(y, 1 - torch.cat([x[..., :10].flip(-1), x[..., 10:].flip(-1)], -1))
    for key, label in {"mask": masks, "keypoints": points, "bbox_xyxy": points.repeat(1, 1, 2)}.items():
        with pytest.raises(
            NotImplementedError, match="PatchSequential: masks, boxes, .* cannot follow cells that move"
        ):
            augment(x, label, data_keys=["image", key])
    with pytest.raises(NotImplementedError, match="cannot follow cells"):
        flips.inverse(flips(x))


@pytest.mark.parametrize("resample", ["each", "once"])
@pytest.mark.parametrize("case", [c for c in (*GEOMETRIC, *MAPS) if not c.changes_size], ids=lambda case: case.name)
def test_replay_of_a_batch_in_which_nothing_was_chosen(case: Augmentation, resample: str) -> None:
    # Pixels from outside follow the first augmentation that interpolates, whether or not samples were chosen.
    bordered = {"padding_mode": "border"} if case.name in ("RandomAffine", "RandomElasticTransform") else {}
    first = case.make(p=0.5, **bordered)
    for second in (A.RandomPerspective(0.5, p=1.0), A.RandomHorizontalFlip(), A.RandomHue((-0.1, 0.1), p=0.5)):
        container = A.AugmentationSequential(first, second, resample=resample)
        x = images(batch=1) + 0.5
        chosen = set()
        for seed in range(12):
            y = container(x, seed=seed)
            chosen.add(container._params[0].data["batch_prob"].item())
            assert torch.equal(container(x, params=container._params), y)
        assert chosen == {0.0, 1.0}


WITH_MATRICES = {
    "ImageSequential": lambda **options: A.ImageSequential(A.RandomRotation(30.0), A.RandomInvert(), **options),
    "AugmentationSequential": lambda **options: A.AugmentationSequential(A.RandomAffine(30.0), **options),
    "PatchSequential": lambda **options: A.PatchSequential(
        A.RandomInvert(), grid_size=(2, 2), patchwise_apply=False, **options
    ),
    "AutoAugment": lambda **options: A.auto.AutoAugment(**options),
    "RandAugment": lambda **options: A.auto.RandAugment(2, 9, **options),
    "TrivialAugment": lambda **options: A.auto.TrivialAugment(**options),
    "AugMix": lambda **options: A.auto.AugMix(**options),
    "OneOf": lambda **options: A.OneOf(A.RandomRotation(30.0), A.RandomInvert(), A.RandomHorizontalFlip(), **options),
    "AdaptiveDiscriminatorAugmentation": lambda **options: A.presets.ada.AdaptiveDiscriminatorAugmentation(
        A.RandomAffine(30.0, p=1.0), initial_p=0.5, **options
    ),
}


@pytest.mark.parametrize("name", WITH_MATRICES)
def test_return_transform(name: str, device: torch.device) -> None:
    """On the constructor and the call; matrices that come with the images are multiplied, or passed on."""
    x, before = images(device), torch.tensor([[1.0, 0, 3], [0, 1, 0], [0, 0, 1]]).expand(6, 3, 3)
    augment = WITH_MATRICES[name]()
    y, matrix = augment(x, seed=1, return_transform=True)
    assert torch.equal(y, augment(x, seed=1)) and matrix.device == x.device
    torch.testing.assert_close(matrix.cpu(), augment.transform_matrix.cpu())
    assert augment((x, before), seed=1)[1] is before
    own = WITH_MATRICES[name](return_transform=True)
    assert isinstance(own(x, seed=1, return_transform=False), Tensor)
    torch.testing.assert_close(own((x, before), seed=1)[1], matrix @ before.to(matrix))
    chained = nn.Sequential(own, A.RandomHorizontalFlip(p=1.0, return_transform=True))
    _, product = chained(x)
    flip = torch.tensor([[-1.0, 0, 19], [0, 1, 0], [0, 0, 1]], device=device)
    torch.testing.assert_close(product, flip @ own.transform_matrix.to(device))


def test_return_transform_with_labels(device: torch.device) -> None:
    x, flip = images(device), A.RandomHorizontalFlip(p=1.0)
    expected = torch.tensor([[-1.0, 0, 19], [0, 1, 0], [0, 0, 1]], device=device).expand(6, 3, 3)
    augment = A.AugmentationSequential(flip, data_keys=["image", "mask"], return_transform=True)
    (y, matrix), mask = augment(x, x)
    assert torch.equal(matrix, expected) and torch.equal(y, mask)
    assert A.preview(augment, x[:1], x[:1], count=2).dim() == 3
    named = A.AugmentationSequential(flip, data_keys=None)({"mask": x, "image": x}, return_transform=True)
    assert torch.equal(named["image"][1], expected) and torch.equal(named["mask"], mask)
    video = A.VideoSequential(flip, return_transform=True)
    frames, matrices = video(x[None])
    assert torch.equal(matrices, expected) and frames.shape == (1, *x.shape)
    with pytest.raises(RuntimeError, match="RandomMixUpV2: samples are mixed, there is no matrix"):
        A.RandomMixUpV2(return_transform=True)


def test_samples_that_a_discriminator_sees_unchanged_have_the_identity(device: torch.device) -> None:
    x = images(device, batch=32)
    augment = A.presets.ada.AdaptiveDiscriminatorAugmentation(A.RandomHorizontalFlip(p=1.0), initial_p=0.5)
    y = augment(x)
    chosen = augment._params[-1].data["batch_prob"].to(device) > 0.5
    assert 0 < chosen.sum() < 32
    flips = augment.transform_matrix[:, 0, 0].to(device) < 0
    assert torch.equal(flips, chosen) and torch.equal(augment.inverse(y), x)
    assert torch.equal(augment(x, params=augment._params), y) and torch.equal(augment(x, params=augment._params), y)


@pytest.mark.parametrize(
    "call",
    [
        lambda keys: A.AugmentationSequential(A.RandomHorizontalFlip(), data_keys=keys),
        lambda keys: A.AugmentationSequential(A.RandomHorizontalFlip())(images(), images(), data_keys=keys),
        lambda keys: A.RandomCutMixV2(data_keys=keys),
        lambda keys: A.RandomTransplantation()(images(), images()[:, 0], data_keys=keys),
        lambda keys: A.preview(A.RandomHorizontalFlip(), images()[0], images(), data_keys=keys),
    ],
    ids=["constructor", "call", "mix", "transplantation", "preview"],
)
def test_unknown_data_keys(call: Any) -> None:
    listed = "'image', 'input', 'mask', 'bbox', 'bbox_xyxy', .*; got "
    with pytest.raises(KeyError, match=rf"\w+: expected data_keys to be of {listed}\['image', 'foo'\]"):
        call(["image", "foo"])
    with pytest.raises(TypeError, match=rf"\w+: expected data_keys to be of {listed}\['image', 1.5\]"):
        call(["image", 1.5])


def chosen_for_samples(grid: bool) -> Any:
    children = (
        *(A.RandomAffine(30.0, p=1.0), A.RandomInvert(p=1.0), A.RandomMotionBlur((3, 9), 35.0, 0.5, p=0.7)),
        A.RandomElasticTransform((5, 5), (2.0, 2.0), p=0.7),
        A.ImageSequential(A.RandomVerticalFlip(), A.RandomBrightness(), random_apply=1),
    )
    if grid:
        return A.PatchSequential(*children, grid_size=(2, 2), random_apply=True)
    return A.AugmentationSequential(*children, random_apply=True, data_keys=["input", "mask", "keypoints"])


@pytest.mark.parametrize("grid", [False, True])
def test_children_and_kernel_sizes_follow_the_seeds_of_samples(grid: bool, device: torch.device) -> None:
    x = torch.rand(6, 3, 16, 20, generator=torch.Generator().manual_seed(0)).to(device)
    inputs = [x] if grid else [x, x[:, :1], 16 * x[:, 0, :4, :2]]
    augment, seeds = chosen_for_samples(grid), torch.arange(6) + 50

    def call(order: Tensor, **options: Any) -> list[Tensor]:
        outputs = augment(*(value[order] for value in inputs), **options)
        return [outputs] if grid else list(outputs)

    whole = call(torch.arange(6), seed=seeds)
    again = call(torch.arange(6), params=augment._params)
    assert all(torch.equal(a, b) for a, b in zip(again, whole))
    for order in (torch.tensor([3, 0, 5, 1, 4, 2]), torch.tensor([4]), torch.arange(0)):
        part = call(order, seed=seeds[order])
        assert all(torch.equal(a, b[order]) for a, b in zip(part, whole))
    if not grid:
        changed = A.ImageSequential(A.CenterCrop(8), A.RandomInvert(), random_apply=1)
        with pytest.raises(
            ValueError, match="expected children that give all samples one size, got .8, 8. and .16, 20."
        ):
            changed(x, seed=seeds)


def test_the_kernel_size_of_a_batch_is_that_of_a_chosen_sample() -> None:
    """Samples that are not chosen made the smallest of the three sizes likelier."""
    blur = A.RandomMotionBlur((3, 7), 35.0, 0.5, p=0.3)
    sizes = []
    for seed in range(300):
        blur(torch.zeros(6, 1, 2, 2), seed=seed)
        if blur._params["batch_prob"].any():
            sizes.append(int(blur._params["ksize_factor"][0]))
    assert all(0.25 < sizes.count(size) / len(sizes) < 0.42 for size in (3, 5, 7))
