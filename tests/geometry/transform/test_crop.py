"""Crops: the operator that computes their matrices, and crops that must be exact copies."""

import pytest
import torch

import kvision as K
from kvision.geometry.transform.matrices import crop_matrix
from op_tests import assert_close
from point_op_tests import SQUARE, Call, PointOpTests, near
from warp_tests import FormulaWarpTests

G = K.geometry
QUADS = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]], [[2.0, 1], [6, 1], [6, 4], [2, 4]]]).double()
FLAT = torch.tensor([[[3.0, 2], [3, 2], [3, 2], [3, 2]], [[1.0, 2], [5, 2], [5, 2], [1, 2]]]).double()


def matrix_of(quads: torch.Tensor, size: tuple[int, int], first: torch.Tensor | None = None) -> torch.Tensor:
    h, w = size
    return crop_matrix(quads, first, float(max(w - 1, 1)), float(max(h - 1, 1)))


@pytest.mark.parametrize("size", [(5, 7), (1, 1), (1, 6)])
def test_matrices(size, device):
    for quads in (QUADS, FLAT, 1000 * QUADS):
        quads = quads.to(device)
        with K.backend("reference"):
            expected = matrix_of(quads, size)
        assert_close(matrix_of(quads, size), expected, 1e-12, 1e-12)
        assert_close(matrix_of(quads.float(), size), expected.float())


def test_matrices_take_corners_to_corners(device):
    first = torch.tensor([[1.0, 2], [3, 5]], dtype=torch.float64, device=device)
    matrix = matrix_of(QUADS.to(device), (5, 7), first)
    corners = torch.tensor([[0.0, 0, 1], [6, 0, 1], [6, 4, 1], [0, 4, 1]], dtype=torch.float64, device=device)
    corners = corners + torch.nn.functional.pad(first, (0, 1))[:, None]
    result = corners @ matrix.mT
    assert_close(result[..., :2] / result[..., 2:], QUADS.to(device), 0, 1e-12)


