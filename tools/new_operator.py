"""Write the six files of a smallest complete operator: factor * input^2, pixel by pixel, with kernels and gradients.

    python tools/new_operator.py filters/smoothing/glow

Afterwards the formula in csrc is the first thing to change, then the reference in Python, which defines it. What is left to do
by hand is printed; CONTRIBUTING.md explains each file.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

HEADER = """\
// NAME: factor x^2, pixel by pixel.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::MODULE {

template <class T>
struct CLASS {
  Planes<T const> x;
  Planes<T> y;
  Compute<T> factor;
};

template <class T>
struct CLASSBackward {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  Compute<T> factor;
};

KV_KERNEL(NAME, CLASS)
KV_KERNEL(NAME_backward, CLASSBackward)

// V is a number or a vector of numbers, F a number.
template <class V, class F>
KV_HD V NAME_pixel(V x, F factor) {
  return x * x * factor;
}
template <class V, class F>
KV_HD V NAME_pixel_vjp(V x, V grad, F factor) {
  return grad * x * (factor * 2);
}

}  // namespace kv::MODULE
"""

CPU = """\
// NAME on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
#include "core/lanes.h"
#include "NAME.h"

namespace kv::MODULE::KV_ISA {

template <class T>
void NAME(CLASS<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const x = p.x.row(plane, y);
    T* const out = p.y.row(plane, y);
    for_each_vector<T>(0, p.x.row_size(), [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, NAME_pixel(load<N>(x + e), p.factor));
    });
  }
}

template <class T>
void NAME_backward(CLASSBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const *const x = p.x.row(plane, y), *const g = p.grad.row(plane, y);
    T* const out = p.grad_x.row(plane, y);
    for_each_vector<T>(0, p.x.row_size(), [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, NAME_pixel_vjp(load<N>(x + e), load<N>(g + e), p.factor));
    });
  }
}

KV_INSTANTIATE(NAME, CLASS)
KV_INSTANTIATE(NAME_backward, CLASSBackward)

}  // namespace kv::MODULE::KV_ISA
"""

CUDA = """\
// NAME on CUDA: one thread an element.
#include "core/launch.cuh"
#include "NAME.h"

namespace kv::MODULE::cuda {
namespace {

constexpr int kThreads = 256;

template <class T>
__global__ void __launch_bounds__(kThreads) run(CLASS<T> p) {
  int64_t const i = int64_t(blockIdx.x) * kThreads + threadIdx.x, size = p.x.row_size();
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height;
  p.y.row(plane, y)[e] = round_to<T>(NAME_pixel(read(p.x.row(plane, y)[e]), p.factor));
}

template <class T>
__global__ void __launch_bounds__(kThreads) run_backward(CLASSBackward<T> p) {
  int64_t const i = int64_t(blockIdx.x) * kThreads + threadIdx.x, size = p.x.row_size();
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height;
  Compute<T> const x = read(p.x.row(plane, y)[e]), g = read(p.grad.row(plane, y)[e]);
  p.grad_x.row(plane, y)[e] = round_to<T>(NAME_pixel_vjp(x, g, p.factor));
}

}  // namespace

template <class T>
int NAME(CLASS<T> const& p, CUstream_st* stream) {
  run<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int NAME_backward(CLASSBackward<T> const& p, CUstream_st* stream) {
  run_backward<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), kThreads)), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(NAME, CLASS)
KV_INSTANTIATE(NAME_backward, CLASSBackward)

}  // namespace kv::MODULE::cuda
"""

OPERATOR = """\
// NAME: schemas and entries, for CPU and CUDA.
#include "FOLDER/NAME.h"
#include "glue/glue.h"

