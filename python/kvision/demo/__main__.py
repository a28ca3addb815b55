"""`python -m kvision.demo [IMAGE ...]`: photographs in, a gallery of filtered ones out."""

from __future__ import annotations

import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NoReturn

import torch
import torch.nn.functional as F
from torch import Tensor

import kvision
from kvision._trace import native_operators
from kvision.core.exceptions import DeviceError, ImageError
from kvision.demo.arguments import demo_parser
from kvision.io import get_sample_images, load_image, write_image

try:
    import cv2
    from tqdm import tqdm

    from kvision.demo import attack, augmentation, color, features, filters, gallery, geometry, morphology
    from kvision.demo.restore import Restoration, blur, restore
    from kvision.demo.sheet import Column, Sheet, cores_left, run
except ModuleNotFoundError as error:
    if __name__ != "__main__":
        raise
    if not {"-h", "--help"}.isdisjoint(sys.argv[1:]):
        demo_parser().parse_args()  # the text needs no package
    sys.exit(f'kvision.demo needs {error.name}: pip install ".[demo]"')

SHEETS = [filters.SHEET, color.SHEET, geometry.SHEET, morphology.SHEET, features.SHEET]
SAMPLES = ("astronaut", "chelsea", "coffee", "rocket")
SIDE = 320  # pixels; photos are cropped to a square and brought to this size
STEPS = 150  # of the restoration

# Seconds of a recorded run, by which the bar goes on: a step of a sheet and those that take longer (the first one loads much), a
# row of augmentations, a step of the restoration, an iteration of the attack, a page of the gallery, and images in own files.
STEP, LONGER = 0.2, {"gaussian blur": 2.2, "bilateral": 2.0, "key points": 1.1, "matches": 1.3}
ROW, RESTORING, ATTACKING, PAGE, FILES = 0.3, 0.008, 0.056, 0.25, 0.6
LEFT = 0.7  # of the cores for torch's threads; with less, they wait for other work
BUSY = 1.5  # times the quickest of its calls that the middle one takes where the machine does other work


def main(arguments: Sequence[str] | None = None) -> int:
    options = demo_parser().parse_args(arguments)
    try:
        device = chosen_device(options.device)
        names, photos = load(options.images)
        options.out.mkdir(parents=True, exist_ok=True)
    except ImportError:  # of the photographs
        print('kvision.demo needs scikit-image: pip install ".[demo]"', file=sys.stderr)
        return 1
    except (OSError, DeviceError, ImageError) as error:
        print(f"kvision.demo: {error}", file=sys.stderr)
        return 2
    photos = photos.to(device)
    threads, left = torch.get_num_threads(), cores_left()
    if is_busy := left < LEFT * threads:
        torch.set_num_threads(1)  # or each call would wait for the thread that has no core
    cv2.setNumThreads(torch.get_num_threads())
    about = f"{len(photos)} photos of {SIDE}x{SIDE} on {device}, {torch.get_num_threads()} CPU threads"
    print(about)
    if is_busy:
        print(f"The machine is busy: torch gets {left:.1f} of {threads} cores. All runs on one thread.")
    done: list[tuple[Sheet, list[Column]]] = []
    pipelines = augmentation.rows(SIDE)
    attacks = attack.ITERATIONS if attack.PROGRAM.is_file() and len(names) > 1 else 0
    seconds = [LONGER.get(step.title, STEP) for sheet in SHEETS for step in sheet.steps]
    seconds += [ROW * len(pipelines), RESTORING * STEPS, ATTACKING * attacks, PAGE * (len(SHEETS) + 1), FILES]
    with tqdm(total=sum(seconds), bar_format="{desc}{percentage:3.0f}%|{bar}| {elapsed}<{remaining}") as bar:
        for sheet in SHEETS:
            columns = []
            for step in sheet.steps:
                bar.set_description(f"{step.title:14}")
                columns.append(run(step, photos))
                bar.update(LONGER.get(step.title, STEP))
            done.append((sheet, columns))
        augmented = []
        for row in pipelines:
            bar.set_description(f"{row.title.split(':')[0]:14}")
            augmented.append((row, augmentation.cells(row, photos[0], names[0])))
            bar.update(ROW)
        bar.set_description(f"{'restoring':14}")
        restored = restore(photos[:2], counted(bar, STEPS))
        attacked = None
        if attacks:
            bar.set_description(f"{'attacking':14}")
            before = bar.n
            attacked = attack.attack(
                list(photos) if options.images else [],
                device,
                lambda i, _: bar.update(before + ATTACKING * i - bar.n),
            )
        bar.set_description(f"{'writing':14}")
        pages = {sheet.title.split()[0].lower(): [section(sheet, columns, names, photos)] for sheet, columns in done}
        pages["augmentation"] = [augmentation.section(augmented, names[0])]
        pages["color"].append(wheel(photos[0], names[0], len(pages["color"][0].columns)))
        pages["filters"].append(restoration(restored, names, photos, len(pages["filters"][0].columns)))
        if attacked is not None:
            pages["features"].append(attack.section(attacked))
        for name, sections in pages.items():
            page = gallery.page(f"kvision {kvision.__version__}: {name}", about, sections)
            gallery.save(page, options.out / f"gallery_{name}.jpg")
            bar.update(PAGE)
        save_results(options.out, names, done, restored)
        bar.update(FILES)
    results = [column for _, columns in done for column in columns]
    print_table(results)
    print(busy(results), end="")
    backend = "native" if native_operators(lambda: blur(photos)) else "reference"
    print(
        f"\nrestored through gaussian_blur2d ({backend}) in {STEPS} steps: "
        f"loss {restored.losses[0]:.1e} -> {restored.losses[-1]:.1e}, "
        f"{decibels(restored)}\n"
        + (f"attacked: {attacked.figures}\n" if attacked is not None else "")
        + f"gallery: {options.out}/gallery_{{{','.join(pages)}}}.jpg"
    )
    return 0


