"""Find the depth of an image by gradient descent on the photometric error of other views, from coarse to fine.

    python examples/depth_estimation.py                    scikit-image's stereo pair of a motorcycle
    python examples/depth_estimation.py --data FOLDER      five views of FOLDER/rgbd_livingroom as well
    python examples/depth_estimation.py --image LEFT RIGHT [--focal PIXELS] [--baseline LENGTH]      your own stereo pair
    python examples/depth_estimation.py --kornia           the same loop with Kornia as well, at the same iterations

The parameter is inverse depth, a number in [0, 1] for each pixel between the far and the near end of the scene. It starts as noise.
SGD with momentum minimizes the weighted sum of the Kornia paper: SSIM and L1 between the image and each warped view, and the
roughness of inverse depth where the image has no edges. Every scene gives a figure with a row for each level. Errors are measured
where the true depth is known: the mean of abs(depth - true) / true, and the fraction of pixels where that is less than 10%.

A new scene needs the range of its depth. `depth_range` derives it from the views: points nearer than its near end would move by
more than a fourth of the width between two views, points beyond its far end by less than a pixel. A narrower range (--near,
--far) helps the descent. Depth outside of it is clamped to half of near and twice of far, and comes out there.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import torch
from torch import Tensor

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

LEVELS, ITERATIONS = 5, 120
RATE, MOMENTUM = 0.001, 0.9
RATE_WIDTH = 160  # pixels; on wider images a step of the same rate overshoots
STRUCTURE, SMOOTHNESS = 0.85, 0.15  # weight of SSIM, the rest being that of L1; weight of roughness
WINDOW = 5  # of SSIM
AGREEMENT = 0.6  # least mean SSIM of an image and the warped view of its pair


@dataclass(frozen=True)
class Scene:
    """An image (1, 3, H, W), V other views, camera matrices (1, 3, 3) and (V, 3, 3), and poses (V, 4, 4) from the frame of the
    image to the views'. `truth` (1, 1, H, W) is the depth of the image, 0 where it is not known.

    All depth is between `near` and `far`. At least `fraction` of the pixels must be correct to 10%.
    """

    name: str
    picture: Tensor
    views: Tensor
    camera: Tensor
    view_cameras: Tensor
    motions: Tensor
    truth: Tensor
    near: float
    far: float
    fraction: float


# --- scenes ---------------------------------------------------------------------------------------------------------


def shrunk(image: Tensor, size: tuple[int, int]) -> Tensor:
    """An image or a batch of them at a smaller size."""
    return image if tuple(image.shape[2:]) == size else K.geometry.resize(image, size, antialias=True)


def at_size(camera: Tensor, before: tuple[int, int], after: tuple[int, int]) -> Tensor:
    """Camera matrices of images that are resized: from edge to edge, so that the middle of the first pixel moves."""
    y, x = (b / a for b, a in zip(after, before))
    scale = torch.tensor([[x, 0, (x - 1) / 2], [0, y, (y - 1) / 2], [0, 0, 1]], device=camera.device)
    return scale @ camera


def motorcycle(device: torch.device, width: int = 320) -> Scene:
    """Two images of the Middlebury stereo data of 2014, of which scikit-image tells the calibration."""
    from skimage import data

    left, right, disparity = data.stereo_motorcycle()
    focal, center, shift, baseline = 994.978, (311.193, 254.877), 31.086, 0.193001
    before = disparity.shape
    size = (round(before[0] * width / before[1]), width)
    camera = torch.tensor([[[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]]])
    other = camera.clone()
    other[:, 0, 2] += shift
    motion = torch.eye(4)[None].clone()
    motion[:, 0, 3] = -baseline
    known = torch.from_numpy(disparity)[None, None]
    known = K.geometry.resize(known, size, interpolation="nearest")
    truth = torch.where(known.isfinite(), K.geometry.depth_from_disparity(known + shift, baseline, focal), 0)
    pictures = [shrunk(K.image_to_tensor(x, keepdim=False).float() / 255, size) for x in (left, right)]
    cameras = (at_size(x, before, size) for x in (camera, other))
    tensors = (x.to(device) for x in (*pictures, *cameras, motion, truth))
    return Scene("motorcycle", *tensors, near=1.5, far=8.0, fraction=0.7)


def livingroom(folder: Path, device: torch.device, width: int = 320) -> Scene:
    """Five views that were rendered a few centimeters apart; the third is the image."""

    def numbers(name: str, rows: int) -> Tensor:
        return torch.tensor([float(x) for x in (folder / name).read_text().split()], dtype=torch.float64).view(rows, -1)

    poses = [numbers(f"pose_{i}.txt", 4) for i in range(5)]
    pictures = torch.stack([K.io.load_image(folder / f"color_{i}.jpg") for i in range(5)])
    before = (pictures.shape[2], pictures.shape[3])
    size = (before[0] * width // before[1], width)
    pictures = shrunk(pictures, size)
    camera = at_size(numbers("intrinsics.txt", 3)[None].float(), before, size)
    depth = K.io.load_image(folder / "depth_2.png", K.io.ImageLoadType.UNCHANGED)[None].float()
    truth = K.geometry.resize(depth, size, interpolation="nearest") / float((folder / "depth_scale.txt").read_text())
    others = [0, 1, 3, 4]
    motions = torch.stack([torch.linalg.inv(poses[i]) @ poses[2] for i in others]).float()
    tensors = (pictures[2:3], pictures[others], camera, camera.expand(4, 3, 3), motions, truth)
    return Scene("livingroom", *(x.to(device) for x in tensors), near=0.5, far=5.0, fraction=0.7)


def depth_range(camera: Tensor, motions: Tensor, width: int) -> tuple[float, float]:
    """Near and far from the focal length and the longest baseline: a parallax of a fourth of the width, and of one pixel."""
    centers = -motions[:, :3, :3].mT @ motions[:, :3, 3:]
    parallax = float(camera[0, 0, 0] * centers.norm(dim=1).max())  # in pixels, of a point at depth 1
    return parallax / (width / 4), parallax


def stereo(
    left: Tensor, right: Tensor, focal: float | None, baseline: float, device: torch.device, width: int
) -> Scene:
    """A rectified pair of images (1, 3, H, W), the second taken `baseline` to the right. Its depth is not known."""
    before = (left.shape[2], left.shape[3])
    size = (round(before[0] * width / before[1]), width)
    focal = 1.2 * before[1] if focal is None else focal
    camera = torch.tensor([[[focal, 0, before[1] / 2], [0, focal, before[0] / 2], [0, 0, 1]]])
    camera = at_size(camera, before, size)
    motion = torch.eye(4)[None].clone()
    motion[:, 0, 3] = -baseline
    near, far = depth_range(camera, motion, width)
    pictures = [shrunk(picture, size) for picture in (left, right)]
    truth = torch.zeros(1, 1, *size)
    tensors = (x.to(device) for x in (*pictures, camera, camera, motion, truth))
    return Scene("stereo", *tensors, near=near, far=far, fraction=0.0)


# --- descent --------------------------------------------------------------------------------------------------------


def sizes(scene: Scene, levels: int) -> list[tuple[int, int]]:
    """Those of the levels, from coarse to fine."""
    h, w = scene.picture.shape[2:]
    return [(h >> k, w >> k) for k in reversed(range(levels))]


def warper_of(scene: Scene, size: tuple[int, int], library: ModuleType) -> Callable[[Tensor, Tensor], Tensor]:
    """A function of depth (1, 1, h, w) and the views at that size that warps the views to the camera of the image."""
    before = tuple(scene.picture.shape[2:])
    count = len(scene.views)
    height, width = (torch.full((count,), float(n), device=scene.views.device) for n in size)

    def camera(matrix: Tensor, pose: Tensor):
        intrinsics = torch.eye(4, device=matrix.device).repeat(count, 1, 1)
        intrinsics[:, :3, :3] = at_size(matrix, before, size)
        return library.geometry.PinholeCamera(intrinsics, pose, height, width)

    here = camera(scene.camera, torch.eye(4, device=scene.views.device).repeat(count, 1, 1))
    there = camera(scene.view_cameras, scene.motions)
    warper = library.geometry.DepthWarper(there, *size, padding_mode="border").compute_projection_matrix(here)
    return lambda depth, views: warper(depth.expand(count, -1, -1, -1), views)


def depth_of(scene: Scene, inverse_depth: Tensor) -> Tensor:
    """Depth from inverse depth in [0, 1], clamped a little outside of this range."""
    far, near = 1 / scene.far, 1 / scene.near
    return 1 / (far + inverse_depth * (near - far)).clamp(0.5 * far, 2 * near)


def objective(picture: Tensor, warped: Tensor, inverse_depth: Tensor, library: ModuleType) -> Tensor:
    """The paper's weighted sum."""
    pictures = picture.expand_as(warped)
    structure = (1 - library.metrics.ssim(pictures, warped, WINDOW)).mean() / 2
    difference = (pictures - warped).abs().mean()
    roughness = library.losses.inverse_depth_smoothness_loss(inverse_depth / inverse_depth.mean().detach(), picture)
    return STRUCTURE * structure + (1 - STRUCTURE) * difference + SMOOTHNESS * roughness


