"""Cameras, distortion and disparities.

Cameras look along z, with x to the right and y down. Points, principal points and disparities are in pixels, the first
pixel's center at 0.
"""

import numpy as np
import pytest
import torch

import kvision as K
from interchange.rows import noise, row, same
from interchange.test_rotations import AXIS_ANGLE, R, T

G = K.geometry
# Of COLMAP's models: focal lengths and principal point, then coefficients.
RADIAL = {
    "SIMPLE_RADIAL": [50, 20, 15, 0.1],
    "RADIAL": [50, 20, 15, 0.1, -0.05],
    "OPENCV": [50, 60, 20, 15, 0.1, -0.05, 0.01, 0.003],
    "FULL_OPENCV": [50, 60, 20, 15, 0.1, -0.05, 0.01, 0.003, 0.02, 0.05, -0.03, 0.01],
}
FISHEYE = {
    "SIMPLE_FISHEYE": [50, 20, 15],
    "FISHEYE": [50, 60, 20, 15],
    "SIMPLE_RADIAL_FISHEYE": [50, 20, 15, 0.1],
    "RADIAL_FISHEYE": [50, 20, 15, 0.1, -0.05],
    "OPENCV_FISHEYE": [50, 60, 20, 15, 0.1, -0.05, 0.01, 0.003],
}
POINTS = torch.tensor([[0.5, 0.2, 1.0], [-0.3, 0.4, 1], [0, 0, 1]], dtype=torch.float64)


def seen_by_colmap(pycolmap, model, params):
    return torch.from_numpy(
        pycolmap.Camera(model=model, width=40, height=30, params=params).img_from_cam(POINTS.numpy())
    )


@row(
    "COLMAP",
    "pixel coordinates begin at the edge: the first pixel's center is (.5, .5)",
    'centers at (0, 0): `convert_keypoints(points, "edges", "centers")`, `camera_from_colmap`',
)
def test_colmap_pixels(pycolmap):
    camera = pycolmap.Camera(model="PINHOLE", width=8, height=6, params=[5.0, 6.0, 4.0, 3.0])
    pixel = camera.img_from_cam(np.array([[0.2, -0.1, 1.0]]))
    matrix, _ = G.camera_from_colmap(torch.tensor(camera.params, dtype=torch.float64), "PINHOLE")
    assert same(matrix, [[5.0, 0, 3.5], [0, 6, 2.5], [0, 0, 1]])
    ours = G.project_points(torch.tensor([[0.2, -0.1, 1.0]], dtype=torch.float64), matrix[None])
    assert same(G.convert_keypoints(torch.from_numpy(pixel), "edges", "centers"), ours)


@row(
    "COLMAP",
    "models SIMPLE_PINHOLE to FULL_OPENCV: OpenCV's distortion, of one focal length or two; (fx, fy, cx, cy, k1, k2, p1, p2, ...)",
    "`camera_from_colmap(params, model)`, then `distort_points`; `camera_to_colmap`",
)
def test_colmap_distortion(pycolmap):
    for model, values in RADIAL.items():
        matrix, coefficients = G.camera_from_colmap(torch.tensor(values, dtype=torch.float64), model)
        ours = G.distort_points(G.project_points(POINTS, matrix[None])[None], matrix[None], coefficients[None])
        theirs = seen_by_colmap(pycolmap, model, values)
        assert same(G.convert_keypoints(theirs, "edges", "centers"), ours), model


@row(
    "COLMAP",
    "models SIMPLE_FISHEYE to OPENCV_FISHEYE: Kannala-Brandt, of one focal length or two",
    "`camera_from_colmap(params, model)`, then `distort_points_kannala_brandt` of (fx, fy, cx, cy, k1, k2, k3, k4)",
)
def test_colmap_fisheye(pycolmap):
    for model, values in FISHEYE.items():
        matrix, k = G.camera_from_colmap(torch.tensor(values, dtype=torch.float64), model)
        params = torch.cat([matrix.diagonal()[:2], matrix[:2, 2], k])
        theirs = seen_by_colmap(pycolmap, model, values)
        ours = G.distort_points_kannala_brandt(POINTS[:, :2], params)
        assert same(G.convert_keypoints(theirs, "edges", "centers"), ours), model


