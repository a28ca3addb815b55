"""Boxes.

The key "bbox_xyxy" and `mean_iou_bbox` take edges: all of an image is (0, 0, W, H). `Boxes` and "bbox_xyxy_plus" take the first and
the last pixel. `convert_boxes` converts tensors between them, (x, y, w, h), (cx, cy, w, h) and fractions of the image.
"""

import contextlib
import io

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
    '`box_convert`: "xyxy", "xywh" and "cxcywh", all by edges',
    "`convert_boxes`: the same names",
)
def test_torchvision_formats(torchvision):
    modes = "xyxy", "xywh", "cxcywh"
    for a in modes:
        for b in modes:
            assert same(torchvision.ops.box_convert(B, a, b), K.geometry.convert_boxes(B, a, b))


@row(
    "torchvision",
    "`masks_to_boxes`: the first and the last pixel",
    '`masks_to_boxes`: the same; `masks_to_boxes(masks, "xyxy")` gives edges',
)
def test_torchvision_masks(torchvision):
    assert torchvision.ops.masks_to_boxes(torch.from_numpy(MASK)[None]).tolist() == [[3, 2, 7, 5]]
    edges = K.geometry.convert_boxes(torch.tensor([3.0, 2, 7, 5]), "xyxy_plus", "xyxy")
    assert edges.tolist() == [3, 2, 8, 6]
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
    "pycocotools",
    "`COCOeval`: mean of 10 thresholds of the overlap, .5 to .95, and of 101 recalls; an overlap equal to the threshold is right",
    "`mean_average_precision`: one threshold, 11 recalls, as Pascal VOC 2007; an overlap above it is right",
)
def test_pycocotools_precision(pycocotools):
    """Right, wrong, right: the precision is 1 up to a recall of .5, and 2/3 beyond."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    true = torch.tensor([[10.0, 10, 30, 30], [50, 50, 90, 90]])
    found, scores = torch.cat([true[:1], true[:1] + 200, true[1:]]), torch.tensor([0.9, 0.8, 0.7])

    def entries(boxes, **more):
        xywh = K.geometry.convert_boxes(boxes, "xyxy", "xywh")
        boxes = [dict(bbox=b.tolist(), area=float(b[2] * b[3]), iscrowd=0) for b in xywh]
        return [
            dict(b, id=i + 1, image_id=1, category_id=1, **{k: float(v[i]) for k, v in more.items()})
            for i, b in enumerate(boxes)
        ]

    with contextlib.redirect_stdout(io.StringIO()):
        data = COCO()
        data.dataset = dict(info={}, images=[dict(id=1)], categories=[dict(id=1)], annotations=entries(true))
        data.createIndex()
        evaluation = COCOeval(data, data.loadRes(entries(found, score=scores)), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    assert same(evaluation.stats[:2], [(51 + 50 * 2 / 3) / 101] * 2)  # the boxes are exact at every threshold
    labels = [torch.ones(3, dtype=torch.long)], [torch.ones(2, dtype=torch.long)]
    mean, _ = K.metrics.mean_average_precision([found], labels[0], [scores], [true], labels[1], 2)
    assert same(mean, (6 + 5 * 2 / 3) / 11)


@row(
    "AlbumentationsX",
    '"yolo": center and size in fractions of the image; "coco" (x, y, w, h), "pascal_voc" (x1, y1, x2, y2), edges',
    '"bbox_xywh", "bbox_xyxy"; `convert_boxes(boxes, "normalized_cxcywh", "xyxy", (H, W))` of "yolo"',
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
    boxes = torch.tensor([[1.0, 2, 4, 6]])
    for mode, expected in (("xywh", [1, 2, 3, 4]), ("normalized_cxcywh", [0.125, 0.4, 0.15, 0.4])):
        assert same(K.geometry.convert_boxes(boxes, "xyxy", mode, (10, 20)), expected)