def descend(
    scene: Scene, iterations: int, levels: int, library: ModuleType = K, step: Callable[[], object] = lambda: None
) -> Iterator[tuple[Tensor, Tensor]]:
    """Depth, and the views warped by it, after each level. `step` is called after each iteration."""
    generator = torch.Generator().manual_seed(0)
    inverse_depth = torch.rand(1, 1, *sizes(scene, levels)[0], generator=generator).to(scene.picture.device)
    for size in sizes(scene, levels):
        picture, views = shrunk(scene.picture, size), shrunk(scene.views, size)
        warp = warper_of(scene, size, library)
        inverse_depth = K.geometry.resize(inverse_depth, size).detach().requires_grad_()
        # The objective is a mean over pixels. A change of inverse depth moves a pixel by a fraction of the width, so that the
        # curvature of the objective grows with the square of the width.
        rate = RATE * inverse_depth.numel() * min(1, RATE_WIDTH / size[1]) ** 2
        optimizer = torch.optim.SGD([inverse_depth], rate, MOMENTUM)
        for _ in range(iterations):
            optimizer.zero_grad()
            objective(picture, warp(depth_of(scene, inverse_depth), views), inverse_depth, library).backward()
            optimizer.step()
            step()
        depth = depth_of(scene, inverse_depth.detach())
        yield depth, warp(depth, views)


