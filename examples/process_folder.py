"""Apply a pipeline of kvision to every image of a folder: on one machine, or with Ray on a cluster.

    python examples/process_folder.py PICTURES RESULTS                          a Gaussian blur
    python examples/process_folder.py PICTURES RESULTS --pipeline "K.filters.MedianBlur(5)" "K.filters.Sobel()"
    python examples/process_folder.py PHOTO.jpg RESULTS                         an image of your own
    python examples/process_folder.py LIST.txt RESULTS                          a path or URL in each line; URLs take fsspec
    ... --device cuda --decoder torchvision                                     JPEG files are decoded on the GPU
    ... --engine ray --actors 8                                                 pip install ".[ray]"; RAY_ADDRESS says where

A step of the pipeline is a Python expression for an nn.Module that takes images (B, 3, H, W) in [0, 1], or uint8 with --uint8;
images of one size go through it together. The result of PICTURES/a/b.jpg is RESULTS/a/b.jpg.png. It appears complete or not at all,
so that a second start does what is left of the first. An image that cannot be read, or that the pipeline refuses, is a line of
RESULTS/broken.csv and is left alone until --retry. So is one of more than --max-pixels, one whose name is no text or longer than
200 bytes, and what is no regular file. Only one job at a time works in a folder of results, which is not inside that of the images.

On one machine the workers of a DataLoader decode, each with several threads. A worker that dies, or is not done with a batch after
--timeout seconds, is replaced; an image whose worker dies or hangs again, when it is alone, counts as broken. Workers end with the
program, even if it is killed.

With Ray, a pool of actors, one a GPU, grows with what waits, and tasks decode on all CPUs; without GPUs the actors decode as well.
Ray holds back what the actors are too busy for, and repeats what was lost with a machine.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import errno
import fcntl
import importlib.util
import itertools
import logging
import os
import stat
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

import kvision as K
from kvision.demo.arguments import device_of, make_folder, require
from kvision.demo.workers import exit_with_parent

SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
BLUR = "K.filters.GaussianBlur2d(5, (1.5, 1.5))"
DECODERS = {"opencv": "cv2", "torchcodec": "torchcodec", "torchvision": "torchvision"}  # backends of kvision.io.decode
FORMATS = (".png", ".jpg", ".webp")  # of the results; PNG keeps every bit
PARTIAL = "partial"
MAX_PIXELS = 250_000_000
MAX_NAME = 200  # bytes; file systems take 255, and a file that is being written has a longer name than its result


@dataclass(frozen=True)
class Task:
    """An image and the file of its result."""

    path: str
    target: str


@dataclass(frozen=True)
class Read:
    """What a worker made of the task of that number: pixels, uint8 (3, H, W), or the bytes of a JPEG file, or an error."""

    number: int
    pixels: Tensor | None = None
    jpeg: Tensor | None = None
    error: str = ""


# --- what there is to do --------------------------------------------------------------------------------------------


def tasks_of(source: Path, out: Path, suffix: str = ".png") -> list[Task]:
    """A task for each image below a folder, for an image, or for each line of a text file; the same line twice is one task."""
    if source.is_dir():
        files = (path for path in sorted(source.rglob("*")) if path.suffix.lower() in SUFFIXES and not path.is_dir())
        names = {str(path): str(path.relative_to(source)) for path in files}
    elif source.suffix.lower() in SUFFIXES:
        names = {str(source): source.name}
    else:
        lines = filter(None, map(str.strip, source.read_text().splitlines()))
        names = {line: name_of(line) for line in lines}
    return [Task(path, str(out / f"{name}{suffix}")) for path, name in names.items()]


def name_of(url: str) -> str:
    """A relative path for a path or URL."""
    parts = urlsplit(url)
    path = unquote(parts.netloc + parts.path) if parts.scheme else url
    return "/".join(part for part in path.split("/") if part not in ("", ".", ".."))


def words(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def conflict(tasks: Sequence[Task], source: Path, out: Path) -> str:
    """Why results would replace each other or images, or become images of the next start; nothing if they would not."""
    if source.is_dir() and out.is_relative_to(source):
        return f"the folder of the results, {out}, is inside the folder of the images"
    by_target: dict[str, str] = {}
    folders: set[str] = set()
    for task in tasks:
        other = by_target.setdefault(task.target, task.path)
        if other != task.path:
            return f"{other} and {task.path} have the same result, {task.target}"
        folder = os.path.dirname(task.target)
        while folder not in folders and len(folder) > len(str(out)):
            folders.add(folder)
            folder = os.path.dirname(folder)
    for folder in folders & by_target.keys():
        return f"the result of {by_target[folder]}, {folder}, is the folder of other results"
    if source.is_dir() and str(source) in folders:
        return f"results would go to {source}, which is the folder of the images"
    for path in (task.path for task in tasks if os.path.abspath(task.path) in by_target):
        return f"{path} is an image and a result"
    return ""


def refusal(task: Task) -> str:
    """What is wrong with the name of an image; nothing if it can be read. A decoder may crash at a name that is no text."""
    if printable(task.path) != task.path:
        return "its name is no valid text"
    size = len(Path(task.target).stem.encode())
    return f"its name has {size} bytes, more than {MAX_NAME}" if size > MAX_NAME else ""


def printable(text: str) -> str:
    """Text of which every byte can be written and read again: names of files may be no UTF-8."""
    return text.encode(errors="backslashreplace").decode().replace("\0", "\\0")


class Report:
    """RESULTS/broken.csv, a line for each broken image, written at once. It is locked: a second job raises BlockingIOError."""

    def __init__(self, out: Path, retry: bool) -> None:
        self.file = (out / "broken.csv").open("a+", newline="", encoding="utf-8", errors="backslashreplace")
        try:
            fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system unlocks it, however the job ends
        except BlockingIOError:
            self.file.close()
            raise
        except OSError as error:
            print(f"{out}: {error.strerror}: see that no other job works there")  # a file system without locks
        self.file.seek(0)
        known = [row for row in csv.reader(self.file) if len(row) == 2][1:]  # a killed run may leave half a row
        known = [] if retry else known
        self.known = {path for path, _ in known}
        self.file.truncate(0)
        csv.writer(self.file).writerows([("path", "error"), *known])
        self.file.flush()

    def __enter__(self) -> Report:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def add(self, path: str, error: str) -> None:
        csv.writer(self.file).writerow((printable(path), printable(error)))
        self.file.flush()


# --- reading and decoding -------------------------------------------------------------------------------------------


@contextlib.contextmanager
def local(path: str) -> Iterator[str]:
    """A file of this machine with the content of a path or URL."""
    parts = urlsplit(path)
    if parts.scheme in ("", "file"):
        path = path if parts.scheme == "" else unquote(parts.path)
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would be waited for
            raise OSError(f"{path} is no regular file")
        yield path
        return
    try:
        import fsspec
    except ImportError as error:
        raise OSError(f"reading {parts.scheme}:// takes fsspec: pip install fsspec") from error
    with fsspec.open(path) as remote, tempfile.NamedTemporaryFile() as file:
        file.write(remote.read())
        file.flush()
        yield file.name


def read(number: int, task: Task, keep_jpeg: bool, max_pixels: int = MAX_PIXELS) -> Read:
    """Decode by OpenCV; with `keep_jpeg` leave whole JPEG files to a decoder of the GPU."""
    too_large = f"the image has more than {max_pixels} pixels (--max-pixels)"
    try:
        with local(task.path) as path:
            if keep_jpeg and (data := plain_jpeg(path, max_pixels)):
                return Read(number, jpeg=torch.frombuffer(bytearray(data), dtype=torch.uint8))
            pixels = K.io.load_image(path, K.io.ImageLoadType.RGB8)
            return Read(number, pixels) if pixels[0].numel() <= max_pixels else Read(number, error=too_large)
    except Exception as error:  # whatever is wrong with an image, the others go on
        return Read(number, error=too_large if "CV_IO_MAX_IMAGE_PIXELS" in str(error) else words(error))


def opencv_limits(max_pixels: int) -> dict[str, str]:
    """The environment in which OpenCV refuses larger images by their header, before it allocates them.

    OpenCV reads it when it is loaded; where that was earlier, `read` refuses them after they are decoded.
    """
    return {"OPENCV_IO_MAX_IMAGE_PIXELS": str(max_pixels)}


def plain_jpeg(path: str, max_pixels: int) -> bytes:
    """The file, if it is a JPEG file that ends as it should, in color or gray and not too large; otherwise nothing."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None  # max_pixels is the limit
    data = Path(path).read_bytes()
    if not data.startswith(b"\xff\xd8") or not data.rstrip(b"\0").endswith(b"\xff\xd9"):
        return b""
    with Image.open(path) as picture:
        small = picture.width * picture.height <= max_pixels
        return data if small and picture.mode in ("RGB", "L") else b""


