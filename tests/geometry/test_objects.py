"""Vectors, lines, planes, quaternions, poses and point clouds."""

import itertools
import math

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from torch import Tensor, nn

import kvision as K
from composition_tests import Case, CompositionTests
from kvision.geometry.pointcloud import (
    load_pointcloud_ply,
    load_pointcloud_ply_binary,
    save_pointcloud_ply,
    save_pointcloud_ply_binary,
)
from kvision.geometry.quaternion import average_quaternions
from kvision.geometry.vector import Scalar, Vector2, Vector3
from op_tests import assert_close

G = K.geometry
Q = G.Quaternion


def line(origin: Tensor, direction: Tensor) -> G.ParametrizedLine:
    return G.ParametrizedLine.through(origin, origin + direction)


class TestObjects(CompositionTests):
    cases = {
        "vector": Case(lambda v, w: (Vector3(v).normalized() + w).dot(Vector3(v)).data, ((2, 5, 3), (2, 5, 3))),
        "line": Case(lambda o, d, p: line(o, d).distance(p), ((2, 5, 3),) * 3),
        "projection": Case(lambda o, d, p: line(o, d).projection(p), ((2, 5, 2),) * 3),
        "fit_line": Case(lambda p, w: G.fit_line(p, w).direction, ((2, 9, 3), (2, 9))),
        "plane": Case(lambda a, b, c, p: G.Hyperplane.through(a, b, c).projection(p).data, ((2, 5, 3),) * 4),
        "fit_plane": Case(lambda p: G.fit_plane(p).signed_distance(p.new_ones(3)).data, ((2, 9, 3),)),
        "intersect": Case(lambda o, d, n: line(o, d).intersect(G.Hyperplane.from_vector(n, o))[1], ((2, 5, 3),) * 3),
        "product": Case(lambda p, q: (Q(p) * Q(q) / Q(p) + 2 * Q(q).inv() - 1).data, ((2, 5, 4),) * 2),
        "slerp": Case(lambda p, q: Q(p).slerp(Q(q), 0.3).data, ((2, 5, 4),) * 2),
        "power": Case(lambda p, t: (Q(p) ** t).data, ((2, 5, 4), (2, 5))),
        "pose": Case(lambda R, t, p: pose(R, t).inverse().transform_points(p), ((2, 3, 3), (2, 3), (2, 5, 3))),
    }
    compiled = ("vector", "slerp")


def pose(R: Tensor, t: Tensor) -> G.NamedPose:
    there = G.NamedPose.from_rt(R, t, "a", "b")
    return G.NamedPose.from_rt(R, t, "b", "c") * there


def rand(*shape: int, seed: int = 5) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) - 0.3


# --- vectors --------------------------------------------------------------------------------------------------------


def test_vectors(device):
    v = Vector3(torch.tensor([[1.0, 2, 2], [0, 0, 0]], device=device))
    assert_close([v.x, v.y, v.z], list(v.data.unbind(-1)))
    assert_close(v.normalized().data, v.data / 3)
    assert isinstance(v + 1, Vector3)
    assert isinstance(v.sum(), Tensor)
    assert isinstance(v.dot(v), Scalar)
    assert_close(v.squared_norm().data, v.dot(v).data)
    assert Vector2.random((4,), device=device, dtype=torch.float64).shape == (4, 2)
    assert Vector3.random(device=device).shape == (3,)
    assert_close(
        Vector2.from_coords(torch.ones(3, device=device), torch.zeros(3, device=device)).x, torch.ones(3, device=device)
    )
    zero = torch.zeros(3, device=device, requires_grad=True)
    (grad,) = torch.autograd.grad(Vector3(zero).normalized().data.sum(), zero)
    assert grad.isfinite().all()


