"""Sense of rotation, centers, flips.

Positive angles are counter-clockwise as seen in the image, about the center ((W - 1) / 2, (H - 1) / 2). A flip sends the pixel x to
W - 1 - x and the edge x to W - x.
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import brightest, chw, dot, noise, row, same

G = K.geometry
A = K.augmentation
RIGHT = dot(9, 9, 7, 4)  # a dot to the right of the center: counter-clockwise by 90 degrees it is above, at (4, 1)
ABOVE, BELOW = (4, 1), (4, 7)
Y = torch.rand(1, 1, 12, 16, generator=torch.Generator().manual_seed(0))


def turned(degrees, image=RIGHT):
    return G.rotate(chw(image), torch.tensor([float(degrees)]))


@row("OpenCV", "`getRotationMatrix2D`: counter-clockwise", "`get_rotation_matrix2d`, `rotate`")
def test_opencv(cv2):
    matrix = cv2.getRotationMatrix2D((4, 3), 30, 1.5)
    assert same(
        matrix, G.get_rotation_matrix2d(torch.tensor([[4.0, 3]]), torch.tensor([30.0]), torch.full((1, 2), 1.5))
    )
    assert (
        brightest(cv2.warpAffine(RIGHT, cv2.getRotationMatrix2D((4, 4), 90, 1), (9, 9)))
        == brightest(turned(90))
        == ABOVE
    )


@row("Pillow", "`rotate`: counter-clockwise, nearest by default", '`rotate(x, angle, "nearest")`')
def test_pillow(PIL):
    from PIL import Image

    image = noise(12, 16)
    theirs = np.asarray(Image.fromarray(image).rotate(33, Image.BILINEAR))
    assert brightest(Image.fromarray(RIGHT).rotate(90)) == ABOVE
    assert same(theirs[3:-3, 4:-4], G.rotate(chw(image), 33)[..., 3:-3, 4:-4], 1e-4)


@row(
    "SciPy",
    "`ndimage.rotate`: counter-clockwise, splines of order 3 and the result enlarged by default",
    "`rotate`; `order=1, reshape=False` there",
)
def test_scipy(scipy):
    import scipy.ndimage

    image = noise(12, 16)
    assert brightest(scipy.ndimage.rotate(RIGHT, 90)) == ABOVE
    theirs = scipy.ndimage.rotate(image, 33, order=1, reshape=False)
    assert same(theirs[3:-3, 4:-4], G.rotate(chw(image), 33)[..., 3:-3, 4:-4], 1e-4)


@row("scikit-image", "`transform.rotate`: counter-clockwise, bilinear", "`rotate`")
def test_skimage(skimage):
    image = noise(12, 16)
    theirs = skimage.transform.rotate(image, 33)
    assert brightest(skimage.transform.rotate(RIGHT, 90)) == ABOVE and same(
        theirs[3:-3, 4:-4], G.rotate(chw(image), 33)[..., 3:-3, 4:-4], 1e-4
    )


@row("NumPy", "`rot90`: counter-clockwise", "`rotate(x, 90.)`; torch's `rot90(1, (-2, -1))`")
def test_numpy(np):
    assert brightest(np.rot90(RIGHT)) == ABOVE == brightest(chw(RIGHT).rot90(1, (-2, -1)))


@row(
    "torchvision",
    "`rotate`: counter-clockwise, nearest by default",
    '`rotate(x, angle, "nearest")`; `RandomRotation(..., resample="nearest")`',
)
def test_torchvision_rotate(torchvision):
    from torchvision.transforms import v2

    image, linear = chw(noise(12, 16)), v2.InterpolationMode.BILINEAR
    assert brightest(v2.functional.rotate(chw(RIGHT), 90)) == ABOVE
    assert v2.RandomRotation(30).interpolation == "nearest" == v2.RandomAffine(30).interpolation
    assert same(v2.functional.rotate(image, 33, linear)[..., 3:-3, 4:-4], G.rotate(image, 33)[..., 3:-3, 4:-4], 1e-4)


@row("torchvision", "`affine`, `RandomAffine`: clockwise", "`rotate(x, -angle)`; `RandomAffine` is counter-clockwise")
def test_torchvision_affine(torchvision):
    from torchvision.transforms.v2 import functional as F

    assert brightest(F.affine(chw(RIGHT), 90, [0, 0], 1, [0, 0])) == BELOW == brightest(turned(-90))


@row("AlbumentationsX", "`Rotate` and `Affine`: counter-clockwise", "`RandomRotation`, `RandomAffine`")
def test_albumentations(albumentations):
    for transform in (albumentations.Rotate((90, 90), p=1), albumentations.Affine(rotate=(90, 90), p=1)):
        assert brightest(transform(image=RIGHT[..., None])["image"]) == ABOVE
    for transform in (A.RandomRotation((90.0, 90.0), p=1.0), A.RandomAffine((90.0, 90.0), p=1.0)):
        assert brightest(transform(chw(RIGHT))) == ABOVE


@row("DALI", "`fn.rotate`: counter-clockwise, the result enlarged by default", "`rotate`; `keep_size=True` there")
def test_dali(dali):
    from interchange.pipelines import run

    assert brightest(run(lambda fn, x: fn.rotate(x, angle=90.0, keep_size=True), RIGHT[..., None])) == ABOVE


@row(
    "Kornia",
    "`rotate` and `RandomRotation`: counter-clockwise; `get_affine_matrix2d` and `RandomAffine`: clockwise",
    "the same, but `RandomAffine` is counter-clockwise",
)
def test_kornia(kornia):
    assert brightest(kornia.geometry.rotate(chw(RIGHT), torch.tensor([90.0]))) == ABOVE
    assert brightest(kornia.augmentation.RandomAffine((90.0, 90.0), p=1.0)(chw(RIGHT))) == BELOW
    center, one, turn = torch.full((1, 2), 4.0), torch.ones(1, 2), torch.tensor([90.0])
    assert same(
        kornia.geometry.get_affine_matrix2d(0 * one, center, one, turn),
        G.get_affine_matrix2d(0 * one, center, one, turn),
    )


@row(
    "OpenCV",
    "angles of `RotatedRect` and of key points: clockwise, in degrees",
    "minus the angle; orientations are counter-clockwise, in degrees",
)
def test_opencv_angles(cv2):
    corners = cv2.boxPoints(((5.0, 4.0), (4.0, 2.0), 30.0))
    turn = np.deg2rad(30)  # clockwise where y is down
    x, y = 2 * np.cos(turn) - 1 * np.sin(turn) + 5, 2 * np.sin(turn) + 1 * np.cos(turn) + 4
    assert abs(corners - [x, y]).max(1).min() < 1e-4
    ramp = (
        torch.arange(32.0).view(1, 1, 32, 1).expand(1, 1, 32, 32)
    )  # brighter downward: the gradient is 90 degrees clockwise
    assert abs(K.feature.PatchDominantGradientOrientation(32)(ramp).item() + np.pi / 2) < 0.1


@row("torchvision", "rotated boxes `CXCYWHR`: counter-clockwise, in degrees", 'corners (B, N, 4, 2), key "bbox"')
def test_torchvision_rotated_boxes(torchvision):
    from torchvision import tv_tensors
    from torchvision.transforms.v2 import functional as F

    box = tv_tensors.BoundingBoxes([[5.0, 4.0, 4.0, 2.0, 30.0]], format="CXCYWHR", canvas_size=(10, 10))
    theirs = F.convert_bounding_box_format(box, new_format=tv_tensors.BoundingBoxFormat.XYXYXYXY).reshape(4, 2)
    center, one = torch.tensor([[5.0, 4.0]]), torch.ones(1, 2)
    corners = torch.tensor([[[3.0, 3.0], [7.0, 3.0], [7.0, 5.0], [3.0, 5.0]]])
    ours = G.transform_points(
        torch.cat([G.get_rotation_matrix2d(center, torch.tensor([30.0]), one), torch.tensor([[[0, 0, 1.0]]])], 1),
        corners,
    )
    assert same(theirs, ours)


def flipped(kind, labels):
    return A.AugmentationSequential(A.RandomHorizontalFlip(p=1.0), data_keys=["image", kind])(
        torch.zeros(1, 1, 9, 9), labels
    )[1]


@row(
    "torchvision",
    "a horizontal flip sends the key point x to W - 1 - x, the box edge x to W - x",
    'the same: "keypoints", "bbox_xyxy"',
)
def test_torchvision_flips(torchvision):
    from torchvision import tv_tensors
    from torchvision.transforms.v2 import functional as F

    points = F.horizontal_flip(tv_tensors.KeyPoints([[2.0, 3.0]], canvas_size=(9, 9)))
    boxes = F.horizontal_flip(tv_tensors.BoundingBoxes([[1.0, 2, 4, 6]], format="XYXY", canvas_size=(9, 9)))
    assert same(points, flipped("keypoints", torch.tensor([[[2.0, 3]]]))) and same(points, [6, 3])
    assert same(boxes, flipped("bbox_xyxy", torch.tensor([[[1.0, 2, 4, 6]]]))) and same(boxes, [5, 2, 8, 6])


@row(
    "AlbumentationsX",
    "the same; angles of key points are counter-clockwise, and a flip sends a to 180 - a",
    "points as there; angles are not carried",
)
def test_albumentations_flips(A):
    flip = A.Compose(
        [A.HorizontalFlip(p=1)], keypoint_params=A.KeypointParams("xya"), bbox_params=A.BboxParams("pascal_voc")
    )
    result = flip(image=np.zeros((9, 9, 3), np.uint8), keypoints=[(2, 3, 30)], bboxes=[(1, 2, 4, 6)])
    assert same(result["keypoints"], [6, 3, 150], 1e-3) and same(result["bboxes"], [5, 2, 8, 6], 1e-3)
    turn = A.Compose([A.Rotate((90, 90), p=1)], keypoint_params=A.KeypointParams("xya"))
    assert same(turn(image=np.zeros((9, 9, 3), np.uint8), keypoints=[(7, 4, 30)])["keypoints"], [4, 1, 120], 1e-3)


@row(
    "Kornia",
    'boxes "bbox_xyxy" are flipped as pixels: the edge x goes to W - 1 - x',
    '"bbox_xyxy_plus"; "bbox_xyxy" has edges',
)
def test_kornia_flips(kornia):
    flip = kornia.augmentation.AugmentationSequential(
        kornia.augmentation.RandomHorizontalFlip(p=1.0), data_keys=["image", "bbox_xyxy"]
    )
    theirs = flip(torch.zeros(1, 1, 9, 9), torch.tensor([[[1.0, 2, 4, 6]]]))[1]
    assert not same(theirs, [5, 2, 8, 6]) and same(flipped("bbox_xyxy", torch.tensor([[[1.0, 2, 4, 6]]])), [5, 2, 8, 6])
