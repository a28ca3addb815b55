"""Quality of local features on pairs of images with a known homography: kvision, OpenCV's SIFT, Kornia.

    python -m benchmarks.features                                   synthetic pairs of scikit-image's photographs
    python -m benchmarks.features --data FOLDER --csv features.csv  FOLDER/homography as well; FOLDER/weights for Key.Net

All methods find the same number of features in the same gray images. Columns:

    repeat      key points of the common area that have a mutual nearest one within 3 px in the other image, of those of the
                image that has fewer
    mma1 3 5    mean matching accuracy: mutual nearest descriptors of which the points are within 1, 3, 5 px
    inliers     matches of match_smnn(th=.9) within 3 px of the homography that RANSAC finds
    right       inliers that are within 3 px of the known homography
    corners     mean distance of the corners under RANSAC's homography and the known one, px
    offset      length of the mean vector between matched points and the truth, px, of the matches within 3 px
"""

from __future__ import annotations

import argparse
import csv
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

import kvision as K

SEQUENCES = (("graf", 3), ("wall", 3), ("boat", 3), ("leuven", 4), ("bikes", 3), ("ubc", 4))
PHOTOGRAPHS = ("astronaut", "coffee", "chelsea", "rocket")
COLUMNS = ("repeat", "mma1", "mma3", "mma5", "inliers", "right", "corners", "offset", "seconds")


class Pair(NamedTuple):
    """Gray images (1, 1, H, W) in [0, 1], and the homography (3, 3) of pixels from the first to the second."""

    name: str
    first: Tensor
    second: Tensor
    homography: Tensor


class Features(NamedTuple):
    points: Tensor  # (N, 2)
    descriptors: Tensor  # (N, D)


Method = Callable[[Tensor], Features]

# --- pairs ----------------------------------------------------------------------------------------------------------


def real(folder: Path) -> Iterator[Pair]:
    """The sequences that are in a folder of homography/NAME/img1.png, imgK.png, H_1_K.txt."""
    for name, k in SEQUENCES:
        at = folder / "homography" / name
        if not at.is_dir():
            continue
        first, second = (gray(K.io.load_image(at / f"img{i}.png")[None]) for i in (1, k))
        numbers = [float(x) for x in (at / f"H_1_{k}.txt").read_text().split()]
        yield Pair(name, first, second, torch.tensor(numbers, dtype=torch.float64).reshape(3, 3))


def synthetic() -> Iterator[Pair]:
    """Photographs under homographies, under the identity, and under a shift of half a pixel that no filter made."""
    from skimage import data

    generator = torch.Generator().manual_seed(0)
    for name in PHOTOGRAPHS:
        picture = gray(K.image_to_tensor(getattr(data, name)(), keepdim=False).float() / 255)
        h, w = picture.shape[2:]
        corners = torch.tensor([[[0.0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]]])
        moved = corners + 0.3 * min(h, w) * (torch.rand(1, 4, 2, generator=generator) - 0.5)
        homography = K.get_perspective_transform(corners, moved)
        warped = K.warp_perspective(picture, homography, (h, w), padding_mode="reflection")
        yield Pair(name, picture, warped, homography[0].double())
    picture = gray(K.image_to_tensor(data.astronaut(), keepdim=False).float() / 255)
    yield Pair("identity", picture, picture, torch.eye(3, dtype=torch.float64))
    # Means of 2 x 2 pixels: moved by one pixel first, the smaller image moves by half a pixel.
    large = gray(K.image_to_tensor(data.retina(), keepdim=False).float() / 255)[..., 100:1301, 100:1301]
    small = [torch.nn.functional.avg_pool2d(x, 2) for x in (large[..., :-1, :-1], large[..., :-1, 1:])]
    shift = torch.eye(3, dtype=torch.float64)
    shift[0, 2] = -0.5
    yield Pair("half pixel", *small, shift)


def gray(image: Tensor) -> Tensor:
    return image if image.shape[1] == 1 else K.color.rgb_to_grayscale(image)


# --- methods --------------------------------------------------------------------------------------------------------


