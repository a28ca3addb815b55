"""What Kornia cannot tell about geometry.transform: exact results, gradients, types, bad arguments, registration."""

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from op_tests import assert_close, does_not_wait

G = K.geometry
SQUARE = torch.tensor([[[0.0, 0], [1, 0], [1, 1], [0, 1]]])
QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


# --- exact results --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", range(-5, 6))
def test_quarter_turns_are_exact(turns, device):
    x = torch.rand(1, 2, 33, 33, device=device)
    assert torch.equal(G.rotate(x, torch.tensor([90.0 * turns], device=device)), x.rot90(turns, (2, 3)))


def test_images_and_single_images(device):
    x = torch.rand(2, 3, 7, 8, device=device)
    one = torch.tensor([[1.5, -0.5]], device=device)
    assert_close(G.translate(x, one)[1], G.translate(x[1], one[0]))
    assert_close(G.rotate(x, torch.tensor(20.0, device=device))[0], G.rotate(x[0], torch.tensor([20.0], device=device)))
    assert_close(G.scale(x, torch.tensor([2.0], device=device)), G.scale(x, torch.full((2, 2), 2.0, device=device)))


def test_crops_of_one_pixel(device):
    x = torch.rand(1, 2, 6, 7, device=device)
    point = torch.tensor([[[3.0, 2], [3, 2], [3, 2], [3, 2]]], device=device)
    assert_close(G.crop_and_resize(x, point, (1, 1)), x[..., 2:3, 3:4])
    row = torch.tensor([[[1.0, 2], [5, 2], [5, 2], [1, 2]]], device=device)
    assert_close(G.crop_and_resize(x, row, (1, 5)), x[..., 2:3, 1:6])
    assert_close(G.crop_and_resize(x, row, (3, 5)), x[..., 2:3, 1:6].expand(1, 2, 3, 5))


def test_identity_of_volumes(device):
    x, eye = torch.rand(2, 1, 4, 5, 6, device=device), torch.eye(4, device=device)[None]
    for align_corners in (True, False):
        for mode in ("bilinear", "nearest"):
            assert torch.equal(G.warp_affine3d(x, eye[:, :3], (4, 5, 6), mode, align_corners=align_corners), x)
            assert torch.equal(G.warp_perspective3d(x, eye, (4, 5, 6), mode, align_corners=align_corners), x)
            assert_close(G.homography_warp3d(x, eye, (4, 5, 6), mode, align_corners=align_corners), x, 0, 2e-6)


def test_shears_in_space_keep_their_center(device):
    center = torch.tensor([[1.0, 2, 3]], device=device)
    angles = {
        name: torch.tensor([0.1 * i], device=device)
        for i, name in enumerate(("sxy", "sxz", "syx", "syz", "szx", "szy"))
    }
    M = G.get_shear_matrix3d(center, **angles)
    assert_close((M[:, :3, :3] @ center[..., None])[..., 0] + M[:, :3, 3], center)


def test_splines_go_through_their_points(device):
    p, q = torch.rand(2, 9, 2, device=device) * 2 - 1, torch.rand(2, 9, 2, device=device)
    assert_close(G.warp_points_tps(p, p, *G.get_tps_transform(p, q)), q, 0, 1e-4)


def test_perspective_of_points_on_a_line_is_not_finite(device):
    line = torch.tensor([[[0.0, 0], [1, 1], [2, 2], [0, 3]]], device=device)
    assert not G.get_perspective_transform(line, SQUARE.to(device)).isfinite().all()


# --- resize ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["bilinear", "bicubic"])
def test_antialias_is_that_of_torch(mode, device):
    x = torch.rand(2, 3, 33, 40, device=device)
    expected = F.interpolate(x, (9, 50), mode=mode, antialias=True)
    assert_close(G.resize(x, (9, 50), mode, antialias=True), expected)


