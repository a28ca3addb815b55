"""The dispatch of operators: choice of the backend, and behavior when a library is missing."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess
import sys
import threading

import pytest
import torch

import kvision as K
from fresh import run
from kvision import _backend, _ops
from kvision._modes import INTERPOLATION, PADDING

pytestmark = pytest.mark.interface


def test_backend_is_restored_after_an_error(backend):
    before = _backend.current_backend()
    with pytest.raises(ZeroDivisionError), K.backend("reference"):
        assert _backend.current_backend() == "reference"
        raise ZeroDivisionError
    assert _backend.current_backend() == before


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


def test_serves_names_the_backend(device, backend):
    x = torch.zeros(1, 1, 4, 4, device=device)
    assert _ops.serves("sobel", x) == ("reference" if backend == "reference" else "native")
    assert _ops.serves("sobel", x.to("meta")) == "reference"


@pytest.mark.slow
def test_environment_chooses_the_backend():
    code = "import torch, kvision as K; print(K._ops.serves('sobel', torch.zeros(1, 1, 2, 2)))"
    assert run(code, KVISION_BACKEND="reference").stdout.strip() == "reference"
    assert "expected one of" in run(code, KVISION_BACKEND="quick").stderr


def test_misspelt_variables_warn():
    environment = {"KVISION_BACKNED": "reference", "kvision_isa": "avx2", "KVISION_HOME": "/"}
    result = run("import kvision; import kvision.filters", KVISION_ISA="avx3", **environment)
    warned = re.findall("UserWarning: (.*)", result.stderr)
    expected = [
        "kvision: KVISION_BACKNED in the environment has no effect; did you mean KVISION_BACKEND?",
        "kvision: kvision_isa in the environment has no effect; did you mean KVISION_ISA?",
    ]
    if "cpu" not in _backend.unserved:
        expected.append("kvision: KVISION_ISA=avx3 is not supported here; ")
    assert len(warned) == len(expected) and all(any(w.startswith(e) for w in warned) for e in expected), warned


@pytest.mark.slow
def test_a_second_copy_is_an_import_error(tmp_path):
    """Two libraries that declare the same operators would abort the process. The same one again is no second copy."""
    if "cpu" in _backend.unserved:
        pytest.skip("needs the library")
    library = _backend.LIBRARY_FOLDER / "libkvision.so"
    other = shutil.copy(library, tmp_path)
    program = "import torch; torch.ops.load_library({!r}); import kvision; print('imported')"
    assert run(program.format(str(library))).stdout == "imported\n"
    result = run(program.format(other))
    assert (
        result.returncode == 1 and f"ImportError: kvision: {library} cannot be loaded beside the copy" in result.stderr
    )
    assert f", {other}; import kvision from one place only" in result.stderr


def test_without_libraries_the_reference_serves():
    """A broken or missing library is a reason in kvision.info(), not an ImportError."""
    code = (
        "import torch\n"
        "def fail(path): raise OSError('broken')\n"
        "torch.ops.load_library = fail\n"
        "import kvision as K\n"
        "print(K._backend.unserved['cpu']); print(K.filters.sobel(torch.zeros(1, 1, 1, 1)).item() > 0)"
    )
    result = run(code, KVISION_BACKEND="auto")
    assert result.returncode == 0, result.stderr
    assert "does not load: broken" in result.stdout and "True" in result.stdout


@pytest.mark.slow
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
    if "cpu" not in _backend.unserved:
        assert "twice is not in libkvision.so, which is older: build kvision again" in result.stdout
    assert result.stdout.splitlines()[0] == "8.0 reference"
    assert "twice: backend 'native' was asked for, but" in result.stderr


def test_cuda_library_is_not_loaded_without_cuda():
    if torch.backends.cuda.is_built():
        pytest.skip("this torch has CUDA")
    assert _backend.unserved["cuda"] == "this torch was built without CUDA"


def test_every_operator_has_a_readable_schema(backend):
    for name, operator in _ops.operators.items():
        if operator.kernel is not None:
            schema = operator.kernel._schema
            assert all(not a.name.startswith("_") and a.name for a in schema.arguments), name


def test_no_operator_takes_strings(backend):
    """Torch's stable C interface leaks memory for each string argument of a call."""
    for name, operator in _ops.operators.items():
        if operator.kernel is not None:
            assert all("str" not in str(a.type) for a in operator.kernel._schema.arguments), name


