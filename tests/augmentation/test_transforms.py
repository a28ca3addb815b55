"""Matrices of chains of transforms from columns of parameters."""

import math

import pytest
import torch
from torch import Tensor

import kvision as K
from kvision.augmentation.columns import Column
from kvision.augmentation.transforms import MAX_TRANSFORMS, Transform, make_plan, transform_matrix
from op_tests import assert_close
from point_op_tests import Call, PointOpTests, vector

affine, C = Transform.affine, [Column(i) for i in range(17)]
CENTER = (7.5, 4.0)
AFFINE = affine((C[7], C[8]), angle=C[0], translation=(C[1], C[2]), scale=(C[3], C[4]), shear=(C[5], C[6]))
CORNERS = (0.0, 0.0, 15.0, 0.0, 15.0, 8.0, 0.0, 8.0)
PERSPECTIVE = Transform("perspective", *CORNERS, *C[9:])
MOVING = Transform("perspective", *C[:16])
CROP = Transform("crop", *C[:4], 8, 6, 0)
CROP_OF_CENTERS = Transform("crop", *C[:4], 8, 6, 1)
FLIP = Transform.constant([[-1, 0, 15], [0, 1, 0], [0, 0, 1]])


def parameters() -> Tensor:
    """Seventeen: those of an affine transform, and four corners near CORNERS."""
    affine_part = torch.tensor([100.0, 3, 2, 1, 1, 20, 10, 7, 4], dtype=torch.float64)
    corners = torch.tensor(CORNERS, dtype=torch.float64)
    return torch.cat([affine_part * (0.9 * torch.rand(9) + 0.1), corners + 2 * torch.rand(8)])


def quads() -> Tensor:
    return torch.tensor(CORNERS * 2, dtype=torch.float64) + 2 * torch.rand(16)


class TestTransformMatrix(PointOpTests):
    common = {"broadcasts": False, "accepted": ("columns of one axis less",)}
    calls = {
        "transform_matrix": [
            Call((parameters,), make_plan([AFFINE])),
            Call((parameters,), make_plan([FLIP, PERSPECTIVE, AFFINE, CROP])),
            Call((quads,), make_plan([MOVING])),
            Call((vector(4, scale=9),), make_plan([CROP, CROP_OF_CENTERS])),
            Call((vector(9),), make_plan([Transform("matrix", *C[:9]), FLIP])),
            Call((vector(3),), make_plan([affine(CENTER, angle=C[0], scale=(C[1], C[1])), affine(CENTER, angle=C[0])])),
        ]
    }


def matrices(columns: list[list[float]], *transforms: Transform, device: torch.device, dtype=torch.float32) -> Tensor:
    return transform_matrix(torch.tensor(columns, dtype=dtype, device=device), transforms)


def moved(matrix: Tensor, points: list[list[float]]) -> Tensor:
    return K.geometry.transform_points(matrix, torch.tensor([points], dtype=matrix.dtype, device=matrix.device))[0]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_identity_is_exact(dtype, device):
    for h, w in ((9, 16), (223, 317), (4095, 8191), (1, 1)):
        corners = [0.0, 0.0, w - 1, 0.0, w - 1, h - 1, 0.0, h - 1]
        shifted = [x + 0.3 for x in corners]
        chain = (
            affine(
                ((w - 1) / 2, (h - 1) / 2), angle=C[0], translation=(C[0], C[0]), scale=(C[1], C[1]), shear=(C[0], C[0])
            ),
            Transform("crop", C[2], C[3], w, h, w, h, 0),
            Transform("crop", C[2], C[3], w, h, w, h, 1),
            *(Transform("perspective", *c, *c) for c in ((corners, shifted) if h > 1 else ())),
        )
        result = matrices([[0.0, 1.0, 0.0, 0.0], [-0.0, 1.0, 0.0, 0.0]], *chain, device=device, dtype=dtype)
        assert torch.equal(result, torch.eye(3, dtype=dtype, device=device).expand(2, 3, 3))
        assert not result.signbit().any()