# --- lines and planes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", [2, 3, 5])
@pytest.mark.parametrize("weighted", [False, True])
def test_fitted_lines_are_those_of_a_decomposition(axes, weighted, device):
    points = rand(7, 20, axes) + 3 * rand(7, 20, 1, seed=6) * rand(7, 1, axes, seed=7)
    weights = rand(7, 20, seed=8).abs() if weighted else None
    found = G.fit_line(points.to(device), None if weights is None else weights.to(device))
    w = torch.ones(7, 20, dtype=torch.float64) if weights is None else weights
    mean = (w[..., None] * points).sum(1, keepdim=True) / w.sum(1)[:, None, None]
    _, _, V = torch.linalg.svd((points - mean) * w.sqrt()[..., None])
    assert_close(found.origin.cpu(), mean[:, 0])
    assert_close((found.direction.cpu() * V[:, 0]).sum(-1).abs(), torch.ones(7, dtype=torch.float64))
    assert_close(found.direction.norm(dim=-1).cpu(), torch.ones(7, dtype=torch.float64))


def test_fitted_planes_are_those_of_a_decomposition(device):
    points = rand(7, 20, 3) * torch.tensor([1, 0.5, 0.01], dtype=torch.float64)
    points = points @ G.axis_angle_to_rotation_matrix(rand(7, 3, seed=9)).mT + 100
    found = G.fit_plane(points.to(device))
    _, S, V = torch.linalg.svd(points - points.mean(1, keepdim=True))
    assert_close((found.normal.data.cpu() * V[:, 2]).sum(-1).abs(), torch.ones(7, dtype=torch.float64))
    distances = found.abs_distance(points.to(device).transpose(0, 1)).data
    assert_close(distances.square().sum(0).cpu(), S[:, 2] ** 2, 1e-8, 1e-8)
    single = G.fit_plane(Vector3(points[0].float().to(device)))
    assert_close(single.normal.data.double().cpu().abs(), found.normal.data[0].cpu().abs(), 1e-2, 1e-2)


def test_degenerate_fits_have_finite_gradients(device):
    same = torch.ones(1, 5, 3, device=device, requires_grad=True)
    along = torch.arange(15.0, device=device).reshape(1, 5, 3).requires_grad_()
    for points, fit in itertools.product(
        (same, along), (lambda p: G.fit_line(p).direction, lambda p: G.fit_plane(p).n)
    ):
        found = fit(points)
        (grad,) = torch.autograd.grad(found.sum(), points)
        assert found.isfinite().all()
        assert grad.isfinite().all()
    assert_close(G.fit_line(along).direction, torch.full((1, 3), 3**-0.5, device=device))
    assert not G.fit_line(same).direction.any()


def test_lines_and_planes_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry
    from kornia.geometry.vector import Vector3 as TheirVector

    a, b, c, p = (rand(4, 3, seed=s) for s in range(4))
    ours, his = G.ParametrizedLine.through(a.to(device), b.to(device)), theirs.ParametrizedLine.through(a, b)
    flat, level = G.Hyperplane.through(*(x.to(device) for x in (a, b, c))), theirs.Hyperplane.through(a, b, c)
    assert_close(ours.projection(p.to(device)).cpu(), his.projection(p))
    assert_close(ours.distance(p.to(device)).cpu(), his.distance(p))
    assert_close(ours.squared_distance(p.to(device)).cpu(), his.squared_distance(p))
    assert_close(ours.point_at(p[:, 0].to(device)).cpu(), his.point_at(p[:, 0]))
    assert_close(ours.point_at(Scalar(torch.tensor(2.0, device=device))).cpu(), his.point_at(2.0))
    assert (ours.dim(), ours[0] is ours.origin, len(list(ours))) == (3, True, 2)
    assert_close(flat.normal.data.cpu(), level.normal.data)
    assert_close(flat.offset.data.cpu(), level.offset.data)
    assert_close(flat.signed_distance(p.to(device)).data.cpu(), level.signed_distance(TheirVector(p)).data)
    assert_close(flat.projection(p.to(device)).data.cpu(), level.projection(TheirVector(p)).data)
    other = G.ParametrizedLine(p.to(device), c.to(device))
    assert_close([x.cpu() for x in other.intersect(flat)], list(theirs.ParametrizedLine(p, c).intersect(level)))
    parallel = G.ParametrizedLine(p.to(device), (b - a).to(device))
    assert_close(parallel.intersect(flat)[1], p.to(device))


