import contextlib
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import fresh
import kvision as K
from kvision._modes import INTERPOLATION, PADDING
from kvision.geometry.transform import sampling
from kvision.geometry.transform.sampling import remap
from op_tests import assert_close, instruction_set, pairwise, with_layout
from warp_tests import WarpTests, affine, homography, one

G = K.geometry
MODES = ("bilinear", "nearest", "bicubic")
PADDINGS = ("zeros", "border", "reflection")
WARP = ("warp", "warp_image_backward", "warp_matrix_backward")


class TestWarpAffine(WarpTests):
    function = staticmethod(G.warp_affine)
    operators = WARP
    compiler = "inductor"
    max_size = 7
    variants = [
        {"M": affine, "dsize": (8, 11)},
        {"M": one(affine), "dsize": (5, 21), "mode": "nearest", "padding_mode": "reflection"},
        {"M": affine, "dsize": (7, 9), "mode": "bicubic", "padding_mode": "border"},
    ]
    errors = [
        ({"M": lambda x: torch.eye(3)[None]}, ValueError, r"expected M of shape \(B, 2, 3\), got \(1, 3, 3\)"),
        ({"M": lambda x: torch.ones(3, 2, 3)}, ValueError, "expected M with a batch size of 1 or 2"),
        ({"M": [[1.0]]}, TypeError, "M to be a Tensor"),
        ({"dsize": (0, 3)}, ValueError, "dsize to be an int or 2 ints of at least 1"),
        ({"dsize": (1.5, 3)}, TypeError, "dsize"),
        ({"mode": "linear"}, ValueError, "mode must be one of bilinear, nearest, bicubic; got 'linear'"),
        ({"padding_mode": "wrap"}, ValueError, "padding_mode must be one of"),
        ({"align_corners": None}, TypeError, "align_corners to be a bool"),
        ({"padding_mode": "fill", "fill_value": lambda x: torch.ones(5)}, ValueError, "expected fill_value of shape"),
    ]


class TestWarpPerspective(WarpTests):
    function = staticmethod(G.warp_perspective)
    operators = WARP
    max_size = 7
    variants = [
        {"M": homography, "dsize": (6, 10), "padding_mode": "fill", "fill_value": lambda x: torch.rand(x.shape[1])},
    ]


class TestHomographyWarp(WarpTests):
    function = staticmethod(G.homography_warp)
    operators = WARP
    max_size = 7
    variants = [
        {"src_homo_dst": lambda x: unit_homography(x), "dsize": (7, 11)},
    ]


def unit_homography(x: Tensor) -> Tensor:
    m = torch.tensor([[0.83, 0.17, 0.061], [-0.13, 0.91, -0.047], [0.11, -0.07, 1.03]], dtype=torch.float64)
    return m + 0.013 * torch.arange(len(x))[:, None, None]


class TestRemap(WarpTests):
    function = staticmethod(G.remap)
    operators = ("remap", "remap_image_backward", "remap_map_backward")
    max_size = 7
    variants = [
        {"map_x": lambda x: coords(x, 3), "map_y": lambda x: coords(x, 2)},
        {
            "map_x": one(lambda x: coords(x, 3) / 9),
            "map_y": one(lambda x: coords(x, 2) / 7),
            "normalized_coordinates": True,
            "mode": "bicubic",
            "padding_mode": "border",
        },
    ]
    errors = [
        ({"map_y": lambda x: torch.ones(2, 3, 3)}, ValueError, "expected map_y of shape"),
        ({"padding_mode": "fill"}, ValueError, "padding_mode must be one of zeros, border, reflection"),
    ]


def coords(x: Tensor, axis: int) -> Tensor:
    """In, around and between the pixels along an axis of x, (B, 5, 7); no coordinate is close to where taps change."""
    n = x.shape[axis]
    whole = torch.randint(-2, n + 2, (len(x), 5, 7), generator=torch.Generator().manual_seed(axis))
    return whole + 0.1 + 0.3 * torch.rand(len(x), 5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(7))


# --- against torch and OpenCV ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("mode", MODES)
def test_values_and_gradients_are_those_of_grid_sample(mode, padding, align_corners, device):
    x = torch.rand(2, 3, 9, 12, dtype=torch.float64, device=device, requires_grad=True)
    grid = (torch.rand(2, 8, 7, 2, dtype=torch.float64, device=device) * 6 - 3).requires_grad_()
    weight = torch.rand(2, 3, 8, 7, dtype=torch.float64, device=device)
    theirs = F.grid_sample(x, grid, mode, padding, align_corners)
    ours = G.remap(x, grid[..., 0], grid[..., 1], mode, padding, align_corners, normalized_coordinates=True)
    assert_close(ours, theirs)
    for ours_, theirs_ in zip(*(torch.autograd.grad((y * weight).sum(), (x, grid)) for y in (ours, theirs))):
        assert_close(ours_, theirs_)


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("mode", MODES)
def test_warp_perspective_equals_remap_of_its_coordinates(mode, padding, align_corners, device):
    x = torch.rand(2, 3, 9, 12, dtype=torch.float64, device=device, requires_grad=True)
    M = homography(x).to(device).requires_grad_()
    x_, y_ = torch.arange(14.0, device=device).double(), torch.arange(10.0, device=device).double()[:, None]
    inverse = torch.linalg.inv(M)[..., None, None]
    u, v, w = (inverse[:, i, 0] * x_ + inverse[:, i, 1] * y_ + inverse[:, i, 2] for i in range(3))
    weight = torch.rand(2, 3, 10, 14, dtype=torch.float64, device=device)
    theirs = G.remap(x, u / w, v / w, mode, padding, align_corners)
    ours = G.warp_perspective(x, M, (10, 14), mode, padding, align_corners)
    assert_close(ours, theirs)
    for ours_, theirs_ in zip(*(torch.autograd.grad((y * weight).sum(), (x, M)) for y in (ours, theirs))):
        assert_close(ours_, theirs_)


