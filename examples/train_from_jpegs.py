"""Train on a folder of photographs: workers read files, the device decodes and augments them.

    python examples/train_from_jpegs.py FOLDER                                  classes are folders: FOLDER/cat/1.jpg
    python examples/train_from_jpegs.py FOLDER --device cuda --batch 256 --workers 8 --epochs 10
    python examples/train_from_jpegs.py                                         on pictures that the program makes

Photographs have sizes of their own, so a worker would have to decode and crop each of them before it can send a batch. Here workers
send the bytes of files, one tensor a batch. Two threads decode the next batches, on CUDA streams of their own, by nvJPEG where
torchcodec or torchvision is installed, while the network learns from the one before. A file that cannot be decoded is left out
with its label. The program prints the loss, the accuracy and the images a second of each epoch, and writes OUT/model.pt.
"""

from __future__ import annotations

import argparse
import functools
import os
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

import kvision as K
import kvision.augmentation as A
from kvision.demo.arguments import device_of, make_folder, require
from kvision.demo.workers import exit_with_parent

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

Photographs = tuple[list[Tensor], Tensor]  # images and labels

# --- files ----------------------------------------------------------------------------------------------------------


class Files(NamedTuple):
    """A batch of files, one behind the other, which a process sends as one block of memory."""

    content: Tensor
    sizes: list[int]
    labels: Tensor


class Folder(Dataset[tuple[Tensor, int]]):
    """The bytes of FOLDER/CLASS/FILE and the number of the class."""

    def __init__(self, folder: Path) -> None:
        self.classes = sorted(path.name for path in folder.iterdir() if path.is_dir())
        self.files = [
            (path, label)
            for label, name in enumerate(self.classes)
            for path in sorted((folder / name).rglob("*"))
            if path.suffix.lower() in SUFFIXES
        ]

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> tuple[Tensor, int]:
        path, label = self.files[index]
        return torch.from_numpy(np.fromfile(path, np.uint8)), label


def collate(samples: list[tuple[Tensor, int]]) -> Files:
    files, labels = zip(*samples)
    return Files(torch.cat(files), [len(file) for file in files], torch.tensor(labels))


# --- decoding ahead -------------------------------------------------------------------------------------------------


