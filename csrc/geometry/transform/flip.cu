// Flips and crops on CUDA. Each thread copies 16 bytes of a few rows, or single elements where rows are not aligned.
#include "core/launch.cuh"
#include "geometry/transform/flip.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256, kRows = 4;  // rows in flight per thread

// Blocks of rows of a plane are `across` vectors wide; there are `down` in a plane.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    flip_rows(__grid_constant__ Flip<T> const p, unsigned across, unsigned down) {
  unsigned const i = blockIdx.x * kThreads + threadIdx.x, block = i / across, plane = block / down;
  if (plane >= p.y.count()) return;
  int const e = int(i - block * across) * P, y = int(block - plane * down) * kRows;
  int const size = int(p.x.row_size()), height = int(p.x.height);
  int const from = p.columns ? size - P - e : e + int(p.left);
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

// Element by element, for rows that are not aligned: a warp copies 32 x `groups` columns of some rows, each thread
// every 32nd column. Where columns keep their order or are reversed, addresses of a row's elements differ by constants.
constexpr int kWarps = kThreads / 32;
enum class Columns { kept, reversed, of_pixels_reversed };

template <class T, Columns columns, int N>
__global__ void __launch_bounds__(kThreads) flip_elements(__grid_constant__ Flip<T> const p) {
  int const e = int(blockIdx.x) * 32 * N + int(threadIdx.x % 32);
  int const first_y = int(blockIdx.y * kWarps + threadIdx.x / 32) * kRows;
  int const size = int(p.x.row_size()), step = int(p.x.step), height = int(p.x.height);
  int const result_size = int(p.y.row_size()), left = columns == Columns::kept ? int(p.left) * step : 0;
  int const begin = max(-left, 0), end = min(result_size, size - left);  // columns that are not out of bounds
  auto const source = [&](int k) {                                       // of column e + 32 k
    if constexpr (columns == Columns::of_pixels_reversed)
      return size - step - (e + 32 * k) + 2 * ((e + 32 * k) % step);
    else
      return columns == Columns::kept ? e + left + 32 * k : size - 1 - e - 32 * k;
  };
  for (int64_t plane = blockIdx.z; plane < p.y.count(); plane += gridDim.z) {
    T const* const in = p.x.plane(plane);
    T* const out = p.y.plane(plane) + e;
    for (int y = first_y; y < p.y.height; y += int(gridDim.y) * kWarps * kRows) {
      T elements[kRows][N] = {};
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        int const row = p.rows ? height - 1 - y - r : y + r + int(p.top);
        if (y + r >= p.y.height || unsigned(row) >= unsigned(height)) continue;
        T const* const in_row = in + row * p.x.row_stride;
#pragma unroll
        for (int k = 0; k < N; ++k)
          if (e + 32 * k >= begin && e + 32 * k < end) elements[r][k] = in_row[source(k)];
      }
      T* const out_row = out + y * p.y.row_stride;
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int k = 0; k < N; ++k)
          if (y + r < p.y.height && e + 32 * k < result_size) out_row[r * p.y.row_stride + 32 * k] = elements[r][k];
    }
  }
}

template <class T>
void launch_elements(Flip<T> const& p, CUstream_st* stream) {
  int64_t const groups = ceil_div(p.y.row_size(), 32);  // of columns
  auto const launch = [&](auto kernel, int n) {
    dim3 const blocks(unsigned(ceil_div(groups, n)),
                      unsigned(min(ceil_div(p.y.height, kWarps * kRows), int64_t(65535))),
                      unsigned(min(p.y.count(), int64_t(65535))));
    kernel<<<blocks, kThreads, 0, stream>>>(p);
  };
  auto const with_columns = [&](auto columns) {
    constexpr Columns kColumns = columns.value;
    // As few accesses out of bounds as possible, which take as long as others.
    auto const unused = [&](int64_t n) { return ceil_div(groups, n) * n - groups; };
    if (groups <= 2)
      launch(flip_elements<T, kColumns, 2>, 2);
    else if (unused(8) <= unused(6) && unused(8) <= unused(5))
      launch(flip_elements<T, kColumns, 8>, 8);
    else if (unused(6) <= unused(5))
      launch(flip_elements<T, kColumns, 6>, 6);
    else
      launch(flip_elements<T, kColumns, 5>, 5);
  };
  if (!p.columns)
    with_columns(std::integral_constant<Columns, Columns::kept>{});
  else if (p.x.step == 1)
    with_columns(std::integral_constant<Columns, Columns::reversed>{});
  else
    launch(flip_elements<T, Columns::of_pixels_reversed, 8>, 8);
}

}  // namespace

template <class T>
int flip(Flip<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / int(sizeof(T));
  if (is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y) && p.left % P == 0) {
    int64_t const across = p.y.row_size() / P, down = ceil_div(p.y.height, kRows);
    flip_rows<T, P><<<unsigned(ceil_div(across * down * p.y.count(), kThreads)), kThreads, 0, stream>>>(
        p, unsigned(across), unsigned(down));
  } else {
    launch_elements(p, stream);
  }
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::geometry::cuda
