"""Replays of lists of images with given parameters: each call by its own numbers."""

import pytest
import torch

from augmentation.container.test_list_launches import Calls, Launches
from augmentation.test_lists import pictures, seeds_of
from benchmarks.sample_calls.augmentations import IMAGES
from kvision import augmentation as A
from kvision.core.exceptions import ShapeError


class _Shares(A.random_generator.RandomGeneratorBase):
    """A shift along x: the column is a share of the width, the parameter counts pixels."""

    fields = (("pixels", 0),)

    def draws(self, shape):
        return [A.draws.uniform(0.1, 0.5)]

    def to_params(self, columns, shape):
        return {"pixels": columns[:, 0] * shape[-1]}

    def to_columns(self, params, shape):
        return params["pixels"][:, None] / shape[-1]


class _Move(A.GeometricAugmentationBase2D):
    def __init__(self, **options):
        super().__init__(**options)
        self._param_generator = _Shares()
        self.flags = {"resample": "bilinear", "padding_mode": "border"}

    def transforms(self, shape, flags):
        return [A.Transform.affine((0.0, 0.0), translation=("pixels", 0.0))]


def test_columns_that_depend_on_sizes_are_replayed_after_those_that_do_not(device):
    """A shift of 0 is one of all sizes; which columns others have has to be asked again."""
    images, move, alone = pictures(device), _Move(p=1.0), _Move(p=1.0)
    move(images)
    params = move._params
    still = {**params, "pixels": torch.zeros_like(params["pixels"])}
    for given in (still, params, still):
        replayed = move(images, params=given)
        for b, x in enumerate(images):
            own = {"pixels": given["pixels"][b : b + 1]}
            assert torch.allclose(replayed[b], alone(x[None], params=own)[0], atol=1e-6)


def test_windows_without_their_padding_are_replayed_by_the_sizes_of_images(device):
    """Images smaller than the window are padded, each as it needs."""
    images, crop = pictures(device, [(12, 30), (40, 14), (30, 31)]), A.RandomCrop((20, 20), pad_if_needed=True)
    crop(images)
    params = {name: x for name, x in crop._params.items() if name in ("src", "dst")}
    replayed = crop(images, params=params)
    for b, x in enumerate(images):
        own = {name: value[b : b + 1] for name, value in params.items()}
        assert torch.equal(replayed[b], crop(x[None], params=own)[0])


def test_samples_that_are_not_chosen_are_replayed_in_one_launch(device, backend):
    """Their corners stay, which are others in each size."""
    images, warp = pictures(device), A.RandomPerspective(p=0.5)
    results = warp(images, seed=torch.arange(len(images), device=device))
    assert 0 < warp._params["batch_prob"].sum() < len(images)
    with Calls() as counted:
        replayed = warp(images, params=warp._params)
    assert backend == "reference" or counted.count == 1
    assert all(torch.equal(a, b) for a, b in zip(replayed, results))


def on(device, params):
    """Parameters that lie on a device."""
    if isinstance(params, list):
        return [item._replace(data=on(device, item.data)) for item in params]
    moved = {name: x.to(device) for name, x in params.items() if isinstance(x, torch.Tensor)}
    return {**params, **moved}


@pytest.mark.parametrize("resample", ["each", "once"])
def test_parameters_on_the_device_are_replayed_in_as_many_launches(resample, device, backend):
    augment = A.ImageSequential(
        A.RandomPerspective(p=0.5),
        A.RandomAffine(20.0, (0.1, 0.1), p=0.7),
        A.OpticalDistortion(p=0.7),
        A.RandomErasing(p=0.7),
        A.RandomCrop((20, 20), p=0.5, pad_if_needed=True),
        resample=resample,
    )
    counts = []
    for number in (6, 20):
        images = pictures(device, [(20 + i, 50 - i) for i in range(number)])
        results = augment(images, seed=seeds_of(images))
        params = on(device, augment._params)
        replayed = augment(images, params=params)  # makes plans
        with Calls() as counted:
            augment(images, params=params)
        counts.append(counted.count)
        for a, b in zip(replayed, results, strict=True):
            torch.testing.assert_close(a, b, rtol=0, atol=1e-4)
    assert backend == "reference" or counts[0] == counts[1]


def test_replays_leave_the_generator_of_torch_alone(device):
    images, warp = pictures(device), A.RandomPerspective(p=0.5)
    warp(images)
    state = torch.get_rng_state()
    warp(images, params=warp._params)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("noise", [A.RandomGaussianNoise, A.RandomSaltAndPepperNoise])
