#!/usr/bin/env bash
# pypose 0.9.5 (torch 2.13.0): svdtf of points in a plane returns a wrong pose for almost half of all poses, and so does its ICP.
# Believed: "the rigid transformation matrix that minimizes the mean squared error between the input point sets", its documentation, whose example is three
# points, which always lie in a plane. Seen of 20 points of a board in 200 random poses, without noise: 88 results are off by the size of the
# scene, an RMS of 1.6 where the board is 2 wide, and they stay so with noise; points in space are right. pypose.module.ICP of a board that is turned by
# .1 radians ends in a wrong pose 11 times of 20. Of two equal fits, a rotation and a mirror image, the latter is taken by chance, and the numbers of
# its quaternion are of neither. roma.rigid_points_registration is right for all 200.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pypose==0.9.5 torch==2.13.0 roma==1.8.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - <<'PROGRAM'
import numpy as np
import pypose
import roma
import torch
from scipy.spatial.transform import Rotation

torch.set_num_threads(1)
print("pypose", pypose.__version__, "torch", torch.__version__)


def scene(k, flat, noise):
    """Points, where a rotation and a translation take them, and the rotation."""
    random = np.random.default_rng(k)
    points = random.uniform(-1, 1, (20, 3)) * [1, 1, 0 if flat else 1]
    pose = Rotation.random(random_state=k)
    return points, pose.apply(points) + [1, 2, 3] + random.normal(0, noise, points.shape), pose.as_matrix()


for name, flat, noise in (("plane", True, 0), ("plane", True, 0.05), ("space", False, 0), ("space", False, 0.05)):
    errors, wrong_by_roma = [], 0
    for k in range(200):
        source, target, rotation = scene(k, flat, noise)
        found = pypose.svdtf(torch.tensor(source), torch.tensor(target))
        if abs(found.matrix().numpy()[:3, :3] - rotation).max() > 0.2:
            off = found.Act(torch.tensor(source)).numpy() - target
            errors.append(np.sqrt((off**2).sum(1).mean()))
        by_roma, _ = roma.rigid_points_registration(torch.tensor(source), torch.tensor(target))
        wrong_by_roma += abs(by_roma.numpy() - rotation).max() > 0.2
    print(f"{name}, noise {noise}: {len(errors)} of 200 poses wrong, {wrong_by_roma} by roma", end="")
    print(f", RMS of the wrong ones {np.mean(errors):.2f}" if errors else "")
    assert wrong_by_roma == 0 and (60 < len(errors) < 120 and np.mean(errors) > 1 if flat else not errors)
board, wrong = scene(0, True, 0)[0], 0
for k in range(20):
    turn = Rotation.from_rotvec(np.random.default_rng(k).normal(0, 0.1, 3))
    target = turn.apply(board) + [0.01, 0.02, 0.03]
    found = pypose.module.ICP()(torch.tensor(board)[None], torch.tensor(target)[None])
    wrong += abs(found.matrix()[0].numpy()[:3, :3] - turn.as_matrix()).max() > 0.1
print(f"ICP of the board, turned a little: {wrong} of 20 poses wrong")
assert wrong >= 5
PROGRAM
