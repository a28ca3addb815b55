"""Replays of lists of images with given parameters: each call by its own numbers."""

import pytest
import torch

from augmentation.container.test_list_launches import Calls, Launches
from augmentation.test_lists import pictures
from kvision import augmentation as A


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
