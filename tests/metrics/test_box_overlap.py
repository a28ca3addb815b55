"""Overlaps of boxes and their losses: values of torchvision 0.29.1, and polygons of rotated boxes clipped in float64."""

import pytest
import torch
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

M, L = K.metrics, K.losses
NAMES = ("generalized_box_iou", "distance_box_iou", "complete_box_iou")


def upright(x: Tensor) -> Tensor:
    return torch.cat([x[..., :2], x[..., :2] + x[..., 2:4]], -1)


class TestOverlaps(CompositionTests):
    cases = {
        "generalized_box_iou": Case(lambda a, b: M.generalized_box_iou(upright(a), upright(b)), ((2, 3, 4), (2, 5, 4))),
        "distance_box_iou": Case(lambda a, b: M.distance_box_iou(upright(a), upright(b)), ((2, 3, 4), (2, 5, 4))),
        "complete_box_iou": Case(
            lambda a, b: M.complete_box_iou(upright(a), upright(b)), ((2, 3, 4), (2, 5, 4)), differentiable=False
        ),
        "box_iou_rotated": Case(M.box_iou_rotated, ((2, 3, 5), (2, 4, 5))),
        "generalized_box_iou_loss": Case(
            lambda a, b: L.generalized_box_iou_loss(upright(a), upright(b)), ((2, 3, 4), (2, 3, 4))
        ),
    }
    compiled = ("generalized_box_iou", "box_iou_rotated")


A = [[0.0, 0, 4, 2], [1, 1, 3, 4]]
B = [[1.0, 0, 5, 3], [6, 6, 7, 9]]
VALUES = {
    "generalized_box_iou": [[0.361904762, -0.825396825], [0.160714286, -0.8125]],
    "distance_box_iou": [[0.391806723, -0.48076923], [0.223214286, -0.4525]],
    "complete_box_iou": [[0.391512699, -0.530769226], [0.220353624, -0.453302399]],
}
LOSSES = {
    "generalized_box_iou": [0.638095241, 1.812499998],
    "distance_box_iou": [0.60819328, 1.4525],
    "complete_box_iou": [0.608487304, 1.453302399],
}


@pytest.mark.parametrize("name", NAMES)
def test_values_of_torchvision(name, device):
    a, b = torch.tensor(A, device=device, dtype=torch.float64), torch.tensor(B, device=device, dtype=torch.float64)
    overlaps, loss = getattr(M, name)(a, b), getattr(L, f"{name}_loss")
    assert_close(overlaps.cpu(), torch.tensor(VALUES[name], dtype=torch.float64), 0, 1e-8)
    assert_close(loss(a, b).cpu(), torch.tensor(LOSSES[name], dtype=torch.float64), 0, 1e-8)
    assert_close(loss(a, b, "mean"), loss(a, b).mean())
    assert loss(a[:0], b[:0], "mean") == 0
    assert_close(loss(a.half(), b), loss(a, b).to(torch.float64))  # of the wider type
    inverted = b[:, [2, 1, 0, 3]]
    assert getattr(M, name)(a, inverted).isnan().all() and loss(inverted, a).isnan().all()


def test_gradient_of_the_complete_overlap(device):
    """Its alpha is a constant: the gradient is that of the formula with alpha's value."""
    a, b = (torch.tensor(x, device=device, dtype=torch.float64).requires_grad_() for x in (A, B))
    result = M.complete_box_iou(a, b)
    angle = [torch.atan((x[:, 2] - x[:, 0]) / (x[:, 3] - x[:, 1])) for x in (a, b)]
    v = 4 / torch.pi**2 * (angle[0][:, None] - angle[1]).square()
    alpha = (v / (1 - M.mean_iou_bbox(a, b) + v + 1e-7)).detach()
    expected = M.distance_box_iou(a, b) - alpha * v
    assert_close(result, expected)
    for g, e in zip(torch.autograd.grad(result.sum(), (a, b)), torch.autograd.grad(expected.sum(), (a, b))):
        assert_close(g, e)


