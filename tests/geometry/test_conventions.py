"""The statements of docs/conventions.md."""

import inspect
import re
from pathlib import Path

import kvision as K

PAGE = (Path(__file__).parents[2] / "docs" / "conventions.md").read_text()


def test_the_code_of_the_page():
    names: dict[str, object] = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(example, names)


def test_defaults_of_align_corners():
    """The table names every function that has the argument, and its default."""
    rows = re.findall(r"^\| `(True|False|None)`[^|]*\| (.*) \|$", PAGE, re.MULTILINE)
    stated = {name: default for default, names in rows for name in re.findall(r"`(\w+)`", names)}
    results = {}
    for name in dir(K.geometry.transform):
        value = getattr(K.geometry.transform, name)
        if inspect.isfunction(value) and not name.startswith("_"):
            parameter = inspect.signature(value).parameters.get("align_corners")
            if parameter is not None:
                results[name] = str(parameter.default)
    results["Rescale"] = str(inspect.signature(K.geometry.Rescale).parameters["align_corners"].default)
    assert stated == results
