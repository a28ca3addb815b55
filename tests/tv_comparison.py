"""v2's calls that kvision.tv repeats with the same seeds, and how far results may differ."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

HEIGHT, WIDTH = 61, 54


def photograph(seed: int = 0) -> Tensor:
    """A uint8 image (3, H, W) with smooth parts, edges and noise."""
    torch.manual_seed(seed)
    smooth = torch.nn.functional.interpolate(torch.rand(1, 3, 5, 6), (HEIGHT, WIDTH), mode="bicubic")[0] * 255
    return (smooth + 12 * torch.randn(3, HEIGHT, WIDTH)).clamp(0, 255).to(torch.uint8)


# Names of classes, positional and named arguments; colors of floats are in [0, 1].
MOVES: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("RandomHorizontalFlip", (), {"p": 0.7}),
    ("RandomVerticalFlip", (), {"p": 0.7}),
    ("Resize", (40,), {}),
    ("Resize", ((33, 50),), {"interpolation": "bicubic"}),
    ("Resize", ((90, 41),), {"antialias": False}),
    ("Resize", (None,), {"max_size": 90, "interpolation": "nearest-exact"}),
    ("CenterCrop", (32,), {}),
    ("CenterCrop", ((80, 31),), {}),
    ("RandomCrop", (32,), {}),
    ("RandomCrop", ((70, 60),), {"padding": [3, 4, 5, 6], "pad_if_needed": True, "fill": 3}),
    ("RandomResizedCrop", (24,), {}),
    ("Pad", ([1, 2, 3, 4],), {"fill": 7}),
    ("RandomZoomOut", (), {"p": 0.7, "fill": 3}),
    ("RandomRotation", (40,), {"fill": 1}),
    ("RandomRotation", (40,), {"interpolation": "bilinear", "expand": True}),
    (
        "RandomAffine",
        (30,),
        {"translate": (0.1, 0.2), "scale": (0.7, 1.2), "shear": [-10, 10, -5, 5], "interpolation": "bilinear"},
    ),
    ("RandomAffine", (30,), {"shear": 7, "center": [10, 20], "fill": None}),
    ("RandomPerspective", (), {"p": 0.7}),
    ("ElasticTransform", (), {}),
    ("ScaleJitter", ((50, 60),), {}),
    ("RandomShortestSize", ([30, 40],), {"max_size": 50}),
    ("RandomResize", (30, 45), {}),
    ("RandomIoUCrop", (), {}),
    ("ConvertBoundingBoxFormat", ("XYWH",), {}),
    ("ClampBoundingBoxes", (), {}),
    ("ClampKeyPoints", (), {}),
    ("SetClampingMode", (None,), {}),
    ("SanitizeBoundingBoxes", (), {"min_size": 20}),
    ("SanitizeKeyPoints", (), {}),
    ("ToPureTensor", (), {}),
    ("Identity", (), {}),
    ("ToDtype", (torch.float32, True), {}),
    ("Grayscale", (3,), {}),
    ("ColorJitter", (0.3,), {}),
]
COLORS: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = [
    ("Grayscale", (), {}),
    ("RandomGrayscale", (), {"p": 0.7}),
    ("RGB", (), {}),
    ("ColorJitter", (0.4, 0.4, 0.4, 0.2), {}),
    ("RandomPhotometricDistort", (), {}),
    ("RandomChannelPermutation", (), {}),
    ("RandomInvert", (), {"p": 0.7}),
    ("RandomPosterize", (3,), {"p": 0.7}),
    ("RandomSolarize", (0.4,), {"p": 0.7}),
    ("RandomAdjustSharpness", (2.0,), {"p": 0.7}),
    ("RandomAutocontrast", (), {"p": 0.7}),
    ("RandomEqualize", (), {"p": 0.7}),
    ("GaussianBlur", (5,), {}),
    ("GaussianBlur", ((5, 9), (0.5, 1.0)), {}),
    ("GaussianNoise", (), {}),
    ("JPEG", ((20, 70),), {}),
    ("RandomErasing", (), {"p": 0.7}),
    ("RandomErasing", (), {"p": 0.7, "value": "random"}),
    ("RandomErasing", (), {"p": 0.7, "value": [0.1, 0.2, 0.3]}),
    ("ConvertImageDtype", (), {}),
    ("Normalize", ([0.4, 0.5, 0.6], [0.2, 0.2, 0.3]), {}),
    ("AutoAugment", (), {}),
    ("RandAugment", (), {"fill": 3}),
    ("TrivialAugmentWide", (), {}),
    ("AugMix", (), {}),
    ("ToPILImage", (), {}),
    ("ToImage", (), {}),
    ("UniformTemporalSubsample", (3,), {}),
]
# Chains of functions that each truncate bytes: an error of one level may grow.
CHAINS = ("ColorJitter", "RandomPhotometricDistort", "AutoAugment", "RandAugment", "AugMix")


def differences(ours: Any, theirs: Any, levels: float = 1, floats: float = 2e-5, where: str = "") -> list[str]:
    """What differs: types, formats, shapes, or more than .1% of the values by more than `levels` or `floats`."""
    if type(ours) is not type(theirs):
        return [f"{where}: {type(ours).__name__}, not {type(theirs).__name__}"]
    if isinstance(theirs, dict):
        return [d for k in theirs for d in differences(ours[k], theirs[k], levels, floats, f"{where}.{k}")]
    if isinstance(theirs, (tuple, list)):
        pairs = enumerate(zip(ours, theirs, strict=True))
        return [d for i, (x, y) in pairs for d in differences(x, y, levels, floats, f"{where}[{i}]")]
    if hasattr(theirs, "getbands"):
        import numpy as np

        if (ours.mode, ours.size) != (theirs.mode, theirs.size):
            return [f"{where}: {ours}, not {theirs}"]
        ours, theirs = (torch.from_numpy(np.array(x)) for x in (ours, theirs))
    if not isinstance(theirs, Tensor):
        return [] if ours == theirs else [f"{where}: {ours!r}, not {theirs!r}"]
    found = [
        f"{where}: {name} {getattr(ours, name)}, not {getattr(theirs, name)}"
        for name in ("shape", "dtype", "format", "canvas_size", "clamping_mode")
        if getattr(ours, name, None) != getattr(theirs, name, None)
    ]
    if not found:
        distance = (ours.as_subclass(Tensor).double() - theirs.as_subclass(Tensor).double()).abs()
        limit = floats if theirs.is_floating_point() else levels
        share = (distance > limit).double().mean() if distance.numel() else 0.0
        if share > 1e-3:
            found.append(f"{where}: {share:.2%} differ, by {distance.max():.3g} at most")
    return found


def recipes(m: Any) -> dict[str, tuple[str, Any]]:
    """The presets of torchvision's training scripts, of a module, and the kind of sample that they take."""
    from torchvision.tv_tensors import Mask

    to_float = m.ToDtype(torch.float32, scale=True)
    normalize = m.Normalize((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
    end, flip = [to_float, normalize], m.RandomHorizontalFlip()
    train = [m.RandomResizedCrop(32, antialias=True), flip, m.TrivialAugmentWide(), *end, m.RandomErasing(0.1)]
    out = m.RandomZoomOut(fill={"others": (123.0, 117.0, 104.0), Mask: 0})
    jitter = [m.ScaleJitter((50, 50)), m.RandomCrop(50, pad_if_needed=True, fill=0), flip, to_float]
    crop = m.RandomCrop(28, pad_if_needed=True)
    return {
        "classification": ("classification", train),
        "evaluation": ("classification", [m.Resize(40, antialias=True), m.CenterCrop(32), *end]),
        "SSD": ("detection", [m.RandomPhotometricDistort(), out, m.RandomIoUCrop(), flip, to_float]),
        "large scale jitter": ("detection", [*jitter, m.SanitizeBoundingBoxes()]),
        "multiscale": ("detection", [m.RandomShortestSize((30, 40, 50), max_size=70), flip, to_float]),
        "segmentation": ("segmentation", [m.RandomResize(30, 100), flip, crop, *end]),
        "video": ("video", [to_float, m.Resize((40, 50), antialias=False), flip, normalize, m.RandomCrop((32, 32))]),
    }
