// Determinants of the Hessian on CUDA; responses.cuh says how a block goes through an image.
//
//   along y   rows of the three second derivatives               -> lines
//   along x   rows of the derivatives, gradient of the response  -> gradient
//   along x   transposed rows                                    -> back
//   along y   transposed rows
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int kReach = 4;  // columns of a block, see BlockPosition; of responses and of gradients
constexpr int kBlocks = 4, kBlocksOfGradients = 3;  // of a multiprocessor

// The second derivatives along y of a thread's column: orders 0, 1, 2 for those of order 2, 1, 0 along x.
template <class Kernel, class F>
struct DerivativesDown {
  static constexpr int kAround = 2 * Kernel::reach;
  uint8_t const* column;  // in row 0
  int64_t row_stride;
  int height;
  DType stored;
  F pixels[kAround + kRows];  // the last ones are the latest

  __device__ __forceinline__ DerivativesDown(Work<F> const& work, BlockPosition const& position)
      : column(work.x.plane(position.plane) + min(position.column, position.width - 1) * work.x.step),
        row_stride(work.x.row_stride),
        height(position.height),
        stored(work.stored) {}

  // Reads `Count` rows from y on, of which those out of bounds are the first or the last one.
  template <int Count>
  __device__ __forceinline__ void read_rows(int y) {
#pragma unroll
    for (int i = 0; i < kAround; ++i) pixels[i] = pixels[i + kRows];
    dispatch_floating_dtype<F>(stored, [&](auto type) {
      using T = decltype(type);
#pragma unroll
      for (int r = 0; r < Count; ++r)
        pixels[kAround + kRows - Count + r] =
            read(*reinterpret_cast<T const*>(column + clamp(y + r, 0, height - 1) * row_stride));
    });
  }
  // Those of the rows from y on.
  __device__ __forceinline__ void next(int y, BlockPosition const& position, RowGroup<F, 3>& lines) {
    read_rows<kRows>(y + Kernel::reach);
    int const at = int(threadIdx.x) + kPad;
    F values[kRows][3];
#pragma unroll
    for (int r = 0; r < kRows; ++r)
      filters::for_each_channel<Kernel>([&](auto c) {
        values[r][c.value] = c.down().dot([&](int i) { return pixels[r + i]; }) * c.template scale<F>(true);
        lines.values[r][c.value][at] = values[r][c.value];
      });
    if (position.template is_near_end<Kernel::reach>(position.column, 1))
      position.template for_each_outside<Kernel::reach>(Border::replicate, position.column, [&](int to) {
#pragma unroll
        for (int r = 0; r < kRows; ++r)
#pragma unroll
          for (int m = 0; m < 3; ++m) lines.values[r][m][to] = values[r][m];
      });
  }
};

// Along x: the Hessians of a thread's columns.
template <class Kernel, class F>
__device__ __forceinline__ void hessians(BlockPosition const& position, RowGroup<F, 3> const& lines,
                                         SymmetricMatrix<F> (&result)[kRows]) {
  F derivatives[3][kRows];
  filters::for_each_channel<Kernel>([&](auto c) {
    F v[kRows + 2 * kPad];
    read_window(lines.values[position.r][c.value], position.x - position.left, v);
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      derivatives[c.value][j] = c.along().dot([&](int i) { return v[kPad - Kernel::reach + j + i]; });
  });
#pragma unroll
  for (int j = 0; j < kRows; ++j) result[j] = {derivatives[0][j], derivatives[2][j], derivatives[1][j]};
}

template <class Kernel, class F>
__global__ void __launch_bounds__(kThreads<F>, kBlocks) hessian_forward(__grid_constant__ Work<F> const work) {
  __shared__ RowGroup<F, 3> groups[2];
  BlockPosition const position(work, kReach);
  DerivativesDown<Kernel, F> down(work, position);
  F const scale = work.arguments.scale_of(position.plane);
  down.template read_rows<2 * Kernel::reach>(position.y0 - Kernel::reach);
  int group = 0;
  for (int y = position.y0; y < position.y1; y += kRows, group ^= 1) {
    if (position.column < position.width) down.next(y, position, groups[group]);
    __syncthreads();
    int const row = y + position.r;
    if (row >= position.y1 || !position.owns_some()) continue;
    SymmetricMatrix<F> of_row[kRows];
    hessians<Kernel>(position, groups[group], of_row);
    F result[kRows];
#pragma unroll
    for (int j = 0; j < kRows; ++j) result[j] = scale * determinant(of_row[j]);
    write_row(work, position, row, result);
  }
}

