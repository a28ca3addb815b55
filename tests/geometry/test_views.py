"""What Kornia cannot tell about several views: gradients, transforms, degenerate input, types, bad arguments, OpenCV."""

from functools import partial

import cv2
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

import kvision as K
from composition_tests import Case, CompositionTests, on
from kvision.geometry.solvers.null_vector import _eigenvectors
from op_tests import assert_close
from view_tests import CAMERA, LENS, Scene, on_planes, rand

G = K.geometry
# Values of the tests are random in [0.1, 1); these are what they are added to.
X, Y, H = on_planes(1, 12)
X7, Y7, LINES_X, LINES_Y = X[:, :7], Y[:, :7], X.view(6, 2, 2), Y.view(6, 2, 2)
QUADS = torch.tensor([[0.0, 0], [40, 3], [42, 41], [1, 44], [20, 9], [33, 27]]).double()
QUARTIC = torch.tensor([0, 0, 2.0, 0, 0])
SCENE = Scene(1, 8)
SEEN = [(x - CAMERA[:2, 2]) / CAMERA.diagonal()[:2] for x in (SCENE.x1, SCENE.x2)]
POINTS = (2, 12, 2)


def points(x: Tensor, base: Tensor) -> Tensor:
    return on(x.device, base).to(x.dtype) + 3 * x


def rays(x: Tensor, seen: Tensor) -> Tensor:
    """As many of them as x has, seen by the camera, and some of x."""
    return on(x.device, seen).to(x.dtype)[:, : x.shape[1]] + 0.3 * x


def camera(x: Tensor) -> Tensor:
    return on(x.device, CAMERA).to(x.dtype).expand(len(x), 3, 3)


class NoSolvers(TorchDispatchMode):
    """An error for what torch asks a library of linear algebra for: on a GPU it waits, and no graph can be captured."""

    def __torch_dispatch__(self, call, types, args=(), kwargs=None):
        name = call.name().removeprefix("aten::").lstrip("_")
        elementwise = name.startswith(("linalg_vector_norm", "linalg_cross"))
        assert elementwise or not name.startswith(("linalg_", "lu_", "cholesky", "triangular_solve", "ormqr")), name
        return call(*args, **(kwargs or {}))


