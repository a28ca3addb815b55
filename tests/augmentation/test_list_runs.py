"""Runs of passes over lists of images: the bits of each image alone and of a batch, gradients, labels, graphs and launches."""

from __future__ import annotations

import gc
import weakref
from functools import partial

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from augmentation.test_lists import SMALL, Halved, pictures, seeds_of
from benchmarks.timing import launches
from kvision import augmentation as A
from kvision._backend import current_backend
from kvision.augmentation.drawn_pass import DrawnListPass
from kvision.augmentation.engine import list_runs, passes
from kvision.augmentation.lists import conversions
from op_tests import assert_close

FISHEYE = [torch.tensor(r, device="cpu") for r in ((-0.3, 0.3), (-0.3, 0.3), (0.9, 1.1))]
PASSES = {
    "flips": lambda: (A.RandomHorizontalFlip(), A.RandomVerticalFlip(p=1.0)),
    "affine": lambda: (A.RandomAffine(20.0, (0.1, 0.1), (0.8, 1.2), p=0.7),),
    "perspective": lambda: (A.RandomPerspective(0.3, p=1.0), A.RandomGrayscale(p=0.5)),
    "antialiased": lambda: (
        A.RandomAffine(20.0, scale=(0.3, 0.8), antialias=True, p=0.7),
        A.RandomHorizontalFlip(),
        A.RandomPerspective(0.5, antialias=True, p=0.7),
        A.RandomZoomOut(fill=0.5, p=0.7),
    ),
    "nearest": lambda: (A.RandomRotation(30.0, "nearest", p=1.0), A.RandomVerticalFlip()),
    "colors": lambda: (A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=0.8), A.RandomSolarize(), A.RandomPosterize()),
    "everything": lambda: (
        A.RandomHorizontalFlip(),
        A.RandomAffine(20.0),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize(0.4, 0.3),
    ),
    "erasing": lambda: (A.RandomErasing(p=0.7), A.RandomHorizontalFlip(), A.CoarseDropout((1, 3), fill=0.5, p=0.9)),
    "lines": lambda: (A.GridMask(rotation_range=(-0.4, 0.4), p=0.7),),
    "units": lambda: (A.GridDropout(0.4, unit_size_range=(3, 9), p=0.7), A.GridDropout(p=0.7)),
    "gaussian": lambda: (
        A.RandomGaussianBlur((3, 5), (0.3, 2.0), p=0.7),
        A.RandomGaussianBlur(5, (0.5, 2.0), "replicate"),
    ),
    "box": lambda: (A.RandomBoxBlur(p=0.7), A.RandomBoxBlur((3, 2), "circular", p=1.0), A.RandomHorizontalFlip()),
    "median": lambda: (A.RandomMedianBlur(p=0.7), A.RandomMedianBlur((5, 5)), A.RandomMedianBlur((2, 3), p=1.0)),
    "sharpness": lambda: (A.RandomSharpness(p=0.7), A.RandomSharpness((0.5, 3.0), p=0.7)),
    "zoom": lambda: (A.ZoomBlur(p=0.7), A.ZoomBlur((1.0, 1.5), (0.1, 0.2), p=0.7)),
    "chromatic": lambda: (A.ChromaticAberration((-0.3, 0.3), (-0.3, 0.3), p=0.7), A.RandomHorizontalFlip()),
    "disks": lambda: (A.Defocus((1, 2), p=0.7), A.Defocus((1, 3), p=0.7)),
    "lenses": lambda: (
        A.OpticalDistortion(p=0.7),
        A.RandomHorizontalFlip(),
        A.OpticalDistortion(mode="fisheye", resample="bicubic", padding_mode="reflection", p=0.7),
        A.RandomFisheye(*FISHEYE, p=0.7),
    ),
    "splines": lambda: (A.RandomThinPlateSpline(p=0.7), A.Swirl(resample="nearest", padding_mode="border", p=0.7)),
    "late crop": lambda: (A.RandomHorizontalFlip(), A.RandomResizedCrop((12, 14)), A.ColorJitter(0.2, 0.2)),
    "statistics": lambda: (A.Denormalize(0.3, 0.5, p=0.7), A.RandomHorizontalFlip(), A.Normalize(0.5, 0.5, p=0.7)),
}


