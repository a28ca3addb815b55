// Flips on CUDA: each thread moves 16 bytes of a few rows, or one element of them where rows are not aligned.
#include "core/launch.cuh"
#include "flip.h"

namespace kv::cuda {
namespace {

constexpr int kRows = 4;  // in flight at a time

template <class T, int P>
__global__ void __launch_bounds__(256) flip_rows(Flip<T> p, unsigned across, unsigned rows) {
  unsigned const i = blockIdx.x * 256 + threadIdx.x, group = i / across;
  int const e = int(i - group * across) * P, size = int(p.x.row_size()), step = int(p.x.step);
  unsigned const height = unsigned(p.x.height), first = group * kRows;
  int const mirrored = P > 1 ? size - P - e : size - step - e + 2 * (e % step), from = p.columns ? mirrored : e;
  Pack<T, P> packs[kRows];
#pragma unroll
  for (int k = 0; k < kRows; ++k) {
    if (first + k >= rows) break;
    unsigned const plane = (first + k) / height, y = first + k - plane * height;
    packs[k] = *reinterpret_cast<Pack<T, P> const*>(p.x.row(plane, p.rows ? height - 1 - y : y) + from);
  }
#pragma unroll
  for (int k = 0; k < kRows; ++k) {
    if (first + k >= rows) break;
    unsigned const plane = (first + k) / height, y = first + k - plane * height;
    Pack<T, P> reversed = packs[k];
    if (p.columns)
#pragma unroll
      for (int l = 0; l < P; ++l) reversed.v[l] = packs[k].v[P - 1 - l];
    *reinterpret_cast<Pack<T, P>*>(p.y.row(plane, y) + e) = reversed;
  }
}

}  // namespace

template <class T>
int flip(Flip<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / int(sizeof(T));
  auto const launch = [&](auto width) {
    constexpr int N = decltype(width)::value;
    int64_t const across = p.x.row_size() / N, groups = ceil_div(p.x.rows(), kRows);
    flip_rows<T, N>
        <<<unsigned(ceil_div(across * groups, 256)), 256, 0, stream>>>(p, unsigned(across), unsigned(p.x.rows()));
  };
  if (is_strip<P>(p.x) && is_strip<P>(p.y))
    launch(std::integral_constant<int, P>{});
  else
    launch(std::integral_constant<int, 1>{});
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::cuda
