"""Train a classifier on any number of processes, machines and GPUs, with kvision's augmentation and losses.

    python examples/train_distributed.py                                                 one process, synthetic images
    torchrun --nproc-per-node 2 examples/train_distributed.py --device cpu               two CPU processes
    torchrun --nproc-per-node gpu examples/train_distributed.py --model resnet50         one process for each GPU of this machine
    torchrun --nnodes 4 --nproc-per-node gpu --rdzv-backend c10d --rdzv-endpoint HOST:29500 examples/train_distributed.py ...
    ... --data FOLDER                          your own images, FOLDER/CLASS/NAME.jpg
    ... --checkpoint FOLDER                    save every so many steps, and continue from there when started again

Gradients are averaged by DistributedDataParallel, over NCCL on GPUs and gloo on CPUs. Every rank augments its own part of the batch
on its own device, with its own stream of random numbers; with --seed-samples the numbers are functions of the epoch and the image
instead, and a batch is augmented alike on any number of ranks. A checkpoint has the parameters, the state of the optimizer and all
generators: a run that was killed, also in a single rank, gives the same losses when it is started again with the same number of
ranks. On GPUs this also takes --deterministic. FOLDER must be seen by all machines. torchrun starts the ranks again itself with
--max-restarts 3; set TORCH_DISABLE_SHARE_RDZV_TCP_STORE=1 then, or the new ranks look for the old ones (seen with torch 2.13).

The program prints images a second, of all ranks and of each, and the share of the time that augmentation takes.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import functools
import math
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
import torch.distributed.nn  # before the process group exists: see process_group
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader, Dataset, Sampler

import kvision as K
import kvision.augmentation as A
from kvision.demo.arguments import device_of, make_folder, require
from kvision.demo.workers import exit_with_parent

MEAN, STD = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
TEXTURES = ("stripes", "checks", "rings", "dots")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
WARM_UP, MOMENTUM, DECAY = 0.05, 0.9, 1e-4  # share of the steps; of SGD; of the weights

# --- images -------------------------------------------------------------------------------------------------------


class Order(Sampler[list[int]]):
    """The indices of this rank's part of each batch, from step `first` to `last`.

    Each epoch has an order of its own, the same on all ranks; a batch of all ranks together is the next piece of it. Nothing here
    has a state, so that a run may continue at any step.
    """

    def __init__(self, count: int, batch: int, seed: int, first: int, last: int) -> None:
        self.count, self.batch, self.seed, self.steps = count, batch, seed, range(first, last)
        self.each_epoch = count // (batch * dist.get_world_size())

    def __len__(self) -> int:
        return len(self.steps)

    def __iter__(self) -> Iterator[list[int]]:
        for step in self.steps:
            epoch, number = divmod(step, self.each_epoch)
            start = (number * dist.get_world_size() + dist.get_rank()) * self.batch
            yield permutation(self.count, self.seed, epoch)[start : start + self.batch].tolist()

    def seeds(self, step: int, indices: Tensor) -> Tensor:
        """Of the samples: another one for each image in each epoch."""
        return indices + (step // self.each_epoch) * self.count + (self.seed << 40)


@functools.lru_cache(1)
def permutation(count: int, seed: int, epoch: int) -> Tensor:
    return torch.randperm(count, generator=torch.Generator().manual_seed((seed << 20) + epoch))


class Textures:
    """Synthetic images, uint8 (3, size, size), in the memory of the device. The class is the kind of texture."""

    classes = TEXTURES

    def __init__(self, count: int, size: int, device: torch.device, seed: int = 0) -> None:
        generator = torch.Generator().manual_seed(seed)
        self.labels = torch.arange(count) % len(TEXTURES)
        pictures = []
        y, x = torch.meshgrid(*[torch.linspace(-1, 1, size)] * 2, indexing="ij")
        for label in self.labels.tolist():
            angle, frequency, *shift = torch.rand(4, generator=generator).tolist()
            angle, frequency = math.pi * angle, 12 + 20 * frequency
            u = frequency * (math.cos(angle) * x + math.sin(angle) * y) + 6 * shift[0]
            v = frequency * (math.cos(angle) * y - math.sin(angle) * x) + 6 * shift[1]
            wave = (u.sin(), u.sin().sign() * v.sin().sign(), torch.hypot(u, v).sin(), (u.sin() + v.sin() - 1).sign())
            dark, bright = torch.rand(2, 3, 1, 1, generator=generator)
            picture = 0.6 * dark + (0.5 + 0.5 * wave[label]) * (0.4 + 0.6 * bright - 0.6 * dark)
            noise = 0.1 * torch.randn(picture.shape, generator=generator)
            pictures.append((255 * (picture + noise).clamp(0, 1)).byte())
        # With channels last, so that a batch is channels_last.
        self.pixels = torch.stack(pictures).permute(0, 2, 3, 1).contiguous().to(device)
        self.labels = self.labels.to(device)

    def __len__(self) -> int:
        return len(self.labels)

    def batches(self, order: Order, device: torch.device, workers: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        for indices in map(torch.tensor, order):
            on_device = indices.to(device, non_blocking=True)
            yield self.pixels[on_device].permute(0, 3, 1, 2), self.labels[on_device], on_device


class Folder(Dataset[tuple[Tensor, int, int]]):
    """Images of FOLDER/CLASS, uint8 (3, size, size): the square in the middle. The processes of a DataLoader decode them."""

    def __init__(self, folder: Path, size: int) -> None:
        self.size = size
        self.classes = tuple(sorted(path.name for path in folder.iterdir() if path.is_dir()))
        self.files = [
            (path, label)
            for label, name in enumerate(self.classes)
            for path in sorted((folder / name).rglob("*"))
            if path.suffix.lower() in SUFFIXES
        ]

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> tuple[Tensor, int, int]:
        path, label = self.files[index]
        picture = K.io.load_image(path)[None]
        square = K.geometry.center_crop(K.geometry.resize(picture, self.size, antialias=True), (self.size, self.size))
        return (255 * square[0]).round().byte(), label, index

    def batches(self, order: Order, device: torch.device, workers: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        loader = DataLoader(
            self,
            batch_sampler=order,
            num_workers=workers,
            worker_init_fn=exit_with_parent,
            pin_memory=device.type == "cuda",
        )
        for batch in loader:
            yield tuple(x.to(device, non_blocking=True) for x in batch)


class Augmentation(nn.Module):
    """Random resized crop, flip and color jitter of uint8 images, normalized, in `dtype`."""

    def __init__(self, size: int, dtype: torch.dtype, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.dtype = dtype
        self.steps = A.ImageSequential(
            A.RandomResizedCrop((size, size)),
            A.RandomHorizontalFlip(),
            A.ColorJitter(0.2, 0.2, 0.2, 0.1, p=1.0),
            A.Normalize(MEAN, STD),
            generator=generator,
        )

    def forward(self, pictures: Tensor, seed: Tensor | None = None) -> Tensor:
        unit = torch.mul(pictures, 1 / 255, out=torch.empty_like(pictures, dtype=self.dtype))
        return self.steps(unit) if seed is None else self.steps(unit, seed=seed)


# --- network --------------------------------------------------------------------------------------------------------


class Block(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut. No sample depends on the others of its batch, which several ranks share."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.norm1, self.norm2 = nn.GroupNorm(8, outputs), nn.GroupNorm(8, outputs)
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.shortcut = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.GroupNorm(8, outputs))

    def forward(self, x: Tensor) -> Tensor:
        return (self.shortcut(x) + self.norm2(self.second(self.norm1(self.first(x)).relu()))).relu()


def network(name: str, classes: int) -> nn.Module:
    """torchvision's ResNet-50, or a residual network of seven convolutions, which needs no GPU and no torchvision."""
    if name == "resnet50":
        from torchvision.models import resnet50

        return resnet50(num_classes=classes)
    stem = nn.Conv2d(3, 16, 7, 4, 3, bias=False), nn.GroupNorm(8, 16), nn.ReLU()
    blocks = Block(16, 16, 1), Block(16, 32, 2), Block(32, 64, 2)
    return nn.Sequential(*stem, *blocks, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(64, classes))