def test_flips_and_quarter_turns_are_exact(device):
    turn = affine((3.5, 3.5), angle=C[0])
    result = matrices([[90.0], [180.0], [270.0], [-90.0], [360.0]], turn, device=device)
    quarter = [[0, 1, 0], [-1, 0, 7], [0, 0, 1]]  # counter-clockwise, with the y axis down
    half, three = [[-1, 0, 7], [0, -1, 7], [0, 0, 1]], [[0, -1, 7], [1, 0, 0], [0, 0, 1]]
    expected = torch.tensor([quarter, half, three, three, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    assert torch.equal(result.cpu(), expected.float())
    scale = affine((100.5, 20.0), scale=(C[0], C[1]))
    result = matrices([[-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]], scale, device=device)
    assert result[:, 0, 2].tolist() == [201, 0, 201] and result[:, 1, 2].tolist() == [0, 40, 40]
    assert torch.equal(result[:, :2, :2].diagonal(0, 1, 2).cpu(), torch.tensor([[-1.0, 1], [1, -1], [-1, -1]]))


def test_affine_is_a_rotation_counter_clockwise_about_the_center(device):
    result = matrices([[30.0]], affine(CENTER, angle=C[0]), device=device, dtype=torch.float64)
    expected = K.geometry.get_rotation_matrix2d(
        torch.tensor([CENTER], dtype=torch.float64, device=device),
        torch.tensor([30.0], dtype=torch.float64, device=device),
        torch.ones(1, 2, dtype=torch.float64, device=device),
    )
    assert_close(result[:, :2], expected)


def test_affine_shears_then_scales_then_rotates_then_translates(device):
    columns = [[25.0, 3.0, -2.0, 1.2, 0.8, 10.0, -20.0]]
    about = affine(CENTER, angle=C[0], translation=(C[1], C[2]), scale=(C[3], C[4]), shear=(C[5], C[6]))
    result = matrices(columns, about, device=device, dtype=torch.float64)[0].cpu()
    a, b, t = math.tan(math.radians(10)), math.tan(math.radians(-20)), math.radians(25)
    shear = torch.tensor([[1, 0], [-b, 1]], dtype=torch.float64) @ torch.tensor([[1, -a], [0, 1]], dtype=torch.float64)
    rotation = torch.tensor([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]], dtype=torch.float64)
    linear = rotation @ torch.diag(torch.tensor([1.2, 0.8], dtype=torch.float64)) @ shear
    center = torch.tensor(CENTER, dtype=torch.float64)
    assert_close(result[:2, :2], linear)
    assert_close(result[:2, 2], center + torch.tensor([3.0, -2.0], dtype=torch.float64) - linear @ center)


def test_perspective_takes_points_to_points(device):
    columns = torch.stack([quads() for _ in range(3)]).to(device)
    result = transform_matrix(columns, [MOVING])
    source, destination = columns.view(3, 2, 4, 2).unbind(1)
    assert_close(K.geometry.transform_points(result, source), destination)
    assert_close(result, K.geometry.get_perspective_transform(source, destination))


@pytest.mark.parametrize("side", [[0, 0, 8, 0, 8, 0, 0, 0], [0, 0, 0, 0, 0, 8, 0, 8], [0.0] * 8])
def test_perspective_moves_nothing_where_a_side_is_a_single_pixel(side, device):
    columns = torch.cat([torch.tensor(side), torch.rand(8)])[None].to(device).requires_grad_()
    result = transform_matrix(columns, [MOVING])
    assert torch.equal(result[0], torch.eye(3, device=device))
    assert not torch.autograd.grad(result.sum(), columns)[0].any()


def test_crops_take_corners_to_corners(device):
    box = [[2.0, 3.0, 6.0, 4.0]]
    centers = matrices(box, CROP_OF_CENTERS, device=device)
    assert_close(moved(centers, [[2, 3], [7, 6]]).cpu(), torch.tensor([[0.0, 0], [7, 5]]))
    edges = matrices(box, CROP, device=device)
    assert_close(moved(edges, [[1.5, 2.5], [7.5, 6.5]]).cpu(), torch.tensor([[-0.5, -0.5], [7.5, 5.5]]))


def test_crops_of_a_pixel_can_be_inverted(device):
    single = Transform("crop", 5, 6, 1, 1, 4, 1, 1)
    result = matrices([[0.0]], single, device=device, dtype=torch.float64)
    assert result.inverse().isfinite().all()


def test_chains_are_products(device):
    columns = torch.stack([parameters() for _ in range(4)]).to(device)
    chain = [FLIP, PERSPECTIVE, AFFINE, CROP]
    product = torch.eye(3, dtype=torch.float64, device=device)
    for transform in chain:
        product = transform_matrix(columns, [transform]) @ product
    assert_close(transform_matrix(columns, chain), product)
    long = chain * 5
    assert len(long) > MAX_TRANSFORMS
    split = transform_matrix(columns, long[8:]) @ transform_matrix(columns, long[:8])
    scale = split.abs().amax()
    assert_close(transform_matrix(columns, long) / scale, split / scale)


@pytest.mark.native  # the reference does not read columns that no transform takes
def test_an_empty_chain_is_the_identity(device):
    columns = torch.rand(2, 3, device=device, requires_grad=True)
    result = transform_matrix(columns, [])
    assert torch.equal(result, torch.eye(3, device=device).expand(2, 3, 3))
    assert not torch.autograd.grad(result.sum(), columns)[0].any()


def test_float32_columns_are_computed_in_double(device):
    """A rotation and its inverse about a far center leave nothing of float32's rounding."""
    far, back = affine((1e5, 1e5), angle=C[0]), affine((1e5, 1e5), angle=C[1])
    result = matrices([[33.0, -33.0]], far, back, device=device)
    assert (result - torch.eye(3, device=device)).abs().max() < 1e-6


def test_gradient_of_a_column_that_is_used_twice(device):
    columns = torch.tensor([[0.3]], dtype=torch.float64, device=device, requires_grad=True)
    transform_matrix(columns, [affine((0.0, 0.0), scale=(C[0], C[0]))])[0, :2, :2].sum().backward()
    assert columns.grad.item() == 2


def test_gradient_at_the_identity(device):
    corners = torch.tensor([CORNERS * 2], dtype=torch.float64, device=device, requires_grad=True)
    assert torch.equal(transform_matrix(corners, [MOVING])[0], torch.eye(3, dtype=torch.float64, device=device))

    def moved_corner(c: Tensor) -> Tensor:
        return K.geometry.transform_points(transform_matrix(c, [MOVING]), corners.detach()[:, :8].view(1, 4, 2))

    (jacobian,) = torch.autograd.functional.jacobian(moved_corner, (corners,))
    jacobian = jacobian.view(8, 16)
    eye = torch.eye(8, dtype=torch.float64, device=device)
    assert_close(jacobian, torch.cat([-eye, eye], 1))


@pytest.mark.native
def test_plans_are_checked(device):
    operator = torch.ops.kvision.transform_matrix
    columns = torch.zeros(2, 9, device=device)
    plan, numbers = make_plan([AFFINE])
    for bad_plan, bad_numbers, message in (
        ([9, *plan[1:]], numbers, "no kind of transform 9"),
        ([*plan[:-1], 9], numbers, "no column 9"),
        (plan[:-1], numbers, "9 columns of inputs"),
        (plan, numbers[1:], "expected 9 numbers, got 8"),
        (plan * (MAX_TRANSFORMS + 1), numbers * (MAX_TRANSFORMS + 1), "at most 16 transforms"),
    ):
        with pytest.raises(RuntimeError, match=f"transform_matrix: .*{message}"):
            operator(columns, bad_plan, bad_numbers)