def test_functional_transforms_compose(device):
    """jacrev over vmap over grad: three levels through one operator."""

    def loss(x):
        return K.filters.sobel(x).sum()

    x = torch.rand(3, 1, 1, 4, 4, dtype=torch.float64, device=device)
    jacobian = torch.func.vmap(torch.func.jacrev(torch.func.grad(loss)))(x)
    assert jacobian.shape == (3, 1, 1, 4, 4, 1, 1, 4, 4)


def test_jacobians_of_no_images(device):
    x = torch.rand(0, 1, 4, 4, device=device)
    for jacobian in (torch.func.jacrev, torch.func.jacfwd):
        assert jacobian(K.filters.sobel)(x).shape == (0, 1, 4, 4, 0, 1, 4, 4)


def test_vmap_of_one_row_for_a_batch(device):
    """The gradient of what all samples share has one row, however many samples there are, so each element is a call."""
    x, grad = torch.rand(2, 1, 5, 5, device=device), torch.rand(3, 2, 1, 5, 5, device=device)
    kernel = torch.rand(1, 3, 3, device=device)

    def gradient(g):
        return torch.func.vjp(lambda k: K.filters.filter2d(x, k), kernel)[1](g)[0]

    assert torch.allclose(torch.func.vmap(gradient)(grad), torch.stack([gradient(g) for g in grad]))


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


