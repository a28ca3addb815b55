// Determinants of the Hessian on CUDA. Those of planar images are in scale_space/hessian.cu.
//
// A block traverses its columns downwards, row by row; a thread has four columns. The steps of an iteration are
// independent: each reads what the one before it wrote to shared memory in the iteration before.
//
//   row y      second derivatives along y
//   row y - 1  second derivatives along x; gradient of the determinant
//   row y - 2  transposed derivatives along x and, by running sums, along y
#include "responses.cuh"
#include "scale_space/hessian.h"

namespace kv::feature::cuda {
namespace {

constexpr int P = kColumns;
constexpr int kReach = 4;                            // columns of a block that are incomplete on either side
constexpr int kBlocks = 12, kBlocksOfGradients = 8;  // of a multiprocessor

template <class Row>
struct RowWeights;
template <int... W>
struct RowWeights<filters::WeightRow<W...>> {
  __host__ __device__ static constexpr int at(int i) {
    constexpr int weights[] = {W...};
    return weights[i];
  }
};

// The rows of a thread's columns that second derivatives along y read.
template <class Kernel, class F, bool Vectors>
struct PixelRows {
  static constexpr int reach = Kernel::reach;
  Columns<F, Vectors> const columns;
  F rows[2 * reach + 1][P];
  F next[P];  // a row that was read ahead

  // The first row is `y`.
  __device__ __forceinline__ PixelRows(Work<F> const& work, ColumnPosition const& position, int y)
      : columns(work, work.x, position) {
#pragma unroll
    for (int i = 1; i <= 2 * reach; ++i) read(y - reach + i - 1, rows[i]);
    read(y + reach, next);
  }
  __device__ __forceinline__ void read(int y, F (&row)[P]) const {
    columns.read(clamp(y, 0, int(columns.work.x.height) - 1), row);
  }
  // Moves on to row y and, if `more`, reads a row ahead. Calls are in the order of rows. A thread waits for all of its
  // loads at once, so it takes `next` before it starts to read another row.
  __device__ __forceinline__ void advance(int y, bool more) {
#pragma unroll
    for (int i = 0; i < 2 * reach; ++i)
#pragma unroll
      for (int j = 0; j < P; ++j) rows[i][j] = rows[i + 1][j];
#pragma unroll
    for (int j = 0; j < P; ++j) rows[2 * reach][j] = next[j];
    if (more) read(y + 1 + reach, next);
  }
  // Writes the derivatives along y of the row to `lines`.
  __device__ __forceinline__ void write_derivatives(ColumnPosition const& position, Lines<F, 3>& lines) const {
    filters::for_each_channel<Kernel>([&](auto c) {
      F values[P];
#pragma unroll
      for (int j = 0; j < P; ++j) values[j] = c.down().dot([&](int i) { return rows[i][j]; });
      write_replicated<reach, Vectors>(position, lines.values[c.value], values);
    });
  }
};

// The Hessians of a thread's columns, by derivatives along x of the derivatives along y in `lines`.
template <class Kernel, class F>
__device__ __forceinline__ void hessians(int at, Lines<F, 3> const& lines, SymmetricMatrix<F> (&result)[P]) {
  F derivatives[3][P];
  filters::for_each_channel<Kernel>([&](auto c) {
    F v[P + 2 * kPad];
    read_window(lines.values[c.value], at, v);
#pragma unroll
    for (int j = 0; j < P; ++j)
      derivatives[c.value][j] = c.along().dot([&](int i) { return v[kPad - Kernel::reach + j + i]; });
  });
#pragma unroll
  for (int j = 0; j < P; ++j)
    result[j] = SecondDerivatives<Kernel, F>().hessian(derivatives[0][j], derivatives[1][j], derivatives[2][j]);
}

template <class Kernel, class F>
__global__ void __launch_bounds__(kColumnThreads<F>, kBlocks) hessian_forward(__grid_constant__ Work<F> const work) {
  __shared__ Lines<F, 3> lines[2];
  ColumnPosition const position(work, kReach, int(blockDim.x), int(threadIdx.x));
  PixelRows<Kernel, F, false> pixels(work, position, position.y0);
  Columns<F, false> const results(work, work.result, position);
  F const scale = work.arguments.scale_of(position.plane) * SecondDerivatives<Kernel, F>().factor;
  bool const writes = position.owns_some();
  int now = 0;
#pragma unroll(2 * Kernel::reach + 1)  // so that registers of rows are renamed, not moved
  for (int y = position.y0; y <= position.y1; ++y, now ^= 1) {
    // Only loads and stores are conditional: where rows were, branches would move their registers.
    bool const has_pixels = y < position.y1 && position.x < position.width;
    pixels.advance(y, has_pixels);
    if (has_pixels) pixels.write_derivatives(position, lines[now]);
    if (y > position.y0 && writes) {
      SymmetricMatrix<F> hessian[P];
      hessians<Kernel>(position.at, lines[now ^ 1], hessian);
      F result[P];
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = scale * determinant(hessian[j]);
      results.write(position, y - 1, result);
    }
    __syncthreads();
  }
}

template <class Kernel, class F, bool Vectors>
__global__ void __launch_bounds__(kColumnThreads<F>, kBlocksOfGradients)
    hessian_backward(__grid_constant__ Work<F> const work) {
  constexpr int reach = Kernel::reach;
  __shared__ Lines<F, 3> lines[2], gradients[2];
  ColumnPosition const position(work, kReach, int(blockDim.x), int(threadIdx.x));
  int const height = position.height, width = position.width, x = position.x, y0 = position.y0, y1 = position.y1;
  PixelRows<Kernel, F, Vectors> pixels(work, position, y0 - reach);
  Columns<F, Vectors> const grads(work, work.grad, position), results(work, work.result, position);
  F const scale = work.arguments.scale_of(position.plane) * SecondDerivatives<Kernel, F>().factor;
  bool const has_columns = x < width;
  for (int i = int(threadIdx.x); i < int(sizeof(gradients) / sizeof(F)); i += int(blockDim.x))
    gradients[0].values[0][i] = 0;  // gradients out of bounds stay 0
  __syncthreads();
  F sums[2 * reach][P] = {}, before_first[P] = {};  // of incomplete rows; of rows above the image
  F next_grad[P] = {};                              // a row that was read ahead
  int now = 0;
#pragma unroll 1
  for (int y = y0 - reach; y < y1 + reach + 2; ++y, now ^= 1) {
    pixels.advance(y, true);
    F grad[P];
#pragma unroll
    for (int j = 0; j < P; ++j) grad[j] = next_grad[j];
    grads.read(clamp(y, 0, height - 1), next_grad);
    if (has_columns) {
      int const row = y - 1;
      bool const in_bounds = row >= 0 && row < height;
      pixels.write_derivatives(position, lines[now]);
      SymmetricMatrix<F> hessian[P];
      hessians<Kernel>(position.at, lines[now ^ 1], hessian);
      F result[3][P];
#pragma unroll
      for (int j = 0; j < P; ++j) {
        SymmetricMatrix<F> const d =
            SecondDerivatives<Kernel, F>().hessian_vjp(determinant_vjp(hessian[j], grad[j] * scale));
        bool const is_pixel = in_bounds && row >= y0 - reach && (Vectors || x + j < width);
        result[0][j] = is_pixel ? d.xx : F(0), result[1][j] = is_pixel ? d.xy : F(0);
        result[2][j] = is_pixel ? d.yy : F(0);
      }
#pragma unroll
      for (int m = 0; m < 3; ++m) write_vector(gradients[now].values[m], position.at, result[m]);

      F back[3][P], complete[P];
      filters::for_each_channel<Kernel>([&](auto c) {
        F v[P + 2 * kPad];
        read_window(gradients[now ^ 1].values[c.value], position.at, v);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          bool const may_be_last = !Vectors || j == P - 1;
          back[c.value][j] = c.along().dot_vjp([&](int i) { return v[kPad - reach + j + i]; }, j == 0 && x == 0,
                                               may_be_last && x + j == width - 1);
        }
      });
#pragma unroll
      for (int j = 0; j < P; ++j) {
#pragma unroll
        for (int t = 0; t <= 2 * reach; ++t) {
          F sum = t < 2 * reach ? sums[min(t, 2 * reach - 1)][j] : F(0);
          filters::for_each_channel<Kernel>([&](auto c) {
            constexpr int channel = decltype(c)::value;
            int const weight = RowWeights<decltype(c.down())>::at(t);
            if (weight != 0) sum += F(weight) * back[channel][j];
          });
          if (t == 0)
            complete[j] = sum;
          else
            sums[t - 1][j] = sum;
        }
      }
      // The replicating border reads the first and the last row more than once.
      int const completed = y - 2 - reach;
#pragma unroll
      for (int j = 0; j < P; ++j) {
        if (completed < 0) before_first[j] += complete[j];
        if (completed == 0) complete[j] += before_first[j];
        if (completed == height - 1)
#pragma unroll
          for (int t = 0; t < reach; ++t) complete[j] += sums[t][j];
      }
      if (completed >= y0 && completed < y1) results.write(position, completed, complete);
    }
    __syncthreads();
  }
}

}  // namespace