class TestViews(CompositionTests):
    # Candidates are added up: their order is open.
    cases = {
        "homography": Case(lambda x, y: G.find_homography_dlt(points(x, X), points(y, Y)), (POINTS, POINTS)),
        "weighted": Case(lambda x, w: G.find_homography_dlt(x, points(x, Y), w), (POINTS, (2, 12))),
        "iterated": Case(
            lambda x, w: G.find_homography_dlt_iterated(points(x, X), on(x.device, Y).to(x.dtype).expand_as(x), w, 9.0, 3),
            (POINTS, (2, 12)),
        ),
        "lines": Case(
            lambda x, w: G.find_homography_lines_dlt(points(x, LINES_X), points(x, LINES_Y), w),
            ((2, 6, 2, 2), (2, 6)),
        ),
        "normalized": Case(lambda x, w: torch.cat([y[..., -2:] for y in G.normalize_points(x, 1e-3, w)], 1), ((2, 7, 2), (2, 7))),
        "transfer": Case(lambda x, h: G.symmetric_transfer_error(x, x.flip(1), h), (POINTS, (2, 3, 3))),
        "one way": Case(lambda x, h: G.oneway_transfer_error(x, x.flip(1), h[:1], False), ((2, 7, 3), (2, 3, 3))),
        "from one line": Case(
            lambda x, y, f: G.left_to_right_epipolar_distance(x, y, f) + G.right_to_left_epipolar_distance(y, x, f),
            ((2, 7, 3), (2, 7, 2), (2, 3, 3)),
        ),
        "distance": Case(lambda x, h: G.sampson_homography_distance(x, x.flip(1), h, False), (POINTS, (2, 3, 3))),
        "segments": Case(lambda x, h: G.line_segment_transfer_error_one_way(x, x.flip(1), h), ((2, 5, 2, 2), (2, 3, 3))),
        "fundamental": Case(lambda x, y: G.find_fundamental(x, points(y, X)), (POINTS, POINTS)),
        "seven": Case(
            lambda x: G.find_fundamental(points(x, X7), points(x, Y7).flip(1), None, "7POINT").sum(1),
            ((2, 7, 2),),
        ),
        "sampson": Case(lambda x, f: G.sampson_epipolar_distance(x, x.flip(1), f, False), (POINTS, (2, 3, 3))),
        "symmetrical": Case(lambda x, f: G.symmetrical_epipolar_distance(x, x.flip(1), f), (POINTS, (2, 3, 3))),
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
        "camera": Case(lambda p: torch.cat(G.KRt_from_projection(p), -1), ((2, 3, 4),)),
        "cameras": Case(lambda f: G.projections_from_fundamental(f).square(), ((2, 3, 3),)),
        "triangulated": Case(
            lambda x, p: G.triangulate_points(p, p.flip(-1), x, x.flip(1)), ((2, 4, 2), (2, 3, 4))
        ),
        "fundamental, weighted": Case(lambda x, w: G.find_fundamental(x, points(x.flip(1), X), w), (POINTS, (2, 12))),
        "pose, weighted": Case(
            lambda x, k, w: G.solve_pnp_dlt(points(x, SCENE.points), points(x[..., :2], SCENE.x1), camera(x) + k.triu(), w),
            ((2, 8, 3), (2, 3, 3), (2, 8)),
        ),
        "pose": Case(
            lambda x, y: G.solve_pnp_dlt(points(x, SCENE.points), points(y, SCENE.x1), camera(x)),
            ((2, 8, 3), (2, 8, 2)),
        ),
        "distorted": Case(
            lambda x, d: G.distort_points(points(x, QUADS), camera(x), 0.1 * d), ((2, 6, 2), (2, 14))
        ),
        "undistorted": Case(
            lambda x, d: G.undistort_points(points(x, QUADS), camera(x), 0.1 * d), ((2, 6, 2), (2, 14))
        ),
        "affine": Case(lambda x, w: G.find_affine(x, x.square().flip(1), w), (POINTS, (2, 12))),
        "quartic": Case(lambda c: G.solve_quartic(c - on(c.device, QUARTIC)), ((2, 5),)),
        "determinant": Case(G.determinant_to_polynomial, ((2, 3, 13),)),
    }  # fmt: skip
    compiled = ("weighted", "lines", "normalized", "camera", "triangulated")

    def test_autocast_changes_nothing(self, case, device):
        values = self.values(case, device, torch.float32)
        expected = case.call(*values)
        with torch.autocast(device.type, dtype=torch.bfloat16):
            assert_close(case.call(*values), expected, 1e-5, 1e-5)

    def derivatives(self, case: Case, values: list[Tensor]) -> list[Tensor]:
        """The result, gradients, and gradients of a norm of these."""
        leaves = [v.detach().requires_grad_() for v in values]
        output = case.call(*leaves)
        first = torch.autograd.grad(output.nan_to_num(0.0).square().sum(), leaves, create_graph=True, allow_unused=True)
        total = sum(g.square().sum() for g in first if g is not None)
        second = torch.autograd.grad(total, leaves, allow_unused=True)
        return [x.detach() for x in (output, *first, *second) if x is not None]

    def test_no_solver_is_called(self, case, device, backend):
        if backend == "reference":
            pytest.skip("the reference may")
        with NoSolvers():
            self.derivatives(case, self.values(case, device))

    def test_cuda_graph_of_derivatives(self, case, device):
        if device.type != "cuda":
            pytest.skip("needs --device cuda")
        values = self.values(case, device)
        with torch.cuda.stream(torch.cuda.Stream()):
            self.derivatives(case, values)
        torch.cuda.synchronize()
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            captured = self.derivatives(case, values)
        for v, new in zip(values, self.values(case, device)):
            v.copy_(new)
        graph.replay()
        for found, expected in zip(captured, self.derivatives(case, values)):
            assert_close(found, expected, 1e-6, 1e-6)


