"""Every public function exports with dynamic batch, channels, height and width, except the listed ones.

Compilation is in test_dynamic_compile.py, so that two processes can run the two files at the same time.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.export import Dim

from benchmarks.sample_calls import WITHOUT_SAMPLE, public_functions, sample_calls
from dynamic_calls import CALLS, LEFT_OUT, Call, examples
from op_tests import assert_close

EVEN = ("rgb_to_yuv420", "rgb_to_yuv422", "yuv420_to_rgb", "yuv422_to_rgb")  # heights and widths are multiples of two


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


def test_guide_names_omitted_functions() -> None:
    page = (Path(__file__).parents[2] / "docs/deployment.md").read_text()
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
    assert not unknown, f"without an entry in benchmarks/sample_calls: {unknown}"