def test_lines_and_planes_learn(device):
    line = G.ParametrizedLine(nn.Parameter(torch.zeros(2)), torch.tensor([1.0, 0])).to(device)
    assert [name for name, _ in line.named_parameters()] == ["origin"]
    line.distance(torch.tensor([1.0, 2], device=device)).backward()
    assert_close(line.origin.grad, torch.tensor([0.0, -1], device=device))
    assert isinstance(G.Hyperplane(nn.Parameter(torch.ones(3)), Scalar(torch.ones(()))).n, nn.Parameter)


# --- quaternions ----------------------------------------------------------------------------------------------------


def test_quaternions_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry.quaternion.Quaternion
    p, q, t = rand(6, 4), rand(6, 4, seed=6), rand(6, seed=7)
    calls = [
        lambda a, b, t: a * b,
        lambda a, b, t: a / b,
        lambda a, b, t: a + b,
        lambda a, b, t: a - b,
        lambda a, b, t: -a,
        lambda a, b, t: 2.0 * a,
        lambda a, b, t: a * t,
        lambda a, b, t: a / t,
        lambda a, b, t: a + t,
        lambda a, b, t: a - 2.0,
        lambda a, b, t: 2.0 - a,
        lambda a, b, t: 2.0 + a,
        lambda a, b, t: 2.0 / a,
        lambda a, b, t: a**2,
        lambda a, b, t: a**-0.7,
        lambda a, b, t: a.inv(),
        lambda a, b, t: a.conj(),
        lambda a, b, t: a.normalize(),
        lambda a, b, t: a.slerp(b, 0.3),
        lambda a, b, t: a.slerp(b, t),
        lambda a, b, t: a[2:4],
    ]
    for call in calls:
        expected = call(theirs(p), theirs(q), t).data
        assert_close(call(Q(p.to(device)), Q(q.to(device)), t.to(device)).data.cpu(), expected, 1e-9, 1e-9)
    a, b = Q(p.to(device)), theirs(p)
    for name in ("real", "scalar", "vec", "q", "w", "x", "y", "z", "polar_angle"):
        assert_close(getattr(a, name).cpu(), getattr(b, name))
    for name in ("matrix", "to_axis_angle", "norm", "squared_norm", "to_euler"):
        found, expected = getattr(a, name)(), getattr(b, name)()
        assert_close([x.cpu() for x in found] if isinstance(found, tuple) else found.cpu(), expected)
    assert a.shape == (6, 4)
    assert len(a.coeffs) == 4
    assert a.norm(keepdim=True).shape == (6, 1)


def test_ways_to_make_quaternions(device):
    q = Q.random(1000, device, torch.float64)
    assert_close(q.norm(), torch.ones(1000, dtype=torch.float64, device=device))
    assert q.data.mean(0).abs().max() < 0.1
    for again in (Q.from_matrix(q.matrix()), Q.from_axis_angle(q.to_axis_angle()), Q.from_euler(*q.to_euler())):
        assert_close(again.matrix(), q.matrix(), 0, 1e-12)
    assert_close(Q.identity(2, device).data, torch.tensor([[1.0, 0, 0, 0]] * 2, device=device))
    assert Q.identity().shape == Q.random().shape == (4,)
    assert_close(Q.from_coeffs(1.0, 2.0, 3.0, 4.0).data, torch.tensor([1.0, 2, 3, 4]))
    assert_close(Q.from_coeffs(*q.coeffs).data, q.data)
    assert q.to(torch.float32).data.dtype == torch.float32
    assert [name for name, _ in Q(nn.Parameter(torch.ones(4))).named_parameters()] == ["data"]


@given(st.lists(st.floats(-2, 2).filter(lambda x: abs(x) > 1e-3), min_size=12, max_size=12), st.floats(-3, 3))
def test_algebra(numbers, t):
    p, q, r = (Q(x) for x in torch.tensor(numbers, dtype=torch.float64).split(4))
    assert_close(((p * q) * r).data, (p * (q * r)).data, 1e-10, 1e-10)
    assert_close((p * (q + r)).data, (p * q + p * r).data, 1e-10, 1e-10)
    assert_close((p * p.inv()).data, Q.identity(dtype=torch.float64).data, 0, 1e-10)
    assert_close((p * q).norm(), p.norm() * q.norm())
    assert_close((p * q).matrix(), p.matrix() @ q.matrix(), 0, 1e-10)
    assert_close((p**t * p ** (1 - t)).data, p.data, 1e-9, 1e-9)
    assert_close(p.slerp(q, 0.0).matrix(), p.matrix(), 0, 1e-9)
    assert_close(p.slerp(q, 1.0).matrix(), q.matrix(), 0, 1e-7)