# --- values at the rim ------------------------------------------------------------------------------------------------


def finite_gradients(function, *args: Tensor) -> Tensor:
    """The result of a call whose gradients are all finite."""
    leaves = [a.clone().requires_grad_() for a in args]
    output = function(*leaves)
    safe = torch.where(output.detach().isfinite() & (output.detach().abs() < 1e30), output, 0)
    grads = torch.autograd.grad(safe.square().sum(), leaves, allow_unused=True)
    assert all(g is None or g.isfinite().all() for g in grads)
    return output.detach()


def test_homographies_of_degenerate_points(device):
    square = torch.tensor([[[0.0, 0], [9, 0], [9, 9], [0, 9]]]).to(device)
    assert_close(
        finite_gradients(G.find_homography_dlt, square, 3 * square + 1)[0, 2, 2], torch.tensor(1.0, device=device)
    )
    line = torch.arange(10.0, device=device)[None, :, None].expand(1, 10, 2)
    one = torch.ones(1, 5, 2, device=device)
    for points in (line, one, torch.zeros_like(one)):
        finite_gradients(G.find_homography_dlt, points, points + 1)
    weights = torch.tensor([[1.0, 1, 1, 1, 0]], device=device)
    outlier = torch.cat([square, square[:, :1] + 50], 1), torch.cat([2 * square, square[:, :1]], 1)
    found = finite_gradients(lambda x, y: G.find_homography_dlt(x, y, weights), *outlier)
    assert_close(found, torch.diag(torch.tensor([2.0, 2, 1], device=device))[None], 0, 1e-4)


def test_fundamental_matrices_of_degenerate_points(device):
    """Exact ones, of points in a plane, which leave several, on a line, and all in one place."""
    scene, plane = Scene(1, 9), on_planes(1, 9)
    line = torch.arange(9.0).double()[None, :, None].expand(1, 9, 2)
    for x, y in ((scene.x1, scene.x2), plane[:2], (line, line), (torch.ones_like(line), torch.ones_like(line))):
        weights = torch.ones(1, 9).double().to(device)
        found = finite_gradients(G.find_fundamental, x.to(device), y.to(device), weights)
        found = found.cpu()
        assert found.isfinite().all() and torch.linalg.det(found).abs() < 1e-9 * found.norm() ** 3 + 1e-12


def test_not_finite_points_stay_in_their_sample(device):
    x, y, H = (v.to(device) for v in on_planes(2, 8))
    x[1, 3, 0] = float("nan")
    found = G.find_homography_dlt(x, y)
    assert_close(found[0], (H / H[:, 2:, 2:])[0], 1e-6, 1e-6)
    assert found[1].isnan().all()


def test_transfer_to_infinity(device):
    H = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [1, 0, 0]]], device=device)  # x = 0 goes to infinity
    x = torch.tensor([[[0.0, 1], [1, 1]]], device=device)
    error = finite_gradients(lambda x, h: G.oneway_transfer_error(x, x, h), x, H)
    assert error.tolist() == [[float("inf"), 0]]
    assert (finite_gradients(lambda x, h: G.symmetric_transfer_error(x, x, h), x, H) == torch.finfo(x.dtype).max).all()
    for distance in (G.sampson_homography_distance, G.sampson_epipolar_distance, G.symmetrical_epipolar_distance):
        assert finite_gradients(distance, x, x, 0 * H).isinf().all()
    for distance in (G.oneway_transfer_error, G.sampson_homography_distance):
        exact = finite_gradients(partial(distance, squared=False), x, x, torch.eye(3, device=device)[None])
        assert (exact == 0).all()


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
        found = G.motion_from_essential_choose_solution(*args, chosen)
        with K.backend("reference"):
            assert_close(found, G.motion_from_essential_choose_solution(*args, chosen), 1e-9, 1e-9)
        assert found[3].tolist() == ([40] * 3 if chosen is None else mask.sum(1).tolist())