@pytest.mark.parametrize("isa", ["avx512", "avx2", "baseline"])
@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("mode", MODES)
def test_displacements_equal_absolute_coordinates(mode, align_corners, isa, device):
    like = {"dtype": torch.float64, "device": device}
    x = torch.rand(2, 3, 17, 133, **like, requires_grad=True)
    moves = (torch.rand(2, 2, 17, 133, **like) * 0.2 - 0.1).requires_grad_()
    weight = torch.rand(2, 3, 17, 133, **like)
    grid = F.affine_grid(torch.eye(2, 3, **like)[None], (1, 1, 17, 133), align_corners).movedim(-1, 1)
    with instruction_set(isa) if device.type == "cpu" else contextlib.nullcontext():
        ours = remap(x, *moves.unbind(1), None, None, INTERPOLATION[mode], PADDING["fill"], align_corners, True, True)
        theirs = remap(
            x, *(grid + moves).unbind(1), None, None, INTERPOLATION[mode], PADDING["fill"], align_corners, True, False
        )
        assert_close(ours, theirs)
        for ours_, theirs_ in zip(*(torch.autograd.grad((y * weight).sum(), (x, moves)) for y in (ours, theirs))):
            assert_close(ours_, theirs_)


OPENCV = {"bilinear": (cv2.INTER_LINEAR, 2e-5), "nearest": (cv2.INTER_NEAREST, 0), "bicubic": (cv2.INTER_CUBIC, 3e-5)}
# From pixels of the result to those of the image. The last row is that of warpPerspective.
TO_SOURCE = np.float64([[0.75, 0.125, 0.171], [-0.25, 0.875, 9.104], [1.1e-3, -4e-4, 1]])


@pytest.mark.parametrize("mode", MODES)
def test_values_of_opencv(mode, device):
    """OpenCV 5 samples float32 images of 1, 3 and 4 channels at the exact coordinates."""
    flag, tolerance = OPENCV[mode]
    picture = np.random.default_rng(0).random((60, 80, 3), np.float32)
    affine = np.vstack([TO_SOURCE[:2], [0, 0, 1]])
    for matrix, theirs in (
        (affine, cv2.warpAffine(picture, affine[:2], (90, 70), flags=flag | cv2.WARP_INVERSE_MAP)),
        (TO_SOURCE, cv2.warpPerspective(picture, TO_SOURCE, (90, 70), flags=flag | cv2.WARP_INVERSE_MAP)),
    ):
        ours = G.homography_warp(
            to_tensor(picture, device),
            torch.from_numpy(matrix).float()[None].to(device),
            (70, 90),
            mode,
            align_corners=True,
            normalized_homography=False,
        )
        assert_close(ours.cpu(), to_tensor(theirs, "cpu"), 0, tolerance)
    u, v = (np.random.default_rng(n).uniform(-2, n, (50, 40)).astype(np.float32) for n in (82, 62))
    ours = G.remap(
        to_tensor(picture, device), *(torch.from_numpy(m)[None].to(device) for m in (u, v)), mode, align_corners=True
    )
    assert_close(ours.cpu(), to_tensor(cv2.remap(picture, u, v, flag), "cpu"), 0, tolerance)


@pytest.mark.parametrize(
    "name, k, expected",
    [
        *[("graf", 2, 0.888), ("graf", 3, 0.855), ("wall", 3, 0.873), ("boat", 3, 0.939)],
        *[("leuven", 4, 0.953), ("bikes", 3, 0.981), ("ubc", 4, 0.979)],
    ],
)
def test_real_pairs(name, k, expected, data, device):
    """Warped back by a measured homography, a photograph correlates with the other one as it did when that was measured."""
    folder = data / "homography" / name
    first, other = (K.color.rgb_to_grayscale(picture(folder / f"img{i}.png", device)) for i in (1, k))
    numbers = [float(number) for number in (folder / f"H_1_{k}.txt").read_text().split()]
    from_first = torch.tensor(numbers, device=device).reshape(1, 3, 3)
    to_first = torch.linalg.inv(from_first.double()).float()
    back, inside = (G.warp_perspective(x, to_first, tuple(first.shape[2:])) for x in (other, torch.ones_like(other)))
    both = torch.stack([first[inside > 0.999], back[inside > 0.999]])
    assert abs(torch.corrcoef(both)[0, 1].item() - expected) < 2e-3