# Of pixels that have numbers of their own.
NOISES = {
    "normal": lambda: (A.RandomAffine(20.0), A.RandomGaussianNoise(std=0.2, p=0.7), A.RandomHorizontalFlip()),
    "salt": lambda: (A.RandomSaltAndPepperNoise(0.2, p=0.7),),
    "factors": lambda: (A.SpeckleNoise(p=0.7), A.MultiplicativeNoise(per_channel=True, elementwise=True, p=1.0)),
    "factors of images": lambda: (A.MultiplicativeNoise((0.5, 1.5), p=0.7), A.RandomHorizontalFlip()),
    "factors of channels": lambda: (A.MultiplicativeNoise((0.5, 1.5), per_channel=True, p=0.7),),
    "dropped": lambda: (A.PixelDropout(0.2, p=0.7), A.PixelDropout(0.2, True, "random", p=0.7)),
    "colored": lambda: (A.PixelDropout(0.2, drop_value=(0.2, 0.3, 0.9), p=0.7), A.PixelDropout(0.2, True, 0.5, p=0.7)),
    "erased": lambda: (
        A.RandomErasing(value="random", p=0.7),
        A.RandomHorizontalFlip(),
        A.CoarseDropout((1, 3), fill="random", p=0.7),
    ),
    "lines of noise": lambda: (A.GridMask(fill="random", p=0.7),),
    "units of noise": lambda: (A.GridDropout(fill="random", p=0.7),),
    "photons": lambda: (A.ShotNoise(p=0.7), A.RandomHorizontalFlip()),
    "sensor": lambda: (A.ISONoise(p=0.7),),
    "glass": lambda: (A.GlassBlur(p=0.7), A.RandomHorizontalFlip(), A.GlassBlur(0.3, 2, 1, p=0.7)),
    "grids": lambda: (A.GridDistortion(p=0.7), A.PiecewiseAffine(nb_rows_range=(3, 5), p=0.7)),
    "elastic": lambda: (
        A.RandomElasticTransform((9, 7), (2.0, 3.0), (2.0, 3.0), p=0.7),
        A.RandomRotation(20.0),
        A.RandomElasticTransform((5, 5), (2.0, 2.0), align_corners=True, p=0.7),
    ),
    "elastic by sides": lambda: (
        A.RandomElasticTransform((127, 95), (20.0, 24.0), (2.0, 3.0), scale_window=True, p=0.7),
        A.RandomElasticTransform((1, 95), (20.0, 24.0), (2.0, 3.0), True, scale_window=True, p=0.7),
    ),
    "wide elastic": lambda: (  # windows that the kernel of displacements does not have
        A.RandomElasticTransform((1001, 1201), (200.0, 150.0), (2.0, 3.0), True, scale_window=True, p=0.7),
        A.RandomElasticTransform((71, 9), (20.0, 3.0), (2.0, 3.0), p=0.7),
    ),
    "rain": lambda: (A.Spatter(gauss_sigma_range=(1.0, 2.0), p=0.7), A.CommonCorruption("spatter", 2, p=0.7)),
    "mud": lambda: (A.Spatter((0.6, 0.7), mode="mud", p=0.7), A.CommonCorruption("spatter", 5, p=0.7)),
    "waves": lambda: (A.CommonCorruption("elastic_transform", 3, p=0.7), A.RandomHorizontalFlip()),
    "late": lambda: (A.RandomErasing(), A.RandomResizedCrop((12, 14)), A.RandomErasing(), A.SpeckleNoise(p=1.0)),
}
BLURS = ("gaussian", "box", "median", "disks", "sharpness", "zoom")
MAPS = ("lenses", "splines", "grids", "elastic", "elastic by sides", "waves")
OTHERS = ("antialiased", "rain", "mud")
PASSES_AND_NOISES = {**PASSES, **NOISES}


