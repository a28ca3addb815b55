"""Crops: the operator that makes their matrices, and what must be exact."""

import pytest
import torch

import kvision as K
from kvision.geometry.transform.crop import _crop_matrix
from op_tests import assert_close

G = K.geometry
QUADS = torch.tensor([[[1.3, 1.1], [5.2, 0.7], [4.9, 3.8], [0.9, 4.2]], [[2.0, 1], [6, 1], [6, 4], [2, 4]]]).double()
FLAT = torch.tensor([[[3.0, 2], [3, 2], [3, 2], [3, 2]], [[1.0, 2], [5, 2], [5, 2], [1, 2]]]).double()


@pytest.mark.parametrize("size", [(5, 7), (1, 1), (1, 6)])
def test_matrices(size, device):
    for quads in (QUADS, FLAT, 1000 * QUADS):
        quads = quads.to(device)
        with K.backend("reference"):
            expected = _crop_matrix(quads, list(size))
        assert_close(_crop_matrix(quads, list(size)), expected, 1e-12, 1e-12)
        assert_close(_crop_matrix(quads.float(), list(size)), expected.float())


def test_matrices_take_corners_to_corners(device):
    matrix = _crop_matrix(QUADS.to(device), [5, 7])
    corners = torch.tensor([[0.0, 0, 1], [6, 0, 1], [6, 4, 1], [0, 4, 1]], dtype=torch.float64, device=device)
    found = corners @ matrix.mT
    assert_close(found[..., :2] / found[..., 2:], QUADS.to(device), 0, 1e-12)


def test_matrices_as_an_operator(device, backend):
    quads = QUADS.to(device, copy=True).requires_grad_()
    assert torch.autograd.gradcheck(lambda q: _crop_matrix(q, [5, 7]), quads)
    assert torch.autograd.gradgradcheck(lambda q: _crop_matrix(q, [5, 7]), quads)
    each = torch.func.vmap(lambda q: _crop_matrix(q[None], [5, 7])[0])(quads.detach())
    assert_close(each, _crop_matrix(quads.detach(), [5, 7]))
    if backend != "reference":
        torch.library.opcheck(torch.ops.kvision.crop_matrix.default, (quads, [5, 7]))
        for wrong in (quads[0], quads[:, :3], quads.half()):
            with pytest.raises(RuntimeError, match="^crop_matrix: "):
                torch.ops.kvision.crop_matrix(wrong.detach(), [5, 7])
        with pytest.raises(RuntimeError, match="^crop_matrix: expected a size"):
            torch.ops.kvision.crop_matrix(quads.detach(), [5, 0])


def test_two_operators_a_call(device, backend):
    """The matrix and the warp."""
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x, boxes = torch.rand(2, 3, 16, 16, device=device), QUADS.to(device).float()
    G.crop_and_resize(x, boxes, (8, 8))
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profile:
        G.crop_and_resize(x, boxes, (8, 8))
    names = [event.name for event in profile.events()]
    free = ("aten::empty", "aten::contiguous")  # of what is contiguous
    operators = [name for name in names if "::" in name and not name.startswith(free)]
    assert operators == ["kvision::crop_matrix", "kvision::warp"], operators
    assert device.type == "cpu" or names.count("cudaLaunchKernel") == 2, names


def test_whole_boxes_are_slices(device):
    """Exact: the matrix of a box of whole pixels has whole numbers."""
    x = torch.rand(2, 3, 613, 1021, device=device)
    boxes = torch.tensor([[101, 37, 900, 600], [3, 11, 802, 574]], device=device)
    x0, y0, x1, y1 = boxes.unbind(1)
    corners = torch.stack([x0, y0, x1, y0, x1, y1, x0, y1], 1).reshape(2, 4, 2).float()
    found = G.crop_and_resize(x, corners, (564, 800))
    for i, (left, top, right, bottom) in enumerate(boxes.tolist()):
        assert torch.equal(found[i], x[i, :, top : bottom + 1, left : right + 1])
