#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: of scenes that are far away cv2.recoverPose returns any one of the four poses, most of them wrong by 180 degrees.
# Believed: a pose has no scale, and of the four that an essential matrix has, the one is taken that puts the points in front of both cameras. Seen: points
# beyond 50 baselines count as behind; only the overload that takes distanceThresh speaks of such a limit.
# Exact points at a depth of 20 to 40 baselines all count, a few at 60, none at 100 and beyond, and then of 24 motions 4 to 7 come back
# right, the others with a turn of 180 degrees or t reversed, from the exact matrix as from findEssentialMat. Only the returned count, 0, tells. With
# distanceThresh=1e9 all are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

print("opencv", cv2.__version__)
camera = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])


def seen(points):
    pixels = points @ camera.T
    return np.ascontiguousarray(pixels[:, :2] / pixels[:, 2:])


def right(result, rotation, step):
    return np.trace(rotation.T @ result[1]) > 2.9 and float(result[2].ravel() @ step) > 0.9


for depth in (20, 40, 60, 100, 300):
    random = np.random.default_rng(0)
    counts, poses = {"exact": [], "estimated": []}, {"exact": 0, "estimated": 0, "without limit": 0}
    for _ in range(24):
        rays = np.c_[random.uniform(-0.3, 0.3, (200, 2)), np.ones(200)] * random.uniform(0.8, 1.2, (200, 1))
        rotation = cv2.Rodrigues(random.uniform(-0.05, 0.05, 3))[0]
        step = random.normal(size=3)
        step /= np.linalg.norm(step)
        cross = np.array([[0, -step[2], step[1]], [step[2], 0, -step[0]], [-step[1], step[0], 0]])
        first, second = seen(rays * depth), seen(rays * depth @ rotation.T + step)
        matrices = {"exact": cross @ rotation, "estimated": cv2.findEssentialMat(first, second, camera)[0][:3]}
        for name, essential in matrices.items():
            result = cv2.recoverPose(essential, first, second, camera)
            counts[name].append(result[0])
            poses[name] += int(right(result, rotation, step))
        far = cv2.recoverPose(matrices["exact"], first, second, camera, distanceThresh=1e9)
        poses["without limit"] += int(far[0] == 200 and right(far, rotation, step))
    spans = {name: f"{min(count)} to {max(count)}" for name, count in counts.items()}
    print(f"depth {depth}: points of 200 that count {spans}, right poses of 24 {poses}")
    assert poses["without limit"] == 24
    if depth < 100:
        assert poses["exact"] == 24 and (min(counts["exact"]) == 200 if depth < 50 else max(counts["exact"]) < 80)
    else:
        assert poses["exact"] < 12 and poses["estimated"] < 12 and max(counts["exact"]) == 0
PROGRAM