# --- training -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setup:
    """What to train, on what. `batch` is of one rank; `each` is the number of steps between lines and checkpoints."""

    device: torch.device
    model: str = "small"
    batch: int = 32
    steps: int = 200
    each: int = 20
    size: int = 256
    crop: int = 224
    rate: float = 0.1
    seed: int = 0
    workers: int = 2
    augment: bool = True
    seed_samples: bool = False

    @property
    def dtype(self) -> torch.dtype:
        """Of the images. The network computes in bfloat16 on a GPU."""
        return torch.float16 if self.device.type == "cuda" else torch.float32


@dataclass(frozen=True)
class Report:
    """Of the last steps: mean loss, images a second of each rank, the largest share of time in augmentation of a rank."""

    step: int
    loss: float
    rates: list[float]
    share: float


class Stopwatch:
    """Seconds between marks: of the device by events, which do not make the host wait, or of the clock on a CPU."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.pairs = device, []

    def now(self) -> Any:
        if self.device.type == "cpu":
            return time.perf_counter()
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        return event

    @contextlib.contextmanager
    def lap(self) -> Iterator[None]:
        begin = self.now()
        yield
        self.pairs.append((begin, self.now()))

    def seconds(self) -> float:
        """Of all laps since the last call. Waits for the device."""
        pairs, self.pairs = self.pairs, []
        if self.device.type == "cpu":
            return sum(end - begin for begin, end in pairs)
        torch.cuda.synchronize(self.device)
        return sum(begin.elapsed_time(end) for begin, end in pairs) * 1e-3


class Training:
    """Network, optimizer and generators of one rank, and the losses of all steps so far."""

    def __init__(self, setup: Setup, pictures: Textures | Folder) -> None:
        self.setup, self.pictures, self.step, self.losses = setup, pictures, 0, []
        torch.manual_seed(setup.seed)
        model = network(setup.model, len(pictures.classes)).to(setup.device, memory_format=torch.channels_last)
        on_gpu = setup.device.type == "cuda"
        self.model = DistributedDataParallel(
            model, [setup.device.index] if on_gpu else None, gradient_as_bucket_view=True
        )
        self.optimizer = torch.optim.SGD(model.parameters(), setup.rate, MOMENTUM, weight_decay=DECAY, nesterov=True)
        self.generator = torch.Generator(setup.device)
        self.augment = Augmentation(setup.crop, setup.dtype, self.generator)
        self.seed_streams()

    def seed_streams(self) -> None:
        """Give each rank random numbers of its own, for augmentation and for layers such as dropout."""
        torch.manual_seed(((self.setup.seed << 20) + self.step << 20) + dist.get_rank())
        self.generator.manual_seed(torch.initial_seed() ^ (1 << 62))

    def rate(self) -> float:
        """The learning rate of this step: a linear warm-up, then half of a cosine."""
        done = (self.step + 1) / self.setup.steps
        return self.setup.rate * min(done / WARM_UP, 0.5 + 0.5 * math.cos(math.pi * min(1.0, done)))

    def loss(self, images: Tensor, labels: Tensor) -> Tensor:
        with torch.autocast(images.device.type, torch.bfloat16, enabled=images.is_cuda):
            logits = self.model(images)
        return K.losses.focal_loss(logits.float(), labels, alpha=None, reduction="sum") / len(labels)

    def run(self) -> Iterator[Report]:
        """Train to the last step; a report every `each` steps."""
        setup = self.setup
        order = Order(len(self.pictures), setup.batch, setup.seed, self.step, setup.steps)
        whole, augmentation, recent = Stopwatch(setup.device), Stopwatch(setup.device), []
        begin, fixed = whole.now(), None
        for pictures, labels, indices in self.pictures.batches(order, setup.device, setup.workers):
            if setup.augment or fixed is None:  # without augmentation, one batch again and again
                with augmentation.lap():
                    seeds = order.seeds(self.step, indices) if setup.seed_samples else None
                    fixed = self.augment(pictures, seeds)
            for group in self.optimizer.param_groups:
                group["lr"] = self.rate()
            loss = self.loss(fixed, labels)
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()
            self.optimizer.step()
            recent.append(loss.detach())
            self.step += 1
            if self.step % setup.each == 0 or self.step == setup.steps:
                whole.pairs.append((begin, whole.now()))
                yield self.report(recent, whole.seconds(), augmentation.seconds())
                begin, recent = whole.now(), []

    def report(self, recent: list[Tensor], seconds: float, augmentation: float) -> Report:
        """What all ranks know together."""
        numbers = torch.tensor([len(recent) * self.setup.batch / seconds, augmentation / seconds])
        own = torch.cat([torch.stack(recent).cpu(), numbers]).to(self.setup.device)
        all_ranks = [torch.empty_like(own) for _ in range(dist.get_world_size())]
        dist.all_gather(all_ranks, own)
        table = torch.stack(all_ranks).cpu().double()
        self.losses += table[:, :-2].mean(0).tolist()
        mean = sum(self.losses[-len(recent) :]) / len(recent)
        return Report(self.step, mean, table[:, -2].tolist(), float(table[:, -1].max()))

    # A checkpoint is one file, which is replaced in one step of the file system: a killed run leaves the old one or the new one.

    def save(self, folder: Path) -> None:
        state = {"default": torch.get_rng_state(), "augmentation": self.generator.get_state()}
        if self.setup.device.type == "cuda":
            state["device"] = torch.cuda.get_rng_state(self.setup.device)
        streams: list[Any] = [None] * dist.get_world_size()
        dist.all_gather_object(streams, state)
        if dist.get_rank() != 0:
            return
        folder.mkdir(parents=True, exist_ok=True)
        model = self.model.module.state_dict()
        checkpoint = {"model": model, "optimizer": self.optimizer.state_dict(), "streams": streams}
        torch.save({**checkpoint, "step": self.step, "losses": self.losses}, folder / "checkpoint.tmp")
        os.replace(folder / "checkpoint.tmp", folder / "checkpoint.pt")

    def load(self, folder: Path) -> str:
        """Continue from the checkpoint, if there is one. Says what was found."""
        path = folder / "checkpoint.pt"
        if not path.exists():
            return ""
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
        self.model.module.load_state_dict(checkpoint["model"])
        self.optimizer.load_state_dict(checkpoint["optimizer"])
        self.step, self.losses = checkpoint["step"], checkpoint["losses"]
        streams, ranks = checkpoint["streams"], dist.get_world_size()
        if len(streams) != ranks:
            self.seed_streams()
            return (
                f"continued at step {self.step}, on {ranks} ranks instead of {len(streams)}: random numbers are others"
            )
        own = streams[dist.get_rank()]
        torch.set_rng_state(own["default"])
        self.generator.set_state(own["augmentation"])
        if "device" in own:
            torch.cuda.set_rng_state(own["device"], self.setup.device)
        return f"continued at step {self.step}"


@contextlib.contextmanager
def process_group(device: torch.device) -> Iterator[None]:
    """The processes that torchrun started, or this one alone.

    torch.distributed.nn has the process group of its import as default arguments. DistributedDataParallel imports it, and if
    that is the first import, the group outlives its destruction: a thread of gloo that lets go of a tensor while Python
    ends then aborts the process (seen with torch 2.13).
    """
    backend, own = ("nccl", device) if device.type == "cuda" else ("gloo", None)
    if own:
        torch.cuda.set_device(own)
    if "RANK" in os.environ:
        dist.init_process_group(backend, device_id=own)
    else:
        dist.init_process_group(backend, store=dist.HashStore(), rank=0, world_size=1, device_id=own)
    try:
        yield
    finally:
        dist.destroy_process_group()


# --- the run --------------------------------------------------------------------------------------------------------


def pictures_of(parser: argparse.ArgumentParser, options: argparse.Namespace, device: torch.device) -> Any:
    """The images to train on; too few of them end the program in one line."""
    global_batch = options.batch * dist.get_world_size()
    if options.data is None:
        return Textures(max(options.count, global_batch), options.size, device)
    pictures = Folder(options.data, options.size) if options.data.is_dir() else ()
    if len(pictures) < global_batch or len(pictures.classes) < 2:
        parser.error(
            f"--data {options.data}: expected a folder with {global_batch} images or more in a folder of each class, got "
            f"{len(pictures)} in {len(getattr(pictures, 'classes', ()))}"
        )
    return pictures


def write_losses(losses: list[float], path: Path) -> None:
    with path.with_suffix(".tmp").open("w", newline="") as file:
        csv.writer(file).writerows([("step", "loss"), *enumerate(losses, 1)])
    os.replace(path.with_suffix(".tmp"), path)


def train(setup: Setup, pictures: Textures | Folder, options: argparse.Namespace) -> None:
    """Train, print, and write losses and checkpoints.

    The network must be gone before its process group is destroyed: what is left of DistributedDataParallel would destroy it
    later, holding Python's lock, and wait for a thread of gloo that waits for that lock (seen with torch 2.13).
    """
    training = Training(setup, pictures)
    first = dist.get_rank() == 0
    loaded = training.load(options.checkpoint) if options.checkpoint else ""
    if first:
        backend = dist.get_backend()
        print(
            f"{dist.get_world_size()} ranks by {backend}, {options.model}, {options.batch} images a rank",
            flush=True,
        )
        print(loaded, end="\n" if loaded else "", flush=True)
    for report in training.run():
        if options.checkpoint:
            training.save(options.checkpoint)
        if first:
            write_losses(training.losses, options.out / "losses.csv")
            done = 20 * report.step // options.steps
            print(
                f"[{'#' * done:20}] step {report.step:{len(str(options.steps))}}/{options.steps} loss {report.loss:.4f} "
                f"{sum(report.rates):8.0f} images/s in all, a rank {min(report.rates):.0f} to {max(report.rates):.0f}, "
                f"augmentation {report.share:.1%} of the time",
                flush=True,
            )
    if first:
        print(f"losses are in {options.out / 'losses.csv'}")
        if options.checkpoint:
            print(f"the checkpoint is {options.checkpoint / 'checkpoint.pt'}")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of images, in a folder for each class; default: synthetic")
    parser.add_argument("--count", type=int, default=512, help="of synthetic images")
    parser.add_argument("--size", type=int, default=256, help="of the images, before augmentation")
    parser.add_argument("--crop", type=int, default=224, help="of the images, after it")
    parser.add_argument("--model", choices=("small", "resnet50"), default="small", help="resnet50 is torchvision's")
    parser.add_argument("--batch", type=int, default=32, help="of each rank")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--rate", type=float, default=0.1, help="largest learning rate")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seed-samples", action="store_true", help="augment an image alike on any number of ranks")
    parser.add_argument(
        "--deterministic", action="store_true", help="use only algorithms that give the same bits again"
    )
    parser.add_argument("--checkpoint", type=Path, metavar="FOLDER", help="save to it, and continue from it")
    parser.add_argument("--every", type=int, default=20, help="steps between two lines, and checkpoints")
    parser.add_argument("--workers", type=int, default=2, help="processes that decode images, for each rank")
    parser.add_argument("--out", type=Path, default=Path("out/train"), help="where losses.csv goes")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device, int(os.environ.get("LOCAL_RANK", 0)))
    if options.model == "resnet50":
        require(parser, "torchvision")
    make_folder(parser, options.out)
    if options.deterministic:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        torch.use_deterministic_algorithms(True)
    torch.backends.cudnn.benchmark = not options.deterministic
    setup = Setup(
        device=device,
        model=options.model,
        batch=options.batch,
        steps=options.steps,
        each=options.every,
        size=options.size,
        crop=options.crop,
        rate=options.rate,
        seed=options.seed,
        workers=options.workers,
        seed_samples=options.seed_samples,
    )
    with process_group(device):
        train(setup, pictures_of(parser, options, device), options)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