def picture(path: Path, device) -> Tensor:
    return K.io.load_image(path, K.io.ImageLoadType.RGB32, device)[None]


def to_tensor(picture: np.ndarray, device) -> Tensor:
    return torch.from_numpy(picture).permute(2, 0, 1)[None].to(device)


# --- exact results --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16, torch.uint8], ids=str)
@pytest.mark.parametrize("mode", MODES)
def test_integer_shifts_and_quarter_turns_are_exact(mode, dtype, device):
    x = (torch.rand(1, 2, 37, 53, device=device) * 255).to(dtype)

    def warped(matrix: list[list[float]], size: tuple[int, int]) -> Tensor:
        return G.warp_affine(x, torch.tensor([matrix], device=device), size, mode)

    assert torch.equal(warped([[1.0, 0, 0], [0, 1, 0]], (37, 53)), x)
    assert torch.equal(warped([[1.0, 0, 5], [0, 1, -3]], (37, 53))[..., :34, 5:], x[..., 3:, :48])
    assert torch.equal(warped([[0.0, 1, 0], [-1, 0, 52]], (53, 37)), x.rot90(1, (2, 3)))
    assert torch.equal(warped([[-1.0, 0, 52], [0, -1, 36]], (37, 53)), x.flip(2, 3))
    assert torch.equal(warped([[1.0, 0, -9], [0, 1, -8]], (1, 1)), x[..., 8:9, 9:10])


@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("mode", MODES)
def test_identities(mode, align_corners, device):
    x = torch.rand(2, 3, 16, 32, device=device)
    y, columns = torch.meshgrid(torch.arange(16.0), torch.arange(32.0), indexing="ij")
    eye = torch.eye(3, device=device)[None]
    options = {"mode": mode, "align_corners": align_corners}
    assert torch.equal(G.remap(x, columns[None].to(device), y[None].to(device), **options), x)
    assert_close(G.homography_warp(x, eye, (16, 32), **options), x, 0, 1e-6)
    assert torch.equal(G.homography_warp(x, eye, (16, 32), normalized_homography=False, **options), x)
    assert torch.equal(G.warp_perspective(x, -3 * eye, (16, 32), **options), x)  # a homography has no scale


# --- coords and pixels that are no numbers --------------------------------------------------------------------------


