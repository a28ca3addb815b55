// Flips and crops on CUDA. Each thread copies 16 bytes of a few rows, or single elements where rows are not aligned.
#include "core/launch.cuh"
#include "geometry/transform/flip.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kRows = 4;  // in flight per thread

// Blocks of rows of a plane are `across` vectors wide; there are `down` in a plane.
template <class T, int P>
__global__ void __launch_bounds__(256) flip_rows(__grid_constant__ Flip<T> const p, unsigned across, unsigned down) {
  unsigned const i = blockIdx.x * 256 + threadIdx.x, block = i / across, plane = block / down;
  if (plane >= p.y.count()) return;
  int const e = int(i - block * across) * P, y = int(block - plane * down) * kRows;
  int const size = int(p.x.row_size()), step = int(p.x.step), height = int(p.x.height);
  int const mirrored = P > 1 ? size - P - e : size - step - e + 2 * (e % step);
  int const from = p.columns ? mirrored : e + int(p.left) * step;
  int const first = p.rows ? height - 1 - y : y + int(p.top), down_one = p.rows ? -1 : 1;
  int const rows = unsigned(from) < unsigned(size) ? min(kRows, int(p.y.height) - y) : 0;
  T const* const in = p.x.row(plane, first) + from;
  int64_t const stride = p.x.row_stride * down_one;
  Vector<T, P> vectors[kRows] = {};
#pragma unroll
  for (int k = 0; k < kRows; ++k)
    if (k < rows && unsigned(first + k * down_one) < unsigned(height))
      vectors[k] = *reinterpret_cast<Vector<T, P> const*>(in + k * stride);
  T* const out = p.y.row(plane, y) + e;
#pragma unroll
  for (int k = 0; k < kRows; ++k) {
    if (y + k >= p.y.height) break;
    Vector<T, P> vector = vectors[k];
    if (p.columns)
#pragma unroll
      for (int l = 0; l < P; ++l) vector.v[l] = vectors[k].v[P - 1 - l];
    T* const to = out + k * p.y.row_stride;
    if constexpr (sizeof(vector) == 16)  // a streaming store, as store_vector
      __stcs(reinterpret_cast<uint4*>(to), *reinterpret_cast<uint4 const*>(&vector));
    else
      *reinterpret_cast<Vector<T, P>*>(to) = vector;
  }
}

}  // namespace

template <class T>
int flip(Flip<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / int(sizeof(T));
  auto const launch = [&](auto width) {
    constexpr int N = decltype(width)::value;
    int64_t const across = p.y.row_size() / N, down = ceil_div(p.y.height, kRows);
    flip_rows<T, N>
        <<<unsigned(ceil_div(across * down * p.y.count(), 256)), 256, 0, stream>>>(p, unsigned(across), unsigned(down));
  };
  if (is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y) && p.left % P == 0)
    launch(std::integral_constant<int, P>{});
  else
    launch(std::integral_constant<int, 1>{});
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::geometry::cuda
