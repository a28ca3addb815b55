import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from op_tests import assert_close
from warp_tests import WarpTests

G = K.geometry


def shrinking(x: Tensor) -> Tensor:
    """Affine maps (B, 2, 3) to about a third along one slanted axis and a little larger along the other."""
    moves = torch.tensor([[0.3137, 0.1341, 1.3717], [-0.2309, 1.0739, 1.0133]], dtype=torch.float64)
    return moves + 0.0117 * torch.arange(len(x))[:, None, None]


def receding(x: Tensor) -> Tensor:
    last = torch.tensor([[[0.0171, 0.0213, 1.09]]], dtype=torch.float64)
    return torch.cat([shrinking(x), last.expand(len(x), 1, 3)], 1)


def coords(x: Tensor, axis: int) -> Tensor:
    """Coordinates (B, 5, 6) that step over one to four pixels, some of them out of bounds."""
    n = x.shape[axis]
    y, column = torch.meshgrid(torch.arange(5.0), torch.arange(6.0), indexing="ij")
    along = 2.317 * column + 0.413 * y if axis == 3 else 1.719 * y - 0.331 * column
    bent = 0.05 * torch.rand(len(x), 5, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(axis))
    return along - 0.3 * n + bent


class TestWarpAntialiased(WarpTests):
    function = staticmethod(G.warp_perspective)
    operators = ("warp_antialiased", "warp_antialiased_image_backward", "warp_antialiased_matrix_backward")
    max_size = 5
    variants = [
        {
            "M": receding,
            "dsize": (5, 6),
            "padding_mode": "fill",
            "fill_value": lambda x: torch.rand(x.shape[1]),
            "antialias": True,
        },
    ]
    errors = [
        ({"mode": "bicubic"}, ValueError, "expected mode 'bilinear' with antialias, got 'bicubic'"),
        ({"antialias": 1}, TypeError, "antialias to be a bool"),
    ]


class TestRemapAntialiased(WarpTests):
    function = staticmethod(G.remap)
    operators = ("remap_antialiased", "remap_antialiased_image_backward", "remap_antialiased_map_backward")
    max_size = 5
    variants = [
        {
            "map_x": lambda x: coords(x, 3),
            "map_y": lambda x: coords(x, 2),
            "padding_mode": "reflection",
            "antialias": True,
        },
    ]
    errors = [({"mode": "nearest"}, ValueError, "expected mode 'bilinear' with antialias, got 'nearest'")]


# --- against other filters --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(16, 20), (11, 48), (40, 7)], ids=str)
def test_axis_aligned_warps_are_antialiased_resizes(size, device):
    """Those of torch in float64, away from the border, where a resize has no padding."""
    x = torch.rand(2, 3, 40, 48, dtype=torch.float64, device=device)
    (h, w), (height, width) = size, x.shape[2:]
    scale_x, scale_y = w / width, h / height
    numbers = [[scale_x, 0, (scale_x - 1) / 2], [0, scale_y, (scale_y - 1) / 2]]
    M = torch.tensor([numbers], dtype=torch.float64, device=device)
    ours = G.warp_affine(x, M, size, padding_mode="border", antialias=True)
    theirs = F.interpolate(x, size, mode="bilinear", antialias=True)
    assert_close(ours[..., 1:-1, 1:-1], theirs[..., 1:-1, 1:-1])
    bytes = (255 * x).round().to(torch.uint8)
    rounded = G.warp_affine(bytes, M.float(), size, padding_mode="border", antialias=True).double()
    theirs = F.interpolate(bytes.double(), size, mode="bilinear", antialias=True)
    assert (rounded - theirs)[..., 1:-1, 1:-1].abs().max() < 0.51


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_reflections_of_one_pixel_are_those_of_equal_pixels(dtype, device):
    x = torch.rand(1, 3, 7, 1, dtype=dtype, device=device, requires_grad=True)
    M = torch.tensor(
        [[[0.4127, 0.1031, 5.0137], [-0.2053, 0.5091, 9.0171]]], dtype=dtype, device=device, requires_grad=True
    )
    weight = torch.rand(1, 3, 17, 13, dtype=dtype, device=device)
    found = []
    for image in (x, x.expand(-1, -1, -1, 9)):
        y = G.warp_affine(image, M, (17, 13), padding_mode="reflection", antialias=True)
        found.append((y, *torch.autograd.grad((y * weight).sum(), (x, M))))
    assert_close(*found, 2e-5, 2e-4 if dtype == torch.float32 else 1e-9)


