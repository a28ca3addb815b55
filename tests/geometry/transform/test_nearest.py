"""Labels, masks and other integers in nearest modes: moved as they are, whatever their type and size."""

from fractions import Fraction

import pytest
import torch
from torch import Tensor

import kvision as K

G = K.geometry
TYPES = [torch.bool, torch.int8, torch.int16, torch.int32, torch.int64]
SHIFT = torch.tensor([[[1.0, 0, 1.5], [0.1, 1, -2], [0, 0, 1]]])
BOX = torch.tensor([[[1.0, 1], [6, 1], [6, 5], [1, 5]]])
NOISE = torch.randn(1, 2, 8, 10, generator=torch.Generator().manual_seed(0))
CALLS = {
    "resize": lambda x: G.resize(x, (5, 13), "nearest"),
    "nearest-exact": lambda x: G.resize(x, (16, 7), "nearest-exact"),
    "rescale": lambda x: G.rescale(x, 0.7, "nearest"),
    "resize_to_be_divisible": lambda x: G.resize_to_be_divisible(x, 4, "nearest"),
    "warp_perspective": lambda x: G.warp_perspective(x, SHIFT.to(x.device), (7, 9), "nearest"),
    "warp_affine": lambda x: G.warp_affine(x, SHIFT[:, :2].to(x.device), (7, 9), "nearest", "reflection"),
    "homography_warp": lambda x: G.homography_warp(x, 0.7 * SHIFT.to(x.device), (7, 9), "nearest"),
    "remap": lambda x: G.remap(x, *(6 + 6 * n for n in NOISE.to(x.device).unbind(1)), "nearest", "border"),
    "elastic_transform2d": lambda x: G.elastic_transform2d(x, NOISE.to(x.device).expand(2, -1, -1, -1), mode="nearest"),
    "rotate": lambda x: G.rotate(x, torch.tensor([30.0], device=x.device), mode="nearest"),
    "affine": lambda x: G.affine(x, SHIFT[:, :2].to(x.device), mode="nearest"),
    "crop_and_resize": lambda x: G.crop_and_resize(x, BOX.repeat(2, 1, 1).to(x.device), (9, 9), "nearest"),
    "center_crop": lambda x: G.center_crop(x, (3, 5), "nearest"),
    "center_crop at whole pixels": lambda x: G.center_crop(x, (4, 6)),
}


def labels(dtype: torch.dtype, *shape: int) -> Tensor:
    """Of all sizes that the type has."""
    generator = torch.Generator().manual_seed(1)
    bits = {torch.bool: 1, torch.int64: 62}.get(dtype, torch.empty(0, dtype=dtype).element_size() * 8 - 1)
    return (torch.randint(0, 2**62, shape, generator=generator) >> (62 - bits)).to(dtype)


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_integers_are_moved_as_they_are(call, device):
    number = torch.arange(1.0, 81).reshape(1, 1, 8, 10).repeat(2, 1, 1, 1)
    index = call(number.to(device)).long()  # of the pixel that each pixel of the result is; 0 out of bounds
    for dtype in TYPES:
        x = labels(dtype, 2, 3, 8, 10).to(device)
        pixels = torch.nn.functional.pad(x.flatten(2), (1, 0))
        expected = pixels.gather(2, index.flatten(2).expand(-1, 3, -1)).reshape(2, 3, *index.shape[2:])
        result = call(x)
        assert result.dtype == dtype and torch.equal(result, expected), dtype
        moved = torch.vmap(call)(x[None])[0] if dtype == torch.int64 else expected
        assert torch.equal(moved, expected)


def test_volumes_and_warps_by_depth(device):
    x = labels(torch.int64, 1, 2, 4, 6, 8).to(device)
    still = torch.eye(3, 4, device=device)[None]
    assert torch.equal(G.warp_affine3d(x, still, (4, 6, 8), "nearest"), x)
    assert torch.equal(G.center_crop3d(x, (2, 2, 4), "nearest"), x[..., 1:3, 2:4, 2:6])
    eye, size = torch.eye(4, device=device)[None], torch.tensor([8.0], device=device)
    camera = G.PinholeCamera(eye, eye, size, size)
    warper = K.DepthWarper(camera, 6, 8, "nearest").compute_projection_matrix(camera)
    assert torch.equal(warper(torch.ones(1, 1, 6, 8, device=device), x[:, :, 0]), x[:, :, 0])


