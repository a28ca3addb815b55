"""Options of the suite: `--device cuda`, `--backend reference`; hypothesis profiles by HYPOTHESIS_PROFILE."""

from __future__ import annotations

import gc
import os
import shutil
import sysconfig
import zlib
from collections.abc import Iterator
from pathlib import Path

# Tests run in parallel, each with one thread: more threads would spend half of the time in waits for one another. Tests
# that depend on the number of threads set it; theirs sleep while they wait, where others need the core: spinning would take five
# times as long as the calls. The variables are set before torch is imported, also for child processes.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OMP_WAIT_POLICY"] = "passive"

# A pool of compilers would import torch in each of its processes. Which vectors there are would be tried by compiling programs.
os.environ["TORCHINDUCTOR_COMPILE_THREADS"] = os.environ["TORCHINDUCTOR_VEC_ISA_OK"] = "1"

# torch keys cached graphs by operator names, so it would reuse graphs from before a schema or gradient changed.
os.environ["TORCHINDUCTOR_FX_GRAPH_CACHE"] = os.environ["TORCHINDUCTOR_AUTOGRAD_CACHE"] = "0"

# Pictures here are small. Corrupted ones may claim a billion pixels, for which OpenCV would spend seconds on memory.
os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(1 << 24)

import hypothesis
import pytest
import torch

from kvision import _backend
from op_tests import OpTests

hypothesis.settings.register_profile("quick", max_examples=30, deadline=None, derandomize=True)
# The same cases in every run: what fails is what was changed.
hypothesis.settings.register_profile("ci", max_examples=100, deadline=None, derandomize=True)
hypothesis.settings.register_profile("thorough", max_examples=5000, deadline=None, print_blob=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", default="cpu", choices=("cpu", "cuda"), help="where the tensors of the tests live")
    parser.addoption("--backend", default="native", choices=("native", "reference", "auto"), help="what is tested")
    parser.addoption("--sizes", default="all", choices=("all", "few"), help="which small sizes are swept")
    parser.addoption(
        "--thin",
        action="append",
        default=[],
        metavar="MARKER=N",
        help="of each parametrized test with this marker run a part of 1/N, rounded up, always the same one",
    )


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> torch.device:
    return torch.device(request.config.getoption("--device"))


@pytest.fixture(autouse=True, scope="session")
def backend(request: pytest.FixtureRequest) -> str:
    """Run the tests on this backend, in all threads. "native" uses the kernels where they exist."""
    name = request.config.getoption("--backend")
    _backend.set_default_backend("reference" if name == "reference" else "auto")
    return name


@pytest.fixture(scope="session")
def sizes(request: pytest.FixtureRequest) -> str:
    return request.config.getoption("--sizes")


@pytest.fixture(autouse=True)
def seed(device: torch.device) -> None:
    if (
        device.type == "cpu"
    ):  # torch.manual_seed would save the stack for each kind of GPU, which takes a sixth of a short test
        torch.default_generator.manual_seed(0)
    else:
        torch.manual_seed(0)


@pytest.fixture(scope="session")
def data() -> Path:
    """The optional folder of sample images next to the repository."""
    folder = Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the optional sample data is not there")
    return folder


@pytest.fixture(scope="session")
def cmake() -> str:
    """CMake, for the tests that compile C++."""
    if shutil.which(os.environ.get("CXX", "c++")) is None:
        pytest.skip("there is no C++ compiler")
    folders = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    return shutil.which("cmake", path=folders) or pytest.skip("cmake is not installed")


# Folders whose tests call operators; the others test files, containers and packaging.
OPERATORS = (
    *("augmentation", "color", "contrib", "deployment", "enhance", "feature", "filters", "geometry"),
    *("losses", "metrics", "morphology"),
)
# A test that compares with one of them names it.
PEERS = ("kornia", "opencv", "torchvision", "pil", "scipy", "scikit", "skimage")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect no garbage among the tests, neither while they are created, of which it takes a third, nor later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def thinned(items: list[pytest.Item], share: int) -> Iterator[pytest.Item]:
    """Of each parametrized test the ones to leave out of a run of one in `share`: at least one of its parameters stays."""
    tests: dict[str, list[pytest.Item]] = {}
    for item in items:
        tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for each in tests.values():
        each.sort(key=lambda item: zlib.crc32(item.nodeid.encode()))
        yield from each[-(-len(each) // share) :]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark tests by folder: `operators` for the folders above, the files next to this one, and docstring examples.

    `peers` are tests with another library in their name or their file's. `docstrings` are their examples.

    Files with slow tests come first, then those next to this one, many of which start programs, so that no process is left
    with one of them when the others are done.
    """
    here = Path(__file__).parent
    paths = {item.path for item in items}
    folders = {path: path.relative_to(here).parts[0] if path.is_relative_to(here) else None for path in paths}
    for item in items:
        folder = folders[item.path]
        if folder is None or folder in OPERATORS or folder == item.path.name:
            item.add_marker(pytest.mark.operators)
        if folder is None:
            item.add_marker(pytest.mark.docstrings)
        words = f"{item.path.stem}_{item.name.partition('[')[0]}".split("_")
        if any(word.startswith(PEERS) for word in words):
            item.add_marker(pytest.mark.peers)
    if config.option.device == "cpu":
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("gpu")])
        items[:] = [item for item in items if not item.get_closest_marker("gpu")]
    left = {
        item
        for marker, _, count in (option.partition("=") for option in config.option.thin)
        for item in thinned([item for item in items if item.get_closest_marker(marker)], int(count))
    }
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: (item.path not in slow, item.path.parent != here))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Where something will be compiled, let inductor make torch's own loops without vectors, in two thirds of the time.

    Processes that tests start make them with vectors.
    """
    if any(item.get_closest_marker("tracing") for item in session.items):
        import torch._inductor.config

        torch._inductor.config.cpp.simdlen = 1


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print what tests counted, whichever process ran them: `record_property("counts", ...)`."""
    for report in terminalreporter.stats.get("passed", []):
        for name, value in report.user_properties:
            if name == "counts":
                terminalreporter.write_line(f"{report.nodeid}: {value}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Tests of an OpTests class run once for every variant it declares."""
    if metafunc.cls is not None and issubclass(metafunc.cls, OpTests) and "variant" in metafunc.fixturenames:
        variants = metafunc.cls.variants
        metafunc.parametrize(
            "variant", variants, ids=["-".join(f"{k}={_short(v)}" for k, v in kw.items()) for kw in variants]
        )


def _short(value: object) -> str:
    return "tensor" if callable(value) else str(value).replace(" ", "")