def test_points_at_infinity(device):
    P1, P2 = torch.eye(3, 4, device=device), torch.eye(3, 4, device=device)
    P2[0, 3] = -1
    x = torch.tensor([[0.5, 0.25], [0.5, 0.25]], device=device)
    y = torch.tensor([[0.5, 0.25], [0.25, 0.25]], device=device)
    found = finite_gradients(lambda x, y: G.triangulate_points(P1, P2, x, y), x, y)
    assert found[0].isnan().all()
    assert_close(found[1], torch.tensor([2.0, 1, 4], device=device), 1e-5, 1e-5)


def test_poses_of_points_in_a_plane_are_nan(device):
    points = rand(1, 9, 3) * torch.tensor([1.0, 1, 0]) + torch.tensor([0.0, 0, 5])
    seen = points[..., :2] / points[..., 2:]
    pose = finite_gradients(
        lambda p: G.solve_pnp_dlt(p, seen.to(device), torch.eye(3).double()[None].to(device)), points.to(device)
    )
    assert pose.isnan().all()


def test_no_candidates_for_points_on_a_line(device):
    line = torch.arange(5.0, device=device).double()[None, :, None].expand(1, 5, 2)
    assert finite_gradients(G.find_essential, line, line).isnan().all()


@pytest.mark.parametrize("roots", [[1, 1, 1], [-2, 3, 3], [0, 0, 5], [1e-6, 1, 1e6]])
def test_known_roots(roots, device):
    coeffs = torch.ones(1, 1).double()
    for r in roots:
        coeffs = torch.nn.functional.pad(coeffs, (0, 1)) - r * torch.nn.functional.pad(coeffs, (1, 0))
    expected = torch.tensor([roots]).double()
    assert_close(finite_gradients(G.solve_cubic, coeffs.to(device)).cpu(), expected, 1e-6, 1e-9)
    both = torch.nn.functional.pad(coeffs, (1, 0)).to(device)  # a quartic that is a cubic
    assert_close(finite_gradients(G.solve_quartic, both)[:, :3].sort(-1).values.cpu(), expected, 1e-6, 1e-9)


def test_polynomials_without_roots(device):
    coeffs = torch.tensor([[1.0, 0, 1], [0, 0, 1], [0, 0, 0]], device=device)
    assert (finite_gradients(G.solve_quadratic, coeffs) == 0).all()
    assert (finite_gradients(G.solve_quartic, torch.nn.functional.pad(coeffs, (1, 1))[:1]) == 0).all()


@pytest.mark.parametrize("n", [3, 4, 9, 12])
def test_eigenvectors(n, device):
    """Also of matrices that have no more than one eigenvalue, or two."""
    matrix = torch.stack([M @ M.mT for M in rand(6, n, n, seed=n)]).to(device)
    matrix[:3] = torch.stack([0 * matrix[0], torch.eye(n, device=device).double(), torch.ones_like(matrix[0])])
    values, vectors = _eigenvectors(matrix)
    assert_close(values, torch.linalg.eigvalsh(matrix.cpu()).to(device), 1e-12, 1e-12)
    assert_close(matrix @ vectors, vectors * values[:, None], 1e-12, 1e-12)
    assert_close(vectors.mT @ vectors, torch.eye(n, device=device).double().expand_as(matrix), 1e-12, 1e-12)


def test_errors_of_many_correspondences_of_one_matrix(device):
    """Their gradients are sums of sums; bits do not depend on the run."""
    x, y, F = (v.to(device) for v in (rand(2, 9, 2, 3, seed=1), rand(2, 5000, 2, seed=2), rand(1, 3, 3, seed=3)))
    x = x.flatten(2)[:, :, :2].repeat(1, 556, 1)[:, :5000]
    results = []
    for backend in ("auto", "auto", "reference"):
        leaf = F.clone().requires_grad_()
        with K.backend(backend):
            errors = G.symmetrical_epipolar_distance(x, y, leaf)
            results.append([errors.detach(), *torch.autograd.grad(errors.sum(), leaf)])
    assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
    assert_close(results[0], results[2], 1e-10, 1e-10)