def test_gaussian_antialias_is_that_of_kornia(device):
    kornia = pytest.importorskip("kornia")
    x = torch.rand(2, 3, 33, 40)
    expected = kornia.geometry.resize(x, (9, 13), antialias=True)
    assert_close(G.resize(x.to(device), (9, 13), antialias="gaussian").cpu(), expected, 1e-4, 1e-5)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.uint8, torch.int32], ids=str)
def test_types(dtype, device):
    x = (torch.rand(1, 3, 12, 14, device=device) * 200).to(dtype)
    wide = x.float()
    stored = dtype if dtype != torch.int32 else torch.float32
    angle, box = torch.tensor([25.0], device=device), 2 * QUAD.to(device)
    for call in (
        lambda s: G.rotate(s, angle),
        lambda s: G.resize(s, (5, 20)),
        lambda s: G.crop_and_resize(s, box, (6, 6)),
        lambda s: G.center_crop(s, (5, 8)),
        lambda s: G.elastic_transform2d(s, torch.zeros(1, 2, 12, 14, device=device) + 0.1, (3, 3), (1.0, 1.0)),
    ):
        found = call(x)
        expected = call(wide)
        if dtype == torch.uint8:
            expected = expected.round()
        assert_close(found.float(), expected.to(stored).float(), 1e-2, 1.01)
        assert found.dtype == stored


def test_nothing_waits_for_the_device(device):
    """Small tensors are filled in where they are used, not copied there."""
    if device.type != "cuda":
        pytest.skip("needs --device cuda")
    x, v = torch.rand(1, 3, 12, 14, device=device), torch.rand(1, 1, 4, 5, 6, device=device)
    angle, box = torch.tensor([25.0], device=device), QUAD.to(device)
    M, box3d = torch.eye(3, device=device)[None], G.bbox_generator3d(*torch.ones(6, 1, device=device))
    noise = torch.zeros(1, 2, 12, 14, device=device)
    calls = (
        lambda: G.rotate(x, angle),
        lambda: G.warp_perspective(x, M, (5, 5), padding_mode="fill", fill_value=0.5),
        lambda: G.resize(x, (5, 20), antialias=True),
        lambda: G.build_laplacian_pyramid(x, 2),
        lambda: G.ScalePyramid(min_size=4)(x),
        lambda: G.crop_and_resize(x, box, (6, 6)),
        lambda: G.center_crop(x, (5, 8)),
        lambda: G.rot180(x),
        lambda: G.elastic_transform2d(x, noise, (3, 3), (1.0, 1.0)),
        lambda: G.rotate3d(v, angle, angle, angle),
        lambda: G.center_crop3d(v, (2, 3, 3)),
        lambda: G.crop_and_resize3d(v, box3d, (2, 2, 2)),
    )
    does_not_wait(device, calls)


# --- gradients ------------------------------------------------------------------------------------------------------

IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
VOLUME = torch.rand(1, 1, 3, 4, 3, generator=torch.Generator().manual_seed(2)).double()
FUNCTIONS = {
    "rotate": (lambda x, a: G.rotate(x, a), (IMAGE, torch.tensor([17.0]))),
    "scale": (lambda x, s: G.scale(x, s), (IMAGE, torch.tensor([[1.27, 0.83]]))),
    "crop_and_resize": (lambda x, b: G.crop_and_resize(x, b, (3, 4)), (IMAGE, QUAD)),
    "perspective": (G.get_perspective_transform, (SQUARE + 0.1 * QUAD, QUAD)),
    "resize": (lambda x: G.resize(x, (3, 9)), (IMAGE,)),
    "pyrdown": (G.pyrdown, (IMAGE,)),
    "elastic": (
        lambda x, n, s, a: G.elastic_transform2d(x, n, (3, 3), s, a),
        (IMAGE, IMAGE * 0.2, torch.tensor([1.0, 1.3]), torch.tensor([0.3, 0.4])),
    ),
    "volume": (
        lambda x, m: G.warp_perspective3d(x, m, (2, 3, 3)),
        (VOLUME, torch.eye(4)[None] + 0.03 * torch.rand(1, 4, 4)),
    ),
    "rotate3d": (lambda x, a: G.rotate3d(x, a, a * 0.3, a * 0.7), (VOLUME, torch.tensor([11.0]))),
    "spline": (
        lambda x, p, q: G.warp_image_tps(x, p, *G.get_tps_transform(p, q)),
        (IMAGE, 0.3 * QUAD - 0.9, 0.29 * QUAD - 0.83),
    ),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


def test_gradients_without_rotation_are_finite(device):
    angles = torch.zeros(1, 3, device=device, requires_grad=True)
    ones = torch.ones(1, 3, device=device)
    (grad,) = torch.autograd.grad(G.get_projective_transform(ones, angles, ones)[0, 0, 1], angles)
    assert grad.isfinite().all() and grad.any()


# --- bad arguments --------------------------------------------------------------------------------------------------

X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.rotate([1.0], torch.ones(1)), TypeError, "rotate: expected tensor to be a Tensor, got list"),
    (lambda: G.rotate(X[0, 0], torch.ones(1)), ValueError, r"rotate: expected tensor of shape \(B, C, H, W\)"),
    (lambda: G.rotate(X, torch.ones(3)), ValueError, "rotate: expected angle with 1 or 2 rows"),
    (lambda: G.translate(X, torch.ones(2, 3)), ValueError, r"translate: expected translation of shape \(B, 2\)"),
    (lambda: G.scale(X, 2.0), TypeError, "scale: expected scale_factor to be a Tensor"),
    (lambda: G.shear(X, torch.ones(2, 2), "linear"), ValueError, "shear: mode must be one of"),
    (lambda: G.affine(X, torch.eye(3)[None]), ValueError, r"affine: expected matrix of shape \(B, 2, 3\)"),
    (lambda: G.resize(X, 1.5), TypeError, "resize: expected size"),
    (lambda: G.resize(X, (0, 3)), ValueError, "resize: expected size"),
    (lambda: G.resize(X, 3, side="top"), ValueError, "resize: side must be one of short, long, vert, horz"),
    (lambda: G.resize(X, 3, antialias="box"), TypeError, "resize: expected antialias to be a bool"),
    (lambda: G.resize(X[0, 0, 0], 3), ValueError, r"resize: expected input of shape \(\*, H, W\)"),
    (lambda: G.rescale(X, 0.1), ValueError, "rescale: expected factor to leave a pixel"),
    (lambda: G.pyrdown(X[0]), ValueError, r"pyrdown: expected input of shape \(B, C, H, W\)"),
    (lambda: G.build_pyramid(X, 0), ValueError, "build_pyramid: expected max_level"),
    (lambda: G.center_crop(X[0], (2, 2)), ValueError, "center_crop: expected input_tensor of shape"),
    (lambda: G.crop_and_resize(X, torch.ones(2, 4), (2, 2)), ValueError, "crop_and_resize: expected boxes of shape"),
    (lambda: G.crop_by_boxes(X, QUAD, QUAD), ValueError, "crop_by_boxes: expected src_box of rectangles"),
    (lambda: G.crop_by_indices(X, QUAD), ValueError, "crop_by_indices: expected src_box of shape"),
    (lambda: G.crop_by_transform_mat(X, torch.eye(4)[None], (2, 2)), ValueError, "crop_by_transform_mat: expected transform"),
    (lambda: G.CenterCrop2D((9, 9))(X), ValueError, "CenterCrop2D: expected input of at least"),
    (lambda: G.warp_affine3d(X, torch.eye(3, 4)[None], (1, 1, 1)), ValueError, "warp_affine3d: expected src of shape"),
    (lambda: G.warp_affine3d(V, torch.eye(3, 4)[None], (1, 1, 1), "bicubic"), ValueError, "warp_affine3d: mode must be"),
    (lambda: G.rotate3d(V, torch.ones(2), torch.ones(1), torch.ones(1)), ValueError, "rotate3d: expected yaw of shape"),
    (lambda: G.get_rotation_matrix2d(torch.ones(1, 2), torch.ones(2), torch.ones(1, 2)), ValueError, "of one batch size"),
    (lambda: G.get_rotation_matrix2d(torch.ones(1, 2).int(), torch.ones(1), torch.ones(1, 2)), TypeError, "center to be floating"),
    (lambda: G.get_perspective_transform(QUAD, QUAD.double()), TypeError, "get_perspective_transform: expected points of one"),
    (lambda: G.hflip(torch.ones(3)), ValueError, r"hflip: expected input of shape \(\*, H, W\)"),
    (lambda: G.elastic_transform2d(X, X), ValueError, "elastic_transform2d: expected noise of shape"),
    (lambda: G.get_tps_transform(QUAD, QUAD[0]), ValueError, "get_tps_transform: expected points_dst of shape"),
    (lambda: G.Affine(), RuntimeError, "Affine: expected at least one of"),
    (lambda: G.Affine(torch.ones(1), torch.ones(2, 2)), RuntimeError, "Affine: expected parameters of one batch size"),
    (lambda: G.ImageRegistrator("affine"), ValueError, "ImageRegistrator: model_type must be one of"),
    (lambda: G.ImageRegistrator(G.Homography()), ValueError, "ImageRegistrator: expected a warper"),
    (lambda: G.ImageRegistrator().register(X, X[:1]), ValueError, "ImageRegistrator: expected images of one shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


# --- registration ---------------------------------------------------------------------------------------------------


def blobs(size: int, device: torch.device) -> Tensor:
    picture = torch.zeros(1, 1, size, size, device=device)
    generator = torch.Generator().manual_seed(3)
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, size, device=device)] * 2, indexing="ij")
    for cx, cy, height in (torch.rand(12, 3, generator=generator) * 1.6 - 0.8).tolist():
        picture += height * torch.exp(-25 * ((x - cx) ** 2 + (y - cy) ** 2))
    return picture


