"""`python -m benchmarks.torch_costs`: what torch's own operators cost, in copies of the same image.

A figure is the time of a call over that of a copy of its image in the same rounds. Then what figures do not show: which
modes of `interpolate` take bytes, whether the gradient of `grid_sample` is the same in every run, and, where torchvision
has it, how far the GPU's JPEG decoder is from libjpeg.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import cv2
import torch
import torch.nn.functional as F
from torch import Tensor

import kvision as K
from benchmarks import machine
from benchmarks.case import photographs
from benchmarks.timing import Call, Clock, clock

SHAPE = (32, 3, 512, 512)


class Cost(NamedTuple):
    """A call on an image, by what it does. The figure is its time over that of `per` on the same image."""

    name: str
    call: Call
    per: Call


def blur_weights(x: Tensor) -> Tensor:
    taps = K.filters.get_gaussian_kernel1d(5, 1.5, device=x.device, dtype=x.dtype)
    return taps.expand(x.shape[1], 1, 1, 5)


def depthwise(x: Tensor) -> Call:
    row = blur_weights(x)
    weights = row.mT @ row
    return lambda: F.conv2d(x, weights, padding=2, groups=x.shape[1])


def separable(x: Tensor) -> Call:
    row = blur_weights(x)
    return lambda: F.conv2d(F.conv2d(x, row, padding=(0, 2), groups=3), row.mT.contiguous(), padding=(2, 0), groups=3)


def sampling(x: Tensor) -> Call:
    theta = torch.tensor([[[0.9, 0.1, 0.05], [-0.1, 0.9, 0.02]]], device=x.device, dtype=x.dtype)
    grid = F.affine_grid(theta.expand(len(x), 2, 3), list(x.shape), align_corners=False)
    return lambda: F.grid_sample(x, grid, align_corners=False)


def gathering(x: Tensor) -> Call:
    index = torch.randint(x[0, 0].numel(), x.flatten(2).shape, device=x.device)
    return lambda: x.flatten(2).gather(2, index)


def indexing(x: Tensor) -> Call:
    index = torch.randint(x[0, 0].numel(), (x[0, 0].numel(),), device=x.device)
    return lambda: x.flatten(2)[..., index]


def histogram(x: Tensor) -> Call:
    return partial(torch.histc, x, 256, 0, 1)


def counts(x: Tensor) -> Call:
    return partial(torch.bincount, (255 * x).long().flatten(), minlength=256)


def jitter(x: Tensor) -> Tensor:
    """Brightness, contrast and saturation by torch's operators."""
    x = (1.1 * x).clamp(0, 1)
    mean = K.color.rgb_to_grayscale(x).mean((1, 2, 3), keepdim=True)
    x = (0.9 * x + 0.1 * mean).clamp(0, 1)
    gray = (x * x.new_tensor([0.299, 0.587, 0.114])[:, None, None]).sum(1, keepdim=True)
    return (1.2 * x - 0.2 * gray).clamp(0, 1)


def backward(made: Callable[[Tensor], Call], x: Tensor) -> Call:
    leaf = x.clone().requires_grad_()
    result = made(leaf)()
    grad = torch.ones_like(result)
    return lambda: torch.autograd.grad(result, leaf, grad, retain_graph=True)


