"""`python -m benchmarks.inputs [GROUPS]`: from what programs hold to what networks take, next to bars and peers.

    python -m benchmarks.inputs --device cuda                           every group
    python -m benchmarks.inputs bytes --photos FOLDER                   photographs of your own instead of drawn pictures
    python -m benchmarks.inputs --csv benchmarks/results/h200/inputs.csv

`bytes` are JPEG files in memory, of 280 to 700 pixels a side, to a normalized float16 batch of 224 x 224 (random resized crop,
flip, color jitter): images a second of each decoder alone, and of the whole pipeline while two threads decode ahead. `lists` are
such images, decoded. `frames` are 32 video frames of 1080p in NV12, `patches` inputs of vision-language models, `warps` antialiased
ones of 16 images of 1024 x 1024. Times are medians of rounds in which all contestants take turns, on a CPU minima; a floor is the
bytes that must be read and written over the copy bandwidth of the same run. Bars on CUDA are for an NVIDIA H200. What misses its
bar has an exclamation mark.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import statistics
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial
from itertools import cycle, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

import kvision as K
import kvision.augmentation as A
from benchmarks import machine, results
from benchmarks.augmentation import JITTER, MEAN, STD
from benchmarks.augmentation_cpu import PIPELINE
from benchmarks.case import dead_leaves
from benchmarks.host_time import microseconds
from benchmarks.peers import optional, set_threads
from benchmarks.timing import Clock, clock, extra_bytes, launches
from kvision.io import decoding

CROP = (224, 224)
FRAME = (1080, 1920)
SIDE = 1024


class Figure(NamedTuple):
    """What was measured. The bar is the most that it may be, or the least."""

    group: str
    name: str
    value: float
    unit: str
    bar: float | None = None
    at_least: bool = False

    @property
    def is_missed(self) -> bool:
        return self.bar is not None and (self.value < self.bar if self.at_least else self.value > self.bar)

    def __str__(self) -> str:
        bar = "" if self.bar is None else f"{'at least' if self.at_least else 'at most'} {self.bar:g}"
        return f"{self.group:9}{self.name:58}{self.value:12.4g}{'!' if self.is_missed else ' '} {self.unit:14}{bar}"


class Setup:
    """Where to measure, on what."""

    def __init__(self, device: torch.device, seconds: float, photos: Path | None, count: int) -> None:
        self.device, self.seconds, self.photos, self.count = device, seconds, photos, count

    @cached_property
    def clock(self) -> Clock:
        return clock(self.device, self.seconds)

    @cached_property
    def bandwidth(self) -> float:
        return self.clock.copy_bandwidth()

    @property
    def is_cuda(self) -> bool:
        return self.device.type == "cuda"

    def images(self, count: int, least: int, most: int) -> list[Tensor]:
        """Pictures uint8 (3, H, W) in CPU memory, of seeded sizes, or the photographs as they are."""
        if self.photos is not None:
            files = [path.read_bytes() for path in sorted(self.photos.iterdir()) if path.is_file()]
            photographs = [image for image in K.io.decode(files, errors="skip") if image is not None]
            return list(islice(cycle(photographs), count))
        picture = dead_leaves((3, most, most))
        sizes = torch.randint(least, most + 1, (count, 2), generator=torch.Generator().manual_seed(0)).tolist()
        resized = [F.interpolate(picture[None], size, mode="bilinear", antialias=True)[0] for size in sizes]
        return [(255 * image).round().byte() for image in resized]

    def seconds_of(self, calls: Sequence[Callable[[], Any]]) -> list[float]:
        return [self.clock.value(timing) for timing in self.clock.race(calls)]


def augmentation(antialias: bool = False) -> A.ImageSequential:
    """A list of images of any sizes, or a batch, to a batch."""
    return A.ImageSequential(
        A.RandomResizedCrop(CROP, antialias=antialias),
        A.RandomHorizontalFlip(),
        A.ColorJitter(*JITTER),
        A.Normalize(MEAN, STD),
        output_dtype=torch.float16,
    )


# --- files in memory ------------------------------------------------------------------------------------------------


def jpegs(setup: Setup) -> list[bytes]:
    """As cameras and the web have them: 4:2:0, quality 85. Photographs are taken as they are."""
    if setup.photos is not None:
        files = [
            path.read_bytes() for path in sorted(setup.photos.iterdir()) if path.suffix.lower() in (".jpg", ".jpeg")
        ]
        return list(islice(cycle(files), setup.count))
    from kvision.io.write import encoded

    return [encoded("picture.jpg", image, 85) for image in setup.images(setup.count, 280, 700)]


def rates(calls: Sequence[Callable[[int], Any]], batches: int, images: int, device: torch.device) -> list[float]:
    """Images a second of calls on so many batches, the medians of five rounds in which they take turns."""
    seconds: list[list[float]] = [[] for _ in calls]
    for _ in range(6):
        for call, own in zip(calls, seconds):
            begin = time.perf_counter()
            call(batches)
            if device.type == "cuda":
                torch.cuda.synchronize()
            own.append(time.perf_counter() - begin)
    return [batches * images / statistics.median(own[1:]) for own in seconds]


def repeated(call: Callable[[], Any], batches: int) -> None:
    for _ in range(batches):
        call()


def streams_of(device: torch.device) -> Sequence[Any]:
    """A stream for each thread that decodes, which keeps its memory from one call to the next one; None on the CPU."""
    return [torch.cuda.Stream() for _ in range(2)] if device.type == "cuda" else [None, None]


def ahead(
    decode: Callable[[], list[Tensor]], use: Callable[[list[Tensor]], Any], streams: Sequence[Any], batches: int
) -> None:
    """Use batches while two threads decode the next ones, on a stream of each.

    A thread waits for the last use of its memory. Tensor.record_stream does it by an event of each image, which takes the host
    longer than the decoder.
    """

    def decoded(number: int, used: Any) -> tuple[list[Tensor], Any]:
        stream = streams[number % 2]
        if stream is None:
            return decode(), None
        if used is not None:
            used.synchronize()
        with torch.cuda.stream(stream):
            return decode(), stream.record_event()

    with ThreadPoolExecutor(2) as pool:
        futures = deque(pool.submit(decoded, number, None) for number in range(min(2, batches)))
        for number in range(batches):
            images, ready = futures.popleft().result()
            if ready is not None:
                torch.cuda.current_stream().wait_event(ready)
            use(images)
            used = None if ready is None else torch.cuda.current_stream().record_event()
            del images
            if number + 2 < batches:
                futures.append(pool.submit(decoded, number + 2, used))


def of_bytes(setup: Setup) -> Iterator[Figure]:
    """The pipeline and the decoder alone take turns; of many batches, because nothing is decoded while the last one is used."""
    files, augment, streams = jpegs(setup), augmentation(), streams_of(setup.device)
    for backend in decoding._DECODERS:
        if isinstance(decoding._made(backend), Exception):
            continue

        def decode(name: str = backend) -> list[Tensor]:
            return K.io.decode(files, setup.device, backend=name)

        calls = [partial(repeated, decode), partial(ahead, decode, augment, streams)]
        names = [f"io.decode by {backend}", f"{backend}, crop, flip, jitter, normalize"]
        if backend in ("torchcodec", "torchvision"):
            calls.append(partial(repeated, decode_jpeg(backend, files, setup.device)))
            names.append(f"decode_jpeg of {backend} by itself")
        batches = 24 if setup.is_cuda and backend != "opencv" else 2
        measured = rates(calls, batches, len(files), setup.device)
        for name, own in zip(names, measured):
            yield Figure("bytes", name, own, "images/s")
        pipeline, alone = measured[1], max(measured[0], measured[-1] if len(measured) > 2 else 0)
        yield Figure(
            "bytes",
            f"{backend}, pipeline over decoder alone",
            pipeline / alone,
            "",
            0.97 if setup.is_cuda else None,
            True,
        )
    if (peer := dali(files, setup.device)) is not None:
        (of_peer,) = rates([peer], 24 if setup.is_cuda else 2, len(files), setup.device)
        yield Figure("bytes", "NVIDIA DALI, crop, flip, jitter, normalize", of_peer, "images/s")


def dali(files: Sequence[bytes], device: torch.device) -> Callable[[int], Any] | None:
    """Batches of NVIDIA DALI's pipeline of the same steps, but for contrast around the middle gray; None where it is missing."""
    if importlib.util.find_spec("nvidia") is None or importlib.util.find_spec("nvidia.dali") is None:
        return None
    library: Any = importlib.import_module("nvidia.dali")
    fn, types = library.fn, library.types
    arrays = [np.frombuffer(file, np.uint8) for file in files]
    is_cuda = device.type == "cuda"

    @library.pipeline_def(
        batch_size=len(files), num_threads=8 if is_cuda else torch.get_num_threads(), device_id=0 if is_cuda else None
    )
    def pipeline() -> Any:
        jpegs = fn.external_source(source=lambda: arrays)
        images = fn.decoders.image(jpegs, device="mixed" if is_cuda else "cpu", output_type=types.RGB)
        crops = fn.random_resized_crop(images, size=CROP)
        factors = [fn.random.uniform(range=[1 - x, 1 + x]) for x in JITTER[:3]]
        hue = fn.random.uniform(range=[-360 * JITTER[3], 360 * JITTER[3]])
        colored = fn.color_twist(crops, brightness=factors[0], contrast=factors[1], saturation=factors[2], hue=hue)
        mean, std = ([255 * x for x in numbers] for numbers in (MEAN, STD))
        mirror = fn.random.coin_flip()
        return fn.crop_mirror_normalize(
            colored, dtype=types.FLOAT16, output_layout="CHW", mean=mean, std=std, mirror=mirror
        )

    made = pipeline()
    made.build()
    return partial(repeated, made.run)


