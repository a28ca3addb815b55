#!/usr/bin/env bash
# pycocotools 2.0.11: the object whose annotation has the id 0 counts as missed, however well it is detected.
# Believed: ids only have to be unique, so that a converter may number annotations from 0, as it may images and categories. Seen: COCOeval
# notes at each detection the id of its match, where 0 means none: of four objects that are detected exactly, AP is 1.000 with the ids 1 to 4
# and .564 with 0 to 3, recall .75; category 0 and image 0 do no harm. There is no warning, and a large data set just looks a little
# worse, a rare class much. Number annotations from 1. faster-coco-eval 1.8.0 gives the same numbers and warns.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pycocotools==2.0.11 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import contextlib
import io

from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval


def scores(first_annotation, first_image=1, category=1):
    images = range(first_image, first_image + 4)
    box = {"category_id": category, "bbox": [10, 10, 50, 50]}
    truth = COCO()
    truth.dataset = {
        "info": {},
        "images": [{"id": image, "width": 100, "height": 100} for image in images],
        "categories": [{"id": category, "name": "thing"}],
        "annotations": [
            {"id": first_annotation + i, "image_id": image, "area": 2500, "iscrowd": 0, **box} for i, image in enumerate(images)
        ],
    }
    with contextlib.redirect_stdout(io.StringIO()):
        truth.createIndex()
        found = truth.loadRes([{"image_id": image, "score": 0.9 - 0.1 * i, **box} for i, image in enumerate(images)])
        evaluation = COCOeval(truth, found, "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return [round(float(evaluation.stats[i]), 3) for i in (0, 8)]


for name, numbers in (("annotations from 1", (1,)), ("annotations from 0", (0,)), ("images and category from 0", (1, 0, 0))):
    ap, recall = scores(*numbers)
    print(f"{name}: AP {ap}, recall {recall}")
    assert (ap, recall) == ((0.564, 0.75) if name == "annotations from 0" else (1.0, 1.0))
PROGRAM
