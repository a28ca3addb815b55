"""Affine matrices of medical volumes."""

import pytest
import torch

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
# Voxels of 2 x 3 x 4 mm, whose x points to the back and whose y to the left (LPS).
SPACING, ORIGIN = torch.tensor([2.0, 3, 4]).double(), torch.tensor([10.0, 20, -30]).double()
DIRECTION = torch.tensor([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]).double()
LPS = torch.tensor([[0.0, 3, 0, 10], [2, 0, 0, 20], [0, 0, 4, -30], [0, 0, 0, 1]]).double()


class TestVolumes(CompositionTests):
    cases = {
        "affine_ras_to_lps": Case(G.affine_ras_to_lps, ((2, 4, 4),)),
        "affine_from_spacing": Case(G.affine_from_spacing, ((2, 3), (2, 3), (2, 3, 3))),
        "affine_to_spacing": Case(lambda x: torch.cat([y.flatten(1) for y in G.affine_to_spacing(x)], 1), ((2, 4, 4),)),
        "voxel_transform": Case(
            lambda x, y: G.voxel_transform(x, y + 4 * torch.eye(4, dtype=y.dtype, device=y.device)),
            ((2, 4, 4), (2, 4, 4)),
        ),
    }
    compiled = ()


def test_values(device):
    on = [x.to(device) for x in (SPACING, ORIGIN, DIRECTION)]
    affine = G.affine_from_spacing(*on)
    assert_close(affine.cpu(), LPS, 0, 0)
    for part, expected in zip(G.affine_to_spacing(affine), on):
        assert_close(part, expected, 0, 0)
    ras = G.affine_ras_to_lps(affine)
    assert ras[:, 3].tolist() == [-10, -20, -30, 1] and torch.equal(G.affine_ras_to_lps(ras), affine)
    assert_close(G.affine_from_spacing(SPACING.expand(2, 1, 3), ORIGIN)[1, 0, :3].diagonal(), SPACING, 0, 0)


def test_resampling_on_the_grid_of_another_volume(device):
    """A volume that is linear in the patient's coordinates is the same function on every grid."""
    fine = G.affine_from_spacing(torch.tensor([1.0, 1.5, 2.0]), torch.tensor([-3.0, 2.0, 1.0]))[None].to(device)
    coarse = G.affine_from_spacing(torch.tensor([2.0, 1.0, 1.5]), torch.tensor([-2.0, 2.5, 2.0]))[None].to(device)

    def shown(affine: torch.Tensor, depth: int, height: int, width: int) -> torch.Tensor:
        z, y, x = torch.meshgrid(
            *(torch.arange(float(n), device=device) for n in (depth, height, width)), indexing="ij"
        )
        places = G.transform_points(affine, torch.stack([x, y, z], -1).view(1, -1, 3))
        return (places @ torch.tensor([1.0, 10, 100], device=device)).view(1, 1, depth, height, width)

    moved = K.geometry.warp_affine3d(shown(fine, 6, 7, 8), G.voxel_transform(fine, coarse)[:, :3], (4, 5, 3))
    assert_close(moved, shown(coarse, 4, 5, 3), 0, 1e-3)


BAD = [
    (lambda: G.affine_ras_to_lps(torch.eye(3)), ValueError, "expected affine of shape"),
    (lambda: G.affine_from_spacing(torch.ones(2, 3), torch.ones(3, 3)), ValueError, "expected leading axes"),
    (lambda: G.affine_from_spacing(torch.ones(3, dtype=torch.int64), torch.ones(3)), TypeError, "floating point"),
    (lambda: G.voxel_transform(torch.eye(4), torch.ones(2, 3, 4)), ValueError, "expected affine_dst of shape"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
