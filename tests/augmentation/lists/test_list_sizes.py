"""Lists of images to which augmentations give sizes of their own: by the launches of a batch, what each image becomes alone."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from augmentation.container.test_list_launches import calls
from augmentation.test_lists import KEYS, assert_as_alone, assert_same, comparison, pictures, seeds_of
from benchmarks.timing import launches
from kvision import augmentation as A
from kvision.augmentation import auto
from op_tests import assert_close

SIZES = ((16, 20), (24, 31), (16, 20), (27, 27), (40, 18))

SIZING = {
    "shorter side": lambda: (A.SmallestMaxSize(21),),
    "few pixels": lambda: (A.SmallestMaxSize(2),),
    "longer side": lambda: (A.LongestMaxSize(25, p=0.6),),
    "antialiased": lambda: (A.SmallestMaxSize(11, antialias=True), A.RandomHorizontalFlip()),
    "a side": lambda: (A.Resize(17, side="vert", resample="nearest"), A.ColorJitter(0.2, 0.2, p=0.7)),
    "pad": lambda: (A.Pad((3, 1, 0, 2), fill=0.25, p=0.5),),
    "cut": lambda: (A.RandomAffine(20.0), A.Pad(-2), A.RandomHorizontalFlip()),
    "pad by reflection": lambda: (A.Pad(4, padding_mode="reflect"), A.RandomInvert()),
    "pad if needed": lambda: (A.PadIfNeeded(24, 24, position="random"),),
    "pad to multiples": lambda: (A.PadIfNeeded(None, None, 8, 8, padding_mode="edge", p=0.7),),
    "pad to": lambda: (A.PadTo((24, 24), crop_if_exceeds=False),),
    "scale": lambda: (A.RandomScale((0.5, 1.5), p=0.7),),
    "scale by warps": lambda: (A.RandomHorizontalFlip(), A.RandomScale((0.5, 1.5), antialias=False, p=1.0)),
    "scale one by a warp": lambda: (A.RandomScale((0.5, 1.5), antialias=False, p=0.5),),
    "transpose": lambda: (A.Transpose(), A.RandomRotation(20.0)),
    "transpose twice": lambda: (A.Transpose(), A.RandomHorizontalFlip(), A.Transpose(), A.RandomPlasmaShadow()),
    "symmetries": lambda: (A.D4(), A.RandomRotation(10.0)),
    "chain": lambda: (A.Transpose(p=1.0), A.SmallestMaxSize(24), A.Pad(1), A.RandomAffine(20.0), A.RandomErasing()),
    "choice": lambda: (A.OneOf(A.SmallestMaxSize(20), A.Transpose(p=1.0), A.RandomScale(p=1.0)), A.RandomInvert()),
}
CROPPED = {
    "crop": lambda: (A.SmallestMaxSize(24), A.RandomCrop((20, 22)), A.Normalize(0.4, 0.3)),
    "antialiased crop": lambda: (A.LongestMaxSize(22, antialias=True), A.CenterCrop((9, 9)), A.RandomHorizontalFlip()),
    "padded crop": lambda: (A.PadIfNeeded(24, 24), A.RandomCrop((20, 22)), A.ColorJitter(0.2, 0.2)),
    "antialiased size": lambda: (A.RandomHorizontalFlip(), A.Resize((9, 11), antialias=True), A.RandomInvert()),
    "zoom": lambda: (A.RandomZoomOut(side_range=(1.5, 3.0), p=1.0, size=(12, 14)), A.RandomHorizontalFlip()),
    "late zoom": lambda: (A.RandomAffine(20.0), A.RandomZoomOut(p=1.0, size=(12, 14)), A.ColorJitter(0.2, 0.2)),
    "scaled crop": lambda: (A.RandomScale((0.9, 1.2)), A.RandomResizedCrop((12, 14))),
}
ALL = {**SIZING, **CROPPED}


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("name", ALL)
def test_sizes_of_their_own(name, dtype, device):
    children = ALL[name]()
    augment, images = (
        children[0] if len(children) == 1 else A.ImageSequential(*children),
        pictures(device, SIZES, dtype),
    )
    assert_as_alone(augment, images)
    assert isinstance(augment(images), list) == (name in SIZING)


@pytest.mark.parametrize("name", ALL)
def test_labels_follow_into_other_sizes(name, device):
    images, counts = pictures(device, SIZES), (2, 0, 1, 3, 1)
    seeds = seeds_of(images)
    masks = [torch.randint(0, 9, (n, *x.shape[1:]), device=device) for n, x in zip(counts, images)]
    boxes = [torch.rand(n, 4, device=device).cumsum(1) * 5 for n in counts]
    points = [torch.rand(n, 2, device=device) * 15 for n in (1, 3, 0, 2, 1)]
    inputs = [images, masks, boxes, [list(range(n)) for n in counts], points]
    augment = A.AugmentationSequential(*ALL[name](), data_keys=KEYS, clip_boxes=True, min_box_area=3.0)
    y, *moved = augment(*inputs, seed=seeds)
    same = comparison(augment, y[0].device)
    params, matrices = augment._params, augment.transform_matrix
    by_params, back = augment(*inputs, params=params), augment.inverse(y, *moved, params=params)
    for b, x in enumerate(images):
        own = [[value[b]] for value in inputs[1:]]
        of_image, *of_labels = augment(x[None], *own, seed=seeds[b : b + 1])
        assert same(y[b], of_image[0]) and same(by_params[0][b], y[b])
        assert torch.equal(matrices[b], augment.transform_matrix[0])
        inverse = augment.inverse(of_image, *of_labels)
        for of_list, replayed, label, of_back, returned in zip(moved, by_params[1:], of_labels, back[1:], inverse[1:]):
            assert_same(of_list[b], label[0])
            assert_same(replayed[b], label[0])
            assert_same(of_back[b], returned[0])


NEVER = {
    "alone": lambda: (A.CenterCrop((9, 11), p=0.0),),
    "first": lambda: (A.RandomCrop((9, 11), p=0.0), A.RandomHorizontalFlip()),
    "behind": lambda: (A.RandomAffine(20.0), A.Resize((9, 11), p=0.0), A.SmallestMaxSize(9), A.RandomInvert()),
    "before another": lambda: (A.RandomCrop((9, 11), p=0.0), A.RandomHorizontalFlip(), A.Resize((12, 11))),
    "beside a choice": lambda: (A.RandomCrop((9, 11), p=0.0), A.RandomResizedCrop((9, 11), p=0.5)),
}


@pytest.mark.parametrize("name", NEVER)
def test_sizes_that_are_never_given(name, device):
    children, images = NEVER[name](), pictures(device, SIZES)
    augment = children[0] if len(children) == 1 else A.ImageSequential(*children)
    assert_as_alone(augment, images)
    assert type(augment(images)) is (torch.Tensor if name == "before another" else list)


@pytest.mark.parametrize("name", ["alone", "only child", "in a chain", "image by image"])
def test_images_of_one_size_have_a_factor_each(name, device):
    """Their parameters and inverse are those factors', too."""
    scale = A.RandomScale((0.4, 1.6), p=1.0)
    others = {
        "alone": [],
        "only child": [],
        "in a chain": [A.RandomInvert(p=1.0)],
        "image by image": [A.RandomSnow(p=1.0)],
    }[name]
    images = pictures(device, ((37, 30), (37, 30), (25, 19)))
    augment = scale if name == "alone" else A.ImageSequential(scale, *others)
    results = augment(images, seed=seeds_of(images))
    assert results[0].shape != results[1].shape
    assert_as_alone(augment, images)


