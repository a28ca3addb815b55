"""Drawing: against Kornia, OpenCV and plain loops."""

from __future__ import annotations

import cv2
import kornia
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import kvision as K
from kvision.core.exceptions import ShapeError, TypeCheckError, ValueCheckError

H, W = 17, 23
SEEDS = st.integers(0, 2**32 - 1)


def on(device, *tensors):
    return [tensor.to(device) for tensor in tensors]


def random_points(generator, *shape):
    """Points inside the image: half of them pixel centers, half between, often exactly half-way."""
    size = torch.tensor([W, H])
    whole = torch.rand(*shape, 2, generator=generator).mul(size).floor()
    offset = torch.randint(-2, 2, (*shape, 2), generator=generator) / 4
    return torch.where(torch.rand(*shape, 1, generator=generator) < 0.5, whole, whole + offset)


@given(SEEDS, st.integers(0, 6), st.sampled_from([torch.float32, torch.float64, torch.float16, torch.bfloat16]))
def test_line_agrees_with_kornia(device, seed, count, dtype):
    generator = torch.Generator().manual_seed(seed)
    p1, p2 = (random_points(generator, count).to(dtype) for _ in range(2))
    color = torch.rand(3, generator=generator)
    want = kornia.image.draw_line(torch.zeros(3, H, W), p1, p2, color)
    got = K.image.draw_line(*on(device, torch.zeros(3, H, W), p1, p2, color))
    assert torch.equal(got.cpu(), want)


@given(SEEDS)
def test_line_is_symmetric_and_connected(seed):
    p1, p2 = random_points(torch.Generator().manual_seed(seed), 2)
    line = K.image.draw_line(torch.zeros(1, H, W), p1, p2, 1)
    assert torch.equal(line, K.image.draw_line(torch.zeros(1, H, W), p2, p1, 1))
    a, b = (p1 + 0.5).floor(), (p2 + 0.5).floor()
    assert line.sum() == (a - b).abs().max() + 1  # one pixel a step
    y, x = line[0].nonzero(as_tuple=True)
    step = (b - a) / max((b - a).abs().max(), 1)
    distance = (x - a[0]) * step[1] - (y - a[1]) * step[0]
    assert distance.abs().max() <= 0.5  # and none further than half a pixel from the ideal line


@given(SEEDS)
def test_points_agree_with_kornia(device, seed):
    generator = torch.Generator().manual_seed(seed)
    points, color = random_points(generator, 5), torch.rand(3, generator=generator)
    for image, value in [
        (torch.zeros(3, H, W), color),
        (torch.zeros(1, H, W), color[:1]),
        (torch.zeros(H, W), color[:1]),
    ]:
        want = kornia.image.draw_point2d(image.clone(), points, value)
        assert torch.equal(K.image.draw_point2d(*on(device, image, points, value)).cpu(), want)


@given(SEEDS, st.integers(0, 3), st.integers(1, 5), st.sampled_from([None, True, False]))
def test_rectangle_agrees_with_kornia(device, seed, count, line_width, fill):
    generator = torch.Generator().manual_seed(seed)
    boxes = torch.rand(2, count, 4, generator=generator) * 40 - 10  # corners in any order, also outside
    color = torch.rand(2, count, 3, generator=generator)
    image = torch.rand(2, 3, H, W, generator=generator)
    want = kornia.image.draw_rectangle(image.clone(), boxes, color, fill, line_width)
    assert torch.equal(K.image.draw_rectangle(*on(device, image, boxes, color), fill, line_width).cpu(), want)


@given(SEEDS, st.integers(0, 6))
def test_polygon_agrees_with_kornia(device, seed, vertices):
    generator = torch.Generator().manual_seed(seed)
    polygons = torch.rand(2, vertices, 2, generator=generator) * 30 - 4
    colors = torch.rand(2, 3, generator=generator)
    image = torch.rand(2, 3, H, W, generator=generator)
    want = kornia.image.draw_convex_polygon(image.clone(), polygons, colors)
    assert torch.equal(K.image.draw_convex_polygon(*on(device, image, polygons, colors)).cpu(), want)


@given(SEEDS)
def test_polygon_fills_the_centers_inside(seed):
    """A triangle against its three half-planes, vertices on quarters so that the comparison is exact."""
    a, b, c = torch.randint(-8, 100, (3, 2), generator=torch.Generator().manual_seed(seed)).double() / 4
    y, x = torch.meshgrid(torch.arange(H).double(), torch.arange(W).double(), indexing="ij")
    sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
    inside = torch.stack(sides).ge(0).all(0) | torch.stack(sides).le(0).all(0)
    if (b[0] - a[0]) * (c[1] - a[1]) != (b[1] - a[1]) * (c[0] - a[0]):  # without an area it is but a line
        drawn = K.image.draw_convex_polygon(torch.zeros(1, 1, H, W), torch.stack([a, b, c])[None], 1)
        differing = (drawn[0, 0] > 0) != inside
        assert (torch.stack(sides).abs().amin(0)[differing] < 1e-9).all()


