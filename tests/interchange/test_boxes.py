"""Boxes.

The key "bbox_xyxy" and `mean_iou_bbox` take edges: all of an image is (0, 0, W, H). `Boxes` and "bbox_xyxy_plus" take the first and
the last pixel.
"""

import numpy as np
import torch

import kvision as K
from interchange.rows import row, same

A, B = torch.tensor([[1.0, 2, 5, 8], [0, 0, 4, 4]]), torch.tensor([[2.0, 3, 7, 9], [3, 3, 4, 6]])
MASK = np.zeros((9, 12), np.uint8)
MASK[2:6, 3:8] = 1


@row("torchvision", "`box_iou`: edges, (x1, y1, x2, y2)", "`mean_iou_bbox`")
def test_torchvision_iou(torchvision):
    assert same(torchvision.ops.box_iou(A, B), K.metrics.mean_iou_bbox(A, B))


@row(
    "torchvision",
    "`masks_to_boxes`: the first and the last pixel",
    '"bbox_xyxy_plus"; add 1 to x2 and y2 for "bbox_xyxy"',
)
def test_torchvision_masks(torchvision):
    assert torchvision.ops.masks_to_boxes(torch.from_numpy(MASK)[None]).tolist() == [[3, 2, 7, 5]]
    mask = K.geometry.Boxes.from_tensor(torch.tensor([[[3.0, 2, 7, 5]]]), mode="xyxy_plus").to_mask(9, 12)
    assert same(mask, MASK)


@row("OpenCV", "`boundingRect`: (x, y, w, h), counting pixels", '`Boxes.from_tensor(mode="xywh")`, key "bbox_xywh"')
def test_opencv(cv2):
    assert cv2.boundingRect(MASK) == (3, 2, 5, 4)
    assert same(K.geometry.Boxes.from_tensor(torch.tensor([[[3.0, 2, 5, 4]]]), mode="xywh").to_mask(9, 12), MASK)


@row(
    "scikit-image",
    "`regionprops` `bbox`: (row, column, end row, end column), ends excluded",
    '`bbox[..., [1, 0, 3, 2]]` is "bbox_xyxy"',
)
def test_skimage(skimage):
    assert skimage.measure.regionprops(MASK)[0].bbox == (2, 3, 6, 8)


@row("pycocotools", "boxes (x, y, w, h), edges; masks in columns", '`mean_iou_bbox(box_format="xywh")`')
def test_pycocotools(pycocotools):
    import pycocotools.mask

    a, b = (torch.cat([x[:, :2], x[:, 2:] - x[:, :2]], 1) for x in (A, B))
    theirs = pycocotools.mask.iou(a.double().numpy(), b.double().numpy(), [0, 0])
    assert same(theirs, K.metrics.mean_iou_bbox(a, b, "xywh"))
    assert pycocotools.mask.toBbox(pycocotools.mask.encode(np.asfortranarray(MASK))).tolist() == [3, 2, 5, 4]


@row(
    "AlbumentationsX",
    '"yolo": center and size in fractions of the image; "coco" (x, y, w, h), "pascal_voc" (x1, y1, x2, y2), edges',
    'times (W, H, W, H); "bbox_xywh", "bbox_xyxy"',
)
def test_albumentations(albumentations):
    image = np.zeros((10, 20, 3), np.uint8)
    for name, box, expected in (
        ("coco", [1, 2, 3, 4], [16, 2, 3, 4]),
        ("pascal_voc", [1, 2, 4, 6], [16, 2, 19, 6]),
        ("yolo", [0.125, 0.4, 0.15, 0.4], [0.875, 0.4, 0.15, 0.4]),
    ):
        flip = albumentations.Compose([albumentations.HorizontalFlip(p=1)], bbox_params=albumentations.BboxParams(name))
        assert same(flip(image=image, bboxes=[box])["bboxes"], expected, 1e-3)
