"""Lens distortion of points, and undistortion of images."""

from __future__ import annotations

import cv2
import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case
from kvision.geometry.calibration.distortion import _map, _map_gradient
from op_tests import assert_close, instruction_set
from point_op_tests import EYE, SINGLE_AND_DOUBLE, Call, PointOpTests, near
from view_tests import CAMERA, LENS, ViewTests, camera, points, rand

G = K.geometry
DOUBLE = torch.float64
IMAGE_CAMERA = torch.tensor([[[70.3, 0, 17.1], [0, 68.7, 25.9], [0, 0, 1]]], dtype=DOUBLE)
IMAGE_LENS = torch.tensor(
    [[0.11, -0.07, 0.013, 0.017, 0.05, 0.03, -0.02, 0.01, 0.007, -0.003, 0.004, 0.002, 0.03, -0.04]]
)


def lenses(count: int, batch: int = 2) -> list[Tensor | None]:
    """A camera matrix for each, coefficients for each, and the tilt of all 14 of them, one for all."""
    dist = IMAGE_LENS[:, :count].double() * (1 + 0.3 * torch.arange(batch)[:, None])
    tilt = G.tilt_projection(dist[:1, 12:13], dist[:1, 13:]) if count == 14 else None
    return [IMAGE_CAMERA + 0.1 * torch.arange(batch)[:, None, None], dist, tilt]


def on(device, lens, dtype=DOUBLE):
    return [None if x is None else x.to(dtype).to(device) for x in lens]


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE], ids=str)
@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_values_and_gradients(count, dtype, device):
    lens = on(device, lenses(count), dtype)
    for size in ([1, 1], [7, 33], [90, 61]):  # the last one has two parts of sums
        grad = torch.rand(2, 2, *size, device=device, dtype=DOUBLE) - 0.5
        with K.backend("reference"):
            wide = on(device, lens)
            expected, gradients = _map(*wide, size), _map_gradient(grad, *wide)
        assert_close(_map(*lens, size), expected.to(dtype), 1e-6, 1e-4 if dtype == torch.float32 else 1e-11)
        result = _map_gradient(grad.to(dtype), *lens)
        for a, e in zip(result, gradients, strict=True):
            near = (2e-4 if dtype == torch.float32 else 1e-10) * (1 + float(e.abs().max())) if e.numel() else 0.0
            assert_close(a, e.to(dtype), 0, near)


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_instruction_sets(isa, device, backend):
    if backend == "reference" or device.type != "cpu":
        pytest.skip("this test is about the CPU's kernels")
    with instruction_set(isa):
        test_values_and_gradients(14, torch.float32, device)


@pytest.mark.derivatives
@pytest.mark.parametrize("count", [5, 14])
def test_derivatives(count, device):
    lens = on(device, lenses(count))
    leaves = [x.requires_grad_() for x in lens if x is not None]

    def of_lens(camera: Tensor, dist: Tensor, tilt: Tensor | None = None) -> Tensor:
        return _map(camera, dist, tilt, [3, 4])

    assert torch.autograd.gradcheck(of_lens, leaves, fast_mode=True, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(of_lens, leaves, fast_mode=True)


def test_pixels_without_a_gradient_add_nothing(device, backend):
    """Also where the lens is not defined: the divisor of the radial part is 0 at r^2 = 1, the pixel in the corner."""
    if backend == "reference":
        pytest.skip("torch multiplies them by what is infinite there")
    camera = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]], device=device)
    dist = torch.tensor([[0.1, 0, 0, 0, 0, -0.5, 0, 0]], device=device)
    grad = torch.zeros(1, 2, 2, 2, device=device)
    grad[..., 0, 1] = 1
    assert not _map(camera, dist, None, [2, 2])[..., 1, 1].isfinite().any()
    assert all(g.isfinite().all() for g in _map_gradient(grad, camera, dist, None))


@pytest.mark.parametrize("count", [4, 14])
def test_undistorted_images_and_their_gradients(count, device):
    image = torch.rand(2, 3, 13, 15, dtype=DOUBLE, device=device).requires_grad_()
    camera, dist, _ = on(device, lenses(count))
    leaves = [image, camera.requires_grad_(), dist.requires_grad_()]
    result = G.undistort_image(*leaves)
    with K.backend("reference"):
        expected = G.undistort_image(*leaves)
    assert_close(result, expected)
    weight = torch.rand_like(result)
    for ours, theirs in zip(*(torch.autograd.grad((y * weight).sum(), leaves) for y in (result, expected))):
        assert_close(ours, theirs, 1e-8, 1e-8)
    one = G.undistort_image(image[:1], camera[0], dist[0])
    assert_close(one, result[:1])