def is_by_passes(augment):
    return type(augment._record.parts) is list_runs.ListParts


def same(a, b, is_map=False):
    """The same bits; torch's convolutions, by which the reference blurs, have others for each size of a batch."""
    if is_map and a.dtype == torch.float64 and a.is_cuda:  # kernels of lists may round other products of doubles
        return a.shape == b.shape and torch.allclose(a, b, rtol=0, atol=1e-12)
    if current_backend() != "reference":
        return torch.equal(a, b)
    steps = {torch.uint8: 1, torch.float16: 1e-3}.get(a.dtype, 1e-5)
    return a.shape == b.shape and torch.allclose(a.double(), b.double(), rtol=0, atol=steps)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", PASSES)
def test_passes_over_a_list(name, dtype, channels, device):
    if channels == 1 and any(
        isinstance(m, (A.ColorJitter, A.RandomGrayscale, A.ChromaticAberration)) for m in PASSES[name]()
    ):
        pytest.skip("colors have three channels")
    augment, images = A.ImageSequential(*PASSES[name]()), [x[:channels] for x in pictures(device, SMALL, dtype)]
    interleaved = [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in images]
    views = [torch.nn.functional.pad(x, (1, 2, 3, 1))[:, 3:-1, 1:-2] for x in images]
    seeds = seeds_of(images)
    for given in (images, interleaved, views):
        results = augment(given, seed=seeds)
        assert is_by_passes(augment)
        for b, x in enumerate(given):
            assert same(results[b], augment(x[None], seed=seeds[b : b + 1])[0], name in MAPS)
    equal = [x[:, :15, :16].contiguous() for x in images]
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results = augment(equal, **options)
        torch.manual_seed(0)
        assert all(same(a, b, name in MAPS) for a, b in zip(results, augment(torch.stack(equal), **options)))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", NOISES)
def test_noise_of_a_list(name, dtype, device):
    """That of each image alone under its seed, and of a batch under one seed; parameters, masks and a replay have it, too."""
    augment, images = A.AugmentationSequential(*NOISES[name](), data_keys=["input"]), pictures(device, SMALL, dtype)
    seeds, rounding = seeds_of(images), (0, 1) if dtype == torch.uint8 else (2e-3, 2e-3)
    for given in (images, [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in images]):
        results = augment(given, seed=seeds)
        assert is_by_passes(augment)
        params = augment._params
        for b, x in enumerate(given):
            alone = augment(x[None], seed=seeds[b : b + 1])[0]
            if name == "waves" and alone.is_cuda:  # maps of different sizes are sums in another order than a batch's
                assert_close(results[b], alone, *rounding)
            else:
                assert same(results[b], alone)
        replayed = augment(given, params=params)
        for a, b in zip(results, replayed):
            assert_close(a, b, *rounding)
    equal = [x[:, :15, :16].contiguous() for x in images]
    for options in ({"seed": 3}, {}):
        torch.manual_seed(0)
        results, params = augment(equal, **options), augment._params
        torch.manual_seed(0)
        batch = augment(torch.stack(equal), **options)
        assert all(same(a, b) for a, b in zip(results, batch))
        for a, b in zip(augment(equal, params=params), batch):
            assert_close(a, b, *rounding)


def test_masks_of_erased_images_of_a_list(device):
    images = pictures(device, SMALL)
    masks = [torch.ones(1, *x.shape[1:], dtype=torch.uint8, device=device) for x in images]
    augment = A.AugmentationSequential(
        A.RandomErasing(p=0.7), A.RandomHorizontalFlip(), A.CoarseDropout(p=0.9), data_keys=["input", "mask"]
    )
    seeds = seeds_of(images)
    y, moved = augment(images, masks, seed=seeds)
    assert is_by_passes(augment)
    for b, x in enumerate(images):
        alone = augment(x[None], masks[b][None], seed=seeds[b : b + 1])
        assert torch.equal(y[b], alone[0][0]) and torch.equal(moved[b], alone[1][0])