def test_polygons_of_different_length(device):
    images = torch.zeros(4, 1, H, W, device=device)
    polygons = [
        torch.tensor([[2, 2], [9, 2], [2, 9]]),
        torch.tensor([[2.0, 2.0], [9.0, 2.0], [9.0, 9.0], [2.0, 9.0]], dtype=torch.float64),
        torch.zeros(0, 2),
        torch.tensor([[5, 6]]),
    ]
    K.image.draw_convex_polygon(images, on(device, *polygons), torch.arange(1, 5)[:, None])
    for i, polygon in enumerate(polygons[:2]):
        alone = K.image.draw_convex_polygon(torch.zeros(1, 1, H, W), polygon[None], i + 1)
        assert torch.equal(images[i : i + 1].cpu(), alone)
    assert images[1].sum() == 2 * 8 * 8 and images[2].sum() == 0 and images[3].nonzero().tolist() == [[0, 6, 5]]


def test_filled_boxes_agree_with_opencv():
    boxes = torch.tensor([[[3, 2, 8, 5], [-4, 6, 4, 9], [10, 10, 40, 40]]])
    expected = np.zeros((H, W), np.uint8)
    for i, (x0, y0, x1, y1) in enumerate(boxes[0].tolist()):
        cv2.rectangle(expected, (x0, y0), (x1, y1), i + 1, cv2.FILLED)
    colors = torch.tensor([[[1], [2], [3]]])
    got = K.image.draw_rectangle(torch.zeros(1, 1, H, W, dtype=torch.uint8), boxes, colors, fill=True)
    assert np.array_equal(got[0, 0].numpy(), expected)


def test_colors_in_all_shapes(device):
    line = torch.tensor([[0, 0], [5, 5]])
    for color in (1, [1], [1, 1, 1], np.ones(3), torch.tensor(1), torch.ones(1), torch.ones(3, device=device)):
        for image in (torch.zeros(3, H, W, device=device), torch.zeros(3, H, W, dtype=torch.uint8, device=device)):
            assert K.image.draw_line(image, line[0], line[1], color).sum() == 18
    box = torch.tensor([[[0, 0, 2, 2]], [[0, 0, 2, 2]]])
    for color in (1, torch.ones(3), torch.ones(2, 1, 1), torch.ones(2, 1, 3)):
        assert K.image.draw_rectangle(torch.zeros(2, 3, H, W, device=device), box, color, fill=True).sum() == 54
    square = torch.tensor([[[0, 0], [2, 0], [2, 2], [0, 2]]]).expand(2, 4, 2)
    for color in (1, torch.ones(3), torch.ones(2, 1), torch.ones(2, 3)):
        assert K.image.draw_convex_polygon(torch.zeros(2, 3, H, W, device=device), square, color).sum() == 54


def test_drawing_is_in_place_also_through_views(device):
    batch = torch.zeros(2, 3, H, 2 * W, device=device)
    view = batch[:, :, :, ::2]
    assert K.image.draw_line(view[0], torch.tensor([0, 0]), torch.tensor([3, 0]), 1).data_ptr() == batch.data_ptr()
    assert batch[0, 0, 0].nonzero().flatten().tolist() == [0, 2, 4, 6]
    K.image.draw_rectangle(view, torch.tensor([[[0, 0, 3, 3]]] * 2), 1)
    K.image.draw_convex_polygon(view, torch.tensor([[[0, 0], [3, 0], [3, 3]]] * 2), 1)
    assert batch[..., 1::2].sum() == 0
    points = torch.tensor([1.2, 3.4])
    K.image.draw_point2d(view[0, 0], points, 1)
    assert points.tolist() == pytest.approx([1.2, 3.4])


def test_gradient_passes_where_nothing_is_drawn():
    image = torch.rand(1, 1, 3, 3, requires_grad=True)
    square = torch.tensor([[[0, 0], [1, 0], [1, 1], [0, 1]]])
    for draw in (
        lambda x: K.image.draw_line(x[0], torch.tensor([0, 0]), torch.tensor([2, 2]), 1),
        lambda x: K.image.draw_rectangle(x, torch.tensor([[[0, 0, 1, 1]]]), 1),
        lambda x: K.image.draw_convex_polygon(x, square, 1),
    ):
        canvas = image.clone()
        (grad,) = torch.autograd.grad(draw(canvas).sum(), image)
        assert torch.equal(grad == 0, canvas == 1)


def test_empty_drawings():
    none, image = torch.zeros(0, 2), torch.zeros(3, H, W)
    assert K.image.draw_line(image, none, none, 1).sum() == 0
    assert K.image.draw_point2d(image, none, 1).sum() == 0
    assert K.image.draw_rectangle(image[None], torch.zeros(1, 0, 4), 1).sum() == 0
    assert K.image.draw_convex_polygon(image[None], torch.zeros(1, 0, 2), 1).sum() == 0
    assert K.image.draw_convex_polygon(torch.zeros(0, 3, H, W), [], 1).shape == (0, 3, H, W)
    infinite = torch.tensor([[[-torch.inf, 3, torch.inf, 3]]])
    assert K.image.draw_rectangle(torch.zeros(1, 1, H, W), infinite, 1).sum() == W


