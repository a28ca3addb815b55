"""Points and normals of depth maps."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from depth_scenes import camera, depth, motion
from kvision._ops import FLOATS
from op_tests import TOLERANCES, OpTests, assert_close
from warp_tests import one

G = K.geometry


class Points(OpTests):
    channels = 1
    shape = (2, 1, 13, 18)
    small = (1, 1, 4, 5)
    max_size = 9
    variants = [{"camera_matrix": camera}, {"camera_matrix": one(camera), "normalize_points": True}]
    errors = [
        ({"camera_matrix": lambda x: torch.eye(3)}, ValueError, "expected camera_matrix of shape"),
        ({"normalize_points": 1}, TypeError, "normalize_points to be a bool"),
        ({"camera_matrix": lambda x: torch.ones(3, 3, 3)}, ValueError, "camera_matrix with a batch size of 1 or 2"),
    ]

    def input(self, shape, dtype, device):
        x = super().input(shape, dtype, device)
        return x if dtype == torch.uint8 else x + 1


class TestDepthTo3d(Points):
    function = staticmethod(G.depth_to_3d)
    operators = ("depth_points", "depth_points_backward", "depth_points_camera_backward")
    tolerances = {torch.float32: (2e-5, 1e-5)}

    def test_nan_stays_in_its_window(self, variant, device):
        x, kwargs = self.setup(variant, device, torch.float32)
        x[0, 0, 6, 7] = float("nan")
        self.check(self.call(x, kwargs), self.expected(x, kwargs))


class TestDepthToNormals(TestDepthTo3d):
    function = staticmethod(G.depth_to_normals)
    operators = tuple(
        "depth_normals depth_normals_backward depth_normals_points_backward depth_points_backward "
        "depth_points_camera_backward".split()
    )

    def input(self, shape, dtype, device):
        return 4 * super().input(shape, dtype, device)

    # Differences of neighbors, whose last digits are lost: the points are of a size of 1 and differ by some hundredths.
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
                inputs = [v.to(device).to(torch.float64 if wide else dtype) for v in (x, k)]
                leaves = [v.requires_grad_() for v in inputs]
                with K.backend(backend):
                    y = function(*leaves, distance)
                    results.append([g.to(dtype) for g in torch.autograd.grad(y, leaves, weights.to(y.dtype))])
            assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
            for a, e in zip(results[0], results[2]):
                assert_close(a, e, 8 * relative, 8 * absolute * max(1, float(e.abs().max())))


class TestPointsFunctions(CompositionTests):
    cases = {
        "depth_to_3d_v2": Case(G.depth_to_3d_v2, ((2, 6, 7), (2, 3, 3))),
        "unproject_meshgrid": Case(lambda k: G.unproject_meshgrid(4, 5, k, True), ((2, 3, 3),)),
        "depth_from_disparity": Case(G.depth_from_disparity, ((2, 1, 4, 5), (2,), (2,))),
        "depth_from_plane_equation": Case(G.depth_from_plane_equation, ((2, 3), (2, 1), (2, 4, 2), (2, 3, 3))),
    }


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
    result = G.depth_to_normals(d.to(device), k.to(device))[:, :, 1:-1, 1:-1]
    assert_close(result, normal.to(device)[..., None, None].expand_as(result), 1e-9, 1e-9)


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
    for result, expected in zip(*(torch.autograd.grad(y, leaves, weights) for y in pair)):
        assert_close(result, expected, 1e-7, 1e-7)


def test_true_depth_and_poses_align_the_views(data: Path, device):
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
