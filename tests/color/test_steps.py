"""The table of color steps: one in csrc, one in Python, and numbers that never change."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
import torch

import kvision as K
from kvision import _backend, _ops
from kvision.color import program, steps
from kvision.color.steps import STEPS, Step

CSRC = Path(__file__).parents[2] / "csrc/color"

# The numbers that exported graphs contain. A new step is a new line at the end; no line ever changes.
NUMBERS = {
    "affine": 0,
    "rgb_to_hsv": 1,
    "hsv_to_rgb": 2,
    "rgb_to_hls": 3,
    "hls_to_rgb": 4,
    "rgb_to_linear_rgb": 5,
    "linear_rgb_to_rgb": 6,
    "rgb_to_lab": 7,
    "lab_to_rgb": 8,
    "rgb_to_luv": 9,
    "luv_to_rgb": 10,
    "luma_u8_fixed_point": 11,
    "hsv_u8": 12,
    "weighted_sum": 13,
    "luma_u8": 14,
    "scale_shift_rgb": 15,
    "standardize_rgb": 16,
    "saturation": 17,
    "saturation_raw": 18,
    "saturation_gray": 19,
    "hue": 20,
    "hue_raw": 21,
    "contrast": 22,
    "scale_shift": 23,
    "standardize": 24,
    "gamma": 25,
    "log": 26,
    "sigmoid": 27,
    "solarize": 28,
    "posterize": 29,
    "threshold": 30,
    "lightness_raw": 31,
}


def test_numbers_never_change() -> None:
    assert {name: step.number for name, step in STEPS.items()} == NUMBERS


def test_every_step_has_a_formula_and_a_reference() -> None:
    text = (CSRC / "steps.h").read_text()
    cases = re.findall(r"^ +KV_(?:VALUES|PIXELS)(?:_VJP)?\((\w+),", text, re.MULTILINE)
    _ops.import_modules()  # enhance has some of the references
    assert sorted(cases) == sorted(STEPS) == sorted(program._references)


CHAIN = (("brightness", 1.2), ("contrast", 0.8), ("hue", 0.3), ("normalize", (0.4, 0.5, 0.6), (0.2, 0.3, 0.4)))
# dtype and layout of the image, four steps, no columns.
PLAN = [-1, -1, 4, 23, 22, 20, 16]


@pytest.mark.native
@pytest.mark.skipif("cpu" in _backend.unserved, reason="the operators are declared by libkvision.so")
def test_exported_programs_outlive_new_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    image = torch.rand(2, 3, 5, 7)
    chain = K.enhance.ColorProgram(*CHAIN)
    file = io.BytesIO()
    torch.export.save(torch.export.export(chain, (image,)), file)
    expected = chain(image)

    number = len(STEPS)
    monkeypatch.setitem(STEPS, "added", Step(number, 0, "any", "numbers", "same", "always"))
    monkeypatch.setitem(steps.NAMES, number, "added")
    monkeypatch.setitem(program._references, "added", lambda x: x)
    file.seek(0)
    loaded = torch.export.load(file)
    (call,) = [n for n in loaded.graph.nodes if n.target is torch.ops.kvision.color_program_around_mean.default]
    assert call.args[8] == PLAN
    assert torch.equal(loaded.module()(image), expected)
    with K.backend("reference"):
        torch.testing.assert_close(loaded.module()(image), expected)
        parameters = program.arguments([1.2, 0.0, 1.0])
        y = program.run(image, [number, STEPS["scale_shift"].number, number], parameters)
        torch.testing.assert_close(y, (1.2 * image).clamp(0, 1))


@pytest.mark.skipif("cpu" in _backend.unserved, reason="the operators are declared by libkvision.so")
def test_schema_of_programs_never_changes() -> None:
    tensors = ", ".join(f"Tensor? p{i}" for i in range(program.MAX_TENSORS))
    schema = str(torch.ops.kvision.color_program.default._schema)
    assert (
        schema
        == f"kvision::color_program(Tensor input, {tensors}, Tensor? order, int[] plan, float[] numbers) -> Tensor"
    )


@pytest.mark.native
@pytest.mark.skipif("cpu" in _backend.unserved, reason="the operators are declared by libkvision.so")
def test_whether_a_step_clips_is_no_column() -> None:
    """Gradients follow from the number, of batches and of lists."""
    image, columns = torch.rand(1, 3, 2, 2), torch.ones(1, 1, 1)
    plan, numbers = [-1, -1, 1, STEPS["scale_shift"].number, -1, -1, 0], [2.0, 0.0, 0.0]
    with pytest.raises(RuntimeError, match="whether a step clips is a number"):
        torch.ops.kvision.color_program(image, columns, *(None,) * program.MAX_TENSORS, plan, numbers)
    plan, whole = [*plan[:4], -1, 0, -1], torch.zeros(1, 1, 1)
    y = torch.ops.kvision.color_program(image, whole, *(None,) * program.MAX_TENSORS, plan, numbers)
    assert torch.equal(y, 2 * image)