def costs(x: Tensor) -> Iterator[Cost]:
    copy = partial(torch.empty_like(x).copy_, x)
    last = x.to(memory_format=torch.channels_last)
    step = K.augmentation.ColorJitter(0.2, 0.2, 0.2, p=1.0)
    yield Cost("5x5 depthwise convolution", depthwise(x), copy)
    yield Cost("5x5 depthwise convolution, channels_last", depthwise(last), copy)
    yield Cost("5 + 5 depthwise convolutions", separable(x), copy)
    yield Cost("kvision's gaussian_blur2d 5x5", partial(K.filters.gaussian_blur2d, x, 5, (1.5, 1.5)), copy)
    yield Cost("color jitter of torch's operators", partial(jitter, x), copy)
    yield Cost("color jitter, torch.compile", partial(torch.compile(jitter), x), copy)
    yield Cost("kvision's ColorJitter", partial(step, x), copy)
    half = x.half()
    of_types: dict[str, Callable[[Tensor], Call]] = {
        "x * a + b": lambda x: lambda: x * 1.5 + 0.5,
        "antialiased resize to half": lambda x: partial(
            F.interpolate, x, scale_factor=0.5, mode="bilinear", antialias=True
        ),
        "grid_sample": sampling,
        "5x5 depthwise convolution": depthwise,
    }
    for name, made in of_types.items():
        if x.is_cuda:
            yield Cost(f"{name}: float16 over float32", made(half), made(x))
    yield Cost("grid_sample: backward over forward", backward(sampling, x), sampling(x))
    yield Cost("gather: backward over forward", backward(gathering, x), gathering(x))
    yield Cost("x[..., index]: backward over forward", backward(indexing, x), indexing(x))
    constant, noise = torch.full_like(x, 0.5), torch.rand_like(x)
    for name, made in {"histc": histogram, "bincount": counts}.items():
        yield Cost(f"{name}: a constant image over noise", made(constant), made(noise))


def byte_modes(x: Tensor) -> list[str]:
    """The modes in which `interpolate` takes bytes."""
    images, taken = (255 * x[:1]).byte(), []
    for mode in ("nearest", "nearest-exact", "bilinear", "bicubic", "area"):
        try:
            F.interpolate(images, scale_factor=0.5, mode=mode)
            taken.append(mode)
        except (RuntimeError, NotImplementedError):
            pass
    return taken


def repeats(x: Tensor) -> bool:
    """Whether two gradients of one `grid_sample` have the same bits."""
    call = backward(sampling, x)
    return torch.equal(call()[0], call()[0])


def jpeg_levels(x: Tensor) -> dict[str, int]:
    """Levels between the GPU's decoder and libjpeg, by the subsampling of chroma."""
    decode_jpeg = import_module("torchvision.io").decode_jpeg
    image = (255 * x[0]).byte().permute(1, 2, 0).cpu().numpy()
    levels = {}
    for name in ("444", "420"):
        _, data = cv2.imencode(
            ".jpg", image, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, getattr(cv2, f"IMWRITE_JPEG_SAMPLING_FACTOR_{name}")]
        )
        encoded = torch.from_numpy(data.ravel())
        levels[name] = int((decode_jpeg(encoded).int() - decode_jpeg(encoded, device="cuda").cpu().int()).abs().max())
    return levels


def over(timer: Clock, cost: Cost) -> float:
    call, per = (timer.value(timing) for timing in timer.race([cost.call, cost.per]))
    return call / per


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", choices=("cpu", "cuda"))
    parser.add_argument("--shape", default=SHAPE, type=lambda text: tuple(map(int, text.split("x"))), help="BxCxHxW")
    parser.add_argument("--seconds", default=0.5, type=float, help="of each contestant")
    args = parser.parse_args()
    device = torch.device(args.device)
    torch.set_num_threads(1)
    (x,) = photographs(args.shape, torch.float32, device)
    about: dict[str, Any] = machine.describe(device, ())
    print(
        f"{about['hardware']}, torch {about['torch']}, {'x'.join(map(str, x.shape))}, {about['command']}, {about['commit']}"
    )
    timer = clock(device, args.seconds)
    for cost in costs(x):
        print(f"{over(timer, cost):8.2f}  {cost.name}", flush=True)
    print("interpolate takes bytes by", ", ".join(byte_modes(x)))
    print("the gradient of grid_sample", "is" if repeats(x) else "is not", "the same in every run")
    if x.is_cuda:
        try:
            print("levels from libjpeg to nvJPEG, by sampling of chroma:", jpeg_levels(x))
        except (ImportError, RuntimeError) as error:
            print("nvJPEG was not compared:", str(error).splitlines()[0])


if __name__ == "__main__":
    main()
