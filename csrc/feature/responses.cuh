// Shared code of the responses of corners and blobs on CUDA: blocks of columns, loads and stores, and rows in shared
// memory that include the pixels out of bounds that windows read. Only loads and stores depend on dtype and layout,
// which are therefore run-time arguments.
#pragma once

#include "core/column_grid.cuh"
#include "core/dtype.cuh"
#include "responses.h"

namespace kv::feature::cuda {
namespace {

constexpr int kColumns = 4;  // of a thread
constexpr int kPad = 4;      // elements on either side of a row in shared memory
template <class F>
constexpr int kBlockColumns = sizeof(F) == 8 ? 128 : 256;  // at most
template <class F>
constexpr int kColumnThreads = kBlockColumns<F> / kColumns;  // of a block, at most

// Planes with strides in bytes. Each channel of a channels-last image is a plane.
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
  bool vectors;  // all images are accessed in vectors of four pixels
  ResponseArguments<F> arguments;
  unsigned across, down;  // blocks per plane
  int rows;               // per block
};

// Reads N elements of a row in shared memory by vectors, from `at` on, which is a multiple of 4.
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
__device__ __forceinline__ void write_vector(F* line, int at, F const (&v)[kColumns]) {
  *reinterpret_cast<Vector<F, 4>*>(line + kPad + at) = {v[0], v[1], v[2], v[3]};
}

template <class T>
Work<Compute<T>> work_of(DifferenceOfGaussians<T> const& p) {
  return {stored_planes(p.x),
          {},
          stored_planes(p.y),
          kDType<T>,
          is_vectorizable<kColumns>(p.x) && is_vectorizable<kColumns>(p.y)};
}
template <class Params>
auto arguments_of(Params const& p) {
  auto arguments = p.arguments;
  if (p.x.step > 1) arguments.planes_of_sample = p.x.step;
  return arguments;
}
template <class T>
Work<Compute<T>> work_of(Response<T> const& p) {
  return {stored_planes(p.x),
          {},
          stored_planes(p.y),
          kDType<T>,
          is_vectorizable<kColumns>(p.x) && is_vectorizable<kColumns>(p.y),
          arguments_of(p)};
}
template <class T>
Work<Compute<T>> work_of(ResponseBackward<T> const& p) {
  return {stored_planes(p.x),
          stored_planes(p.grad),
          stored_planes(p.grad_x),
          kDType<T>,
          is_vectorizable<kColumns>(p.x) && is_vectorizable<kColumns>(p.grad) && is_vectorizable<kColumns>(p.grad_x),
          arguments_of(p)};
}

// A row of a block in shared memory: M values for each column.
template <class F, int M>
struct Lines {
  alignas(16) F values[M][kBlockColumns<F> + 2 * kPad];  // column `left` of the block is at kPad
};

// The position of thread `t` of the `threads` of a block, whose columns begin `at` columns from the block's first.
struct ColumnPosition : ColumnBlock {
  int at, columns, x;

  template <class F>
  __device__ __forceinline__ ColumnPosition(Work<F> const& work, int reach, int threads, int t)
      : ColumnBlock(work, threads * kColumns, reach), at(kColumns * t), columns(threads * kColumns), x(left + at) {}
  __device__ __forceinline__ bool owns_some() const { return x + kColumns > first && x < last; }
};

// The columns of a thread in one plane. Vectors: rows are vectors of kColumns pixels, see `run`. Single: they are
// stored in the type F. It refers to the arguments of the kernel, which are constants and cost no registers.
template <class F, bool Vectors, bool Single = false>
struct Columns {
  Work<F> const& work;
  StoredPlanes const& planes;
  int const x, last;  // the last pixel of a row is `last` pixels after pixel x
  uint8_t* first;     // in row 0

