"""Wheels with and without a compiler, and the C++ API as a CMake project finds it in them."""

from __future__ import annotations

import importlib.util
import os
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from types import ModuleType

import pytest
import torch

import kvision

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow


def run(*command: object, **environment: str) -> str:
    """What the command prints."""
    words, pipe = [str(word) for word in command], subprocess.PIPE
    result = subprocess.run(
        words, cwd=ROOT, env={**os.environ, **environment}, stdout=pipe, stderr=subprocess.STDOUT, text=True
    )
    assert result.returncode == 0, result.stdout
    return result.stdout


def build_wheel(folder: Path, **environment: str) -> Path:
    pip = (sys.executable, "-m", "pip")
    print(run(*pip, "wheel", "-v", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT, **environment))
    return next(folder.glob("*.whl"))


def tool(name: str) -> ModuleType:
    """A program of tools as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"tools/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def unpack(wheel: Path, folder: Path) -> dict[str, str]:
    """What pip would install, and the environment that finds it first."""
    zipfile.ZipFile(wheel).extractall(folder)
    return {"PYTHONPATH": str(folder)}


@pytest.fixture(scope="module")
def wheel(cmake: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    # Two modules for one instruction set, not optimized: this is about what is in it. Linked as a release is, and with all modules,
    # where that can be done.
    folder = tmp_path_factory.mktemp("native")
    quick = "-DKVISION_CUDA=OFF -DKVISION_ISA=baseline -DCMAKE_BUILD_TYPE=None"
    if importlib.util.find_spec("ziglang"):
        flags, _ = tool("build_wheels").older_system("2.28", folder / "glibc")
        quick += " " + shlex.join(flags)
    else:
        quick += " '-DKVISION_MODULES=filters;geometry'"  # which examples/cpp calls
    pythons = os.pathsep.join(tool("build_wheels").other_pythons(None))
    return build_wheel(folder, KVISION_BUILD="native", CMAKE_ARGS=quick, KVISION_PYTHONS=pythons)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return unpack(wheel, tmp_path_factory.mktemp("installed"))


def test_wheel_serves_every_python(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "-py3-none-linux_" in wheel.name
    assert {"kvision/lib/libkvision.so", "kvision/lib/cmake/kvision/kvision-config.cmake", "kvision/py.typed"} <= names
    headers = (path.relative_to(ROOT) for path in (ROOT / "include/kvision").rglob("*.h"))
    assert {f"kvision/{header}" for header in headers} <= names
    assert not [name for name in names if name.startswith("tests/") or "csrc" in name]


def test_wheel_has_a_module_for_each_python(wheel: Path) -> None:
    """kvision._C of each Python whose headers are here, imported there."""
    pythons = [sys.executable, *tool("build_wheels").other_pythons(None)]
    modules = [name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("kvision/_C.")]
    assert len(modules) == len(pythons)
    for python in pythons:
        assert tool("test_wheel").import_module(wheel, python).split()[1] == wheel.name.split("-")[1]


def test_wheel_runs_on_glibc_2_28(wheel: Path, tmp_path: Path) -> None:
    """Its libraries need no later glibc, and nothing of the system's libstdc++; auditwheel finds the same."""
    pytest.importorskip("ziglang", reason="stubs of older versions of glibc")
    zipfile.ZipFile(wheel).extractall(tmp_path / "unpacked")
    libraries = sorted(tmp_path.glob("unpacked/kvision/**/*.so"))
    assert "libkvision.so" in [path.name for path in libraries] and len(libraries) > 1
    for library in libraries:
        needed = set(tool("older_glibc").needed_versions(library))
        assert {name for name, _ in needed} == {"GLIBC", "GCC"}
        assert max(version for name, version in needed if name == "GLIBC") <= (2, 28)
    pytest.importorskip("auditwheel")
    release = tool("build_wheels").tagged(wheel, tmp_path / "tagged", "manylinux_2_28_x86_64")
    assert release.name.endswith("-py3-none-manylinux_2_28_x86_64.whl")
    tool("build_wheels").check(release, tmp_path / "checked")