@pytest.mark.parametrize("name", ["shorter side", "pad by reflection", "scale by warps", "transpose", "chain", "crop"])
def test_gradients_of_results_of_other_sizes(name, device):
    augment = A.ImageSequential(*ALL[name]())
    images = [x.requires_grad_() for x in pictures(device, SIZES)]
    seeds = seeds_of(images)
    gradients = torch.autograd.grad(sum(y.square().sum() for y in augment(images, seed=seeds)), images)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1]).square().sum()
        assert torch.allclose(gradients[b], torch.autograd.grad(alone, x)[0], atol=1e-4)


@pytest.mark.parametrize("name", [name for name in ALL if name != "transpose twice"])
def test_calls_of_operators(name, backend):
    """Those of four choices at most, whatever the number of images."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    images = pictures("cpu", [(24 + i % 17, 45 - i % 19) for i in range(40)])
    assert calls(A.ImageSequential(*ALL[name]()), images, seed=seeds_of(images)) <= 12


@pytest.mark.parametrize("name", ["shorter side", "antialiased", "cut", "pad if needed", "symmetries", "crop"])
def test_as_many_launches_as_a_batch(name):
    """Before a crop two more: draws and matrices, and colors behind it, are launches of their own."""
    if not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    images = pictures("cuda", [(40 + i % 9, 52 + 4 * (i % 7)) for i in range(300)], torch.uint8)
    batch, augment = torch.stack([x[:, :40, :52] for x in images]), A.ImageSequential(*ALL[name]())
    assert launches(partial(augment, images)) <= launches(partial(augment, batch)) + 2 * (name == "crop")


def test_what_is_too_small_is_said(device):
    images = pictures(device, ((20, 20), (9, 30)))
    with pytest.raises(ValueError, match=r"Pad: expected padding that leaves pixels of \(9, 30\)"):
        A.Pad(-5)(images)
    with pytest.raises(ValueError, match=r"RandomCrop: .*\(12, 12\)"):
        A.ImageSequential(A.RandomHorizontalFlip(), A.RandomCrop((12, 12)))(images)


def test_equal_sizes_are_decided_for_as_one(device):
    images = pictures(device, [(16, 20)] * 6)
    for augment in (A.RandomScale((0.5, 1.5)), A.Transpose(), A.ImageSequential(A.Transpose(), A.RandomInvert())):
        for seed in range(4):
            assert len({y.shape for y in augment(images, seed=seed)}) == 1
            batch = augment(torch.stack(images), seed=seed)
            assert all(torch.equal(a, b) for a, b in zip(augment(images, seed=seed), batch))


@pytest.mark.parametrize(
    "augment",
    [
        A.OneOf(A.PadIfNeeded(24, 30), A.RandomInvert(p=1.0)),
        A.RandomApply(A.PadIfNeeded(24, 30)),
        A.SomeOf(A.ImageSequential(A.PadIfNeeded(24, 30)), A.RandomInvert(p=1.0), n=1),
        A.ImageSequential(A.CenterCrop((7, 8)), A.RandomInvert(p=1.0), random_apply=1),
    ],
    ids=lambda augment: type(augment).__name__,
)
def test_choices_give_images_of_one_size_sizes_of_their_own(augment, device):
    """And replays of them, too."""
    images = pictures(device, [(16, 20)] * 5)
    seeds = torch.arange(5, device=device)
    results = augment(images, seed=seeds)
    assert len({y.shape for y in results}) == 2
    replayed = augment(images, params=augment._params)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1])[0]
        assert torch.equal(results[b], alone) and torch.equal(replayed[b], alone)


@pytest.mark.tracing
@pytest.mark.parametrize(
    "augment",
    [
        A.Pad(2),
        A.Transpose(p=1.0),
        A.D4(p=1.0),
        A.SmallestMaxSize(9),
        A.LongestMaxSize(12, antialias=True),
        A.PadIfNeeded(24, 30),
        A.ImageSequential(A.PadIfNeeded(24, 30), A.D4(p=1.0), A.RandomInvert(p=1.0)),
    ],
    ids=lambda augment: type(augment).__name__,
)
def test_lists_of_sizes_of_their_own_have_graphs(augment, device):
    from torch._dynamo.testing import CompileCounter

    counter = CompileCounter()
    torch._dynamo.reset()
    compiled = torch.compile(lambda images: augment(images, seed=3), fullgraph=True, backend=counter)
    for sizes in (((20, 30), (41, 17)), ((16, 19), (21, 18)), ((18, 28), (51, 40))):
        images = pictures(device, sizes)
        assert all(torch.equal(a, b) for a, b in zip(compiled(images), augment(images, seed=3), strict=True))
    assert counter.frame_count <= 2

    def call(*images):
        return sum(y.square().sum() for y in augment(list(images), seed=3))

    images = [x.requires_grad_() for x in pictures(device, SIZES[:2])]
    compiled = torch.compile(call, fullgraph=True, backend="aot_eager")
    for a, b in zip(*(torch.autograd.grad(f(*images), images) for f in (call, compiled))):
        assert_close(a, b)


@pytest.mark.parametrize(
    "augment",
    [
        A.RandomHorizontalFlip(p=1.0),
        A.RandomRotation(20.0, p=1.0),
        A.RandomElasticTransform((5, 5), (2.0, 2.0), p=1.0),
        A.RandomGaussianBlur((3, 3), (0.5, 1.0), p=1.0),
        A.RandomErasing(p=1.0),
        auto.AugMix(),
    ],
    ids=lambda augment: type(augment).__name__,
)
def test_results_and_gradients_have_memory_of_their_own(augment, device):
    """Compiled programs take no operator whose results share memory; lists that are too long for these share a block."""
    images = pictures(device, SIZES)
    images = images if isinstance(augment, auto.AugMix) else [x.requires_grad_() for x in images]
    results = augment(images, seed=3)
    gradients = torch.autograd.grad(sum(y.square().sum() for y in results), images) if results[0].requires_grad else ()
    for each in (results, gradients):
        assert len({x.untyped_storage().data_ptr() for x in each}) == len(each)


def test_long_lists_share_a_block(device, backend):
    """It takes the host less time than an allocation for each result."""
    for count, blocks in ((16, 16), (17, 1)):
        images = pictures(device, [(5 + i, 9) for i in range(count)])
        results = A.RandomHorizontalFlip(p=1.0)(images)
        assert all(torch.equal(y, x.flip(-1)) for x, y in zip(images, results, strict=True))
        assert len({y.untyped_storage().data_ptr() for y in results}) == (count if backend == "reference" else blocks)