def test_powers_of_numbers(device):
    minus = Q(torch.tensor([-4.0, 0, 0, 0], dtype=torch.float64, device=device))
    root = minus**0.5
    assert_close((root * root).data, minus.data, 0, 1e-12)
    zero = torch.zeros(4, dtype=torch.float64, device=device, requires_grad=True)
    (grad,) = torch.autograd.grad((Q(zero).norm() + Q(zero).normalize().data.sum()), zero)
    assert grad.isfinite().all()


def test_average(device):
    center = Q.random(1, device, torch.float64)
    turns = 0.3 * (torch.rand(200, 3, dtype=torch.float64, device=device) - 0.5)
    around = center * Q.from_axis_angle(torch.cat([turns, -turns]))
    signs = torch.where(torch.rand(400, 1, device=device) > 0.5, 1.0, -1.0)
    found = average_quaternions(Q(around.data * signs))
    assert_close(found.matrix(), center.matrix(), 0, 1e-12)
    weights = torch.cat([torch.ones(1), torch.zeros(399)]).to(device)
    assert_close(average_quaternions(around, weights).matrix()[0], around.matrix()[0], 0, 1e-12)
    same = center.data.expand(5, 4).clone().requires_grad_()
    (grad,) = torch.autograd.grad(average_quaternions(Q(same)).data.sum(), same)
    assert grad.isfinite().all()


# --- poses ----------------------------------------------------------------------------------------------------------


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


# --- point clouds ---------------------------------------------------------------------------------------------------

WRITERS = [(save_pointcloud_ply, load_pointcloud_ply), (save_pointcloud_ply_binary, load_pointcloud_ply_binary)]


@pytest.mark.parametrize("save, load", WRITERS, ids=["text", "binary"])
@pytest.mark.parametrize("shape", [(7, 3), (2, 4, 5, 3), (0, 3), (3,)])
def test_point_clouds_come_back(save, load, shape, tmp_path, device):
    points = torch.randn(shape)
    if points.numel() > 6:
        points.view(-1)[:3] = torch.tensor([math.nan, math.inf, 1e-40])
    save(tmp_path / "cloud.PLY", points.to(device))
    assert_close(load(tmp_path / "cloud.PLY"), points.reshape(-1, 3))


@pytest.mark.parametrize("i", [0, 1])
def test_point_clouds_are_those_of_kornia(i, tmp_path):
    theirs = pytest.importorskip("kornia").geometry.pointcloud
    save, load = WRITERS[i]
    points, path = torch.randn(9, 3), str(tmp_path / "cloud.ply")
    getattr(theirs, save.__name__)(path, points)
    assert_close(load(path), points)
    save(path, points)
    assert_close(getattr(theirs, load.__name__)(path), points)


def test_point_clouds_of_others(tmp_path):
    """Other types, orders, elements and byte orders; faces after the vertices."""
    header = (
        "ply\nformat {} 1.0\ncomment by hand\nelement camera 1\nproperty float f\nelement vertex 2\nproperty uchar red\n"
        "property float z\nproperty short x\nproperty double y\nelement face 1\nproperty list uchar int i\nend_header\n"
    )
    path, expected = tmp_path / "mesh.ply", torch.tensor([[2.0, 3, 1], [-5, 0.25, 4]])
    path.write_text(header.format("ascii") + "0.5\n255 1 2 3\n0 4 -5 0.25\n3 0 1 1\n")
    assert_close(load_pointcloud_ply(path), expected)
    import struct

    for order, mark in (("little", "<"), ("big", ">")):
        rows = struct.pack(mark + "f", 0.5) + b"".join(
            struct.pack(mark + "Bfhd", 7, z, int(x), y) for x, y, z in expected
        )
        path.write_bytes(header.format(f"binary_{order}_endian").encode() + rows + b"\x03")
        assert_close(load_pointcloud_ply_binary(path), expected)


