// Rows of pixels in shared memory, for the responses of corners and blobs on CUDA.
//
// A block traverses its columns downwards, four rows at a time. In steps along y each thread has one column, with the
// rows that its window needs in registers. In steps along x it has four columns of one of the four rows, so that it
// loads vectors and shares them between its windows. Between the steps rows are in shared memory, with the pixels out
// of bounds that windows read. Only loads and stores depend on the dtype and the layout of the pixels, which are
// therefore run-time arguments. Included by responses*.cu.
#pragma once

#include "core/dtype.cuh"
#include "responses.h"

namespace kv::feature::cuda {
namespace {

constexpr int kRows = 4;  // processed together; also the columns of a thread along x
constexpr int kPad = 4;   // elements on either side of a row in shared memory
template <class F>
constexpr int kThreads = sizeof(F) == 8 ? 128 : 256;  // per block, at most

// Planes with strides in bytes; the channels of channels-last images are planes, too.
using StoredPlanes = Planes<uint8_t>;
template <class T>
StoredPlanes stored_planes(Planes<T> const& p) {
  constexpr int64_t size = sizeof(T);
  auto* const data = reinterpret_cast<uint8_t*>(const_cast<std::remove_const_t<T>*>(p.data));
  if (p.step > 1)
    return {data, p.outer, p.step, p.outer_stride * size, size, p.row_stride * size, p.height, p.width, p.step * size};
  return {data,     p.outer, p.inner, p.outer_stride * size, p.inner_stride * size, p.row_stride * size,
          p.height, p.width, size};
}

template <class F>
struct Work {
  StoredPlanes x, grad, result;  // the result is the response or the gradient of x
  DType stored;
  bool vectors;  // what threads with four columns read or write besides x is accessed in vectors
  ResponseArguments<F> arguments;
  unsigned across, down;  // blocks per plane
  int rows;               // per block
};

// M values for each column of four rows.
template <class F, int M, int Pad = kPad>
struct RowGroup {
  alignas(16) F values[kRows][M][kThreads<F> + 2 * Pad];  // column `left` of the block is at Pad
};

// The position of a block and its threads. Along y each thread has the column `column`; along x it has the columns from
// `x` on of row `r` of the rows that are processed together. Adjacent blocks overlap by the reach of their windows.
struct BlockPosition {
  int64_t plane;
  int left, column, r, x, y0, y1, width, height, first, last;  // the block writes columns from `first` to before `last`

