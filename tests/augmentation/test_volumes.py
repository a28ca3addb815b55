"""Tests of every augmentation of volumes: those of test_contract.py, geometry by formula, and the results of Kornia."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from typing import Any

import pytest
import torch
from torch import Tensor

import kvision.augmentation as A
from benchmarks.sample_calls.augmentations import FLIPS3D, GEOMETRIC3D, IMAGES, VOLUMES, Augmentation
from kvision.augmentation.engine import AugmentationBase3D
from kvision.geometry.linalg import transform_points
from op_tests import does_not_wait

SIZE = (6, 7, 8)
cases = pytest.mark.parametrize("case", VOLUMES, ids=lambda case: case.name)
geometric = pytest.mark.parametrize("case", GEOMETRIC3D, ids=lambda case: case.name)
OURS = ("RandomResizedCrop3D", "Resize3D")  # which Kornia has not


def volumes(device: Any = "cpu", batch: int = 5, dtype: torch.dtype = torch.float32) -> Tensor:
    x = torch.rand(batch, 2, *SIZE, generator=torch.Generator().manual_seed(batch))
    return ((255 * x).to(dtype) if dtype == torch.uint8 else x.to(dtype)).to(device)


def test_all_classes_have_a_case() -> None:
    classes = {
        name
        for name, value in vars(A).items()
        if inspect.isclass(value) and issubclass(value, AugmentationBase3D) and not name.endswith("Base3D")
    }
    assert classes == {case.name for case in VOLUMES}


# --- the contract of all augmentations ------------------------------------------------------------------------------


@cases
def test_replay_is_exact(case: Augmentation, device: torch.device) -> None:
    x, augment = volumes(device), case.make(p=0.7)
    first = augment(x)
    params = augment._params
    assert torch.equal(case.make(p=0.7)(x, params=params), first)
    augment(x.flip(0))
    assert torch.equal(augment(x, params=params), first)


@cases
def test_seeds_and_generators_reproduce(case: Augmentation, device: torch.device) -> None:
    x, augment = volumes(device), case.make()
    torch.manual_seed(5)
    first = augment(x)
    torch.manual_seed(5)
    assert torch.equal(augment(x), first)
    own = torch.Generator().manual_seed(5)
    assert torch.equal(augment(x, generator=own), first)
    assert torch.equal(case.make(generator=torch.Generator().manual_seed(5))(x), first)
    assert torch.equal(augment(x, seed=7), augment(x, seed=7))


@cases
def test_seeds_of_samples_are_independent_of_the_batch(case: Augmentation, device: torch.device) -> None:
    if case.one_kernel:
        pytest.skip("samples share a size, which is that of the first")
    x, augment = volumes(device), case.make(**({} if case.changes_size else {"p": 0.7}))
    seeds, order = torch.arange(5) * 1000, torch.tensor([4, 1, 3])
    all_of_them = augment(x, seed=seeds)
    assert torch.equal(augment(x[order], seed=seeds[order]), all_of_them[order])


@geometric
def test_no_call_waits_for_the_device(case: Augmentation, device: torch.device) -> None:
    x, augment = volumes(device), case.make(**({} if case.changes_size else {"p": 0.7}))
    does_not_wait(device, [lambda: augment(x), lambda: augment(x, seed=1)])


@cases
def test_samples_not_chosen_are_unchanged(case: Augmentation, device: torch.device) -> None:
    x = volumes(device, batch=32) * 3 - 1  # out of [0, 1] as well
    assert torch.equal(case.make(p=0.0)(x), x)
    augment = case.make(p=0.5)
    y, batches = augment(x), 0
    if case.changes_size:  # all samples are cropped, or none
        for seed in range(20):
            batches += augment(x[:1], seed=seed).shape[2:] != x.shape[2:]
        assert 2 < batches < 18
        return
    chosen = augment._params["batch_prob"] > 0.5
    assert 2 < chosen.sum() < 30
    assert torch.equal(y[~chosen], x[~chosen])
    assert torch.equal(augment.transform_matrix.cpu()[~chosen], torch.eye(4).expand(int((~chosen).sum()), 4, 4))
    if case.name != "RandomEqualize3D":  # which leaves a channel of too few voxels within [0, 1]
        assert all((y[i] != x[i]).any() for i in chosen.nonzero().flatten())


@cases
def test_same_on_batch(case: Augmentation) -> None:
    if case.fixed:
        pytest.skip("draws nothing")
    x = volumes()[:1].expand(4, -1, -1, -1, -1)
    y = case.make(p=1.0, same_on_batch=True)(x)
    assert torch.equal(y, y[:1].expand_as(y))
    y = case.make(p=1.0)(x)
    assert not torch.equal(y, y[:1].expand_as(y))


@cases
@pytest.mark.parametrize("batch", [0, 1])
def test_small_batches(case: Augmentation, batch: int, device: torch.device) -> None:
    augment = case.make(p=1.0)
    assert augment(volumes(device, batch)).shape[:2] == (batch, 2)
    assert augment.transform_matrix.shape == (batch, 4, 4)


@cases
def test_ranks(case: Augmentation) -> None:
    x = volumes()[0]
    assert case.make(p=1.0)(x).dim() == 5
    assert case.make(p=1.0, keepdim=True)(x).dim() == 4
    assert case.make(p=1.0, keepdim=True)(x[0]).dim() == 3


@cases
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64, torch.uint8], ids=str)
def test_types(case: Augmentation, dtype: torch.dtype, device: torch.device) -> None:
    x, augment = volumes(device, dtype=dtype), case.make(p=1.0)
    y = augment(x, seed=3)
    assert y.dtype == dtype
    expected = augment(x.float() / (255 if dtype == torch.uint8 else 1), seed=3)
    scale, tolerance = {torch.uint8: (255.0, 1.01), torch.float64: (1.0, 1e-4)}.get(dtype, (1.0, 0.03))
    if case.gradient:  # others jump
        assert (y.double() - scale * expected.double()).abs().max() <= tolerance


@cases
def test_inputs_are_not_modified_and_may_be_strided(case: Augmentation) -> None:
    x = volumes()
    before = x.clone()
    expected = case.make(p=0.7)(x, seed=3)
    assert torch.equal(x, before)
    last = x.to(memory_format=torch.channels_last_3d)
    torch.testing.assert_close(case.make(p=0.7)(last, seed=3), expected, rtol=1e-5, atol=1e-5)


@cases
def test_pickles_and_copies(case: Augmentation) -> None:
    x, augment = volumes(), case.make()
    augment(x)
    for other in (pickle.loads(pickle.dumps(augment)), copy.deepcopy(augment)):
        assert torch.equal(other(x, seed=1), augment(x, seed=1))


@cases
def test_gradient_of_volumes(case: Augmentation) -> None:
    if not case.gradient:
        pytest.skip("jumps")
    augment = case.make(p=1.0)
    x = torch.rand(2, 1, 4, 5, 5, generator=torch.Generator().manual_seed(1)).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: augment(x, seed=2), x, eps=1e-6, atol=1e-4)


def test_ranges_get_gradients() -> None:
    degrees = torch.nn.Parameter(torch.tensor([-20.0, 20.0]))
    augment = A.RandomRotation3D(degrees, p=1.0)
    augment(volumes(), seed=2).square().sum().backward()
    assert degrees.grad is not None and (degrees.grad != 0).all()


@cases
def test_wrong_inputs(case: Augmentation) -> None:
    augment = case.make()
    with pytest.raises(TypeError, match=f"{case.name}: expected input to be .*, got a list of 1"):
        augment([1.0])
    with pytest.raises(TypeError, match=f"{case.name}: .*int64"):
        augment(torch.zeros(1, 3, 8, 8, 8, dtype=torch.int64))
    with pytest.raises(ValueError, match=f"{case.name}: expected input of shape"):
        augment(torch.zeros(8, 8))
    with pytest.raises(ValueError, match=f"{case.name}: expected p"):
        case.make(p=1.1)


@pytest.mark.parametrize(
    "make, error",
    [
        (lambda: A.RandomAffine3D((1.0, 2.0, 3.0, 4.0)), "RandomAffine3D: expected degrees"),
        (lambda: A.RandomAffine3D(1.0, translate=(0.1, 0.1)), "RandomAffine3D: expected translate"),
        (lambda: A.RandomAffine3D(1.0, scale=(-1.0, 1.0)), "RandomAffine3D: expected scale"),
        (lambda: A.RandomRotation3D(40.0, resample="bicubic"), "RandomRotation3D: expected resample"),
        (lambda: A.RandomPerspective3D(1.5), "RandomPerspective3D: expected distortion_scale"),
        (lambda: A.RandomCrop3D((2, 3)), "RandomCrop3D: expected size"),
        (lambda: A.RandomCrop3D((2, 3, 4), padding=(1, 2)), "RandomCrop3D: expected padding"),
        (lambda: A.RandomCrop3D((9, 9, 9))(volumes()), "RandomCrop3D: expected volumes of at least"),
        (lambda: A.CenterCrop3D((0, 1, 1)), "CenterCrop3D: expected size"),
        (lambda: A.RandomMotionBlur3D(4, 0.0, 0.0), "RandomMotionBlur3D: expected kernel_size"),
    ],
)
def test_wrong_arguments(make: Any, error: str) -> None:
    with pytest.raises((TypeError, ValueError), match=error):
        make()


@cases
def test_return_transform(case: Augmentation) -> None:
    x = volumes()
    _, matrix = case.make(p=1.0)(x, return_transform=True)
    assert matrix.shape == (5, 4, 4)
    before = torch.eye(4).expand(5, 4, 4).clone()
    before[:, 0, 3] = 3
    augment = case.make(p=1.0, return_transform=True)
    _, product = augment((x, before))
    torch.testing.assert_close(product, augment.transform_matrix @ before)


# --- geometry -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case, axis", list(zip(FLIPS3D, (-1, -2, -3))), ids=lambda v: getattr(v, "name", ""))
def test_flips_are_exact(case: Augmentation, axis: int, device: torch.device) -> None:
    x, augment = volumes(device), case.make(p=1.0)
    assert torch.equal(augment(x), x.flip(axis))
    assert torch.equal(augment.inverse(augment(x)), x)


@pytest.mark.parametrize("mode, torch_mode", [("constant",) * 2, ("replicate",) * 2, ("reflect",) * 2])
@pytest.mark.parametrize("fill", [0.0, 0.25])
def test_crops_are_exact(mode: str, torch_mode: str, fill: float, device: torch.device) -> None:
    x, padding = volumes(device), (1, 2, 3, 0, 2, 1)
    crop = A.RandomCrop3D((4, 5, 6), padding, fill=fill, padding_mode=mode)
    y = crop(x)
    value = {"value": fill} if mode == "constant" else {}
    padded = torch.nn.functional.pad(x, padding, mode=torch_mode, **value)
    for i, (left, top, front) in enumerate(crop._params["src"][:, 0].long().tolist()):
        expected = padded[i, :, front : front + 4, top : top + 5, left : left + 6]
        assert torch.equal(y[i], expected)
    assert torch.equal(crop.transform_matrix[:, :3, 3].cpu(), torch.tensor([1.0, 3, 2]) - crop._params["src"][:, 0])


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("mode", ["nearest", "bilinear"])
def test_resized_boxes_are_those_of_interpolate(mode: str, align_corners: bool, device: torch.device) -> None:
    x, size = volumes(device).double(), (16, 8, 16)  # no position in the middle of two voxels, of boxes either
    crop, resize = (
        make(size, resample=mode, align_corners=align_corners) for make in (A.RandomResizedCrop3D, A.Resize3D)
    )
    y = crop(x, seed=1)
    torch_mode = {"nearest": "nearest-exact", "bilinear": "trilinear"}[mode]
    options = {"align_corners": align_corners} if mode == "bilinear" else {}
    if mode == "bilinear" or not align_corners:  # nearest-exact reads between edges
        torch.testing.assert_close(resize(x), torch.nn.functional.interpolate(x, size, mode=torch_mode, **options))
    src = crop._params["src"].long()
    sides = src[:, 6] - src[:, 0] + 1
    for i, ((left, top, front), (w, h, d)) in enumerate(zip(src[:, 0].tolist(), sides.tolist())):
        box = x[i : i + 1, :, front : front + d, top : top + h, left : left + w]
        # What is next to a box is read between its edges, and resized boxes end there.
        inner = (..., *[slice(2, -2)] * 3) if not align_corners else ...
        torch.testing.assert_close(y[i : i + 1][inner], resize(box)[inner])


def test_boxes_have_the_volume_and_the_aspect_that_are_asked_for() -> None:
    crop = A.RandomResizedCrop3D(4, (0.2, 0.4), (0.5, 2.0))
    whole = torch.tensor([200.0, 100.0, 50.0])
    params = crop.forward_parameters((2000, 1, 50, 100, 200))
    src = params["src"]
    fractions = (src[:, 6] - src[:, 0] + 1) / whole
    assert (src >= 0).all() and (src[:, 6] <= whole - 1).all()
    kept = (fractions < 1).all(1)  # sides end at those of the volume
    scale, (w, h, d) = fractions.prod(1)[kept], fractions[kept].unbind(1)
    assert 0.19 < scale.min() < 0.21 and 0.39 < scale.max() < 0.41 and abs(scale.mean() - 0.3) < 0.01
    for ratio in (w / h, d / (w * h).sqrt()):
        assert 0.48 < ratio.min() < 0.54 and 1.85 < ratio.max() < 2.1 and abs(ratio.log().mean()) < 0.03


@geometric
def test_what_enters_volumes_is_the_fill_value(case: Augmentation, device: torch.device) -> None:
    """-1000 in images of computed tomography and 255 in masks; where nothing enters no bit changes."""
    x = volumes(device) * 2000 - 1000
    if case.name == "CenterCrop3D":
        case = dataclasses.replace(case, args=((7, 9, 9),))
    fill = {"fill": -1000.0} if case.name == "RandomCrop3D" else {"fill_value": -1000.0}
    enters = fill.keys() & inspect.signature(getattr(A, case.name)).parameters.keys()
    plain, filled = (case.make(p=1.0, **kwargs) for kwargs in ({}, fill if enters else {}))
    keys = ["input", "mask"]
    extra_args = {"mask": {"resample": "nearest", "fill_value": 255}}
    mask = torch.ones_like(x[:, :1], dtype=torch.uint8)
    y, masks = A.AugmentationSequential(filled, data_keys=keys, extra_args=extra_args)(x, mask, seed=1)
    zeros, known = A.AugmentationSequential(plain, data_keys=keys)(x, mask, seed=1)
    assert set(masks.unique().tolist()) == ({1, 255} if enters else {1})
    assert torch.equal(masks == 1, known == 1)
    inside = A.AugmentationSequential(plain)(torch.ones_like(x), seed=1)
    whole, outside = inside > 1 - 1e-6, inside == 0
    assert torch.equal(y[whole], zeros[whole]) and (y[outside] == -1000).all() and bool(outside.any()) == bool(enters)
    torch.testing.assert_close(y, zeros - 1000 * (1 - inside), rtol=0, atol=2e-3)
    if enters:  # another value of each channel, and of bytes in [0, 1]
        channels = case.make(p=1.0, **{name: (0.2, 1.0) for name in fill})
        values = torch.tensor([0.2, 1.0], device=device)[:, None, None, None]
        far = outside[:, :1].expand_as(y)
        assert torch.equal(channels(x, seed=1)[far], values.expand_as(y)[far])
        assert torch.equal(channels((x > 0).byte(), seed=1)[far], (255 * values).byte().expand_as(y)[far])


def test_crops_pad_small_volumes() -> None:
    x = torch.ones(2, 1, 2, 9, 9)
    y = A.RandomCrop3D((4, 5, 5), pad_if_needed=True)(x)
    assert y.shape == (2, 1, 4, 5, 5)
    assert ((y.sum(2) >= 0) & (y.sum(2) <= 2)).all()
    y = A.CenterCrop3D((4, 5, 5))(x)
    assert torch.equal(y[:, :, 1:3], torch.ones(2, 1, 2, 5, 5)) and y.sum() == 100


def test_center_crops() -> None:
    x = volumes()
    crop = A.CenterCrop3D((4, 5, 5))
    assert torch.equal(crop(x), x[:, :, 1:5, 1:6, 1:6])
    corners = A.random_generator.center_crop_generator3d(5, *SIZE, (4, 5, 5))
    assert torch.equal(corners["src"], crop._params["src"])


@geometric
def test_voxels_follow_the_matrix(case: Augmentation) -> None:
    """A linear volume has the value of its source at the position of each voxel of the result."""
    z, y, x = torch.meshgrid(*(torch.arange(float(n)) for n in SIZE), indexing="ij")
    ramp = (x + 10 * y + 100 * z).expand(4, 1, *SIZE)
    augment = case.make(p=1.0)
    result, inside = augment(ramp, seed=6), augment(torch.ones_like(ramp), seed=6) > 0.999
    sizes = result.shape[2:]
    z, y, x = torch.meshgrid(*(torch.arange(float(n)) for n in sizes), indexing="ij")
    points = torch.stack([x, y, z], -1).reshape(1, -1, 3).expand(4, -1, -1)
    source = transform_points(torch.linalg.inv(augment.transform_matrix), points)
    expected = (source @ torch.tensor([1.0, 10.0, 100.0])).reshape(4, 1, *sizes)
    assert inside.sum() > 100
    torch.testing.assert_close(result[inside], expected[inside], rtol=1e-4, atol=1e-2)


@geometric
def test_points_and_masks_follow(case: Augmentation, device: torch.device) -> None:
    x, augment = volumes(device), case.make(p=0.7)
    y = augment(x)
    execution, matrix = augment._execution, augment.transform_matrix
    points = torch.rand(5, 9, 3, device=device) * 5
    torch.testing.assert_close(augment.transform_points(points, execution), transform_points(matrix, points))
    torch.testing.assert_close(augment.transform_masks(x, execution, augment.flags), y)
    if not case.warps:
        labels = (x[:, :1] * 9).long()
        moved = augment.transform_masks(labels, execution, augment.flags)
        assert moved.dtype == torch.int64
        assert torch.equal(moved, augment.transform_masks(labels.float(), execution, augment.flags).long())


@geometric
def test_inverse_undoes(case: Augmentation, device: torch.device) -> None:
    # Of a smooth volume, in the middle that no transform loses.
    axes = torch.meshgrid(*(torch.linspace(-1, 1, n, device=device) for n in (24, 26, 28)), indexing="ij")
    x = torch.exp(-4 * sum(a * a for a in axes)).expand(3, 1, -1, -1, -1)
    sizes = {
        "RandomCrop3D": ((22, 24, 26),),
        "CenterCrop3D": ((22, 24, 26),),
        "RandomPerspective3D": (0.2,),
        "RandomResizedCrop3D": ((40, 42, 44), (0.9, 1.0), (0.9, 1.1)),
        "Resize3D": ((40, 42, 44),),
    }
    augment = getattr(A, case.name)(*sizes.get(case.name, case.args), **case.kwargs, p=1.0)
    y = augment(x)
    params = augment._params
    back = augment.inverse(y)
    assert back.shape == x.shape
    inner = (..., slice(8, 16), slice(9, 17), slice(10, 18))
    torch.testing.assert_close(back[inner], x[inner], rtol=0, atol=0.05 if case.warps else 0.0)
    augment(x)
    torch.testing.assert_close(augment.inverse(y, params=params), back)


def test_axes_of_one_voxel() -> None:
    for size in ((1, 6, 7), (5, 1, 7), (5, 6, 1), (1, 6, 1)):
        x = torch.rand(3, 1, *size)
        augment = A.RandomPerspective3D(0.4, p=1.0)
        y = augment(x)
        assert y.isfinite().all() and (y != 0).any()


@pytest.mark.tracing
@pytest.mark.parametrize("case", [VOLUMES[0], VOLUMES[5], FLIPS3D[0], VOLUMES[11]], ids=lambda case: case.name)
def test_compiles(case: Augmentation) -> None:
    kwargs = {"p": 0.7}
    augment = A.RandomMotionBlur3D(3, 20.0, 0.5, **kwargs) if case.one_kernel else case.make(**kwargs)
    x = volumes()
    compiled = torch.compile(lambda x: augment(x, seed=4), fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(x), augment(x, seed=4))


# --- Kornia ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", [c for c in VOLUMES if c.name not in OURS], ids=lambda case: case.name)
def test_the_parameters_of_kornia_give_its_volumes(case: Augmentation) -> None:
    theirs_of = pytest.importorskip("kornia.augmentation")
    # Kornia's warps leave their matrix where align_corners is False (docs/differences.md).
    kwargs = {**case.kwargs, **({"align_corners": True} if case.warps else {})}
    args = case.args[:3]  # its shears move the center: below
    theirs = getattr(theirs_of, case.name)(*args, **kwargs)
    x = volumes()
    expected = theirs(x)
    ours = getattr(A, case.name)(*args, **kwargs)
    torch.testing.assert_close(ours(x, params=dict(theirs._params)), expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(ours.transform_matrix, theirs.transform_matrix.float(), rtol=1e-4, atol=1e-4)
    assert set(ours._params) == set(theirs._params)


def test_shears_are_those_of_kornia_about_the_center() -> None:
    theirs_of = pytest.importorskip("kornia.augmentation")
    theirs, ours = (m.RandomAffine3D(0.0, shears=(5.0, 6.0, 7.0, 8.0, 9.0, 10.0), p=1.0) for m in (theirs_of, A))
    theirs(volumes()), ours(volumes(), params=dict(theirs._params))
    matrix = ours.transform_matrix
    torch.testing.assert_close(matrix[:, :3, :3], theirs.transform_matrix[:, :3, :3], rtol=1e-4, atol=1e-5)
    center = ours._params["center"][:, None]
    torch.testing.assert_close(transform_points(matrix, center), center)


@pytest.mark.parametrize("case", [c for c in VOLUMES if not c.fixed and c.name not in OURS], ids=lambda case: case.name)
def test_parameters_have_the_shapes_of_kornia(case: Augmentation) -> None:
    theirs_of = pytest.importorskip("kornia.augmentation")
    x = volumes()
    theirs, ours = getattr(theirs_of, case.name)(*case.args, **case.kwargs, p=1.0), case.make(p=1.0)
    theirs(x), ours(x)
    assert {n: (v.shape, v.dtype) for n, v in ours._params.items()} == {
        n: (v.shape, v.dtype) for n, v in theirs._params.items()
    }


def test_draws_after_a_crop_use_its_shape() -> None:
    volumes = torch.rand(4, 1, 12, 12, 12) + 1
    crops = A.ImageSequential(A.RandomCrop3D((6, 6, 6), p=1.0), A.RandomCrop3D((3, 3, 3), p=1.0))
    assert (crops(volumes, seed=1) > 0).all()  # no voxel from outside of the first crop
    assert crops.forward_parameters(volumes.shape)[1].data["forward_input_shape"].tolist() == [4, 1, 6, 6, 6]
    assert torch.equal(crops(volumes, params=crops._params), crops(volumes, seed=1))
    moved = A.ImageSequential(A.CenterCrop3D(6), A.RandomAffine3D(0.0, translate=(0.5, 0.5, 0.5), p=1.0))
    moved(volumes)
    assert moved._params[1].data["translations"].abs().max() <= 3


def test_masks_and_points_of_volumes_in_containers() -> None:
    """The middles of a blob, of its mask and its point agree, and come back."""
    center = torch.tensor([[17.0, 20.0, 22.0], [21.0, 18.0, 19.0]])
    z, y, x = torch.meshgrid(*[torch.arange(40.0)] * 3, indexing="ij")
    squares = sum((a - center[:, i, None, None, None]) ** 2 for i, a in enumerate((x, y, z)))
    volumes_, masks = torch.exp(-squares / 18)[:, None], (squares < 25)[:, None].long()
    augment = A.AugmentationSequential(
        A.RandomAffine3D((15.0, 15.0, 15.0), translate=(0.05, 0.05, 0.05), p=1.0),
        A.RandomHorizontalFlip3D(),
        A.RandomDepthicalFlip3D(),
        A.CenterCrop3D((36, 37, 38)),
        data_keys=["image", "mask", "keypoints"],
    )
    moved, moved_masks, points = augment(volumes_, masks, center[:, None])
    assert moved.shape == (2, 1, 36, 37, 38) == moved_masks.shape and moved_masks.dtype == torch.int64
    z, y, x = torch.meshgrid(*(torch.arange(float(n)) for n in moved.shape[2:]), indexing="ij")
    for values, tolerance in ((moved, 0.1), (moved_masks.float(), 0.6)):
        weights = values / values.sum((2, 3, 4), keepdim=True)
        middle = torch.stack([(weights * a).sum((1, 2, 3, 4)) for a in (x, y, z)], -1)
        torch.testing.assert_close(middle, points[:, 0], rtol=0, atol=tolerance)
    assert augment.visible_points[0].all()
    back, masks_back, points_back = augment.inverse(moved, moved_masks, points)
    assert back.shape == volumes_.shape and masks_back.shape == masks.shape
    torch.testing.assert_close(points_back, center[:, None], rtol=0, atol=1e-3)
    without_channel = augment(volumes_, masks[:, 0], center[:, None])[1]
    assert without_channel.shape == (2, 36, 37, 38)
    with pytest.raises(ValueError, match=r"expected mask of shape \(B, C, D, H, W\)"):
        augment(volumes_, masks[0, 0, 0], center[:, None])
    with pytest.raises(ValueError, match=r"expected keypoints of shape \(B, N, 3\)"):
        augment(volumes_, masks, center[:, None, :2])
    with pytest.raises(NotImplementedError, match="boxes of volumes"):
        augment(volumes_, torch.zeros(2, 1, 4), data_keys=["image", "bbox_xyxy"])


TAKE_VOLUMES = """ColorJiggle ColorJitter Denormalize Normalize RandomAutoContrast RandomBrightness RandomChannelDropout
RandomChannelShuffle RandomClahe RandomContrast RandomEqualize RandomGamma RandomGrayscale RandomHue RandomInvert
RandomPosterize RandomRGBShift RandomSaturation RandomSharpness RandomSnow RandomSolarize""".split()


@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case.name)
def test_augmentations_of_images_in_containers_of_volumes(case: Any, device: torch.device) -> None:
    x = torch.rand(2, 3, 4, 8, 9, device=device) * torch.linspace(0.5, 1, 4, device=device)[:, None, None]
    augment = case.make(**({} if case.changes_size and not case.all_or_none else {"p": 1.0}))
    container = A.AugmentationSequential(A.RandomHorizontalFlip3D(p=0.0), augment, data_keys=["input", "mask"])
    mask = x[:, :1].round()
    if case.name not in TAKE_VOLUMES:
        with pytest.raises(
            ValueError, match=rf"^{case.name}: expected images of shape \(B, C, H, W\), got \(2, 3, 4, 8"
        ):
            container(x, mask)
        return
    y, moved = container(x, mask, seed=1)
    assert torch.equal(moved, mask)
    again = container(x, mask, params=container._params)[0]
    torch.testing.assert_close(again, y)
    slices = [x[:, :, d] for d in range(4)]
    if case.name == "ColorJitter":  # contrast is about the mean of all slices
        slices, x = [x.flatten(2, 3)], x.flatten(2, 3)[:, :, None]
    params = container._params[1].data
    expected = torch.stack([augment(s, params={**params, "forward_input_shape": s.shape}) for s in slices], 2)
    torch.testing.assert_close(y, expected.reshape(y.shape), rtol=1e-5, atol=1e-6)


def test_policies_in_containers_of_volumes() -> None:
    container = A.ImageSequential(A.RandomHorizontalFlip3D(), A.auto.RandAugment(2, 9))
    with pytest.raises(
        ValueError, match=r"RandAugment: expected images of shape \(B, C, H, W\), got \(2, 3, 4, 8, 8\)"
    ):
        container(torch.rand(2, 3, 4, 8, 8))