def test_noise_is_replayed_as_in_each_image_alone(noise, dtype, device):
    images, augment, alone = pictures(device, dtype=dtype), noise(p=1.0), noise(p=1.0)
    augment(images)
    params = {**augment._params, "batch_prob": torch.tensor([1.0, 0.0, 1.0, 1.0])}
    replayed = augment(images, params=params)
    for b, x in enumerate(images):
        own = {name: value[b] if isinstance(value, list) else value[b : b + 1] for name, value in params.items()}
        del own["forward_input_shape"]
        expected = alone(x[None], params=own)[0]
        assert replayed[b].dtype == expected.dtype and torch.equal(replayed[b], expected)


def test_objects_are_dropped_again(device):
    images = pictures(device)
    masks = [(torch.rand(n, *x.shape[1:], device=device) < 0.5).byte() for n, x in zip((1, 0, 3, 1), images)]
    augment = A.AugmentationSequential(
        A.MaskDropout((1, 3), p=1.0), A.RandomVerticalFlip(), data_keys=["image", "mask"]
    )
    results = augment(images, masks)
    for before, after in zip(results, augment(images, masks, params=augment._params)):
        assert all(map(torch.equal, before, after))
    drop = A.MaskDropout((1, 3), p=1.0)
    drop(images, masks=masks)
    params = {**drop._params, "batch_prob": torch.tensor([1.0, 1.0, 0.0, 1.0])}
    replayed = drop(images, params=params)
    assert not torch.equal(replayed[0], images[0]) and torch.equal(replayed[2], images[2])


@pytest.mark.parametrize(
    "augmentation",
    [A.RandomZoomOut, A.RandomGaussianNoise, A.RandomSaltAndPepperNoise],
    ids=lambda augmentation: augmentation.__name__,
)
def test_replays_of_many_sizes_take_as_many_launches_as_of_few(augmentation, device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    counts = []
    for number in (5, 20):
        images = pictures(device, [(20 + i, 50 - i) for i in range(number)])
        augment = A.ImageSequential(augmentation(p=0.5), A.RandomHorizontalFlip())
        results = augment(images, seed=torch.arange(number, device=device))
        params = augment._params
        augment(images, params=params)  # makes plans
        with Launches() as counted:
            replayed = augment(images, params=params)
        counts.append(counted.count)
        assert all(torch.allclose(a, b, atol=1e-5) for a, b in zip(replayed, results))
    assert counts[1] == counts[0]


def _frost(**options):
    return A.RandomFrost(torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)), **options)


def _corruption(name):
    texture = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)) if name == "frost" else None
    return lambda p: A.CommonCorruption(name, 2, texture, p=p)


REPLAYED = {case.name: lambda p, case=case: case.make(p=p) for case in IMAGES}
REPLAYED |= {f"corruption {name}": _corruption(name) for name in A.CommonCorruption.NAMES}
REPLAYED |= {
    "RandomFrost": lambda p: _frost(p=p),
    "elastic by sides": lambda p: A.RandomElasticTransform((13, 13), (4.0, 4.0), scale_window=True, p=p),
    "elastic by a tensor": lambda p: A.RandomElasticTransform((5, 5), torch.tensor([[2.0, 3.0]]), p=p),
    "wide elastic": lambda p: A.RandomElasticTransform((71, 71), (4.0, 4.0), p=p),
    "pixels of colors": lambda p: A.PixelDropout(0.3, drop_value=(0.1, 0.2, 0.3), p=p),
    "pixels of noise": lambda p: A.PixelDropout(0.3, True, "random", p=p),
    "factors of pixels": lambda p: A.MultiplicativeNoise(elementwise=True, p=p),
    "factors of channels": lambda p: A.MultiplicativeNoise(per_channel=True, p=p),
    "erased by noise": lambda p: A.RandomErasing(value="random", p=p),
    "holes of noise": lambda p: A.CoarseDropout(fill="random", p=p),
    "units of noise": lambda p: A.GridDropout(0.4, unit_size_range=(4, 9), fill="random", p=p),
    "lines of noise": lambda p: A.GridMask(fill="random", p=p),
    "mud": lambda p: A.Spatter(mode="mud", p=p),
    "motion of sizes": lambda p: A.RandomMotionBlur((3, 9), 20.0, 0.5, p=p),
    "affine in pieces": lambda p: A.PiecewiseAffine(nb_rows_range=(2, 5), nb_cols_range=(3, 4), p=p),
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.uint8], ids=str)
@pytest.mark.parametrize("name", REPLAYED)
def test_replays_are_those_of_each_image_in_the_launches_of_a_batch(name, dtype, device, backend):
    images = pictures(device, [(26 + i, 40 - i) for i in range(10)], dtype)
    augment = REPLAYED[name](0.5)
    augment = REPLAYED[name](1.0) if augment.whole_batch else augment  # which a chance would give some images
    counts = []
    for number in (8, 10):
        some = images[:number]
        results = augment(some, seed=seeds_of(some))
        params = augment._params
        augment(some, params=params)  # makes plans
        with Launches() as counted:
            replayed = augment(some, params=params)
        counts.append(counted.count)
        exact = device == "cpu" and backend != "reference"
        assert all(
            torch.equal(a, b) if exact else torch.allclose(a, b, atol=1e-4 if dtype.is_floating_point else 1)
            for a, b in zip(replayed, results)
        )
    is_drawn_by_size = "otion" in name  # one launch for each size of windows
    assert backend == "reference" or is_drawn_by_size or counts[0] == counts[1]