def test_bad_point_clouds(tmp_path):
    path = tmp_path / "bad.ply"
    save_pointcloud_ply(path, torch.ones(2, 3))
    text = path.read_text()
    with pytest.raises(ValueError, match="expected a file of format binary"):
        load_pointcloud_ply_binary(path)
    for bad in (
        "",
        text.replace("ply", "plz"),
        text[:40],
        text[:-4],
        text.replace("1.0 1.0 1.0\n", ""),
        text.replace(" y", " q"),
    ):
        path.write_text(bad)
        with pytest.raises(ValueError, match="load_pointcloud_ply: expected"):
            load_pointcloud_ply(path)
    for bad in ("property float", "element vertex -1", "property list uchar int i\nelement x 1", "what"):
        path.write_text(text.replace("end_header", bad + "\nend_header"))
        with pytest.raises(ValueError, match="load_pointcloud_ply: expected"):
            load_pointcloud_ply(path)
    with pytest.raises(TypeError, match="expected filename to be a str or a path, got int"):
        save_pointcloud_ply(3, torch.ones(2, 3))
    with pytest.raises(ValueError, match=r"expected filename to end in \.ply"):
        save_pointcloud_ply("cloud.txt", torch.ones(2, 3))
    with pytest.raises(ValueError, match=r"pointcloud of shape \(\*, 3\)"):
        save_pointcloud_ply(path, torch.ones(2, 4))


BAD = [
    (lambda: Vector3(torch.ones(2)), ValueError, r"Vector3: expected vector of shape \(\*, 3\), got \(2,\)"),
    (lambda: Vector2.from_coords(1.0, torch.ones(2)), TypeError, "Vector2.from_coords: expected tensors or numbers"),
    (lambda: Q(torch.ones(3)), ValueError, r"Quaternion: expected data of shape \(\*, 4\)"),
    (lambda: Q.identity().slerp(torch.ones(4), 0.5), TypeError, "slerp: expected q1 to be a Quaternion, got Tensor"),
    (lambda: Q.from_coeffs(1.0, 2.0, 3.0, torch.ones(())), TypeError, "from_coeffs: expected tensors or numbers, got both"),
    (lambda: average_quaternions(torch.ones(2, 4)), TypeError, "average_quaternions: expected Q to be a Quaternion"),
    (lambda: average_quaternions(Q.identity(2), torch.ones(3)), ValueError, r"average_quaternions: expected w of shape \(2,\)"),
    (lambda: average_quaternions(Q.identity(0)), ValueError, "average_quaternions: expected Q of at least one"),
    (lambda: G.fit_line(torch.ones(2, 3)), ValueError, r"fit_line: expected points of shape \(B, N, D\)"),
    (lambda: G.fit_line(torch.ones(2, 1, 3)), ValueError, "fit_line: expected points of at least 2 a line"),
    (lambda: G.fit_line(torch.ones(2, 5, 3), torch.ones(2)), ValueError, r"fit_line: expected weights of shape \(2, 5\)"),
    (lambda: G.fit_plane(torch.ones(2, 3)), ValueError, r"fit_plane: expected points of shape \(\*, N, 3\)"),
    (lambda: G.Hyperplane(torch.ones(2), torch.ones(())), ValueError, r"Hyperplane: expected n of shape \(\*, 3\)"),
    (lambda: G.Hyperplane.through(torch.ones(3), torch.ones(3)), ValueError, "Hyperplane.through: expected three points"),
    (lambda: G.ParametrizedLine(torch.ones(3), torch.ones(2)), ValueError, r"direction of shape \(\*, 3\)"),
    (lambda: G.NamedPose(torch.eye(2)), ValueError, "NamedPose: expected dst_from_src of shape"),
    (lambda: G.NamedPose.from_rt(torch.eye(3), torch.ones(2)), ValueError, r"expected translation of shape \(3,\)"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
