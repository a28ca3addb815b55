"""Tools that tests of the build need; a test skips where they are not installed."""

from __future__ import annotations

import os
import shutil
import sysconfig

import pytest

PATH = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])


@pytest.fixture(scope="session")
def cmake() -> str:
    if shutil.which(os.environ.get("CXX", "c++")) is None:
        pytest.skip("there is no C++ compiler")
    return shutil.which("cmake", path=PATH) or pytest.skip("cmake is not installed")