@pytest.mark.parametrize("name", [name for name in PASSES_AND_NOISES if name != "photons"])  # counts have none
def test_gradients_of_passes_over_a_list(name, device):
    """Those of each image alone; one that appears twice adds up."""
    augment, images = (
        A.ImageSequential(*PASSES_AND_NOISES[name]()),
        [x.requires_grad_() for x in pictures(device, SMALL)],
    )
    images[2] = images[0]
    seeds = seeds_of(images)
    weights = [torch.rand_like(y) for y in augment(images, seed=seeds)]
    loss = sum((y * w).sum() for y, w in zip(augment(images, seed=seeds), weights))
    assert is_by_passes(augment)
    gradients = torch.autograd.grad(loss, [images[i] for i in (0, 1, 3)])
    alone = [augment(x[None], seed=seeds[b : b + 1])[0] for b, x in enumerate(images)]
    loss = sum((y * w).sum() for y, w in zip(alone, weights))
    for of_list, of_image in zip(gradients, torch.autograd.grad(loss, [images[i] for i in (0, 1, 3)])):
        assert_close(of_list, of_image, 1e-3, 1e-3)


def test_results_in_another_type(device):
    augment = A.ImageSequential(A.RandomHorizontalFlip(p=1.0), A.Normalize(0.5, 0.5), output_dtype=torch.float16)
    images = pictures(device, SMALL, torch.uint8)
    for x, y in zip(images, augment(images)):
        assert y.dtype == torch.float16 and torch.equal(y, augment(x[None])[0])
    assert not is_by_passes(A.ImageSequential(augment))


@pytest.mark.parametrize(
    "name",
    [
        "flips",
        "affine",
        "everything",
        "erasing",
        "factors",
        "factors of images",
        "factors of channels",
        "antialiased",
        "rain",
        "mud",
        "wide elastic",
        *BLURS,
        *MAPS,
    ],
)
def test_as_many_launches_as_a_batch(name):
    """With contrast two more where the planes of some images begin between vectors: no cluster of blocks keeps these."""
    if not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    augment = A.ImageSequential(*PASSES_AND_NOISES[name]())
    by_torch = 14 if name == "zoom" else 0  # more, for moves by the sides of each image, whatever their number
    for step, more in ((4, by_torch), (1, by_torch + 2 * (name == "everything"))):
        images = pictures("cuda", [(40 + i % 9, 52 + step * (i % 7)) for i in range(300)], torch.uint8)
        batch = torch.stack([x[:, :40, :52] for x in images])
        assert launches(partial(augment, images)) <= launches(partial(augment, batch)) + more


def test_plans_of_passes_do_not_depend_on_the_sizes(device):
    augment, counts = A.ImageSequential(*PASSES["everything"]()), set()
    for i in range(40):
        augment(pictures(device, [(40 + i, 50), (60, 70 - i)]))
        counts.add(len(augment._plans._plans))
    assert len(counts) == 1


def test_what_is_no_linear_function_of_the_size(device):
    class Odd(A.GeometricAugmentationBase2D):
        def transforms(self, shape, flags):
            return [A.Transform.affine((0.0, 0.0), translation=(shape[-1] % 3, 0.0))]

    augment, images = A.ImageSequential(Odd(p=1.0)), pictures(device, SMALL)
    results = augment(images)
    assert is_by_passes(augment)
    assert all(torch.equal(y, augment(x[None])[0]) for x, y in zip(images, results))


def test_square_images_of_a_list_are_turned_as_alone(device):
    """Which of the symmetries are drawn depends on whether an image is square."""
    images = pictures(device, SMALL)
    for augment in (A.D4(), A.ImageSequential(A.D4(), A.RandomInvert())):
        for i in range(8):
            seeds = torch.arange(len(images), device=device) + 4 * i
            for b, y in enumerate(augment(images, seed=seeds)):
                assert torch.equal(y, augment(images[b][None], seed=seeds[b : b + 1])[0])