template <class T>
int hessian_response(Response<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  // Special case, H200: 1.62 to 1.99 times as fast as any layout.
  if (p.x.step == 1 && p.y.step == 1 && p.x.row_stride <= INT32_MAX / int64_t(sizeof(T)))
    return level_hessian<T>({p.x, p.y, p.arguments.sobel, {}, 0, p.arguments}, stream);
  int error = 0;
  dispatch_second_derivatives(p.arguments.sobel, [&](auto kernel) {
    using Kernel = decltype(kernel);
    error = run(hessian_forward<Kernel, F>, hessian_forward<Kernel, F>, work_of(p), 1, kReach, 2 * Kernel::reach + 1,
                kBlocks, 1, 0, stream);
  });
  return error;
}

template <class T>
int hessian_response_backward(ResponseBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int error = 0;
  dispatch_second_derivatives(p.arguments.sobel, [&](auto kernel) {
    using Kernel = decltype(kernel);
    error = run(hessian_backward<Kernel, F, false>, hessian_backward<Kernel, F, kHasVectors<F>>, work_of(p), 1, kReach,
                4 * Kernel::reach + 2, kBlocksOfGradients, 1, 0, stream);
  });
  return error;
}

KV_INSTANTIATE(hessian_response, Response)
KV_INSTANTIATE(hessian_response_backward, ResponseBackward)

}  // namespace kv::feature::cuda