# --- what came of it ------------------------------------------------------------------------------------------------


def errors(scene: Scene, depth: Tensor) -> Tensor:
    """abs(depth - true) / true, NaN where the truth is not known."""
    depth = K.geometry.resize(depth, tuple(scene.truth.shape[2:]))
    return torch.where(scene.truth > 0, (depth - scene.truth).abs() / scene.truth, torch.nan)


def quality(error: Tensor) -> tuple[float, float]:
    """Mean error, fraction of pixels within 10%."""
    known = error[error.isfinite()]
    return float(known.mean()), float((known < 0.1).float().mean())


def agreement(scene: Scene, warped: Tensor) -> float:
    """Mean structural similarity of the image and the views warped by its depth; 1 where they are equal."""
    return float(K.metrics.ssim(scene.picture.expand_as(warped), warped, WINDOW).mean())


def limits(scene: Scene, error: Tensor) -> str:
    """Where depth is wrong: without texture nothing tells it, and at depth edges some view does not see it."""
    edges = K.filters.sobel(K.color.rgb_to_grayscale(scene.picture))
    around = torch.ones(7, 7, device=error.device)
    furthest = K.morphology.dilation(scene.truth, around)
    nearest = K.morphology.erosion(torch.where(scene.truth > 0, scene.truth, torch.inf), around)
    near_jump = furthest - nearest > 0.15 * furthest
    plain = (edges < edges.median()) & ~near_jump
    kinds = {"at edges of depth": near_jump, "without texture": plain, "elsewhere": ~plain & ~near_jump}
    return ", ".join(
        f"{quality(error[mask])[1]:.0%} {name} ({mask.float().mean():.0%})" for name, mask in kinds.items()
    )


