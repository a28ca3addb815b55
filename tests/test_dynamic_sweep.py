"""Every public function exports with dynamic batch, channels, height and width, but for the listed ones.

That each compiles so is test_dynamic_compile.py: processes share the two files.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.export import Dim

import kvision as K
from benchmarks.sample_calls import WITHOUT_SAMPLE, SampleCall, Size, public_functions, sample_calls
from op_tests import assert_close

# The program is made at one size and called at another one. No two numbers of a size are equal, nor equal to the 2, 3, 4, 5 of
# coordinates, matrices and kernels: torch takes equal sizes of an example for the same. Functions of colors take three
# channels only.
SIZES = (
    (Size(7, 6, 22, 38), Size(11, 8, 34, 52)),
    (Size(7, 3, 22, 38), Size(11, 3, 34, 52)),
)
EVEN = ("rgb_to_yuv420", "rgb_to_yuv422", "yuv420_to_rgb", "yuv422_to_rgb")  # heights and widths are multiples of two

# What depends on more than the sizes, and why; at most 5% of the public names.
SIZE_OF_DATA = "the size of the result depends on the values"
NUMBERS = "gives a bool, a float or a list of floats of Python, computed from the values: a graph holds tensors"
LEFT_OUT = {
    **dict.fromkeys(("geometry.crop_by_boxes", "geometry.crop_by_boxes3d", "geometry.crop_by_indices"), SIZE_OF_DATA),
    "geometry.nms": SIZE_OF_DATA,
    **dict.fromkeys(
        (
            "geometry.validate_bbox",
            "geometry.validate_bbox3d",
            "metrics.auc_from_errors",
            "metrics.mean_average_precision",
        ),
        NUMBERS,
    ),
}
CALLS = {call.name: call for call in sample_calls() if call.makers}


class Call(nn.Module):
    def __init__(self, call: SampleCall) -> None:
        super().__init__()
        self.call = call

    def forward(self, tensors: dict[str, Tensor]) -> list[Tensor]:
        return flat(self.call.call(K, tensors))


def flat(value: Any) -> list[Tensor]:
    if isinstance(value, Tensor):
        return [value]
    return [tensor for part in value for tensor in flat(part)] if isinstance(value, (list, tuple)) else []


def examples(name: str, device: torch.device) -> tuple[dict[str, Tensor], dict[str, Tensor], list[Tensor]]:
    """Tensors at two sizes, and the results of the second ones. Skips the test of a function that is left out."""
    if name in LEFT_OUT:
        pytest.skip(LEFT_OUT[name])
    warnings.simplefilter("ignore")
    call = CALLS[name]
    for first, second in SIZES:
        try:
            call.call(K, call.tensors(first, device))
            tensors = call.tensors(second, device)
            return call.tensors(first, device), tensors, flat(call.call(K, tensors))
        except ValueError:
            continue
    raise AssertionError(f"{call.name} takes neither size")


@pytest.mark.tracing
@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_export(name: str, device: torch.device) -> None:
    first, second, expected = examples(name, device)

    def dimension(key: str, axis: int, size: int) -> Any:
        if size == second[key].shape[axis]:
            return None
        doubled = name.split(".")[1] in EVEN and axis >= first[key].dim() - 2
        return 2 * Dim(f"half{axis}") if doubled and key != "imageuv" else Dim.AUTO

    dynamic = {k: {i: dimension(k, i, n) for i, n in enumerate(x.shape)} for k, x in first.items()}
    program = torch.export.export(Call(CALLS[name]), (first,), dynamic_shapes=(dynamic,)).module()
    assert_close(list(program(second)), expected, 1e-4, 1e-5)


def test_the_guide_says_what_is_left_out() -> None:
    page = (Path(__file__).parents[1] / "docs/deployment.md").read_text()
    (paragraph,) = (
        p for p in page.split("\n\n") if p.startswith("Every public function that computes on tensors exports")
    )
    assert re.findall(r"`(\w+)`", paragraph) == [name.split(".")[1] for name in LEFT_OUT]


def test_few_functions_are_left_out() -> None:
    names = list(public_functions())
    assert set(LEFT_OUT) <= set(CALLS)
    assert len(LEFT_OUT) <= 0.05 * len(names)
    sampled = {call.name for call in sample_calls()}
    unknown = [name for name in names if name not in sampled and name not in WITHOUT_SAMPLE]
    assert not unknown, f"without arguments in benchmarks/sample_calls.py: {unknown}"