  __device__ __forceinline__ Columns(Work<F> const& work, StoredPlanes const& planes, ColumnPosition const& position)
      : work(work), planes(planes), x(min(position.x, width() - (Vectors ? kColumns : 1))), last(width() - 1 - x) {
    first = planes.plane(position.plane) + x * planes.step;
  }
  __device__ __forceinline__ int width() const { return int(work.x.width); }
  // N pixels of row `y`, which is in bounds: the thread's columns and (N - kColumns) / 2 on either side. Those out of
  // bounds keep their values until `replicate`, which would wait for the others.
  template <int N>
  __device__ __forceinline__ void read(int y, F (&values)[N]) const {
    with_type([&](auto type) { read_at<decltype(type)>(row(y), values); });
  }
  // Gives pixels out of bounds next to a row the values of the replicate border.
  __device__ __forceinline__ void replicate(F (&values)[kColumns + 2]) const {
    // By value: a selection between array elements would put the array into memory.
    auto const copy_if = [](bool condition, F value, F& to) { to = condition ? value : to; };
    copy_if(x == 0, values[1], values[0]);
#pragma unroll
    for (int j = Vectors ? kColumns - 1 : 0; j < kColumns; ++j) copy_if(j == last, values[j + 1], values[j + 2]);
  }
  // The thread's first pixel of row `y`.
  __device__ __forceinline__ uint8_t* row(int y) const { return first + y * planes.row_stride; }
  // Calls f with the stored type.
  template <class Call>
  __device__ __forceinline__ void with_type(Call f) const {
    if constexpr (Single)
      f(F{});
    else
      dispatch_floating_dtype<F>(work.stored, f);
  }
  // Calls f with the function that gives the bytes from pixel x to the one that is `pixels` further.
  template <class T, class Call>
  __device__ __forceinline__ void with_distances(Call f) const {
    if (planes.step == sizeof(T))
      f([](int pixels) { return pixels * int(sizeof(T)); });
    else
      f([&](int pixels) { return pixels * planes.step; });
  }
  template <class T, int N>
  __device__ __forceinline__ void read_at(uint8_t const* at, F (&values)[N]) const {
    constexpr int kBefore = (N - kColumns) / 2;
    if constexpr (Vectors) {
      auto const vector = *reinterpret_cast<Vector<T, kColumns> const*>(at);
#pragma unroll
      for (int j = 0; j < kColumns; ++j) values[kBefore + j] = kv::read(vector.v[j]);
      if constexpr (kBefore == 1) {
        T const* const pixels = reinterpret_cast<T const*>(at);
        if (x > 0) values[0] = kv::read(pixels[-1]);
        if (last >= kColumns) values[N - 1] = kv::read(pixels[kColumns]);
      }
    } else {
      with_distances<T>([&](auto distance) {
#pragma unroll
        for (int i = 0; i < N; ++i)
          if (i < kBefore ? x > 0 : i - kBefore <= last)
            values[i] = kv::read(*reinterpret_cast<T const*>(at + distance(i - kBefore)));
      });
    }
  }
  // Writes the columns that the block owns.
  __device__ __forceinline__ void write(ColumnPosition const& position, int y, F const (&values)[kColumns]) const {
    uint8_t* const at = row(y);
    with_type([&](auto type) {
      using T = decltype(type);
      if constexpr (Vectors) {
        if (position.owns(position.x)) store_vector(reinterpret_cast<T*>(at), values);
      } else {
        int const owned = position.x < position.first ? 0 : position.last - position.x;  // it begins where threads do
        with_distances<T>([&](auto distance) {
#pragma unroll
          for (int j = 0; j < kColumns; ++j)
            if (j < owned) *reinterpret_cast<T*>(at + distance(j)) = round_to<T>(values[j]);
        });
      }
    });
  }
};

template <class F>
__device__ __forceinline__ void read_vector(F const* line, int at, F (&v)[kColumns]) {
  Vector<F, 4> const vector = *reinterpret_cast<Vector<F, 4> const*>(line + kPad + at);
#pragma unroll
  for (int j = 0; j < kColumns; ++j) v[j] = vector.v[j];
}

// Writes a thread's columns to a line, except those that are right of the image.
template <bool Vectors, class F>
__device__ __forceinline__ void write_line(ColumnPosition const& position, F* line, F const (&v)[kColumns]) {
  if (Vectors || position.x + kColumns <= position.width) {
    write_vector(line, position.at, v);
  } else {
#pragma unroll
    for (int j = 0; j < kColumns; ++j)
      if (position.x + j < position.width) line[kPad + position.at + j] = v[j];
  }
}

// The columns of lines out of bounds that reflect others, as far as a warp reads them. A thread has one of them.
template <class F, int M, int Reach>
struct ReflectedColumns {
  static_assert(2 * M * Reach <= 32 && Reach < kColumns);
  bool exist;    // the same for all threads of the warp
  int from, to;  // elements of lines, or negative

