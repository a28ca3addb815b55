"""Depth: points, normals, warps, and the distance of warped views."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from kvision._ops import FLOATS
from op_tests import TOLERANCES, OpTests, assert_close
from warp_tests import FLOAT_PLACES, WarpTests, one

G = K.geometry


def camera(x: Tensor) -> Tensor:
    k = torch.tensor([[11.0, 0, 6.3], [0, 12.5, 4.1], [0, 0, 1]], dtype=torch.float64)
    return k + 0.1 * torch.arange(len(x))[:, None, None] * (k > 1)


def motion(x: Tensor) -> Tensor:
    m = torch.tensor(
        [[0.998, -0.041, 0.052, 0.137], [0.043, 0.999, -0.031, -0.093], [-0.051, 0.033, 0.998, 0.071], [0, 0, 0, 1]],
        dtype=torch.float64,
    )
    return m + 0.0031 * torch.arange(len(x))[:, None, None] * (m < 1)


def depth(x: Tensor) -> Tensor:
    """Of images like x, smooth and in front of the camera."""
    rows = torch.linspace(1.13, 1.91, x.shape[2], dtype=torch.float64)[:, None]
    columns = torch.linspace(0, 0.37, x.shape[3], dtype=torch.float64)
    return (rows + columns**2 + 0.05 * torch.arange(len(x))[:, None, None]).unsqueeze(1)


def projection(x: Tensor) -> Tensor:
    k, m = camera(x), motion(x)
    return torch.cat([k @ m[:, :3, :3] @ torch.linalg.inv(k), k @ m[:, :3, 3:]], 2)


class Points(OpTests):
    channels = 1
    shape = (2, 1, 13, 18)
    small = (1, 1, 4, 5)
    max_size = 9
    variants = [{"camera_matrix": camera}, {"camera_matrix": one(camera), "normalize_points": True}]
    errors = [
        ({"camera_matrix": lambda x: torch.eye(3)}, ValueError, "expected camera_matrix of shape"),
        ({"normalize_points": 1}, TypeError, "normalize_points to be a bool"),
        ({"camera_matrix": lambda x: torch.ones(3, 3, 3)}, ValueError, "camera_matrix with 1 or 2 rows"),
    ]

    def input(self, shape, dtype, device):
        x = super().input(shape, dtype, device)
        return x if dtype == torch.uint8 else x + 1


class TestDepthTo3d(Points):
    function = staticmethod(G.depth_to_3d)
    operators = ("depth_points", "depth_points_backward", "depth_camera")
    tolerances = {torch.float32: (2e-5, 1e-5)}

    def test_nan_stays_in_its_window(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 0, 6, 7] = float("nan")
        self.check(self.call(x, kwargs), self.expected(x, kwargs))


class TestDepthToNormals(TestDepthTo3d):
    function = staticmethod(G.depth_to_normals)
    operators = tuple(
        "depth_normals depth_normals_backward depth_normals_to_points depth_points_backward depth_camera".split()
    )

    def input(self, shape, dtype, device):
        return 4 * super().input(shape, dtype, device)

    # Differences of neighbours, whose last digits are lost: the points are of a size of 1 and differ by some hundredths.
    tolerances = {torch.float32: (1e-4, 2e-5), torch.float16: (2e-3, 4e-3), torch.bfloat16: (1.6e-2, 4e-2)}


@pytest.mark.parametrize("dtype", FLOATS, ids=str)
@pytest.mark.parametrize("function", [G.depth_to_3d, G.depth_to_normals])
def test_gradients_to_cameras(function, dtype, device):
    """Sums over pixels: of whole rows, of a few pixels, of several parts, of channels that lie last."""
    relative, absolute = TOLERANCES[dtype]
    for shape, distance in (((2, 1, 13, 18), True), ((1, 1, 5, 3), False), ((2, 1, 70, 130), False)):
        x = depth(torch.zeros(shape)).to(dtype)
        weights = torch.rand(shape[0], 3, *shape[2:]).to(dtype).to(device).to(memory_format=torch.channels_last)
        for k in (camera(x), camera(x)[:1]):
            results = []
            for backend in ("auto", "auto", "reference"):
                wide = backend == "reference"
                given = [v.to(device).to(torch.float64 if wide else dtype) for v in (x, k)]
                leaves = [v.requires_grad_() for v in given]
                with K.backend(backend):
                    y = function(*leaves, distance)
                    results.append([g.to(dtype) for g in torch.autograd.grad(y, leaves, weights.to(y.dtype))])
            assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
            for a, e in zip(results[0], results[2]):
                assert_close(a, e, 8 * relative, 8 * absolute * max(1, float(e.abs().max())))


class TestWarpFrameDepth(WarpTests):
    function = staticmethod(G.warp_frame_depth)
    small = (1, 1, 4, 4)
    operators = tuple(
        "depth_points depth_points_backward depth_camera depth_warp depth_warp_image_gradient depth_warp_slopes "
        "reprojection reprojection_backward".split()
    )
    bytes = False
    max_size = 7
    tolerances = {**FLOAT_PLACES, torch.float32: (5e-5, 5e-5)}
    variants = [
        {"depth_dst": depth, "src_trans_dst": motion, "camera_matrix": camera},
        {"depth_dst": one(depth), "src_trans_dst": motion, "camera_matrix": one(camera), "normalize_points": True},
    ]
    errors = [
        ({"depth_dst": lambda x: x}, ValueError, "expected depth_dst of shape"),
        ({"src_trans_dst": lambda x: torch.eye(3)[None]}, ValueError, "expected src_trans_dst of shape"),
    ]


def cameras(batch: int, focal: float, device: torch.device, module=G):
    """Cameras of some float64 images 19 pixels wide and 15 high, a little apart."""
    image = torch.zeros(batch, 1, 1, 1)
    intrinsics = torch.eye(4, dtype=torch.float64).repeat(batch, 1, 1)
    intrinsics[:, :3, :3] = torch.tensor([[focal, 0, 9], [0, 1.1 * focal, 7], [0, 0, 1]], dtype=torch.float64)
    pose = motion(image) if focal > 20 else torch.eye(4, dtype=torch.float64).repeat(batch, 1, 1)
    size = torch.full((batch,), 19.0, dtype=torch.float64)
    return module.PinholeCamera(*(x.to(device) for x in (intrinsics, pose, size, size)))


class TestDepthWarper(CompositionTests):
    """The other modes, which come with the same operators."""

    @staticmethod
    def warped(mode: str, padding: str):
        def call(image: Tensor, depth: Tensor, pose: Tensor) -> Tensor:
            size = torch.ones_like(pose[:, 0, 0])
            identity = torch.eye(4, dtype=pose.dtype, device=pose.device).expand_as(pose)
            there, here = (G.PinholeCamera(identity, e, size, size) for e in (identity + 0.1 * pose, identity))
            warper = K.DepthWarper(there, 7, 9, mode, padding, align_corners=False)
            return warper.compute_projection_matrix(here)(depth + 1, image)

        return call

    cases = {
        "nearest": Case(warped("nearest", "zeros"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
        "border": Case(warped("bilinear", "border"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
        "reflection": Case(warped("bilinear", "reflection"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
    }
    compiled = ("border",)


class TestCompositions(CompositionTests):
    cases = {
        "depth_to_3d_v2": Case(G.depth_to_3d_v2, ((2, 6, 7), (2, 3, 3))),
        "unproject_meshgrid": Case(lambda k: G.unproject_meshgrid(4, 5, k, True), ((2, 3, 3),)),
        "depth_from_disparity": Case(G.depth_from_disparity, ((2, 1, 4, 5), (2,), (2,))),
        "depth_from_plane_equation": Case(G.depth_from_plane_equation, ((2, 3), (2, 1), (2, 4, 2), (2, 3, 3))),
    }


# --- the distance of views ------------------------------------------------------------------------------------------


def views_of(x: Tensor) -> Tensor:
    return torch.stack([x, x.flip(3)], 1)


def target(x: Tensor) -> Tensor:
    """Smooth, and never equal to what is in [0, 1]: no difference changes its sign."""
    rows = torch.linspace(1.2, 1.5, x.shape[2], dtype=torch.float64)
    return (rows[:, None] * torch.linspace(1, 1.3, x.shape[3], dtype=torch.float64)).expand(*x.shape[:3], -1).clone()


class TestPhotometricDepth(WarpTests):
    operators = ("photometric_depth", "depth_warp", "depth_warp_image_gradient")
    bytes = False
    max_size = 7
    small = (1, 1, 4, 4)
    tolerances = {**FLOAT_PLACES, torch.float32: (5e-5, 5e-5)}
    variants = [
        {"target": target, "depth": depth, "projections": lambda x: torch.stack([projection(x)] * 2, 1)},
        {
            "target": one(target),
            "depth": one(depth),
            "projections": lambda x: torch.stack([projection(x)] * 2, 1),
            "distance": "charbonnier",
        },
    ]
    errors = [
        ({"distance": "huber"}, ValueError, "distance must be one of l1, l2, charbonnier; got 'huber'"),
        ({"target": lambda x: x[:, :1]}, ValueError, "expected target of shape"),
        ({"projections": lambda x: torch.eye(3)[None, None]}, ValueError, "expected projections of shape"),
    ]

    def function(self, input: Tensor, **kwargs) -> Tensor:
        return G.photometric_depth_loss(views_of(input), **kwargs)

    function.__name__ = "photometric_depth_loss"

    def test_wrong_kinds(self, variant, device):
        pytest.skip("the views are made by this test")

    def test_vmap(self, variant, device):
        pytest.skip("the views of a sample are made of another one")


@pytest.mark.parametrize("distance", ["l1", "l2", "charbonnier"])
def test_is_the_mean_over_the_warped_views(distance, device):
    x = torch.rand(2, 3, 15, 19, dtype=torch.float64, device=device)
    views, y, d = views_of(x), torch.rand_like(x), depth(x).to(device).requires_grad_()
    projections = torch.stack([projection(x), projection(x).flip(0)], 1).to(device).requires_grad_()
    total = terms = 0
    for i in range(2):
        warped, seen = (
            G.depth.warp.depth_warp_of(v, d, projections[:, i], "bilinear", "fill", True)
            for v in (views[:, i], torch.ones_like(y))
        )
        difference, seen = warped - y, (seen > 1 - 1e-9).double()
        value = {"l1": difference.abs(), "l2": difference**2, "charbonnier": (difference**2 + 1e-6).sqrt()}[distance]
        total, terms = total + (value * seen).sum((1, 2, 3)), terms + seen.sum((1, 2, 3))
    found, expected = G.photometric_depth_loss(views, y, d, projections, distance), total / terms.detach()
    assert_close(found, expected)
    for a, e in zip(*(torch.autograd.grad(loss.sum(), (d, projections)) for loss in (found, expected))):
        assert_close(a, e, 1e-7, 1e-7)


def test_where_nothing_is_seen(device):
    x = torch.ones(1, 1, 4, 4, device=device)
    d = torch.zeros_like(x, requires_grad=True)
    loss = G.photometric_depth_loss(x[:, None], x, d, torch.eye(3, 4, device=device)[None, None])
    loss.backward()
    assert loss.isnan()
    assert not d.grad.any()


# --- places ---------------------------------------------------------------------------------------------------------


def test_what_is_behind_the_camera_is_outside_and_has_no_gradient(device):
    image = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    values = torch.tensor([-1.0, 0, float("nan"), float("inf"), -float("inf"), 1e-30, 1], device=device)
    d = values.expand(1, 1, 6, 7).clone().requires_grad_()
    moved = torch.eye(4, device=device)[None].clone().requires_grad_()
    found = G.warp_frame_depth(image, d, moved, torch.eye(3, device=device)[None])
    assert not found[..., :5].any()
    assert_close(found[..., 5:], image[..., 5:])
    found.sum().backward()
    assert all(x.grad.isfinite().all() for x in (image, d, moved))
    assert not d.grad[..., :5].any()


def test_singular_cameras_are_harmless(device):
    image = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    d = torch.ones(1, 1, 6, 7, device=device, requires_grad=True)
    found = G.warp_frame_depth(image, d, torch.eye(4, device=device)[None], torch.zeros(1, 3, 3, device=device))
    found.sum().backward()
    assert not found.any()
    assert d.grad.isfinite().all()
    assert image.grad.isfinite().all()


def test_flat_depth_has_finite_normals(device):
    d = torch.zeros(1, 1, 4, 5, device=device, requires_grad=True)
    normals = G.depth_to_normals(d, torch.eye(3, device=device)[None])
    normals.sum().backward()
    assert not normals.any()
    assert d.grad.isfinite().all()
    with pytest.raises(ValueError, match=r"depth_to_normals: expected depth with H, W of at least 2"):
        G.depth_to_normals(d[..., :1], torch.eye(3, device=device)[None])


def test_one_camera_may_be_expanded(device):
    d = 1 + torch.rand(3, 1, 5, 6, device=device)
    k = camera(d[:1]).float().to(device)
    for call in (G.depth_to_3d, G.depth_to_normals):
        assert_close(call(d, k.expand(3, -1, -1)), call(d, k), 0, 0)
        assert_close(call(d, k.mT.contiguous().mT), call(d, k), 0, 0)


def test_normals_of_a_plane_are_its_normal(device):
    normal = torch.nn.functional.normalize(torch.tensor([[0.3, -0.2, 1.0]], dtype=torch.float64), dim=1)
    k = camera(normal)
    uv = torch.stack(torch.meshgrid(torch.arange(9.0), torch.arange(7.0), indexing="xy"), -1).reshape(1, -1, 2).double()
    d = G.depth_from_plane_equation(normal, torch.tensor([[2.0]]).double(), uv, k).view(1, 1, 7, 9)
    found = G.depth_to_normals(d.to(device), k.to(device))[:, :, 1:-1, 1:-1]
    assert_close(found, normal.to(device)[..., None, None].expand_as(found), 1e-9, 1e-9)


def test_warper_wants_its_cameras_and_sizes(device):
    there, here = (cameras(1, focal, device) for focal in (20.0, 21.0))
    warper = K.DepthWarper(there, 15, 19)
    image, d = torch.rand(1, 3, 15, 19, device=device).double(), torch.ones(1, 1, 15, 19, device=device).double()
    with pytest.raises(ValueError, match="DepthWarper: call compute_projection_matrix"):
        warper(d, image)
    with pytest.raises(TypeError, match="DepthWarper: expected pinhole_dst to be a PinholeCamera"):
        K.DepthWarper(torch.eye(4), 15, 19)
    with pytest.raises(ValueError, match="mode must be one of bilinear, nearest"):
        K.DepthWarper(there, 15, 19, mode="bicubic")
    assert warper.compute_projection_matrix(here) is warper
    with pytest.raises(ValueError, match=r"expected depth_src of shape \(B, 1, 15, 19\)"):
        warper(d[..., :4], image)
    assert "height=15, width=19" in repr(warper)
    grid = warper.warp_grid(d)
    assert_close(torch.nn.functional.grid_sample(image, grid, align_corners=True), warper(d, image))


def test_subpixel_step_moves_the_middle_by_half_a_pixel(device):
    there, here = (cameras(1, focal, device) for focal in (20.0, 21.0))
    warper = K.DepthWarper(there, 15, 19).compute_projection_matrix(here)
    step = float(warper.compute_subpixel_step())

    def place(inverse_depth: float) -> Tensor:
        d = torch.full((1, 1, 15, 19), 1 / inverse_depth, dtype=torch.float64, device=device)
        grid = warper.warp_grid(d)
        u, v = (grid[0, 7:9, 9:11, i].mean() * (n - 1) / 2 for i, n in ((0, 19), (1, 15)))  # about (9.5, 7.5)
        return torch.stack([u, v])

    assert float((place(1 + step) - place(1)).norm()) == pytest.approx(0.5, abs=0.03)


# --- against others -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normalize", [True, False])
def test_is_kornias(normalize, device):
    kornia = pytest.importorskip("kornia").geometry
    x = torch.rand(2, 3, 15, 19, dtype=torch.float64, device=device)
    k, m, d = (f(x).to(device) for f in (camera, motion, depth))
    assert_close(G.depth_to_3d(d, k, normalize), kornia.depth_to_3d(d, k, normalize))
    assert_close(G.depth_to_3d_v2(d[:, 0], k, normalize), kornia.depth_to_3d_v2(d[:, 0], k, normalize))
    grid = G.unproject_meshgrid(15, 19, k, normalize)
    assert_close(G.depth_to_3d_v2(d[:, 0], k, xyz_grid=grid), kornia.depth_to_3d_v2(d[:, 0], k, normalize))
    assert_close(G.depth_to_normals(d, k, normalize), kornia.depth_to_normals(d, k, normalize))
    leaves = [v.requires_grad_() for v in (x, d, m)]
    pair = [module.warp_frame_depth(x, d, m, k, normalize) for module in (G, kornia)]
    assert_close(*pair)
    weights = torch.rand_like(pair[0])
    for found, expected in zip(*(torch.autograd.grad(y, leaves, weights) for y in pair)):
        assert_close(found, expected, 1e-7, 1e-7)


def test_warper_and_the_rest_are_kornias(device):
    kornia = pytest.importorskip("kornia").geometry
    x = torch.rand(2, 3, 15, 19, dtype=torch.float64, device=device)
    d = depth(x).to(device)
    pair = [
        module.depth_warp(cameras(2, 20.0, device, module), cameras(2, 21.0, device, module), d, x, 15, 19)
        for module in (G, kornia)
    ]
    assert_close(*pair)
    assert_close(
        *(module.depth_from_disparity(d, torch.rand(2, device=device) * 0 + 0.3, 12.0) for module in (G, kornia))
    )
    normal, offset, uv = torch.rand(2, 3).double() - 0.3, torch.rand(2, 1).double(), 9 * torch.rand(2, 7, 2).double()
    normal[0] = 0
    args = [v.to(device) for v in (normal, offset, uv, camera(x))]
    assert_close(*(module.depth_from_plane_equation(*args) for module in (G, kornia)))


def test_true_depth_and_poses_explain_the_pictures(data: Path, device):
    """As data/README.md measured it: 2.63 of 255 on average over pairs, 11.06 without a warp."""
    folder = data / "rgbd_livingroom"
    intrinsics = torch.tensor([float(v) for v in (folder / "intrinsics.txt").read_text().split()]).reshape(1, 3, 3)
    scale = float((folder / "depth_scale.txt").read_text())
    images, depths, poses = [], [], []
    for i in range(5):
        images.append(255 * K.io.load_image(folder / f"color_{i}.jpg", device=device)[None])
        numbers = K.io.load_image(folder / f"depth_{i}.png", K.io.ImageLoadType.UNCHANGED, device)
        depths.append(numbers[None].float() / scale)
        pose = [float(v) for v in (folder / f"pose_{i}.txt").read_text().split()]
        poses.append(torch.tensor(pose, dtype=torch.float64).reshape(4, 4))
    errors = []
    for i, j in ((0, 2), (4, 1)):
        relative = (torch.linalg.inv(poses[j]) @ poses[i]).float()[None].to(device)
        k = intrinsics.to(device)
        warped, other = (G.warp_frame_depth(v, depths[i], relative, k) for v in (images[j], depths[j]))
        z = G.transform_points(relative, G.depth_to_3d(depths[i], k).flatten(2).mT).mT[:, 2].view_as(other)
        seen = (depths[i] > 0) & ((other - z).abs() < 0.03 * z)
        errors.append(float(((warped - images[i]).abs().mean(1, keepdim=True)[seen]).mean()))
    assert max(errors) < 3.5, errors