class Decoder:
    """Files to photographs: lists of images of their own sizes, and labels."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.local, self.left_out = device, threading.local(), 0

    def ahead(self, batches: Iterable[Files]) -> Iterator[Photographs]:
        """The photographs of each batch, while two threads decode the next ones.

        A batch belongs to the loop until it asks for the next one. A thread waits for the device to be done with the memory that it
        may take again; `Tensor.record_stream` would do it by an event of each image, which takes longer than to decode them.
        """
        used: torch.cuda.Event | None = None
        with ThreadPoolExecutor(2) as pool:
            futures: deque[Future[tuple[Photographs, torch.cuda.Event | None]]] = deque()
            for files in batches:
                if len(futures) == 2:
                    yield self.ready(futures.popleft())
                    used = None if self.device.type == "cpu" else torch.cuda.current_stream(self.device).record_event()
                futures.append(pool.submit(self.on_a_stream, files, used))
            while futures:
                yield self.ready(futures.popleft())

    def ready(self, future: Future[tuple[Photographs, torch.cuda.Event | None]]) -> Photographs:
        photographs, decoded = future.result()
        if decoded is not None:
            torch.cuda.current_stream(self.device).wait_event(decoded)
        return photographs

    def on_a_stream(self, files: Files, used: torch.cuda.Event | None) -> tuple[Photographs, torch.cuda.Event | None]:
        """Each thread has a stream of its own."""
        if self.device.type == "cpu":
            return self.decoded(files), None
        if not hasattr(self.local, "stream"):
            self.local.stream = torch.cuda.Stream(self.device)
        if used is not None:
            used.synchronize()
        with torch.cuda.stream(self.local.stream):
            return self.decoded(files), self.local.stream.record_event()

    def decoded(self, files: Files) -> Photographs:
        images = K.io.decode(files.content.split(files.sizes), self.device, errors="skip")
        kept = [i for i, image in enumerate(images) if image is not None]
        self.left_out += len(images) - len(kept)
        return [images[i] for i in kept], files.labels[kept].to(self.device)


# --- training -------------------------------------------------------------------------------------------------------


def augmentation(size: int) -> A.ImageSequential:
    """A list of photographs of any sizes to a batch (B, 3, size, size)."""
    return A.ImageSequential(
        A.RandomResizedCrop((size, size), scale=(0.3, 1.0), antialias=True),
        A.RandomHorizontalFlip(),
        A.ColorJitter(0.2, 0.2, 0.2, 0.1),
        A.Normalize(MEAN, STD),
        output_dtype=torch.float32,
    )


def network(classes: int) -> nn.Module:
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 16), (16, 32), (32, 64)):
        layers += [nn.Conv2d(inputs, outputs, 5, 2, 2), nn.BatchNorm2d(outputs), nn.ReLU()]
    return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, classes))


@dataclass(frozen=True)
class Epoch:
    loss: float
    accuracy: float
    images_per_second: float


def train(dataset: Folder, model: nn.Module, device: torch.device, options: argparse.Namespace) -> list[Epoch]:
    from tqdm import tqdm

    loader = DataLoader(
        dataset,
        batch_size=options.batch,
        shuffle=True,
        collate_fn=collate,
        num_workers=options.workers,
        worker_init_fn=exit_with_parent,
        persistent_workers=options.workers > 0,
        multiprocessing_context="forkserver" if options.workers else None,  # without the threads of this process
    )
    augment, decoder = augmentation(options.size), Decoder(device)
    optimizer = torch.optim.AdamW(model.parameters(), 1e-3)
    epochs = []
    for number in range(options.epochs):
        totals, count, begin = torch.zeros(2, device=device), 0, time.perf_counter()
        with tqdm(total=len(dataset), unit=" images", desc=f"epoch {number + 1}", leave=False) as bar:
            for images, labels in decoder.ahead(loader):
                if images:
                    scores = model(augment(images))
                    loss = F.cross_entropy(scores, labels)
                    optimizer.zero_grad()
                    loss.backward()
                    optimizer.step()
                    totals += torch.stack([loss.detach() * len(images), (scores.argmax(1) == labels).sum()])
                    count += len(images)
                bar.update(len(images))
        loss_sum, right = totals.tolist()  # waits for the device
        epoch = Epoch(loss_sum / max(count, 1), right / max(count, 1), count / (time.perf_counter() - begin))
        print(
            f"epoch {number + 1}: loss {epoch.loss:.3f}, accuracy {epoch.accuracy:.0%}, "
            f"{epoch.images_per_second:.0f} images/s"
        )
        epochs.append(epoch)
    if decoder.left_out:
        print(f"left out, because they cannot be decoded: {decoder.left_out} files, of all epochs")
    return epochs


# --- pictures of the program's own ----------------------------------------------------------------------------------


def make_pictures(folder: Path, count: int = 64) -> None:
    """Stripes and rings of random colors, as JPEG files of random sizes."""
    generator = torch.Generator().manual_seed(0)
    draw = functools.partial(torch.rand, generator=generator)
    for number in range(count):
        height, width = (96 + 160 * draw(2)).int().tolist()
        y, x = torch.meshgrid(torch.arange(height) / 24, torch.arange(width) / 24, indexing="ij")
        angle, speed = (3.14 * draw(1)).item(), (2 + 3 * draw(1)).item()
        name, phase = (
            ("stripes", x * np.cos(angle) + y * np.sin(angle)) if number % 2 else ("rings", torch.hypot(x - 3, y - 3))
        )
        wave, colors = 0.5 + 0.5 * torch.sin(speed * phase), draw(2, 3, 1, 1)
        (folder / name).mkdir(parents=True, exist_ok=True)
        K.io.write_image(folder / name / f"{number}.jpg", colors[0] * wave + colors[1] * (1 - wave))


def main(arguments: list[str] | None = None) -> list[Epoch]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="folder of folders of images; default: made pictures")
    parser.add_argument("--out", type=Path, default=Path("out/train_from_jpegs"), help="default: %(default)s")
    parser.add_argument("--size", type=int, default=160, help="of the crops; default: %(default)s")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--workers", type=int, default=min(4, os.cpu_count() or 1), help="processes that read files")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    require(parser, "tqdm")
    make_folder(parser, options.out)
    folder = options.folder or options.out / "pictures"
    if options.folder is None:
        make_pictures(folder)
    if not folder.is_dir():
        parser.error(f"{folder}: expected a folder of folders of images, there is none")
    dataset = Folder(folder)
    if not len(dataset):
        parser.error(f"{folder}: expected images in folders of their classes, found none")
    torch.manual_seed(0)
    model = network(len(dataset.classes)).to(device)
    epochs = train(dataset, model, device, options)
    torch.save({"classes": dataset.classes, "model": model.state_dict()}, options.out / "model.pt")
    print(f"the network is in {options.out / 'model.pt'}")
    return epochs


if __name__ == "__main__":
    main()