def decode_jpeg(library: str, files: Sequence[bytes], device: torch.device) -> Callable[[], Any]:
    """The library's own function, which EXIF, other formats and damaged files do not concern."""
    module: Any = optional("torchcodec.decoders" if library == "torchcodec" else "torchvision.io")
    tensors = [torch.frombuffer(bytearray(file), dtype=torch.uint8) for file in files]
    return lambda: module.decode_jpeg(tensors, device=device)


# --- lists ----------------------------------------------------------------------------------------------------------


def of_lists(setup: Setup) -> Iterator[Figure]:
    """The pipeline of `bytes` on decoded images, against a batch of as many source pixels and against a loop over single images."""
    if not setup.is_cuda:
        yield from of_lists_on_cpu(setup)
        return
    images = [image.to(setup.device) for image in setup.images(128, 280, 700)]
    side = round(statistics.mean(image[0].numel() for image in images) ** 0.5)
    batch = torch.stack([F.interpolate(image[None], (side, side))[0] for image in images])
    for antialias in (False, True):
        name, augment = "128, antialiased" if antialias else "128", augmentation(antialias)
        calls: list[Callable[[], Any]] = [partial(augment, images), partial(augment, batch)]
        calls.append(partial(one_by_one, augment, images))
        of_list, of_batch, of_loop = setup.seconds_of(calls)
        yield Figure("lists", f"crop, flip, jitter, normalize of {name}", 1e3 * of_list, "ms")
        yield Figure("lists", f"{name}, over a batch of as many pixels", of_list / of_batch, "", 1.25)
        yield Figure("lists", f"{name}, loop over single images", 1e3 * of_loop, "ms")
        if (peer := torchvision_v2(images, antialias)) is not None:  # so slow that the clock on the wall will do
            (of_peer,) = rates([partial(repeated, peer)], 1, 1, setup.device)
            yield Figure("lists", f"{name}, torchvision v2", 1e3 / of_peer, "ms")
        yield Figure("lists", f"{name}, host", microseconds(calls[0]), "us", 200)
        yield Figure("lists", f"{name}, launches", launches(calls[0]), "", 3 if antialias else 2)
        yield Figure("lists", f"{name}, memory beyond the result", extra_bytes(calls[0]), "bytes", 65536)
    for name, steps in TO_LISTS.items():
        augment = A.ImageSequential(*(step() for step in steps))
        of_list, of_batch = partial(augment, images), partial(augment, batch)
        seconds, of_pixels = setup.seconds_of([of_list, of_batch])
        yield Figure("lists", f"{name} of 128 to a list", 1e3 * seconds, "ms")
        yield Figure("lists", f"{name} to a list, over a batch of as many pixels", seconds / of_pixels, "", 1.25)
        yield Figure("lists", f"{name} to a list, host", microseconds(of_list), "us", 200 + 2.5 * 128)
        yield Figure(
            "lists", f"{name} to a list, launches beyond a batch's", launches(of_list) - launches(of_batch), "", 0
        )
    leaves = [(image / 255).requires_grad_() for image in images]
    wanted, nothing = microseconds(partial(augmentation(), leaves)), microseconds(lambda: Nothing.apply(*leaves))
    yield Figure(
        "lists", "128 that want gradients, host, less a function's that does nothing", wanted - nothing, "us", 200
    )
    to_side = microseconds(lambda: K.geometry.resize(images, CROP[0]))
    yield Figure("lists", "resize of 128 to a list by the short side, host", to_side, "us", 200 + 2.5 * 128)

    def both() -> Any:
        return torch.autograd.grad(K.geometry.resize(leaves, CROP).sum(), leaves)

    (seconds,) = setup.seconds_of([both])
    moved = 2 * 4 * (sum(image.numel() for image in images) + 128 * 3 * CROP[0] * CROP[1])
    yield Figure("lists", "resize of 128, float32, and its gradients", seconds * setup.bandwidth / moved, "floors", 2.5)


