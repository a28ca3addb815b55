"""Rotations and poses.

Quaternions are (w, x, y, z). Tangents of `Se3` are (translation, rotation). Extrinsics take the world to the camera;
`inverse_transformation` inverts.
"""

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


@row(
    "SciPy",
    "`RigidTransform.as_components`: translation and rotation of x -> R x + t; products apply the right one first",
    '`pose_vector_to_matrix4x4(torch.cat([t, r.as_quat()], -1), "t_xyzw")`',
)
def test_scipy_poses(scipy):
    from scipy.spatial.transform import RigidTransform, Rotation

    pose = RigidTransform.from_components(T.numpy(), Rotation.from_quat(XYZW.numpy()))
    t, r = pose.as_components()
    ours = G.pose_vector_to_matrix4x4(torch.tensor([*t, *r.as_quat()], dtype=torch.float64), "t_xyzw")
    assert same(pose.as_matrix(), ours) and same((pose * pose).as_matrix(), ours @ ours)
    assert same(pose.apply([1.0, 2, 3]), (ours @ ours.new_tensor([1.0, 2, 3, 1]))[:3])


@row("COLMAP", "`Rotation3d.quat`: (x, y, z, w) in Python; in its text files (w, x, y, z)", "`q[..., [3, 0, 1, 2]]`")
def test_colmap(pycolmap):
    rotation = pycolmap.Rotation3d(XYZW.numpy())
    assert same(rotation.matrix(), R) and same(rotation.quat, XYZW)


@row(
    "COLMAP",
    "`Rigid3d.params`: (x, y, z, w, tx, ty, tz); a line of images.txt has (w, x, y, z, tx, ty, tz)",
    '`pose_vector_to_matrix4x4(params, "xyzw_t")`; "wxyz_t" of images.txt',
)
def test_colmap_vectors(pycolmap):
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(XYZW.numpy()), T.numpy())
    ours = G.pose_vector_to_matrix4x4(torch.tensor(pose.params, dtype=torch.float64), "xyzw_t")
    assert same(pose.matrix(), ours[:3]) and same(
        pycolmap.Rigid3d(ours[:3].numpy()).params, G.matrix4x4_to_pose_vector(ours, "xyzw_t")
    )


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


@row("PyPose", "`SO3` and `SE3`: (x, y, z, w), after the translation", '`pose_vector_to_matrix4x4(pose, "t_xyzw")`')
def test_pypose(pypose):
    assert same(pypose.SO3(XYZW).matrix(), R)
    pose = pypose.SE3(torch.cat([T, XYZW]))
    assert same(pose.matrix(), G.pose_vector_to_matrix4x4(pose.tensor(), "t_xyzw"))
    assert same(pose.matrix(), G.Rt_to_matrix4x4(R[None], T.view(1, 3, 1)))


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
