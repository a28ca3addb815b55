"""Essential matrices and the motions they stand for."""

import cv2
import pytest
import torch

import kvision as K
from composition_tests import Case
from kvision.geometry.solvers._minimal import eliminated
from op_tests import assert_close
from point_op_tests import SINGLE_AND_DOUBLE, Call, PointOpTests, near, vector
from view_tests import CAMERA, NoSolvers, Scene, ViewTests, camera, finite_gradients, on_planes, points, rand, rays

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)
SCENE = Scene(1, 8)
SEEN = [(x - CAMERA[:2, 2]) / CAMERA.diagonal()[:2] for x in (SCENE.x1, SCENE.x2)]
POINTS = (2, 12, 2)


class TestEssential(ViewTests):
    # Candidates are added up: their order is open.
    cases = {
        # Rounding chooses the basis of what five equations leave: where that is ill-conditioned, differences are not exact.
        "essential": Case(
            lambda x: G.find_essential(rays(x, SEEN[0]), rays(x.flip(1), SEEN[1])).nan_to_num(0.0).square().sum(1),
            ((2, 5, 2),),
        ),
        "nearest": Case(G.epipolar.project_to_essential, ((2, 3, 3),)),
        "rotations": Case(lambda e: torch.cat(G.decompose_essential_matrix(e)[:2], -1).square(), ((2, 3, 3),)),
        "motion": Case(
            lambda x, e: G.motion_from_essential_choose_solution(e, camera(x), camera(x), points(x, X), points(x, Y))[2],
            (POINTS, (2, 3, 3)),
        ),
    }  # fmt: skip
    compiled = ()

    def test_no_solver_is_called(self, case, device, backend):
        if case is self.cases["essential"] and device.type == "cpu":
            pytest.skip("the CPU has a solver in place of `eliminated`")
        super().test_no_solver_is_called(case, device, backend)


def test_elimination_solves_without_a_library(device):
    """What GPUs run in place of the solver of the CPU."""
    left, right = torch.rand(5, 10, 10, dtype=torch.float64), torch.rand(5, 10, 10, dtype=torch.float64)
    with NoSolvers():
        result = eliminated(left.to(device), right.to(device))
    assert_close(result.cpu(), torch.linalg.solve(left, right), 1e-9, 1e-9)
    assert not eliminated(torch.zeros(1, 3, 3, device=device), torch.ones(1, 3, 1, device=device)).isfinite().any()


def test_exact_essential_matrices_have_gradients(device):
    """Their two equal singular values have no vectors of their own."""
    E = SCENE.E.to(device)
    finite_gradients(G.epipolar.project_to_essential, E)
    finite_gradients(lambda e: torch.cat(G.decompose_essential_matrix(e), -1), E)
    assert_close(G.epipolar.project_to_essential(E), E)


def test_motions_of_degenerate_matrices_are_rotations(device, backend):
    """One of them, where they are not the only one: of rank one, of three equal values, and of zeros."""
    matrices = torch.stack([torch.zeros(3, 3), torch.ones(3, 3), torch.eye(3), torch.diag(torch.tensor([1, 1e-9, 0]))])
    R, _ = G.motion_from_essential(matrices.to(device))
    finite_gradients(lambda e: torch.cat(G.motion_from_essential(e), -1), matrices.to(device))
    finite_gradients(G.epipolar.project_to_essential, matrices.to(device))
    if backend != "reference":
        assert_close(R @ R.mT, torch.eye(3, device=device).expand_as(R), 0, 1e-6)


def test_the_choice_of_a_motion_is_the_references(device):
    scene = Scene(3, 40, noise=0.3)
    E = scene.E * torch.tensor([1.0, -2.0, 3.0]).double().view(3, 1, 1)
    mask = rand(3, 40) > 0.5
    args = [x.to(device) for x in (E, CAMERA.expand(3, 3, 3), CAMERA.expand(3, 3, 3), scene.x1, scene.x2)]
    for chosen in (None, mask.to(device)):
        result = G.motion_from_essential_choose_solution(*args, chosen)
        with K.backend("reference"):
            assert_close(result, G.motion_from_essential_choose_solution(*args, chosen), 1e-9, 1e-9)
        assert result[3].tolist() == ([40] * 3 if chosen is None else mask.sum(1).tolist())


