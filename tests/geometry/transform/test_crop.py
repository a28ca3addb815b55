"""Crops: the operator that makes their matrices, and what must be exact."""

import pytest
import torch

import kvision as K
from kvision.geometry.transform.matrices import crop_matrix
from op_tests import assert_close

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
    found = corners @ matrix.mT
    assert_close(found[..., :2] / found[..., 2:], QUADS.to(device), 0, 1e-12)


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
        expected.insert(0, "kvision::quad_shapes")
    assert [name for name in operators if name.startswith("kvision::")] == expected, operators
    assert device.type == "cpu" or names.count("cudaLaunchKernel") == len(expected), names
    assert device.type == "cpu" or names.count("cudaStreamSynchronize") == len(expected) - 1, names


def test_whole_boxes_are_slices(device):
    """Exact: the matrix of a box of whole pixels has whole numbers."""
    x = torch.rand(2, 3, 613, 1021, device=device)
    boxes = torch.tensor([[101, 37, 900, 600], [3, 11, 802, 574]], device=device)
    x0, y0, x1, y1 = boxes.unbind(1)
    corners = torch.stack([x0, y0, x1, y0, x1, y1, x0, y1], 1).reshape(2, 4, 2).float()
    found = G.crop_and_resize(x, corners, (564, 800))
    for i, (left, top, right, bottom) in enumerate(boxes.tolist()):
        assert torch.equal(found[i], x[i, :, top : bottom + 1, left : right + 1])