MEMORY_OF_RESULTS = """
import os, resource, torch, kvision as K
def megabytes():
    return int(open("/proc/self/statm").read().split()[1]) * 4 / 1024
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for call, *shape in (
    ("filters.gaussian_blur2d(x, 5, (1.0, 1.0))", 16, 3, 256, 256),
    ("filters.box_blur(x, 3)", 12, 3, 250, 318),
    ("filters.box_blur(x, 3)", 1, 3, 480, 640),
    ("geometry.hflip(x)", 1, 1, 200, 200),
):
    if not os.fork():
        x, call = torch.rand(shape), compile("K." + call, "call", "eval")
        for _ in range(5):
            y = eval(call)
        memory, count = megabytes(), faults()
        for _ in range(20):
            y = eval(call)
        print(faults() - count, y.numel() * y.element_size() // 4096, megabytes() - memory, y.data_ptr() % 64, flush=True)
        os._exit(0)
    os.wait()
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_of_results_is_used_again_and_does_not_fault_anew(backend):
    if backend == "reference":
        pytest.skip("the memory of the reference is torch's")
    for _ in range(3):  # whether memory leaks, and whether glibc gives it back, depends on addresses
        command = [sys.executable, "-c", MEMORY_OF_RESULTS]
        rows = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        assert len(rows) == 4
        for row in rows:
            count, pages, grown, misaligned = map(float, row.split())
            assert count < 2 * pages and grown < 30 and misaligned == 0, row  # of 20 results


def test_graphs_that_torch_keeps_on_disk_are_of_this_version():
    assert f"kvision {K.__version__}" in torch.compiler.config.cache_key_tag


# --- the backend of threads and tasks ---------------------------------------------------------------------------------


@pytest.fixture
def default_backend():
    before = _backend.default_backend
    _backend.set_default_backend("auto")
    yield "auto"
    _backend.set_default_backend(before)


def test_threads_choose_their_own_backend(default_backend):
    both_inside, results = threading.Barrier(2), {}

    def work(name):
        before = _backend.current_backend()
        with K.backend(name):
            both_inside.wait()
            results[name] = (
                before,
                _backend.current_backend(),
                _ops.serves("sobel", torch.zeros(1, 1, 2, 2, device="cpu")),
            )
            both_inside.wait()

    threads = [threading.Thread(target=work, args=(name,)) for name in ("reference", "auto")]
    with K.backend("native"):  # not theirs
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert _backend.current_backend() == "native"
    kernel = "reference" if "cpu" in _backend.unserved else "native"
    assert results == {"reference": ("auto", "reference", "reference"), "auto": ("auto", "auto", kernel)}
    assert not _backend.ask_backend and _backend._blocks == 0


def test_tasks_choose_their_own_backend(default_backend):
    async def work(name, other):
        with K.backend(name):
            await asyncio.sleep(0)
            with K.backend(other):
                await asyncio.sleep(0)
                inner = _backend.current_backend()
            await asyncio.sleep(0)
            return inner, _backend.current_backend()

    async def outside():
        await asyncio.sleep(0)
        return _backend.current_backend()

    async def main():
        return await asyncio.gather(work("reference", "native"), work("native", "auto"), outside())

    assert asyncio.run(main()) == [("native", "reference"), ("auto", "native"), "auto"]
    assert not _backend.ask_backend and _backend._blocks == 0 and _backend._thread_backend.name is None


def test_blocks_nest_and_survive_errors(default_backend):
    with K.backend("reference"):
        with pytest.raises(ZeroDivisionError), K.backend("native"):
            raise ZeroDivisionError
        assert _backend.current_backend() == "reference"
        with pytest.raises(ValueError, match="expected one of"), K.backend("fast"):
            pass
        assert _backend.current_backend() == "reference"
    assert _backend.current_backend() == "auto" and not _backend.ask_backend


def test_a_decorated_function_runs_in_its_backend(default_backend):
    assert K.backend("reference")(_backend.current_backend)() == "reference"
    assert _backend.current_backend() == "auto"


def test_gradients_are_served_as_their_call(default_backend, device):
    """A backward pass uses the backend of its forward call, on any thread and in any block."""
    if device.type in _backend.unserved:
        pytest.skip("this test is about the kernels")
    x = torch.rand(1, 1, 4, 4, device=device, requires_grad=True)
    backward, served = _ops.operators["sobel"], []
    original = backward.backward
    backward.backward = lambda *args: (served.append(_backend.current_backend()), original(*args))[1]
    try:
        with K.backend("native"):
            y = K.filters.sobel(x)
        y.sum().backward()
        with K.backend("reference"):
            K.filters.sobel(x)
        y = K.filters.sobel(x)
        with K.backend("native"):
            y.sum().backward()
    finally:
        backward.backward = original
    assert served == ["native", "auto"]


def test_compiled_functions_follow_the_backend(default_backend):
    if "cpu" in _backend.unserved:
        pytest.skip("this test is about the kernels")
    graphs = []

    def compiler(graph, inputs):
        graphs.append("kvision.sobel" in graph.code)
        return graph

    torch.compiler.reset()
    compiled = torch.compile(lambda x: K.filters.sobel(x), backend=compiler, fullgraph=True)
    inside = torch.compile(lambda x: _sobel_of_reference(x), backend=compiler, fullgraph=True)
    x = torch.rand(1, 1, 4, 4)
    compiled(x)
    with K.backend("reference"):
        compiled(x)
        thread = threading.Thread(target=compiled, args=(x,))
        thread.start()
        thread.join()
    compiled(x)
    assert graphs[:3] == [True, False, True]
    inside(x)
    assert not graphs[-1] and _backend.current_backend() == "auto"
    torch.compiler.reset()


def _sobel_of_reference(x):
    with K.backend("reference"):
        return K.filters.sobel(x)


def test_an_empty_variable_chooses_auto():
    code = "import kvision as K; print(K._backend.current_backend())"
    result = run(code, KVISION_BACKEND="")
    assert result.stdout.strip() == "auto", result.stderr


# --- calls that no kernel serves --------------------------------------------------------------------------------------


def labels(size):
    return torch.zeros(size, dtype=torch.int64)


UNSUPPORTED = {
    "focal": lambda: K.losses.focal_loss(torch.zeros(1, 225, 2, 2), labels((1, 2, 2)), reduction="mean"),
    "overlap": lambda: K.losses.dice_loss(torch.zeros(1, 225, 2, 2), labels((1, 2, 2))),
    "binary_focal": lambda: K.losses.binary_focal_loss_with_logits(
        torch.zeros(1, 2, 2, 2), torch.zeros(1, 2, 2, 2), weight=torch.ones(2), reduction="mean"
    ),
    "lovasz": lambda: K.losses.lovasz_softmax_loss(torch.zeros(0, 2, 2, 2), labels((0, 2, 2))),
    "hausdorff": lambda: K.losses.HausdorffERLoss(k=1001)(torch.zeros(1, 2, 2, 2), labels((1, 1, 2, 2))),
    "smoothness": lambda: K.losses.inverse_depth_smoothness_loss(torch.zeros(1, 2, 2, 2), torch.zeros(1, 3, 2, 2)),
    "ms_ssim": lambda: K.losses.MS_SSIMLoss(sigmas=(0.5,) * 17)(torch.zeros(1, 1, 4, 4), torch.zeros(1, 1, 4, 4)),
    "endpoint_error": lambda: K.metrics.aepe(torch.zeros(0, 2), torch.zeros(0, 2)),
    "split_chroma": lambda: K.color.rgb_to_yuv420(torch.zeros(1, 3, 0, 4)),
    "join_chroma": lambda: K.color.yuv420_to_rgb(torch.zeros(1, 1, 0, 4), torch.zeros(1, 2, 0, 2)),
    "apply_colormap": lambda: K.color.apply_colormap(torch.zeros(1, 1, 0, 4), K.color.ColorMap("jet")),
}


@pytest.mark.parametrize("name", UNSUPPORTED)
def test_native_says_why_no_kernel_serves_the_arguments(name, backend):
    if backend == "reference" or "cpu" in _backend.unserved:
        pytest.skip("this test is about the kernels")
    with K.backend("auto"):
        UNSUPPORTED[name]()
    with (
        K.backend("native"),
        pytest.raises(RuntimeError, match=f"^{name}: backend 'native' was asked for, but there is"),
    ):
        UNSUPPORTED[name]()


def test_native_says_why_programs_and_gradients_of_long_rows_are_not_served():
    program, gradient = (_ops.operators[n].supports for n in ("color_program", "filter2d_separable_weights_backward"))
    plan = [0, -1, 1, 0]
    assert program(torch.zeros(1, 3, 2, 2), None, plan, []) is None
    assert (
        program(torch.zeros(1, 3, 2, 2, dtype=torch.float64), None, plan, [])
        == "there is no kernel from torch.float64 to torch.uint8"
    )
    long, short, x = torch.zeros(1, 129), torch.zeros(1, 3), torch.zeros(1, 1, 2, 2)
    assert gradient(long, short, x, x) is None
    assert "129 taps" in gradient(long, short, x.to("meta"), x)
    assert gradient(short, short, x.to("meta"), x) is None


def test_every_condition_is_stated_in_info():
    from kvision import info

    text = info.report(operators=True)
    conditional = {n: o for n, o in _ops.operators.items() if o.supports or o.nondeterministic}
    assert len(conditional) >= 19
    for name, operator in conditional.items():
        assert operator.conditions()
        for condition in operator.conditions():
            assert condition.endswith(".") and f"  {name}: {condition}\n" in text


def test_info_names_flavors_of_opencv(monkeypatch):
    from kvision import _hints, info

    assert "overwrite" not in info.report()
    monkeypatch.setattr(_hints.metadata, "version", lambda name: "5.0")
    text = " ".join(info.report().split())
    assert "opencv-python 5.0 and opencv-python-headless 5.0 and" in text and "overwrite one another's files" in text


def test_info_fits_a_screen():
    """The report has at most 80 columns, except for a path, and 40 lines. The table of operators is optional."""
    from kvision import info

    text = info.report()
    lines = text.splitlines()
    assert len(lines) <= 40 and all(len(line) <= 80 for line in lines if "/" not in line)
    assert re.search(r"cpu   copies [\d.]+ GB/s", text) and float(re.search(r"copies ([\d.]+)", text)[1]) > 0
    assert "--operators" in text and "gaussian_blur2d" not in text
    if info._C is not None:
        assert f"{info._C.active_isa()} (in use)" in " ".join(text.split())
    assert "\n  gaussian_blur2d " in info.report(operators=True)


def test_info_says_why_an_installation_is_pure_python(monkeypatch, tmp_path):
    (tmp_path / "pure_python.txt").write_text("KVISION_BUILD=reference asked for it")
    missing = "libkvision.so was not built: reinstall kvision on a machine with a C++20 compiler"
    monkeypatch.setattr(_backend, "LIBRARY_FOLDER", tmp_path)
    monkeypatch.setattr(_backend, "unserved", {"cpu": missing, "cuda": "this torch was built without CUDA"})
    lines = K.info.report().splitlines()
    at = lines.index("Libraries")
    assert lines[at + 1 : at + 5] == [
        "  cpu   libkvision.so was not built: reinstall kvision on a machine with a C++20",
        "      compiler",
        "        installed as pure Python: KVISION_BUILD=reference asked for it",
        "  cuda  this torch was built without CUDA",
    ]


@pytest.fixture
def made_operator():
    def make(reference, **rules):
        """Register an operator that calls sobel's kernel."""
        sobel = _ops.operators["sobel"]
        operator = _ops.Operator("sobel_again", reference, **rules)
        operator.unserved, operator.kernel, operator._call_kernel = sobel.unserved, sobel.kernel, sobel._call_kernel
        operator._on_cpu, operator._on_cuda = sobel._on_cpu, sobel._on_cuda
        return operator

    return make