def test_no_candidates_for_points_on_a_line(device):
    line = torch.arange(5.0, device=device).double()[None, :, None].expand(1, 5, 2)
    assert finite_gradients(G.find_essential, line, line).isnan().all()


def test_opencv_essential_and_pose():
    scene = Scene(1, 40)
    x, y = scene.x1[0].numpy(), scene.x2[0].numpy()
    E, _ = cv2.findEssentialMat(x, y, CAMERA.numpy())
    _, R, t, _ = cv2.recoverPose(E, x, y, CAMERA.numpy())
    result = G.motion_from_essential_choose_solution(scene.E, CAMERA, CAMERA, scene.x1[0], scene.x2[0])
    assert_close(result[0], torch.from_numpy(R), 1e-4, 1e-4)
    assert_close(result[1], torch.from_numpy(t), 1e-4, 1e-4)
    assert result[3] == 40
    candidates = G.find_essential(*(p[:, :5] for p in scene.normalized()))[0]
    E = torch.from_numpy(E) / torch.from_numpy(E).norm()
    apart = torch.minimum((candidates - E).flatten(1).norm(dim=1), (candidates + E).flatten(1).norm(dim=1))
    assert apart.nan_to_num(9).min() < 1e-6
    # In pixels of two cameras.
    other = torch.tensor([[2.0, 0.1, 3.0], [0.0, 1.5, -4.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    seen = K.geometry.transform_points(other[None], scene.x2)
    pixels = G.find_essential(scene.x1[:, :5], seen[:, :5], K1=CAMERA, K2=(other @ CAMERA)[None])[0]
    assert_close(pixels, candidates, 1e-6, 1e-6)


P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.find_essential(P[:, :4], Q[:, :4]), ValueError, "find_essential: expected points1 of shape .* at least 5"),
    (lambda: G.find_essential(P, Q, K1=M), ValueError, "find_essential: expected K1 and K2, or neither, got K1 alone"),
    (lambda: G.decompose_essential_matrix(P), ValueError, r"decompose_essential_matrix: expected E_mat of shape \(\*, 3, 3\)"),
    (lambda: G.motion_from_essential_choose_solution(M, M, M, P[0], Q[0]), ValueError, "motion_from_essential_choose_solution:"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)


class TestEssentialOperators(PointOpTests):
    calls = {
        "essential_from_fundamental": [Call((vector(3, 3),) * 3)],
        "camera_motion": [Call((vector(3, 3), vector(3, 1)) * 2)],
        "essential_from_motions": [Call((vector(3, 3), vector(3, 1)) * 2)],
    }


class TestMotionOperators(PointOpTests):
    calls = {
        "nearest_essential": [
            Call(
                (near(SCENE.E, 0.1),),
                accepted=("another dtype", "mask of torch.bool"),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
            )
        ],
        "essential_motions": [
            Call(
                (near(SCENE.E, 0.1),),
                accepted=("another dtype", "mask of torch.bool"),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=100,
            )
        ],
        "motion_choice": [
            Call(
                (
                    near(SCENE.E, 0.001),
                    near(CAMERA, 0.01),
                    near(CAMERA, 0.01),
                    near(SCENE.x1[0], 0.01),
                    near(SCENE.x2[0], 0.01),
                    mask,
                ),
                broadcasts=False,
                differentiable=False,
                accepted=("another dtype", "mask of torch.bool"),
                dtypes=SINGLE_AND_DOUBLE,
                tolerance=5000,
            )
            for mask in (None, lambda: torch.ones(8, dtype=torch.bool))
        ],
    }
