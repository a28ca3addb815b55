"""`python -m benchmarks.scaling`: augmentation and training on 1, 2, 4 and 8 GPUs of one host, or on CPU processes.

For each number of ranks, every rank a process: images a second of pipeline A (random resized crop, flip, color jitter and
normalization of uint8 images to float16) alone, and of examples/train_distributed.py without and with it; efficiency is the
rate over that of as many single ranks. Then what must not depend on the number of ranks: the augmented batch with seeds of
its samples, bit by bit, and the losses of a training. Last, every case of these benchmarks on a device that is not the
current one, and on all devices from several threads at once, bit by bit against the first device. No tensor goes from one
GPU to another there, so that torch never enables peer access. Writes scaling.txt, scaling.json and scaling.svg.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import math
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
import torch.distributed as dist
import torch.multiprocessing
from torch import Tensor
from tqdm import tqdm

from benchmarks import machine
from benchmarks.cases import ALL
from benchmarks.measure import tensors_of

EXAMPLE = Path(__file__).parents[1] / "examples" / "train_distributed.py"
TOGETHER = 64  # images of the batch that is the same on any number of ranks
STEPS = 20  # of the training whose losses are compared
HANGS = 120  # seconds after which a rank that waits for the others ends with an error that names what it waited for
SMALL = (2, 3, 96, 128)  # images of the cases on several devices
# Bars: efficiency of augmentation alone; of training, over that without augmentation; share of time in augmentation.
ALONE, TRAINING, SHARE = 0.98, 0.95, 0.03


@dataclass(frozen=True)
class Options:
    """What every rank measures."""

    device: str
    model: str
    batch: int
    count: int  # of the images, the same for any number of ranks
    size: int
    crop: int
    seconds: float


@dataclass(frozen=True)
class Row:
    """The figures of a number of ranks: images a second of all, except `slowest`, the slowest rank's in augmentation alone."""

    ranks: int
    alone: float
    slowest: float
    without: float
    augmented: float
    share: float
    digest: str
    losses: list[float]


