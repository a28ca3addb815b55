"""Train a small segmentation network on synthetic shapes, once with each of kvision's segmentation losses.

    python examples/segmentation_losses.py [--out FOLDER] [--device auto|cpu|cuda] [--steps N] [--image PHOTO...]

Every image has reddish discs (class 1) and bluish boxes (class 2) over a gray background (class 0), with noise. The same
small network is trained from the same weights on the same images with each loss. The program prints the mean intersection
over union on new images and draws the curves. All losses reach more than 0.9. With --image the networks also label your own
photographs by what they have learned: reddish, bluish and the rest.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor, nn

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

SIZE, CLASSES, BATCH = 32, 3, 8


def regions(pred: Tensor, target: Tensor) -> Tensor:
    """The binary Lovász loss of each class against the others."""
    losses = [K.losses.lovasz_hinge_loss(pred[:, c : c + 1], target == c) for c in range(CLASSES)]
    return torch.stack(losses).mean()


def hausdorff(pred: Tensor, target: Tensor) -> Tensor:
    """A boundary loss, beside a loss of regions as in its paper: alone it has no gradient far from any overlap."""
    boundary = K.losses.HausdorffERLoss(k=4)(pred.softmax(1), target[:, None])
    return boundary + K.losses.dice_loss(pred, target, "macro")


LOSSES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "focal": lambda pred, target: CLASSES * K.losses.focal_loss(pred, target, alpha=0.7, reduction="mean"),
    "focal, binary": lambda pred, target: K.losses.binary_focal_loss_with_logits(
        pred, K.losses.one_hot(target, CLASSES, pred.device, pred.dtype), alpha=0.6, reduction="mean"
    ),
    "Dice, micro": K.losses.dice_loss,
    "Dice, macro": lambda pred, target: K.losses.dice_loss(pred, target, "macro"),
    "Tversky": lambda pred, target: K.losses.tversky_loss(pred, target, alpha=0.4, beta=0.6),
    "Lovász hinge": regions,
    "Lovász softmax": K.losses.lovasz_softmax_loss,
    "Hausdorff + Dice": hausdorff,
}


def shapes(count: int, generator: torch.Generator, device: torch.device) -> tuple[Tensor, Tensor]:
    """Images (count, 3, SIZE, SIZE) and their labels (count, SIZE, SIZE)."""
    labels = torch.zeros(count, SIZE, SIZE, dtype=torch.int64)
    images = 0.4 + 0.2 * torch.rand(count, 1, 1, 1, generator=generator).expand(-1, 3, SIZE, SIZE)
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    for kind in (1, 2, 1, 2):
        geometry = torch.rand(count, 4, 1, 1, generator=generator)
        cy, cx = (geometry[:, i] * SIZE for i in (0, 1))
        ry, rx = (3 + 5 * geometry[:, i] for i in (2, 3))
        away = torch.stack([(y - cy) / ry, (x - cx) / (ry if kind == 1 else rx)])
        inside = away.square().sum(0) < 1 if kind == 1 else away.abs().amax(0) < 1
        shade = 0.3 * torch.rand(count, 1, 1, 1, generator=generator)
        color = torch.cat([0.7 + shade, 0.5 * shade + 0.3, 0.6 - shade][:: 1 if kind == 1 else -1], 1)
        images = torch.where(inside[:, None], color, images)
        labels = torch.where(inside, kind, labels)
    return (images + 0.1 * torch.randn(images.shape, generator=generator)).to(device), labels.to(device)


def network() -> nn.Module:
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for inputs in (3, 12, 12):
        layers += [nn.Conv2d(inputs, 12, 3, padding=1), nn.GroupNorm(3, 12), nn.ReLU()]
    return nn.Sequential(*layers, nn.Conv2d(12, CLASSES, 1))


def train(
    name: str, loss: Callable[[Tensor, Tensor], Tensor], steps: int, device: torch.device
) -> tuple[list[float], nn.Module]:
    """The mean IoU of unseen images, every tenth of the way, and the trained network."""
    from tqdm import tqdm

    generator = torch.Generator().manual_seed(1)
    unseen = shapes(32, torch.Generator().manual_seed(2), device)
    model = network().to(device)
    optimizer = torch.optim.Adam(model.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-2, total_steps=steps)
    curve = []
    for step in tqdm(range(1, steps + 1), name, leave=False, unit="step"):
        images, labels = shapes(BATCH, generator, device)
        optimizer.zero_grad()
        loss(model(images), labels).backward()
        optimizer.step()
        schedule.step()
        if step % max(1, steps // 10) == 0:
            with torch.no_grad():
                predicted = model(unseen[0]).argmax(1)
            # The classes of all images together: an image may lack one.
            curve.append(float(K.metrics.mean_iou(predicted.view(1, -1), unseen[1].view(1, -1), CLASSES).mean()))
    return curve, model


def draw(curves: dict[str, list[float]], path: Path) -> None:
    """IoU over training, a line for each loss."""
    from PIL import Image, ImageDraw, ImageFont

    width, height, left, top = 720, 420, 60, 20
    picture = Image.new("RGB", (width + 180, height + 60), "white")
    pen = ImageDraw.Draw(picture)
    pen.font = ImageFont.load_default(13)
    colors = ["#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#17becf"]
    for tenth in range(0, 11, 2):
        y = top + height * (1 - tenth / 10)
        pen.line((left, y, width, y), fill="#dddddd")
        pen.text((left - 30, y - 6), f"{tenth / 10:.1f}", fill="black")
    for curve, color in zip(curves.values(), colors):
        points = [
            (left + (width - left) * i / max(1, len(curve) - 1), top + height * (1 - iou))
            for i, iou in enumerate(curve)
        ]
        pen.line(points, fill=color, width=2)
    for i, (name, color) in enumerate(zip(curves, colors)):
        pen.text((width + 12, top + 18 * i), f"{name}: {curves[name][-1]:.3f}", fill=color)
    pen.text((left, top + height + 12), "mean IoU of unseen images over training", fill="black")
    picture.save(path)


def label(model: nn.Module, picture: Tensor, device: torch.device) -> Tensor:
    """A photograph (1, 3, H, W), 256 pixels on its shorter side, next to its labels in the colors of the shapes."""
    small = K.geometry.resize(picture.to(device), 256, antialias=True)
    with torch.no_grad():
        labels = model(small).argmax(1)
    colors = torch.tensor([[0.5, 0.5, 0.5], [0.8, 0.4, 0.2], [0.2, 0.4, 0.8]], device=device)
    return torch.cat([small, colors[labels].permute(0, 3, 1, 2)], 3)[0].cpu()


def main(arguments: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/segmentation"), help="where the figure goes")
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--image", type=Path, nargs="+", default=[], help="your own photographs, to be labeled")
    options = parser.parse_args(arguments)
    auto = "cuda" if torch.cuda.is_available() else "cpu"
    device = device_of(parser, auto if options.device == "auto" else options.device)
    pictures = images_of(parser, options.image)
    require(parser, "PIL", "tqdm")
    make_folder(parser, options.out)
    curves = {}
    for name, loss in LOSSES.items():
        curves[name], model = train(name, loss, options.steps, device)
        print(f"{name:20} IoU {curves[name][-1]:.3f}", flush=True)
        for path, picture in zip(options.image, pictures):
            file = f"{path.stem}_{name.replace(', ', '_').replace(' ', '_')}.png"
            K.io.write_image(options.out / file, label(model, picture, device))
    draw(curves, options.out / "curves.png")
    if pictures:
        print(f"the labels of your photographs are in {options.out}")
    print(f"the figure is {options.out / 'curves.png'}")
    return {name: curve[-1] for name, curve in curves.items()}


if __name__ == "__main__":
    main()
