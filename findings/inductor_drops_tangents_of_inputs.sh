#!/usr/bin/env bash
# torch 2.13.0 (CPU): torch.compile with its default backend drops the tangents of dual tensors that are passed in, in silence.
# Believed: torch.compile(f)(x) is f(x), for forward-mode differentiation too, or refuses. Seen: inside torch.autograd.forward_ad.dual_level,
# the tangent of the result is None with the backend "inductor", and right with "eager" and "aot_eager". There is no warning, and the
# primal is right, so that a Jacobian assembled from such calls is one of zeros.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy
TORCHINDUCTOR_CACHE_DIR="$folder/cache" "$folder/venv/bin/python" - <<'PROGRAM'
import torch
from torch.autograd import forward_ad


def f(x):
    return x.sin() * 2


x, t = torch.tensor([0.5, 1.0]), torch.ones(2)
seen = {}
for backend in ("eager", "aot_eager", "inductor"):
    torch._dynamo.reset()
    with forward_ad.dual_level():
        y = torch.compile(f, backend=backend, fullgraph=True)(forward_ad.make_dual(x, t))
        seen[backend] = forward_ad.unpack_dual(y).tangent
    print(torch.__version__, backend, seen[backend])
assert torch.allclose(seen["eager"], 2 * x.cos()) and torch.allclose(seen["aot_eager"], 2 * x.cos()) and seen["inductor"] is None
PROGRAM