def test_undistortion_is_a_map_and_a_sampling(device, backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    image, lens = torch.rand(2, 3, 9, 8, device=device), on(device, lenses(5), torch.float32)[:2]
    with torch.profiler.profile() as profile:
        G.undistort_image(image, *lens)
    names = [e.key for e in profile.key_averages() if e.key.startswith("kvision::")]
    assert sorted(names) == ["kvision::remap", "kvision::undistort_map"]


@pytest.mark.tracing
def test_compiled(device):
    image, lens = torch.rand(2, 3, 9, 8, device=device), on(device, lenses(14), torch.float32)[:2]
    compiled = torch.compile(G.undistort_image, fullgraph=True, backend="aot_eager")
    assert_close(compiled(image, *lens), G.undistort_image(image, *lens))


QUADS = torch.tensor([[0.0, 0], [40, 3], [42, 41], [1, 44], [20, 9], [33, 27]]).double()


class TestDistortion(ViewTests):
    cases = {
        "distorted": Case(
            lambda x, d: G.distort_points(points(x, QUADS), camera(x), 0.1 * d), ((2, 6, 2), (2, 14))
        ),
        "undistorted": Case(
            lambda x, d: G.undistort_points(points(x, QUADS), camera(x), 0.03 * d), ((2, 6, 2), (2, 14))
        ),
    }  # fmt: skip
    compiled = ()


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_opencv_distortion(count):
    points, lens = QUADS.numpy(), LENS[:count].numpy()
    plane = (QUADS - CAMERA[:2, 2]) / CAMERA.diagonal()[:2]
    in_space = torch.cat([plane, torch.ones(6, 1).double()], -1).numpy()
    zero = torch.zeros(3).double().numpy()
    expected = torch.from_numpy(cv2.projectPoints(in_space, zero, zero, CAMERA.numpy(), lens)[0][:, 0])
    assert_close(G.distort_points(QUADS, CAMERA, LENS[:count]), expected, 1e-9, 1e-9)
    steps = (cv2.TERM_CRITERIA_COUNT, 60, 0)
    expected = cv2.undistortPoints(points[:, None], CAMERA.numpy(), lens, P=CAMERA.numpy(), criteria=steps)[:, 0]
    assert_close(G.undistort_points(QUADS, CAMERA, LENS[:count], num_iters=60), torch.from_numpy(expected), 1e-9, 1e-9)


@pytest.mark.parametrize("count", [5, 14])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_undistortion_broadcasts(count, dtype, device):
    """One lens for several sets of points, and several for one; with the kernel as with the reference."""
    many = rand(3, 37, 2, high=90).to(device, dtype)
    camera, lens = CAMERA.to(device, dtype), LENS[:count].to(device, dtype)
    lenses = lens * torch.tensor([[1.0], [0.5], [0.1]], device=device, dtype=dtype)
    for seen, K_, dist in ((many, camera, lens), (many[0], camera, lenses), (many, camera.expand(3, 3, 3), lenses)):
        result = G.undistort_points(seen, K_, dist, 2 * camera)
        with K.backend("reference"):
            assert_close(result, G.undistort_points(seen, K_, dist, 2 * camera), 1e-5, 1e-4)
        differentiated = G.undistort_points(seen.clone().requires_grad_(), K_, dist, 2 * camera)
        assert_close(result, differentiated.detach(), 1e-5, 1e-4)
    assert G.undistort_points(many[:, :0], camera, lens).shape == (3, 0, 2)
    assert G.undistort_points(many[:0], camera, lens).shape == (0, 37, 2)


def test_distortion_and_back(device):
    lens = LENS.to(device) * torch.cat([torch.ones(12), torch.ones(2) * 0.1]).to(device)
    moved = G.distort_points(QUADS.to(device), CAMERA.to(device), lens)
    assert_close(G.undistort_points(moved, CAMERA.to(device), lens, num_iters=60), QUADS.to(device), 1e-7, 1e-7)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.distort_points(P, M, torch.rand(2, 6)), ValueError, r"distort_points: expected dist of shape \(\*, n\) with n one"),
    (lambda: G.undistort_points(P, M, torch.rand(2, 4), num_iters=-1), ValueError, "undistort_points: expected num_iters"),
    (lambda: G.undistort_image(torch.rand(2, 1, 4, 4), M[:1], torch.rand(2, 4)), ValueError, "undistort_image: expected image, K"),
    (lambda: G.tilt_projection(torch.rand(2), torch.rand(3)), ValueError, "tilt_projection: expected tensors of one shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


ROWS = near(QUADS), near(CAMERA), near(CAMERA), lambda: 0.1 * LENS + 0.01 * torch.rand(14), near(EYE, 0.01)


class TestDistortionOperators(PointOpTests):
    calls = {
        "distort_points": [
            Call(ROWS, broadcasts=False, accepted=("points cut",), dtypes=SINGLE_AND_DOUBLE, tolerance=20),
            Call(
                (*ROWS[:3], lambda: LENS[:5] * torch.rand(5), None),
                broadcasts=False,
                accepted=("points cut",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=20,
            ),
        ],
        "undistort_points": [
            Call(
                ROWS,
                (5,),
                broadcasts=False,
                accepted=("points cut",),
                differentiable=False,
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=20,
            )
        ],
        "undistort_map": [Call((near(IMAGE_CAMERA[0]), *ROWS[3:]), ([5, 6],), dtypes=SINGLE_AND_DOUBLE, tolerance=50)],
    }


def test_bytes_are_undistorted_as_opencv_does(device):
    image = torch.randint(0, 256, (1, 3, 30, 40), dtype=torch.uint8, device=device)
    K_, dist = torch.tensor([[30.0, 0, 20], [0, 30, 15], [0, 0, 1]]), torch.tensor([0.1, -0.05, 0.01, 0.0])
    result = G.undistort_image(image, K_.to(device), dist.to(device))
    exact = G.undistort_image(image.double(), K_.to(device), dist.to(device))
    assert result.dtype == torch.uint8 and (result - exact).abs().max() <= 0.53  # the CPU samples bytes in fixed point
    # Not cv2.undistort, whose maps are rounded to 1/32 pixel.
    camera, coefficients = K_.double().numpy(), dist.double().numpy()
    maps = cv2.initUndistortRectifyMap(camera, coefficients, None, camera, (40, 30), cv2.CV_32FC1)
    expected = torch.from_numpy(cv2.remap(image[0].permute(1, 2, 0).cpu().numpy(), *maps, cv2.INTER_LINEAR))
    assert (result.cpu()[0].int() - expected.permute(2, 0, 1)).abs().max() <= 1