@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("mode", MODES)
def test_coords_at_infinity(mode, padding, device):
    x = torch.rand(1, 2, 5, 6, device=device).requires_grad_()
    far = torch.tensor(
        [[[float("nan"), float("inf"), -float("inf"), 1e30, -1e30, 3e9]]], device=device
    ).requires_grad_()
    for map_x, map_y in ((far, torch.ones_like(far)), (torch.ones_like(far), far)):
        result = G.remap(x, map_x, map_y, mode, padding)
        assert result.isfinite().all()
        assert padding != "zeros" or not result.any()
        assert all(g.isfinite().all() for g in torch.autograd.grad(result.sum(), (x, far)))
    horizon = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0.5, 0, -1]]], device=device).requires_grad_()  # w = 0 at x = 2
    result = G.homography_warp(x, horizon, (5, 6), mode, padding, normalized_homography=False)
    assert result.isfinite().all()
    assert all(g.isfinite().all() for g in torch.autograd.grad(result.sum(), (x, horizon)))


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("mode", MODES)
def test_taps_of_weight_zero_are_harmless(mode, bad, device):
    x = torch.rand(1, 2, 33, 40, device=device)
    x[0, 1, 20, 19] = bad
    identity = torch.tensor([[[1.0, 0, 0], [0, 1, 0]]], device=device)
    assert_close(G.warp_affine(x, identity, (33, 40), mode), x, 0, 0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("map", ["near", "constant", "anywhere", "magnified"])
def test_image_gradients_of_maps(map, padding, mode, device):  # coords that share taps, and coords that are far apart
    h, w = 70, 44
    y, x = torch.meshgrid(torch.arange(0.0, h), torch.arange(0.0, w), indexing="ij")
    noise = torch.rand(2, 2, h, w)
    u, v = {
        "near": (x + 3 * noise[:, 0] - 1, y + 3 * noise[:, 1] - 2),
        "constant": (x * 0 + 20.3 + noise[:, 0] * 0, y * 0 + 9.6 + noise[:, 1] * 0),
        "anywhere": (60 * noise[:, 0] - 8, 90 * noise[:, 1] - 10),
        "magnified": (x * 0.31 - 3 + noise[:, 0] * 0, y * 0.31 + 50 + noise[:, 1] * 0),
    }[map]
    u, v = ((64 * c).floor() / 64 + 1 / 128 for c in (u, v))  # not within a rounding error of the middle of two pixels
    u, v, grad = u.double().to(device), v.double().to(device), torch.rand(2, 4, h, w).double().to(device)
    image = torch.rand(2, 4, h, w, dtype=torch.float64, device=device, requires_grad=True)
    ours = torch.autograd.grad(G.remap(image, u, v, mode, padding, align_corners=True), image, grad)[0]
    grid = torch.stack([2 * u / (w - 1) - 1, 2 * v / (h - 1) - 1], -1)
    theirs = torch.autograd.grad(F.grid_sample(image, grid, mode, padding, align_corners=True), image, grad)[0]
    assert_close(ours, theirs, 0, 1e-8)
    single = torch.autograd.grad(
        G.remap(image.float(), u.float(), v.float(), mode, padding, align_corners=True), image, grad.float()
    )[0]
    assert_close(single, theirs, 1e-3, 1e-3)


def test_singular_matrices(device):
    x = torch.rand(1, 1, 4, 4, device=device, requires_grad=True)
    M = torch.zeros(1, 3, 3, device=device, requires_grad=True)
    result = G.warp_perspective(x, M, (4, 4))
    assert all(g.isfinite().all() for g in torch.autograd.grad(result.sum(), (x, M)))


# --- precision, layouts, batches ------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_half_images_have_coords_in_float(mode, device):
    """The bits of a float32 image's result, rounded."""
    x = torch.rand(1, 2, 6, 2048, device=device).half()
    M = torch.tensor([[[0.9, 0.013, 100.3], [0.002, 1, -0.37]]], device=device)
    half = G.warp_affine(x, M, (6, 1900), mode, "border")
    assert torch.equal(half, G.warp_affine(x.float(), M, (6, 1900), mode, "border").half())


def test_coords_in_wide_images(device):
    """A ramp shows them."""
    ramp = torch.arange(2048, device=device) % 64
    M = torch.tensor([[[0.9, 0.0, 100.3], [0, 1, 0]]], device=device)
    exact = (torch.arange(1900, device=device).double() - M[0, 0, 2].double()) / M[0, 0, 0].double()
    result = G.warp_affine(ramp.float().expand(1, 1, 2, -1), M, (2, 1900), padding_mode="border")[0, 0, 0]
    plain = (exact > 0) & (exact % 64 < 63) & (exact < 2047)
    assert (result - exact % 64)[plain].abs().max() < 1e-4


@pytest.mark.slow
def test_more_elements_than_an_int_counts(device):
    """Every kernel that writes images: what the last of three images gets is what it gets alone."""
    side = 28000
    if device.type != "cuda" or torch.cuda.mem_get_info()[0] < 24 << 30:
        pytest.skip("needs a GPU with 24 GiB of free memory")
    x = torch.zeros(3, 1, side, side, dtype=torch.uint8, device=device)
    assert x.numel() > 2**31
    x[2, :, -999:, -999:] = torch.randint(0, 256, (999, 999), dtype=torch.uint8, device=device)
    M = torch.tensor([[[0.99, 0.02, -3.3], [-0.01, 1.0, 150.2]]], device=device)
    v, u = torch.meshgrid(
        *[torch.arange(side - 1500, side, device=device, dtype=torch.float32) - 0.3] * 2, indexing="ij"
    )
    for call in (
        lambda x: G.warp_affine(x, M, (side, side)),
        lambda x: G.remap(x, u[None], v[None], align_corners=True),
        lambda x: G.resize(x, (side + 5, side - 3)),
        lambda x: G.resize(x, (side // 3, side // 3), antialias=True),
        lambda x: G.pyrdown(x),
        lambda x: G.rot180(x),
    ):
        last = call(x)[2]
        assert last.any() and torch.equal(last, call(x[2:])[0])
        del last


def test_one_image_serves_many_matrices(device):
    x = torch.rand(1, 3, 9, 8, device=device, requires_grad=True)
    M = affine(torch.zeros(4)).float().to(device)
    many = G.warp_affine(x, M, (7, 9))
    each = torch.cat([G.warp_affine(x, m[None], (7, 9)) for m in M])
    assert torch.equal(many, each)
    assert_close(torch.autograd.grad(many.sum(), x)[0], torch.autograd.grad(each.sum(), x)[0])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16], ids=str)
@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("mode", MODES)
def test_bits_do_not_depend_on_where_rows_begin(mode, padding, dtype, device):
    """On CUDA source tiles are copied by vectors wherever rows begin, and pixels next to the border one by one."""
    x = torch.rand(3, 3, 71, 136, device=device).to(dtype)
    M = affine(torch.zeros(3)).float().to(device) * torch.tensor([[1.0, 1, 20], [1, 1, -10]], device=device)
    expected = G.warp_affine(x, M, (70, 130), mode, padding)
    map_x, map_y = (
        torch.rand(1, 70, 130, device=device) * 40 - 4 + torch.arange(130.0, device=device) for _ in range(2)
    )
    mapped = G.remap(x, map_x, map_y, mode, padding)
    for before in range(4):
        wider = torch.zeros(3, 3, 74, 136 + 2 * before + 1, device=device, dtype=dtype)
        inner = wider[..., 2:-1, before : 136 + before].copy_(x)
        assert torch.equal(G.warp_affine(inner, M, (70, 130), mode, padding), expected)
        assert torch.equal(G.remap(inner, map_x, map_y, mode, padding), mapped)


@pytest.mark.large
@pytest.mark.parametrize("padding", PADDINGS)
@pytest.mark.parametrize("mode", MODES)
def test_large_images_of_odd_rows(mode, padding, device):
    x = torch.rand(2, 3, 335, 513, dtype=torch.float64, device=device)
    M = affine(torch.zeros(2)).to(device)
    weight = torch.rand(2, 3, 300, 481, dtype=torch.float64, device=device)
    results = []
    for image in (x, x.float()):
        image.requires_grad_()
        result = G.warp_affine(image, M.to(image.dtype), (300, 481), mode, padding)
        (grad,) = torch.autograd.grad((result * weight.to(result.dtype)).sum(), image)
        results.append((result.detach().double(), grad.double()))
    differs = (results[0][0] - results[1][0]).abs() > 1e-4
    assert differs.double().mean() < (1e-3 if mode == "nearest" else 1e-9)  # coords between two pixels
    differs = (results[0][1] - results[1][1]).abs() > 1e-3
    assert differs.double().mean() < (1e-2 if mode == "nearest" else 1e-9)


@pytest.mark.large
def test_one_map_serves_a_batch(device):
    """On CUDA a block takes a tile of several images in turn where they have the same map."""
    x = torch.rand(70, 3, 256, 250, device=device, requires_grad=True)
    map_x = torch.rand(1, 256, 250, device=device) * 9 - 4 + torch.arange(250.0, device=device)
    map_y = torch.rand(1, 256, 250, device=device) * 9 - 4 + torch.arange(256.0, device=device)[:, None]
    one_map = G.remap(x, map_x, map_y)
    of_each = G.remap(x, map_x.repeat(70, 1, 1), map_y.repeat(70, 1, 1))
    assert torch.equal(one_map, of_each)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float16])