@pytest.mark.parametrize("rule", [True, lambda x, *_: x.shape[2] > 4], ids=["always", "predicate"])
def test_nondeterministic_kernels_give_way_to_the_reference(made_operator, rule, default_backend, device):
    if device.type in _backend.unserved:
        pytest.skip("this test is about the kernels")
    operator = made_operator(lambda x, *_: torch.full_like(x, 7), nondeterministic=rule)
    small, large = torch.zeros(1, 1, 2, 2, device=device), torch.zeros(1, 1, 6, 6, device=device)

    def takes_reference(x):
        return bool((operator(x, False, 0.0) == 7).all())

    assert not takes_reference(small) and not takes_reference(large)
    torch.use_deterministic_algorithms(True)
    try:
        assert takes_reference(large)
        assert takes_reference(small) == (rule is True)
        with K.backend("native"), pytest.raises(RuntimeError, match="sobel_again: .*is not deterministic"):
            operator(large, False, 0.0)
    finally:
        torch.use_deterministic_algorithms(False)


def test_gradients_that_kernels_sum_by_atomics_are_declared():
    """They are declared on CUDA only, and for warps only with padding modes whose gradient is not a gather."""
    names = {n for n, o in _ops.operators.items() if o.nondeterministic}
    assert names == {
        "composed_coords_backward",
        "depth_warp_image_backward",
        "conv_quad_interp3d_backward",
        "remap_antialiased_image_backward",
        "remap_image_backward",
        "sample_patches_backward",
        "scale_space_peaks_backward",
        "warp3d_volume_backward",
        "warp_and_color_backward",
        "warp_antialiased_image_backward",
        "warp_image_backward",
    }
    x, matrix = torch.zeros(1, 1, 2, 2), torch.zeros(1, 2, 3)
    for name in names - {"composed_coords_backward", "warp_and_color_backward"}:  # these have other arguments
        assert not _ops.operators[name].nondeterministic(
            x, matrix, None, [1, 2, 2], INTERPOLATION["bilinear"], PADDING["border"]
        )
