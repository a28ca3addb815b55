"""Find the homography between two images by gradient descent on their difference, from coarse to fine.

    python examples/image_registration.py                           synthetic pairs of scikit-image's photographs
    python examples/image_registration.py --image PHOTO...          synthetic pairs of your own photographs
    python examples/image_registration.py --data FOLDER             real pairs as well: FOLDER/graf, boat, leuven, bikes
    python examples/image_registration.py --solver gauss-newton     in fewer steps than Adam

Every pair gives a figure with a row for each level of the pyramid: source, destination, warped source, error. The error of a result
is the mean distance of the corners of the image, in pixels, from those of the known homography. Without a known homography the
correlation of both images says whether the search has converged: their local contrasts agree where it has, and are unrelated where
it ended in another minimum.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

LEVELS = 4
CONVERGED = 0.7  # least correlation of local contrasts: 0.9 where the homography is right, below 0.1 in other minima
# Real pairs: folder, number of the second image, pixels that the first estimate is off at every corner, the limit of the error.
REAL = (("leuven", 4, 0, 1.0), ("bikes", 3, 0, 1.0), ("graf", 2, 10, 2.0), ("boat", 3, 10, 2.0))


@dataclass(frozen=True)
class Pair:
    """Images (1, 1, H, W) and the homography from coordinates of `target` to those of `source`, both in [-1, 1].

    `start` is the first estimate. `limit` is the largest mean error of the corners in pixels of the original; `pixels` is the size
    of a pixel here in these.
    """

    name: str
    source: Tensor
    target: Tensor
    truth: Tensor
    start: Tensor
    limit: float
    pixels: float = 1.0


# --- pairs ----------------------------------------------------------------------------------------------------------


def corners(device: torch.device | str = "cpu") -> Tensor:
    return torch.tensor([[[-1.0, -1], [1, -1], [1, 1], [-1, 1]]], device=device)


def photographs() -> Iterator[tuple[str, Tensor]]:
    from skimage import data

    for name in ("astronaut", "coffee", "chelsea", "camera"):
        yield name, K.image_to_tensor(getattr(data, name)(), keepdim=False).float() / 255


def synthetic(device: torch.device, pictures: Iterable[tuple[str, Tensor]] | None = None) -> Iterator[Pair]:
    """Photographs and their warps by a homography that moves their corners by up to 8% of their size."""
    generator = torch.Generator().manual_seed(0)
    for name, picture in photographs() if pictures is None else pictures:
        source = gray(K.geometry.resize(picture, 320, antialias=True)).to(device)
        moved = corners() + 0.16 * (torch.rand(1, 4, 2, generator=generator) - 0.5)
        truth = K.get_perspective_transform(corners(), moved).to(device)
        target = K.homography_warp(source, truth, tuple(source.shape[2:]), padding_mode="reflection")
        yield Pair(name, source, target, truth, torch.eye(3, device=device)[None], 0.25)


def real(folder: Path, device: torch.device) -> Iterator[Pair]:
    """Pairs with a measured homography. The two with a large change of view start 10 pixels away from it at every corner."""
    for name, k, far, limit in REAL:
        folder_of_pair = folder / name
        if not folder_of_pair.is_dir():
            continue
        first, second = (gray(K.io.load_image(folder_of_pair / f"img{i}.png")[None]).to(device) for i in (1, k))
        numbers = [float(x) for x in (folder_of_pair / f"H_1_{k}.txt").read_text().split()]
        truth = to_unit(torch.tensor(numbers, dtype=torch.float64).reshape(1, 3, 3), first, second).to(device)
        half = [K.geometry.rescale(image, 0.5, antialias=True) for image in (second, first)]
        signs = corners(device) * torch.tensor([1.0, -1], device=device)
        shifted = corners(device) + far * 2 * signs / torch.tensor(first.shape[:1:-1], device=device)
        start = (
            truth @ K.get_perspective_transform(corners(device), shifted) if far else torch.eye(3, device=device)[None]
        )
        yield Pair(name, half[0], K.geometry.resize(half[1], tuple(half[0].shape[2:])), truth, start, limit, 2.0)


def gray(image: Tensor) -> Tensor:
    return image if image.shape[1] == 1 else K.color.rgb_to_grayscale(image)


def to_unit(pixels: Tensor, source: Tensor, target: Tensor) -> Tensor:
    """A homography between pixels of two images as one between [-1, 1], from edge to edge."""
    first, second = (unit_of(*image.shape[2:]) for image in (source, target))
    return (second @ pixels @ torch.linalg.inv(first)).float()


def unit_of(h: int, w: int) -> Tensor:
    """[-1, 1] from pixels."""
    return torch.tensor([[2 / w, 0, 1 / w - 1], [0, 2 / h, 1 / h - 1], [0, 0, 1]], dtype=torch.float64)


def normalized(image: Tensor) -> Tensor:
    """Local contrast, which light and exposure hardly change: each pixel minus the mean of its window, over its deviation."""
    size = (2 * (min(image.shape[2:]) // 16) + 1,) * 2
    mean = K.filters.box_blur(image, size, "replicate")
    spread = K.filters.box_blur((image - mean) ** 2, size, "replicate")
    return (image - mean) / (spread + 1e-3).sqrt()


def corner_error(homography: Tensor, pair: Pair) -> float:
    """Mean distance of where the corners go, in pixels of the original source."""
    h, w = pair.source.shape[2:]
    at, expected = (K.geometry.warp_grid(corners(m.device)[:, None], m)[0, 0] for m in (homography, pair.truth))
    scale = torch.tensor([w / 2, h / 2], device=homography.device) * pair.pixels
    return float(((at - expected) * scale).norm(dim=-1).mean())


def correlation(homography: Tensor, pair: Pair) -> float:
    """Of the local contrasts of both images, where the warped one has pixels."""
    size = tuple(pair.target.shape[2:])
    warped = K.homography_warp(pair.source, homography, size, padding_mode="border")
    inside = K.homography_warp(torch.ones_like(pair.source), homography, size) > 0.99
    x, y = (normalized(image)[inside] for image in (warped, pair.target))
    x, y = x - x.mean(), y - y.mean()
    return float((x * y).sum() / (x.norm() * y.norm()).clamp_min(1e-9)) if inside.float().mean() > 0.1 else 0.0


# --- solvers --------------------------------------------------------------------------------------------------------


def adam(source: Tensor, target: Tensor, iterations: int) -> tuple[Tensor, list[Tensor]]:
    """`kvision.geometry.ImageRegistrator` as in the Kornia paper: L1, Adam with a rate of 1e-3."""
    registrator = K.geometry.ImageRegistrator(
        "homography", loss_fn=F.l1_loss, pyramid_levels=LEVELS, lr=1e-3, num_iterations=iterations, tolerance=0
    ).to(source.device)
    homography, levels = registrator.register(source, target, output_intermediate_models=True)
    return homography.detach(), levels


def gauss_newton(source: Tensor, target: Tensor, iterations: int) -> tuple[Tensor, list[Tensor]]:
    """Reweighted least squares: the same loss, near enough, from its normal equations."""
    homography = torch.eye(3, device=source.device)[None]
    levels = []
    pyramids = (K.geometry.build_pyramid(image, LEVELS) for image in (source, target))
    for small_source, small_target in reversed(list(zip(*pyramids))):
        for _ in range(iterations):
            homography = gauss_newton_step(small_source, small_target, homography)
        levels.append(homography)
    return homography, levels


def gauss_newton_step(source: Tensor, target: Tensor, homography: Tensor) -> Tensor:
    """A better homography: one step of Gauss and Newton for the mean of abs(warped - target) where the source is."""
    normal, gradient, _ = K.geometry.photometric_normal_equations(source, target, homography, "charbonnier", 0.1)
    normal, gradient = normal.double(), gradient.double()
    normal = normal + 1e-6 * torch.diag_embed(normal.diagonal(dim1=1, dim2=2))
    step = torch.linalg.solve_ex(normal, -gradient)[0]
    moved = homography + F.pad(step, (0, 1)).reshape(1, 3, 3).to(homography.dtype)
    return moved / moved[:, 2:, 2:]


SOLVERS = {"adam": (adam, 200), "gauss-newton": (gauss_newton, 20)}

# --- the run --------------------------------------------------------------------------------------------------------


def register(pair: Pair, solver: str, iterations: int) -> tuple[Tensor, list[Tensor]]:
    """The homography of a pair, and that after each level."""
    closer = K.homography_warp(pair.source, pair.start, tuple(pair.target.shape[2:]), padding_mode="border")
    homography, levels = SOLVERS[solver][0](normalized(closer), normalized(pair.target), iterations)
    return pair.start @ homography, [pair.start @ level for level in levels]


def draw(pair: Pair, levels: list[Tensor], path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(len(levels), 4, figsize=(12, 2.4 * len(levels)), squeeze=False)
    for row, homography in zip(axes, levels):
        warped = K.homography_warp(pair.source, homography, tuple(pair.target.shape[2:]))
        pictures = (pair.source, pair.target, warped, (warped - pair.target).abs())
        for axis, picture, title in zip(row, pictures, ("source", "destination", "warped", "error")):
            axis.imshow(picture[0, 0].cpu(), cmap="gray", vmin=0, vmax=1)
            axis.set_title(
                title if title != "warped" else f"warped, corners {corner_error(homography, pair):.2f} px off",
                fontsize=9,
            )
            axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--solver", choices=tuple(SOLVERS), default="adam")
    parser.add_argument("--iterations", type=int, help="on each level; default: 200 of Adam, 20 of Gauss-Newton")
    parser.add_argument("--data", type=Path, help="folder of real pairs")
    parser.add_argument(
        "--image", type=Path, nargs="+", default=[], help="your own photographs, to be warped and found again"
    )
    parser.add_argument("--out", type=Path, default=Path("out/registration"), help="where the figures go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.data and not any((options.data / name).is_dir() for name, *_ in REAL):
        parser.error(
            f"--data {options.data}: expected a folder with {', '.join(name for name, *_ in REAL)}, there is none"
        )
    own = [(path.stem, picture) for path, picture in zip(options.image, images_of(parser, options.image))]
    require(parser, "matplotlib", *(() if own else ("skimage",)))
    iterations = options.iterations or SOLVERS[options.solver][1]
    make_folder(parser, options.out)
    missed = 0
    pairs = [*synthetic(device, own or None), *(real(options.data, device) if options.data else ())]
    for i, pair in enumerate(pairs):
        begin = time.perf_counter()
        homography, levels = register(pair, options.solver, iterations)
        error = corner_error(homography, pair)
        seconds = time.perf_counter() - begin
        agreement = correlation(homography, pair)
        remarks = "" if error <= pair.limit else "  MISSED"
        remarks += "" if agreement >= CONVERGED else "  did not converge"
        missed += error > pair.limit
        before = corner_error(pair.start, pair)
        print(
            f"[{'#' * (i + 1):{len(pairs)}}] {pair.name:10} {before:6.2f} -> {error:5.2f} px (at most {pair.limit}) "
            f"correlation {agreement:.2f}, in {iterations} iterations on {LEVELS} levels, {seconds:.1f} s{remarks}",
            flush=True,
        )
        draw(pair, levels, options.out / f"{pair.name}_{options.solver}.png")
    print(f"figures are in {options.out}")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