def test_reports_the_active_isa(installed: dict[str, str]) -> None:
    """The wheel was compiled for the baseline alone, so that is in use whatever the processor has."""
    program = (
        "from kvision import _C; print(_C.active_isa(), _C.isa_supported('avx2'), _C.set_isa('avx2'), _C.active_isa())"
    )
    for chosen in ("", "avx2", "avx512"):
        output = run(sys.executable, "-c", program, KVISION_ISA=chosen, **installed)
        assert output.split()[-4:] == ["baseline", "False", "False", "baseline"]


def test_errors_cross_the_library(installed: dict[str, str]) -> None:
    """An exception of kvision's C++, with its own libstdc++, is Python's RuntimeError with the whole sentence."""
    program = (
        "import torch, kvision\ntry: torch.ops.kvision.sobel(torch.zeros(3), True, 1e-6)\n"
        "except RuntimeError as error: print('caught', error)"
    )
    assert "caught sobel: " in run(sys.executable, "-c", program, KVISION_BACKEND="native", **installed)


def test_wheel_works(installed: dict[str, str]) -> None:
    program = "import torch, kvision as K, kvision._C; print(K.__file__, K.sobel(torch.zeros(1, 1, 2, 2)).max().item())"
    path, value = run(sys.executable, "-c", program, KVISION_BACKEND="native", **installed).split()[-2:]
    assert path.startswith(installed["PYTHONPATH"]) and abs(float(value) - 1e-3) < 1e-9


def test_without_the_module_of_this_python(installed: dict[str, str]) -> None:
    """_C serves one Python; where it cannot be imported, the operators still run."""
    for module in Path(installed["PYTHONPATH"], "kvision").glob("_C.*"):
        module.rename(module.with_suffix(".aside"))
    try:
        assert "kvision._C was not built for this Python" in run(sys.executable, "-m", "kvision.info", **installed)
        program = "import torch, kvision as K; K.sobel(torch.zeros(1, 1, 2, 2))"
        run(sys.executable, "-c", program, KVISION_BACKEND="native", **installed)
    finally:
        for module in Path(installed["PYTHONPATH"], "kvision").glob("_C.*"):
            module.rename(module.with_suffix(".so"))


def test_a_driver_older_than_the_cuda_library(cmake: str, installed: dict[str, str], tmp_path: Path) -> None:
    """The reference serves images on the GPU, says one line of warning; kvision.info() says what to do. All of CUDA is made up."""
    stand_ins = {
        tmp_path / "libcuda.so.1": "int cuDriverGetVersion(int* version) { *version = 12080; return 0; }",
        Path(installed["PYTHONPATH"], "kvision/lib/libkvision_cuda.so"): "int kvision_cuda_runtime() { return 13000; }",
    }
    for library, source in stand_ins.items():
        (tmp_path / "source.cpp").write_text(f'extern "C" {source}\n')
        run(os.environ.get("CXX", "c++"), "-shared", "-fPIC", "-o", library, tmp_path / "source.cpp")
    (tmp_path / "nvidia-smi").write_text("#!/bin/sh\n")
    (tmp_path / "nvidia-smi").chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "LD_LIBRARY_PATH": str(tmp_path), **installed}
    program = "import torch; torch.backends.cuda.is_built = lambda: True; import kvision; kvision.info()"
    try:
        output = run(sys.executable, "-c", program, KVISION_BACKEND="auto", **environment)
    finally:
        library.unlink()
    (warning,) = (line for line in output.splitlines() if "RuntimeWarning" in line)
    reason = "the driver runs CUDA 12 at most, libkvision_cuda.so was built with CUDA 13"
    assert f"kvision computes images on the GPU in plain torch, which is slower: {reason}." in warning
    report = " ".join(output.split())
    assert f"cuda {reason}" in report and "cuda kernels serve 0 of" in report and "update its driver" in report


def test_cpp_example(cmake: str, installed: dict[str, str], tmp_path: Path) -> None:
    """examples/cpp links the installed wheel, filters a photograph and checks its gradient."""
    cv2, data = pytest.importorskip("cv2"), pytest.importorskip("skimage.data")
    cv2.imwrite(str(tmp_path / "photo.ppm"), data.astronaut()[..., ::-1])
    prefixes = run(sys.executable, "-m", "kvision.info", "--cmake-prefix-path", **installed).splitlines()[-1]
    assert prefixes.startswith(installed["PYTHONPATH"])
    quick = "-DCMAKE_BUILD_TYPE=None"  # torch's headers take half the time to compile without optimization
    run(cmake, "-S", ROOT / "examples/cpp", "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={prefixes}", quick)
    # tests/deployment/test_production.py builds and runs the others.
    run(cmake, "--build", tmp_path, "--target", "edges")
    print(run(tmp_path / "edges", tmp_path / "photo.ppm", tmp_path / "edges.ppm"))
    edges = cv2.imread(str(tmp_path / "edges.ppm"))
    assert edges.shape == (512, 512, 3) and edges.max() == 255 and 0 < edges.mean() < 64