def test_without_shrinking_it_is_the_plain_warp(device):
    """Values and gradients, of maps that turn and magnify."""
    x = torch.rand(2, 3, 21, 19, dtype=torch.float64, device=device, requires_grad=True)
    angle = torch.tensor([37.0, 90.0], device=device).double()
    scale = torch.tensor([[1.3, 1.1], [1.7, 1.0]], device=device).double()
    M = G.get_rotation_matrix2d(torch.tensor([[9.3, 10.1]], device=device).double().expand(2, 2), angle, scale)
    M.requires_grad_()
    weight = torch.rand(2, 3, 30, 25, dtype=torch.float64, device=device)
    plain, ours = (G.warp_affine(x, M, (30, 25), padding_mode="border", antialias=a) for a in (False, True))
    assert_close(ours, plain)
    grads = [torch.autograd.grad((y * weight).sum(), (x, M)) for y in (ours, plain)]
    assert_close(grads[0][0], grads[1][0])
    assert_close(grads[0][1][0], grads[1][1][0], 1e-6, 1e-6)  # a quarter turn reads pixels, which are corners


@pytest.mark.parametrize(
    "factor, degrees, shear, decibels",
    [(2.0, 20.0, 0.1, 40), (3.0, 20.0, 0.2, 45), (4.0, 30.0, 0.1, 45), (6.0, 10.0, 0.1, 45)],
)
def test_photographs_against_supersampling(factor, degrees, shear, decibels, data, device):
    """16 x 16 plain samples over two pixels of the result along each axis, with the weights of a triangle."""
    photo = K.io.load_image(data / "homography" / "graf" / "img1.png", K.io.ImageLoadType.RGB32, device)[None]
    photo = photo[..., 100:420, 100:500].double()
    size = (30, 40)
    angle = torch.tensor(degrees, device=device).deg2rad()
    turn = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()]).reshape(2, 2).double()
    J = factor * turn @ torch.tensor([[1.0, shear], [0.0, 1.0]], device=device).double()
    middle = torch.tensor([(size[1] - 1) / 2, (size[0] - 1) / 2], device=device).double()
    offset = torch.tensor([199.7, 159.6], device=device).double() - J @ middle
    to_photo = torch.eye(3, device=device).double()
    to_photo[:2] = torch.cat([J, offset[:, None]], 1)

    def plain(x: float, y: float) -> Tensor:
        moved = to_photo.clone()
        moved[:2, 2] += J @ torch.tensor([x, y], device=device).double()
        return G.homography_warp(photo, moved[None], size, padding_mode="reflection", normalized_homography=False)

    steps = [(i + 0.5) / 8 - 1 for i in range(16)]
    weights = {(x, y): (1 - abs(x)) * (1 - abs(y)) for x in steps for y in steps}
    truth = sum(w * plain(*at) for at, w in weights.items()) / sum(weights.values())
    M = torch.linalg.inv(to_photo)[None]
    ours = G.warp_perspective(
        photo.float(), M.float(), size, padding_mode="reflection", align_corners=False, antialias=True
    )

    def psnr(y: Tensor) -> float:
        return -10 * (y.double() - truth).square().mean().log10().item()

    assert psnr(ours) > decibels > psnr(plain(0, 0))


def test_it_is_continuous_in_the_matrix(device):
    """A step of 1e-4 in the scale, through where shrinking begins, moves no pixel by more than 2e-3."""
    x = torch.rand(1, 1, 24, 24, dtype=torch.float64, device=device)
    scales = 1 / torch.linspace(0.99, 1.01, 201, device=device).double()
    angle = torch.full((201,), 12.0, device=device).double()
    center = torch.full((201, 2), 11.5, device=device).double()
    for both in (torch.stack([scales, scales], 1), torch.stack([scales, torch.ones_like(scales)], 1)):
        M = G.get_rotation_matrix2d(center, angle, both)
        y = G.warp_affine(x, M, (24, 24), padding_mode="border", antialias=True)
        assert (y[1:] - y[:-1]).abs().max() < 2e-3


