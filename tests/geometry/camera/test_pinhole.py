"""Pinhole cameras."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)
LAST = (2, 5, 1)


def camera(intrinsics: Tensor, extrinsics: Tensor) -> G.PinholeCamera:
    size = torch.ones_like(intrinsics[:, 0, 0])
    return G.PinholeCamera(intrinsics, extrinsics, size, size)


class TestPinhole(CompositionTests):
    cases = {
        "PinholeCamera.project": Case(lambda p, k, e: camera(k, e).project(p), (P3, POSE, POSE)),
        "PinholeCamera.unproject": Case(lambda p, d, k, e: camera(k, e).unproject(p, d), (P2, LAST, POSE, POSE)),
    }
    compiled = ("PinholeCamera.project",)


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


def cameras(device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    intrinsics, extrinsics = torch.eye(4).repeat(2, 1, 1), torch.eye(4).repeat(2, 1, 1)
    intrinsics[:, :2, :3] = torch.tensor([[[100.0, 0.3, 30], [0, 110, 20]], [[90.0, 0, 31], [0, 95, 22]]])
    extrinsics[:, :3, :3] = G.axis_angle_to_rotation_matrix(torch.tensor([[0.1, 0.2, -0.3], [0.0, 0, 1]]))
    extrinsics[:, :3, 3] = torch.tensor([[0.1, 0.2, 4], [1.0, 0, 5]])
    sizes = torch.tensor([48.0, 40]), torch.tensor([64.0, 60])
    return tuple(x.double().to(device) for x in (intrinsics, extrinsics, *sizes))


def test_cameras_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry
    ours, his = G.PinholeCamera(*cameras(device)), theirs.PinholeCamera(*cameras("cpu"))
    points, depth = rand(2, 7, 3), rand(2, 7, 1)
    assert_close(ours.project(points.to(device)).cpu(), his.project(points))
    assert_close(
        ours.unproject(points[..., :2].to(device), depth.to(device)).cpu(), his.unproject(points[..., :2], depth)
    )
    for name in (
        *("intrinsics", "extrinsics", "fx", "fy", "cx", "cy", "tx", "ty", "tz", "rt_matrix", "camera_matrix"),
        *("rotation_matrix", "translation_vector", "height", "width"),
    ):
        assert_close(getattr(ours, name).cpu(), getattr(his, name))
    assert_close(ours.intrinsics_inverse().cpu(), his.intrinsics_inverse())
    assert ours.batch_size == 2
    assert ours.device().type == device.type
    numbers = (1.0, 2.0, 3.0, 4.0, 5, 6, 7.0, 8.0, 9.0, 2)
    made = G.PinholeCamera.from_parameters(*numbers, device, torch.float32)
    expected = theirs.PinholeCamera.from_parameters(*numbers, torch.device("cpu"), torch.float32)
    for name in ("intrinsics", "extrinsics", "height", "width"):
        assert_close(getattr(made, name).cpu(), getattr(expected, name))


def test_round_trip(device):
    points, depth = rand(2, 7, 2).to(device), rand(2, 7, 1).to(device)
    look = G.PinholeCamera(*cameras(device))
    assert_close(look.project(look.unproject(points, depth)), points, 1e-9, 1e-9)
    matrix = look.camera_matrix * torch.tensor([[1.0, 0, 1], [1, 1, 1], [1, 1, 1]], device=device)
    assert_close(G.project_points(G.unproject_points(points, depth, matrix), matrix), points, 1e-9, 1e-9)
    ray = G.unproject_points(points, depth, matrix, normalize=True)
    assert_close(ray.norm(dim=-1, keepdim=True), depth)
    for name, sizes in (("pixel_coordinates", (5, 1)), ("pixel_coordinates3d", (2, 5, 1))):
        x = rand(4, len(sizes)).to(device)
        assert_close(getattr(G, f"denormalize_{name}")(getattr(G, f"normalize_{name}")(x, *sizes), *sizes), x)
    H = rand(2, 3, 3).to(device)
    normalized = G.normalize_homography(H, (5, 1), (3, 4), False)
    assert_close(G.denormalize_homography(normalized, (5, 1), (3, 4), False), H, 1e-9, 1e-9)


def test_cameras_own_their_tensors(device):
    tensors = cameras(device)
    before = [t.clone() for t in tensors]
    look = G.PinholeCamera(*tensors)
    other = look.scale(torch.tensor([2.0, 3], device=device))
    look.tx, look.ty, look.tz = 1.0, 2.0, torch.ones(2, device=device)
    look.scale_(0.5)
    assert_close(list(tensors), before)
    assert_close(other.fx, before[0][:, 0, 0] * torch.tensor([2.0, 3], device=device).double())
    assert_close(look.cx, before[0][:, 0, 2] / 2)
    assert_close(look.width, before[3] / 2)
    assert_close(look.translation_vector[1].flatten(), torch.tensor([1.0, 2, 1], dtype=torch.float64, device=device))
    assert_close(look.clone().rotation_matrix, before[1][:, :3, :3])


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.PinholeCamera(EYE[None], EYE[None], torch.ones(1), torch.ones(1)), ValueError, r"intrinsics of shape \(B, 4, 4\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")[:2], torch.ones(1), torch.ones(1)), ValueError, r"height of shape \(2,\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")).project(torch.ones(3, 5, 3)), ValueError, r"point_3d of shape \(2, \*, 3\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")).unproject(ONES[..., :2], EYE), ValueError, "unproject: expected depth"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