@row(
    "COLMAP",
    "models FOV, THIN_PRISM_FISHEYE, RAD_TAN_THIN_PRISM_FISHEYE, DIVISION, EUCM, EQUIRECTANGULAR",
    "none: `camera_from_colmap` refuses them; `colmap image_undistorter` gives PINHOLE",
)
def test_colmap_others(pycolmap):
    ours = {"SIMPLE_PINHOLE", "PINHOLE", *RADIAL, *FISHEYE}
    others = {"FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "EUCM"}
    others |= {"EQUIRECTANGULAR", "INVALID"}
    assert set(pycolmap.CameraModelId.__members__) == ours | others
    for model in others:
        with pytest.raises(ValueError, match="model must be one of"):
            G.camera_from_colmap(torch.ones(8), model)


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


@row(
    "OpenCV",
    "`StereoBM`, `StereoSGBM`: a point at x in the left image is at x - d in the right one; int16, in 16ths of a pixel",
    "`depth_from_disparity(d / 16, baseline, fx)`, `StereoCamera`: the same sign, in pixels",
)
def test_opencv_disparity(cv2):
    scene = noise(64, 136, dtype=np.uint8)
    left, right = scene[:, :128], scene[:, 8:]  # what is at x on the left is at x - 8 on the right
    theirs = cv2.StereoSGBM_create(numDisparities=16, blockSize=5).compute(
        np.ascontiguousarray(left), np.ascontiguousarray(right)
    )
    assert theirs.dtype == np.int16 and np.median(theirs[16:48, 40:100]) == 8 * 16
    camera = torch.tensor([[[50.0, 0, 64, 0], [0, 50, 32, 0], [0, 0, 1, 0]]])
    other = camera.clone()
    other[:, 0, 3] = -50 * 0.1  # the right camera is .1 to the right
    depth = G.depth_from_disparity(torch.full((1, 1, 1), 8.0), 0.1, 50.0)
    assert same(G.StereoCamera(camera, other).reproject_disparity_to_3D(torch.full((1, 1, 1, 1), 8.0))[..., 2], depth)


@row(
    "OpenCV",
    "`reprojectImageTo3D(disparity, Q)` of `stereoRectify`'s Q: depth fx baseline / d",
    "`StereoCamera.reproject_disparity_to_3D`",
)
def test_opencv_reprojection(cv2):
    camera = np.float64([[50, 0, 2], [0, 50, 1], [0, 0, 1]])
    *_, left, right, q, _, _ = cv2.stereoRectify(
        camera,
        np.zeros(5),
        camera,
        np.zeros(5),
        (5, 4),
        np.eye(3),
        np.float64([[-0.1], [0], [0]]),
        flags=cv2.CALIB_ZERO_DISPARITY,
    )
    disparity = noise(4, 5) + 1
    theirs = cv2.reprojectImageTo3D(disparity, q)
    pair = G.StereoCamera(*(torch.from_numpy(p)[None].float() for p in (left, right)))
    assert same(theirs, pair.reproject_disparity_to_3D(torch.from_numpy(disparity)[None, ..., None]), 1e-4)


@row(
    "OpenCV",
    "`stereoRectify`: half of the rotation each, then the baseline onto x or y; sizes are (width, height)",
    "`stereo_rectify`: the same matrices; sizes are (H, W)",
)
def test_opencv_rectification(cv2):
    camera, rotation = (
        np.float64([[500, 0, 320], [0, 500, 240], [0, 0, 1]]),
        cv2.Rodrigues(np.float64([0.02, 0.1, 0.01]))[0],
    )
    t = np.float64([[-0.1], [0.01], [0]])
    theirs = cv2.stereoRectify(camera, np.zeros(5), camera, np.zeros(5), (640, 480), rotation, t, alpha=0)[:5]
    matrix = torch.from_numpy(camera)
    pair = G.stereo_rectify(matrix, None, matrix, None, (480, 640), *map(torch.from_numpy, (rotation, t)), alpha=0.0)
    for name, result in zip(("R1", "R2", "P1", "P2", "Q"), theirs):
        assert same(result, getattr(pair, name), 1e-3)


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
