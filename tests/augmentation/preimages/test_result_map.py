"""Positions of a result that read given points, and the inside of quadrilaterals."""

from __future__ import annotations

import torch
from torch import Tensor

from kvision.augmentation.preimages.result_map import EXACT, INSIDE, NEAREST_PIXEL, PIXEL, ResultMap, result_map
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, vector

H, W, MARGIN = 21, 39, 2
X, Y = (
    torch.cat([torch.tensor([-9.0, -4, -0.5]), torch.arange(n - 6.0), n - 6.5 + torch.tensor([0.0, 3, 8])])[None]
    for n in (W, H)
)


def coordinates() -> Tensor:
    """A map that folds."""
    nodes = torch.stack([X.expand(H, W), Y.mT.expand(H, W)], -1).double()
    return nodes + 0.7 * torch.randn(H, W, 2, dtype=torch.float64)


def kinds() -> Tensor:
    shown = torch.zeros(H, W, dtype=torch.uint8)
    shown[MARGIN:-MARGIN, MARGIN:-MARGIN] = INSIDE
    shown[MARGIN + 1 : -MARGIN - 1, MARGIN + 1 : -MARGIN - 1] = PIXEL
    shown[8:10, 20:] = 0
    return shown


def quads() -> Tensor:
    size = torch.tensor([[0.0, 0], [1, 0.1], [0.9, 1], [-0.1, 0.8]], dtype=torch.float64)
    corners = 20 * torch.rand(6, 1, 2, dtype=torch.float64)
    return (corners + size * (0.1 + 15 * torch.rand(6, 1, 2, dtype=torch.float64))).flatten(1)


def points() -> Tensor:
    return torch.rand(9, 2, dtype=torch.float64) * torch.tensor([44.0, 26]) - 6


class TestPreimageOperators(PointOpTests):
    calls = {
        "preimage_extents": [
            Call(
                (quads, vector(6, 8), coordinates, kinds, X.double(), Y.double()),
                (MARGIN,),
                broadcasts=False,
                differentiable=False,
                accepted=("margin 0",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,  # the roots of quadratic equations of nearly degenerate cells
            )
        ],
        "preimage_points": [
            Call(
                (points, coordinates, kinds, X.double(), Y.double()),
                (MARGIN,),
                broadcasts=False,
                differentiable=False,
                accepted=("margin 0",),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
            )
        ],
    }


def wavy(size: tuple[int, int], strength: float, device: torch.device) -> tuple[ResultMap, Tensor]:
    """A map of a result, and what its pixels read, (H, W, 2)."""

    def read(nodes: Tensor, margin: int) -> tuple[Tensor, Tensor]:
        at = nodes.clone()
        at[..., 0] += strength * (nodes[..., 1] / 5).sin() * (nodes[..., 0] / 4).cos()
        at[..., 1] += strength * (nodes[..., 0] / 6 + 1).cos()
        return at[None], torch.ones(1, *nodes.shape[:2], dtype=torch.bool, device=device)

    known = result_map(size, 200, torch.zeros(1, device=device), read)
    edge = known.margin + 1
    return known, known.coordinates[0, edge:-edge, edge:-edge]


def test_known_values(device: torch.device) -> None:
    """Where nothing is displaced, positions are the points, whether there are pixels or not, and extents the corners."""
    known, _ = wavy((20, 30), 0.0, device)
    points = torch.tensor(
        [[[3.25, 7.5], [0.0, 0.0], [29.4, 19.4], [-3.0, 5.0], [40.0, 25.0], [150.0, -90.0]]], device=device
    )
    positions, kinds = known.positions(points)
    torch.testing.assert_close(positions, points, rtol=0, atol=1e-3)
    assert kinds.tolist() == [[EXACT, EXACT, EXACT, 0, 0, 0]]
    quads = torch.tensor(
        [[[[2.0, 3], [8, 3], [8, 5], [2, 5]], [[-4.0, 2.1], [0.3, 2.1], [0.3, 2.2], [-4, 2.2]]]], device=device
    )
    shown, whole = known.extents(quads, torch.tensor([[-1.0, 0], [1, 0], [0, -1], [0, 1]], device=device)).unbind(2)
    torch.testing.assert_close(whole[0], torch.tensor([[-2.0, 8, -3, 5], [4, 0.3, -2.1, 2.2]], device=device))
    torch.testing.assert_close(shown[0], torch.tensor([[-2.0, 8, -3, 5], [0.5, 0.3, -2.1, 2.2]], device=device))


def test_folded_map(device: torch.device) -> None:
    """All pixels that read from inside a box are in its extents; a point is where the pixel is that reads nearest to it."""
    known, reads = wavy((120, 150), 6.0, device)
    corners = torch.rand(1, 40, 1, 2, device=device) * 90
    quads = corners + torch.tensor([[0.0, 0], [30, 0], [30, 20], [0, 20]], device=device)
    shown = known.extents(quads, torch.tensor([[-1.0, 0], [1, 0], [0, -1], [0, 1]], device=device))[0, :, 0]
    for quad, (left, right, top, bottom) in zip(
        quads[0], (shown * torch.tensor([-1, 1, -1, 1], device=device)).tolist()
    ):
        is_inside = ((reads >= quad[0]) & (reads <= quad[2])).all(-1)
        rows, columns = is_inside.nonzero().unbind(1)
        for first, last, at in ((left, right, columns), (top, bottom, rows)):
            assert first <= at.min() + 1e-3 and at.max() - 1e-3 <= last
            assert at.min() - first < 4 and last - at.max() < 4  # parts that are narrower than a pixel
    points = torch.rand(1, 60, 2, device=device) * torch.tensor([149.0, 119], device=device)
    positions, kinds = known.positions(points)
    near = (reads - points[0, :, None, None]).square().sum(-1).flatten(1).argmin(1)
    pixels = torch.stack([near % 150, near // 150], -1)
    visible = kinds[0] > 0
    assert visible.sum() > 40 and (kinds == EXACT).sum() > 40
    assert ((positions[0] - pixels)[visible].norm(dim=-1) <= 1.5).all()
    assert torch.equal(positions[0][kinds[0] == NEAREST_PIXEL], pixels[kinds[0] == NEAREST_PIXEL].float())
