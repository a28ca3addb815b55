"""The operator path itself: which backend serves, and what happens when a library is missing."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch

import kvision as K
from kvision import _ops


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, timeout=120
    )


def test_backend_is_restored_after_an_error(backend):
    before = _ops._backend
    with pytest.raises(ZeroDivisionError), K.backend("reference"):
        assert _ops._backend == "reference"
        raise ZeroDivisionError
    assert _ops._backend == before


def test_unknown_backend():
    with pytest.raises(ValueError, match="backend: expected one of auto, native, reference; got 'fast'"):
        with K.backend("fast"):
            pass


def test_native_says_what_is_missing(backend):
    if backend == "reference":
        pytest.skip("this test is about the kernels")
    x = torch.zeros(1, 1, 4, 4, device="meta")
    with (
        K.backend("native"),
        pytest.raises(RuntimeError, match="^sobel: backend 'native' was asked for, but .* on meta"),
    ):
        K.filters.sobel(x)


def test_serves(device, backend):
    x = torch.zeros(1, 1, 4, 4, device=device)
    assert _ops.serves("sobel", x) == ("reference" if backend == "reference" else "native")
    assert _ops.serves("sobel", x.to("meta")) == "reference"


def test_environment_chooses_the_backend():
    code = "import torch, kvision as K; print(K._ops.serves('sobel', torch.zeros(1, 1, 2, 2)))"
    assert run(code, KVISION_BACKEND="reference").stdout.strip() == "reference"
    assert "expected one of" in run(code, KVISION_BACKEND="quick").stderr


def test_without_libraries_the_reference_serves():
    """A broken or missing library is a reason in kvision.info(), not an ImportError."""
    code = (
        "import torch\n"
        "def fail(path): raise OSError('broken')\n"
        "torch.ops.load_library = fail\n"
        "import kvision as K\n"
        "print(K._ops.unserved['cpu']); print(K.filters.sobel(torch.zeros(1, 1, 1, 1)).item() > 0)"
    )
    result = run(code, KVISION_BACKEND="auto")
    assert result.returncode == 0, result.stderr
    assert "does not load: broken" in result.stdout and "True" in result.stdout


def test_an_older_library_lacks_an_operator():
    """The reference serves it, kvision.info() says why, and only backend "native" makes it an error."""
    code = (
        "import torch, kvision as K\n"
        "twice, x = K._ops.register('twice', lambda x: 2 * x), torch.ones(1, 1, 2, 2)\n"
        "print(twice(x).sum().item(), K._ops.serves('twice', x))\n"
        "K.info()\n"
        "with K.backend('native'): twice(x)"
    )
    result = run(code, KVISION_BACKEND="auto")
    if "cpu" not in _ops.unserved:
        assert "twice is not in libkvision.so, which is older: build kvision again" in result.stdout
    assert result.stdout.splitlines()[0] == "8.0 reference"
    assert "twice: backend 'native' was asked for, but" in result.stderr


def test_cuda_library_is_not_loaded_without_cuda():
    if torch.backends.cuda.is_built():
        pytest.skip("this torch has CUDA")
    assert _ops.unserved["cuda"] == "this torch was built without CUDA"


def test_every_operator_has_a_readable_schema(backend):
    for name, operator in _ops.operators.items():
        if operator.kernel is not None:
            schema = operator.kernel._schema
            assert all(not a.name.startswith("_") and a.name for a in schema.arguments), name


def test_functional_transforms_compose(device):
    """jacrev over vmap over grad: three levels through one operator."""

    def loss(x):
        return K.filters.sobel(x).sum()

    x = torch.rand(3, 1, 1, 4, 4, dtype=torch.float64, device=device)
    jacobian = torch.func.vmap(torch.func.jacrev(torch.func.grad(loss)))(x)
    assert jacobian.shape == (3, 1, 1, 4, 4, 1, 1, 4, 4)


def test_a_constant_result_carries_no_gradient(device):
    x = torch.rand(1, 1, 6, 6, device=device, requires_grad=True)
    magnitude, edges = K.filters.canny(x)
    assert magnitude.requires_grad and not edges.requires_grad
    (_, edges), (_, tangent) = torch.func.jvp(K.filters.canny, (x.detach(),), (torch.ones_like(x),))
    assert torch.equal(tangent, torch.zeros_like(edges))


def test_fake_tensors_and_make_fx(device):
    from torch._subclasses.fake_tensor import FakeTensorMode
    from torch.fx.experimental.proxy_tensor import make_fx

    with FakeTensorMode():
        assert K.filters.sobel(torch.empty(2, 3, 5, 7)).shape == (2, 3, 5, 7)
    graph = make_fx(lambda x: K.filters.sobel(x))(torch.rand(1, 1, 4, 4, device=device))
    assert torch.allclose(graph(torch.ones(1, 1, 4, 4, device=device)), torch.full((1, 1, 4, 4), 1e-3, device=device))


def test_module_can_be_pickled(tmp_path):
    module = K.filters.Sobel()
    torch.save(module, tmp_path / "sobel.pt")
    loaded = torch.load(tmp_path / "sobel.pt", weights_only=False)
    x = torch.rand(1, 1, 4, 4)
    assert torch.equal(loaded(x), module(x))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_of_large_results_is_used_again(backend):
    if backend == "reference":
        pytest.skip("the memory of the reference is torch's")
    code = """
import torch, kvision as K
def megabytes():
    return int(open("/proc/self/statm").read().split()[1]) * 4 / 1024
x = torch.rand(16, 3, 256, 256)
for _ in range(4):
    K.filters.gaussian_blur2d(x, 5, (1.0, 1.0))
before = megabytes()
for _ in range(30):
    y = K.filters.gaussian_blur2d(x, 5, (1.0, 1.0))
print(megabytes() - before, y.data_ptr() % 64)
"""
    for _ in range(3):  # whether memory is lost depends on where things happen to lie
        grown, misaligned = run(code).stdout.split()
        assert float(grown) < 30 and int(misaligned) == 0  # a result is 12 MB


def test_graphs_that_torch_keeps_on_disk_are_of_this_version():
    assert f"kvision {K.__version__}" in torch.compiler.config.cache_key_tag
