"""Calibrate a camera from pictures of a chessboard, and undistort a picture with the result.

    python examples/calibration.py                         renders its own board through a lens that is known
    python examples/calibration.py --image PICTURE ...     your pictures of a board (--columns, --rows inner corners)
    python examples/calibration.py --model kannala_brandt  a fisheye lens

OpenCV finds the corners, kvision refines them and estimates intrinsics, distortion and poses. The figure has a picture with the
corners, the same picture without distortion, and the error of each view.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require
from kvision.geometry.liegroup import Se3

SIZE = (480, 640)
CAMERA = torch.tensor([[520.0, 0.0, 318.0], [0.0, 515.0, 243.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
DIST = torch.tensor([-0.22, 0.07, 0.0008, -0.0005, 0.0], dtype=torch.float64)
SQUARE = 0.03  # meters
VIEWS = 12


def board(columns: int, rows: int) -> Tensor:
    """The inner corners (rows * columns, 3) of a chessboard, row by row."""
    y, x = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).double().unbind(-1)
    return SQUARE * torch.stack([x, y, torch.zeros_like(x)], -1)


def render(columns: int, rows: int, views: int = VIEWS, supersampling: int = 3) -> Tensor:
    """Pictures (V, 1, H, W) of a chessboard, drawn by following the ray of every sample to the board."""
    generator = torch.Generator().manual_seed(0)
    middle = SQUARE * torch.tensor([(columns - 1) / 2, (rows - 1) / 2, 0.0], dtype=torch.float64)
    turn = Se3.exp(
        torch.cat([torch.zeros(views, 3), 0.7 * torch.rand(views, 3, generator=generator) - 0.35], -1).double()
    )
    away = torch.rand(views, 3, generator=generator).double() * torch.tensor([0.08, 0.06, 0.1])
    height, width = (n * supersampling for n in SIZE)
    y, x = torch.cartesian_prod(torch.arange(height), torch.arange(width)).double().unbind(-1)
    pixels = (torch.stack([x, y], -1) + 0.5) / supersampling - 0.5
    rays = K.geometry.undistort_points(pixels, CAMERA, DIST, torch.eye(3, dtype=torch.float64))
    rays = torch.cat([rays, torch.ones_like(rays[:, :1])], -1)
    pictures = []
    for i in range(views):
        to_board = turn[i].inverse().requires_grad_(False)
        origin = to_board.r * -(away[i] + torch.tensor([-0.04, -0.03, 0.4], dtype=torch.float64))
        direction = to_board.r * rays
        p = origin - origin[2] / direction[:, 2:] * direction + middle
        square = (p[:, :2] / SQUARE).floor()
        is_board = ((square >= -1) & (square < torch.tensor([columns, rows]))).all(-1)
        white = ~is_board | (square.sum(-1) % 2 == 0)
        pictures.append((0.1 + 0.8 * white).float().view(1, 1, height, width))
    pictures = torch.nn.functional.avg_pool2d(torch.cat(pictures), supersampling)
    return (pictures + 0.01 * torch.randn(pictures.shape, generator=generator)).clamp(0, 1)


def corners_of(picture: Tensor, columns: int, rows: int) -> Tensor | None:
    """The inner corners (rows * columns, 2) of a chessboard in a gray picture (1, H, W); None where there is none."""
    import cv2

    found, corners = cv2.findChessboardCornersSB((255 * picture[0]).byte().cpu().numpy(), (columns, rows))
    if not found:
        return None
    start = torch.from_numpy(corners).reshape(1, -1, 2).to(picture.device)
    return K.geometry.refine_corners(picture[None], start, max_iterations=100, eps=1e-4)[0].cpu().double()


def calibrate(pictures: list[Tensor], columns: int, rows: int, model: str, device: torch.device):
    """The calibration, the corners (V, N, 2) and the pictures that show a board."""
    found = [(p, c) for p in pictures if (c := corners_of(p, columns, rows)) is not None]
    if len(found) < 3:
        raise SystemExit(
            f"calibration: expected three pictures of a board of {columns} x {rows} corners, found {len(found)}"
        )
    shown, corners = [p for p, _ in found], torch.stack([c for _, c in found])
    points = board(columns, rows).expand(1, len(corners), -1, -1).to(device)
    size = tuple(shown[0].shape[-2:])
    return K.geometry.calibrate_camera(points, corners[None].to(device), size, model=model), corners, shown


def main(arguments: list[str] | None = None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", nargs="+", type=Path, help="pictures of one size; default: rendered ones")
    parser.add_argument("--columns", type=int, default=9, help="inner corners of a row of the board")
    parser.add_argument("--rows", type=int, default=6, help="inner corners of a column")
    parser.add_argument("--model", choices=("brown_conrady", "kannala_brandt"), default="brown_conrady")
    parser.add_argument("--out", type=Path, default=Path("calibration"), help="folder of the figure")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    require(parser, "matplotlib", "cv2")
    make_folder(parser, options.out)
    if options.image:
        pictures = [K.rgb_to_grayscale(image)[0] for image in images_of(parser, options.image)]
    else:
        pictures = list(render(options.columns, options.rows))
    fit, corners, shown = calibrate(pictures, options.columns, options.rows, options.model, device)
    deviation = fit.covariance[0].diagonal().sqrt()
    for name, value, sigma in zip(
        ("fx", "fy", "cx", "cy"), fit.camera_matrix[0, [0, 1, 0, 1], [0, 1, 2, 2]], deviation
    ):
        print(f"{name} {value:9.3f} +- {sigma:.3f}")
    print("distortion", " ".join(f"{k:.5f}" for k in fit.dist[0]))
    print(f"rms {fit.rms[0]:.4f} pixels; views " + " ".join(f"{v:.3f}" for v in fit.view_rms[0]))
    figure(shown[0], corners[0], fit, options.model, options.out)
    return fit


def undistorted(picture: Tensor, fit, model: str) -> Tensor:
    """The picture as a pinhole camera with the same matrix shows it."""
    matrix, dist = fit.camera_matrix[0].cpu(), fit.dist[0].cpu()
    if model == "brown_conrady":
        return K.geometry.undistort_image(picture[None], matrix[None].float(), dist[None].float())[0]
    height, width = picture.shape[-2:]
    grid = K.geometry.create_meshgrid(height, width, normalized_coordinates=False)[0].double()
    camera = matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
    plane = K.geometry.camera.undistort_points_affine(grid, camera)
    source = K.geometry.camera.distort_points_kannala_brandt(plane, torch.cat([camera, dist])).float()
    return K.geometry.remap(picture[None], source[None, ..., 0], source[None, ..., 1], align_corners=True)[0]


def figure(picture: Tensor, corners: Tensor, fit, model: str, folder: Path) -> None:
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(1, 3, figsize=(15, 4))
    axes[0].imshow(picture[0], cmap="gray")
    axes[0].plot(*corners.T, "r.", markersize=3)
    axes[1].imshow(undistorted(picture, fit, model)[0], cmap="gray")
    axes[2].bar(range(fit.view_rms.shape[1]), fit.view_rms[0].cpu())
    for axis, title in zip(axes, ("picture", "without distortion", "error of each view, pixels")):
        axis.set_title(title)
    plt.savefig(folder / "calibration.png", bbox_inches="tight")
    plt.close()


if __name__ == "__main__":
    main()