@pytest.mark.parametrize("width", [132, 131])  # rows that begin with vectors of four pixels, and others
@pytest.mark.parametrize(
    "factor, degrees", [(1.0, 10.0), (1.6, 77.0), (2.0, 20.0), (2.7, 0.0), (4.0, 110.0), (6.0, 200.0)]
)
def test_turned_images_are_those_of_float64(factor, degrees, width, device):
    """Inside and at the border, of channels together and alone, next to numbers that are not finite, and by lists."""
    x = torch.rand(2, 4, 120, width, generator=torch.Generator().manual_seed(0))
    spoiled = x.clone()
    spoiled[0, 1, 50:70:9, 40:80:13] = float("inf")
    spoiled[1, 3, 57, 71] = float("nan")
    center = torch.tensor([[width / 2, 60.0]])
    M = G.get_rotation_matrix2d(
        center.expand(2, 2), torch.tensor([degrees, degrees + 45]), torch.full((2, 2), 1 / factor)
    )
    M[:, :, 2] -= center - torch.tensor([20.0, 22.0])
    bytes = (255 * x).round().to(torch.uint8)
    for padding in ("zeros", "border", "reflection"):

        def warp(images: Tensor | list[Tensor], padding: str = padding) -> Tensor:
            first = images[0]
            to = torch.float64 if first.dtype == torch.float64 else torch.float32
            moves = M.to(first.device, to)
            return G.warp_affine(images, moves, (44, 41), padding_mode=padding, antialias=True)

        for images, tolerance in ((x, 2e-5), (spoiled, 2e-5), (x.half(), 1e-3), (bytes, 0.51)):
            expected = warp(images.double())
            ours = warp(images.to(device))
            torch.testing.assert_close(ours.cpu().double(), expected, rtol=0, atol=tolerance, equal_nan=True)
            listed = warp(list(images.to(device)))
            torch.testing.assert_close(listed.cpu().double(), expected, rtol=0, atol=tolerance, equal_nan=True)


# --- limits -----------------------------------------------------------------------------------------------------------


def test_pixels_far_out_and_strong_shrinking(device):
    x = torch.rand(1, 2, 5, 6, device=device).requires_grad_()
    far = torch.tensor([[[float("nan"), float("inf"), -float("inf"), 1e30, -1e30, 3e9]]], device=device)
    for padding in ("zeros", "border", "reflection"):
        y = G.remap(x, far, torch.ones_like(far), padding_mode=padding, antialias=True)
        assert y.isfinite().all() and torch.autograd.grad(y.sum(), x)[0].isfinite().all()
        assert padding != "zeros" or not y.any()
    M = torch.tensor([[[1e-3, 0, 0], [0, 1e-3, 0]]], device=device).requires_grad_()
    y = G.warp_affine(x, M, (2, 2), padding_mode="border", antialias=True)
    assert ((y > 0) & (y < 1)).all()
    assert all(g.isfinite().all() for g in torch.autograd.grad(y.sum(), (x, M)))
    singular = torch.zeros(1, 3, 3, device=device, requires_grad=True)
    y = G.warp_perspective(x, singular, (4, 4), antialias=True)
    assert all(g.isfinite().all() for g in torch.autograd.grad(y.sum(), (x, singular)))


def test_functions_that_make_their_matrix(device):
    x = torch.rand(2, 3, 24, 32, device=device)
    half = torch.tensor([[[0.5, 0, 0.5 * 15.5], [0, 0.5, 0.5 * 11.5]]], device=device)
    expected = G.warp_affine(x, half, (24, 32), antialias=True)
    assert_close(G.scale(x, 0.5, antialias=True), expected)
    assert_close(G.Scale(0.5, antialias=True)(x), expected)
    assert_close(G.rotate(x, 30.0, antialias=True), G.rotate(x, 30.0), 0, 2e-5)
    boxes = torch.tensor([[[3.0, 2], [27, 2], [27, 20], [3, 20]]], device=device)
    M = torch.tensor([[[8 / 24, 0, -1.0], [0, 6 / 18, -2 / 3]]], device=device)
    index = torch.tensor([1, 0, 1], device=device)
    crops = G.crop_and_resize(x, boxes.expand(3, 4, 2), (7, 9), box_indices=index, antialias=True)
    assert_close(crops, G.warp_affine(x, M, (7, 9), antialias=True)[index], 0, 2e-6)


@pytest.mark.parametrize("wants_gradient", [False, True])
def test_shapes_of_tensors_without_values(wants_gradient):
    image = torch.empty(2, 3, 20, 30, device="meta", requires_grad=wants_gradient)
    matrix, grid = torch.empty(2, 3, 3, device="meta"), torch.empty(2, 9, 10, device="meta")
    for y in (
        K.geometry.warp_perspective(image, matrix, (9, 10), antialias=True),
        K.geometry.warp_affine(list(image), matrix[:, :2], (9, 10), antialias=True),
        K.geometry.remap(image, grid, grid, antialias=True),
    ):
        assert y.is_meta and y.shape == (2, 3, 9, 10) and y.requires_grad == wants_gradient