@pytest.mark.tracing
@pytest.mark.parametrize("name", [name for name in PASSES_AND_NOISES if "units" not in name])  # as many graphs as grids
def test_compiles_twice_at_most_a_length(name, device):
    from torch._dynamo.testing import CompileCounter

    counter, augment = CompileCounter(), A.ImageSequential(*PASSES_AND_NOISES[name]())
    torch._dynamo.reset()
    compiled = torch.compile(lambda images: augment(images, seed=3), fullgraph=True, backend=counter)
    for sizes in (((20, 30), (41, 17), (15, 64)), ((16, 19), (21, 18), (25, 33)), ((18, 28), (51, 40), (16, 17))):
        images = pictures(device, sizes)
        assert all(same(a, b) for a, b in zip(compiled(images), augment(images, seed=3)))
    assert counter.frame_count <= 2


def test_labels_and_parameters_of_a_list_in_one_size(device):
    """A late crop makes the list a batch, with masks of each image, boxes, the inverse and a replay."""
    images = pictures(device, SMALL)
    masks = [(x[:1] > 0.5).to(torch.uint8) for x in images]
    boxes = [torch.tensor([[1.0, 2, 9, 12]], device=device) for _ in images]
    augment = A.AugmentationSequential(*PASSES["late crop"](), data_keys=["input", "mask", "bbox_xyxy"])
    seeds = seeds_of(images)
    y, moved, edges = augment(images, masks, boxes, seed=seeds)
    assert is_by_passes(augment) and y.shape == (4, 3, 12, 14)
    params, matrices = augment._params, augment.transform_matrix
    back = augment.inverse(y, data_keys=["input"])
    for b, x in enumerate(images):
        alone = augment(x[None], masks[b][None], [boxes[b]], seed=seeds[b : b + 1])
        assert torch.equal(y[b], alone[0][0]) and torch.equal(moved[b], alone[1][0])
        assert_close(edges[b], alone[2][0], 0, 0)
        assert torch.equal(matrices[b], augment.transform_matrix[0])
        assert torch.equal(back[b], augment.inverse(alone[0], data_keys=["input"])[0])
    assert torch.equal(augment(images, masks, boxes, params=params)[0], y)


def test_long_lists_are_those_of_their_parts(device):
    images = pictures(device, [(4 + i % 7, 5 + i % 3) for i in range(520)])
    augment, seeds = A.ImageSequential(*PASSES["everything"]()), torch.arange(520, device=device)
    results, last = augment(images, seed=seeds), augment(images[510:], seed=seeds[510:])
    assert all(torch.equal(a, b) for a, b in zip(results[510:], last))


def test_the_operator_promises_what_it_gives(device, backend, monkeypatch):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    for dtype in (torch.uint8, torch.float32):
        images = [x.permute(1, 2, 0).contiguous().permute(2, 0, 1) for x in pictures(device, SMALL, dtype)]
        for name in ("colors", "affine", "everything"):
            augment, calls = A.ImageSequential(*PASSES[name]()), []
            operator = passes.warp_and_color_to_list
            monkeypatch.setattr(DrawnListPass, "serves", lambda *args: False)
            for module in (passes, conversions):
                monkeypatch.setattr(module, "warp_and_color_to_list", lambda *a: (calls.append(a), operator(*a))[1])  # noqa: B023
            augment(images, seed=0)
            monkeypatch.undo()
            (args,) = calls
            kernel = torch.ops.kvision.warp_and_color_to_list.default
            torch.library.opcheck(kernel, args, test_utils="test_schema")
            with FakeTensorMode(allow_non_fake_inputs=True) as fake:  # that results share memory, it need not say
                promised = kernel([fake.from_tensor(x) for x in args[0]], *args[1:])
            for y, expected in zip(kernel(*args), promised, strict=True):
                assert (y.shape, y.stride(), y.dtype) == (expected.shape, expected.stride(), expected.dtype)