def test_gradients_pass_through_replays(device):
    images = [x.requires_grad_() for x in pictures(device, [(26 + i, 40 - i) for i in range(4)])]
    for name in (
        "ShotNoise",
        "ISONoise",
        "GlassBlur",
        "SpeckleNoise",
        "RandomFog",
        "pixels of noise",
        "elastic by a tensor",
    ):
        augment, alone = REPLAYED[name](1.0), REPLAYED[name](1.0)
        augment(images, seed=seeds_of(images))
        params = augment._params
        results = augment(images, params=params)
        if not results[0].requires_grad:
            continue
        grads = torch.autograd.grad(sum(y.square().sum() for y in results), images)
        for b, x in enumerate(images):
            own = {key: value[b] if isinstance(value, list) else value[b : b + 1] for key, value in params.items()}
            del own["forward_input_shape"]
            expected = torch.autograd.grad(alone(x[None], params=own).square().sum(), x)[0]
            assert torch.allclose(grads[b], expected, atol=1e-4), name


@pytest.mark.parametrize(
    "name", ["RandomGaussianNoise", "RandomFog", "GlassBlur", "elastic by sides", "holes of noise"]
)
def test_maps_of_pixels_are_not_replayed_on_other_sizes(name, device):
    images = pictures(device, [(26 + i, 40 - i) for i in range(3)])
    larger = [torch.nn.functional.pad(x, (0, 1, 0, 2)) for x in images]
    for batch, other in ((images, larger), (torch.stack(images[:1]), torch.stack(larger[:1]))):
        augment = REPLAYED[name](1.0)
        augment(batch)
        with pytest.raises(ShapeError, match=f"{type(augment).__name__}: expected params of images of size"):
            augment(other, params=augment._params)
        augment = A.ImageSequential(A.RandomVerticalFlip(), augment)
        augment(batch)
        with pytest.raises(ShapeError, match="expected params of images of size"):
            augment(other, params=augment._params)


OF_CHANNELS = {
    "RandomGaussianNoise",
    "RandomSaltAndPepperNoise",
    "RandomPlasmaBrightness",
    "RandomLinearIllumination",
    "RandomChannelShuffle",
    "RandomChannelDropout",
    "SpeckleNoise",
    "ShotNoise",
}


@pytest.mark.filterwarnings("ignore:.*this call has no")
@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_parameters_replay_on_other_channels_or_are_refused_by_name(case, device):
    """Those of maps of two planes, which move pixels, on images of two channels, too."""
    images = pictures(device, [(26 + i, 40 - i) for i in range(3)])
    for before, after in ((3, 4), (3, 1), (1, 3), (2, 3)):
        old, new = ([x[[0, 1, 2, 0][:channels]] for x in images] for channels in (before, after))
        for is_list in (False, True):
            first, second = (x if is_list else torch.stack([y[:, :20, :20] for y in x]) for x in (old, new))
            augment = case.make(p=1.0)
            try:
                augment(first)
                augment(second)
            except ValueError:
                continue  # other numbers of channels are refused anyway
            augment(first)
            try:
                results = augment(second, params=augment._params)
                assert results[0].shape[0] == after
            except ShapeError as error:
                assert f"{case.name}: expected params of images of {after} channels" in str(error)
                assert before > 1 or case.name == "RandomChannelShuffle" or case.name == "RandomChannelDropout"
            else:
                assert before == 1 or case.name not in OF_CHANNELS