  __device__ __forceinline__ explicit ReflectedColumns(ColumnPosition const& p) {
    int const lane = threadIdx.x % 32, begin = p.at - kColumns * lane, last = p.width - 1 - p.left;
    bool const has_first = p.left == 0 && begin == 0;
    bool const has_last = last < p.columns && last >= begin && last - Reach < begin + 32 * kColumns;
    bool const is_first = lane < M * Reach;
    int const line = lane % M * (int(sizeof(Lines<F, M>) / sizeof(F)) / M) + kPad, d = lane / M % Reach + 1;
    bool const copies = is_first ? has_first : has_last && lane < 2 * M * Reach;
    exist = has_first || has_last;
    from = copies ? line + (is_first ? d : last - d) : -1;
    to = line + (is_first ? -d : last + d);
  }
  // Fills them in, after the barrier behind the stores of all warps. Called by all threads of a warp.
  __device__ __forceinline__ void fill(Lines<F, M>& lines) const {
    if (!exist) return;
    F* const elements = lines.values[0];
    if (from >= 0) elements[to] = elements[from];
    __syncwarp();
  }
};

// Writes a thread's columns to a line, and the first and the last one of the image to the columns out of bounds too.
template <int Reach, bool Vectors, class F>
__device__ __forceinline__ void write_replicated(ColumnPosition const& position, F* line, F const (&v)[kColumns]) {
  static_assert(Reach == 1 || Reach == 2);  // vectors
  int const x = position.x, last = position.width - 1;
  F* const own = line + kPad + position.at;
  write_line<Vectors>(position, line, v);
  auto const fill = [](F* to, F value) {
    Vector<F, Reach> vector;
#pragma unroll
    for (int i = 0; i < Reach; ++i) vector.v[i] = value;
    *reinterpret_cast<Vector<F, Reach>*>(to) = vector;
  };
  if (x == 0) fill(own - Reach, v[0]);
  if constexpr (Vectors) {
    if (x + kColumns - 1 == last) fill(own + kColumns, v[kColumns - 1]);
  } else {
#pragma unroll
    for (int i = 1; i <= Reach; ++i)
#pragma unroll
      for (int j = 0; j < kColumns; ++j)
        if (x + j == last && position.at + j + i < position.columns + kPad) own[j + i] = v[j];
  }
}

// A barrier of all threads of a block that warps reach from different loops.
__device__ __forceinline__ void synchronize_block() {
  asm volatile("barrier.sync 1, %0;" ::"r"(blockDim.x) : "memory");
}

template <class F>
constexpr bool kHasVectors = sizeof(F) == 4;  // float64 has one kernel for aligned and unaligned rows

// Launches `vectors` if rows are made of vectors, otherwise `any`, with `roles` threads for every four columns. A block
// completes `group` rows at a time, and has `column_bytes` of dynamic shared memory for each of its columns and those
// that it reads on either side.
template <class F, class... Arguments>
int run(void (*any)(Work<F>, Arguments...), void (*vectors)(Work<F>, Arguments...), Work<F> work, int roles, int reach,
        int more, int resident, int group, int64_t column_bytes, CUstream_st* stream, Arguments... arguments) {
  ColumnGrid const grid(work.x.count(), work.x.height, work.x.width, kBlockColumns<F>, reach, more, resident, 0,
                        32 * kColumns, group);
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  // Special case, H200: 1.15 (dog_response_single backward) to 1.64 (hessian backward) times as fast as elements.
  auto* const kernel = work.vectors ? vectors : any;
  kernel<<<grid.blocks, unsigned(roles * grid.columns / kColumns), column_bytes*(grid.columns + 2 * reach), stream>>>(
      work, arguments...);
  return cudaGetLastError();
}

}  // namespace
}  // namespace kv::feature::cuda
