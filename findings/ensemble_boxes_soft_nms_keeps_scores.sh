#!/usr/bin/env bash
# ensemble-boxes 1.0.9: soft_nms returns the scores of before, so that it suppresses nothing.
# Believed: soft non-maximum suppression lowers the scores of boxes that overlap a better one, which is all that it does, and a detector's average
# precision rises by it. Seen of boxes a and b with an IoU of .82 and c elsewhere, of scores .9, .8 and .5: b comes after c, as its score is .21 inside (by
# the linear method .15), and it is returned with .8, so that scores do not descend. Sorted by score, as evaluations do, the list is that of
# before. Only what falls below thresh inside, .001 by default, is left out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ensemble-boxes==1.0.9 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import importlib.metadata

import numpy as np
from ensemble_boxes import soft_nms

print("ensemble-boxes", importlib.metadata.version("ensemble-boxes"))
boxes = [[0.1, 0.1, 0.3, 0.3], [0.1, 0.12, 0.3, 0.32], [0.6, 0.6, 0.8, 0.8]]
scores = [0.9, 0.8, 0.5]
iou = 0.18 / (2 * 0.2 - 0.18)
for name, method, weight in (("linear", 1, 1 - iou), ("Gaussian", 2, np.exp(-(iou**2) / 0.5))):
    expected = 0.8 * weight
    kept, found, _ = soft_nms([boxes], [scores], [[0, 0, 0]], method=method, iou_thr=0.5, sigma=0.5)
    order = [boxes.index(box.tolist()) for box in kept]
    print(f"{name}, IoU {iou:.2f}: boxes {order} with scores {found.tolist()}, where the second should have {expected:.3f}")
    assert order == [0, 2, 1] and found.tolist() == [0.9, 0.5, 0.8]
    for thresh in (expected - 0.01, expected + 0.01):
        kept, found, _ = soft_nms([boxes], [scores], [[0, 0, 0]], method=method, iou_thr=0.5, sigma=0.5, thresh=thresh)
        print(f"{name}, threshold {thresh:.3f}: {found.tolist()}")
        assert len(kept) == (3 if thresh < expected else 2)
PROGRAM
