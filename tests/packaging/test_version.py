"""One version: that of python/kvision/_version.py, which pip, CMake and the libraries take from there."""

from __future__ import annotations

import contextlib
import re
from importlib import metadata
from pathlib import Path

import pytest

import kvision as K
from kvision import _version

ROOT = Path(__file__).parents[2]


def test_the_package_and_its_metadata_have_it() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", K.__version__)
    assert (ROOT / "python/kvision/_version.py").read_text() == f'__version__ = "{K.__version__}"\n'
    assert _version.__version__ == K.__version__
    assert 'version = { attr = "kvision._version.__version__" }' in (ROOT / "pyproject.toml").read_text()
    with contextlib.suppress(metadata.PackageNotFoundError):  # run from the sources without an install
        assert metadata.version("kvision").removesuffix("+python") == K.__version__  # of a build without a compiler


def test_the_library_has_it() -> None:
    c = pytest.importorskip("kvision._C")
    assert c.version() == K.__version__


def test_the_cmake_package_has_it() -> None:
    config = ROOT / "python/kvision/lib/cmake/kvision/kvision-config-version.cmake"
    if not config.exists():
        pytest.skip("pure Python")
    assert f'set(PACKAGE_VERSION "{K.__version__}")' in config.read_text()


def test_the_changelog_leads_to_it() -> None:
    """It has no heading before tools/release.py writes it, and is the newest one after."""
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == "Unreleased"
    assert headings[1:2] in ([], [K.__version__])