def test_cmake_finds_the_installation(cmake: str, wheel: Path, tmp_path: Path) -> None:
    """The folder the wheel was built in, installed by CMake as a C++ user would."""
    prefix = tmp_path / "prefix"
    run(cmake, "--install", ROOT / "build/wheel", "--prefix", prefix)
    prefixes = f"{prefix};{torch.utils.cmake_prefix_path}"
    output = run(cmake, "-S", ROOT / "examples/cpp", "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefixes}")
    assert "Configuring done" in output and not list(prefix.glob("_C*"))


def test_without_a_compiler_it_is_pure_python(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    wheel = build_wheel(tmp_path, CXX="/nonexistent", KVISION_BUILD="auto")
    assert "installed as pure Python" in capfd.readouterr().out
    assert wheel.name == f"kvision-{kvision.__version__}+python-py3-none-any.whl"
    environment = unpack(wheel, tmp_path)
    assert "installed as pure Python: there is no GCC or Clang" in run(
        sys.executable, "-m", "kvision.info", **environment
    )
    program = "import torch, kvision as K; K.sobel(torch.zeros(1, 1, 2, 2))"
    run(sys.executable, "-c", program, **environment)
    with pytest.raises(AssertionError, match="backend 'native' was asked for, but libkvision.so was not built"):
        run(sys.executable, "-c", program, KVISION_BACKEND="native", **environment)


def test_native_can_be_demanded(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="KVISION_BUILD=native, but there is no GCC or Clang"):
        build_wheel(tmp_path, CXX="/nonexistent", KVISION_BUILD="native")


def test_other_compilers_are_refused(cmake: str, tmp_path: Path) -> None:
    """By name: this one says that it is Intel's."""
    compiler = tmp_path / "icpx"
    compiler.write_text('#!/bin/sh\nexec g++ -D__INTEL_LLVM_COMPILER=20250000 "$@"\n')
    compiler.chmod(0o755)
    with pytest.raises(AssertionError, match="kernels take GCC or Clang, but the compiler is IntelLLVM"):
        run(
            cmake,
            "-S",
            ROOT,
            "-B",
            tmp_path / "build",
            f"-DTORCH_ROOT={Path(torch.__file__).parent}",
            CXX=str(compiler),
        )


def test_cuda_is_left_out_where_no_gpu_is_visible(cmake: str, tmp_path: Path) -> None:
    """Compiling it takes as long as all else; who wants it all the same asks for it."""
    if any(Path(name).exists() for name in ("/dev/nvidia0", "/proc/driver/nvidia")):
        pytest.skip("a GPU is visible")
    torch_root = Path(torch.__file__).parent
    configure = (
        cmake,
        "-S",
        ROOT,
        "-B",
        tmp_path,
        f"-DTORCH_ROOT={torch_root}",
        f"-DPython_EXECUTABLE={sys.executable}",
    )
    output = run(*configure, CUDACXX="/nonexistent/nvcc", KVISION_CUDA="AUTO")
    sentence = "the CUDA kernels are left out, since no GPU is visible; KVISION_CUDA=ON in the environment builds them"
    assert f"-- kvision: {sentence}" in output
    assert (tmp_path / "cuda_left_out.txt").read_text() == sentence
    output = run(*configure, "-DKVISION_CUDA=OFF")
    assert sentence not in output and not (tmp_path / "cuda_left_out.txt").exists()


def test_a_wrong_choice_of_cuda_is_an_error() -> None:
    with pytest.raises(AssertionError, match="KVISION_CUDA must be one of AUTO, ON, OFF; got 'maybe'"):
        run(sys.executable, "setup.py", "--version", KVISION_CUDA="maybe")
