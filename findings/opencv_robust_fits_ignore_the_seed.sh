#!/usr/bin/env bash
# opencv-python-headless 5.0.0.93: cv2.setRNGSeed does not reach RANSAC, LMEDS and USAC, so "20 seeds" are one run twenty times.
# Believed: the mean and spread of findHomography, findEssentialMat, findFundamentalMat and estimateAffine2D over seeds are
# those of a random algorithm, as they are of cv2.kmeans. Seen: all of them start a generator of their own at a fixed state: same
# points, same bits. The spread is real: with the same points in another order the error of RANSAC's homography varies by a factor of
# 2.7. UsacParams.randomGeneratorState is the seed of the USAC methods, and none exists for RANSAC: shuffle the points.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import cv2
import numpy as np

random, n = np.random.default_rng(0), 300
truth = np.array([[1.1, 0.05, 10], [-0.04, 0.95, 20], [1e-4, -5e-5, 1]])
camera = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def project(matrix, points):
    moved = np.c_[points, np.ones(len(points))] @ matrix.T
    return moved[:, :2] / moved[:, 2:]


first = random.uniform(0, 600, (n, 2))
second = project(truth, first) + random.normal(0, 1, (n, 2))
wrong = random.random(n) < 0.7
second[wrong] = random.uniform(0, 600, (wrong.sum(), 2))
corners = np.array([[0, 0], [600, 0], [600, 600], [0, 600.0]])


def homography(method, order=slice(None)):
    matrix, _ = cv2.findHomography(first[order], second[order], method, 3.0, maxIters=2000, confidence=0.99)
    return float(np.linalg.norm(project(matrix, corners) - project(truth, corners), axis=1).mean())


print("OpenCV", cv2.__version__)
fits = {
    "homography RANSAC": lambda: homography(cv2.RANSAC),
    "homography LMEDS": lambda: homography(cv2.LMEDS),
    "homography USAC_MAGSAC": lambda: homography(cv2.USAC_MAGSAC),
    "essential RANSAC": lambda: cv2.findEssentialMat(first, second, camera, cv2.RANSAC, 0.999, 1.0)[0].tobytes(),
    "fundamental RANSAC": lambda: cv2.findFundamentalMat(first, second, cv2.RANSAC, 1.0, 0.999)[0].tobytes(),
    "affine RANSAC": lambda: cv2.estimateAffine2D(first, second)[0].tobytes(),
    "k-means": lambda: cv2.kmeans(first.astype(np.float32), 4, None, (3, 10, 1.0), 1, cv2.KMEANS_RANDOM_CENTERS)[2].tobytes(),
}
for name, fit in fits.items():
    results = set()
    for seed in range(20):
        cv2.setRNGSeed(seed)
        results.add(fit())
    print(f"{name}: {len(results)} different results of 20 seeds")
    assert len(results) > 10 if name == "k-means" else len(results) == 1
errors = [homography(cv2.RANSAC, np.random.default_rng(seed).permutation(n)) for seed in range(20)]
print(f"RANSAC's homography of the same points in 20 orders: {min(errors):.2f} to {max(errors):.2f} px off at the corners")
assert max(errors) > 1.5 * min(errors)
PROGRAM
