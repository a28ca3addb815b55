"""Match two photographs by local features, find the homography between them, and stitch a panorama.

    python examples/feature_matching.py                             pairs and views made of scikit-image's photographs
    python examples/feature_matching.py --data FOLDER               real pairs as well: FOLDER/graf, boat, leuven, bikes
    python examples/feature_matching.py --image LEFT RIGHT          two photographs of a scene, with the panorama of them
    python examples/feature_matching.py --weights HardNet.pth       HardNet describes the patches instead of SIFT

The third example of the Kornia paper: a Hessian detector with affine shapes and orientations, patches, descriptors, mutual
nearest neighbors that pass the ratio test, RANSAC. Every pair gives an image of its inliers. Two photographs of --image with fewer
than 15 inliers are said to be of different scenes; the program then ends with 1 and makes no panorama.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

# Real pairs: folder, number of the second image.
REAL = (("graf", 3), ("boat", 3), ("leuven", 4), ("bikes", 3))
PATCH = 32
LEAST = 15  # inliers of one scene: unrelated photographs of scikit-image have none, the least of the pairs here 96
LIMIT = 3.0  # pixels: of an inlier, and of the mean error of the corners


@dataclass(frozen=True)
class Pair:
    """Color images (1, 3, H, W) and, where it is known, the homography (1, 3, 3) of pixels from the first to the second."""

    name: str
    first: Tensor
    second: Tensor
    truth: Tensor | None = None


class Matches(NamedTuple):
    points1: Tensor  # (K, 2)
    points2: Tensor
    homography: Tensor  # (3, 3)
    inliers: Tensor  # (K,) bool


# --- pairs ----------------------------------------------------------------------------------------------------------


def photograph(name: str, device: torch.device) -> Tensor:
    from skimage import data

    return K.image_to_tensor(getattr(data, name)(), keepdim=False).float().to(device) / 255


def synthetic(device: torch.device) -> Iterator[Pair]:
    """Photographs and what another camera sees of them: turned, nearer, darker, with noise."""
    generator = torch.Generator().manual_seed(0)
    for name in ("astronaut", "coffee"):
        first = photograph(name, device)
        h, w = first.shape[2:]
        corners = torch.tensor([[[0.0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]]], device=device)
        center = corners.mean(1)
        turned = K.geometry.get_rotation_matrix2d(center, center.new_tensor([25.0]), center.new_tensor([[1.2, 1.2]]))
        moved = K.geometry.transform_points(nn.functional.pad(turned, (0, 0, 0, 1)) + corner(center), corners)
        moved = moved + 0.1 * w * (torch.rand(1, 4, 2, generator=generator) - 0.5).to(device)
        truth = K.get_perspective_transform(corners, moved)
        second = 0.7 * K.warp_perspective(first, truth, (h, w))
        noise = 0.02 * torch.randn(second.shape, generator=generator).to(device)
        yield Pair(name, first, (second + noise).clamp(0, 1), truth)


def corner(like: Tensor) -> Tensor:
    """A 3 x 3 matrix with a 1 in the lower right."""
    return torch.diag(like.new_tensor([0.0, 0, 1]))[None]


def real(folder: Path, device: torch.device) -> Iterator[Pair]:
    for name, k in REAL:
        at = folder / name
        if at.is_dir():
            first, second = (K.io.load_image(at / f"img{i}.png")[None].to(device) for i in (1, k))
            numbers = [float(x) for x in (at / f"H_1_{k}.txt").read_text().split()]
            yield Pair(name, first, second, torch.tensor(numbers, device=device).reshape(1, 3, 3))


def views(device: torch.device) -> list[Tensor]:
    """Three overlapping views of a photograph, of which the second and the third are turned and darker."""
    wide = photograph("rocket", device)[..., :300, :]
    h, w = 300, 280
    cut = [wide[..., x : x + w] for x in (0, 170, 340)]
    turns = []
    for view, degrees, gain in zip(cut, (0.0, 2.0, -3.0), (1.0, 0.9, 1.0)):
        center, angle = view.new_tensor([[w / 2, h / 2]]), view.new_tensor([degrees])
        matrix = K.geometry.get_rotation_matrix2d(center, angle, view.new_tensor([[1.0, 1.0]]))
        turns.append(gain * K.geometry.warp_affine(view, matrix, (h, w), padding_mode="reflection"))
    return turns


# --- detect, describe, match ----------------------------------------------------------------------------------------


class Features(nn.Module):
    """Hessian detector with affine shapes and orientations, and descriptors of its patches."""

    def __init__(self, count: int, weights: Path | None = None) -> None:
        super().__init__()
        self.detector = K.feature.ScaleSpaceDetector(
            count,
            resp_module=K.feature.BlobHessian(),
            ori_module=K.feature.LAFOrienter(19),
            aff_module=K.feature.LAFAffineShapeEstimator(19),
            mr_size=6.0,
        )
        self.descriptor = K.feature.HardNet(weights) if weights else K.feature.SIFTDescriptor(PATCH, rootsift=True)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Points (N, 2) and descriptors (N, 128) of a color or gray image."""
        gray = image if image.shape[1] == 1 else K.color.rgb_to_grayscale(image)
        lafs, _ = self.detector(gray)
        patches = K.feature.extract_patches_from_pyramid(gray, lafs, PATCH)
        filled = K.feature.laf_is_filled(lafs)[0]
        return K.feature.get_laf_center(lafs)[0, filled], self.descriptor(patches[0, filled])