def clipped_area(polygon: list[complex], by: list[complex]) -> float:
    """The area of a convex polygon inside of another, both counter-clockwise in axes (x, y): side after side is cut off."""
    for start, end in zip(by, by[1:] + by[:1]):
        kept = []
        for p, q in zip(polygon, polygon[1:] + polygon[:1]):
            inside_p, inside_q = (((end - start).conjugate() * (x - start)).imag for x in (p, q))
            if inside_p >= 0:
                kept.append(p)
            if inside_p * inside_q < 0:
                kept.append(p + (q - p) * inside_p / (inside_p - inside_q))
        polygon = kept
    return sum((p.conjugate() * q).imag for p, q in zip(polygon, polygon[1:] + polygon[:1])) / 2


def rotated(n: int, seed: int) -> Tensor:
    r = torch.rand(n, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return torch.cat([10 * r[:, :2], 1 + 6 * r[:, 2:4], 720 * r[:, 4:] - 360], 1)


def test_rotated_boxes_are_polygons(device):
    a, b = rotated(9, 1), rotated(12, 2)
    a[:4, 4] = torch.tensor([0.0, 90, -90, 180])
    b[:4, 4] = torch.tensor([0.0, 0, 90, 45])
    b[4] = a[3]
    corners = [K.geometry.convert_boxes(x, "cxcywhr", "xyxyxyxy").reshape(-1, 4, 2).tolist() for x in (a, b)]
    polygons = [[[complex(*corner) for corner in box] for box in boxes] for boxes in corners]
    both = torch.tensor([[clipped_area(p, q) for q in polygons[1]] for p in polygons[0]], dtype=torch.float64)
    area_a, area_b = (x[:, 2] * x[:, 3] for x in (a, b))
    expected = both / (area_a[:, None] + area_b - both)
    assert 0.3 < (expected > 0).double().mean() < 0.9
    assert_close(M.box_iou_rotated(a.to(device), b.to(device)).cpu(), expected, 0, 1e-12)
    assert_close(M.box_iou_rotated(a.to(device).float(), b.to(device).float()).cpu(), expected.float(), 0, 1e-5)


def test_rotated_boxes_whose_edges_coincide(device):
    # torchvision 0.29.1: box_iou(fmt="cxcywhr")
    a = torch.tensor([[5.0, 5, 4, 2, 30], [5, 5, 4, 2, 0]], dtype=torch.float64, device=device)
    b = torch.tensor([[5.0, 5, 4, 2, -15], [6, 5.5, 3, 3, 60], [5, 5, 4, 2, 30]], dtype=torch.float64, device=device)
    expected = torch.tensor([[0.517428279, 0.369528532, 1.0], [0.76196754, 0.391559869, 0.623309672]]).double()
    assert_close(M.box_iou_rotated(a, b).cpu(), expected, 0, 1e-7)
    boxes = rotated(50, 3).float().to(device)
    half_turn = boxes + torch.tensor([0.0, 0, 0, 0, 180], device=device)
    for other in (boxes, half_turn):
        leaf = boxes.clone().requires_grad_()
        own = M.box_iou_rotated(leaf, other).diagonal()
        assert_close(own, torch.ones_like(own), 0, 1e-6)
        assert torch.autograd.grad(own.sum(), leaf)[0].isfinite().all()
    x, y = (torch.tensor(v, dtype=torch.float64, device=device) for v in (A, B))
    turned = [K.geometry.convert_boxes(v, "xyxy", "cxcywhr") for v in (x, y)]
    assert_close(M.box_iou_rotated(*turned), M.mean_iou_bbox(x, y))
    assert M.box_iou_rotated(turned[0] * torch.tensor([1.0, 1, 0, 1, 1], device=device), turned[1]).isnan().all()


BAD = [
    (lambda: M.generalized_box_iou(torch.ones(2, 5), torch.ones(2, 4)), r"expected boxes1 of shape \(\*, N, 4\)"),
    (lambda: M.box_iou_rotated(torch.ones(2, 5), torch.ones(2, 4)), r"expected boxes2 of shape \(\*, M, 5\)"),
    (lambda: M.distance_box_iou(torch.ones(2, 2, 4), torch.ones(3, 2, 4)), "leading axes that broadcast"),
    (lambda: L.complete_box_iou_loss(torch.ones(2, 4), torch.ones(3, 4)), "expected boxes of one shape"),
    (lambda: L.complete_box_iou_loss(torch.ones(2, 4), torch.ones(2, 4), "max"), "reduction"),
]


@pytest.mark.parametrize("call, message", BAD, ids=range(len(BAD)))
def test_errors(call, message):
    with pytest.raises(ValueError, match=message):
        call()