# Augmentations that leave images their sizes.
TO_LISTS: dict[str, Sequence[Callable[[], nn.Module]]] = {
    "flip": (A.RandomHorizontalFlip,),
    "affine": (partial(A.RandomAffine, 20.0),),
    "jitter, normalize": (partial(A.ColorJitter, *JITTER), partial(A.Normalize, MEAN, STD)),
    "erasing": (partial(A.RandomErasing, p=1.0),),
    "speckle": (partial(A.SpeckleNoise, p=1.0),),
    "flip, affine, jitter": (A.RandomHorizontalFlip, partial(A.RandomAffine, 20.0), partial(A.ColorJitter, *JITTER)),
}


class Nothing(torch.autograd.Function):
    """A function of many tensors that does nothing."""

    @staticmethod
    def forward(ctx: Any, *tensors: Tensor) -> Tensor:
        return tensors[0].new_empty(1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        raise NotImplementedError


def of_lists_on_cpu(setup: Setup) -> Iterator[Figure]:
    resize = partial(K.geometry.resize, size=CROP)
    small = setup.images(32, 64, 128)
    photographs = setup.images(32, 280, 700)
    for name, images, bar in (("32 images of 64 to 128", small, 1.3), ("8 images of 280 to 700", photographs[:8], 1.0)):
        of_list, of_loop = setup.seconds_of([partial(resize, images), partial(one_by_one, resize, images)])
        yield Figure("lists", f"resize of {name}", 1e3 * of_list, "ms")
        yield Figure("lists", f"resize of {name}, loop over single images, over that", of_loop / of_list, "", bar, True)
    big = F.interpolate(photographs[0][None], (3000, 4000))[0]
    one, two = setup.seconds_of([partial(in_threads, count, partial(resize, [big, *small[1:]])) for count in (1, 2)])
    yield Figure("lists", "resize of one of 4000x3000 among 31 of 64 to 128", 1e3 * one, "ms")
    yield Figure("lists", "one of 4000x3000 among 31, two threads, over that", one / two, "", 1.6, True)
    augment = augmentation()
    for name, peer in (
        ("torchvision v2", torchvision_v2(photographs, False)),
        ("AlbumentationsX", albumentations(photographs)),
    ):
        if peer is not None:
            of_list, of_peer = setup.seconds_of([partial(augment, photographs), peer])
            yield Figure("lists", f"crop, flip, jitter, normalize of 32 beside {name}", 1e3 * of_list, "ms")
            yield Figure("lists", f"{name}, loop over single images, over that", of_peer / of_list, "", 2.0, True)


def in_threads(count: int, call: Callable[[], Any]) -> None:
    before = torch.get_num_threads()
    set_threads(count)
    call()
    set_threads(before)


def albumentations(images: list[Tensor]) -> Callable[[], Tensor] | None:
    """The same pipeline in AlbumentationsX, whose images are arrays (H, W, C); None where it is not installed."""
    library = optional("albumentations")
    if library is None:
        return None
    transform = PIPELINE.theirs(library, CROP[0])
    arrays = [image.permute(1, 2, 0).contiguous().numpy() for image in images]
    return lambda: torch.stack([torch.from_numpy(transform(image=array)["image"]) for array in arrays])


def torchvision_v2(images: list[Tensor], antialias: bool) -> Callable[[], Tensor] | None:
    """The same pipeline image by image, as torchvision takes images of different sizes; None where it is not installed."""
    v2: Any = optional("torchvision.transforms.v2")
    if v2 is None:
        return None
    transform = v2.Compose(
        [
            v2.RandomResizedCrop(CROP, antialias=antialias),
            v2.RandomHorizontalFlip(),
            v2.ColorJitter(*JITTER),
            v2.ToDtype(torch.float16, scale=True),
            v2.Normalize(MEAN, STD),
        ]
    )
    return lambda: torch.stack([transform(image) for image in images])


def one_by_one(call: Callable[[Tensor], Tensor], images: list[Tensor]) -> Tensor:
    return torch.cat([call(image[None]) for image in images])


# --- inputs of vision-language models ---------------------------------------------------------------------------------


def of_patches(setup: Setup) -> Iterator[Figure]:
    """Bars in milliseconds on one thread of a CPU, in floors of 64 images on CUDA."""
    if setup.is_cuda:
        sizes = [
            ("64 of 1024x1024", (1024, 1024), 1.5),
            ("64 of 2048x1536, limited to 1003520 pixels", (2048, 1536), 2.5),
        ]
        for name, size, bar in sizes:
            image = (255 * dead_leaves((3, *size))).byte().to(setup.device)
            images = [image.roll(7 * i, -1) for i in range(64)]
            call = partial(K.contrib.vision_patches, images, temporal_patch_size=1, dtype=torch.bfloat16)
            patches = call().patches
            moved = sum(x.numel() for x in images) + patches.numel() * patches.element_size()
            (seconds,) = setup.seconds_of([call])
            yield Figure("patches", f"Qwen2-VL, {name}, bfloat16", 1e3 * seconds, "ms")
            yield Figure("patches", f"Qwen2-VL, {name}, bfloat16", seconds * setup.bandwidth / moved, "floors", bar)
        return
    image = (255 * dead_leaves((3, SIDE, SIDE))).byte()[None]
    for times, dtype, bar in ((1, torch.bfloat16, 2.2), (2, torch.float32, 4.0)):
        call = partial(K.contrib.vision_patches, image, temporal_patch_size=times, dtype=dtype)
        (seconds,) = setup.seconds_of([call])
        kind = str(dtype).removeprefix("torch.")
        yield Figure("patches", f"Qwen2-VL, {SIDE}x{SIDE}, T = {times}, {kind}", 1e3 * seconds, "ms", bar)


# --- frames of video, antialiased warps -------------------------------------------------------------------------------


def of_frames(setup: Setup) -> Iterator[Figure]:
    """To float16 in one launch, against two calls. The floor reads the planes and writes the result."""
    count, (height, width) = 32 if setup.is_cuda else 1, FRAME
    frames = torch.randint(16, 236, (count, 3 * height // 2, width), dtype=torch.uint8, device=setup.device)
    edges = ((width - height) / 2.0, 0, (width + height) / 2, height)
    boxes = torch.tensor([edges], device=setup.device).expand(count, 4)
    colors = {"matrix": "bt709", "mean": MEAN, "std": STD, "dtype": torch.float16}
    half = (height // 2, width // 2)
    rgb = K.color.frames_to_rgb(frames, matrix="bt709")

    def in_two_calls(size: tuple[int, int], columns: slice = slice(None), antialias: bool = True) -> Tensor:
        converted = K.color.frames_to_rgb(frames, matrix="bt709")[..., columns]
        resized: Tensor = K.geometry.resize(converted, size, antialias=antialias)
        return resized

    center = slice(int(edges[0]), int(edges[2]))
    for name, call, both in (
        (
            "to 224x224 crops",
            lambda: K.color.resize_frames(frames, CROP, boxes, **colors),
            partial(in_two_calls, CROP, center, False),
        ),
        (
            "to 224x224 crops, antialiased",
            lambda: K.color.resize_frames(frames, CROP, boxes, antialias=True, **colors),
            partial(in_two_calls, CROP, center),
        ),
        (
            "to half size, antialiased",
            lambda: K.color.resize_frames(frames, half, antialias=True, **colors),
            partial(in_two_calls, half),
        ),
    ):
        result = call()
        moved = frames.numel() + result.numel() * result.element_size()
        seconds, two = setup.seconds_of([call, both])
        yield Figure("frames", name, 1e3 * seconds, "ms")
        yield Figure("frames", name, seconds * setup.bandwidth / moved, "floors", 1.5 if setup.is_cuda else None)
        yield Figure(
            "frames",
            f"frames_to_rgb and resize {name}, over that",
            two / seconds,
            "",
            2 if setup.is_cuda else None,
            True,
        )
    video = K.color.Frames(frames, matrix="bt709", dtype=torch.float16)
    crop = A.ImageSequential(
        A.RandomResizedCrop(CROP, antialias=True), A.RandomHorizontalFlip(), A.Normalize(MEAN, STD)
    )
    of_frames, of_images = setup.seconds_of(
        [partial(crop, video), lambda: crop(K.color.frames_to_rgb(frames, matrix="bt709", dtype=torch.float16))]
    )
    yield Figure("frames", "container: random crop, flip, normalize", 1e3 * of_frames, "ms")
    yield Figure("frames", "container of converted images, over that", of_images / of_frames, "")
    for name, call, moved in (
        ("frames_to_rgb", lambda: K.color.frames_to_rgb(frames, matrix="bt709"), frames.numel() + rgb.numel()),
        ("rgb_to_frames", lambda: K.color.rgb_to_frames(rgb, matrix="bt709"), frames.numel() + rgb.numel()),
    ):
        (seconds,) = setup.seconds_of([call])
        yield Figure("frames", f"{name}, bytes", 1e3 * seconds, "ms")
        yield Figure("frames", f"{name}, bytes", seconds * setup.bandwidth / moved, "floors")


def of_warps(setup: Setup) -> Iterator[Figure]:
    """Rotations that shrink. The floor reads the source and writes the result, once each; with a gradient, twice."""
    count = 16 if setup.is_cuda else 1
    images = dead_leaves((3, SIDE, SIDE)).to(setup.device).expand(count, -1, -1, -1).contiguous()
    leaf = images.clone().requires_grad_()
    for factor, bar in ((2, 1.8), (4, 2.5)):
        side = SIDE // factor
        center = torch.full((1, 2), SIDE / 2, device=setup.device)
        matrix = K.geometry.get_rotation_matrix2d(
            center, torch.tensor([20.0]).to(center), torch.full_like(center, 1 / factor)
        )
        matrix[:, :, 2] -= (SIDE - side) / 2
        matrix = matrix.expand(count, 2, 3)
        call = partial(K.geometry.warp_affine, images, matrix, (side, side), antialias=True)
        plain = partial(K.geometry.warp_affine, images, matrix, (side, side))

        def both(matrix: Tensor = matrix, side: int = side) -> Any:
            return torch.autograd.grad(K.geometry.warp_affine(leaf, matrix, (side, side), antialias=True).sum(), leaf)

        moved = (images.numel() + call().numel()) * images.element_size()
        forward, without, f_and_b = setup.seconds_of([call, plain, both])
        floor, on_h200 = moved / setup.bandwidth, setup.is_cuda
        yield Figure("warps", f"warp_affine to 1/{factor}, antialiased", 1e3 * forward, "ms")
        yield Figure(
            "warps", f"warp_affine to 1/{factor}, antialiased", forward / floor, "floors", bar if on_h200 else None
        )
        yield Figure("warps", f"warp_affine to 1/{factor}, plain", without / floor, "floors")
        yield Figure(
            "warps", f"and its gradient, 1/{factor}", f_and_b / (2 * floor), "floors", 3.5 if on_h200 else None
        )


# --- the command ----------------------------------------------------------------------------------------------------

GROUPS: dict[str, Callable[[Setup], Iterator[Figure]]] = {
    "bytes": of_bytes,
    "lists": of_lists,
    "frames": of_frames,
    "patches": of_patches,
    "warps": of_warps,
}


def write(path: Path, figures: Sequence[Figure], about: dict[str, Any]) -> None:
    """Replace the rows of the groups that were measured."""
    lines, rows = results.read(path) if path.exists() else ([], [])
    lines = lines or [f"# {about['hardware']}, torch {about['torch']}: `{about['command']}`"]
    measured = {figure.group for figure in figures}
    rows = [row for row in rows if row["group"] not in measured]
    for figure in figures:
        bar = "" if figure.bar is None else f"{figure.bar:g}"
        limit = "" if figure.bar is None else ("at least" if figure.at_least else "at most")
        value = f"{figure.value:.4g}" if figure.value < 1e4 else f"{figure.value:.0f}"
        rows.append(
            {
                "group": figure.group,
                "name": figure.name,
                "value": value,
                "unit": figure.unit,
                "bar": bar,
                "limit": limit,
            }
            | {"commit": about["commit"] or ""}
        )
    results.write(path, lines, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; default: all")
    parse.add_argument("--device", choices=("cpu", "cuda"), default="cuda" if torch.cuda.is_available() else "cpu")
    parse.add_argument("--threads", type=int, default=1, help="of torch and OpenCV on the CPU (default 1)")
    parse.add_argument("--photos", type=Path, metavar="FOLDER", help="photographs instead of drawn pictures")
    parse.add_argument("--count", type=int, default=256, help="files of a batch (default 256)")
    parse.add_argument("--seconds", type=float, default=0.5, help="time for one figure (default 0.5)")
    parse.add_argument("--csv", type=Path, help="table whose rows of the measured groups are replaced")
    options = parse.parse_args(arguments)
    unknown = [name for name in options.groups if name not in GROUPS]
    if unknown:
        parse.error(f"unknown groups {unknown}; there are {', '.join(GROUPS)}")
    device = torch.device(options.device)
    if device.type == "cpu":
        set_threads(options.threads)
    about = machine.describe(device, [])
    print(
        f"{about['hardware']}  {about['date']}  kvision {about['commit']}  torch {about['torch']}\n$ {about['command']}\n"
    )
    setup, figures = Setup(device, options.seconds, options.photos, options.count), []
    for name in options.groups or GROUPS:
        for figure in GROUPS[name](setup):
            print(figure, flush=True)
            figures.append(figure)
    if options.csv is not None:
        write(options.csv, figures, about)
    return 0


if __name__ == "__main__":
    sys.exit(main())
