"""Perspective projection of points."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)
LAST = (2, 5, 1)


class TestPerspective(CompositionTests):
    cases = {
        "project_points": Case(G.project_points, (P3, MATRIX)),
        "unproject_points": Case(lambda p, d, k: G.unproject_points(p, d, k, True), (P2, LAST, MATRIX)),
    }
    compiled = ("unproject_points",)


GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


CALLS = [
    *(("project_points", (rand(2, 5, 3), rand(*s, 3, 3))) for s in ((), (1,), (2,), (2, 1))),
    *(("unproject_points", (rand(2, 5, 2), rand(2, 5, 1), rand(2, 3, 3), n)) for n in (True, False)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    result = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (result, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


def cameras(device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    intrinsics, extrinsics = torch.eye(4).repeat(2, 1, 1), torch.eye(4).repeat(2, 1, 1)
    intrinsics[:, :2, :3] = torch.tensor([[[100.0, 0.3, 30], [0, 110, 20]], [[90.0, 0, 31], [0, 95, 22]]])
    extrinsics[:, :3, :3] = G.axis_angle_to_rotation_matrix(torch.tensor([[0.1, 0.2, -0.3], [0.0, 0, 1]]))
    extrinsics[:, :3, 3] = torch.tensor([[0.1, 0.2, 4], [1.0, 0, 5]])
    sizes = torch.tensor([48.0, 40]), torch.tensor([64.0, 60])
    return tuple(x.double().to(device) for x in (intrinsics, extrinsics, *sizes))


def test_projection_equals_opencv(device):
    cv2 = pytest.importorskip("cv2")
    intrinsics, extrinsics, *_ = cameras("cpu")
    points = rand(2, 50, 3)
    points[..., 2] += 1
    moved = G.transform_points(extrinsics.to(device), points.to(device))
    result = G.project_points(moved, intrinsics[:, :3, :3].to(device))
    for i in range(2):
        turn, move = extrinsics[i, :3, :3].numpy(), extrinsics[i, :3, 3].numpy()
        expected, _ = cv2.projectPoints(points[i].numpy(), turn, move, intrinsics[i, :3, :3].numpy(), None)
        assert_close(result[i].cpu(), torch.from_numpy(expected[:, 0]), 1e-12, 1e-10)


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.project_points(ONES, torch.ones(3, 3, 3)), ValueError, "project_points: expected leading axes that broadcast"),
    (lambda: G.project_points(ONES[..., :2], EYE), ValueError, r"project_points: expected point_3d of shape \(\*, 3\)"),
    (lambda: G.unproject_points(ONES[..., :2], ONES, EYE), ValueError, r"unproject_points: expected depth of shape \(\*, 1\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