class Pictures(Dataset[Read]):
    """The images of some tasks. A worker decodes those of a batch in several threads."""

    def __init__(self, tasks: Sequence[Task], threads: int, keep_jpeg: bool, max_pixels: int) -> None:
        self.tasks, self.threads, self.keep_jpeg, self.max_pixels = tasks, threads, keep_jpeg, max_pixels

    def __len__(self) -> int:
        return len(self.tasks)

    def __getitem__(self, number: int) -> Read:
        return read(number, self.tasks[number], self.keep_jpeg, self.max_pixels)

    def __getitems__(self, numbers: list[int]) -> list[Read]:
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(self.__getitem__, numbers))


# --- the pipeline ---------------------------------------------------------------------------------------------------


def pipeline_of(steps: Sequence[str]) -> nn.Module:
    """The modules that the expressions make, one after the other."""
    names = {"K": K, "kvision": K, "A": K.augmentation, "nn": nn, "torch": torch}
    return nn.Sequential(*(eval(step, names) for step in steps)).eval()


class Apply:
    """Decodes what workers left to the GPU, and runs the pipeline on all images of one size together."""

    def __init__(self, steps: Sequence[str], device: str, decoder: str, uint8: bool) -> None:
        self.device, self.decoder, self.uint8 = torch.device(device), decoder, uint8
        self.pipeline = pipeline_of(steps).to(self.device)

    def __call__(self, batch: Sequence[Read]) -> list[tuple[int, Tensor | str]]:
        """For each image its number, and the result, uint8 (C, H, W) in CPU memory, or an error."""
        results: list[tuple[int, Tensor | str]] = [(item.number, item.error) for item in batch if item.error]
        pixels = {item.number: item.pixels for item in batch if item.pixels is not None}
        files = {item.number: item.jpeg for item in batch if item.jpeg is not None}
        pixels.update(self.decoded(files, results))
        by_size: dict[tuple[int, ...], list[int]] = {}
        for number, image in pixels.items():
            by_size.setdefault(tuple(image.shape), []).append(number)
        for numbers in by_size.values():
            results += self.apply(numbers, [pixels[number] for number in numbers])
        return results

    def decoded(self, files: dict[int, Tensor], results: list[tuple[int, Tensor | str]]) -> dict[int, Tensor]:
        """All files at once. What cannot be decoded becomes a result, an error."""
        images = K.io.decode(list(files.values()), self.device, backend=self.decoder, errors="skip")
        for number, image in zip(files, images):
            if image is None:
                results.append((number, self.reason(files[number])))
        return {number: image for number, image in zip(files, images) if image is not None}

    def reason(self, file: Tensor) -> str:
        """Why a file cannot be decoded."""
        try:
            K.io.decode(file, self.device, backend=self.decoder)
        except ValueError as error:
            return words(error)
        return "it was decoded at the second attempt only"

    def apply(self, numbers: list[int], images: list[Tensor]) -> list[tuple[int, Tensor | str]]:
        try:
            batch = torch.stack([image.to(self.device, non_blocking=True) for image in images])
            with torch.inference_mode():
                result = self.pipeline(batch if self.uint8 else batch.float() / 255)
            if not isinstance(result, Tensor) or result.dim() != 4 or len(result) != len(images):
                got = tuple(result.shape) if isinstance(result, Tensor) else type(result).__name__
                raise ValueError(f"the pipeline must give images ({len(images)}, C, H, W), got {got}")
            if result.dtype != torch.uint8:
                result = (255 * result.float().nan_to_num(0).clamp(0, 1)).round().byte()
            return list(zip(numbers, result.cpu()))
        except Exception as error:  # of the pipeline, or no memory for all of them at once
            if len(images) == 1:
                return [(numbers[0], f"pipeline: {words(error)}")]
        return [pair for number, image in zip(numbers, images) for pair in self.apply([number], [image])]


