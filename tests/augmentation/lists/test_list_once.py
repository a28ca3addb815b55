"""Lists of images that `resample="once"` reads by one antialiased warp or composed map: as alone, by the launches of a batch."""

import pytest
import torch

from augmentation.container.test_list_launches import calls
from augmentation.test_lists import assert_as_alone, pictures, seeds_of
from kvision import augmentation as A
from kvision._backend import current_backend

SIZES = ((16, 20), (24, 31), (16, 20), (27, 27), (40, 18))


def shrink(**options):
    return A.RandomAffine(20.0, scale=(0.4, 0.7), antialias=True, **options)


CHAINS = {
    "list": lambda: (shrink(p=0.7), A.RandomPerspective(0.4, p=1.0), A.RandomHorizontalFlip()),
    "batch": lambda: (shrink(), A.RandomPerspective(0.4, antialias=True), A.RandomResizedCrop((9, 11))),
    "first a batch": lambda: (A.RandomResizedCrop((14, 12), antialias=True), A.RandomRotation(20.0), A.CenterCrop(9)),
    "other sizes": lambda: (shrink(), A.SmallestMaxSize(11, antialias=True), A.Transpose(p=1.0), A.Pad(1)),
    "colors around": lambda: (A.RandomInvert(), shrink(), A.RandomRotation(9.0, p=1.0), A.Normalize(0.4, 0.3)),
    "map": lambda: (A.RandomAffine(20.0), A.OpticalDistortion(p=0.7), A.RandomHorizontalFlip(), A.Normalize(0.4, 0.3)),
    "maps": lambda: (
        A.RandomElasticTransform((5, 5), (2.0, 2.0), p=0.7),
        A.RandomRotation(20.0),
        A.RandomThinPlateSpline(0.1),
    ),
    "map and sizes": lambda: (
        A.RandomThinPlateSpline(0.1),
        A.SmallestMaxSize(11, antialias=False),
        A.Transpose(p=1.0),
        A.Pad(1),
        A.OpticalDistortion(p=0.7),
    ),
    "map and a batch": lambda: (A.GridDistortion(), A.RandomResizedCrop((9, 11)), A.OpticalDistortion(p=0.7)),
    "map of a batch": lambda: (
        A.CenterCrop((14, 12)),
        A.RandomElasticTransform((5, 5), (2.0, 2.0)),
        A.ColorJitter(0.2),
    ),
    "maps inside": lambda: (
        A.RandomAffine(20.0),
        A.ImageSequential(A.RandomRotation(9.0), A.OpticalDistortion(p=0.7), A.RandomHorizontalFlip()),
        A.OneOf(A.RandomThinPlateSpline(0.1), A.RandomPerspective(0.4), A.RandomAffine(20.0)),
    ),
    "two": lambda: (shrink(), A.RandomRotation(9.0), A.RandomGaussianNoise(), A.RandomRotation(9.0), shrink(p=0.7)),
}
MAPS = [name for name in CHAINS if "map" in name]  # whose points and boxes differ by rounding
chains = pytest.mark.parametrize("name", CHAINS)


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@chains
def test_each_image_is_warped_as_by_itself(name, dtype, device):
    augment, images = A.ImageSequential(*CHAINS[name](), resample="once"), pictures(device, SIZES, dtype)
    assert_as_alone(augment, images)
    assert isinstance(augment(images), list) == ("batch" not in name)


@chains
def test_labels_follow_the_warp(name, device):
    augment = A.AugmentationSequential(
        *CHAINS[name](), data_keys=["input", "mask", "bbox_xyxy", "keypoints"], resample="once"
    )
    images = pictures(device, SIZES)
    labels = [
        [(255 * x[:1]).to(torch.uint8) for x in images],
        [torch.tensor([[2.0, 3.0, 12.0, 14.0]], device=x.device) for x in images],
        [torch.tensor([[5.0, 6.0], [9.0, 2.0]], device=x.device) for x in images],
    ]
    seeds = seeds_of(images)
    moved = augment(images, *labels, seed=seeds)
    again = augment(images, *labels, params=augment._params)
    for b, x in enumerate(images):
        alone = augment(x[None], *[own[b][None] for own in labels], seed=seeds[b : b + 1])
        for i, own in enumerate(alone):
            tolerance = 1e-3 if name in MAPS and i > 1 else 2e-5 if current_backend() == "reference" and i == 0 else 0
            for mine in (moved[i][b], again[i][b]):
                torch.testing.assert_close(mine, own[0], rtol=0, atol=tolerance)


@chains
def test_gradients_reach_each_image(name, device):
    augment = A.ImageSequential(*CHAINS[name](), resample="once")
    images, seeds = [x.requires_grad_() for x in pictures(device, SIZES)], torch.arange(len(SIZES))
    gradients = torch.autograd.grad(sum(y.square().sum() for y in augment(images, seed=seeds)), images)
    for b, x in enumerate(images):
        alone = augment(x[None], seed=seeds[b : b + 1]).square().sum()
        torch.testing.assert_close(gradients[b], torch.autograd.grad(alone, x)[0], atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("name", [name for name in CHAINS if "inside" not in name])  # choices
def test_calls_do_not_depend_on_the_number_of_images(name, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    augment, counts = A.ImageSequential(*CHAINS[name](), resample="once"), []
    for number in (3, 9):
        images = pictures("cpu", [(24 + i, 45 - i) for i in range(number)])
        counts.append(calls(augment, images, seed=seeds_of(images)))
    assert counts[0] == counts[1] <= 9


@pytest.mark.tracing
@pytest.mark.parametrize("name", ["list", "batch", "other sizes", "map", "map and sizes"])
def test_lists_that_are_warped_once_have_graphs(name, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    from torch._dynamo.testing import CompileCounter

    augment, counter = A.ImageSequential(*CHAINS[name](), resample="once"), CompileCounter()
    torch._dynamo.reset()
    compiled = torch.compile(lambda images: augment(images, seed=3), fullgraph=True, backend=counter)
    for sizes in (((20, 30), (41, 17)), ((16, 19), (21, 18)), ((18, 28), (51, 40))):
        images = pictures(device, sizes)
        for a, b in zip(compiled(images), augment(images, seed=3), strict=True):
            torch.testing.assert_close(a, b)
    assert counter.frame_count <= 2
