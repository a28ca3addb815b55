// The gradient of dilation and erosion by flat windows of 7 x 7 and 15 x 15 pixels on CUDA. A block traverses its
// columns of a plane downwards, a group of rows at a time, so that few windows are computed twice. Along y a thread has
// one column; along x it has as many pixels of one row as the group has rows.
//
// Of S elements, the windows that begin at 0 ... S are a suffix of the elements 0 ... S - 1 and a prefix of the
// elements S ... 2 S - 1. So S + 1 windows take 3 S - 3 merges (van Herk, Gil and Werman).
#include "core/column_grid.cuh"
#include "dilation_tiles.cuh"

namespace kv::morphology::cuda {
namespace {

using Value = Ties<float>;

constexpr int kMaxColumns = 256, kResident = 3;

// Rows of a group, for windows of `size` rows and columns; `size - 1` rows of windows are kept for the next group.
constexpr int rows_of(int size) { return size + 1; }
// An odd number, so that the threads of a warp, which take different rows along x, read different banks.
constexpr int stride_of(int size, int columns) { return (columns + size - 1) | 1; }
constexpr int bytes_of(int size, int columns) {
  return int(sizeof(Value)) * (rows_of(size) * stride_of(size, columns) + (size - 1) * columns);
}

template <class T>
struct Work {
  Planes<T const> grad, x;
  Planes<T> grad_x;
  StructuringElement<float> window;
  int64_t planes;  // of a sample
  unsigned across, down;
  int rows;
};

template <int Size, class Read, class Write>
__device__ __forceinline__ void combine_run(Read read, Write write) {
  Value suffix[Size];
  suffix[Size - 1] = read(Size - 1);
#pragma unroll
  for (int i = Size - 2; i >= 0; --i) suffix[i] = combine(read(i), suffix[i + 1]);
  write(0, suffix[0]);
  Value prefix = read(Size);
#pragma unroll
  for (int i = 1; i < Size; ++i) {
    write(i, combine(suffix[i], prefix));
    prefix = combine(prefix, read(Size + i));
  }
  write(Size, prefix);
}

// Combines windows along x, in place: window i begins at element i of a row, and is stored at `to + i`.
template <int Size>
__device__ __forceinline__ void combine_rows(Value* values, int stride, int to) {
  constexpr int kRows = rows_of(Size);
  int const run = int(threadIdx.x) / kRows * kRows;
  Value* const row = values + int(threadIdx.x) % kRows * stride + run;
  Value results[kRows];
  combine_run<Size>([&](int i) { return row[i]; }, [&](int i, Value const& value) { results[i] = value; });
  __syncthreads();
#pragma unroll
  for (int i = 0; i < kRows; ++i) row[to + i] = results[i];
  __syncthreads();
}

template <class T, int Size>
__global__ void __launch_bounds__(kMaxColumns, kResident) backward_by_strips(__grid_constant__ Work<T> const p) {
  constexpr int kRows = rows_of(Size), kCarried = Size - 1;
  extern __shared__ __align__(16) unsigned char bytes[];
  ColumnBlock const block(p, int(blockDim.x), kCarried);
  if (!is_flat(p.window, block.plane / p.planes)) return;
  int const columns = int(blockDim.x), stride = stride_of(Size, columns), thread = int(threadIdx.x);
  int const top = p.window.top, left = p.window.left, right = kCarried - left;
  int const column = block.left + thread, height = block.height;
  bool const in_plane = column < block.width, owned = block.owns(column);
  float const sign = p.window.sign(), outside = p.window.value * sign;
  T const* const x_column = p.x.plane(block.plane) + column;
  T const* const grad_column = p.grad.plane(block.plane) + column;
  T* const out_column = p.grad_x.plane(block.plane) + column;
  int const x_stride = int(p.x.row_stride), grad_stride = int(p.grad.row_stride), out_stride = int(p.grad_x.row_stride);

  Value* const values = reinterpret_cast<Value*>(bytes);    // (kRows, stride)
  Value* const carried = values + kRows * stride + thread;  // (kCarried, columns): windows of the rows before
  Value* const pixels = values + left + thread;             // of the thread's column
  Value* const windows = values + right + thread;
  // The values on either side of the block's columns.
  auto const pad = [&](int before, Value const& value) {
    if (thread >= kCarried) return;
    Value* const at = values + (thread < before ? thread : columns + thread);
#pragma unroll
    for (int i = 0; i < kRows; ++i) at[i * stride] = value;
  };
  // Calls f(i, whether row y + i is in bounds) for N rows of the thread's column.
  auto const for_each_row = [&](int y, auto count, auto f) {
    if (in_plane && y >= 0 && y + count <= height) {
#pragma unroll
      for (int i = 0; i < count; ++i) f(i, true);
    } else {
#pragma unroll
      for (int i = 0; i < count; ++i) f(i, in_plane && y + i >= 0 && y + i < height);
    }
  };
  float x[2 * Size];  // the pixels of the column from row `row - top` on
  auto const load_pixels = [&](int y, auto begin, auto count) {
    for_each_row(y + begin, count, [&](int i, bool inside) {
      x[begin + i] = inside ? read(x_column[unsigned((y + begin + i) * x_stride)]) * sign : outside;
    });
  };
  using Carried = std::integral_constant<int, kCarried>;
  using Rows = std::integral_constant<int, kRows>;

  int const first = max(block.y0 + top - kCarried, 0);  // row of windows
  load_pixels(first - top, std::integral_constant<int, 0>(), Carried());
#pragma unroll
  for (int i = 0; i < kCarried; ++i) carried[i * columns] = {minus_infinity<float>(), 0};
#pragma unroll 1
  for (int row = first; row - top < block.y1; row += kRows) {
    load_pixels(row - top, Carried(), Rows());
    pad(left, {outside, float(Size)});
    combine_run<Size>([&](int i) { return Value{x[i], 1}; },
                      [&](int i, Value const& value) { pixels[i * stride] = value; });
#pragma unroll
    for (int i = 0; i < kCarried; ++i) x[i] = x[i + kRows];
    __syncthreads();
    combine_rows<Size>(values, stride, right);

    // Replaces maxima and tie counts by negative maxima and tie gradients: a minimum of maxima is computed as the
    // maximum of their negatives. Windows out of bounds have none.
    float grad[kRows];
    for_each_row(row, Rows(), [&](int i, bool inside) {
      grad[i] = inside ? read(grad_column[unsigned((row + i) * grad_stride)]) : 0.f;
    });
    int const rows = in_plane ? height - row : 0;
    pad(right, {minus_infinity<float>(), 0});
    combine_run<Size>(
        [&](int i) {
          if (i < kCarried) return carried[i * columns];
          int const at = max(i - kCarried, 0);
          Value const ties = windows[at * stride];
          bool const counts = at < rows && ties.value == ties.value;
          float const of_tie = tie_gradient(grad[at], ties.count);
          Value const value{counts ? -ties.value : minus_infinity<float>(), counts ? of_tie : 0.f};
          if (i >= kRows) carried[(i - kRows) * columns] = value;
          return value;
        },
        [&](int i, Value const& value) { windows[i * stride] = value; });
    __syncthreads();
    combine_rows<Size>(values, stride, left);

    int const y = row - top;
    auto const store = [&](int i) {
      float const own = read(x_column[unsigned((y + i) * x_stride)]) * sign;
      Value const sum = pixels[i * stride];
      out_column[unsigned((y + i) * out_stride)] = round_to<T>(own == -sum.value ? sum.count : 0.f);
    };
    if (owned && y >= block.y0 && y + kRows <= block.y1) {
#pragma unroll
      for (int i = 0; i < kRows; ++i) store(i);
    } else if (owned) {
      for (int i = max(block.y0 - y, 0); i < min(block.y1 - y, kRows); ++i) store(i);
    }
  }
}

}  // namespace

template <class T>
int dilation_backward_strips(DilationBackward<T> const& p, CUstream_st* stream) {
  auto const launch = [&](auto size) -> int {
    constexpr int kSize = decltype(size)::value;
    auto const kernel = backward_by_strips<T, kSize>;
    int const bytes = bytes_of(kSize, kMaxColumns);
    ColumnGrid const grid(p.x.count(), p.x.height, p.x.width, kMaxColumns, kSize - 1, kSize - 1, kResident, bytes, 32,
                          rows_of(kSize));
    if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes)) return error;
    kernel<<<grid.blocks, grid.columns, bytes_of(kSize, grid.columns), stream>>>(
        {p.grad, p.x, p.grad_x, p.window, p.planes, grid.across, grid.down, grid.rows});
    return cudaGetLastError();
  };
  return p.window.height == 7 ? launch(std::integral_constant<int, 7>()) : launch(std::integral_constant<int, 15>());
}

template int dilation_backward_strips(DilationBackward<float> const&, CUstream_st*);
template int dilation_backward_strips(DilationBackward<Half> const&, CUstream_st*);
template int dilation_backward_strips(DilationBackward<BFloat16> const&, CUstream_st*);

}  // namespace kv::morphology::cuda
