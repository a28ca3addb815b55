"""Change two photographs that do not match a little, so that they match under a homography of our choice.

    python examples/attack_on_matching.py                           two of scikit-image's photographs
    python examples/attack_on_matching.py --data FOLDER             FOLDER/a.png and b.png
    python examples/attack_on_matching.py --height 512 --features 2500

The targeted attack of the Kornia paper. Both images are optimized by Adam through the Hessian detector with soft maxima,
the patches and their SIFT descriptors. A target is a frame of one image and its counterpart under the wanted homography
in the other. The loss of all targets is

    location + alpha * descriptors + beta * distance

Location asks that the soft maximum of the response around a target is at the target, and among the strongest of the image.
The descriptors of both frames of a target are to be nearer to each other than half their distance to the nearest other
descriptor. The distance from the originals is limited, too: after each step the changes are scaled down to the wanted PSNR.

Frames are upright: an orientation is the largest bin of a histogram, and no derivative says how to change which bin it is.

Success is counted from images that are rounded to 8 bits: features detected afresh, matches that pass the ratio test at .8,
inliers of RANSAC at 4 pixels which are within 4 pixels of the wanted homography as well. The exit status is 1 if a seed has
fewer than 100 inliers or a PSNR below 28 dB.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

PATCH = 32
SCALE = 6.0  # of a frame, over the blur of its level
WINDOW = 2  # pixels of a level around a target in which its response is to be the largest
RATIO, LIMIT = 0.8, 4.0  # of the ratio test, and pixels of an inlier
WANTED_INLIERS, WANTED_PSNR = 100, 28.0
ITERATIONS, ALPHA, BETA = 100, 3.0, 0.1


class Features(NamedTuple):
    points: Tensor  # (N, 2)
    descriptors: Tensor  # (N, 128)
    responses: Tensor  # (N,)


class Targets(NamedTuple):
    """Frames (1, N, 2, 3) of an image, and the windows (n, 3 * 5 * 5) of the responses of its octaves around them."""

    frames: Tensor
    windows: list[Tensor]


class Outcome(NamedTuple):
    first: Tensor  # (1, 1, H, W), rounded to 8 bits
    second: Tensor
    points: tuple[Tensor, Tensor]  # of the inliers
    matches: int
    psnr: tuple[float, float]
    seconds: float  # of an iteration

    @property
    def inliers(self) -> int:
        return len(self.points[0])

    @property
    def success(self) -> bool:
        return self.inliers >= WANTED_INLIERS and min(self.psnr) >= WANTED_PSNR


# --- images and homographies --------------------------------------------------------------------------------------


def pictures(originals: list[Tensor], height: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Two photographs, those of scikit-image unless some are given, in gray: (1, 1, height, 4 / 3 height)."""
    both = originals
    if not both:
        from skimage import data

        both = [K.image_to_tensor(x, keepdim=False).float() / 255 for x in (data.chelsea(), data.hubble_deep_field())]
    size = (height, height * 4 // 3)
    first, second = (K.color.rgb_to_grayscale(x.to(device)) for x in both)
    return cropped(first, size), cropped(second, size)


def cropped(image: Tensor, size: tuple[int, int]) -> Tensor:
    """The middle of an image in another size, without stretching it."""
    h, w = image.shape[2:]
    width = min(w, h * size[1] // size[0])
    height = min(h, width * size[0] // size[1])
    y, x = (h - height) // 2, (w - width) // 2
    return K.geometry.resize(image[..., y : y + height, x : x + width], size, antialias=True)


def wanted_homography(seed: int, like: Tensor) -> Tensor:
    """A turn by 15 to 25 degrees, a scale of 1.2 to 1.35 and some perspective about the center, (1, 3, 3)."""
    h, w = like.shape[2:]
    u = torch.rand(5, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    angle, scale = math.radians(15 + 10 * u[0]) * (1 if u[1] < 0.5 else -1), 1.2 + 0.15 * u[2]
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    about_center = torch.tensor([[1, 0, -(w - 1) / 2], [0, 1, -(h - 1) / 2], [0, 0, 1]], dtype=torch.float64)
    px, py = 0.3 * (2 * u[3] - 1) / w, 0.3 * (2 * u[4] - 1) / h
    change = torch.tensor([[c, -s, 0], [s, c, 0], [px, py, 1]], dtype=torch.float64)
    return (torch.linalg.inv(about_center) @ change @ about_center)[None].to(like)


# --- features -------------------------------------------------------------------------------------------------------


class Extractor(nn.Module):
    """Hessian detector with soft maxima, upright frames, SIFT."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.count = count
        self.pyramid = K.ScalePyramid(3, 1.6, 16, extra_levels=2)
        self.response = K.BlobHessian()
        soft_maxima = K.geometry.ConvSoftArgmax3d((3, 3, 3), (1, 1, 1), (1, 1, 1), normalized_coordinates=False)
        self.detector = K.ScaleSpaceDetector(
            count, SCALE, self.pyramid, resp_module=self.response, subpix_module=soft_maxima
        )
        self.descriptor = K.feature.SIFTDescriptor(PATCH, rootsift=True)

    def responses(self, image: Tensor) -> list[Tensor]:
        """The responses (L, H, W) of all octaves."""
        octaves, sigmas, _ = self.pyramid(image)
        return [self.response(o[0, 0, :, None], s[0])[:, 0] for o, s in zip(octaves, sigmas)]

    def describe(self, image: Tensor, frames: Tensor) -> Tensor:
        return self.descriptor(K.extract_patches_from_pyramid(image, frames, PATCH)[0])

    @torch.no_grad()
    def forward(self, image: Tensor) -> tuple[Tensor, Features]:
        """Frames (1, N, 2, 3) and features of an image, without empty slots."""
        frames, responses = self.detector(image)
        frames, responses = frames[:, responses[0] > 0], responses[0, responses[0] > 0]
        return frames, Features(frames[0, :, :, 2], self.describe(image, frames), responses)


# --- targets --------------------------------------------------------------------------------------------------------


def upright(frames: Tensor) -> Tensor:
    return K.feature.laf_from_center_scale_ori(K.feature.get_laf_center(frames), K.feature.get_laf_scale(frames))


def place_targets(
    extractor: Extractor, first: Tensor, second: Tensor, homography: Tensor, count: int
) -> tuple[Targets, Targets]:
    """Features of either image with their counterparts in the other one.

    First come those of which one image has little contrast: there the other's content takes the least change. Targets
    keep a distance of 5 / 6 of their scale.
    """
    move = K.feature.perspective_transform_lafs
    of_first, of_second = (extractor(image)[0] for image in (first, second))
    a = upright(torch.cat([of_first, move(torch.linalg.inv(homography), of_second)], 1))
    b = upright(move(homography, a))
    h, w = first.shape[2:]
    inside = torch.ones_like(a[0, :, 0, 0], dtype=torch.bool)
    contrasts = []
    for image, frames in ((first, a), (second, b)):
        x, y, scale = frames[0, :, 0, 2], frames[0, :, 1, 2], frames[0, :, 0, 0]
        margin = 0.6 * scale + 4
        inside &= (x > margin) & (y > margin) & (x < w - 1 - margin) & (y < h - 1 - margin)
        inside &= (scale > SCALE * 1.7) & (scale < SCALE * 1.6 * 3)
        contrasts.append(K.extract_patches_from_pyramid(image, frames, PATCH)[0].flatten(1).std(1))
    cost = torch.where(inside, torch.minimum(*contrasts), math.inf).cpu()
    points, scales = a[0, :, :, 2].cpu(), a[0, :, 0, 0].cpu()
    chosen: list[int] = []
    for i in cost.argsort().tolist():
        if len(chosen) == count or cost[i] == math.inf:
            break
        others = torch.tensor(chosen, dtype=torch.long)
        min_distance = 5 / SCALE * (scales[i] * scales[others]).sqrt()
        if bool(((points[i] - points[others]).norm(dim=1) > min_distance).all()):
            chosen.append(i)
    index = torch.tensor(chosen, device=a.device)
    shapes = [response.shape for response in extractor.responses(first)]
    return tuple(Targets(x[:, index], windows_of(x[:, index], shapes, (h, w))) for x in (a, b))  # type: ignore[return-value]


def windows_of(frames: Tensor, shapes: list[torch.Size], size: tuple[int, int]) -> list[Tensor]:
    """Indices of the responses in 3 levels and 5 x 5 pixels around the voxels that are nearest to frames."""
    x, y, scale = frames[0, :, 0, 2], frames[0, :, 1, 2], frames[0, :, 0, 0]
    octaves = torch.log2(scale / SCALE / 1.6)
    octave = (octaves - 1 / 6).floor().clamp(0, len(shapes) - 1)
    level = ((octaves - octave) * 3).round().clamp(1, 3).long()
    near, adjacent = (torch.arange(-r, r + 1, device=frames.device) for r in (WINDOW, 1))
    windows = []
    for i, (_, h, w) in enumerate(shapes):
        in_octave = octave == i
        column = (x[in_octave] * (w - 1) / (size[1] - 1)).round().long().clamp(WINDOW, w - 1 - WINDOW)
        row = (y[in_octave] * (h - 1) / (size[0] - 1)).round().long().clamp(WINDOW, h - 1 - WINDOW)
        planes = (level[in_octave][:, None] + adjacent)[:, :, None, None] * h
        rows = (planes + (row[:, None] + near)[:, None, :, None]) * w
        windows.append((rows + (column[:, None] + near)[:, None, None, :]).flatten(1))
    return windows


# --- attack ---------------------------------------------------------------------------------------------------------


def location_loss(extractor: Extractor, image: Tensor, targets: Targets, threshold: Tensor) -> Tensor:
    """How far targets are from being the soft maximum of their window, and from being among the strongest features."""
    values = [r.flatten()[index] for r, index in zip(extractor.responses(image), targets.windows)]
    windows = torch.cat(values) / threshold
    middle = windows.shape[1] // 2
    temperature = 0.1
    log_probability = torch.log_softmax(windows / temperature, 1)[:, middle]
    return F.relu(1.3 - windows[:, middle]).mean() - temperature * log_probability.mean()


def descriptor_loss(
    descriptors: tuple[Tensor, Tensor], targets: tuple[Targets, Targets], others: list[Features]
) -> Tensor:
    """How much the descriptors of a target are apart, over the distance to the nearest wrong one, above a half."""
    a, b = descriptors
    apart = (a - b).norm(dim=1)
    with torch.no_grad():
        own = torch.cdist(a, b)
        own.fill_diagonal_(math.inf)
        nearest = torch.minimum(own.amin(0), own.amin(1))
        for rows, target, features in ((a, targets[1], others[1]), (b, targets[0], others[0])):
            wrong = torch.cdist(rows, features.descriptors)
            near = torch.cdist(target.frames[0, :, :, 2], features.points) < SCALE
            nearest = torch.minimum(nearest, wrong.masked_fill(near, math.inf).amin(1))
    return F.relu(apart / nearest - 0.5).mean()


def progress(done: int, total: int) -> None:
    print(f"\r[{'#' * (30 * done // max(total, 1)):30}] {done}/{total}", end="", flush=True)


def attack(
    extractor: Extractor,
    first: Tensor,
    second: Tensor,
    homography: Tensor,
    *,
    iterations: int = ITERATIONS,
    alpha: float = ALPHA,
    beta: float = BETA,
    progress: Callable[[int, int], None] = progress,
) -> Outcome:
    """Let the first image match the second under the homography, by as many targets as a third of the features.

    `progress` is told how many iterations are done, of how many.
    """
    originals = (first, second)
    targets = place_targets(extractor, first, second, homography, extractor.count // 3)
    images = tuple(x.clone().requires_grad_() for x in originals)
    optimizer = torch.optim.Adam(images, lr=0.003)
    largest = 10 ** (-(WANTED_PSNR + 0.1) / 10)  # mean squared change; rounding adds a little
    others: list[Features] = []
    begin = time.perf_counter()
    for iteration in range(iterations):
        if iteration % 10 == 0:
            others = [extractor(x.detach())[1] for x in images]
            # A target that is as strong as this stays among the features that are detected.
            thresholds = [f.responses[min(len(f.responses) - 1, int(0.7 * extractor.count))] for f in others]
            progress(iteration, iterations)
        location = sum(location_loss(extractor, *x) for x in zip(images, targets, thresholds))
        described = tuple(extractor.describe(x, t.frames) for x, t in zip(images, targets))
        apart = descriptor_loss(described, targets, others)  # type: ignore[arg-type]
        distance = sum(F.mse_loss(x, original) for x, original in zip(images, originals)) / largest
        loss = location + alpha * apart + beta * distance
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        with torch.no_grad():
            for image, original in zip(images, originals):
                change = image.clamp(0, 1) - original
                image.copy_(original + change * (largest / change.square().mean()).sqrt().clamp(max=1))
    seconds = (time.perf_counter() - begin) / max(iterations, 1)
    progress(iterations, iterations)
    return verified([(255 * x.detach()).round() / 255 for x in images], originals, extractor, homography, seconds)


def verified(
    images: list[Tensor], originals: tuple[Tensor, Tensor], extractor: Extractor, homography: Tensor, seconds: float
) -> Outcome:
    """What the features of the images, detected afresh, match."""
    (_, a), (_, b) = (extractor(x) for x in images)
    _, index = K.feature.match_snn(a.descriptors, b.descriptors, RATIO)
    x, y = a.points[index[:, 0]], b.points[index[:, 1]]
    inliers = torch.zeros(len(x), dtype=torch.bool, device=x.device)
    if len(x) >= 4:
        _, inliers = K.geometry.RANSAC("homography", LIMIT, max_iter=20, seed=0)(x.double(), y.double())
        moved = K.geometry.transform_points(homography, x[None])[0]
        inliers = inliers & ((moved - y).norm(dim=1) <= LIMIT)
    psnr = tuple(float(K.metrics.psnr(image, original, 1.0)) for image, original in zip(images, originals))
    return Outcome(*images, (x[inliers], y[inliers]), len(x), psnr, seconds)  # type: ignore[arg-type]


# --- output ---------------------------------------------------------------------------------------------------------


def draw(originals: tuple[Tensor, Tensor], outcome: Outcome, path: Path) -> None:
    """The originals, and below them the attacked images with the matches that survive."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    h, w = originals[0].shape[2:]
    rows = [torch.cat([x[0, 0] for x in both], 1).cpu() for both in (originals, (outcome.first, outcome.second))]
    figure, axes = plt.subplots(2, 1, figsize=(10, 7.8))
    for axis, row in zip(axes, rows):
        axis.imshow(row, cmap="gray", vmin=0, vmax=1)
        axis.axis("off")
    for (x0, y0), (x1, y1) in zip(*(p.tolist() for p in outcome.points)):
        axes[1].plot([x0, x1 + w], [y0, y1], linewidth=0.5)
    axes[0].set_title("originals", fontsize=9)
    axes[1].set_title(
        f"attacked, {outcome.inliers} matches under the wanted homography, PSNR {min(outcome.psnr):.1f} dB", fontsize=9
    )
    axes[1].set_xlim(-0.5, 2 * w - 0.5)
    axes[1].set_ylim(h - 0.5, -0.5)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path, nargs=2, metavar=("FIRST", "SECOND"), help="two photographs")
    parser.add_argument("--data", type=Path, help="folder with a.png and b.png")
    parser.add_argument("--height", type=int, default=240, help="of the images; their width is 4 / 3 of it")
    parser.add_argument("--features", type=int, default=500, help="of each image")
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    parser.add_argument("--alpha", type=float, default=ALPHA, help="weight of the descriptors")
    parser.add_argument("--beta", type=float, default=BETA, help="weight of the distance from the originals")
    parser.add_argument("--seeds", type=int, default=3, help="number of homographies")
    parser.add_argument("--out", type=Path, default=Path("out/attack"), help="where the figures go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    for name in ("a.png", "b.png"):
        if options.data and not (options.data / name).is_file():
            parser.error(f"--data {options.data}: expected a folder with a.png and b.png")
    device = device_of(parser, options.device)
    paths = options.image or ([options.data / name for name in ("a.png", "b.png")] if options.data else [])
    own = images_of(parser, paths)
    require(parser, "matplotlib", *(() if own else ("skimage",)))
    originals = pictures(own, options.height, device)
    extractor = Extractor(options.features).to(device)
    make_folder(parser, options.out)
    outcomes = []
    for seed in range(options.seeds):
        homography = wanted_homography(seed, originals[0])
        before = verified(list(originals), originals, extractor, homography, 0.0)
        outcome = attack(
            extractor, *originals, homography, iterations=options.iterations, alpha=options.alpha, beta=options.beta
        )
        outcomes.append(outcome)
        draw(originals, outcome, options.out / f"seed{seed}.png")
        print(
            f"\rseed {seed}: {outcome.inliers} inliers of {outcome.matches} matches ({before.inliers} before; at least "
            f"{WANTED_INLIERS}), PSNR {outcome.psnr[0]:.2f} and {outcome.psnr[1]:.2f} dB (at least {WANTED_PSNR:g}), "
            f"{1e3 * outcome.seconds:.0f} ms an iteration" + ("" if outcome.success else "  MISSED"),
            flush=True,
        )
    missed = sum(not x.success for x in outcomes)
    print(f"{len(outcomes) - missed} of {len(outcomes)} attacks succeeded; figures are in {options.out}")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
