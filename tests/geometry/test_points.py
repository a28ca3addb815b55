"""Points, homographies, poses, cameras and grids: the suite of compositions, Kornia's and OpenCV's values, round trips."""

import itertools

import hypothesis.strategies as st
import pytest
import torch
from hypothesis import given
from torch import Tensor

import kvision as K
from composition_tests import Case, CompositionTests
from op_tests import assert_close

G = K.geometry
P2, P3, MATRIX, POSE = (2, 5, 2), (2, 5, 3), (2, 3, 3), (2, 4, 4)
LAST = (2, 5, 1)


def flat(f):
    """A function of several results as one of one."""
    return lambda *x: torch.cat([y.flatten(1) for y in f(*x)], 1)


def camera(intrinsics: Tensor, extrinsics: Tensor) -> G.PinholeCamera:
    size = torch.ones_like(intrinsics[:, 0, 0])
    return G.PinholeCamera(intrinsics, extrinsics, size, size)


class TestPoints(CompositionTests):
    cases = {
        "rad2deg": Case(G.rad2deg, (P2,)),
        "deg2rad": Case(G.deg2rad, (P2,)),
        "pol2cart": Case(flat(G.pol2cart), (P2, P2)),
        "cart2pol": Case(flat(G.cart2pol), (P2, P2)),
        "angle_to_rotation_matrix": Case(G.angle_to_rotation_matrix, ((2, 3),)),
        "convert_points_to_homogeneous": Case(G.convert_points_to_homogeneous, (P2,)),
        "convert_points_from_homogeneous": Case(G.convert_points_from_homogeneous, (P3,)),
        "convert_affinematrix_to_homography": Case(G.convert_affinematrix_to_homography, ((2, 2, 3),)),
        "convert_affinematrix_to_homography3d": Case(G.convert_affinematrix_to_homography3d, ((2, 3, 4),)),
        "normalize_pixel_coordinates": Case(lambda p: G.normalize_pixel_coordinates(p, 3, 1), (P2,)),
        "denormalize_pixel_coordinates": Case(lambda p: G.denormalize_pixel_coordinates(p, 3, 1), (P2,)),
        "normalize_pixel_coordinates3d": Case(lambda p: G.normalize_pixel_coordinates3d(p, 3, 1, 5), (P3,)),
        "denormalize_pixel_coordinates3d": Case(lambda p: G.denormalize_pixel_coordinates3d(p, 3, 1, 5), (P3,)),
        "normalize_homography": Case(lambda m: G.normalize_homography(m, (3, 4), (1, 5)), (MATRIX,)),
        "denormalize_homography": Case(lambda m: G.denormalize_homography(m, (3, 4), (1, 5), False), (MATRIX,)),
        "normalize_homography3d": Case(lambda m: G.normalize_homography3d(m, (2, 3, 4), (2, 1, 5)), (POSE,)),
        "denormalize_homography3d": Case(lambda m: G.denormalize_homography3d(m, (2, 3, 4), (2, 1, 5)), (POSE,)),
        "normalize_points_with_intrinsics": Case(G.normalize_points_with_intrinsics, (P2, MATRIX)),
        "denormalize_points_with_intrinsics": Case(G.denormalize_points_with_intrinsics, (P2, MATRIX)),
        "Rt_to_matrix4x4": Case(G.Rt_to_matrix4x4, (MATRIX, (2, 3, 1))),
        "camtoworld_to_worldtocam_Rt": Case(flat(G.camtoworld_to_worldtocam_Rt), (MATRIX, (2, 3, 1))),
        "camtoworld_graphics_to_vision_4x4": Case(G.camtoworld_graphics_to_vision_4x4, (POSE,)),
        "camtoworld_vision_to_graphics_Rt": Case(flat(G.camtoworld_vision_to_graphics_Rt), (MATRIX, (2, 3, 1))),
        "transform_points": Case(lambda p, m: G.transform_points(m, p), (P3, POSE)),
        "compose_transformations": Case(G.compose_transformations, (POSE, POSE)),
        "inverse_transformation": Case(G.inverse_transformation, (POSE,)),
        "relative_transformation": Case(G.relative_transformation, (POSE, POSE)),
        "point_line_distance": Case(G.point_line_distance, (P2, P3)),
        "euclidean_distance": Case(G.euclidean_distance, (P3, P3)),
        "batched_dot_product": Case(G.batched_dot_product, (P3, P3)),
        "squared_norm": Case(G.squared_norm, (P3,)),
        "project_points": Case(G.project_points, (P3, MATRIX)),
        "unproject_points": Case(lambda p, d, k: G.unproject_points(p, d, k, True), (P2, LAST, MATRIX)),
        "PinholeCamera.project": Case(lambda p, k, e: camera(k, e).project(p), (P3, POSE, POSE)),
        "PinholeCamera.unproject": Case(lambda p, d, k, e: camera(k, e).unproject(p, d), (P2, LAST, POSE, POSE)),
    }
    compiled = ("normalize_homography", "relative_transformation", "PinholeCamera.project", "unproject_points")