def test_a_cuda_graph_draws_again_for_a_list():
    if not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    images, augment = (
        pictures("cuda", SMALL),
        A.ImageSequential(A.RandomAffine(20.0, p=1.0), A.RandomBrightness((0.5, 1.5))),
    )
    augment(images)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        results = augment(images)
    replays = []
    for _ in range(2):
        graph.replay()
        replays.append([y.clone() for y in results])
    assert not any(torch.equal(a, b) for a, b in zip(*replays))
    with pytest.raises(RuntimeError, match="would repeat the draws"), torch.cuda.graph(torch.cuda.CUDAGraph()):
        Halved()(images)


def test_a_cuda_graph_keeps_the_numbers_of_a_list():
    """Its replays copy them from memory of the host that has no other owner by then."""
    if not torch.cuda.is_available():
        pytest.skip("needs a GPU")
    images = pictures("cuda", SMALL)
    units, affine, maps = (
        A.GridDropout(unit_size_range=(3, 9), p=1.0),
        A.RandomAffine(20.0, (0.2, 0.2), p=1.0),
        A.ZoomBlur(p=1.0),
    )
    affine(images, seed=3)
    params = affine._params
    calls = (lambda: units(images, seed=3), lambda: affine(images, params=params), lambda: maps(images, seed=3))
    for call in calls:
        expected, graph = call(), torch.cuda.CUDAGraph()
        try:
            with torch.cuda.graph(graph):
                results = call()
        except RuntimeError as error:
            pytest.skip(f"this torch cannot pin memory while it captures: {error}")
        others = [torch.full((n,), 7.0, dtype=torch.float64) for n in range(1, 300) for _ in range(20)]
        graph.replay()
        assert all(torch.equal(a, b) for a, b in zip(results, expected)) and others


def test_what_is_wrong_with_a_list_is_said_by_every_path(device):
    """Kernels that read the sizes themselves find it, and then each image is asked."""
    images = pictures(device, SMALL)
    wrong = {
        "one type": images[1].half(),
        "one number of channels": images[1][:2],
        r"of shape \(C, H, W\)": images[1][0],
    }
    fused = A.ImageSequential(A.RandomResizedCrop((8, 8)), A.RandomHorizontalFlip())
    for augment in (fused, A.ImageSequential(A.RandomHorizontalFlip()), A.Normalize(0.4, 0.3), A.RandomAffine(9.0)):
        for message, x in wrong.items():
            with pytest.raises((TypeError, ValueError), match=f"expected input.* {message}"):
                augment([images[0], x, *images[2:]])


def test_noise_behind_a_late_crop_is_that_of_each_image(device):
    augment, images = A.ImageSequential(*PASSES["late crop"](), A.RandomGaussianNoise(p=1.0)), pictures(device, SMALL)
    seeds = seeds_of(images)
    results, params = augment(images, seed=seeds), augment._params
    assert is_by_passes(augment)
    assert_close(augment(images, params=params), results, 1e-5, 1e-5)
    for b, x in enumerate(images):
        assert same(results[b], augment(x[None], seed=seeds[b : b + 1])[0])


@pytest.mark.parametrize("chain", ["flips", "late crop"])
def test_what_a_call_keeps_has_no_images(chain, device):
    """Labels are moved in the call; what is kept for parameters and the inverse is as large as these."""
    augment = A.AugmentationSequential(*PASSES[chain](), data_keys=["input", "bbox_xyxy"])
    images = pictures(device, SMALL)
    alive = [weakref.ref(x) for x in images]
    augment(images, [torch.tensor([[1.0, 2, 9, 12]], device=device) for _ in images])
    assert is_by_passes(augment)
    del images
    gc.collect()
    assert not any(x() is not None for x in alive)