class Matcher(nn.Module):
    """Mutual nearest neighbors that pass the ratio test, as `kvision.contrib.ImageStitcher` takes them."""

    def __init__(self, features: Features, ratio: float = 0.9) -> None:
        super().__init__()
        self.features, self.ratio = features, ratio

    def forward(self, data: dict[str, Tensor]) -> dict[str, Tensor]:
        (points1, first), (points2, second) = (self.features(data[name]) for name in ("image0", "image1"))
        _, indices = K.feature.match_smnn(first, second, self.ratio)
        samples = torch.zeros(len(indices), dtype=torch.int64, device=indices.device)
        return {
            "keypoints0": points1[indices[:, 0]],
            "keypoints1": points2[indices[:, 1]],
            "batch_indexes": samples,
        }


def match(matcher: Matcher, first: Tensor, second: Tensor) -> Matches:
    """The matches of two images, and the homography that most of them agree with."""
    with torch.no_grad():
        matches = matcher({"image0": first, "image1": second})
        x, y = matches["keypoints0"], matches["keypoints1"]
        if len(x) < 4:
            return Matches(x, y, torch.eye(3, device=x.device), torch.zeros(len(x), dtype=torch.bool))
        homography, inliers = K.geometry.RANSAC("homography", LIMIT, max_iter=20, seed=0)(x, y)
        return Matches(x, y, homography, inliers)


def corner_error(homography: Tensor, pair: Pair) -> float:
    """Mean distance of where the corners of the first image go in the second, in pixels."""
    h, w = pair.first.shape[2:]
    corners = torch.tensor([[[0.0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]]], device=homography.device)
    at, expected = (K.geometry.transform_points(m, corners) for m in (homography[None], pair.truth))
    return float((at - expected).norm(dim=-1).mean())


# --- the run --------------------------------------------------------------------------------------------------------


def draw(pair: Pair, matches: Matches, path: Path, most: int = 150) -> None:
    """Both images side by side, with lines between inliers."""
    import matplotlib.pyplot as plt

    pictures = [K.tensor_to_image(x.cpu()) for x in (pair.first, pair.second)]
    h, gap = max(p.shape[0] for p in pictures), pictures[0].shape[1] + 10
    figure, axis = plt.subplots(figsize=(12, 12 * h / (gap + pictures[1].shape[1])))
    for picture, left in zip(pictures, (0, gap)):
        axis.imshow(picture, extent=(left - 0.5, left + picture.shape[1] - 0.5, picture.shape[0] - 0.5, -0.5))
    x, y = (p[matches.inliers.to(p.device)].cpu() for p in (matches.points1, matches.points2))
    for (x1, y1), (x2, y2) in zip(x[:: len(x) // most + 1].tolist(), y[:: len(x) // most + 1].tolist()):
        axis.plot((x1, x2 + gap), (y1, y2), "o-", color="lime", linewidth=0.6, markersize=2)
    axis.set_xlim(-0.5, gap + pictures[1].shape[1] - 0.5)
    axis.set_ylim(h - 0.5, -0.5)
    axis.set_title(f"{len(x)} inliers of {len(matches.points1)} matches", fontsize=9)
    axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def panorama(matcher: Matcher, images: list[Tensor]) -> Tensor:
    """Overlapping images from left to right as one."""
    torch.manual_seed(0)  # of RANSAC
    with torch.no_grad():
        return K.contrib.ImageStitcher(matcher, estimator="ransac")(*images)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path, nargs=2, metavar=("LEFT", "RIGHT"), help="two photographs of a scene")
    parser.add_argument("--data", type=Path, help="folder of real pairs")
    parser.add_argument("--weights", type=Path, help="published weights of HardNet; default: SIFT describes")
    parser.add_argument("--features", type=int, default=2000, help="of each image")
    parser.add_argument("--out", type=Path, default=Path("out/matching"), help="where the images go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.data and not any((options.data / name).is_dir() for name, _ in REAL):
        parser.error(
            f"--data {options.data}: expected a folder with {', '.join(name for name, _ in REAL)}, there is none"
        )
    if options.weights and not options.weights.is_file():
        parser.error(f"--weights {options.weights}: there is no such file")
    own = images_of(parser, options.image or [])
    require(parser, "matplotlib", *(() if own else ("skimage",)))
    make_folder(parser, options.out)
    matcher = Matcher(Features(options.features, options.weights)).to(device).eval()
    if options.image:
        images = [picture.to(device) for picture in own]
        pairs, overlapping = [Pair(options.image[0].stem, *images)], images
    else:
        pairs, overlapping = [*synthetic(device), *(real(options.data, device) if options.data else ())], views(device)
    missed, inliers = 0, 0
    for i, pair in enumerate(pairs):
        begin = time.perf_counter()
        matches = match(matcher, pair.first, pair.second)
        count = int(matches.inliers.sum())
        seconds = time.perf_counter() - begin
        inliers += count
        result = ""
        if pair.truth is not None:
            error = corner_error(matches.homography, pair)
            missed += error > LIMIT
            result = f", corners {error:.2f} px off (at most {LIMIT:g})" + ("  MISSED" if error > LIMIT else "")
        print(
            f"[{'#' * (i + 1):{len(pairs)}}] {pair.name:10} {count} inliers of {len(matches.points1)} matches in "
            f"{seconds:.1f} s{result}",
            flush=True,
        )
        draw(pair, matches, options.out / f"{pair.name}.png")
    if options.image and inliers < LEAST:
        print(
            f"{inliers} inliers, fewer than {LEAST}: no homography relates these photographs; images are in {options.out}"
        )
        return 1
    stitched = panorama(matcher, overlapping)
    K.io.write_image(options.out / "panorama.png", (255 * stitched[0].clamp(0, 1)).round().byte().cpu())
    print(
        f"{inliers} inliers in {len(pairs)} pairs, {missed} missed; panorama of {len(overlapping)} views "
        f"{stitched.shape[3]}x{stitched.shape[2]}; images are in {options.out}"
    )
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