def test_triangulation_of_many_points_of_one_pair(device):
    """The gradients to their projections are sums of sums."""
    scene = Scene(1, 2500, noise=0.5)
    weights = rand(1, 2500, 3, seed=4).to(device)
    results = []
    for backend in ("auto", "auto", "reference"):
        leaves = [x.to(device).requires_grad_() for x in (scene.P1, scene.P2, scene.x1, scene.x2)]
        with K.backend(backend):
            found = G.triangulate_points(*leaves)
            results.append([found.detach(), *torch.autograd.grad(found, leaves, weights)])
    assert all(torch.equal(a, b) for a, b in zip(*results[:2]))
    assert_close(results[0], results[2], 1e-8, 1e-8)


# --- types and registration -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16], ids=str)
def test_half_types_are_rounded_once(dtype, device):
    x, y = (v.to(device, dtype) for v in on_planes(1, 9)[:2])
    for call in (
        G.find_homography_dlt,
        lambda x, y: G.sampson_epipolar_distance(x, y, torch.ones(1, 3, 3, dtype=dtype, device=device)),
        lambda x, y: G.normalize_points(x)[0],
    ):
        found = call(x, y)
        assert found.dtype == dtype
        assert_close(found, call(x.float(), y.float()).to(dtype), 1e-2, 1e-2)


def test_float32_is_as_good_as_it_can_be(device):
    x, y, H = (v.to(device) for v in on_planes(8, 9))
    expected = H / H[:, 2:, 2:]
    found = G.find_homography_dlt(x.float(), y.float())
    assert_close(found.double(), G.find_homography_dlt(x.float().double(), y.float().double()), 1e-5, 1e-6)
    assert_close(found.double(), expected, 1e-3, 1e-4)


# --- OpenCV -----------------------------------------------------------------------------------------------------------


def test_opencv_homography():
    x, y, _ = on_planes(3, 30, noise=0.5)
    for a, b, found in zip(x, y, G.find_homography_dlt(x, y)):
        expected = torch.from_numpy(cv2.findHomography(a.numpy(), b.numpy(), 0)[0])
        there, them = (G.oneway_transfer_error(a[None], b[None], h[None]).mean() for h in (found, expected))
        assert there < 1.05 * them  # which is the least there is: OpenCV goes on from the same by Levenberg-Marquardt


def test_opencv_fundamental():
    scene = Scene(1, 30, noise=0.3)
    expected = torch.from_numpy(cv2.findFundamentalMat(scene.x1[0].numpy(), scene.x2[0].numpy(), cv2.FM_8POINT)[0])
    assert_close(G.find_fundamental(scene.x1, scene.x2)[0], expected, 1e-5, 1e-8)


def test_opencv_essential_and_pose():
    scene = Scene(1, 40)
    x, y = scene.x1[0].numpy(), scene.x2[0].numpy()
    E, _ = cv2.findEssentialMat(x, y, CAMERA.numpy())
    _, R, t, _ = cv2.recoverPose(E, x, y, CAMERA.numpy())
    found = G.motion_from_essential_choose_solution(scene.E, CAMERA, CAMERA, scene.x1[0], scene.x2[0])
    assert_close(found[0], torch.from_numpy(R), 1e-4, 1e-4)
    assert_close(found[1], torch.from_numpy(t), 1e-4, 1e-4)
    assert found[3] == 40
    candidates = G.find_essential(*(p[:, :5] for p in scene.normalized()))[0]
    E = torch.from_numpy(E) / torch.from_numpy(E).norm()
    apart = torch.minimum((candidates - E).flatten(1).norm(dim=1), (candidates + E).flatten(1).norm(dim=1))
    assert apart.nan_to_num(9).min() < 1e-6