  // `reach`: columns on either side of the block whose results are incomplete; a multiple of kRows.
  template <class F>
  __device__ __forceinline__ BlockPosition(Work<F> const& work, int reach)
      : width(int(work.x.width)), height(int(work.x.height)) {
    unsigned const line = blockIdx.x / work.across, block = blockIdx.x - line * work.across;
    plane = line / work.down;
    int const columns = int(blockDim.x);
    left = int(block) * (columns - 2 * reach);
    column = left + int(threadIdx.x);
    r = int(threadIdx.x) / (columns / kRows);
    x = left + kRows * (int(threadIdx.x) - r * (columns / kRows));
    first = block == 0 ? 0 : left + reach;
    last = block + 1 == work.across ? width : left + columns - reach;
    y0 = int(line - unsigned(plane) * work.down) * work.rows;
    y1 = min(y0 + work.rows, height);
  }
  __device__ __forceinline__ bool owns(int c) const { return c >= first && c < last; }
  // Whether the thread writes some of its columns along x.
  __device__ __forceinline__ bool owns_some() const { return x + kRows > first && x < last; }
  // Calls f(index in the block's row) for every position out of bounds within `Reach` that reads column `c`.
  template <int Reach, int Pad = kPad, class F>
  __device__ __forceinline__ void for_each_outside(Border border, int c, F f) const {
    for_each_reader(border, c, width, left == 0 ? Reach : 0, Reach, [&](int i) {
      if (i != c && i - left < int(blockDim.x) + Pad) f(Pad + i - left);
    });
  }
  template <int Reach>
  __device__ __forceinline__ bool is_near_end(int c, int count) const {
    return c < width && (c <= Reach || c + count + Reach >= width);
  }
};

// Writes a thread's columns of a row along x, of which only those that the block owns.
template <class F>
__device__ __forceinline__ void write_row(Work<F> const& work, BlockPosition const& position, int y,
                                          F const (&values)[kRows]) {
  uint8_t* const row = work.result.row(position.plane, y) + position.x * work.result.step;
  dispatch_floating_dtype<F>(work.stored, [&](auto type) {
    using T = decltype(type);
    if (work.vectors && position.x >= position.first && position.x + kRows <= position.last) {
      store_vector(reinterpret_cast<T*>(row), values);
      return;
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      if (position.owns(position.x + j)) *reinterpret_cast<T*>(row + j * work.result.step) = round_to<T>(values[j]);
  });
}

// Reads the same columns of a row of gradients, as 0 out of bounds.
template <class F>
__device__ __forceinline__ void read_gradients(Work<F> const& work, BlockPosition const& position, int y,
                                               F (&values)[kRows]) {
  uint8_t const* const row = work.grad.row(position.plane, y) + position.x * work.grad.step;
  dispatch_floating_dtype<F>(work.stored, [&](auto type) {
    using T = decltype(type);
    if (work.vectors && position.x + kRows <= position.width) {
      auto const vector = *reinterpret_cast<Vector<T, kRows> const*>(row);
#pragma unroll
      for (int j = 0; j < kRows; ++j) values[j] = read(vector.v[j]);
      return;
    }
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      values[j] = position.x + j < position.width ? read(*reinterpret_cast<T const*>(row + j * work.grad.step)) : F(0);
  });
}

// Writes the thread's column of a row.
template <class F>
__device__ __forceinline__ void write_pixel(Work<F> const& work, uint8_t* pixel, F value) {
  dispatch_floating_dtype<F>(work.stored, [&](auto type) {
    using T = decltype(type);
    *reinterpret_cast<T*>(pixel) = round_to<T>(value);
  });
}

// Reads the elements of a row in shared memory from `at` on, which is a multiple of 4.
template <class F, int N>
__device__ __forceinline__ void read_window(F const* line, int at, F (&v)[N]) {
#pragma unroll
  for (int i = 0; i < N; i += 4) {
    Vector<F, 4> const vector = *reinterpret_cast<Vector<F, 4> const*>(line + at + i);
#pragma unroll
    for (int e = 0; e < 4; ++e) v[i + e] = vector.v[e];
  }
}
template <class F>
__device__ __forceinline__ void write_vector(F* line, int at, F const (&v)[kRows]) {
  *reinterpret_cast<Vector<F, 4>*>(line + kPad + at) = {v[0], v[1], v[2], v[3]};
}

struct Grid {
  unsigned across, down, blocks;
  int rows, threads;

  // Splits planes into blocks, no wider than their columns need. A block reads `more` rows than it completes, and the
  // number of rows per block minimizes the work of each multiprocessor, which holds `resident` blocks of the most
  // threads.
  Grid(int64_t planes, int64_t height, int64_t width, int most_threads, int reach, int more, int resident)
      : across(0), rows(1), threads(0) {
    int64_t const fewest = 1 + ceil_div(max(width - most_threads, int64_t(0)), most_threads - 2 * reach);
    for (int64_t parts = fewest; parts <= fewest + 2; ++parts) {
      int64_t const each = ceil_div(ceil_div(width + 2 * reach * (parts - 1), parts), 32) * 32;
      if (across == 0 || parts * each < int64_t(across) * threads) across = unsigned(parts), threads = int(each);
    }
    double min_work = INFINITY;
    int64_t const machine = multiprocessors(), held = resident * most_threads / threads;
    for (int64_t parts = 1; parts <= height / 8 + 1; ++parts) {
      int64_t const each = ceil_div(height, parts);
      int64_t const count = ceil_div(planes * across * ceil_div(height, each), machine);
      double const work = double(ceil_div(count, held) * held) * double(each + more);
      if (work < min_work) min_work = work, rows = int(each);
    }
    down = unsigned(ceil_div(height, rows));
    blocks = unsigned(planes * across * down);
  }
};

// Whether all rows are aligned to vectors of four pixels.
template <class T>
bool has_vectors(Planes<T> const& p) {
  constexpr int64_t size = sizeof(T), bytes = size == 8 ? 16 : kRows * size;
  return p.step == 1 && reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.outer_stride * size % bytes == 0 &&
         p.inner_stride * size % bytes == 0 && p.row_stride * size % bytes == 0;
}

template <class T>
Work<Compute<T>> work_of(DifferenceOfGaussians<T> const& p) {
  return {stored_planes(p.x), {}, stored_planes(p.y), kDType<T>, has_vectors(p.y)};
}
template <class Params>
auto arguments_of(Params const& p) {
  auto arguments = p.arguments;
  if (p.x.step > 1) arguments.planes_of_sample = p.x.step;
  return arguments;
}
template <class T>
Work<Compute<T>> work_of(Response<T> const& p) {
  return {stored_planes(p.x), {}, stored_planes(p.y), kDType<T>, has_vectors(p.y), arguments_of(p)};
}
template <class T>
Work<Compute<T>> work_of(ResponseBackward<T> const& p) {
  return {stored_planes(p.x), stored_planes(p.grad), stored_planes(p.grad_x),
          kDType<T>,          has_vectors(p.grad),   arguments_of(p)};
}

template <class F>
int run(void (*kernel)(Work<F>), Work<F> work, int reach, int more, int resident, CUstream_st* stream) {
  Grid const grid(work.x.count(), work.x.height, work.x.width, kThreads<F>, reach, more, resident);
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  kernel<<<grid.blocks, grid.threads, 0, stream>>>(work);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::feature::cuda
