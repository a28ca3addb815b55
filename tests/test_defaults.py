"""What a call gives depends on its arguments: not on torch's default device and type, on autocast, or on forward mode elsewhere."""

from __future__ import annotations

import ast
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.autograd import forward_ad

import kvision as K
from benchmarks.sample_calls import Size, sample_calls
from benchmarks.sample_calls.augmentations import IMAGES, VOLUMES

CALLS = {call.name: call for call in sample_calls() if call.axes}
SIZES = (Size(2, 3, 8, 10), Size(2, 3, 24, 32))

# Without a tensor to follow, they follow torch's defaults, as torch's own do.
OF_NUMBERS = (
    *(
        "create_meshgrid",
        "create_meshgrid3d",
        "normal_transform_pixel",
        "normal_transform_pixel3d",
        "random_intrinsics",
    ),
    *(name.partition(".")[2] for name in CALLS if name.startswith("filters.get_")),
    "laplacian_1d",
)


@contextlib.contextmanager
def default_dtype(dtype: torch.dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


SURROUNDINGS: dict[str, Callable[[torch.device], Any]] = {
    "default device": lambda device: torch.device("meta"),
    "default dtype": lambda device: default_dtype(torch.float64),
    "autocast": lambda device: torch.autocast(device.type, torch.bfloat16),
    "forward mode of another": lambda device: forward_ad.dual_level(),
}


def flat(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ()
    return [tensor for part in parts for tensor in flat(part)]


@pytest.mark.sweep
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("surrounding", SURROUNDINGS)
def test_calls_do_not_depend_on_defaults(surrounding: str, device: torch.device) -> None:
    differs = []
    for name, call in CALLS.items():
        if name.partition(".")[2] in OF_NUMBERS and surrounding.startswith("default"):
            continue
        for size in SIZES:
            try:
                expected = flat(call.call(K, call.tensors(size, device)))
            except ValueError:
                continue
            tensors = call.tensors(size, device)
            try:
                with SURROUNDINGS[surrounding](device):
                    actual = flat(call.call(K, tensors))
                same = [
                    a.dtype == e.dtype and a.device == e.device and torch.allclose(a, e, 0, 0, equal_nan=True)
                    for a, e in zip(actual, expected, strict=True)
                ]
                if not all(same):
                    differs.append(name)
            except (RuntimeError, NotImplementedError) as error:
                differs.append(f"{name}: {error}")
            break
    assert not differs, "\n".join(differs)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16], ids=str)
def test_augmentations_do_not_depend_on_the_default_dtype(dtype: torch.dtype, device: torch.device) -> None:
    images, volumes = torch.rand(3, 3, 16, 301, device=device), torch.rand(3, 3, 6, 7, 301, device=device)
    variants = {a.name: (a.make(p=1.0), images) for a in IMAGES if a.name != "RandomFrost"}  # of a larger texture
    variants |= {a.name: (a.make(p=1.0), volumes) for a in VOLUMES}
    variants["RandomFrost"] = K.augmentation.RandomFrost(torch.rand(3, 20, 310), p=1.0), images
    variants["CoarseDropout of noise"] = K.augmentation.CoarseDropout(fill="random", p=1.0), images
    for name in ("RandAugment", "TrivialAugment"):
        variants[name] = getattr(K.augmentation.auto, name)(*((2, 10) if name == "RandAugment" else ())), images
    for name in ("gaussian_noise", "speckle_noise", "impulse_noise", "snow", "spatter"):
        variants[name] = K.augmentation.CommonCorruption(name, 3), images
    differs = []
    for name, (augment, x) in variants.items():
        for values in (x, x.double()):
            torch.manual_seed(3)
            expected = augment(values)
            torch.manual_seed(3)
            with default_dtype(dtype):
                try:
                    actual = augment(values)
                except (RuntimeError, TypeError) as error:
                    differs.append(f"{name}: {error}")
                    continue
            if actual.dtype != expected.dtype or not torch.equal(actual, expected):
                differs.append(name)
    assert not differs, "\n".join(differs)


# --- the lint -----------------------------------------------------------------------------------------------------------

FACTORIES = (
    *(
        "arange",
        "asarray",
        "empty",
        "eye",
        "full",
        "linspace",
        "logspace",
        "normal",
        "ones",
        "rand",
        "randint",
        "randn",
    ),
    *("randperm", "scalar_tensor", "tensor", "tril_indices", "triu_indices", "zeros"),
)
# Where a tensor is made of numbers alone, and where parameters of modules are made, torch's default device is meant.
MAKES_FROM_NUMBERS = (
    *(
        "augmentation/auto/operation_base.py",
        "constants.py",
        "demo/",
        "feature/hardnet.py",
        "feature/hynet.py",
        "feature/mkd.py",
        "feature/responses.py",
    ),
    *("feature/sift.py", "geometry/boxes.py", "geometry/collection.py", "geometry/epipolar/", "geometry/pointcloud.py"),
    *("geometry/quaternion.py", "geometry/transform/registration.py"),
)


def test_what_functions_make_says_where_it_lies() -> None:
    package = Path(K.__file__).parent
    silent = []
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if name.startswith(MAKES_FROM_NUMBERS):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            if node.func.attr not in FACTORIES or ast.unparse(node.func.value) != "torch":
                continue
            if not any(keyword.arg in ("device", None) for keyword in node.keywords):
                silent.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
    assert not silent, "\n".join(silent)


def test_pose_errors_keep_float32_under_autocast(device: torch.device) -> None:
    pose = torch.eye(4, device=device)[None, :3].repeat(2, 1, 1)
    turned = pose.clone()
    turned[:, :2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    with torch.autocast(device.type, torch.bfloat16):
        errors = K.metrics.pose_errors(pose, turned)
    assert errors["R_err"].dtype == torch.float32 and torch.equal(
        errors["R_err"], torch.full((2,), 90.0, device=device)
    )
