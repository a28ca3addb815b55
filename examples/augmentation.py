"""Augment the images of a training loop: in the workers of a DataLoader, or whole batches on the device that trains.

    python examples/augmentation.py                        windows of scikit-image's photographs
    python examples/augmentation.py --image PHOTO...       of your own
    python examples/augmentation.py --workers 8 --batch 256 --device cuda

First the chain of the Kornia paper: a torch.nn.Sequential of augmentations that returns the product of their matrices, by which the
images are moved back. Then a small network learns which photograph a window is from, once without augmentation, once with
every sample augmented by the worker that loads it, and once with every batch augmented on the device. Seeds of samples give the
same images either way. The program prints images a second, and writes the chain, a sheet of draws and a batch as images.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

import kvision as K
import kvision.augmentation as A
from kvision.demo.arguments import device_of, images_of, make_folder, require
from kvision.demo.workers import exit_with_parent

WINDOW, CROP = 224, 160
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

# --- the chain of the paper -----------------------------------------------------------------------------------------


def chain() -> nn.Sequential:
    return nn.Sequential(
        A.RandomVerticalFlip(p=0.5, return_transform=True),
        A.RandomAffine(30.0, (0.1, 0.1), (0.8, 1.1), p=1.0, return_transform=True),
        A.ColorJitter(0.2, 0.3, 0.3, 0.1, return_transform=True),
    )


def move_back(augmented: Tensor, matrices: Tensor) -> Tensor:
    return K.geometry.warp_perspective(augmented, torch.linalg.inv(matrices), tuple(augmented.shape[2:]))


# --- a training loop ------------------------------------------------------------------------------------------------


def pipeline() -> A.ImageSequential:
    return A.ImageSequential(
        A.RandomResizedCrop((CROP, CROP), scale=(0.3, 1.0)),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize(MEAN, STD),
    )


def without_augmentation() -> A.ImageSequential:
    return A.ImageSequential(A.CenterCrop((CROP, CROP)), A.Normalize(MEAN, STD))


class Windows(Dataset[tuple[Tensor, int, int]]):
    """Windows of photographs, uint8 (3, WINDOW, WINDOW), each with the number of its photograph and its seed.

    With `augment` the worker augments them, and they are float32 (3, CROP, CROP).
    """

    def __init__(self, photographs: list[Tensor], count: int, augment: nn.Module | None = None) -> None:
        self.photographs, self.count, self.augment, self.epoch = photographs, count, augment, 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> tuple[Tensor, int, int]:
        label = index % len(self.photographs)
        photograph = self.photographs[label]
        generator = torch.Generator().manual_seed(index)
        top, left = (int(torch.randint(n - WINDOW + 1, (1,), generator=generator)) for n in photograph.shape[1:])
        window = photograph[:, top : top + WINDOW, left : left + WINDOW]
        seed = self.epoch * self.count + index  # another one in each epoch
        if self.augment is not None:
            window = self.augment(unit(window[None]), seed=torch.tensor([seed]))[0]
        return window, label, seed


def unit(images: Tensor) -> Tensor:
    return images.float() / 255


def network(classes: int) -> nn.Module:
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 12), (12, 16), (16, 24)):
        layers += [nn.Conv2d(inputs, outputs, 5, stride=3, padding=2), nn.GroupNorm(4, outputs), nn.ReLU()]
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(24, classes))


@dataclass
class Result:
    """Images a second, the fraction of correct answers in the last quarter of the steps, and the last batch of the network."""

    rate: float
    correct: float
    images: Tensor


def train(name: str, windows: Windows, augment: nn.Module | None, options: argparse.Namespace) -> Result:
    """Epochs of a new network; `augment` gets whole batches on the device, unless the windows augment themselves."""
    from tqdm import tqdm

    device = options.device
    model = network(len(windows.photographs)).to(device)
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    loader = DataLoader(
        windows,
        options.batch,
        num_workers=options.workers,
        worker_init_fn=exit_with_parent,
        pin_memory=device.type == "cuda",
        persistent_workers=False,  # they read the number of the epoch when they start
    )
    correct, seen, start = [], 0, 0.0
    with tqdm(total=options.epochs * len(loader), desc=f"{name:28}", unit="batch", leave=False) as bar:
        for windows.epoch in range(options.epochs):
            for step, (images, labels, seeds) in enumerate(loader):
                images, labels = images.to(device, non_blocking=True), labels.to(device, non_blocking=True)
                if augment is not None:
                    images = augment(unit(images), seed=seeds.to(device, non_blocking=True))
                optimizer.zero_grad()
                predicted = model(images)
                F.cross_entropy(predicted, labels).backward()
                optimizer.step()
                correct.append((predicted.argmax(1) == labels).float().mean())
                if windows.epoch == 0 and step == 0:  # the first batch starts the workers and warms up
                    wait(device)
                    start = time.perf_counter()
                else:
                    seen += len(images)
                bar.update()
        wait(device)
    rate = seen / (time.perf_counter() - start) if seen else float("nan")
    last = torch.stack(correct[-max(1, len(correct) // 4) :]).mean()
    return Result(rate, float(last), images.detach())


def rate_alone(batch: Tensor, size: int) -> float:
    """Images a second of the augmentation alone, `size` in a call."""
    augment, parts = pipeline(), batch.split(size)
    augment(parts[0])
    rounds, start = 0, 0.0
    while rounds < 4 or time.perf_counter() - start < 0.5:
        if rounds == 1:  # the first one warms up
            wait(batch.device)
            start = time.perf_counter()
        for part in parts:
            augment(part)
        rounds += 1
    wait(batch.device)
    return (rounds - 1) * len(batch) / (time.perf_counter() - start)


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


# --- the run --------------------------------------------------------------------------------------------------------


def photographs_of(parser: argparse.ArgumentParser, paths: list[Path]) -> list[Tensor]:
    """Photographs, uint8 (3, H, W), their shorter side 320; a file that cannot be read ends the program in one line."""
    pictures = [image[0] for image in images_of(parser, paths)]
    if not paths:
        require(parser, "skimage")
        pictures = K.io.get_sample_images()
    scaled = [K.geometry.resize(picture[None], 320, antialias=True)[0] for picture in pictures]
    return [(255 * picture).round().clamp(0, 255).byte() for picture in scaled]


def main(arguments: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path, nargs="+", default=[], help="your own photographs")
    parser.add_argument("--workers", type=int, default=2, help="processes that load (default 2)")
    parser.add_argument("--batch", type=int, default=32, help="windows in a batch (default 32)")
    parser.add_argument("--windows", type=int, default=512, help="windows in an epoch (default 512)")
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/augmentation"), help="where the images go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    for name in ("batch", "windows", "epochs"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} {getattr(options, name)}: expected a positive number")
    if options.workers < 0:
        parser.error(f"--workers {options.workers}: expected 0 or more")
    options.device = device_of(parser, options.device)
    photographs = photographs_of(parser, options.image)
    require(parser, "tqdm")
    make_folder(parser, options.out)

    torch.manual_seed(0)
    images = torch.stack([unit(Windows(photographs, 4)[i][0]) for i in range(4)]).to(options.device)
    augmented, matrices = chain()(images)
    rows = torch.cat([images, augmented, move_back(augmented, matrices)])
    K.io.write_image(options.out / "chain.png", K.image.make_grid(rows, n_row=4, padding=8))
    A.preview(pipeline(), unit(photographs[0]), file=options.out / "draws.png")

    ways = {
        "no augmentation": (None, without_augmentation()),
        "each sample in its worker": (pipeline(), None),
        f"the batch on {options.device.type}": (None, pipeline()),
    }
    results = {}
    for name, (of_samples, of_batches) in ways.items():
        results[name] = train(name, Windows(photographs, options.windows, of_samples), of_batches, options)
        print(f"{name:28} {results[name].rate:8.0f} images/s   {results[name].correct:6.1%} correct", flush=True)
    windows = Windows(photographs, options.batch)
    batch = unit(torch.stack([window for window, _, _ in map(windows.__getitem__, range(options.batch))])).to(
        options.device
    )
    print(
        f"the augmentation alone: {rate_alone(batch, len(batch)):.0f} images/s in batches, {rate_alone(batch, 1):.0f} one by one"
    )
    by_sample, by_batch = (result.images.cpu() for result in list(results.values())[1:])
    print(f"largest difference between samples and batches: {(by_sample - by_batch).abs().max():.1g}")
    shown = A.Denormalize(MEAN, STD)(by_batch[:16]).clamp(0, 1)
    K.io.write_image(options.out / "batch.png", K.image.make_grid(shown, n_row=4, padding=8))
    print(f"the chain, draws and a batch are images in {options.out}")
    return {name: result.rate for name, result in results.items()}


if __name__ == "__main__":
    main()