namespace kv::MODULE {
namespace {

Tensor NAME(Tensor const& input, double factor) {
  check_images("NAME", "input", input);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout), y = empty_like(x, layout);
  dispatch_floating("NAME", x, [&](auto type) {
    using T = typename decltype(type)::type;
    CLASS<T> const params{planes<T const>(x, layout), planes<T>(y, layout), Compute<T>(factor)};
    KV_RUN(NAME, x, params, params.y.rows(), params.y.row_size());
  });
  return y;
}

Tensor NAME_backward(Tensor const& grad, Tensor const& input, double factor) {
  check_images("NAME_backward", "input", input);
  check_like("NAME_backward", "grad", grad, input);
  Layout const layout = layout_of(input);
  Tensor const g = as_layout(grad, layout), x = as_layout(input, layout), grad_x = empty_like(x, layout);
  dispatch_floating("NAME_backward", x, [&](auto type) {
    using T = typename decltype(type)::type;
    CLASSBackward<T> const params{planes<T const>(g, layout), planes<T const>(x, layout), planes<T>(grad_x, layout),
                                  Compute<T>(factor)};
    KV_RUN(NAME_backward, x, params, params.x.rows(), params.x.row_size());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(NAME, "(Tensor input, float factor) -> Tensor")
KV_OPERATOR(NAME_backward, "(Tensor grad, Tensor input, float factor) -> Tensor")

}  // namespace kv::MODULE
"""

REFERENCE = '''\
"""NAME."""

from __future__ import annotations

from torch import Tensor

from kvision import _check
from kvision._ops import register, vjp


def _reference(x: Tensor, factor: float) -> Tensor:
    return x * x * factor


_NAME = register("NAME", _reference, gradients="input: NAME_backward")
register("NAME_backward", vjp(_reference), layout_of=1)


def NAME(input: Tensor, factor: float = 1.0) -> Tensor:
    """Square the pixels of an image and multiply them by a number.

    Args:
        input: images of shape (B, C, H, W). Integers are computed in float32.
        factor: what the squares are multiplied by.

    Returns:
        Images of shape (B, C, H, W).

    Raises:
        TypeError: `input` is not a tensor of real numbers, `factor` not a number.
        ValueError: `input` is not of shape (B, C, H, W).

    Example:
        >>> import torch
        >>> from kvision.PACKAGE.NAME import NAME
        >>> NAME(torch.full((1, 1, 1, 2), 3.0), 0.5)
        tensor([[[[4.5000, 4.5000]]]])
    """
    _check.images("NAME", "input", input)
    factor = _check.number("NAME", "factor", factor)
    if not input.is_floating_point():
        input = input.float()
    return _NAME(input, factor)
'''

TEST = """\
from kvision.PACKAGE.NAME import NAME
from op_tests import OpTests


class TestCLASS(OpTests):
    function = staticmethod(NAME)
    operators = ("NAME", "NAME_backward")
    variants = [{}, {"factor": -0.5}]
"""

LEFT = """\
Next:
    ninja -C build/cmake && python tools/generate.py
    make test TESTS=tests/FOLDER/test_NAME.py
By hand, when it is to be public:
    python/kvision/MODULE/__init__.py            its export
    benchmarks/sample_calls                      its sample call
    CHANGELOG.md                                 what a user can see
Then tests/test_public_api.py and tests/test_docs.py say how to renew the list of names and docs/reference."""


def files(folder: str, name: str) -> dict[str, str]:
    """Path -> text of the files of operator `name` in a folder such as filters/smoothing."""
    words = {
        "CLASS": "".join(part.capitalize() for part in name.split("_")),
        "MODULE": folder.split("/")[0],
        "PACKAGE": folder.replace("/", "."),
        "FOLDER": folder,
        "NAME": name,
    }
    texts = {
        f"csrc/{folder}/{name}.h": HEADER,
        f"csrc/{folder}/{name}_cpu.cpp": CPU,
        f"csrc/{folder}/{name}.cu": CUDA,
        f"csrc/{folder}/{name}_op.cpp": OPERATOR,
        f"python/kvision/{folder}/{name}.py": REFERENCE,
        f"tests/{folder}/test_{name}.py": TEST,
        "": LEFT,
    }
    for word, value in words.items():
        texts = {path: text.replace(word, value) for path, text in texts.items()}
    return texts


def main(path: str, root: Path = ROOT) -> None:
    folder, _, name = path.rpartition("/")
    if not folder or not name.isidentifier() or name != name.lower():
        raise SystemExit(f"expected a folder and a name in lower case, as in filters/smoothing/glow, got {path!r}")
    texts = files(folder, name)
    left = texts.pop("")
    if existing := [file for file in texts if (root / file).exists()]:
        raise SystemExit(f"there is {existing[0]}")
    for file, text in texts.items():
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).write_text(text)
        print(file)
    formatter = Path(sys.executable).with_name("clang-format")  # lines break where names end
    if formatter.exists():
        subprocess.run([formatter, "-i", *(root / file for file in texts if file.startswith("csrc"))], check=True)
    print(left)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(sys.argv[1])