def test_opencv_triangulation():
    scene = Scene(1, 40, noise=0.5)
    X = cv2.triangulatePoints(scene.P1.numpy(), scene.P2.numpy(), scene.x1[0].T.numpy(), scene.x2[0].T.numpy())
    expected = torch.from_numpy((X[:3] / X[3]).T)
    assert_close(G.triangulate_points(scene.P1, scene.P2, scene.x1[0], scene.x2[0]), expected, 1e-6, 1e-6)


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_opencv_distortion(count):
    points, lens = QUADS.numpy(), LENS[:count].numpy()
    plane = (QUADS - CAMERA[:2, 2]) / CAMERA.diagonal()[:2]
    in_space = torch.cat([plane, torch.ones(6, 1).double()], -1).numpy()
    zero = torch.zeros(3).double().numpy()
    expected = torch.from_numpy(cv2.projectPoints(in_space, zero, zero, CAMERA.numpy(), lens)[0][:, 0])
    assert_close(G.distort_points(QUADS, CAMERA, LENS[:count]), expected, 1e-9, 1e-9)
    expected = torch.from_numpy(cv2.undistortPoints(points[:, None], CAMERA.numpy(), lens, P=CAMERA.numpy())[:, 0])
    assert_close(G.undistort_points(QUADS, CAMERA, LENS[:count]), expected, 1e-9, 1e-9)


def test_opencv_decomposition():
    camera, R, center = cv2.decomposeProjectionMatrix(SCENE.P2.numpy())[:3]
    found = G.KRt_from_projection(SCENE.P2[None])
    assert_close(found[0][0] / found[0][0, 2, 2], torch.from_numpy(camera), 1e-9, 1e-9)
    assert_close(found[1][0], torch.from_numpy(R), 1e-9, 1e-9)
    assert_close(-found[1][0].T @ found[2][0], torch.from_numpy(center[:3] / center[3]), 1e-9, 1e-9)


@pytest.mark.parametrize("count", [5, 14])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_undistortion_broadcasts(count, dtype, device):
    """One lens for several sets of points, and several for one; with the kernel as with the reference."""
    many = rand(3, 37, 2, high=90).to(device, dtype)
    camera, lens = CAMERA.to(device, dtype), LENS[:count].to(device, dtype)
    lenses = lens * torch.tensor([[1.0], [0.5], [0.1]], device=device, dtype=dtype)
    for points, K_, dist in ((many, camera, lens), (many[0], camera, lenses), (many, camera.expand(3, 3, 3), lenses)):
        found = G.undistort_points(points, K_, dist, 2 * camera)
        with K.backend("reference"):
            assert_close(found, G.undistort_points(points, K_, dist, 2 * camera), 1e-5, 1e-4)
        differentiated = G.undistort_points(points.clone().requires_grad_(), K_, dist, 2 * camera)
        assert_close(found, differentiated.detach(), 1e-5, 1e-4)
    assert G.undistort_points(many[:, :0], camera, lens).shape == (3, 0, 2)
    assert G.undistort_points(many[:0], camera, lens).shape == (0, 37, 2)


def test_distortion_and_back(device):
    lens = LENS.to(device) * torch.cat([torch.ones(12), torch.ones(2) * 0.1]).to(device)
    moved = G.distort_points(QUADS.to(device), CAMERA.to(device), lens)
    assert_close(G.undistort_points(moved, CAMERA.to(device), lens, num_iters=60), QUADS.to(device), 1e-7, 1e-7)


# --- bad arguments ----------------------------------------------------------------------------------------------------