@pytest.mark.parametrize("mode", MODES)
def test_results_by_maps_depend_on_no_alignment(mode, dtype, device):
    """On CUDA maps of whole vectors are read by these."""
    x = torch.rand(2, 3, 90, 70, device=device).to(dtype)
    shape = (2, 67, 100)
    maps = [
        torch.rand(shape, device=device) * 8
        - 4
        + torch.arange(float(shape[i]), device=device).view(-1, *(1,) * (i == 1))
        for i in (2, 1)
    ]
    result = G.remap(x, *maps, mode)
    for first, last, step in ((1, 0, 1), (0, 1, 1), (0, 0, 2)):
        others = [torch.full((2, 67, first + step * 100 + last), float("nan"), device=device) for _ in maps]
        parts = [other[..., first : first + step * 100 : step] for other in others]
        for part, map in zip(parts, maps):
            part.copy_(map)
        assert torch.equal(G.remap(x, *parts, mode), result)
    assert torch.equal(G.remap(x, *(map[:, :, :99] for map in maps), mode), result[..., :99])


def test_maps_of_very_wide_images(device):
    """Coordinates from 2^20 on are no last bits of sums of floats."""
    x = torch.rand(1, 1, 2, 1 << 21, device=device)
    at = torch.tensor([3.0, 70000.0, (1 << 20) + 7.0, (1 << 21) - 2.0], device=device)
    row = torch.tensor([0.0, 1.0, 1.0, 0.0], device=device)
    assert torch.equal(G.remap(x, at[None, None], row[None, None])[0, 0, 0], x[0, 0, row.long(), at.long()])


# --- more samples than images ---------------------------------------------------------------------------------------


def samples_on(device: torch.device) -> int:
    """On CUDA more than a block of the kernel looks at together."""
    return 300 if device.type == "cuda" else 40


def patches(count: int, h: int, w: int) -> Tensor:
    """Homographies to patches anywhere in images of that size, some out of bounds."""
    generator = torch.Generator().manual_seed(3)
    angle, x, y = (torch.rand(count, dtype=torch.float64, generator=generator) for _ in range(3))
    x, y, angle = (1.3 * x - 0.2) * w, (1.3 * y - 0.2) * h, 6 * angle
    cos, sin, zero = angle.cos() * 1.2, angle.sin() * 0.8, 0 * x
    rows = (cos, -sin, x, sin, cos, y, zero + 0.003, zero - 0.002, zero + 1)
    return torch.linalg.inv(torch.stack(rows, 1).reshape(count, 3, 3))


def many(kind: str, x: Tensor, index: Tensor | None, count: int, mode: str, padding: str):
    """A call of `count` samples of the images of x, as a function of the images and what says where they are."""
    M, size = patches(count, *x.shape[2:]).to(x.device), (11, 14)
    options = INTERPOLATION[mode], PADDING[padding], True
    if kind == "warp":
        M = M.double() if x.dtype == torch.float64 else M.float()
        return lambda x, M, index: sampling.warp(x, M, None, index, list(size), *options, True, False), (M,)
    coords = sampling.source_coords(M, size, x.shape[2:], True, True, False)
    coords = [p.double() if x.dtype == torch.float64 else p.float() for p in coords]
    return lambda x, u, v, index: sampling.remap(x, u, v, None, index, *options, False, False), coords


