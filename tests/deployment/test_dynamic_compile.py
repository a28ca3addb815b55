"""Every public function that exports also compiles with dynamic batch, channels, height and width."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from dynamic_calls import CALLS, Call, examples
from op_tests import assert_close


@pytest.mark.tracing
@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_compile(name: str, device: torch.device) -> None:
    """One graph serves both sizes."""
    first, second, expected = examples(name, device)
    torch._dynamo.reset()
    graphs = []

    def backend(graph: torch.fx.GraphModule, _: Any) -> Any:
        graphs.append(graph)
        return graph.forward

    compiled = torch.compile(Call(CALLS[name]), dynamic=True, fullgraph=True, backend=backend)
    compiled(first)
    assert_close(compiled(second), expected, 1e-4, 1e-5)
    assert len(graphs) <= 1