def write(task: Task, image: Tensor) -> None:
    """Write the result to a temporary file in the same folder, then rename it in one step of the file system."""
    target = Path(task.target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise ValueError(error.strerror) from error
        raise
    mark = f"{os.getpid()}.{threading.get_ident()}.{PARTIAL}"
    partial = target.with_name(f".{target.name}.{mark}{target.suffix}")
    try:
        K.io.write_image(partial, image)
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


# --- one machine ----------------------------------------------------------------------------------------------------


class Job:
    """Writes results and reports errors in threads, each task once."""

    def __init__(self, tasks: Sequence[Task], report: Report, threads: int, progress: Callable[[], object]) -> None:
        self.tasks, self.report, self.progress, self.broken = tasks, report, progress, 0
        self.pool, self.lock, self.most = ThreadPoolExecutor(threads), threading.Lock(), 8 * threads
        self.claimed: set[int] = set()
        self.futures: deque[Future[None]] = deque()

    def finish(self, results: Sequence[tuple[int, Tensor | str]]) -> None:
        for number, result in results:
            self.futures.append(self.pool.submit(self._finish, number, result))
        while len(self.futures) > self.most:  # the disk is slower than the pipeline
            self.futures.popleft().result()

    def _finish(self, number: int, result: Tensor | str) -> None:
        with self.lock:
            if number in self.claimed:
                return
            self.claimed.add(number)
        if isinstance(result, Tensor):
            try:
                write(self.tasks[number], result)
            except ValueError as error:  # an image that PNG cannot hold; an error of the disk ends the job
                result = words(error)
        with self.lock:
            if isinstance(result, str):
                self.broken += 1
                self.report.add(self.tasks[number].path, result)
            self.progress()

    def wait(self) -> None:
        while self.futures:
            self.futures.popleft().result()
        self.pool.shutdown()


def next_of(batches: Iterator[list[Read]]) -> list[Read] | None:
    """The next batch; nothing at the end, or when a worker died or hangs. What it had sent may be lost with it."""
    try:
        return next(batches, None)
    except (ConnectionError, EOFError, FileNotFoundError):
        return None
    except RuntimeError as error:
        if "DataLoader worker" in str(error) or "DataLoader timed out" in str(error):
            return None
        raise


def run_here(tasks: Sequence[Task], options: argparse.Namespace, job: Job) -> None:
    """Decode in the workers of a DataLoader, apply here, write in threads."""
    apply = Apply(options.pipeline, options.device, options.decoder, options.uint8)
    pictures = Pictures(tasks, options.threads, options.decoder != "opencv", options.max_pixels)
    waiting = deque(range(len(tasks)))
    context = "forkserver"  # workers without the threads and the GPU of this process
    careful = 0  # images to read alone, after a worker died or hung
    while waiting:
        workers, size = (1, 1) if careful else (options.workers, options.batch)
        numbers = list(waiting)[: careful or None]
        loader = DataLoader(
            pictures,
            batch_sampler=[numbers[i : i + size] for i in range(0, len(numbers), size)],
            collate_fn=list,
            num_workers=workers,
            worker_init_fn=exit_with_parent,
            prefetch_factor=(1 if careful else 2) if workers else None,
            multiprocessing_context=context if workers else None,
            timeout=options.timeout if workers else 0,
        )
        batches = iter(loader)
        while (batch := next_of(batches)) is not None:
            job.finish(apply(batch))
            for item in batch:
                waiting.remove(item.number)  # the first ones
        unread = bool(waiting) and waiting[0] <= numbers[-1]
        if unread and careful:
            job.finish([(waiting.popleft(), "the process that decoded it died or hung")])
        careful = options.workers * 2 * options.batch if unread else 0
    job.wait()


# --- a cluster ------------------------------------------------------------------------------------------------------


def decode_rows(rows: dict[str, Any], max_pixels: int) -> dict[str, Any]:
    """Images of a batch of Ray's rows, in threads. A broken one has no pixels."""
    os.environ.update(opencv_limits(max_pixels))
    with ThreadPoolExecutor(4) as pool:
        items = list(pool.map(lambda path: read(0, Task(path, ""), False, max_pixels), rows["path"]))
    empty = torch.zeros(3, 0, 0, dtype=torch.uint8)
    pixels = np.empty(len(items), object)
    for i, item in enumerate(items):
        pixels[i] = (empty if item.pixels is None else item.pixels).numpy()
    return {**rows, "pixels": pixels, "error": np.array([item.error for item in items], object)}


class ApplyRows:
    """`Apply` for batches of Ray's rows. Writes the results, unless an earlier attempt has, and gives path and error."""

    def __init__(self, steps: Sequence[str], device: str, uint8: bool, threads: int) -> None:
        self.apply, self.threads = Apply(steps, device, "opencv", uint8), threads

    def __call__(self, rows: dict[str, Any]) -> dict[str, Any]:
        tasks = [Task(str(path), str(target)) for path, target in zip(rows["path"], rows["target"])]
        batch = [
            Read(i, error=str(error)) if error else Read(i, torch.from_numpy(np.array(pixels)))
            for i, (pixels, error) in enumerate(zip(rows["pixels"], rows["error"]))
            if not os.path.exists(tasks[i].target)
        ]
        errors = [""] * len(tasks)

        def finish(result: tuple[int, Tensor | str]) -> None:
            number, image = result
            try:
                if isinstance(image, str):
                    errors[number] = image
                else:
                    write(tasks[number], image)
            except ValueError as error:
                errors[number] = words(error)

        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(finish, self.apply(batch)))
        return {"path": rows["path"], "error": np.array(errors, object)}