@pytest.mark.parametrize("model", ["translation", "similarity", "homography"])
def test_registration_finds_the_transform(model, device):
    source = blobs(64, device)
    truth = torch.eye(3, device=device)[None]
    truth[0, :2, 2] = torch.tensor([0.06, -0.04])
    if model == "similarity":
        truth[0, :2, :2] *= 1.05
    if model == "homography":
        truth[0, 0, 1], truth[0, 1, 0], truth[0, 2, 0] = 0.04, -0.04, 0.01
    target = G.homography_warp(source, truth, (64, 64))
    rate = 2e-3 if model == "homography" else 5e-3
    registrator = G.ImageRegistrator(model, pyramid_levels=3, lr=rate, num_iterations=80, tolerance=0).to(device)
    found, levels = registrator.register(source, target, output_intermediate_models=True)
    corners = torch.tensor([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], device=device).T
    moved, expected = found[0] @ corners, truth[0] @ corners
    error = (moved[:2] / moved[2] - expected[:2] / expected[2]).norm(dim=0).mean() * 32
    assert len(levels) == 3
    assert error < 0.5  # pixels
    there_and_back = registrator.model() @ registrator.model.forward_inverse()
    assert_close(there_and_back / there_and_back[:, 2:, 2:], torch.eye(3, device=device)[None], 0, 1e-5)
    inside = (slice(None), slice(None), slice(8, -8), slice(8, -8))
    assert (registrator.warp_src_into_dst(source) - target)[inside].abs().mean() < 0.02
    assert (registrator.warp_dst_into_src(target) - source)[inside].abs().mean() < 0.02


def test_registration_with_any_loss(device):
    """Losses that are not computed in one pass are computed step by step, with nearly the same result."""
    source, target = blobs(48, device), blobs(48, device).roll((1, 2), (2, 3))
    model = torch.eye(3, device=device)[None]
    fused = G.ImageRegistrator().get_single_level_loss(source, target, model)
    plain = G.ImageRegistrator(loss_fn=lambda a, b, reduction: F.l1_loss(a, b, reduction=reduction))
    assert_close(plain.get_single_level_loss(source, target, model), fused, 0.05, 0)
