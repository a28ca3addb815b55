"""Only kvision/_torch_compat.py reaches parts of torch without a public name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch.autograd import forward_ad

import kvision
from kvision import _torch_compat

pytestmark = pytest.mark.interface

PACKAGE = Path(kvision.__file__).parent


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


# Private attributes of torch's objects, matched under any variable name.
PRIVATE = {
    name
    for owner in (
        torch,
        torch.Tensor,
        torch.nn.Module(),
        torch.ops.aten.add.default,
        torch.ops.aten.add,
        torch.autograd.Function,
        torch.autograd.function.FunctionCtx,
        forward_ad,
        torch.func,
        torch.library,
    )
    for name in dir(owner)
    if is_private(name)
}


def private_uses(source: str) -> Iterator[str]:
    """The uses of private parts of torch in `source`, one line each."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            modules = []
            if isinstance(node, ast.Attribute) and node.attr in PRIVATE:
                if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")):
                    yield f"{node.lineno}: {ast.unparse(node)}"
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "getattr":
                name = node.args[1]
                if isinstance(name, ast.Constant) and name.value in PRIVATE:
                    yield f"{node.lineno}: {ast.unparse(node)}"
        for module in modules:
            if module.split(".")[0] == "torch" and any(map(is_private, module.split("."))):
                yield f"{node.lineno}: {ast.unparse(node)}"


FILES = [p for p in sorted(PACKAGE.rglob("*.py")) if p.name != "_torch_compat.py"]


def test_no_other_file_reaches_private_parts_of_torch():
    uses = {str(path.relative_to(PACKAGE)): list(private_uses(path.read_text())) for path in FILES}
    assert not {path: found for path, found in uses.items() if found}


@pytest.mark.parametrize(
    "source",
    [
        "import torch._C",
        "from torch._functorch.utils import f",
        "from torch.utils._python_dispatch import TorchDispatchMode",
        "from torch import _C",
        "torch._C._dispatch_has_kernel_for_dispatch_key('', '')",
        "forward_ad._current_level",
        "kernel._schema.arguments",
        "getattr(kernel, '_op', None)",
        "x._base",
        "super()._load_from_state_dict()",
    ],
)
def test_private_parts_are_recognized(source):
    assert list(private_uses(source))


def test_public_parts_are_not():
    assert not list(
        private_uses("import torch\nself._modules\nfrom kvision import _ops\n_ops._checked_backend\nx.shape")
    )


def test_every_name_is_used_and_says_what_it_waits_for():
    source = (PACKAGE / "_torch_compat.py").read_text()
    users = "".join(p.read_text() for p in FILES)
    for name in _torch_compat.__all__:
        assert hasattr(_torch_compat, name) and name in users
    assert source.lower().count("waits for") >= len(_torch_compat.__all__)


def test_forward_ad_and_transforms_are_seen():
    assert not _torch_compat.in_forward_ad() and not _torch_compat.in_function_transform()
    with forward_ad.dual_level():
        assert _torch_compat.in_forward_ad()
    seen = []
    torch.func.vmap(lambda x: (seen.append(_torch_compat.in_function_transform()), x)[1])(torch.ones(2))
    assert seen == [True] and not _torch_compat.in_function_transform()


def test_autocast_of_any_device_is_seen():
    assert not _torch_compat.is_any_autocast_enabled()
    with torch.autocast("cpu"):
        assert _torch_compat.is_any_autocast_enabled()
        with torch.autocast("cpu", enabled=False):
            assert not _torch_compat.is_any_autocast_enabled()
