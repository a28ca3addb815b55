"""Warps of images by depth."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from depth_scenes import camera, depth, motion
from op_tests import assert_close
from warp_tests import FLOAT_COORDS, WarpTests, one

G = K.geometry


class TestWarpFrameDepth(WarpTests):
    function = staticmethod(G.warp_frame_depth)
    small = (1, 1, 4, 4)
    operators = tuple(
        "depth_points depth_points_backward depth_points_camera_backward depth_warp depth_warp_image_backward "
        "depth_warp_coords_backward reprojection reprojection_backward".split()
    )
    bytes = False
    max_size = 7
    tolerances = {**FLOAT_COORDS, torch.float32: (5e-5, 5e-5)}
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
            destination, source = (G.PinholeCamera(identity, e, size, size) for e in (identity + 0.1 * pose, identity))
            warper = K.DepthWarper(destination, 7, 9, mode, padding, align_corners=False)
            return warper.compute_projection_matrix(source)(depth + 1, image)

        return call

    cases = {
        "nearest": Case(warped("nearest", "zeros"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
        "border": Case(warped("bilinear", "border"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
        "reflection": Case(warped("bilinear", "reflection"), ((2, 3, 7, 9), (2, 1, 7, 9), (2, 4, 4))),
    }
    compiled = ("border",)


def test_what_is_behind_the_camera_is_outside_and_has_no_gradient(device):
    image = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    values = torch.tensor([-1.0, 0, float("nan"), float("inf"), -float("inf"), 1e-30, 1], device=device)
    d = values.expand(1, 1, 6, 7).clone().requires_grad_()
    moved = torch.eye(4, device=device)[None].clone().requires_grad_()
    result = G.warp_frame_depth(image, d, moved, torch.eye(3, device=device)[None])
    assert not result[..., :5].any()
    assert_close(result[..., 5:], image[..., 5:])
    result.sum().backward()
    assert all(x.grad.isfinite().all() for x in (image, d, moved))
    assert not d.grad[..., :5].any()


def test_cameras_of_other_views(device):
    """The source's own camera: the same view, enlarged about its first pixel and moved."""
    image = torch.rand(2, 2, 6, 7, device=device)
    d = 1 + torch.rand(2, 1, 6, 7, device=device)
    here = torch.tensor([[[20.0, 0, 3], [0, 20, 2.5], [0, 0, 1]]], device=device)
    there = here.repeat(2, 1, 1)
    there[1, :2, 2] += torch.tensor([1.0, -2], device=device)
    still = torch.eye(4, device=device)[None]
    result = G.warp_frame_depth(image, d, still, here, camera_matrix_src=there)
    assert_close(result[0], image[0])
    assert_close(result[1, :, 2:, :-1], image[1, :, :-2, 1:])
    moved = motion(image).to(image)
    expected = G.warp_frame_depth(image, d, moved, here)
    assert_close(G.warp_frame_depth(image, d, moved, here, camera_matrix_src=here), expected)
    with pytest.raises(ValueError, match=r"warp_frame_depth: .*\(3,\) of camera_matrix_src"):
        G.warp_frame_depth(image, d, moved, here, camera_matrix_src=here.repeat(3, 1, 1))


def test_singular_cameras_are_harmless(device):
    image = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    d = torch.ones(1, 1, 6, 7, device=device, requires_grad=True)
    result = G.warp_frame_depth(image, d, torch.eye(4, device=device)[None], torch.zeros(1, 3, 3, device=device))
    result.sum().backward()
    assert not result.any()
    assert d.grad.isfinite().all()
    assert image.grad.isfinite().all()


def test_warper_wants_its_cameras_and_sizes(device):
    destination, source = (cameras(1, focal, device) for focal in (20.0, 21.0))
    warper = K.DepthWarper(destination, 15, 19)
    image, d = torch.rand(1, 3, 15, 19, device=device).double(), torch.ones(1, 1, 15, 19, device=device).double()
    with pytest.raises(ValueError, match="DepthWarper: call compute_projection_matrix"):
        warper(d, image)
    with pytest.raises(TypeError, match="DepthWarper: expected pinhole_dst to be a PinholeCamera"):
        K.DepthWarper(torch.eye(4), 15, 19)
    with pytest.raises(ValueError, match="mode must be one of bilinear, nearest"):
        K.DepthWarper(destination, 15, 19, mode="bicubic")
    assert warper.compute_projection_matrix(source) is warper
    with pytest.raises(ValueError, match=r"expected depth_src of shape \(B, 1, 15, 19\)"):
        warper(d[..., :4], image)
    assert "height=15, width=19" in repr(warper)
    grid = warper.warp_grid(d)
    assert_close(torch.nn.functional.grid_sample(image, grid, align_corners=True), warper(d, image))


def test_subpixel_step_moves_the_middle_by_half_a_pixel(device):
    destination, source = (cameras(1, focal, device) for focal in (20.0, 21.0))
    warper = K.DepthWarper(destination, 15, 19).compute_projection_matrix(source)
    step = float(warper.compute_subpixel_step())

    def position(inverse_depth: float) -> Tensor:
        d = torch.full((1, 1, 15, 19), 1 / inverse_depth, dtype=torch.float64, device=device)
        grid = warper.warp_grid(d)
        u, v = (grid[0, 7:9, 9:11, i].mean() * (n - 1) / 2 for i, n in ((0, 19), (1, 15)))  # about (9.5, 7.5)
        return torch.stack([u, v])

    assert float((position(1 + step) - position(1)).norm()) == pytest.approx(0.5, abs=0.03)


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


def test_grid_of_the_warper_is_kornias(device):
    kornia = pytest.importorskip("kornia").geometry
    eye, size = torch.eye(4)[None], torch.tensor([4.0])
    expected = kornia.DepthWarper(kornia.PinholeCamera(eye, eye, size, size), 4, 5).grid
    camera = G.PinholeCamera(*(x.to(device) for x in (eye, eye, size, size)))
    assert_close(G.DepthWarper(camera, 4, 5).grid, expected.to(device))


def test_a_grid_that_is_set_chooses_the_pixels(device):
    kornia = pytest.importorskip("kornia").geometry
    x = torch.rand(2, 3, 15, 19, dtype=torch.float64, device=device)
    d = depth(x).to(device).requires_grad_()
    pair = []
    for module in (G, kornia):
        warper = module.DepthWarper(cameras(2, 20.0, device, module), 15, 19)
        warper.compute_projection_matrix(cameras(2, 21.0, device, module))
        own = warper(d, x)
        warper.grid = warper.grid.to(x) * 0.5 + torch.tensor([1.0, 2.0, 0.5], device=device)
        pair.append(warper(d, x))
        assert (pair[-1] - own).abs().max() > 0.1
    assert_close(*pair)
    assert_close(torch.nn.functional.grid_sample(x, warper.warp_grid(d), align_corners=True), pair[0])
    (of_depth,) = torch.autograd.grad(pair[0].sum(), d)
    assert of_depth.abs().sum() > 0
    warper = G.DepthWarper(cameras(1, 20.0, device), 15, 19).compute_projection_matrix(cameras(1, 21.0, device))
    warper.grid = warper.grid
    assert_close(warper(d[:1], x), G.depth_warp(*(cameras(1, f, device) for f in (20.0, 21.0)), d[:1], x, 15, 19))
    with pytest.raises(ValueError, match=r"DepthWarper: expected grid of shape \(B, 15, 19, 3\), got \(1, 4, 5, 3\)"):
        warper.grid = torch.zeros(1, 4, 5, 3)