IMAGE, BATCH, P = torch.zeros(3, H, W), torch.zeros(1, 3, H, W), torch.tensor([1.0, 1.0])
BOX = torch.zeros(1, 1, 4)


@pytest.mark.parametrize(
    ("draw", "args", "error", "text"),
    [
        ("draw_point2d", ([0], P, 1), TypeCheckError, "draw_point2d: expected image to be a Tensor, got list"),
        ("draw_point2d", (BATCH, P, 1), ShapeError, r"image of shape \(C, H, W\) or \(H, W\), got \(1, 3, 17, 23\)"),
        ("draw_point2d", (IMAGE, [1, 1], 1), TypeCheckError, "expected points to be a Tensor, got list"),
        ("draw_point2d", (IMAGE, torch.zeros(3), 1), ShapeError, r"points of shape \(N, 2\) or \(2,\), got \(3,\)"),
        ("draw_point2d", (IMAGE, torch.tensor([23, 0]), 1), ValueCheckError, r"x from 0 to 22 .* got \(23, 0\)"),
        ("draw_point2d", (IMAGE, torch.tensor([-0.6, 0]), 1), ValueCheckError, r"got \(-1, 0\)"),
        ("draw_point2d", (IMAGE, P * torch.nan, 1), ValueCheckError, "points without NaN"),
        ("draw_point2d", (IMAGE, P * torch.inf, 1), ValueCheckError, "points inside the image"),
        (
            "draw_point2d",
            (IMAGE, P, torch.zeros(2)),
            ShapeError,
            r"color of shape \(\) or \(1,\) or \(3,\), got \(2,\)",
        ),
        ("draw_point2d", (IMAGE, P, "red"), TypeCheckError, "expected color to be a Tensor or numbers, got 'red'"),
        ("draw_line", (BATCH, P, P, 1), ShapeError, r"draw_line: expected image of shape \(C, H, W\)"),
        ("draw_line", (IMAGE, P, P[None], 1), ShapeError, r"p2 of the shape of p1, \(2,\), got \(1, 2\)"),
        ("draw_line", (IMAGE, P, 99 * P, 1), ValueCheckError, r"expected p2 inside the image.* got \(99, 99\)"),
        ("draw_line", (IMAGE, P, None, 1), TypeCheckError, "expected p2 to be a Tensor, got NoneType"),
        ("draw_rectangle", (IMAGE, BOX), ShapeError, r"image of shape \(B, C, H, W\)"),
        ("draw_rectangle", (BATCH, BOX[0]), ShapeError, r"rectangle of shape \(1, N, 4\), got \(1, 4\)"),
        (
            "draw_rectangle",
            (BATCH, BOX.expand(2, 1, 4)),
            ShapeError,
            r"rectangle of shape \(1, N, 4\), got \(2, 1, 4\)",
        ),
        ("draw_rectangle", (BATCH, BOX, torch.zeros(1, 2, 3)), ShapeError, "expected color of shape"),
        ("draw_rectangle", (BATCH, BOX, 1, False, 0), ValueCheckError, "line_width to be an int of at least 1, got 0"),
        ("draw_rectangle", (BATCH, BOX, 1, False, True), ValueCheckError, "line_width .* got True"),
        ("draw_rectangle", (BATCH, BOX * torch.nan), ValueCheckError, "rectangle without NaN"),
        ("draw_convex_polygon", (IMAGE, BOX, 1), ShapeError, r"images of shape \(B, C, H, W\)"),
        ("draw_convex_polygon", (BATCH, BOX, 1), ShapeError, r"polygons of shape \(1, K, 2\), got \(1, 1, 4\)"),
        ("draw_convex_polygon", (BATCH, [P], 1), ShapeError, r"polygons\[0\] of shape \(K, 2\), got \(2,\)"),
        (
            "draw_convex_polygon",
            (BATCH, [P[None]] * 2, 1),
            ShapeError,
            r"polygons of shape \(1, K, 2\), got \(2, 1, 2\)",
        ),
        ("draw_convex_polygon", (BATCH, "abc", 1), TypeCheckError, "expected polygons to be a Tensor, got str"),
        ("draw_convex_polygon", (BATCH, [P[None]], torch.zeros(2, 3)), ShapeError, "expected colors of shape"),
    ],
)
def test_errors(draw, args, error, text):
    with pytest.raises(error, match=text):
        getattr(K.image, draw)(*args)


def test_graphs_draw_lines_between_points_of_the_host(device):
    if device.type != "cuda":
        pytest.skip("CUDA graphs are CUDA's")
    ends, color = (torch.tensor([1, 2]), torch.tensor([30, 9])), torch.tensor([0.5], device=device)
    expected = K.image.draw_line(torch.zeros(1, 20, 40, device=device), *ends, color)
    image, graph = torch.zeros_like(expected), torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        K.image.draw_line(image, *ends, color)
    graph.replay()
    assert torch.equal(image, expected)