def of_module(module: torch.nn.Module) -> Method:
    """A module that returns frames, responses and descriptors; slots without a feature are left out."""

    def detect(image: Tensor) -> Features:
        lafs, _, descriptors = module(image)
        is_filled = (lafs[0] != 0).flatten(1).any(1)
        return Features(lafs[0, is_filled, :, 2], descriptors[0, is_filled])

    return detect


class Described(torch.nn.Module):
    """A detector of a library with Kornia's names, and descriptors of its patches."""

    def __init__(
        self, library: Any, detector: torch.nn.Module, descriptor: torch.nn.Module, patch_size: int = 32
    ) -> None:
        super().__init__()
        self.extract, self.patch_size = library.extract_patches_from_pyramid, patch_size
        self.detector, self.descriptor = detector, descriptor

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        lafs, responses = self.detector(image)
        patches = self.extract(image, lafs, self.patch_size)
        return lafs, responses, self.descriptor(patches.flatten(0, 1)).unflatten(0, patches.shape[:2])


def opencv(count: int, root: bool) -> Method:
    sift = cv2.SIFT_create(count)

    def detect(image: Tensor) -> Features:
        keypoints, descriptors = sift.detectAndCompute((255 * image[0, 0].cpu().numpy()).round().astype(np.uint8), None)
        points = torch.tensor([k.pt for k in keypoints]).reshape(-1, 2)
        x = torch.tensor(np.zeros((0, 128), np.float32) if descriptors is None else descriptors)
        if root:
            x = torch.nn.functional.normalize(x, p=1, dim=1).sqrt()
        return Features(points[:count].to(image.device), x[:count].to(image.device))

    return detect


def sift_of(k: Any, count: int, device: torch.device, detector: Any = None) -> Method:
    """Hessian + affine shape + orientation + SIFT in a library with Kornia's names, or with another detector."""
    if detector is None:
        detector = k.ScaleSpaceDetector(
            count,
            resp_module=k.BlobHessian(),
            ori_module=k.LAFOrienter(32),
            aff_module=k.LAFAffineShapeEstimator(32),
        )
    return of_module(Described(k, detector, k.SIFTDescriptor(32, rootsift=True)).to(device).eval())


def learned(count: int, weights: Path, descriptor: str, device: torch.device) -> Method:
    """Key.Net + AffNet + OriNet with SIFT or TFeat, of published weights."""
    k = K.feature
    orienter = k.LAFOrienter(32, angle_detector=k.OriNet(weights / "OriNet.pth"))
    shape = k.LAFAffNetShapeEstimator(weights / "AffNet.pth")
    detector = k.KeyNetDetector(weights / "keynet_pytorch.pth", count, ori_module=orienter, aff_module=shape)
    if descriptor == "SIFT":
        return sift_of(k, count, device, detector)
    network = k.TFeat(weights / "tfeat-liberty.params")
    return of_module(Described(k, detector, network).to(device).eval())


def methods(count: int, folder: Path | None, device: torch.device) -> dict[str, Callable[[], Method]]:
    """What makes each method, by its name."""
    constructors: dict[str, Callable[[], Method]] = {
        "kvision SIFT": lambda: of_module(K.feature.SIFTFeature(count, device=device)),
        "kvision Hessian-affine SIFT": lambda: sift_of(K.feature, count, device),
        "OpenCV SIFT": lambda: opencv(count, False),
        "OpenCV RootSIFT": lambda: opencv(count, True),
    }
    try:
        import kornia.feature as KF

        constructors["Kornia SIFT"] = lambda: of_module(KF.SIFTFeature(count, device=device))
        constructors["Kornia Hessian-affine SIFT"] = lambda: sift_of(KF, count, device)
    except ImportError:
        print("Kornia is not installed: no rows of it")
    if folder is not None and (weights := folder / "weights").is_dir():
        constructors["kvision Key.Net SIFT"] = lambda: learned(count, weights, "SIFT", device)
        constructors["kvision Key.Net TFeat"] = lambda: learned(count, weights, "TFeat", device)
    return constructors


# --- measures -------------------------------------------------------------------------------------------------------


def moved(points: Tensor, homography: Tensor) -> Tensor:
    return K.geometry.transform_points(homography[None].to(points), points[None])[0]