P, Q, M = torch.rand(2, 8, 2), torch.rand(2, 8, 2), torch.rand(2, 3, 3)
BAD = [
    (lambda: G.find_homography_dlt([1.0], Q), TypeError, "find_homography_dlt: expected points1 to be a Tensor, got list"),
    (lambda: G.find_homography_dlt(P.int(), Q), TypeError, "find_homography_dlt: expected points1 to be floating point"),
    (lambda: G.find_homography_dlt(P[:, :3], Q[:, :3]), ValueError, "find_homography_dlt: expected points1 of shape .* at least 4"),
    (lambda: G.find_homography_dlt(P, Q[:1]), ValueError, "find_homography_dlt: expected tensors of one shape"),
    (lambda: G.find_homography_dlt(P, Q, torch.ones(2, 7)), ValueError, r"find_homography_dlt: expected weights of shape \(2, 8\)"),
    (lambda: G.find_homography_dlt(P, Q, solver="qr"), NotImplementedError, "find_homography_dlt: solver must be one of lu, svd"),
    (lambda: G.find_homography_dlt_iterated(P, Q, P[..., 0], 0.0), ValueError, "find_homography_dlt_iterated: expected"),
    (lambda: G.find_homography_dlt_iterated(P, Q, P[..., 0], n_iter=0), ValueError, "find_homography_dlt_iterated: expected"),
    (lambda: G.find_homography_lines_dlt(P, Q), ValueError, r"find_homography_lines_dlt: expected ls1 of shape \(B, N, 2, 2\)"),
    (lambda: G.oneway_transfer_error(P, Q, M[0]), ValueError, r"oneway_transfer_error: expected H of shape \(\*, B, 3, 3\)"),
    (lambda: G.symmetric_transfer_error(P, torch.rand(2, 8, 4), M), ValueError, r"symmetric_transfer_error: expected pts2 of"),
    (lambda: G.sample_is_valid_for_homography(P[:, :3], Q[:, :3]), ValueError, "sample_is_valid_for_homography: expected points1"),
    (lambda: G.find_fundamental(P[:, :7], Q[:, :7]), ValueError, "find_fundamental: expected points1 of shape .* at least 8"),
    (lambda: G.find_fundamental(P, Q, method="7POINT"), ValueError, r"find_fundamental: expected points1 of shape \(B, 7, 2\)"),
    (lambda: G.find_fundamental(P, Q, method="RANSAC"), ValueError, "find_fundamental: method must be one of 8POINT, 7POINT"),
    (lambda: G.find_essential(P[:, :4], Q[:, :4]), ValueError, "find_essential: expected points1 of shape .* at least 5"),
    (lambda: G.decompose_essential_matrix(P), ValueError, r"decompose_essential_matrix: expected E_mat of shape \(\*, 3, 3\)"),
    (lambda: G.motion_from_essential_choose_solution(M, M, M, P[0], Q[0]), ValueError, "motion_from_essential_choose_solution:"),
    (lambda: G.triangulate_points(M, M, P, Q), ValueError, r"triangulate_points: expected P1 of shape \(\*, 3, 4\)"),
    (lambda: G.triangulate_points(torch.rand(3, 4), torch.rand(3, 4), P, Q, "qr"), NotImplementedError, "triangulate_points:"),
    (lambda: G.triangulate_points(torch.rand(3, 3, 4), torch.rand(3, 4), P, Q), ValueError, "triangulate_points: expected shapes"),
    (lambda: G.projection_from_KRt(M, M[0], M[..., :1]), ValueError, "projection_from_KRt: expected K, R and t with as many axes"),
    (lambda: G.intrinsics_like(0.0, torch.rand(1, 1, 2, 2)), ValueError, "intrinsics_like: expected focal above 0"),
    (lambda: G.distort_points(P, M, torch.rand(2, 6)), ValueError, r"distort_points: expected dist of shape \(\*, n\) with n one"),
    (lambda: G.undistort_points(P, M, torch.rand(2, 4), num_iters=-1), ValueError, "undistort_points: expected num_iters"),
    (lambda: G.undistort_image(torch.rand(2, 1, 4, 4), M[:1], torch.rand(2, 4)), ValueError, "undistort_image: expected image, K"),
    (lambda: G.tilt_projection(torch.rand(2), torch.rand(3)), ValueError, "tilt_projection: expected tensors of one shape"),
    (lambda: G.solve_pnp_dlt(torch.rand(2, 5, 3), P[:, :5], M), ValueError, "solve_pnp_dlt: expected world_points of at least six"),
    (lambda: G.solve_cubic(torch.rand(3)), ValueError, r"solve_cubic: expected coeffs of shape \(\*, B, 4\)"),
    (lambda: G.null_vector_3x4(M), ValueError, r"null_vector_3x4: expected A of shape \(\*, 3, 4\)"),
    (lambda: G.find_affine(P[:, :2], Q[:, :2]), ValueError, "find_affine: expected points1 of shape .* at least 3"),
    (lambda: G.generate_scene(0, 3), ValueError, "generate_scene: expected num_views"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)