# --- Kornia's values ------------------------------------------------------------------------------------------------

GENERATOR = torch.Generator().manual_seed(2)


def rand(*shape: int) -> Tensor:
    return torch.rand(shape, dtype=torch.float64, generator=GENERATOR) + 0.1


SIZES = [((3, 4), (2, 5)), ((1, 4), (3, 1))]
CALLS = [
    ("rad2deg", (rand(3),)),
    ("deg2rad", (rand(3),)),
    ("pol2cart", (rand(3), rand(3))),
    ("cart2pol", (rand(3) - 0.5, rand(3) - 0.5)),
    ("angle_to_rotation_matrix", (500 * rand(3),)),
    ("convert_points_from_homogeneous", (rand(2, 3, 3),)),
    ("convert_points_to_homogeneous", (rand(2, 3, 3),)),
    ("convert_affinematrix_to_homography", (rand(2, 2, 3),)),
    ("convert_affinematrix_to_homography3d", (rand(2, 3, 4),)),
    *(("normalize_pixel_coordinates", (rand(2, 3, 2), *a)) for a, _ in SIZES),
    *(("denormalize_pixel_coordinates", (rand(2, 3, 2), *a)) for a, _ in SIZES),
    *(("normalize_pixel_coordinates3d", (rand(2, 3, 3), 2, *a)) for a, _ in SIZES),
    *(("denormalize_pixel_coordinates3d", (rand(2, 3, 3), 2, *a)) for a, _ in SIZES),
    *(("normalize_homography", (rand(2, 3, 3), *sizes, a)) for sizes in SIZES for a in (True, False)),
    *(("denormalize_homography", (rand(2, 3, 3), *sizes, a)) for sizes in SIZES for a in (True, False)),
    *(("normalize_homography3d", (rand(2, 4, 4), (2, *a), (3, *b))) for a, b in SIZES),
    *(("denormalize_homography3d", (rand(2, 4, 4), (2, *a), (3, *b))) for a, b in SIZES),
    *(("normalize_points_with_intrinsics", (rand(2, 5, 2), rand(*s, 3, 3))) for s in ((), (1,), (2,), (2, 1))),
    ("denormalize_points_with_intrinsics", (rand(2, 5, 2), rand(2, 3, 3))),
    ("Rt_to_matrix4x4", (rand(2, 3, 3), rand(2, 3, 1))),
    ("matrix4x4_to_Rt", (rand(2, 4, 4),)),
    ("camtoworld_to_worldtocam_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("worldtocam_to_camtoworld_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("camtoworld_graphics_to_vision_4x4", (rand(2, 4, 4),)),
    ("camtoworld_graphics_to_vision_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    ("camtoworld_vision_to_graphics_4x4", (rand(2, 4, 4),)),
    ("camtoworld_vision_to_graphics_Rt", (rand(2, 3, 3), rand(2, 3, 1))),
    *(("transform_points", (rand(*s, 3, 3), rand(2, 4, 5, 2))) for s in ((), (1,), (2,))),
    ("transform_points", (rand(1, 4, 4), rand(7, 3))),
    ("compose_transformations", (rand(2, 4, 4), rand(1, 4, 4))),
    ("inverse_transformation", (rand(4, 4),)),
    ("relative_transformation", (rand(1, 4, 4), rand(2, 4, 4))),
    ("point_line_distance", (rand(2, 5, 2), rand(2, 5, 3))),
    ("point_line_distance", (rand(2, 5, 3), rand(2, 5, 3))),
    ("euclidean_distance", (rand(2, 5, 3), rand(2, 5, 3))),
    ("batched_dot_product", (rand(2, 5, 3), rand(2, 5, 3), True)),
    ("batched_squared_norm", (rand(2, 5, 3), True)),
    *(("project_points", (rand(2, 5, 3), rand(*s, 3, 3))) for s in ((), (1,), (2,), (2, 1))),
    *(("unproject_points", (rand(2, 5, 2), rand(2, 5, 1), rand(2, 3, 3), n)) for n in (True, False)),
]


@pytest.mark.parametrize("name, args", CALLS, ids=[f"{i}-{c[0]}" for i, c in enumerate(CALLS)])
def test_values_are_those_of_kornia(name, args, device):
    theirs = pytest.importorskip("kornia").geometry
    found = getattr(G, name)(*(a.to(device) if isinstance(a, Tensor) else a for a in args))
    expected = getattr(theirs, name)(*args)
    for ours, his in zip(*((y,) if isinstance(y, Tensor) else y for y in (found, expected)), strict=True):
        assert_close(ours.cpu(), his, 1e-7, 1e-9)


@pytest.mark.parametrize("sizes", [(3, 4), (1, 5), (4, 1)])
def test_grids_are_those_of_kornia(sizes, device):
    theirs = pytest.importorskip("kornia").geometry
    kinds = {"device": device, "dtype": torch.float64}
    for normalized, corners in itertools.product((True, False), repeat=2):
        expected = theirs.create_meshgrid(*sizes, normalized, dtype=torch.float64, align_corners=corners)
        assert_close(G.create_meshgrid(*sizes, normalized, **kinds, align_corners=corners).cpu(), expected, 0, 1e-15)
        expected = theirs.create_meshgrid3d(2, *sizes, normalized, dtype=torch.float64)
        assert_close(G.create_meshgrid3d(2, *sizes, normalized, **kinds).cpu(), expected, 0, 1e-15)
        expected = theirs.normal_transform_pixel(*sizes, dtype=torch.float64, align_corners=corners)
        assert_close(G.normal_transform_pixel(*sizes, **kinds, align_corners=corners).cpu(), expected, 0, 1e-15)
    expected = theirs.normal_transform_pixel3d(2, *sizes, dtype=torch.float64)
    assert_close(G.normal_transform_pixel3d(2, *sizes, **kinds).cpu(), expected, 0, 1e-15)


def cameras(device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    intrinsics, extrinsics = torch.eye(4).repeat(2, 1, 1), torch.eye(4).repeat(2, 1, 1)
    intrinsics[:, :2, :3] = torch.tensor([[[100.0, 0.3, 30], [0, 110, 20]], [[90.0, 0, 31], [0, 95, 22]]])
    extrinsics[:, :3, :3] = G.axis_angle_to_rotation_matrix(torch.tensor([[0.1, 0.2, -0.3], [0.0, 0, 1]]))
    extrinsics[:, :3, 3] = torch.tensor([[0.1, 0.2, 4], [1.0, 0, 5]])
    sizes = torch.tensor([48.0, 40]), torch.tensor([64.0, 60])
    return tuple(x.double().to(device) for x in (intrinsics, extrinsics, *sizes))


def test_cameras_are_those_of_kornia(device):
    theirs = pytest.importorskip("kornia").geometry
    ours, his = G.PinholeCamera(*cameras(device)), theirs.PinholeCamera(*cameras("cpu"))
    points, depth = rand(2, 7, 3), rand(2, 7, 1)
    assert_close(ours.project(points.to(device)).cpu(), his.project(points))
    assert_close(
        ours.unproject(points[..., :2].to(device), depth.to(device)).cpu(), his.unproject(points[..., :2], depth)
    )
    for name in (
        *("intrinsics", "extrinsics", "fx", "fy", "cx", "cy", "tx", "ty", "tz", "rt_matrix", "camera_matrix"),
        *("rotation_matrix", "translation_vector", "height", "width"),
    ):
        assert_close(getattr(ours, name).cpu(), getattr(his, name))
    assert_close(ours.intrinsics_inverse().cpu(), his.intrinsics_inverse())
    assert ours.batch_size == 2
    assert ours.device().type == device.type
    numbers = (1.0, 2.0, 3.0, 4.0, 5, 6, 7.0, 8.0, 9.0, 2)
    made = G.PinholeCamera.from_parameters(*numbers, device, torch.float32)
    expected = theirs.PinholeCamera.from_parameters(*numbers, torch.device("cpu"), torch.float32)
    for name in ("intrinsics", "extrinsics", "height", "width"):
        assert_close(getattr(made, name).cpu(), getattr(expected, name))


def test_projection_is_that_of_opencv(device):
    cv2 = pytest.importorskip("cv2")
    intrinsics, extrinsics, *_ = cameras("cpu")
    points = rand(2, 50, 3)
    points[..., 2] += 1
    moved = G.transform_points(extrinsics.to(device), points.to(device))
    found = G.project_points(moved, intrinsics[:, :3, :3].to(device))
    for i in range(2):
        turn, move = extrinsics[i, :3, :3].numpy(), extrinsics[i, :3, 3].numpy()
        expected, _ = cv2.projectPoints(points[i].numpy(), turn, move, intrinsics[i, :3, :3].numpy(), None)
        assert_close(found[i].cpu(), torch.from_numpy(expected[:, 0]), 1e-12, 1e-10)


# --- exact results --------------------------------------------------------------------------------------------------


def test_there_and_back(device):
    points, depth = rand(2, 7, 2).to(device), rand(2, 7, 1).to(device)
    look = G.PinholeCamera(*cameras(device))
    assert_close(look.project(look.unproject(points, depth)), points, 1e-9, 1e-9)
    matrix = look.camera_matrix * torch.tensor([[1.0, 0, 1], [1, 1, 1], [1, 1, 1]], device=device)
    assert_close(G.project_points(G.unproject_points(points, depth, matrix), matrix), points, 1e-9, 1e-9)
    ray = G.unproject_points(points, depth, matrix, normalize=True)
    assert_close(ray.norm(dim=-1, keepdim=True), depth)
    for name, sizes in (("pixel_coordinates", (5, 1)), ("pixel_coordinates3d", (2, 5, 1))):
        x = rand(4, len(sizes)).to(device)
        assert_close(getattr(G, f"denormalize_{name}")(getattr(G, f"normalize_{name}")(x, *sizes), *sizes), x)
    H = rand(2, 3, 3).to(device)
    there = G.normalize_homography(H, (5, 1), (3, 4), False)
    assert_close(G.denormalize_homography(there, (5, 1), (3, 4), False), H, 1e-9, 1e-9)


def test_normalized_homography_agrees_with_normalized_points(device):
    H, p = rand(1, 3, 3).to(device), rand(1, 6, 2).to(device)
    moved = G.normalize_pixel_coordinates(G.transform_points(H, p), 6, 7)
    normalized = G.transform_points(G.normalize_homography(H, (4, 5), (6, 7)), G.normalize_pixel_coordinates(p, 4, 5))
    assert_close(normalized, moved, 1e-9, 1e-9)


def test_points_at_infinity_stay_undivided(device):
    p = torch.tensor([[1.0, 2, 0], [3, 4, 1e-9], [4, 2, -2]], device=device, requires_grad=True)
    found = G.convert_points_from_homogeneous(p)
    assert_close(found, torch.tensor([[1.0, 2], [3, 4], [-2, -1]], device=device))
    look = torch.eye(3, device=device)
    assert_close(G.project_points(p, look), found)
    flat = torch.eye(4, device=device)[None] * torch.tensor([1.0, 1, 1, 0], device=device)
    assert_close(G.transform_points(flat, p[None]), p[None])
    (grad,) = torch.autograd.grad(found.sum() + G.project_points(p, look).sum(), p)
    assert grad.isfinite().all()


def test_gradients_where_distances_are_zero(device):
    x = torch.zeros(2, 2, device=device, requires_grad=True)
    rho, phi = G.cart2pol(x[:, 0], x[:, 1])
    line = torch.tensor([[0.0, 0, 1], [1.0, 1, 0]], device=device, requires_grad=True)
    distance = G.point_line_distance(x, line)
    assert_close(distance, torch.tensor([torch.inf, 0], device=device))
    total = rho.sum() + phi.sum() + G.euclidean_distance(x, 0 * x.detach()).sum() + distance[1]
    assert total == 0
    assert all(g.isfinite().all() for g in torch.autograd.grad(total, (x, line)))
    infinite = torch.tensor([1.0, 2, 0], device=device)
    assert G.point_line_distance(infinite, line[1]) == torch.inf


def test_half_types_compute_in_float32(device):
    p, k = rand(2, 5, 3).to(device), 100 * rand(2, 3, 3).to(device)
    for dtype in (torch.float16, torch.bfloat16):
        q = p.to(dtype)
        assert_close(G.project_points(q, k.float()), G.project_points(q.float(), k.float()).to(dtype))
        assert_close(
            G.transform_points(k.to(dtype), q[..., :2]),
            G.transform_points(k.to(dtype).float(), q[..., :2].float()).to(dtype),
        )
    assert G.create_meshgrid(1, 5000, False, device, torch.float16)[0, 0, -1, 0] == 5000
    assert G.transform_points(k.float(), torch.ones(2, 5, 2, dtype=torch.long, device=device)).dtype == torch.float32


def test_cameras_own_their_tensors(device):
    tensors = cameras(device)
    before = [t.clone() for t in tensors]
    look = G.PinholeCamera(*tensors)
    other = look.scale(torch.tensor([2.0, 3], device=device))
    look.tx, look.ty, look.tz = 1.0, 2.0, torch.ones(2, device=device)
    look.scale_(0.5)
    assert_close(list(tensors), before)
    assert_close(other.fx, before[0][:, 0, 0] * torch.tensor([2.0, 3], device=device).double())
    assert_close(look.cx, before[0][:, 0, 2] / 2)
    assert_close(look.width, before[3] / 2)
    assert_close(look.translation_vector[1].flatten(), torch.tensor([1.0, 2, 1], dtype=torch.float64, device=device))
    assert_close(look.clone().rotation_matrix, before[1][:, :3, :3])


@given(st.lists(st.floats(-3, 3), min_size=12, max_size=12), st.floats(0.5, 2))
def test_rigid_transformations(numbers, s):
    a, b = torch.tensor(numbers, dtype=torch.float64).reshape(2, 6)
    A, B = (G.Rt_to_matrix4x4(G.axis_angle_to_rotation_matrix(v[:3]), v[3:, None]) for v in (a, b))
    eye = torch.eye(4, dtype=torch.float64)
    assert_close(G.compose_transformations(A, G.inverse_transformation(A)), eye, 0, 1e-12)
    assert_close(G.compose_transformations(A, G.relative_transformation(A, B)), B, 0, 1e-12)
    p = torch.arange(12, dtype=torch.float64).reshape(1, 4, 3)
    both = G.transform_points(G.compose_transformations(A, B)[None], p)
    assert_close(both, G.transform_points(A[None], G.transform_points(B[None], p)), 0, 1e-11)
    distance = G.euclidean_distance(p[:, :-1], p[:, 1:])
    moved = G.transform_points(A[None], p * s)
    assert_close(G.euclidean_distance(moved[:, :-1], moved[:, 1:]), distance * s, 1e-11, 0)


def test_rotation_check():
    R, t = torch.eye(3)[None], torch.ones(1, 3, 1)
    G.camtoworld_to_worldtocam_Rt(R, t, check_rotation=True)
    with pytest.raises(ValueError, match="worldtocam_to_camtoworld_Rt: expected R of rotations"):
        G.worldtocam_to_camtoworld_Rt(2 * R, t, check_rotation=True)


EYE, ONES = torch.eye(3), torch.ones(2, 4, 3)
BAD = [
    (lambda: G.rad2deg(1.0), TypeError, "rad2deg: expected tensor to be a Tensor, got float"),
    (lambda: G.pol2cart(torch.ones(2), torch.ones(3)), ValueError, "pol2cart: expected leading axes that broadcast"),
    (lambda: G.convert_points_to_homogeneous(torch.ones(())), ValueError, r"of shape \(\*, D\), got \(\)"),
    (lambda: G.convert_points_from_homogeneous(torch.ones(3, 1)), ValueError, "D of at least 2"),
    (lambda: G.convert_affinematrix_to_homography(EYE), ValueError, r"expected A of shape \(\*, 2, 3\), got \(3, 3\)"),
    (lambda: G.normalize_pixel_coordinates(ONES, 3, 4), ValueError, r"pixel_coordinates of shape \(\*, 2\)"),
    (lambda: G.normalize_pixel_coordinates(ONES[..., :2], 0, 4), ValueError, "expected height to be an int of at least 1"),
    (lambda: G.normal_transform_pixel(2.5, 3), TypeError, "normal_transform_pixel: expected height to be an int"),
    (lambda: G.normalize_homography(EYE.int(), (2, 3), (2, 3)), TypeError, "normalize_homography: .* floating point"),
    (lambda: G.normalize_homography(EYE, 3.5, (2, 3)), TypeError, "normalize_homography: expected dsize_src"),
    (lambda: G.transform_points(EYE, ONES), ValueError, r"transform_points: expected points_1 of shape \(\*, 2\)"),
    (lambda: G.transform_points(EYE[:2], ONES), ValueError, r"transform_points: expected trans_01 of shape"),
    (lambda: G.transform_points(EYE.expand(3, 3, 3), ONES[..., :2]), ValueError, r"points_1 of shape \(3, \*, 2\)"),
    (lambda: G.transform_points(EYE.expand(2, 3, 3), ONES[0, :2, :2]), ValueError, r"points_1 of shape \(2, \*, 2\)"),
    (lambda: G.inverse_transformation(EYE), ValueError, r"expected trans_12 of shape \(\*, 4, 4\)"),
    (lambda: G.compose_transformations(torch.ones(2, 4, 4), torch.ones(3, 4, 4)), ValueError, "leading axes that broadcast"),
    (lambda: G.point_line_distance(torch.ones(4), torch.ones(3)), ValueError, "point_line_distance: expected point of shape"),
    (lambda: G.euclidean_distance(torch.ones(4), torch.ones(3)), ValueError, "euclidean_distance: expected leading axes"),
    (lambda: G.Rt_to_matrix4x4(EYE, torch.ones(1, 3, 1)), ValueError, r"Rt_to_matrix4x4: expected t of shape \(3, 1\)"),
    (lambda: G.project_points(ONES, torch.ones(3, 3, 3)), ValueError, "project_points: expected leading axes that broadcast"),
    (lambda: G.project_points(ONES[..., :2], EYE), ValueError, r"project_points: expected point_3d of shape \(\*, 3\)"),
    (lambda: G.unproject_points(ONES[..., :2], ONES, EYE), ValueError, r"unproject_points: expected depth of shape \(\*, 1\)"),
    (lambda: G.create_meshgrid(0, 3), ValueError, "create_meshgrid: expected height to be an int of at least 1"),
    (lambda: G.PinholeCamera(EYE[None], EYE[None], torch.ones(1), torch.ones(1)), ValueError, r"intrinsics of shape \(B, 4, 4\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")[:2], torch.ones(1), torch.ones(1)), ValueError, r"height of shape \(2,\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")).project(torch.ones(3, 5, 3)), ValueError, r"point_3d of shape \(2, \*, 3\)"),
    (lambda: G.PinholeCamera(*cameras("cpu")).unproject(ONES[..., :2], EYE), ValueError, "unproject: expected depth"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message):
        call()
