"""Policies and mixtures against PIL, on bytes, and augmentations with fixed parameters against OpenCV and torchvision."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image, ImageEnhance, ImageFilter, ImageOps
from torch import Tensor

import kvision.augmentation as A
from benchmarks.case import dead_leaves
from kvision.augmentation.auto import AugMix, RandAugment, TrivialAugment
from kvision.augmentation.auto.operation_table import OPERATIONS

H, W = 48, 64


def pictures(batch: int) -> Tensor:
    """Different pictures, uint8 (B, 3, H, W), with edges, flat regions and a little noise."""
    leaves = (255 * dead_leaves((3, H, W))).round().byte()
    return torch.stack([leaves.roll((7 * i, 13 * i), (1, 2)) // (1 + i % 2) for i in range(batch)])


# --- PIL ------------------------------------------------------------------------------------------------------------


def affine(image: Image.Image, *rows: float) -> Image.Image:
    """By the map from pixels of the result, whose center of coordinates is that of the image."""
    a, b, c, d, e, f = rows
    x, y = image.width / 2, image.height / 2
    from_result = (a, b, c + x - a * x - b * y, d, e, f + y - d * x - e * y)
    return image.transform(image.size, Image.Transform.AFFINE, from_result, Image.Resampling.BILINEAR)


MOVES: dict[str, Callable[[Image.Image, float], Image.Image]] = {
    "rotate": lambda image, v: image.rotate(v, Image.Resampling.BILINEAR),
    "shear_x": lambda image, v: affine(image, 1, v, 0, 0, 1, 0),
    "shear_y": lambda image, v: affine(image, 1, 0, 0, v, 1, 0),
    "translate_x": lambda image, v: affine(image, 1, 0, -v * image.width, 0, 1, 0),
    "translate_y": lambda image, v: affine(image, 1, 0, 0, 0, 1, -v * image.height),
    "translate_x_pixels": lambda image, v: affine(image, 1, 0, -v, 0, 1, 0),
    "translate_y_pixels": lambda image, v: affine(image, 1, 0, 0, 0, 1, -v),
}
COLORS: dict[str, Callable[[Image.Image, float], Image.Image]] = {
    "identity": lambda image, v: image,
    "auto_contrast": lambda image, v: ImageOps.autocontrast(image),
    "equalize": lambda image, v: ImageOps.equalize(image),
    "invert": lambda image, v: ImageOps.invert(image),
    "posterize": lambda image, v: ImageOps.posterize(image, round(v)) if round(v) else image.point(lambda _: 0),
    "solarize": lambda image, v: ImageOps.solarize(image, 255 * v),  # type: ignore[arg-type]  # numbers between levels, too
    "color": lambda image, v: ImageEnhance.Color(image).enhance(v),
    "contrast": lambda image, v: ImageEnhance.Contrast(image).enhance(v),
    "brightness": lambda image, v: ImageEnhance.Brightness(image).enhance(v),
    "sharpness": lambda image, v: ImageEnhance.Sharpness(image).enhance(v),
}
NAMES = {operation.number: name for name, operation in OPERATIONS.items()}


def by_pil(x: Tensor, params: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """The images (B, H, W, 3) one by one, from the parameters of a policy, and whether pixels are away from what was outside."""
    results, inside = [], []
    for i, pixels in enumerate(x):
        image, known = Image.fromarray(pixels.movedim(0, -1).numpy()), Image.new("L", (W, H), 255)
        for item in params:
            number, value = int(item.data["operation"][i]), float(item.data["magnitude"][i])
            if number < 0:
                continue
            name = NAMES[number]
            image = (MOVES.get(name) or COLORS[name])(image, value)
            if name in MOVES:  # at a border PIL repeats half a pixel, which kvision blends with black
                known = MOVES[name](known.point(lambda level: 255 * (level == 255)), value).filter(
                    ImageFilter.MinFilter(3)
                )
                known.paste(0, (0, 0, W, 1)), known.paste(0, (0, H - 1, W, H))
                known.paste(0, (0, 0, 1, H)), known.paste(0, (W - 1, 0, W, H))
        results.append(np.asarray(image, np.float64))
        inside.append(np.asarray(known) == 255)
    return np.stack(results), np.stack(inside)


def levels(y: Tensor) -> np.ndarray:
    return y.movedim(1, -1).numpy().astype(np.float64)


RANGES = {
    **dict.fromkeys(("shear_x", "shear_y"), (0.0, 0.3)),
    **dict.fromkeys(("translate_x", "translate_y"), (0.0, 150 / 331)),
    **dict.fromkeys(("translate_x_pixels", "translate_y_pixels"), (0.0, 16.0)),
    **dict.fromkeys(("color", "contrast", "brightness", "sharpness"), (1.0, 1.9)),
    "rotate": (0.0, 30.0),
    "posterize": (8.0, 0.0),
    "solarize": (1.0, 0.0),
}


@pytest.mark.parametrize("name", [*MOVES, *COLORS])
def test_an_operation_is_that_of_pil(name: str) -> None:
    x, augment = pictures(24), TrivialAugment([[(name, *RANGES.get(name, (0.0, 0.0)))]])
    y = augment(x, seed=1)
    expected, inside = by_pil(x, augment._params)
    error = np.abs(levels(y) - expected)[inside]
    assert inside.mean() > 0.4
    # PIL rounds grays, and truncates results.
    assert error.max() <= {"color": 2, "contrast": 2, "sharpness": 2}.get(
        name, 0 if name in ("identity", "invert") else 1
    )


def test_policies_of_pil() -> None:
    x, augment = pictures(64), RandAugment(2, 9)
    y = augment(x, seed=1)
    expected, inside = by_pil(x, augment._params)
    error = np.abs(levels(y) - expected)[inside]
    # Rounding may carry a value across a threshold of solarize, or a level of equalize and posterize.
    assert (error <= 3).mean() > 0.98 and error.mean() < 0.7


@pytest.mark.parametrize("severity", [3, 10])
def test_mixtures_of_pil(severity: int) -> None:
    x, augment = pictures(48), AugMix(severity)
    y = augment(x, seed=1)
    params = augment._params
    weights = params[0].data["weights"].double().numpy()[..., None, None, None]
    mixture, inside = weights[:, 0] * levels(x), np.ones((len(x), H, W), bool)
    for i in range(augment.mixture_width):
        chain, known = by_pil(x, params[3 * i : 3 * i + 3])
        mixture, inside = mixture + weights[:, i + 1] * chain, inside & known
    error = np.abs(levels(y) - mixture)[inside]
    assert inside.mean() > 0.3 and (error <= 3).mean() > 0.98 and error.mean() < 0.7


# --- OpenCV ---------------------------------------------------------------------------------------------------------


def smooth(batch: int = 4) -> Tensor:
    """Pictures in [0, 1], float32, without edges."""
    blurred = [cv2.GaussianBlur(image, (9, 9), 2) for image in arrays(pictures(batch) / 255)]
    return torch.stack([torch.from_numpy(image).movedim(-1, 0) for image in blurred])


def arrays(x: Tensor) -> list[np.ndarray]:
    return [np.ascontiguousarray(image.movedim(0, -1).numpy()) for image in x]


def rotation(p: dict[str, np.ndarray], image: np.ndarray) -> np.ndarray:
    matrix = cv2.getRotationMatrix2D(((W - 1) / 2, (H - 1) / 2), float(p["degrees"]), 1.0)
    return cv2.warpAffine(image, matrix, (W, H))


def rotation_scale_translation(p: dict[str, np.ndarray], image: np.ndarray) -> np.ndarray:
    matrix = cv2.getRotationMatrix2D(((W - 1) / 2, (H - 1) / 2), float(p["angle"]), float(p["scale"][0]))
    matrix[:, 2] += p["translations"]
    return cv2.warpAffine(image, matrix, (W, H))


def corners(p: dict[str, np.ndarray], image: np.ndarray, before: str, after: str, size: tuple[int, int]) -> np.ndarray:
    matrix = cv2.getPerspectiveTransform(p[before].astype(np.float32), p[after].astype(np.float32))
    return cv2.warpPerspective(image, matrix, size)


def elastic(p: dict[str, np.ndarray], image: np.ndarray) -> np.ndarray:
    blurred = [cv2.GaussianBlur(n, (31, 31), 5.0, borderType=cv2.BORDER_CONSTANT) for n in p["noise"]]
    x, y = np.meshgrid(np.arange(W, dtype=np.float32), np.arange(H, dtype=np.float32))
    return cv2.remap(image, x + blurred[0] * W / 2, y + blurred[1] * H / 2, cv2.INTER_LINEAR)


def hue(p: dict[str, np.ndarray], image: np.ndarray) -> np.ndarray:
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
    hsv[..., 0] = (hsv[..., 0] + 360 * float(p["hue_factor"])) % 360
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)


def gray(p: dict[str, np.ndarray], image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)


Reference = Callable[[dict[str, np.ndarray], np.ndarray], np.ndarray]
OPENCV: dict[str, tuple[Callable[[], Any], Reference]] = {
    "rotation": (lambda: A.RandomRotation(40.0, p=1.0), rotation),
    "affine": (lambda: A.RandomAffine(40.0, (0.1, 0.1), (0.8, 1.3), p=1.0), rotation_scale_translation),
    "perspective": (
        lambda: A.RandomPerspective(0.5, p=1.0),
        lambda p, image: corners(p, image, "start_points", "end_points", (W, H)),
    ),
    "resized crop": (
        lambda: A.RandomResizedCrop((40, 44), (0.2, 0.9)),
        lambda p, image: corners(p, image, "src", "dst", (44, 40)),
    ),
    "flip": (lambda: A.RandomHorizontalFlip(p=1.0), lambda p, image: cv2.flip(image, 1)),
    "elastic": (lambda: A.RandomElasticTransform((31, 31), (5.0, 5.0), p=1.0), elastic),
    "gaussian blur": (
        lambda: A.RandomGaussianBlur((7, 7), (0.5, 2.0), p=1.0),
        lambda p, image: cv2.GaussianBlur(image, (7, 7), float(p["sigma"]), borderType=cv2.BORDER_REFLECT_101),
    ),
    "box blur": (
        lambda: A.RandomBoxBlur((5, 5), p=1.0),
        lambda p, image: cv2.blur(image, (5, 5), borderType=cv2.BORDER_REFLECT_101),
    ),
    "hue": (lambda: A.RandomHue((-0.5, 0.5), p=1.0), hue),
    "grayscale": (lambda: A.RandomGrayscale(p=1.0), gray),
}


@pytest.mark.parametrize("name", OPENCV)
def test_fixed_parameters_in_opencv(name: str, device: torch.device) -> None:
    make, reference = OPENCV[name]
    x, augment = smooth(), make()
    y = augment(x.to(device), seed=3).cpu()
    params = {key: value.numpy() for key, value in augment._params.items()}
    for i, image in enumerate(arrays(x)):
        expected = reference({key: value[i] for key, value in params.items() if len(value) == len(x)}, image)
        error = np.abs(y[i].movedim(0, -1).numpy() - expected)
        assert error.max() < 2e-4, (name, i, error.max(), error.mean())


# --- torchvision ----------------------------------------------------------------------------------------------------


def jitter(T: Any, p: dict[str, Tensor], x: Tensor) -> Tensor:
    adjust = (
        lambda x: T.adjust_brightness(x, float(p["brightness_factor"])),
        lambda x: T.adjust_contrast(x, float(p["contrast_factor"])),
        lambda x: T.adjust_saturation(x, float(p["saturation_factor"])),
        lambda x: T.adjust_hue(x, float(p["hue_factor"])),
    )
    for index in p["order"].tolist():
        x = adjust[index](x)
    return x


TORCHVISION: dict[str, tuple[Callable[[], Any], Callable[[Any, dict[str, Tensor], Tensor], Tensor]]] = {
    "rotation": (
        lambda: A.RandomRotation(40.0, p=1.0),
        lambda T, p, x: T.rotate(x, float(p["degrees"]), T.InterpolationMode.BILINEAR),
    ),
    "affine": (
        lambda: A.RandomAffine(40.0, (0.1, 0.1), (0.8, 1.3), p=1.0),
        lambda T, p, x: T.affine(
            x,
            -float(p["angle"]),  # clockwise
            p["translations"].tolist(),
            float(p["scale"][0]),
            [0.0, 0.0],
            T.InterpolationMode.BILINEAR,
        ),
    ),
    "perspective": (
        lambda: A.RandomPerspective(0.5, p=1.0),
        lambda T, p, x: T.perspective(
            x,
            (p["start_points"] + 0.5).tolist(),  # from the edges of the image
            (p["end_points"] + 0.5).tolist(),
            T.InterpolationMode.BILINEAR,
        ),
    ),
    "jitter": (lambda: A.ColorJitter(0.4, 0.4, 0.4, 0.3), jitter),
    "solarize": (
        lambda: A.RandomSolarize((0.2, 0.8), (0.0, 0.0), p=1.0),
        lambda T, p, x: T.solarize(x, float(p["thresholds"])),
    ),
    "sharpness": (
        lambda: A.RandomSharpness((0.5, 2.0), p=1.0),
        lambda T, p, x: T.adjust_sharpness(x, float(p["sharpness"])),
    ),
    "gaussian blur": (
        lambda: A.RandomGaussianBlur((7, 7), (0.5, 2.0), p=1.0),
        lambda T, p, x: T.gaussian_blur(x, [7, 7], [float(p["sigma"])] * 2),
    ),
    "auto contrast": (lambda: A.RandomAutoContrast(p=1.0), lambda T, p, x: T.autocontrast(x)),
    "invert": (lambda: A.RandomInvert(p=1.0), lambda T, p, x: T.invert(x)),
}


@pytest.mark.parametrize("name", TORCHVISION)
def test_fixed_parameters_in_torchvision(name: str, device: torch.device) -> None:
    try:
        import torchvision.transforms.v2.functional as functional
    except (ImportError, RuntimeError) as error:  # a build for another torch
        pytest.skip(f"torchvision cannot be imported: {error}")
    make, reference = TORCHVISION[name]
    x, augment = smooth().to(device), make()
    y = augment(x, seed=3)
    for i, image in enumerate(x):
        params = {key: value[i] for key, value in augment._params.items() if len(value) == len(x)}
        expected = reference(functional, params, image)
        error = (y[i] - expected).abs()
        # A value may fall to the other side of a threshold.
        assert error.mean() < 1e-4 and (error < 1e-3).float().mean() > 0.999, (name, i, error.max())
