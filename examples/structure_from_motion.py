"""Find cameras and a cloud of points from photographs of a scene.

    python examples/structure_from_motion.py                                   renders eight views of a corner of a room
    python examples/structure_from_motion.py --data FOLDER                     FOLDER/rgbd_livingroom, whose poses are known
    python examples/structure_from_motion.py --image A.jpg B.jpg ... --focal 1200    your photographs, in their order

SIFT features; matches of all pairs that agree on an essential matrix; one pair to begin with; further cameras by the known
points that they see (PnP); new points by triangulation; bundle adjustment of all. Scale is free: the first two cameras are
about 1 apart. Writes points with their colors (cloud.ply) and a figure; prints errors of rotations where the truth is known.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require
from kvision.geometry.liegroup import Se3
from kvision.geometry.optim import ReprojectionError, least_squares

FEATURES = 4000
RATIO = 0.85  # of the distances to the nearest and the second descriptor
INLIER = 1.5  # pixels from the epipolar line
LEAST = 20  # matches of a pair that sees the same, and points of a camera
ERROR = 3.0  # pixels: observations further off are dropped
ANGLE = 0.7  # degrees between the rays of a point, at least


@dataclass
class Photographs:
    """Images (V, 3, H, W), the camera matrix (3, 3) of all, and where they are known, poses (V, 4, 4) from world to camera."""

    images: Tensor
    camera: Tensor
    truth: Tensor | None = None


@dataclass
class Scene:
    """Observations of points in views, and what has been found of both; NaN where nothing has."""

    camera: Tensor  # (3, 3)
    view: Tensor  # (M,)
    point: Tensor  # (M,)
    pixels: Tensor  # (M, 2)
    poses: Tensor  # (V, 4, 4), from world to camera
    points: Tensor  # (N, 3)

    def has_view(self) -> Tensor:
        """Which observations are of a view whose pose is known."""
        return self.poses[self.view, 0, 0].isfinite()

    def known(self) -> Tensor:
        """Which observations are of a known point in a known view."""
        return self.has_view() & self.points[self.point, 0].isfinite()

    def errors(self) -> Tensor:
        """Distances (M,) of observations from where the points are seen, infinite behind the camera."""
        in_camera = K.geometry.transform_points(self.poses[self.view], self.points[self.point][:, None])
        seen, in_front = K.geometry.project_points(in_camera[:, 0], self.camera, return_valid=True)
        return torch.where(in_front, (seen - self.pixels).norm(dim=-1), torch.inf)


# --- photographs ----------------------------------------------------------------------------------------------------


def room(device: torch.device, views: int = 8, size: tuple[int, int] = (360, 480)) -> Photographs:
    """A floor and two walls with photographs on them, seen from an arc."""
    from skimage import data

    names = ("coffee", "astronaut", "chelsea")  # on x = 0, y = 0, z = 0, each 2 wide
    walls = [K.image_to_tensor(getattr(data, name)(), keepdim=False).float().to(device) / 255 for name in names]
    height, width = size
    camera = torch.tensor(
        [[1.1 * width, 0, (width - 1) / 2], [0, 1.1 * width, (height - 1) / 2], [0, 0, 1]], device=device
    )
    angle = torch.linspace(0.5, 1.0, views, device=device)
    eyes = torch.stack([4.2 * angle.cos(), 4.2 * angle.sin(), 2.0 + 0.5 * (4 * angle).sin()], -1)
    target = eyes.new_tensor([0.9, 0.9, 0.7])
    front = torch.nn.functional.normalize(target - eyes, dim=-1)
    right = torch.nn.functional.normalize(
        torch.linalg.cross(front, eyes.new_tensor([[0.0, 0, 1]]).expand_as(front)), dim=-1
    )
    R = torch.stack([right, torch.linalg.cross(front, right), front], 1)
    truth = K.geometry.Rt_to_matrix4x4(R, -R @ eyes[..., None])
    grid = K.create_meshgrid(height, width, normalized_coordinates=False, device=device)[0]
    rays = K.geometry.camera.undistort_points_affine(grid, camera[[0, 1, 0, 1], [0, 1, 2, 2]])
    rays = torch.nn.functional.pad(rays, (0, 1), value=1.0)
    images = []
    for eye, rotation in zip(eyes, R):
        direction = rays @ rotation
        distance = -eye / direction  # to each of the planes (H, W, 3)
        distance = torch.where(distance > 0, distance, torch.inf)
        image = torch.zeros(3, height, width, device=device)
        for axis, wall in enumerate(walls):
            point = eye + distance[..., axis, None] * direction
            u, v = (point[..., i] / 2 for i in range(3) if i != axis)
            x, y = u * (wall.shape[-1] - 1), (1 - v) * (wall.shape[-2] - 1)
            seen = K.geometry.remap(wall, x[None].nan_to_num(-1), y[None].nan_to_num(-1), align_corners=True)[0]
            image = torch.where((u >= 0) & (u <= 1) & (v >= 0) & (v <= 1), seen, image)
        images.append(image)
    generator = torch.Generator().manual_seed(0)
    noise = 0.01 * torch.randn(views, 3, height, width, generator=generator).to(device)
    return Photographs((torch.stack(images) + noise).clamp(0, 1), camera, truth)


def living_room(folder: Path, device: torch.device) -> Photographs:
    def numbers(name: str, *shape: int) -> Tensor:
        return torch.tensor([float(x) for x in (folder / name).read_text().split()], device=device).reshape(shape)

    count = len(list(folder.glob("color_*.jpg")))
    images = torch.cat([K.io.load_image(folder / f"color_{i}.jpg")[None] for i in range(count)]).to(device)
    poses = torch.stack([numbers(f"pose_{i}.txt", 4, 4) for i in range(count)])
    return Photographs(images, numbers("intrinsics.txt", 3, 3), K.geometry.inverse_transformation(poses))


# --- matches and tracks ---------------------------------------------------------------------------------------------


def matched(photographs: Photographs) -> tuple[list[Tensor], dict[tuple[int, int], Tensor]]:
    """Pixels (N, 2) of the features of each image, and for pairs of images matches (K, 2) that agree on an essential matrix."""
    features = K.feature.SIFTFeature(FEATURES, upright=True, device=photographs.images.device)
    pixels, descriptors = [], []
    for image in K.rgb_to_grayscale(photographs.images):
        frames, responses, found = features(image[None])
        at = K.feature.get_laf_center(frames)[0]
        pixels.append(at[responses[0] > 0])
        descriptors.append(found[0][responses[0] > 0])
    focal = photographs.camera[[0, 1], [0, 1]].mean()
    ransac = K.geometry.RANSAC("essential", inl_th=float(INLIER / focal), confidence=0.9999, seed=0)
    pairs = {}
    for i, j in combinations(range(len(pixels)), 2):
        _, match = K.feature.match_smnn(descriptors[i], descriptors[j], RATIO)
        if len(match) >= LEAST:
            plane = [on_plane(pixels[k][match[:, side]], photographs.camera) for side, k in enumerate((i, j))]
            _, inliers = ransac(*plane)
            if int(inliers.sum()) >= LEAST:
                pairs[i, j] = match[inliers]
    return pixels, pairs


def on_plane(pixels: Tensor, camera: Tensor) -> Tensor:
    return K.geometry.camera.undistort_points_affine(pixels, camera[[0, 1, 0, 1], [0, 1, 2, 2]])


def tracks(pixels: list[Tensor], pairs: dict[tuple[int, int], Tensor], camera: Tensor) -> Scene:
    """Features that match each other are one point, unless an image has two of them."""
    root = {(view, k): (view, k) for view, at in enumerate(pixels) for k in range(len(at))}

    def find(feature: tuple[int, int]) -> tuple[int, int]:
        while root[feature] != feature:
            root[feature] = root[root[feature]]
            feature = root[feature]
        return feature

    for (i, j), match in pairs.items():
        for a, b in match.tolist():
            root[find((i, a))] = find((j, b))
    members: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for feature in root:
        members.setdefault(find(feature), []).append(feature)
    kept = [track for track in members.values() if len(track) == len({view for view, _ in track}) > 1]
    rows = [(view, k, point) for point, track in enumerate(kept) for view, k in track]
    view, k, point = torch.tensor(rows, device=camera.device).reshape(-1, 3).unbind(-1)
    starts = torch.tensor([0, *(len(at) for at in pixels)], device=camera.device).cumsum(0)
    camera, unknown = camera.double(), torch.nan
    poses = camera.new_full((len(pixels), 4, 4), unknown)
    return Scene(
        camera,
        view,
        point,
        torch.cat(pixels)[starts[view] + k].double(),
        poses,
        camera.new_full((len(kept), 3), unknown),
    )


# --- cameras and points ---------------------------------------------------------------------------------------------


def begin(scene: Scene) -> None:
    """Poses of two views that share many points under large angles."""
    best, focal = 0.0, scene.camera[0, 0]
    for i, j in combinations(range(len(scene.poses)), 2):
        a, b = (
            torch.full_like(scene.points[:, 0], -1).long().index_put_((scene.point[m],), m)
            for m in ((scene.view == v).nonzero()[:, 0] for v in (i, j))
        )
        both = (a >= 0) & (b >= 0)
        if int(both.sum()) < LEAST:
            continue
        x1, x2 = scene.pixels[a[both]], scene.pixels[b[both]]
        essential, inliers = K.geometry.RANSAC("essential", inl_th=float(INLIER / focal), seed=0)(
            on_plane(x1, scene.camera), on_plane(x2, scene.camera)
        )
        R, t, X, _ = K.geometry.motion_from_essential_choose_solution(
            essential, scene.camera, scene.camera, x1, x2, inliers
        )
        center = -(R.mT @ t)[:, 0]
        angles = degrees_between(X, X - center)[inliers]
        score = float(inliers.sum() * angles.nanmedian().clamp(max=5.0))
        if score > best:
            best = score
            scene.poses.fill_(torch.nan)
            scene.poses[i] = torch.eye(4, device=R.device)
            scene.poses[j] = K.geometry.Rt_to_matrix4x4(R[None], t[None])[0]
    if not best:
        raise SystemExit("structure_from_motion: no two photographs see the same from different positions")


def degrees_between(a: Tensor, b: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(torch.linalg.cross(a, b).norm(dim=-1), (a * b).sum(-1)))


def triangulate(scene: Scene) -> None:
    """Points that two known views see, from those furthest apart."""
    new = scene.has_view() & scene.points[scene.point, 0].isnan()
    R, t = scene.poses[:, :3, :3], scene.poses[:, :3, 3:]
    centers = -(R.mT @ t)[..., 0]
    known = centers[centers[:, 0].isfinite()]
    along = ((centers - known.mean(0)) @ torch.linalg.svd(known - known.mean(0)).Vh[0])[scene.view]
    ends = []
    for sign in (1.0, -1.0):
        value = along.new_full((len(scene.points),), -torch.inf)
        value.scatter_reduce_(0, scene.point[new], sign * along[new], "amax")
        row = torch.full((len(scene.points),), -1, device=along.device)
        at_end = new & (sign * along == value[scene.point])
        row[scene.point[at_end]] = at_end.nonzero()[:, 0]
        ends.append(row)
    point = ((ends[0] >= 0) & (ends[0] != ends[1])).nonzero()[:, 0]
    first, second = (end[point] for end in ends)
    P = scene.camera @ scene.poses[:, :3]
    X = K.geometry.triangulate_points(
        P[scene.view[first]], P[scene.view[second]], scene.pixels[first, None], scene.pixels[second, None]
    )[:, 0]
    apart = degrees_between(X - centers[scene.view[first]], X - centers[scene.view[second]]) > ANGLE
    scene.points[point] = torch.where(apart[:, None], X, torch.nan)
    drop(scene)


def drop(scene: Scene) -> None:
    """Forget observations that are off, and points that fewer than two views see."""
    off = scene.known() & ~(scene.errors() < ERROR)
    keep = ~off
    scene.view, scene.point, scene.pixels = scene.view[keep], scene.point[keep], scene.pixels[keep]
    count = torch.bincount(scene.point[scene.has_view()], minlength=len(scene.points))
    scene.points[count < 2] = torch.nan


def bundle(scene: Scene) -> float:
    """Move all known poses and points to the least reprojection error; the root mean square of what is left."""
    rows = scene.known().nonzero()[:, 0]
    views, pose_of = scene.view[rows].unique(return_inverse=True)
    points, point_of = scene.point[rows].unique(return_inverse=True)
    fit = least_squares(
        ReprojectionError(scene.pixels[None, rows], scene.camera),
        {"pose": Se3.from_matrix(scene.poses[None, views]), "points": scene.points[None, points]},
        loss="huber",
        index={"pose": pose_of, "points": point_of},
        eliminate="points",
        max_iterations=30,
        gradient="none",
    )
    scene.poses[views] = fit.variables["pose"].matrix()[0].detach()
    scene.points[points] = fit.variables["points"][0].detach()
    drop(scene)
    return scene.errors()[scene.known()].square().mean().sqrt().item()


def add_view(scene: Scene) -> bool:
    """The pose of the view that sees most of the known points; False if none sees enough."""
    useful = ~scene.has_view() & scene.points[scene.point, 0].isfinite()
    count = torch.bincount(scene.view[useful], minlength=len(scene.poses))
    if int(count.max()) < LEAST:
        return False
    view = int(count.argmax())
    rows = useful & (scene.view == view)
    pose, valid = K.geometry.solve_pnp(
        scene.points[None, scene.point[rows]], scene.pixels[None, rows], scene.camera[None], loss="cauchy"
    )
    if not valid.item():
        return False
    scene.poses[view] = pose.matrix()[0].detach()
    return True


def reconstruct(photographs: Photographs) -> Scene:
    pixels, pairs = matched(photographs)
    print(f"{len(pixels)} photographs, {sum(map(len, pixels))} features, {len(pairs)} pairs that see the same")
    scene = tracks(pixels, pairs, photographs.camera)
    begin(scene)
    while True:
        triangulate(scene)
        rms = bundle(scene)
        count = int(scene.poses[:, 0, 0].isfinite().sum())
        print(f"{count:3} cameras {int(scene.points[:, 0].isfinite().sum()):6} points, rms {rms:.3f} pixels")
        if not add_view(scene):
            return scene


# --- results --------------------------------------------------------------------------------------------------------


def rotation_errors(scene: Scene, truth: Tensor) -> Tensor:
    """Degrees between found and true rotations from the first known camera to each other one."""
    known = scene.poses[:, 0, 0].isfinite()
    found, true = (poses[known, :3, :3].double() for poses in (scene.poses, truth.to(scene.poses)))
    found, true = (R[1:] @ R[0].mT for R in (found, true))
    return K.metrics.angle_error_mat(found, true)


def colors(scene: Scene, images: Tensor) -> Tensor:
    """The mean color (N, 3) of where points are seen."""
    x, y = scene.pixels.round().long().unbind(-1)
    seen = images[scene.view, :, y.clamp(0, images.shape[2] - 1), x.clamp(0, images.shape[3] - 1)]
    total = seen.new_zeros(len(scene.points), 4).index_add(
        0, scene.point, torch.nn.functional.pad(seen, (0, 1), value=1.0)
    )
    return total[:, :3] / total[:, 3:]


def figure(scene: Scene, images: Tensor, rgb: Tensor, path: Path) -> None:
    import matplotlib.pyplot as plt

    known = scene.points[:, 0].isfinite()
    points, rgb = scene.points[known].cpu(), rgb[known].cpu().clamp(0, 1)
    first = int(scene.poses[:, 0, 0].isfinite().nonzero()[0])
    rows = scene.known() & (scene.view == first)
    picture = plt.figure(figsize=(13, 5))
    axis = picture.add_subplot(1, 2, 1, title="one photograph, and the points that it sees")
    axis.imshow(images[first].permute(1, 2, 0).cpu())
    axis.plot(*scene.pixels[rows].cpu().T, "r.", markersize=2)
    axis.set_axis_off()
    axis = picture.add_subplot(1, 2, 2, projection="3d", title="points and cameras")
    axis.scatter(points[:, 0], points[:, 2], -points[:, 1], c=rgb.numpy(), s=2)
    poses = scene.poses[scene.poses[:, 0, 0].isfinite()].cpu()
    centers = -(poses[:, :3, :3].mT @ poses[:, :3, 3:])[..., 0]
    axis.plot(centers[:, 0], centers[:, 2], -centers[:, 1], "r^-")
    low = torch.minimum(points.quantile(0.02, 0), centers.amin(0))
    high = torch.maximum(points.quantile(0.98, 0), centers.amax(0))
    axis.set(
        xlim=(low[0], high[0]),
        ylim=(low[2], high[2]),
        zlim=(-high[1], -low[1]),
        box_aspect=(high - low)[[0, 2, 1]].tolist(),
    )
    picture.savefig(path, bbox_inches="tight")
    plt.close(picture)


def main(arguments: list[str] | None = None) -> tuple[Scene, Tensor | None]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--image", nargs="+", type=Path, help="photographs of one size, in the order of their positions"
    )
    parser.add_argument(
        "--focal", type=float, help="their focal length in pixels; default: 1.2 times their longer side"
    )
    parser.add_argument("--data", type=Path, help="a folder that has rgbd_livingroom")
    parser.add_argument("--out", type=Path, default=Path("out/structure_from_motion"), help="where the results go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.data and not (options.data / "rgbd_livingroom").is_dir():
        parser.error(f"--data {options.data}: expected a folder with rgbd_livingroom, there is none")
    require(parser, "matplotlib", *([] if options.image or options.data else ["skimage"]))
    make_folder(parser, options.out)
    if options.image:
        images = images_of(parser, options.image)
        if len({image.shape for image in images}) > 1 or len(images) < 2:
            parser.error("--image: expected two or more photographs of one size")
        height, width = images[0].shape[2:]
        focal = options.focal or 1.2 * max(height, width)
        camera = torch.tensor([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]], device=device)
        photographs = Photographs(torch.cat(images).to(device), camera)
    elif options.data:
        photographs = living_room(options.data / "rgbd_livingroom", device)
    else:
        photographs = room(device)
    scene = reconstruct(photographs)
    rgb, known = colors(scene, photographs.images), scene.points[:, 0].isfinite()
    K.geometry.save_pointcloud_ply_binary(options.out / "cloud.ply", scene.points[known], rgb[known])
    figure(scene, photographs.images, rgb, options.out / "structure_from_motion.png")
    errors = None
    if photographs.truth is not None:
        errors = rotation_errors(scene, photographs.truth)
        print(f"rotations: median error {errors.median():.3f} degrees, largest {errors.max():.3f}")
    print(f"points and figure are in {options.out}")
    return scene, errors


if __name__ == "__main__":
    main()
