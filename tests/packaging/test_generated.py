"""What tools/generate.py writes is what the repository has."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

from kvision import _backend, _gradients, _ops

ROOT = Path(__file__).parents[2]
built = pytest.mark.skipif("cpu" in _backend.unserved, reason="the schemas are those of libkvision.so")


def load_generator() -> Any:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "tools/generate.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def without_layout(text: str) -> str:
    """A text without what clang-format and ruff decide."""
    return re.sub(r"\s|//|\\|,(?=\s*[})])", "", text)


@built
def test_files_are_what_the_generator_writes() -> None:
    for path, text in load_generator().generated():
        assert without_layout(path.read_text()) == without_layout(text), f"{path} differs: run tools/generate.py"


@built
def test_words_name_what_a_gradient_reads() -> None:
    operators = _ops.all_operators()
    kernel = operators["median_blur"].kernel

    def parse(words: str) -> list[_gradients.Entry]:
        return _gradients.parse("median_blur", words, kernel, operators.__getitem__)

    (entry,) = parse("input: median_blur_backward(output=detach(result))")
    assert entry.targets == (0,)
    assert entry.values[:3] == (("grad", 0), ("argument", 0), ("detach", 0))
    for words, message in (
        ("input: median_blur_backward", "has an argument output, which it has not"),
        ("input: median_blur_backward(output=result, size=3)", "has no argument size"),
        ("input: median_blur_backward(output=image)", "'image' is no value"),
    ):
        with pytest.raises(ValueError, match=message):
            parse(words)
