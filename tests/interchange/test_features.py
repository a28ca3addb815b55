"""Key points of SIFT and their descriptors.

Frames (B, N, 2, 3) take the unit circle to the image; the scale of one of SIFT is 6 times the blur at which it was found.
"""

import warnings

import numpy as np
import torch

import kvision as K
from interchange.rows import row, same

F = K.feature
# A blob around the pixel (40, 28).
Y, X = np.mgrid[:64, :80].astype(np.float32)
BLOB = (np.exp(-((X - 40) ** 2 + (Y - 28) ** 2) / 50) * 204 + 25.5).astype(np.uint8)
# Two blobs of other sizes, which give one direction each.
PAIR = (BLOB * 0.5 + 120 * np.exp(-((X - 49) ** 2 + (Y - 31) ** 2) / 8)).astype(np.uint8)


def found(image: np.ndarray, **kwargs: object) -> tuple[torch.Tensor, torch.Tensor]:
    """Frames (N, 2, 3) and descriptors (N, 128) as OpenCV finds them."""
    sift = F.SIFTFeature(num_features=8, opencv=True, **kwargs)
    with torch.no_grad():
        frames, responses, descriptors = sift(torch.from_numpy(image)[None, None].float() / 255)
    return frames[responses > 0], descriptors[responses > 0]


@row(
    "OpenCV",
    "`SIFT`: centers are .23 pixels too far to the lower right, unless `enable_precise_upscale=True`",
    "`SIFTFeature(opencv=True)`: as the default there",
)
def test_opencv_centers(cv2):
    for precise, center in ((False, (40.23, 28.23)), (True, (40, 28))):
        points = cv2.SIFT_create(enable_precise_upscale=precise).detect(BLOB)
        assert points and all(same(point.pt, center, 0.01) for point in points)
    frames, _ = found(BLOB)
    assert len(frames) and same(F.get_laf_center(frames[None])[0], np.full((len(frames), 2), [40.23, 28.23]), 0.05)


@row(
    "OpenCV",
    "`KeyPoint.size` is twice the blur; `angle` in degrees, clockwise",
    "`get_laf_scale(frames) / 3`, `-get_laf_orientation(frames)`",
)
def test_opencv_sizes_and_angles(cv2):
    theirs = max(cv2.SIFT_create().detect(PAIR), key=lambda point: point.response)
    frames, _ = found(PAIR)
    distance = (F.get_laf_center(frames[None])[0] - torch.tensor(theirs.pt)).norm(dim=-1)
    turned = (-F.get_laf_orientation(frames[None])[0, :, 0] - theirs.angle + 180) % 360 - 180
    sizes = F.get_laf_scale(frames[None]).flatten() / 3
    assert ((distance < 0.05) & (turned.abs() < 2) & ((sizes - theirs.size).abs() < 0.02)).any()


@row(
    "OpenCV",
    "descriptors: whole numbers as float32, of length about 512, angles counted counter-clockwise and side by side",
    '`SIFTFeature(opencv=True, rootsift=False, descriptor_layout="opencv")`; `convert_sift_descriptor_layout`',
)
def test_opencv_descriptors(cv2):
    _, theirs = cv2.SIFT_create().detectAndCompute(PAIR, None)
    assert theirs.dtype == np.float32 and (theirs == theirs.round()).all()
    assert (abs(np.linalg.norm(theirs, axis=1) - 512) < 8).all()
    _, ours = found(PAIR, rootsift=False, descriptor_layout="opencv")
    assert same(torch.cdist(torch.from_numpy(theirs), ours).amin(1) < 30, np.ones(len(theirs)))


@row(
    "COLMAP",
    "`Sift`: (x, y, blur, radians), x and y begin at the edge; descriptors are RootSIFT of length 1",
    '`convert_keypoints(xy, "edges", "centers")`, `get_laf_scale(frames) / 6`',
)
def test_colmap(pycolmap):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        points, descriptors = pycolmap.Sift().extract(BLOB)
    points = torch.from_numpy(points)
    assert same(
        K.geometry.convert_keypoints(points[:, :2], "edges", "centers"), np.full((len(points), 2), [40, 28]), 0.01
    )
    assert same(points[:, 2], np.full(len(points), 4.44), 0.05) and points[:, 3].abs().max() < 6.3
    assert same(np.linalg.norm(descriptors, axis=1), np.ones(len(points)), 0.01)
    frames, _ = found(BLOB)
    assert same(F.get_laf_scale(frames[None]).flatten() / 6, np.full(len(frames), 4.44), 0.05)