@pytest.mark.native
@pytest.mark.parametrize(
    ("warp", "data", "padding"),
    pairwise(
        list(itertools.product(["warp", "remap"], MODES)),
        list(itertools.product([1, 3], [torch.float64, torch.float32, torch.float16])),
        ["fill", "border", "reflection"],
    ),
    ids=str,
)
def test_many_samples_of_few_images(warp, data, padding, device):
    """Values and gradients are those of as many images."""
    (kind, mode), (images, dtype) = warp, data
    x = torch.rand(images, 4, 70, 93, dtype=torch.float64, device=device).to(dtype)
    samples = samples_on(device)
    index = torch.randint(0, images, (samples,), device=device) if images > 1 else None
    call, where = many(kind, x, index, samples, mode, padding)
    every = x.index_select(0, index) if images > 1 else x.expand(samples, -1, -1, -1)
    ours, theirs = call(x, *where, index), call(every, *where, None)
    assert torch.equal(ours, theirs)
    weight = torch.rand(ours.shape, dtype=torch.float64, device=device).to(dtype)

    def gradients(f, x, *args):
        leaves = [a.detach().clone().requires_grad_() for a in (x, *where)]
        return torch.autograd.grad((f(*leaves, *args) * weight).sum(), leaves)

    ours, theirs = gradients(call, x, index), gradients(call, every, None)
    for a, b in zip(ours[1:], theirs[1:]):
        assert torch.equal(a, b)
    added = torch.zeros(x.shape, dtype=torch.float64, device=device)
    which = torch.zeros(samples, dtype=torch.int64, device=device) if index is None else index
    added.index_add_(0, which, theirs[0].double())
    assert_close(ours[0], added.to(dtype), *((None, None) if dtype != torch.float16 else (4e-3, 4e-3)))
    with K.backend("reference"):
        reference = gradients(call, x.double(), index)[0] if dtype == torch.float64 else None
    if reference is not None:
        assert_close(ours[0], reference)


@pytest.mark.parametrize("channels", [1, 2, 7])
@pytest.mark.parametrize("layout", ["contiguous", "channels_last"])
def test_gradients_of_many_samples_are_the_same_every_run(layout, channels, device):
    x = torch.rand(2, channels, 70, 93, device=device).requires_grad_()
    index = torch.arange(samples_on(device), device=device) % 2
    call, where = many("warp", x, index, len(index), "bilinear", "fill")
    y = call(x, *where, index)
    weight = with_layout(torch.rand_like(y), layout)
    first, *others = (torch.autograd.grad(y, x, weight, retain_graph=True)[0] for _ in range(3))
    assert all(torch.equal(first, other) for other in others)


@pytest.mark.native  # the reference multiplies them by weights of 0
def test_gradients_that_are_no_numbers(device):
    """Those of samples that do not reach a pixel leave it alone."""
    x = torch.rand(1, 2, 40, 50, device=device, requires_grad=True)
    M = torch.eye(3, device=device).repeat(3, 1, 1)
    M[:, 0, 2] = torch.tensor([0.0, -20.25, -5.5])
    y = G.warp_perspective(x, M, (8, 8))
    weight = torch.rand_like(y)
    weight[1, 1, 3, 4] = float("nan")
    result = torch.autograd.grad(y, x, weight, retain_graph=True)[0]
    assert result.isnan().sum() == 2 and result[0, 1, 3, 24:26].isnan().all()
    plain = torch.autograd.grad(y, x, weight.nan_to_num(), retain_graph=True)[0]
    assert_close(result[~result.isnan()], plain[~result.isnan()])