def draw(scene: Scene, levels: list[tuple[Tensor, Tensor]], path: Path) -> None:
    import matplotlib.pyplot as plt

    shown = min(2, len(scene.views))
    figure, axes = plt.subplots(len(levels) + 1, shown + 3, figsize=(3 * (shown + 3), 2.4 * (len(levels) + 1)))
    range_of_depth = {"cmap": "viridis", "vmin": scene.near, "vmax": min(scene.far, float(scene.truth.max()) * 1.1)}
    if not (scene.truth > 0).any():
        range_of_depth["vmax"] = float(levels[-1][0].quantile(0.95))

    def show(axis, image: Tensor, title: str, **options) -> None:
        pixels = image[0].permute(1, 2, 0).squeeze(-1).cpu()
        axis.imshow(pixels if options else pixels.clamp(0, 1), **options)
        axis.set_title(title, fontsize=9)

    pictures = [(scene.picture, "picture"), *((v[None], "view") for v in scene.views[:shown])]
    for axis, (image, title) in zip(axes[0], pictures):
        show(axis, image, title)
    show(axes[0, shown + 1], scene.truth, "true depth", **range_of_depth)
    for row, (depth, warped) in zip(axes[1:], levels):
        error = errors(scene, depth)
        mean, fraction = quality(error)
        for i in range(shown):
            show(row[i], warped[i : i + 1], "view, warped")
        show(
            row[shown], (warped.mean(0, keepdim=True) - shrunk(scene.picture, tuple(warped.shape[2:]))).abs() * 4, "x 4"
        )
        show(row[shown + 1], depth, f"depth, error {mean:.1%}", **range_of_depth)
        show(row[shown + 2], error, f"error, {fraction:.0%} within 10%", cmap="magma", vmin=0, vmax=0.3)
    for axis in axes.flat:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def estimate(
    scene: Scene, iterations: int, levels: int, library: ModuleType
) -> tuple[list[tuple[Tensor, Tensor]], float]:
    """What `descend` gives, and the seconds it took."""
    from tqdm import tqdm

    begin = time.perf_counter()
    with tqdm(total=iterations * levels, desc=f"{scene.name}, {library.__name__}", unit="step", leave=False) as bar:
        estimates = list(descend(scene, iterations, levels, library, bar.update))
    if scene.picture.is_cuda:
        torch.cuda.synchronize()
    return estimates, time.perf_counter() - begin


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with rgbd_livingroom")
    parser.add_argument("--iterations", type=int, default=ITERATIONS, help="on each level")
    parser.add_argument("--levels", type=int, default=LEVELS)
    parser.add_argument("--width", type=int, default=320, help="of the images")
    parser.add_argument(
        "--image", type=Path, nargs=2, default=[], metavar=("LEFT", "RIGHT"), help="your own rectified stereo pair"
    )
    parser.add_argument("--focal", type=float, help="of --image, in pixels; default: 1.2 times the width")
    parser.add_argument("--baseline", type=float, default=1.0, help="of --image, in the unit of the depth; default: 1")
    parser.add_argument("--near", type=float, help="least depth; default: known, or from the views")
    parser.add_argument("--far", type=float, help="largest depth")
    parser.add_argument("--kornia", action="store_true", help="run Kornia, too")
    parser.add_argument("--out", type=Path, default=Path("out/depth"), help="where the figures go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.data and not (options.data / "rgbd_livingroom").is_dir():
        parser.error(f"--data {options.data}: expected a folder with rgbd_livingroom, there is none")
    own = images_of(parser, options.image)
    if own and own[0].shape != own[1].shape:
        parser.error(
            f"--image: expected two images of one size, got {tuple(own[0].shape[2:])} and {tuple(own[1].shape[2:])}"
        )
    require(parser, "matplotlib", "tqdm", *(() if own else ("skimage",)), *(("kornia",) if options.kornia else ()))
    make_folder(parser, options.out)
    if own:
        scenes = [stereo(*own, options.focal, options.baseline, device, options.width)]
    else:
        scenes = [motorcycle(device, options.width)]
    if options.data:
        scenes.append(livingroom(options.data / "rgbd_livingroom", device, options.width))
    chosen = {name: value for name in ("near", "far") if (value := getattr(options, name)) is not None}
    scenes = [replace(scene, **chosen) for scene in scenes]
    for scene in scenes:
        if not 0 < scene.near < scene.far:
            parser.error(f"--near, --far: expected 0 < near < far, got {scene.near:.3g} and {scene.far:.3g}")
    libraries = [K]
    if options.kornia:
        import kornia

        libraries.append(kornia)
    missed = 0
    for scene in scenes:
        if not (scene.truth > 0).any():
            estimates, seconds = estimate(scene, options.iterations, options.levels, K)
            depth = estimates[-1][0]
            middle = float(depth.median())
            print(
                f"{scene.name}: depth from {float(depth.min()):.3g} to {float(depth.max()):.3g}, median {middle:.3g}",
                end="; ",
            )
            print(f"searched from {scene.near:.3g} to {scene.far:.3g}; {seconds:.1f} s")
            draw(scene, estimates, options.out / f"{scene.name}.png")
            if (similarity := agreement(scene, estimates[-1][1])) < AGREEMENT:
                missed += 1
                print(
                    f"{scene.name}: similarity of the warped view {similarity:.2f}, less than {AGREEMENT:g}: "
                    "no depth relates these images"
                )
            continue
        constant = depth_of(scene, torch.full_like(scene.truth, 0.5))
        print(
            "{:11} {:10} error {:6.1%}, within 10% {:4.0%}".format(
                scene.name, "constant", *quality(errors(scene, constant))
            )
        )
        for library in libraries:
            levels, seconds = estimate(scene, options.iterations, options.levels, library)
            error = errors(scene, levels[-1][0])
            mean, fraction = quality(error)
            steps = options.iterations * options.levels
            print(
                f"{scene.name:11} {library.__name__:10} error {mean:6.1%}, within 10% {fraction:4.0%}: {limits(scene, error)}; "
                f"{seconds:.1f} s, {1000 * seconds / steps:.2f} ms a step"
            )
            if library is K:
                missed += fraction < scene.fraction
                draw(scene, levels, options.out / f"{scene.name}.png")
    print(f"figures are in {options.out}")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