@pytest.mark.parametrize("call", [G.crop_and_resize, G.crop_by_boxes], ids=lambda call: call.__name__)
def test_few_operators_a_call(call, device, backend):
    """The warp by a matrix of its own; before it what has to be known of boxes, in one copy to the host."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x, boxes = torch.rand(2, 3, 16, 16, device=device), QUADS.to(device).float()
    if call is G.crop_by_boxes:
        boxes = boxes[1:].expand(2, -1, -1).contiguous()
    to = boxes if call is G.crop_by_boxes else (8, 8)
    call(x, boxes, to)
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
        call(x, boxes, to)
    names = [event.name for event in profile.events()]
    free = ("aten::empty", "aten::contiguous")  # of what is contiguous
    operators = [name for name in names if "::" in name and not name.startswith(free)]
    expected = ["kvision::warp_by_formula"]
    if call is G.crop_by_boxes:
        expected.insert(0, "kvision::crop_box_checks")
    assert [name for name in operators if name.startswith("kvision::")] == expected, operators
    assert device.type == "cpu" or names.count("cudaLaunchKernel") == len(expected), names
    assert device.type == "cpu" or names.count("cudaStreamSynchronize") == len(expected) - 1, names


def test_integer_boxes_are_slices(device):
    """Exact: the matrix of a box of whole pixels has whole numbers."""
    x = torch.rand(2, 3, 613, 1021, device=device)
    boxes = torch.tensor([[101, 37, 900, 600], [3, 11, 802, 574]], device=device)
    x0, y0, x1, y1 = boxes.unbind(1)
    corners = torch.stack([x0, y0, x1, y0, x1, y1, x0, y1], 1).reshape(2, 4, 2).float()
    result = G.crop_and_resize(x, corners, (564, 800))
    for i, (left, top, right, bottom) in enumerate(boxes.tolist()):
        assert torch.equal(result[i], x[i, :, top : bottom + 1, left : right + 1])


QUAD = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]]])


def test_crops_of_one_pixel(device):
    x = torch.rand(1, 2, 6, 7, device=device)
    point = torch.tensor([[[3.0, 2], [3, 2], [3, 2], [3, 2]]], device=device)
    assert_close(G.crop_and_resize(x, point, (1, 1)), x[..., 2:3, 3:4])
    row = torch.tensor([[[1.0, 2], [5, 2], [5, 2], [1, 2]]], device=device)
    assert_close(G.crop_and_resize(x, row, (1, 5)), x[..., 2:3, 1:6])
    assert_close(G.crop_and_resize(x, row, (3, 5)), x[..., 2:3, 1:6].expand(1, 2, 3, 5))


def quads(x: torch.Tensor, each: int) -> torch.Tensor:
    """`each` boxes for an image of x, all different."""
    count = each * len(x)
    return QUADS[0] + 0.37 * torch.arange(count, dtype=torch.float64)[:, None, None]


def indices(x: torch.Tensor) -> torch.Tensor:
    """The image of each of three boxes per image, in no order."""
    return torch.arange(3 * len(x)).flip(0) % max(len(x), 1)


class TestCropAndResize(FormulaWarpTests):
    """Several boxes an image."""

    function = staticmethod(G.crop_and_resize)
    operators = (
        *("warp_by_formula", "warp_image_backward", "warp_matrix_backward"),
        *("crop_matrix", "crop_matrix_backward"),
    )
    max_size = 7
    accepted = ("image of another batch",)  # more images than indices are in use
    variants = [
        {"boxes": lambda x: quads(x, 3), "size": (5, 9), "box_indices": indices},
        {
            "boxes": lambda x: quads(x, 3),
            "size": (4, 3),
            "box_indices": lambda x: indices(x).int(),
            "mode": "bicubic",
            "padding_mode": "reflection",
        },
    ]
    errors = [
        ({"boxes": lambda x: torch.ones(5, 4, 2)}, ValueError, r"expected box_indices of shape \(5,\), got \(6,\)"),
        (
            {"box_indices": None, "boxes": lambda x: torch.ones(3, 4, 2)},
            ValueError,
            "expected boxes with a batch size of 1 or 2",
        ),
        ({"box_indices": [0, 1]}, TypeError, "expected box_indices to be a Tensor of int64 or int32, got list"),
        ({"box_indices": lambda x: torch.zeros(6)}, TypeError, "int64 or int32, got torch.float32"),
    ]


@pytest.mark.parametrize("bad", [-1, 2])
def test_indices_out_of_range(bad, device):
    """An error on the CPU. On a GPU reading them would wait for it; they are clamped."""
    x, boxes = torch.rand(2, 3, 9, 8, device=device), quads(torch.zeros(2), 1).float().to(device)
    wrong, right = (torch.tensor([0, i], device=device) for i in (bad, min(max(bad, 0), 1)))
    if device.type != "cpu":
        assert torch.equal(
            G.crop_and_resize(x, boxes, (3, 4), box_indices=wrong),
            G.crop_and_resize(x, boxes, (3, 4), box_indices=right),
        )
        return
    with pytest.raises(ValueError, match=f"^crop_and_resize: expected box_indices from 0 to 1, got {bad}"):
        G.crop_and_resize(x, boxes, (3, 4), box_indices=wrong)


@pytest.mark.native
@pytest.mark.parametrize("bad", [-1, 2])
def test_kernels_check_indices_that_python_cannot_read(bad, device):
    if device.type != "cpu":
        pytest.skip("indices on a GPU are clamped")
    x, boxes = torch.rand(2, 3, 9, 8), quads(torch.zeros(2), 1).float()
    wrong = torch.tensor([0, bad])
    with pytest.raises(RuntimeError, match="warp_by_formula: expected image_index from 0 to 1, got -1"):
        torch.func.vmap(lambda s: G.crop_and_resize(s, boxes, (3, 4), box_indices=wrong))(x[None])


def test_boxes_of_one_image(device):
    x = torch.rand(1, 3, 9, 8, device=device)
    boxes = quads(torch.zeros(5), 1).float().to(device)
    each = torch.cat([G.crop_and_resize(x, box[None], (3, 4)) for box in boxes])
    assert torch.equal(G.crop_and_resize(x, boxes, (3, 4)), each)
    assert torch.equal(G.crop_and_resize(x, boxes, (3, 4), box_indices=torch.zeros(5, dtype=int, device=device)), each)
    none = torch.zeros(0, 4, 2, device=device)
    assert G.crop_and_resize(x, none, (3, 4)).shape == (0, 3, 3, 4)
    assert G.crop_and_resize(x[:0], none, (3, 4), box_indices=none[:, 0, 0].long()).shape == (0, 3, 3, 4)


IMAGE = torch.rand(1, 2, 5, 6, generator=torch.Generator().manual_seed(1)).double()
FUNCTIONS = {
    "crop_and_resize": (lambda x, b: G.crop_and_resize(x, b, (3, 4)), (IMAGE, QUAD)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_gradients(name, device):
    function, args = FUNCTIONS[name]
    args = tuple(a.double().to(device).requires_grad_() for a in args)
    assert torch.autograd.gradcheck(function, args, nondet_tol=1e-9)
    assert torch.autograd.gradgradcheck(function, args, nondet_tol=1e-9)


X, V = torch.rand(2, 3, 4, 5), torch.rand(1, 1, 3, 4, 5)
BAD = [
    (lambda: G.center_crop(X[0], (2, 2)), ValueError, "center_crop: expected input_tensor of shape"),
    (lambda: G.crop_and_resize(X, torch.ones(2, 4), (2, 2)), ValueError, "crop_and_resize: expected boxes of shape"),
    (lambda: G.crop_by_boxes(X, QUAD, QUAD), ValueError, "crop_by_boxes: expected src_box of rectangles"),
    (lambda: G.crop_by_indices(X, QUAD), ValueError, "crop_by_indices: expected src_box of shape"),
    (lambda: G.crop_by_transform_mat(X, torch.eye(4)[None], (2, 2)), ValueError, "crop_by_transform_mat: expected transform"),
    (lambda: G.CenterCrop2D((9, 9))(X), ValueError, "CenterCrop2D: expected input of at least"),
]  # fmt: skip


def test_boxes_of_each_element_of_vmap(device):
    """Those of one size; its elements are the calls. Boxes of several sizes would give results of several sizes."""
    images, volumes = torch.rand(3, 2, 1, 8, 9, device=device), torch.rand(3, 2, 1, 4, 5, 6, device=device)
    square = torch.tensor([[1.0, 1], [4, 1], [4, 3], [1, 3]], device=device)
    boxes = (square + torch.arange(3.0, device=device).reshape(3, 1, 1, 1)).expand(3, 2, 4, 2)
    square = torch.cat([square, square.new_ones(4, 1)], 1)
    cubes = torch.cat([square, square + square.new_tensor([0.0, 0, 1])])[None, None].expand(3, 2, 8, 3)
    for crop, args in (
        (lambda x, b: G.crop_by_boxes(x, b, b), (images, boxes)),
        (lambda x, b: G.crop_by_boxes3d(x, b, b), (volumes, cubes)),
        (lambda x, b: G.crop_by_indices(x, b.long()), (images, boxes)),
        (lambda x, b: G.crop_by_indices(x, b.long(), (4, 7)), (images, boxes)),
        (lambda x, b: G.crop_by_indices(x, b.long(), (4, 7), shape_compensation="pad"), (images, boxes)),
    ):
        expected = torch.stack([crop(*each) for each in zip(*args)])
        assert torch.equal(torch.func.vmap(crop)(*args), expected)
        moved = torch.func.vmap(crop, in_dims=(1, 2))(args[0].movedim(0, 1), args[1].movedim(0, 2))
        assert torch.equal(moved, expected)
    boxes = boxes * torch.tensor([1, 1, 2], device=device).reshape(3, 1, 1, 1)
    for crop, name in (
        (G.crop_by_indices, "src_box"),
        (lambda x, b: G.crop_by_boxes(x, b, b), "dst_box"),
    ):
        with pytest.raises(ValueError, match=f"expected {name} of one size"):
            torch.func.vmap(crop)(images, boxes)


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()


class TestCropOperators(PointOpTests):
    calls = {
        "crop_box_checks": [Call((near(SQUARE), near(SQUARE)))],
    }
