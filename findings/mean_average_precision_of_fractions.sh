#!/usr/bin/env bash
# mean-average-precision 2024.1.5.0 and pycocotools 2.0.11: the "COCO mAP" of boxes in fractions of the image is 1.000 in place of .34.
# Believed: an IoU does not depend on the unit of coordinates, so that boxes in fractions, as YOLO has them, score as in pixels, and what its
# documentation computes as COCO's mAP is the number of pycocotools. Seen of jittered boxes: of 8, 16 and 32 pixels of 640 fractions have an AP of
# 1.000, of 128 pixels .90, where pycocotools has .34, .31, .33 and .32; a box that touches the object in a corner alone counts as found. In pixels
# it has .41, .34, .36 and .33. The IoU adds 1 to each width and height, as if coordinates were whole numbers of pixels that both belong to the box.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mean-average-precision==2024.1.5.0 pycocotools==2.0.11 pandas==2.3.3 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import contextlib
import io
from importlib.metadata import version

import numpy as np
from mean_average_precision import MetricBuilder
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

print("mean-average-precision", version("mean-average-precision"), "pycocotools", version("pycocotools"))


def scores(truths, found):
    """COCO's AP and AP50 by the package, as its documentation computes them."""
    metric = MetricBuilder.build_evaluation_metric("map_2d", async_mode=False, num_classes=1)
    for true, seen in zip(truths, found):
        columns = np.zeros(len(true))
        metric.add(np.c_[seen, np.zeros(len(seen)), np.linspace(0.9, 0.1, len(seen))], np.c_[true, columns, columns, columns])
    options = {"recall_thresholds": np.arange(0, 1.01, 0.01), "mpolicy": "soft"}
    return [float(metric.value(iou_thresholds=t, **options)["mAP"]) for t in (np.arange(0.5, 1, 0.05), 0.5)]


def coco_scores(truths, found):
    def listed(groups, **more):
        for image, boxes in enumerate(groups):
            for k, (x1, y1, x2, y2) in enumerate(boxes.tolist()):
                score = {"score": np.linspace(0.9, 0.1, len(boxes))[k]} if "iscrowd" not in more else {}
                yield {
                    "image_id": image,
                    "category_id": 1,
                    "bbox": [x1, y1, x2 - x1, y2 - y1],
                    "area": (x2 - x1) * (y2 - y1),
                    **more,
                    **score,
                }

    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        annotations = [{"id": k + 1, **entry} for k, entry in enumerate(listed(truths, iscrowd=0))]
        coco.dataset = {"images": [{"id": k} for k in range(len(truths))], "categories": [{"id": 1}], "annotations": annotations}
        coco.createIndex()
        evaluation = COCOeval(coco, coco.loadRes(list(listed(found))), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return evaluation.stats[:2].tolist()


random = np.random.default_rng(0)
for size in (8, 16, 32, 128):
    truths, found = [], []
    for _ in range(60):
        corner = random.uniform(0, 500, (4, 2))
        truths.append(np.c_[corner, corner + random.uniform(0.7, 1.3, (4, 2)) * size])
        found.append(truths[-1] + random.normal(0, 0.12 * size, (4, 4)))
    pixels, coco = scores(truths, found), coco_scores(truths, found)
    fractions = scores([boxes / 640 for boxes in truths], [boxes / 640 for boxes in found])
    print(f"objects of {size} pixels: AP and AP50 {np.round(pixels, 3)} in pixels, {np.round(fractions, 3)} in fractions,", end=" ")
    print("pycocotools", np.round(coco, 3))
    assert fractions[1] > 0.99 and pixels[0] > coco[0]
    if size < 128:
        assert fractions[0] > 0.99
    if size == 8:
        assert pixels[0] > coco[0] + 0.05
apart = scores([np.array([[0.1, 0.1, 0.3, 0.3]])], [np.array([[0.3, 0.3, 0.5, 0.5]])])
in_pixels = scores([np.array([[64.0, 64, 192, 192]])], [np.array([[192.0, 192, 320, 320]])])
print(f"a box beside the object, that touches it in one point: AP50 {apart[1]:.2f} in fractions, {in_pixels[1]:.2f} in pixels")
assert apart[1] > 0.99 and in_pixels[1] == 0
PROGRAM