template <class Kernel, class F>
__global__ void __launch_bounds__(kThreads<F>, kBlocksOfGradients)
    hessian_backward(__grid_constant__ Work<F> const work) {
  constexpr int reach = Kernel::reach;
  __shared__ RowGroup<F, 3> lines, gradients;
  BlockPosition const position(work, kReach);
  DerivativesDown<Kernel, F> down(work, position);
  F const scale = work.arguments.scale_of(position.plane);
  int const height = position.height, width = position.width, column = position.column, x = position.x;
  int const first = x - position.left, at = int(threadIdx.x) + kPad;
  uint8_t* const pixel = work.result.plane(position.plane) + min(column, width - 1) * work.result.step;
  // Gradients out of bounds are 0; the elements before the block's first column and after its last one stay.
  if (threadIdx.x < kPad)
#pragma unroll
    for (int r = 0; r < kRows; ++r)
#pragma unroll
      for (int m = 0; m < 3; ++m) {
        F* const line = gradients.values[r][m];
        line[threadIdx.x] = line[kPad + blockDim.x + threadIdx.x] = 0;
      }
  down.template read_rows<2 * reach>(position.y0 - 2 * reach);
  F back[2 * reach + kRows][3];  // the last rows, after the steps along x

  for (int y = position.y0 - reach; y - kRows + kRows - 1 - reach < position.y1 - 1; y += kRows) {
    if (column < width) down.next(y, position, lines);
    __syncthreads();
    {
      int const row = y + position.r;
      SymmetricMatrix<F> of_row[kRows];
      F grads[kRows] = {}, result[3][kRows];
      hessians<Kernel>(position, lines, of_row);
      bool const in_bounds = row >= 0 && row < height;
      if (in_bounds && x < width) read_gradients(work, position, row, grads);
#pragma unroll
      for (int j = 0; j < kRows; ++j) {
        SymmetricMatrix<F> const d = determinant_vjp(of_row[j], grads[j] * scale);
        bool const is_pixel = in_bounds && x + j < width;
        result[0][j] = is_pixel ? d.xx : F(0), result[1][j] = is_pixel ? d.xy : F(0);
        result[2][j] = is_pixel ? d.yy : F(0);
      }
#pragma unroll
      for (int m = 0; m < 3; ++m) write_vector(gradients.values[position.r][m], first, result[m]);
    }
    __syncthreads();
    filters::for_each_channel<Kernel>([&](auto c) {
      F v[kRows + 2 * kPad], result[kRows];
      read_window(gradients.values[position.r][c.value], first, v);
#pragma unroll
      for (int j = 0; j < kRows; ++j)
        result[j] = c.along().dot_vjp([&](int i) { return v[kPad - reach + j + i]; }, x + j == 0, x + j == width - 1) *
                    c.template scale<F>(true);
      write_vector(lines.values[position.r][c.value], first, result);
    });
    __syncthreads();
    if (column < width) {
#pragma unroll
      for (int i = 0; i < 2 * reach; ++i)
#pragma unroll
        for (int m = 0; m < 3; ++m) back[i][m] = back[i + kRows][m];
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int m = 0; m < 3; ++m) back[2 * reach + r][m] = lines.values[r][m][at];
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        int const row = y + r - reach;
        F sum = 0;
        filters::for_each_channel<Kernel>([&](auto c) {
          sum += c.down().dot_vjp([&](int i) { return back[r + i][c.value]; }, row == 0, row == height - 1);
        });
        if (row >= position.y0 && row < position.y1 && position.owns(column))
          write_pixel(work, pixel + row * work.result.row_stride, sum);
      }
    }
    __syncthreads();
  }
}

}  // namespace

template <class T>
int hessian_response(Response<T> const& p, CUstream_st* stream) {
  int error = 0;
  dispatch_second_derivatives(p.arguments.sobel, [&](auto kernel) {
    using Kernel = decltype(kernel);
    error = run(hessian_forward<Kernel, Compute<T>>, work_of(p), kReach, 2 * Kernel::reach, kBlocks, stream);
  });
  return error;
}

template <class T>
int hessian_response_backward(ResponseBackward<T> const& p, CUstream_st* stream) {
  int error = 0;
  dispatch_second_derivatives(p.arguments.sobel, [&](auto kernel) {
    using Kernel = decltype(kernel);
    error =
        run(hessian_backward<Kernel, Compute<T>>, work_of(p), kReach, 4 * Kernel::reach, kBlocksOfGradients, stream);
  });
  return error;
}

KV_INSTANTIATE(hessian_response, Response)
KV_INSTANTIATE(hessian_response_backward, ResponseBackward)

}  // namespace kv::feature::cuda