def is_inside(points: Tensor, image: Tensor) -> Tensor:
    h, w = image.shape[2:]
    return ((points >= 0) & (points <= points.new_tensor([w - 1, h - 1]))).all(1)


def repeatability(x: Tensor, y: Tensor, pair: Pair) -> float:
    """Of the key points of two images in their common area."""
    to, back = moved(x, pair.homography), moved(y, torch.linalg.inv(pair.homography))
    to, y = to[is_inside(to, pair.second)], y[is_inside(back, pair.first)]
    if not len(to) or not len(y):
        return 0.0
    distances, _ = K.feature.match_mnn(to, y)
    return float((distances <= 3).sum()) / min(len(to), len(y))


def measure(method: Method, pair: Pair, device: torch.device) -> dict[str, float]:
    pair = pair._replace(first=pair.first.to(device), second=pair.second.to(device))
    start = time.perf_counter()
    with torch.no_grad():
        first, second = method(pair.first), method(pair.second)
        seconds = (time.perf_counter() - start) / 2
        values = {"repeat": repeatability(first.points, second.points, pair)}
        _, matches = K.feature.match_mnn(first.descriptors, second.descriptors)
        errors = moved(first.points[matches[:, 0]], pair.homography) - second.points[matches[:, 1]]
        distances = errors.norm(dim=1)
        for t in (1, 3, 5):
            values[f"mma{t}"] = float((distances <= t).float().mean()) if len(distances) else 0.0
        close = errors[distances <= 3]
        values["offset"] = float(close.mean(0).norm()) if len(close) else float("nan")
        _, matches = K.feature.match_smnn(first.descriptors, second.descriptors, 0.9)
        x, y = first.points[matches[:, 0]].double(), second.points[matches[:, 1]].double()
        values |= {"inliers": 0.0, "right": 0.0, "corners": float("inf")}
        if len(matches) >= 4:
            homography, inliers = K.geometry.RANSAC("homography", 3.0, max_iter=20, seed=0)(x, y)
            is_right = (moved(x, pair.homography) - y).norm(dim=1) <= 3
            h, w = pair.first.shape[2:]
            corners = x.new_tensor([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]])
            values["inliers"], values["right"] = float(inliers.sum()), float((inliers & is_right).sum())
            values["corners"] = float((moved(corners, homography) - moved(corners, pair.homography)).norm(dim=1).mean())
    return {**values, "seconds": seconds}


def main(arguments: list[str] | None = None) -> list[dict[str, Any]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with homography/ and, for learned features, weights/")
    parser.add_argument("--features", type=int, default=2000, help="of each image")
    parser.add_argument("--csv", type=Path, help="file to write the table to")
    parser.add_argument("--only", default="", help="methods with this in their name")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = torch.device(options.device)
    warnings.filterwarnings("ignore", category=FutureWarning)
    pairs = [*(real(options.data) if options.data else ()), *synthetic()]
    rows: list[dict[str, Any]] = []
    print(f"{options.features} features, {device}")
    print(f"{'':12} {'':30} " + " ".join(f"{name:>8}" for name in COLUMNS))
    available = methods(options.features, options.data, device)
    chosen = {name: make() for name, make in available.items() if options.only in name}
    for pair in pairs:
        for name, method in chosen.items():
            values = measure(method, pair, device)
            rows.append({"pair": pair.name, "method": name, **values})
            cells = " ".join(f"{values[c]:8.0f}" if c in ("inliers", "right") else f"{values[c]:8.3f}" for c in COLUMNS)
            print(f"{pair.name:12} {name:30} {cells}", flush=True)
    for name in chosen:
        mean = {
            c: float(np.mean([r[c] for r in rows if r["method"] == name])) for c in ("repeat", "mma1", "mma3", "mma5")
        }
        print(f"{'mean':12} {name:30} " + " ".join(f"{value:8.3f}" for value in mean.values()))
    if options.csv:
        with open(options.csv, "w", newline="") as file:
            writer = csv.DictWriter(file, ["pair", "method", *COLUMNS])
            writer.writeheader()
            writer.writerows(rows)
        print(f"the table is in {options.csv}")
    return rows


if __name__ == "__main__":
    main()