def example() -> ModuleType:
    """examples/train_distributed.py"""
    spec = importlib.util.spec_from_file_location("train_distributed", EXAMPLE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses read their module from sys.modules
    spec.loader.exec_module(module)
    return module


# --- one rank -------------------------------------------------------------------------------------------------------


def work(rank: int, ranks: int, options: Options, folder: str) -> None:
    """What one process measures; the first one writes the row."""
    device = torch.device(options.device, rank) if options.device == "cuda" else torch.device("cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
        torch.backends.cudnn.benchmark = True
    torch.set_num_threads(1)  # as under torchrun; threads of several ranks that wait for each other take the cores
    progress = tqdm(desc=f"{ranks} rank{'s' * (ranks > 1)}", total=6, unit="figure", disable=rank > 0)

    def figure(name: str, measure: Callable[[], Any]) -> Any:
        """What `measure` gives; the bar says meanwhile what that is, so that a rank that hangs is seen where it does."""
        progress.set_postfix_str(name)
        result = measure()
        progress.update()
        return result

    figure("ranks join", partial(join, rank, ranks, device, folder))
    train = example()
    pictures = train.Textures(options.count, options.size, device)
    setup = train.Setup(device, options.model, options.batch, size=options.size, crop=options.crop)
    alone, slowest = figure("augmentation alone", partial(augmentation, train, setup, pictures, options.seconds))
    plain = replace(setup, augment=False)
    without, _ = figure("training without augmentation", partial(training, train, plain, pictures, options.seconds))
    augmented, share = figure("training", partial(training, train, setup, pictures, options.seconds))
    digested = figure("augmented bits", partial(digest, train, setup, pictures))
    row = Row(
        ranks,
        alone,
        slowest,
        without,
        augmented,
        share,
        digested,
        figure("losses", partial(losses, train, setup, pictures)),
    )
    progress.close()
    if rank == 0:
        Path(folder, f"{ranks}.json").write_text(json.dumps(asdict(row)))
    dist.destroy_process_group()


def join(rank: int, ranks: int, device: torch.device, folder: str) -> None:
    """Make this process one of the ranks."""
    backend, own = ("nccl", device) if device.type == "cuda" else ("gloo", None)
    store = dist.FileStore(f"{folder}/store{ranks}", ranks)
    dist.init_process_group(
        backend, store=store, rank=rank, world_size=ranks, device_id=own, timeout=timedelta(seconds=HANGS)
    )


def wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def whole(number: float, device: torch.device, operation: dist.ReduceOp.RedOpType) -> float:
    """The sum, the minimum or the maximum of the number over all ranks."""
    on_device = torch.tensor([number], dtype=torch.float64, device=device)
    dist.all_reduce(on_device, operation)
    return float(on_device)


def augmentation(train: ModuleType, setup: Any, pictures: Any, seconds: float) -> tuple[float, float]:
    """Images a second of all ranks together, and of the slowest one, while all of them augment."""
    device = setup.device
    augment = train.Augmentation(setup.crop, setup.dtype, torch.Generator(device).manual_seed(dist.get_rank()))
    batch = pictures.pixels[: setup.batch].permute(0, 3, 1, 2)

    def run(calls: int) -> float:
        wait(device)
        dist.barrier()
        begin = time.perf_counter()
        for _ in range(calls):
            augment(batch)
        wait(device)
        return time.perf_counter() - begin

    run(3)
    calls = math.ceil(10 * seconds / whole(run(10), device, dist.ReduceOp.MAX))
    times = [run(math.ceil(calls / 3)) for _ in range(3)]
    own = setup.batch * math.ceil(calls / 3) / statistics.median(times)
    return whole(own, device, dist.ReduceOp.SUM), whole(own, device, dist.ReduceOp.MIN)


def training(train: ModuleType, setup: Any, pictures: Any, seconds: float) -> tuple[float, float]:
    """Images a second of all ranks together, and the share of time in augmentation."""
    begin = time.perf_counter()
    for _ in train.Training(replace(setup, steps=6, each=3), pictures).run():  # the first steps choose algorithms
        first, begin = time.perf_counter() - begin, time.perf_counter()
    each = max(2, math.ceil(seconds / whole(first, setup.device, dist.ReduceOp.MAX)))  # a third of the time
    reports = list(train.Training(replace(setup, steps=4 * each, each=each), pictures).run())[1:]
    return statistics.median(sum(r.rates) for r in reports), statistics.median(r.share for r in reports)


def digest(train: ModuleType, setup: Any, pictures: Any) -> str:
    """Of a batch of all ranks, augmented by seeds of its samples; the ranks' parts of it equal what one rank computes."""
    augment = train.Augmentation(setup.crop, setup.dtype)
    batch, seeds = pictures.pixels[:TOGETHER].permute(0, 3, 1, 2), torch.arange(TOGETHER, device=setup.device)
    rank, ranks = dist.get_rank(), dist.get_world_size()
    own = augment(batch.chunk(ranks)[rank], seeds.chunk(ranks)[rank]).contiguous()
    parts = [torch.empty_like(own) for _ in range(ranks)]
    dist.all_gather(parts, own)
    assert torch.equal(torch.cat(parts), augment(batch, seeds)), f"rank {rank}: the parts of {ranks} ranks differ"
    return hashlib.sha256(torch.cat(parts).cpu().numpy().tobytes()).hexdigest()[:16]


def losses(train: ModuleType, setup: Any, pictures: Any) -> list[float]:
    """Of a small network on the same batches for any number of ranks."""
    share = replace(setup, model="small", batch=TOGETHER // dist.get_world_size(), steps=STEPS, each=STEPS, rate=0.02)
    run = train.Training(replace(share, seed_samples=True), pictures)
    list(run.run())
    return run.losses


# --- several devices in one process ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Devices:
    """Cases whose results on other devices and threads differ from those on the first device, with what was found."""

    devices: list[str]
    threads: int
    cases: int
    other_device: dict[str, str]
    from_threads: dict[str, str]


def on_devices(devices: Sequence[torch.device], threads: int) -> Devices:
    """Run all cases on the last device while the first is current, then on all devices from several threads."""
    inputs = {name: case.inputs(SMALL, torch.float32, torch.device("cpu")) for name, case in ALL.items()}

    def run(name: str, device: torch.device) -> list[Tensor]:
        arguments = [x.to(device) if isinstance(x, Tensor) else x for x in inputs[name]]
        torch.manual_seed(0)
        outputs = tensors_of(ALL[name].call(*arguments))
        if any(x.device != device for x in outputs):
            raise AssertionError(f"a result is on {outputs[0].device} instead of {device}")
        return [x.cpu() for x in outputs]

    expected = {name: run(name, devices[0]) for name in ALL}

    def differences(device: torch.device) -> dict[str, str]:
        if device.type == "cpu":
            differences_of = {name: compared(expected[name], partial(run, name, device)) for name in ALL}
        else:
            with torch.cuda.stream(torch.cuda.Stream(device)):
                torch.cuda.set_device(devices[0])  # of this thread; entering the stream made `device` current
                differences_of = {name: compared(expected[name], partial(run, name, device)) for name in ALL}
        return {name: difference for name, difference in differences_of.items() if difference}

    other = differences(devices[-1])
    with ThreadPoolExecutor(threads) as pool:
        differences_of = list(pool.map(differences, [devices[i % len(devices)] for i in range(threads)]))
    differing = {name: said for result in differences_of for name, said in result.items()}
    return Devices([str(d) for d in devices], threads, len(ALL), other, differing)


def compared(expected: list[Tensor], run: Callable[[], list[Tensor]]) -> str:
    """What is different, empty where every bit is the same."""
    try:
        results = run()
    except Exception as error:  # any failure is a result
        return f"{type(error).__name__}: {error}".splitlines()[0]
    if all(torch.equal(x.nan_to_num(), y.nan_to_num()) for x, y in zip(results, expected)):
        return ""
    worst = max(
        float((x.double() - y.double()).nan_to_num().abs().max()) for x, y in zip(results, expected) if x.numel()
    )
    return f"differs by {worst:.2g}"


# --- the table ------------------------------------------------------------------------------------------------------


def measure(options: Options, numbers: Sequence[int]) -> list[Row]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for ranks in numbers:
            torch.multiprocessing.spawn(work, (ranks, options, folder), ranks)
            rows.append(Row(**json.loads(Path(folder, f"{ranks}.json").read_text())))
            alone, augmented = round(rows[-1].alone), round(rows[-1].augmented)
            print(
                f"  {alone} images/s augmented alone, {augmented} trained with augmentation",
                file=sys.stderr,
                flush=True,
            )
    return rows


def efficiency(rows: Sequence[Row], what: str) -> list[float]:
    """Rates over those of as many single ranks."""
    return [getattr(row, what) / getattr(rows[0], what) * rows[0].ranks / row.ranks for row in rows]


def table(rows: Sequence[Row]) -> str:
    lines = [
        "       augmentation alone               training without      training with augmentation",
        "ranks  images/s   slowest  efficiency   images/s  efficiency  images/s  efficiency  with/without  share of time",
    ]
    columns = [efficiency(rows, what) for what in ("alone", "without", "augmented")]
    for row, alone, without, augmented in zip(rows, *columns):
        lines.append(
            f"{row.ranks:5} {row.alone:9.0f} {row.slowest:9.0f} {alone:11.1%} {row.without:10.0f} {without:11.1%} "
            f"{row.augmented:9.0f} {augmented:11.1%} {row.augmented / row.without:13.1%} {row.share:14.2%}"
        )
    return "\n".join(lines)


def bars(rows: Sequence[Row]) -> list[str]:
    """Each bar with what was measured on the most ranks. They hold for a ResNet-50 on GPUs with 128 images a rank."""

    def line(what: str, measured: float, bar: float, met: bool) -> str:
        return f"{what:58} {measured:8.2%} / {bar:.0%}{'' if met else '  MISSED'}"

    share = max(row.share for row in rows)
    lines = [line("share of time in augmentation, largest", share, SHARE, share <= SHARE)]
    ranks = rows[-1].ranks
    if ranks > rows[0].ranks:
        alone = efficiency(rows, "alone")[-1]
        scaled = efficiency(rows, "augmented")[-1] / efficiency(rows, "without")[-1]
        lines.append(line(f"efficiency of augmentation alone, {ranks} ranks", alone, ALONE, alone >= ALONE))
        lines.append(
            line(f"that of training, over that without it, {ranks} ranks", scaled, TRAINING, scaled >= TRAINING)
        )
    return lines


def agreement(rows: Sequence[Row]) -> list[str]:
    """What must not depend on the number of ranks."""
    first, numbers = rows[0], ", ".join(str(row.ranks) for row in rows)
    equal = all(row.digest == first.digest for row in rows)
    worst = max(abs(a - b) / abs(b) for row in rows for a, b in zip(row.losses, first.losses))
    return [
        f"{TOGETHER} images by seeds of samples on {numbers} ranks: {'the same bits' if equal else 'DIFFERENT'}",
        f"losses of {STEPS} steps on {numbers} ranks: at most {worst:.2g} of the loss from those of {first.ranks}",
    ]


def said(devices: Devices) -> list[str]:
    where = {
        "current device is the first": devices.other_device,
        f"{devices.threads} threads at once": devices.from_threads,
    }
    return [
        f"{devices.cases} cases on {', '.join(devices.devices)}, {what}: "
        + ("the same bits" if not different else "; ".join(f"{name} {why}" for name, why in different.items()))
        for what, different in where.items()
    ]


def plot(rows: Sequence[Row], title: str, path: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams.update({"svg.hashsalt": "kvision", "svg.fonttype": "none", "font.size": 9})
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    ranks = [row.ranks for row in rows]
    panels = {
        "augmentation alone": [("alone", "#0f766e", "pipeline A")],
        "training": [("without", "#8a8a8a", "without augmentation"), ("augmented", "#c2410c", "with pipeline A")],
    }
    for axis, (name, curves) in zip(axes, panels.items()):
        for what, color, label in curves:
            rates = [getattr(row, what) for row in rows]
            axis.plot(ranks, rates, marker="o", color=color, label=label)
            axis.plot(ranks, [rates[0] * n / ranks[0] for n in ranks], "--", color=color, linewidth=0.8)
        axis.set_title(name, fontsize=9)
        axis.set_xticks(ranks)
        axis.set_xlabel("ranks; dashed: as many single ones")
        axis.set_ylabel("images/s")
        axis.set_ylim(0)
        axis.yaxis.set_major_formatter("{x:,.0f}")
        axis.legend(frameon=False)
        axis.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize=9)
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def numbers_of(text: str) -> list[int]:
    """Ranks to measure, such as 1,2,4; each divides the batch that is the same for all of them."""
    numbers = sorted({int(number) for number in text.split(",")})
    if not numbers or numbers[0] < 1 or any(TOGETHER % n for n in numbers):
        raise ValueError(text)
    return numbers


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(prog="python -m benchmarks.scaling", description=__doc__)
    on_gpu = torch.cuda.is_available()
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cuda" if on_gpu else "cpu")
    parse.add_argument("--ranks", type=numbers_of, help="default: 1, 2, 4, 8 as far as there are GPUs, or cores")
    parse.add_argument(
        "--model", choices=("small", "resnet50"), help="default: resnet50 on GPUs, if torchvision is there"
    )
    parse.add_argument("--batch", type=int, default=128, help="of each rank")
    parse.add_argument("--size", type=int, default=256, help="of the images")
    parse.add_argument("--crop", type=int, default=224, help="of the augmented images")
    parse.add_argument("--seconds", type=float, default=2.0, help="time for one figure")
    parse.add_argument("--threads", type=int, default=4, help="that call the cases at once")
    parse.add_argument("--out", type=Path, default=Path("out/scaling"), metavar="DIR")
    options = parse.parse_args(arguments)
    if options.device == "cuda" and not on_gpu:
        parse.error("--device cuda: torch finds no CUDA device")
    available = torch.cuda.device_count() if options.device == "cuda" else os.cpu_count() or 1
    numbers = options.ranks or [n for n in (1, 2, 4, 8) if n <= available]
    if options.device == "cuda" and numbers[-1] > available:
        parse.error(f"--ranks {numbers[-1]}: expected at most {available}, the number of GPUs")
    has_torchvision = importlib.util.find_spec("torchvision") is not None
    model = options.model or ("resnet50" if options.device == "cuda" and has_torchvision else "small")

    about = machine.describe(torch.device(options.device), ["torchvision"] if has_torchvision else [])
    head = f"{max(numbers)} x {about['hardware']}  torch {about['torch']}  {about['date']}  kvision {about['commit']}"
    task = f"{options.batch}x3x{options.size}x{options.size} uint8 a rank to {options.crop}x{options.crop}; {model}"
    print(f"{head}\n$ {about['command']}\n{task}\n", flush=True)
    count = max(options.batch * numbers[-1], TOGETHER)
    rows = measure(
        Options(options.device, model, options.batch, count, options.size, options.crop, options.seconds), numbers
    )
    judged = bars(rows) if options.device == "cuda" and model == "resnet50" and options.batch == 128 else []
    lines = [table(rows), "", *judged, *agreement(rows)]
    print("\n".join(lines), flush=True)
    devices = [torch.device("cuda", i) for i in range(available)] if options.device == "cuda" else [torch.device("cpu")]
    checked = on_devices(devices, max(options.threads, len(devices)))
    print("\n".join(said(checked)), flush=True)

    options.out.mkdir(parents=True, exist_ok=True)
    text = "\n".join([head, f"$ {about['command']}", task, "", *lines, *said(checked)])
    (options.out / "scaling.txt").write_text(text + "\n")
    result = {"machine": about, "task": task, "rows": [asdict(row) for row in rows], "devices": asdict(checked)}
    (options.out / "scaling.json").write_text(json.dumps(result, indent=1) + "\n")
    try:
        plot(rows, f"{about['hardware']}, {task}", options.out / "scaling.svg")
    except ImportError:
        print("no scaling.svg: matplotlib is not installed")
    print(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