@pytest.mark.parametrize("images", [1, 2])
def test_derivatives_of_many_samples(images, device):
    x = torch.rand(images, 1, 5, 6, dtype=torch.float64, device=device, requires_grad=True)
    index = torch.tensor([1, 0, 1], device=device) if images > 1 else None
    M = affine(torch.zeros(3)).to(device).requires_grad_()
    fill = torch.rand(3, 1, dtype=torch.float64, device=device, requires_grad=True)

    def f(x: Tensor, M: Tensor, fill: Tensor) -> Tensor:
        return sampling.warp(x, M, fill, index, [3, 4], INTERPOLATION["bicubic"], PADDING["fill"], True, True, False)

    assert torch.autograd.gradcheck(f, (x, M, fill), nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(f, (x, M, fill), fast_mode=True, nondet_tol=1e-9)
    u, v = (coords(torch.zeros(3, 1, 5, 6), axis)[:, :2, :3].to(device).requires_grad_() for axis in (3, 2))

    def g(x: Tensor, u: Tensor, v: Tensor) -> Tensor:
        return sampling.remap(x, u, v, None, index, INTERPOLATION["bilinear"], PADDING["border"], True, False, False)

    torch.use_deterministic_algorithms(device.type == "cuda", warn_only=True)
    try:
        assert torch.autograd.gradcheck(g, (x, u, v), nondet_tol=1e-9)
        assert torch.autograd.gradgradcheck(g, (x, u, v), fast_mode=True, nondet_tol=1e-9)
    finally:
        torch.use_deterministic_algorithms(False)


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("mapped", ["image", "M", "index", "image, M", "image, index", "M, index", "image, M, index"])
@pytest.mark.parametrize("images, rows", [(1, 3), (3, 3), (2, 3), (1, 1), (3, 1)])
def test_vmap_over_samples(images, rows, mapped, indexed, device):
    if indexed == (images == rows) or ("index" in mapped and not indexed):
        pytest.skip("not a call")
    n, like = 4, {"dtype": torch.float64, "device": device}
    x = torch.rand(n, images, 2, 9, 8, **like)
    M = affine(torch.zeros(n * rows)).to(device).unflatten(0, (n, rows))
    index = torch.randint(0, images, (n, rows), device=device)
    options = [7, 9], INTERPOLATION["bilinear"], PADDING["border"], True, True, False

    def call(x: Tensor, M: Tensor, index: Tensor) -> Tensor:
        return sampling.warp(x, M, None, index if indexed else None, *options)

    def gradients(x: Tensor, M: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
        return torch.func.grad(lambda x, M: (call(x, M, index) ** 2).sum(), (0, 1))(x, M)

    dims = tuple(0 if name in mapped.split(", ") else None for name in ("image", "M", "index"))
    args = [a if dim == 0 else a[0] for a, dim in zip((x, M, index), dims)]
    for function in (call, gradients):
        result = torch.func.vmap(function, dims)(*args)
        each = [function(*(a[i] if dim == 0 else a for a, dim in zip(args, dims))) for i in range(n)]
        expected = torch.stack(each) if function is call else tuple(torch.stack(g) for g in zip(*each))
        assert_close(result, expected)


def test_no_samples(device):
    x = torch.rand(1, 2, 6, 7, device=device, requires_grad=True)
    y = G.warp_affine(x, torch.zeros(0, 2, 3, device=device), (4, 5))
    assert y.shape == (0, 2, 4, 5)
    assert not torch.autograd.grad(y.sum(), x)[0].any()
    none = torch.zeros(0, dtype=torch.int64, device=device)
    options = [4, 5], INTERPOLATION["bilinear"], PADDING["border"], True, True, False
    y = sampling.warp(x, torch.zeros(0, 2, 3, device=device), None, none, *options)
    assert y.shape == (0, 2, 4, 5) and not torch.autograd.grad(y.sum(), x)[0].any()


@pytest.mark.tracing
def test_compiled_for_any_number_of_samples(device, backend):
    torch._dynamo.reset()
    x = torch.rand(1, 2, 16, 17, device=device, requires_grad=True)
    f = torch.compile(lambda x, M: G.warp_perspective(x, M, (5, 6)), fullgraph=True, dynamic=True, backend="aot_eager")
    for count in (3, 5):
        M = patches(count, 16, 17).float().to(device)
        assert_close(f(x, M), G.warp_perspective(x, M, (5, 6)))
        ours, theirs = (torch.autograd.grad((y**2).sum(), x)[0] for y in (f(x, M), G.warp_perspective(x, M, (5, 6))))
        assert_close(ours, theirs)


MANY_PATCHES = """
import resource, sys, torch, kvision as K
def step(count):
    image = torch.zeros(1, 3, 1080, 1920, device=sys.argv[1], requires_grad=True)
    M = torch.eye(3, device=sys.argv[1]).repeat(count, 1, 1)
    M[:, :2, 2] = -torch.rand(count, 2, device=sys.argv[1]) * 1000
    K.geometry.warp_perspective(image, M, (32, 32)).sum().backward()
    return image.grad
def peak():
    if sys.argv[1] != "cpu":
        return torch.cuda.max_memory_allocated()
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
step(1)
before = peak()
step(2048)
print((peak() - before) / (4 * 3 * 1080 * 1920))
"""


@pytest.mark.programs
def test_memory_of_many_patches(device, backend):
    """2,048 patches of an image, and their gradient, take the memory of the patches: less than three images."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    result = fresh.run(MANY_PATCHES, device.type)
    assert result.returncode == 0, result.stderr
    assert float(result.stdout) < 3, result.stdout


def test_vmap_over_matrices(device):
    x = torch.rand(1, 2, 9, 8, device=device)
    M = homography(torch.zeros(4)).float().to(device)
    assert_close(
        torch.func.vmap(lambda m: G.warp_perspective(x, m[None], (7, 9)))(M)[:, 0], G.warp_perspective(x, M, (7, 9))
    )


def test_fill_shapes(device):
    x, M = torch.rand(2, 3, 5, 6, device=device), affine(torch.zeros(2)).float().to(device)
    number = G.warp_affine(x, M, (9, 9), padding_mode="fill", fill_value=0.5)
    for fill in (torch.tensor(0.5), torch.full((1,), 0.5), torch.full((3,), 0.5), torch.full((2, 3, 1, 1), 0.5)):
        assert torch.equal(G.warp_affine(x, M, (9, 9), padding_mode="fill", fill_value=fill.to(device)), number)
    blended = G.warp_affine(x, M, (9, 9)) + 0.5 * (1 - G.warp_affine(torch.ones_like(x), M, (9, 9)))
    assert_close(number, blended)
    assert torch.equal(G.warp_affine(x, M, (9, 9), padding_mode="fill"), G.warp_affine(x, M, (9, 9)))


def test_grids(device):
    grid = torch.rand(1, 4, 5, 2, device=device)
    M = homography(torch.zeros(3)).float().to(device)
    homogeneous = torch.cat([grid, torch.ones_like(grid[..., :1])], -1) @ M.mT[:, None]
    assert_close(G.warp_grid(grid, M), homogeneous[..., :2] / homogeneous[..., 2:])


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("layout", ["contiguous", "channels_last", "column_slice"])
@pytest.mark.parametrize("channels", [1, 3, 5])
def test_flips_and_integer_shifts_copy(dtype: torch.dtype, channels: int, layout: str, device: torch.device) -> None:
    """Also beyond the image, where the padding counts, in rows longer than a chunk, and with NaN and inf nearby."""
    x = (255 * torch.rand(2, channels, 5, 150, device=device)).to(dtype)
    if dtype.is_floating_point:
        x[0, 0, 1, 2], x[1, -1, 3, 140] = torch.nan, torch.inf
    x = with_layout(x, layout)
    matrix = dtype if dtype == torch.float64 else torch.float32
    for flips, (right, down), mode in itertools.product(
        ((1, 1), (-1, 1), (1, -1), (-1, -1)), ((0, 0), (7, -2), (-130, 1), (141, 3), (-400, 9)), ("nearest", "bilinear")
    ):
        last = [(n - 1) * (s < 0) for n, s in zip((150, 5), flips)]
        m = torch.tensor([[flips[0], 0, last[0] + right], [0, flips[1], last[1] + down], [0, 0, 1]], dtype=matrix)
        for padding, options in (("zeros", {}), ("border", {}), ("fill", {"fill_value": torch.full((channels,), 3.0)})):
            y = G.warp_perspective(x, m.expand(2, 3, 3).to(device), (6, 145), mode, padding, **options)
            u, v = (
                (s * (torch.arange(n, device=device) - t - e)).long()
                for s, n, t, e in zip(flips, (145, 6), (right, down), last)
            )
            expected = x[:, :, v.clamp(0, 4)[:, None], u.clamp(0, 149)]
            outside = ((v < 0) | (v > 4))[:, None] | (u < 0) | (u > 149)
            if padding != "border":
                expected = expected.masked_fill(outside, 0 if padding == "zeros" else 3)
            assert torch.equal(y.nan_to_num(7), expected.nan_to_num(7)), (flips, right, down, mode, padding)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("layout", ["contiguous", "channels_last"])
@pytest.mark.parametrize("padding", ["zeros", "border", "reflection"])
def test_gradients_of_integer_shifts_copy(dtype: torch.dtype, layout: str, padding: str, device: torch.device) -> None:
    """To the pixels that the result reads, and 0 to the others; where the padding repeats pixels they add up."""
    x = with_layout(torch.rand(2, 3, 5, 150, dtype=dtype, device=device), layout).requires_grad_()
    matrix = dtype if dtype == torch.float64 else torch.float32
    for flips, (right, down), mode in itertools.product(
        ((1, 1), (-1, 1), (1, -1), (-1, -1)), ((0, 0), (-5, -1), (7, -2), (141, 3), (-400, 9)), ("nearest", "bilinear")
    ):
        size = (4, 145) if (right, down) == (-5, -1) else (6, 155)
        last = [(n - 1) * (s < 0) for n, s in zip((150, 5), flips)]
        m = torch.tensor([[flips[0], 0, last[0] + right], [0, flips[1], last[1] + down], [0, 0, 1]], dtype=matrix)
        y = G.warp_perspective(x, m.expand(2, 3, 3).to(device), size, mode, padding)
        grad = with_layout(torch.randint(-4, 5, y.shape, device=device).to(dtype), layout)
        ours = torch.autograd.grad(y, x, grad)[0]
        u, v = (
            (s * (torch.arange(n, device=device) - t - e)).long()
            for s, n, t, e in zip(flips, reversed(size), (right, down), last)
        )
        if padding == "reflection":  # about the centers of the outermost pixels
            u, v = ((at + n - 1).remainder(2 * n - 2).sub(n - 1).abs() for at, n in ((u, 150), (v, 5)))
        outside = ((v < 0) | (v > 4))[:, None] | (u < 0) | (u > 149)
        read = v.clamp(0, 4)[:, None] * 150 + u.clamp(0, 149)
        expected = torch.zeros(2, 3, 5 * 150, dtype=dtype, device=device)
        added = (grad.masked_fill(outside, 0) if padding == "zeros" else grad).flatten(2)
        expected.scatter_add_(2, read.flatten().expand(2, 3, -1), added)
        assert torch.equal(ours.flatten(2), expected), (flips, right, down, mode)
