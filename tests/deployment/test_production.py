"""From Python to production: programs of torch.export, and AOTInductor packages that run without kvision's Python or any."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

import kvision as K
from kvision import _backend
from op_tests import assert_close

pytestmark = pytest.mark.programs

ROOT = Path(__file__).parents[2]


class Sharpness(nn.Module):
    """A typical pipeline of an application: filters, a learned threshold, a reduction."""

    def __init__(self) -> None:
        super().__init__()
        self.filters = nn.Sequential(
            K.filters.GaussianBlur2d((5, 5), (1.0, 1.0)), K.filters.BoxBlur(3), K.filters.Sobel()
        )
        self.threshold = nn.Parameter(torch.tensor(0.1))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        edges = self.filters(image)
        return edges, torch.sigmoid(50 * (edges - self.threshold)).mean(dim=(1, 2, 3))


@pytest.fixture
def model(device: torch.device) -> nn.Module:
    return Sharpness().to(device)


@pytest.fixture
def program(model: nn.Module, device: torch.device) -> torch.export.ExportedProgram:
    """The model as a graph of operators, for any batch size."""
    image = torch.rand(2, 3, 16, 20, device=device)
    return torch.export.export(model, (image,), dynamic_shapes=({0: torch.export.Dim.DYNAMIC},))


@pytest.mark.tracing
def test_export_with_a_dynamic_batch(
    model: nn.Module, program: torch.export.ExportedProgram, device: torch.device
) -> None:
    for batch in (1, 2, 5):
        image = torch.rand(batch, 3, 16, 20, device=device)
        assert_close(program.module()(image), model(image))


@pytest.mark.tracing
def test_exported_program_calls_the_operators(program: torch.export.ExportedProgram, backend: str) -> None:
    if backend == "reference" or _backend.unserved.get("cpu"):
        pytest.skip("the reference is traced into torch's own operators")
    called = {str(node.target) for node in program.graph.nodes if node.op == "call_function"}
    assert "kvision.sobel.default" in called and "kvision.box_blur.default" in called


@pytest.mark.slow
def test_aoti_package_runs_without_python_code(
    model: nn.Module, program: torch.export.ExportedProgram, device: torch.device, tmp_path: Path
) -> None:
    package = torch._inductor.aoti_compile_and_package(program, package_path=str(tmp_path / "model.pt2"))
    image = torch.rand(5, 3, 16, 20, device=device)
    torch.save({"image": image, "expected": model(image)}, tmp_path / "case.pt")
    script = """
import sys, torch
package, case, *libraries = sys.argv[1:]
for library in libraries:
    torch.ops.load_library(library)
case = torch.load(case)
torch.testing.assert_close(torch._inductor.aoti_load_package(package)(case["image"]), case["expected"])
assert not any(name.startswith("kvision") for name in sys.modules)
"""
    served = {"cpu", device.type} - _backend.unserved.keys()
    libraries = [_backend.LIBRARY_FOLDER / _backend.LIBRARIES[d] for d in served]
    subprocess.run([sys.executable, "-c", script, package, tmp_path / "case.pt", *sorted(libraries)], check=True)


@pytest.mark.slow
@pytest.mark.skipif("cpu" in _backend.unserved, reason="the program links libkvision.so")
def test_pipeline_runs_in_cpp(cmake: str, device: torch.device, tmp_path: Path) -> None:
    """examples/cpp/run_pipeline gives Python's numbers from a package and from a traced module."""
    pytest.importorskip("skimage.data")
    prefixes = f"{_backend.LIBRARY_FOLDER.parent};{torch.utils.cmake_prefix_path}"
    build, saved = tmp_path / "build", tmp_path / "saved"
    options = f"-DCMAKE_PREFIX_PATH={prefixes}", "-DCMAKE_BUILD_TYPE=None"  # compiled in half the time
    subprocess.run([cmake, "-S", ROOT / "examples/cpp", "-B", build, *options], check=True)
    subprocess.run([cmake, "--build", build, "--target", "run_pipeline"], check=True)
    script = ROOT / "examples/cpp/save_pipeline.py"
    subprocess.run([sys.executable, script, "--device", device.type, "--out", saved], check=True)

    def printed() -> str:
        return subprocess.run([build / "run_pipeline", saved], check=True, stdout=subprocess.PIPE, text=True).stdout

    everything = printed()
    assert f"image [2, 3, 512, 512] on {device.type}" in everything
    for name in ("traced module: ", "AOTInductor package: ", "AOTInductor package, batch of 1: "):
        assert f"{name}largest difference from Python" in everything
    (saved / "pipeline.pt2").unlink()
    without_package = printed()
    assert "traced module: largest difference from Python" in without_package
    assert "AOTInductor package: there is no" in without_package