def test_fill_of_integers(device):
    away = torch.tensor([[[1.0, 0, 50], [0, 1, 0]]], device=device)
    for dtype, fill, expected in (
        (torch.int64, 2**40 + 1, 2**40 + 1),
        (torch.int8, 300, 127),
        (torch.int16, -2.5, -2),
        (torch.bool, 1, True),
    ):
        x = labels(dtype, 1, 2, 3, 4).to(device)
        result = G.warp_affine(x, away, (3, 4), "nearest", "fill", fill_value=fill)
        assert torch.equal(result, torch.full_like(x, expected)), dtype
    each = torch.tensor([2**33, 7], device=device)
    result = G.warp_affine(labels(torch.int64, 1, 2, 3, 4).to(device), away, (3, 4), "nearest", "fill", fill_value=each)
    assert torch.equal(result[0, :, 0, 0], each)


def test_interpolating_modes_of_integers_stay_float32(device):
    x = labels(torch.int64, 1, 1, 6, 6).to(device) % 100
    for result in (
        G.resize(x, (4, 4)),
        G.resize(x, (4, 4), "area"),
        G.affine(x, torch.eye(2, 3, device=device)[None]),
        G.center_crop(x, (3, 3)),
        G.warp_affine3d(x[None], torch.eye(3, 4, device=device)[None], (1, 6, 6)),
    ):
        assert result.dtype == torch.float32


@pytest.mark.parametrize("size", [3, (2, 5)])
def test_medians_of_integers(size, device):
    ky, kx = (size, size) if isinstance(size, int) else size
    for dtype in TYPES:
        for x in (
            labels(dtype, 2, 3, 8, 10),
            labels(dtype, 1, 1, 8, 10) // 3 if dtype != torch.bool else labels(dtype, 1, 1, 4, 4),
        ):
            windows = [sorted(w) for w in windows_of(x, ky, kx)]
            expected = torch.tensor([w[(len(w) - 1) // 2] for w in windows], dtype=dtype).reshape(x.shape)
            result = K.filters.median_blur(x.to(device), size, "constant")
            assert result.dtype == dtype and torch.equal(result.cpu(), expected), dtype


def windows_of(x: Tensor, ky: int, kx: int) -> list[list[int]]:
    """The values of the window of each pixel, zeros outside."""
    top, left = (ky - 1) // 2, (kx - 1) // 2
    padded = torch.nn.functional.pad(x, (left, kx - 1 - left, top, ky - 1 - top))
    return padded.unfold(2, ky, 1).unfold(3, kx, 1).reshape(-1, ky * kx).tolist()


@pytest.mark.tracing
def test_integers_compile(device):
    x = labels(torch.int64, 2, 3, 8, 10).to(device)
    call = CALLS["resize"]
    assert torch.equal(torch.compile(call, backend="aot_eager", fullgraph=True, dynamic=True)(x), call(x))


@pytest.mark.parametrize("width", [11, 30, 57, 96])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.uint8], ids=str)
def test_midway_between_two_pixels_is_the_even_one(dtype, width, device):
    """Whatever the errors of rounding of matrices and coordinates, so that all devices give one result."""
    row = torch.arange(80, device=device).to(dtype).expand(1, 1, 5, 80)
    matrices, expected = [], []
    for size in range(2, 60):
        step, first = Fraction(size, width), size % 6
        coords = [(2 * i + 1) * step / 2 - Fraction(1, 2) + first for i in range(width)]
        expected.append([min(max(round(x), 0), 79) for x in coords])
        matrices.append([[float(1 / step), 0, float((Fraction(1, 2) - first) / step - Fraction(1, 2))], [0, 1.0, 0]])
    matrix = torch.tensor(matrices, dtype=torch.float64 if dtype == torch.float64 else torch.float32, device=device)
    read = G.warp_affine(row.expand(len(matrices), -1, -1, -1), matrix, (5, width), "nearest", "border")
    assert torch.equal(read, torch.tensor(expected, device=device).to(dtype)[:, None, None].expand_as(read))
