"""Poses between named frames."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
Q = G.Quaternion


class TestPose(CompositionTests):
    cases = {
        "pose": Case(lambda R, t, p: pose(R, t).inverse().transform_points(p), ((2, 3, 3), (2, 3), (2, 5, 3))),
    }
    compiled = ()


def pose(R: Tensor, t: Tensor) -> G.NamedPose:
    named_pose = G.NamedPose.from_rt(R, t, "a", "b")
    return G.NamedPose.from_rt(R, t, "b", "c") * named_pose


def rand(*shape: int, seed: int = 5) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3


def test_poses(device):
    R = G.axis_angle_to_rotation_matrix(rand(2, 3)).to(device)
    t, p = rand(2, 3, seed=8).to(device), rand(2, 5, 3, seed=9).to(device)
    first = G.NamedPose.from_rt(R, t, "robot", "map")
    assert_close(first.transform_points(p), p @ R.mT + t[:, None])
    assert_close(first.inverse().transform_points(first.transform_points(p)), p, 0, 1e-12)
    assert (first.inverse().frame_src, first.inverse().frame_dst) == ("map", "robot")
    assert_close(G.NamedPose.from_rt(Q.from_matrix(R), t).pose, first.pose, 0, 1e-12)
    assert_close((first.rotation, first.translation), (R, t))
    both = first * G.NamedPose.from_matrix(first.pose, "camera", "robot")
    assert_close(both.transform_points(p), first.transform_points(first.transform_points(p)), 0, 1e-12)
    assert "camera" in repr(both)
    plane = G.NamedPose.from_rt(torch.eye(2), torch.ones(2))
    assert plane.frame_src != plane.frame_dst
    with pytest.raises(ValueError, match="expected a pose that leads to 'robot', got one that leads to 'map'"):
        first * first
    with pytest.raises(TypeError, match="NamedPose: expected a NamedPose to follow"):
        first * R
    with pytest.raises(ValueError, match="poses of one dimension"):
        first * G.NamedPose(torch.eye(3), "x", "robot")


BAD = [
    (lambda: G.NamedPose(torch.eye(2)), ValueError, "NamedPose: expected dst_from_src of shape"),
    (lambda: G.NamedPose.from_rt(torch.eye(3), torch.ones(2)), ValueError, r"expected translation of shape \(3,\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("group", [G.liegroup.Se2, G.liegroup.Se3])
def test_poses_of_lie_groups(group, device):
    """The pose stays an element of the group, and moves points as its matrix does; gradients reach its parameters."""
    n = 2 if group is G.liegroup.Se2 else 3
    first, second = (group.exp(rand(4, 3 * n - 3, seed=seed).to(device)) for seed in (1, 2))
    p = rand(4, 5, n, seed=3).to(device)
    named_pose = G.NamedPose(first, "robot", "map") * G.NamedPose(second, "camera", "robot")
    matrices = G.NamedPose(first.matrix(), "robot", "map") * G.NamedPose(second.matrix(), "camera", "robot")
    assert isinstance(named_pose.pose, group) and (named_pose.frame_src, named_pose.frame_dst) == ("camera", "map")
    assert_close(
        (named_pose.matrix(), named_pose.transform_points(p)), (matrices.pose, matrices.transform_points(p)), 0, 1e-12
    )
    assert isinstance(named_pose.inverse().pose, group) and type(named_pose.rotation) is type(first.rotation)
    assert_close(named_pose.inverse().matrix(), matrices.inverse().pose, 0, 1e-12)
    assert_close(named_pose.translation, matrices.translation, 0, 1e-12)
    mixed = G.NamedPose(first, "robot", "map") * G.NamedPose(second.matrix(), "camera", "robot")
    assert_close(mixed.pose, matrices.pose, 0, 1e-12)
    made = G.NamedPose.from_rt(first.rotation, first.translation)
    assert isinstance(made.pose, group)
    (grad,) = torch.autograd.grad(named_pose.transform_points(p).sum(), [first.t])
    assert grad.isfinite().all() and grad.abs().sum() > 0
