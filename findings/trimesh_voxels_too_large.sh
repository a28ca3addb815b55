#!/usr/bin/env bash
# trimesh 5.2.0: a filled voxel grid is half a voxel too large on every side, and its marching cubes are in voxels instead of the mesh's units.
# Believed: voxelized(pitch).fill() has the voxels inside the mesh, so that its volume is that of the mesh, up to errors that go either way, and
# marching_cubes, "representing the current voxel object", lies where points and as_boxes() do. Seen: every voxel that the surface touches is in: a
# ball of radius 1 has 21% too much volume at a pitch of .1 and 10% at .05, a cube 33% and 16%, but 0 at .2 and 95% at .25, as its
# faces fall into voxels. The marching cubes of a ball around (10, 20, 30) lie from -.5 to 20.5, with a volume of 5018. apply_transform(grid.transform)
# puts them right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet trimesh==5.2.0 scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PROGRAM'
import numpy as np
import trimesh

print("trimesh", trimesh.__version__)
ball, cube = trimesh.creation.icosphere(4), trimesh.creation.box((1, 1, 1))
for name, mesh, expected in (("ball", ball, {0.1: 0.21, 0.05: 0.1}), ("cube", cube, {0.1: 0.33, 0.05: 0.16, 0.2: 0, 0.25: 0.95})):
    for pitch, excess in expected.items():
        grid = mesh.voxelized(pitch).fill()
        seen = grid.volume / mesh.volume - 1
        print(f"{name}, pitch {pitch}: {grid.filled_count} voxels, volume {grid.volume:.3f} of {mesh.volume:.3f}, {seen:+.0%}")
        assert abs(seen - excess) < 0.02

grid = ball.copy().apply_translation((10, 20, 30)).voxelized(0.1).fill()
surface = grid.marching_cubes
placed = surface.copy().apply_transform(grid.transform)
print("points", grid.points.min(0).round(2).tolist(), grid.points.max(0).round(2).tolist(), "volume", round(grid.volume, 2))
for name, mesh in (("as_boxes()", grid.as_boxes()), ("marching_cubes", surface), ("the same with grid.transform", placed)):
    print(name, mesh.bounds.round(2).tolist(), "volume", round(mesh.volume, 2))
assert np.allclose(grid.as_boxes().bounds, [[8.95, 18.95, 28.95], [11.05, 21.05, 31.05]])
assert np.allclose(placed.bounds, grid.as_boxes().bounds)
assert np.allclose(surface.bounds, [[-0.5] * 3, [20.5] * 3]) and np.isclose(surface.volume, 1000 * placed.volume)
PROGRAM