def run_on_cluster(
    tasks: Sequence[Task], options: argparse.Namespace, report: Report, progress: Callable[[], object]
) -> int:
    """Decode in tasks, apply in a pool of actors. Returns the number of broken images."""
    import ray

    logging.getLogger("ray.data").setLevel(logging.WARNING)
    ray.init(ignore_reinit_error=True, log_to_driver=False, logging_level=logging.WARNING)
    ray.data.DataContext.get_current().enable_progress_bars = False
    blocks = -(-len(tasks) // options.batch)
    rows = ray.data.from_items([{"path": t.path, "target": t.target} for t in tasks], override_num_blocks=blocks)
    decode = {"fn_kwargs": {"max_pixels": options.max_pixels}, "batch_size": options.batch}
    results = rows.map_batches(decode_rows, **decode).map_batches(
        ApplyRows,
        fn_constructor_args=(options.pipeline, options.device, options.uint8, options.threads),
        batch_size=options.batch,
        num_gpus=1 if options.device.startswith("cuda") else 0,
        num_cpus=1,
        compute=ray.data.ActorPoolStrategy(min_size=1, max_size=options.actors),
    )
    broken = 0
    for row in results.iter_rows():
        if row["error"]:
            broken += 1
            report.add(row["path"], row["error"])
        progress()
    return broken


# --- how fast -------------------------------------------------------------------------------------------------------


def compare(tasks: Sequence[Task], options: argparse.Namespace) -> None:
    """Print images a second of OpenCV's loop on some of the images, and of every decoder that is installed."""
    import cv2

    blurs = options.pipeline == [BLUR]
    qualities = {".jpg": cv2.IMWRITE_JPEG_QUALITY, ".webp": cv2.IMWRITE_WEBP_QUALITY}
    quality = [qualities[options.format], 80] if options.format in qualities else []  # as kvision.io.write_image
    with tempfile.TemporaryDirectory() as folder:
        whole = [task for task in tasks if os.path.exists(task.target) and "://" not in task.path]
        if not whole:
            return
        begin = time.perf_counter()
        for i, task in enumerate(whole):
            image = cv2.imread(task.path, cv2.IMREAD_COLOR)
            image = cv2.GaussianBlur(image, (5, 5), 1.5) if blurs else image
            cv2.imwrite(f"{folder}/{i}{options.format}", image, quality)
        rate = len(whole) / (time.perf_counter() - begin)
    does = "the same in a loop of OpenCV" if blurs else "reading and writing alone in a loop of OpenCV"
    print(f"{does}, {len(whole)} images: {rate:.0f} images/s")
    device = torch.device(options.device)
    for name in decoders(device):
        items = [read(i, task, name != "opencv", options.max_pixels) for i, task in enumerate(whole)]
        files = [item.jpeg for item in items if item.jpeg is not None]
        begin, count = time.perf_counter(), len(files)
        if name == "opencv":
            pictures = Pictures(whole, options.threads, False, options.max_pixels)
            count = len(pictures.__getitems__(list(range(len(whole)))))
        elif files:
            K.io.decode(files[:1], device, backend=name)
            begin = time.perf_counter()
            for i in range(0, count, options.batch):
                K.io.decode(files[i : i + options.batch], device, backend=name)
            torch.cuda.synchronize(device)
        print(f"decoding by {name}, {count} images: {count / (time.perf_counter() - begin):.0f} images/s")


def decoders(device: torch.device) -> list[str]:
    """Those that are installed and serve the device."""

    def installed(module: str) -> bool:
        with contextlib.suppress(ModuleNotFoundError):
            return importlib.util.find_spec(module) is not None
        return False

    return [
        name for name, module in DECODERS.items() if installed(module) and (name == "opencv" or device.type == "cuda")
    ]


# --- the run --------------------------------------------------------------------------------------------------------


class Stderr:
    """stderr for a bar, as long as there is one. tqdm would keep its lock after an error, and the job would hang."""

    encoding = getattr(sys.stderr, "encoding", None)

    def write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # the terminal or the pipe was closed
            sys.stderr.write(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()

    def fileno(self) -> int:
        return sys.stderr.fileno()


def open_closed_streams() -> None:
    """Open /dev/null for each of stdin, stdout and stderr that is closed: other files would get their numbers."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)


def check(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """End the program in one line where the options ask for what is not there."""
    if options.max_pixels < 1:
        parser.error(f"--max-pixels {options.max_pixels}: expected at least 1")
    if not options.timeout > 0:
        parser.error(f"--timeout {options.timeout:g}: expected more than 0")
    device = device_of(parser, options.device) if options.engine == "local" else torch.device(options.device)
    if not options.source.exists():
        parser.error(f"{options.source}: expected a folder of images or a list of paths, there is none")
    if options.source.is_file() and options.source.suffix.lower() not in SUFFIXES:
        try:
            options.source.read_text()
        except (OSError, UnicodeDecodeError) as error:
            parser.error(f"{options.source}: expected a text file with a path or URL in each line: {words(error)}")
    if options.engine == "ray" and importlib.util.find_spec("ray") is None:
        parser.error('--engine ray: Ray is not installed: pip install ".[ray]"')
    if options.decoder != "opencv" and (options.engine == "ray" or options.decoder not in decoders(device)):
        parser.error(f"--decoder {options.decoder}: expected one of {', '.join(decoders(device))} here")
    try:
        pipeline_of(options.pipeline)
    except Exception as error:
        parser.error(f"--pipeline: {type(error).__name__}: {words(error)}")


def main(arguments: list[str] | None = None) -> int:
    open_closed_streams()
    cores = os.cpu_count() or 1
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "source", type=Path, help="folder of images, an image, or text file with a path or URL in each line"
    )
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--pipeline", nargs="+", default=[BLUR], metavar="MODULE", help=f"default: {BLUR}")
    parser.add_argument("--uint8", action="store_true", help="give the pipeline uint8 images")
    parser.add_argument("--engine", choices=("local", "ray"), default="local")
    parser.add_argument("--decoder", choices=tuple(DECODERS), default="opencv", help="of JPEG files")
    parser.add_argument("--format", choices=FORMATS, default=FORMATS[0], help="of the results")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--workers", type=int, default=max(1, cores // 4), help="processes that decode")
    parser.add_argument("--threads", type=int, default=min(4, cores), help="of a worker, and to write")
    actors = torch.cuda.device_count() or cores
    parser.add_argument("--actors", type=int, default=actors, help="most, with Ray; default: GPUs, else CPUs, here")
    parser.add_argument("--max-pixels", type=int, default=MAX_PIXELS, help="of an image; default: %(default)s")
    parser.add_argument("--timeout", type=float, default=300, help="seconds for a worker's batch; default: %(default)s")
    parser.add_argument("--retry", action="store_true", help="try the images of broken.csv again")
    parser.add_argument("--compare", type=int, default=64, metavar="N", help="images for OpenCV's loop; 0 for none")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    check(parser, options)
    require(parser, "tqdm")
    os.environ.update(opencv_limits(options.max_pixels))
    out = options.out.resolve()
    if out.is_file():
        make_folder(parser, options.out)  # says so
    everything = tasks_of(options.source, out, options.format)
    if reason := conflict(everything, options.source.resolve(), out):
        parser.error(printable(reason))
    make_folder(parser, options.out)
    try:
        report = Report(options.out, options.retry)
    except BlockingIOError:
        parser.error(f"{options.out}: another job is writing its results there")
    with report:
        return run(everything, options, report)


def run(everything: Sequence[Task], options: argparse.Namespace, report: Report) -> int:
    """Do what is not done or reported yet."""
    from tqdm import tqdm

    for partial in options.out.rglob(f".*.{PARTIAL}.*"):  # of a killed job
        partial.unlink(missing_ok=True)
    remaining = [t for t in everything if printable(t.path) not in report.known and not os.path.exists(t.target)]
    refused = [(task.path, reason) for task in remaining if (reason := refusal(task))]
    for path, reason in refused:
        report.add(path, reason)
    tasks = [task for task in remaining if not refusal(task)] if refused else remaining
    begin = time.perf_counter()
    done = len(everything) - len(tasks)
    bar_options = {"unit": "picture", "leave": False, "dynamic_ncols": True, "disable": sys.stderr is None}
    with tqdm(total=len(everything), initial=done, file=Stderr(), **bar_options) as bar:
        if options.engine == "ray":
            broken = run_on_cluster(tasks, options, report, bar.update) if tasks else 0
        else:
            job = Job(tasks, report, options.threads, bar.update)
            run_here(tasks, options, job)
            broken = job.broken
    seconds = time.perf_counter() - begin
    broken += len(refused)
    print(f"{len(everything)} images, {len(everything) - len(remaining)} of them done before", end="; ")
    print(f"{len(remaining) - broken} done and {broken} broken in {seconds:.1f} s: {len(tasks) / seconds:.3g} images/s")
    if options.compare and tasks:
        compare(list(itertools.islice(tasks, options.compare)), options)
    print(f"results and broken.csv are in {printable(str(options.out))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
