"""torch.jit.trace records every public function; torch.jit.script says in one sentence what to use instead."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

import kvision as K
from benchmarks.sample_calls import SampleCall
from dynamic_calls import CALLS, SIZES, flat
from op_tests import assert_close
from test_public_api import public_modules, public_names

pytestmark = pytest.mark.programs

ROOT = "takes a root of a matrix in a torch.autograd.Function, which torch.jit.trace does not save"
LEFT_OUT = {
    "enhance.zca_mean": ROOT,
    "enhance.zca_whiten": ROOT,
    "geometry.crop_by_indices": "the size of the result depends on the values",
}


class Call(nn.Module):
    """A call whose images come from parameters, as behind a layer that was trained."""

    def __init__(self, call: SampleCall, names: list[str]) -> None:
        super().__init__()
        self.call, self.names = call, names
        self.gain = nn.Parameter(torch.ones(()))

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        gained = [x * self.gain.to(x.dtype) if x.is_floating_point() else x for x in tensors]
        return tuple(flat(self.call.call(K, dict(zip(self.names, gained)))))


def traced(module: nn.Module, *tensors: Tensor, path: Path) -> Callable[..., tuple[Tensor, ...]]:
    """The module, traced, saved and loaded."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which it records as numbers
        torch.jit.trace(module, tensors, check_trace=False).save(str(path))
        return torch.jit.load(str(path))


@pytest.mark.tracing
@pytest.mark.parametrize("name", CALLS)
def test_traced_program_gives_the_same(name: str, device: torch.device, tmp_path: Path) -> None:
    if name in LEFT_OUT:
        pytest.skip(LEFT_OUT[name])
    call = CALLS[name]
    for size, _ in SIZES:
        tensors = call.tensors(size._replace(b=2), device)
        try:
            expected = flat(call.call(K, tensors))
            break
        except ValueError:
            continue
    program = traced(Call(call, list(tensors)).to(device), *tensors.values(), path=tmp_path / "program.pt")
    assert_close(flat(program(*tensors.values())), expected, 1e-4, 1e-5)


@pytest.mark.tracing
def test_traced_program_has_gradients(device: torch.device, tmp_path: Path) -> None:
    image = torch.rand(2, 3, 16, 20, device=device, requires_grad=True)
    module = nn.Sequential(K.filters.GaussianBlur2d((5, 5), (1.0, 1.0)), K.filters.Sobel())
    program = traced(module, image, path=tmp_path / "program.pt")
    (result,) = torch.autograd.grad(program(image).square().sum(), image)
    (expected,) = torch.autograd.grad(module(image).square().sum(), image)
    assert_close(result, expected)


@pytest.mark.parametrize(
    "function",
    [
        K.filters.sobel,
        K.filters.gaussian_blur2d,
        K.color.rgb_to_hsv,
        K.geometry.warp_affine,
        K.losses.ssim_loss,
        K.filters.Sobel(),
        K.augmentation.RandomHorizontalFlip(),
        nn.Sequential(nn.Conv2d(3, 3, 3), K.filters.MedianBlur((3, 3))),
    ],
    ids=lambda f: getattr(f, "__name__", type(f).__name__),
)
def test_script_says_what_to_use(function: Callable[..., Tensor]) -> None:
    with pytest.raises(RuntimeError) as raised, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.script(function)
    message = str(raised.value)
    assert message.startswith("TorchScript error: kvision's ") and message.count(". ") == 0 and "\n" not in message
    assert "use torch.export (with AOTInductor where there is no Python) or torch.jit.trace" in message


def test_script_of_a_caller_says_it_too() -> None:
    def edges(image: Tensor) -> Tensor:
        return K.filters.sobel(image)

    with pytest.raises(RuntimeError, match="kvision's sobel is not compiled by torch.jit.script"):
        torch.jit.script(edges)


def test_script_of_every_function_and_module_says_it() -> None:
    silent = []
    for module in public_modules():
        for name in public_names(module):
            value = getattr(module, name)
            computes = inspect.isfunction(value) or (inspect.isclass(value) and issubclass(value, nn.Module))
            if computes and not (hasattr(value, "__script_unsupported") or hasattr(value, "__prepare_scriptable__")):
                silent.append(f"{module.__name__}.{name}")
    other = r"kvision\.(backend|patch_kornia|io\.\w+|augmentation\.random_generator\.\w+)"  # compute nothing on images
    assert not [name for name in silent if not re.fullmatch(other, name)]