def chosen_device(name: str) -> torch.device:
    if name == "cuda" and not torch.cuda.is_available():
        raise DeviceError("--device cuda: torch finds no CUDA device")
    return torch.device("cuda" if name == "auto" and torch.cuda.is_available() else name.replace("auto", "cpu"))


def load(paths: Sequence[Path]) -> tuple[list[str], Tensor]:
    """Names and a batch (B, 3, SIDE, SIDE) of the photos in these files, or of the samples if there are none."""
    pictures = [load_image(path) for path in paths] or get_sample_images(paths=SAMPLES)
    names = [path.stem for path in paths] or list(SAMPLES)
    return names, torch.stack([square(picture) for picture in pictures])


def square(picture: Tensor) -> Tensor:
    """The middle of an image (3, H, W) as (3, SIDE, SIDE)."""
    height, width = picture.shape[1:]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = picture[None, :, top : top + side, left : left + side]
    return F.interpolate(middle, (SIDE, SIDE), mode="bilinear", antialias=True)[0]


def section(sheet: Sheet, columns: Sequence[Column], names: Sequence[str], photos: Tensor) -> gallery.Section:
    """A sheet as a grid: the photos, then for each step its result, and its input where that is not the photos."""
    shown = [("photo", "", "x, a photo", photos)]
    for column in columns:
        if column.input is not None:
            shown.append((column.input[0], "", "x of the next column", column.input[1]))
        shown.append((column.title, f"{column.ms:.2f} ms", column.caption, column.pictures))
    rows = [(name, [gallery.picture(pictures[i]) for *_, pictures in shown]) for i, name in enumerate(names)]
    columns_shown = [(title, note) for title, note, *_ in shown]
    return gallery.Section(sheet.title, columns_shown, rows, [caption for _, _, caption, _ in shown])


def wheel(photo: Tensor, name: str, width: int) -> gallery.Section:
    """A row of `width` images of one photo with its hues rotated once around the circle."""
    columns = [(f"{round(360 * i / width)}°", "") for i in range(width)]
    cells = [gallery.picture(picture) for picture in color.hue_wheel(photo, width)]
    return gallery.Section(
        "Hues rotated by adjust_hue, by another angle for each image of the batch", columns, [(name, cells)]
    )


def restoration(restored: Restoration, names: Sequence[str], photos: Tensor, width: int) -> gallery.Section:
    """The restored photos side by side, and the curve of the loss in the rest of a row of `width` images."""
    columns, cells = [], []
    for i, name in enumerate(names[: len(restored.restored)]):
        columns += [(name, ""), ("blurred", ""), ("restored", "")]
        cells += [gallery.picture(x[i]) for x in (photos, restored.blurred, restored.restored)]
    left = width - len(cells)
    columns.append(("loss: squared difference of the blurred images", ""))
    cells.append(gallery.curve(restored.losses, left * SIDE + (left - 1) * gallery.GAP, SIDE))
    title = f"Restored by gradient descent through gaussian_blur2d: {decibels(restored)}"
    return gallery.Section(title, columns, [("", cells)])


def decibels(restored: Restoration) -> str:
    return f"PSNR {restored.blurred_psnr:.1f} -> {restored.restored_psnr:.1f} dB"


def save_results(
    folder: Path, names: Sequence[str], done: Sequence[tuple[Sheet, Sequence[Column]]], restored: Restoration
) -> None:
    """One PNG per photo and result, named by both."""
    results = {column.title: column.pictures for _, columns in done for column in columns}
    for title, pictures in {**results, "restored": restored.restored}.items():
        for i, (name, picture) in enumerate(zip(names, pictures)):
            write_image(folder / f"{i + 1}_{name}_{title.replace(' ', '_')}.png", picture)


def print_table(columns: Sequence[Column]) -> None:
    print(f"\n{'operator':16}{'backend':12}{'ms':>9}{'OpenCV ms':>12}")
    for column in columns:
        opencv = "-" if column.opencv_ms is None else f"{column.opencv_ms:.2f}"
        print(f"{column.title:16}{column.backend:12}{column.ms:9.2f}{opencv:>12}")


def busy(columns: Sequence[Column]) -> str:
    """A line about other work of the machine, where it made most calls slower."""
    slowdown = statistics.median(column.slowdown for column in columns)
    if slowdown < BUSY:
        return ""
    return f"\nThe machine is busy: half of the calls take {slowdown:.1f} times the quickest or more. The table has the quickest.\n"


def counted(bar: tqdm[NoReturn], steps: int) -> Iterator[int]:
    """0 to steps of the restoration, each counted on the bar once it is done."""
    for step in range(steps):
        yield step
        bar.update(RESTORING)


if __name__ == "__main__":
    sys.exit(main())
