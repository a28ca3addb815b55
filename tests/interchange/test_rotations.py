"""Rotations and poses.

Quaternions are (w, x, y, z). Tangents of `Se3` are (translation, rotation). Cameras look along z, with x to the right and
y down; extrinsics take the world to the camera.
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import row, same

G = K.geometry
AXIS_ANGLE = torch.tensor([[0.3, -0.7, 0.5]], dtype=torch.float64)
R = G.axis_angle_to_rotation_matrix(AXIS_ANGLE)[0]
WXYZ = G.rotation_matrix_to_quaternion(R[None])[0]
XYZW = WXYZ[[1, 2, 3, 0]]
T = torch.tensor([0.4, -0.2, 1.5], dtype=torch.float64)


@row("OpenCV", "`Rodrigues`: axis times angle", "`axis_angle_to_rotation_matrix`, `rotation_matrix_to_axis_angle`")
def test_opencv(cv2):
    assert same(cv2.Rodrigues(AXIS_ANGLE.numpy())[0], R) and same(cv2.Rodrigues(R.numpy())[0], AXIS_ANGLE)


@row(
    "SciPy",
    "`Rotation.as_quat`: (x, y, z, w); `scalar_first=True` for (w, x, y, z)",
    "(w, x, y, z): `q[..., [3, 0, 1, 2]]` of SciPy's",
)
def test_scipy(scipy):
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_matrix(R.numpy())
    assert same(abs(rotation.as_quat() @ XYZW.numpy()), 1) and same(
        abs(rotation.as_quat(scalar_first=True) @ WXYZ.numpy()), 1
    )


@row(
    "SciPy",
    '`from_euler("xyz")`: about the fixed axes x, y, z in this order; "XYZ" about the moving ones',
    '`quaternion_from_euler(roll, pitch, yaw)` is "xyz"',
)
def test_scipy_euler(scipy):
    from scipy.spatial.transform import Rotation

    angles = torch.tensor([0.1, 0.5, -0.8], dtype=torch.float64)
    ours = G.quaternion_to_rotation_matrix(torch.stack(G.quaternion_from_euler(*angles)))
    assert same(Rotation.from_euler("xyz", angles.numpy()).as_matrix(), ours)
    assert not same(Rotation.from_euler("XYZ", angles.numpy()).as_matrix(), ours, 0.1)


@row(
    "SciPy",
    "`RigidTransform.as_exp_coords`: (rotation, translation)",
    "`Se3.log`: (translation, rotation): `v[..., [3, 4, 5, 0, 1, 2]]`",
)
def test_scipy_tangents(scipy):
    from scipy.spatial.transform import RigidTransform

    theirs = RigidTransform.from_matrix(G.Rt_to_matrix4x4(R[None], T.view(1, 3, 1))[0].numpy()).as_exp_coords()
    ours = G.liegroup.Se3(G.liegroup.So3.from_matrix(R[None]), T[None]).log()[0]
    assert same(theirs, ours[[3, 4, 5, 0, 1, 2]])


@row("COLMAP", "`Rotation3d.quat`: (x, y, z, w) in Python; in its text files (w, x, y, z)", "`q[..., [3, 0, 1, 2]]`")
def test_colmap(pycolmap):
    rotation = pycolmap.Rotation3d(XYZW.numpy())
    assert same(rotation.matrix(), R) and same(rotation.quat, XYZW)


@row(
    "COLMAP",
    "`Rigid3d` of an image is `cam_from_world`: it takes points of the world to the camera",
    "the extrinsics of `PinholeCamera`; `worldtocam_to_camtoworld_Rt` inverts",
)
def test_colmap_poses(pycolmap):
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(XYZW.numpy()), T.numpy())
    point = torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64)
    matrix = G.Rt_to_matrix4x4(R[None], T.view(1, 3, 1))
    assert same(pose * point[0].numpy(), G.transform_points(matrix, point[None]))
    back, center = G.worldtocam_to_camtoworld_Rt(R[None], T.view(1, 3, 1))
    assert same(pose.inverse().translation, center) and same(pose.inverse().rotation.matrix(), back)


@row(
    "COLMAP",
    "pixel coordinates begin at the edge: the first pixel's center is (.5, .5)",
    "centers at (0, 0): subtract .5 from points and principal points",
)
def test_colmap_pixels(pycolmap):
    camera = pycolmap.Camera(model="PINHOLE", width=8, height=6, params=[5.0, 6.0, 4.0, 3.0])
    pixel = camera.img_from_cam(np.array([[0.2, -0.1, 1.0]]))
    matrix = torch.tensor([[5.0, 0, 3.5], [0, 6, 2.5], [0, 0, 1]], dtype=torch.float64)
    ours = G.project_points(torch.tensor([[0.2, -0.1, 1.0]], dtype=torch.float64), matrix[None])
    assert same(pixel - 0.5, ours)


@row("PyPose", "`SO3` and `SE3`: (x, y, z, w), after the translation", "`q[..., [3, 0, 1, 2]]`")
def test_pypose(pypose):
    assert same(pypose.SO3(XYZW).matrix(), R)
    assert same(pypose.SE3(torch.cat([T, XYZW])).matrix(), G.Rt_to_matrix4x4(R[None], T.view(1, 3, 1)))


@row("PyPose", "`SE3.Log`: (translation, rotation)", "`Se3.log`")
def test_pypose_tangents(pypose):
    ours = G.liegroup.Se3(G.liegroup.So3.from_matrix(R[None]), T[None]).log()
    assert same(pypose.SE3(torch.cat([T, XYZW])).Log().tensor(), ours)


@row("pyquaternion", "(w, x, y, z)", "the same")
def test_pyquaternion(pyquaternion):
    assert same(pyquaternion.Quaternion(WXYZ.numpy()).rotation_matrix, R)


@row("transforms3d", "(w, x, y, z)", "the same")
def test_transforms3d(transforms3d):
    import transforms3d.quaternions

    assert same(transforms3d.quaternions.quat2mat(WXYZ.numpy()), R)


@row(
    "OpenCV",
    "`projectPoints(rvec, tvec)`: world to camera",
    "`PinholeCamera` with `Rt_to_matrix4x4`; `project_points` of points in the camera",
)
def test_opencv_poses(cv2):
    points = np.float64([[0.5, 0.2, 4.0], [-1, 0.3, 5]])
    camera = np.float64([[50, 0, 20], [0, 60, 15], [0, 0, 1]])
    theirs = cv2.projectPoints(points, AXIS_ANGLE.numpy(), T.numpy(), camera, None)[0]
    moved = G.transform_points(G.Rt_to_matrix4x4(R[None], T.view(1, 3, 1)), torch.from_numpy(points)[None])[0]
    assert same(theirs, G.project_points(moved, torch.from_numpy(camera)[None]), 1e-4)


@row("OpenCV", "distortion: (k1, k2, p1, p2, k3, ...)", "`distort_points`, the same order")
def test_opencv_distortion(cv2):
    camera, k = np.float64([[50, 0, 20], [0, 60, 15], [0, 0, 1]]), np.float64([0.1, -0.05, 0.01, 0.003, 0.02])
    theirs = cv2.projectPoints(np.float64([[0.5, 0.2, 1.0]]), np.zeros(3), np.zeros(3), camera, k)[0]
    pixel = torch.tensor([[[50 * 0.5 + 20, 60 * 0.2 + 15]]], dtype=torch.float64)
    assert same(theirs, G.distort_points(pixel, torch.from_numpy(camera)[None], torch.from_numpy(k)[None]), 1e-4)


@row(
    "OpenCV",
    "`fisheye.distortPoints`: Kannala-Brandt, k1 to k4",
    "`distort_points_kannala_brandt` of (fx, fy, cx, cy, k1, k2, k3, k4)",
)
def test_opencv_fisheye(cv2):
    camera, k = np.float64([[50, 0, 20], [0, 60, 15], [0, 0, 1]]), np.float64([0.1, -0.05, 0.01, 0.003])
    theirs = cv2.fisheye.distortPoints(np.float64([[[0.5, 0.2]]]), camera, k)
    params = torch.tensor([50, 60, 20, 15, *k], dtype=torch.float64)
    assert same(theirs, G.distort_points_kannala_brandt(torch.tensor([0.5, 0.2], dtype=torch.float64), params), 1e-4)


@row("OpenCV", "`findHomography(src, dst)`: src to dst", "`find_homography_dlt(src, dst)`")
def test_opencv_homography(cv2):
    source, matrix = (
        np.random.default_rng(0).random((8, 2)) * 20,
        np.float64([[1.1, 0.1, 3], [-0.05, 0.9, 2], [1e-3, 2e-3, 1]]),
    )
    target = G.transform_points(torch.from_numpy(matrix)[None], torch.from_numpy(source)[None])
    ours = G.find_homography_dlt(torch.from_numpy(source)[None], target)
    assert same(cv2.findHomography(source, target[0].numpy())[0], matrix, 1e-4) and same(
        ours / ours[..., 2:, 2:], matrix, 1e-4
    )


@row("Kornia", "`scale_intrinsics`: coordinates that begin at the edge", "`pixel_centers=True` agrees with `resize`")
def test_kornia_intrinsics(kornia):
    camera, half = torch.tensor([[[50.0, 0, 19.5], [0, 60, 14.5], [0, 0, 1]]]), torch.tensor([0.5])
    assert same(kornia.geometry.scale_intrinsics(camera, half)[0, :2, 2], [9.75, 7.25])
    assert same(G.scale_intrinsics(camera, half, pixel_centers=True)[0, :2, 2], [9.5, 7])
