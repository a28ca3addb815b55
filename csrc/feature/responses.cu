// Responses of corners on CUDA; responses.cuh says how a block goes through an image.
//
// Derivatives and the window along y are steps along y: a new row of products is added to the sums of all rows whose
// windows contain it, and completes the first of them. Rows out of bounds are computed again from the rows that they
// reflect. The gradient takes two such passes, for the structure tensor and back:
//
//   along y   derivatives, window                 -> products
//   along x   window, gradient of the response    -> gradient
//   along x   window                              -> products
//   along y   window, gradient of the products    -> u, v
//   along y   gradient of the derivatives
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int R = kWindowReach, kTaps = 2 * R + 1;
constexpr int kReach = 4, kReachOfGradients = 8;  // columns of a block, see BlockPosition
constexpr int kMoreRows = 2 * R + 2, kMoreRowsOfGradients = 2 * kCornerGradientReach + 2;
constexpr int kBlocks = 3, kBlocksOfGradients = 2;  // of a multiprocessor

// The running sums along y of a column, for the 2 R rows that are incomplete; a new row completes the first.
template <class F>
struct RunningSums {
  F sums[3][2 * R] = {};

  __device__ __forceinline__ F add(int m, F x) {
    F const complete = sums[m][0] + window_weight<F>(0) * x;
#pragma unroll
    for (int t = 1; t < kTaps; ++t)
      sums[m][t - 1] = t < 2 * R ? sums[m][t] + window_weight<F>(t) * x : window_weight<F>(t) * x;
    return complete;
  }
};

// The sums over the windows along x around a thread's columns.
template <class F>
__device__ __forceinline__ void sum_across(F const* line, int at, F (&sums)[kRows]) {
  F v[kRows + 2 * kPad];
  read_window(line, at, v);
#pragma unroll
  for (int j = 0; j < kRows; ++j) {
    sums[j] = window_weight<F>(0) * v[kPad - R + j];
#pragma unroll
    for (int t = 1; t < kTaps; ++t) sums[j] += window_weight<F>(t) * v[kPad - R + j + t];
  }
}

// The derivatives of a thread's column, row by row.
template <class F>
struct Derivatives {
  uint8_t const* column;  // in row 0
  int64_t left, right;    // to the neighbors, in bytes
  int64_t row_stride;
  int height;
  DType stored;
  bool sobel;
  bool has_rows = false;  // whether the two rows before the next ones are known
  F above[3], middle[3];  // these rows

  __device__ __forceinline__ Derivatives(Work<F> const& work, BlockPosition const& position)
      : column(work.x.plane(position.plane) + min(position.column, position.width - 1) * work.x.step),
        left(position.column > 0 ? -work.x.step : 0),
        right(position.column < position.width - 1 ? work.x.step : 0),
        row_stride(work.x.row_stride),
        height(position.height),
        stored(work.stored),
        sobel(work.arguments.sobel) {}

  template <class T>
  __device__ __forceinline__ void read_row(int y, F (&row)[3]) const {
    uint8_t const* const at = column + y * row_stride;
    row[0] = read(*reinterpret_cast<T const*>(at + left));
    row[1] = read(*reinterpret_cast<T const*>(at));
    row[2] = read(*reinterpret_cast<T const*>(at + right));
  }
  __device__ __forceinline__ void differentiate(F const (&a)[3], F const (&b)[3], F const (&c)[3], F& dx, F& dy) const {
    auto const of_column = [&](int i) { return gradient_column(a[i], b[i], c[i], sobel); };
    gradient(of_column(0), of_column(1), of_column(2), sobel, gradient_scale<F>(sobel), dx, dy);
  }
  // Of the rows from y on.
  __device__ __forceinline__ void next(int y, F* dx, F* dy) {
    if (y >= 0 && y + kRows <= height) {
      F rows[kRows][3];
      dispatch_floating_dtype<F>(stored, [&](auto type) {
        using T = decltype(type);
        if (!has_rows) read_row<T>(max(y - 1, 0), above), read_row<T>(y, middle);
#pragma unroll
        for (int r = 0; r < kRows; ++r) read_row<T>(min(y + r + 1, height - 1), rows[r]);
      });
      has_rows = true;
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        differentiate(above, middle, rows[r], dx[r], dy[r]);
#pragma unroll
        for (int i = 0; i < 3; ++i) above[i] = middle[i], middle[i] = rows[r][i];
      }
      return;
    }
    has_rows = false;
#pragma unroll
    for (int r = 0; r < kRows; ++r) {
      int const at = reflected(y + r, height);
      F a[3], b[3], c[3];
      dispatch_floating_dtype<F>(stored, [&](auto type) {
        using T = decltype(type);
        read_row<T>(max(at - 1, 0), a), read_row<T>(at, b), read_row<T>(min(at + 1, height - 1), c);
      });
      differentiate(a, b, c, dx[r], dy[r]);
    }
  }
};

// Along y: adds four rows of products and writes the rows that they complete.
template <class F>
__device__ __forceinline__ void add_products(BlockPosition const& position, F const* dx, F const* dy,
                                             RunningSums<F>& down, RowGroup<F, 3>& rows) {
  int const at = int(threadIdx.x) + kPad;
#pragma unroll
  for (int r = 0; r < kRows; ++r) {
    F const products[3] = {dx[r] * dx[r], dy[r] * dy[r], dx[r] * dy[r]};
#pragma unroll
    for (int m = 0; m < 3; ++m) rows.values[r][m][at] = down.add(m, products[m]);
  }
  if (position.is_near_end<R>(position.column, 1))
    position.for_each_outside<R>(Border::reflect, position.column, [&](int to) {
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int m = 0; m < 3; ++m) rows.values[r][m][to] = rows.values[r][m][at];
    });
}

// Along x: the structure tensors of a thread's columns.
template <class F>
__device__ __forceinline__ void structure_tensors(BlockPosition const& position, RowGroup<F, 3> const& rows,
                                                  SymmetricMatrix<F> (&tensors)[kRows]) {
  F sums[3][kRows];
#pragma unroll
  for (int m = 0; m < 3; ++m) sum_across(rows.values[position.r][m], position.x - position.left, sums[m]);
#pragma unroll
  for (int j = 0; j < kRows; ++j) tensors[j] = {sums[0][j], sums[1][j], sums[2][j]};
}

template <class F>
__global__ void __launch_bounds__(kThreads<F>, kBlocks) corner_forward(__grid_constant__ Work<F> const work) {
  __shared__ RowGroup<F, 3> groups[2];
  BlockPosition const position(work, kReach);
  Derivatives<F> derivatives(work, position);
  RunningSums<F> down;
  F const k = work.arguments.k_of(position.plane), scale = work.arguments.scale_of(position.plane);
  bool const is_harris = work.arguments.kind == CornerKind::harris;
  int group = 0;
  for (int y = position.y0 - R; y - R < position.y1; y += kRows, group ^= 1) {
    if (position.column < position.width) {
      F dx[kRows], dy[kRows];
      derivatives.next(y, dx, dy);
      add_products(position, dx, dy, down, groups[group]);
    }
    __syncthreads();
    int const row = y - R + position.r;
    if (row < position.y0 || row >= position.y1 || !position.owns_some()) continue;
    SymmetricMatrix<F> tensors[kRows];
    structure_tensors(position, groups[group], tensors);
    F result[kRows];
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      result[j] =
          scale * (is_harris ? harris(tensors[j], k) : gftt(tensors[j], fast_sqrt(gftt_discriminant(tensors[j]))));
    write_row(work, position, row, result);
  }
}

template <class F>
__global__ void __launch_bounds__(kThreads<F>, kBlocksOfGradients)
    corner_backward(__grid_constant__ Work<F> const work) {
  __shared__ RowGroup<F, 3> products, gradients;
  __shared__ RowGroup<F, 2> back;  // u and v
  BlockPosition const position(work, kReachOfGradients);
  Derivatives<F> derivatives(work, position);
  RunningSums<F> down, down_back;
  F const k = work.arguments.k_of(position.plane), scale = work.arguments.scale_of(position.plane);
  bool const is_harris = work.arguments.kind == CornerKind::harris, sobel = work.arguments.sobel;
  F const derivative_scale = gradient_scale<F>(sobel);
  int const height = position.height, width = position.width, column = position.column, at = int(threadIdx.x) + kPad;
  uint8_t* const pixel = work.result.plane(position.plane) + min(column, width - 1) * work.result.step;
  auto const is_end = [](int i, int n) { return i == 0 || i == n - 1; };
  constexpr int kKept = 2 * R;  // rows of derivatives before the latest four
  F dx[kKept + kRows], dy[kKept + kRows];
  GradientRow<F> above{}, middle{};

  for (int y = position.y0 - kCornerGradientReach; y - kRows - kCornerGradientReach + R < position.y1 - 1; y += kRows) {
    if (column < width) {
#pragma unroll
      for (int i = 0; i < kKept; ++i) dx[i] = dx[i + kRows], dy[i] = dy[i + kRows];
      derivatives.next(y, dx + kKept, dy + kKept);
      add_products(position, dx + kKept, dy + kKept, down, products);
    }
    __syncthreads();
    if (position.x < width) {
      int const row = reflected(y - R + position.r, height);
      SymmetricMatrix<F> tensors[kRows];
      structure_tensors(position, products, tensors);
      F grads[kRows], result[3][kRows];
      read_gradients(work, position, row, grads);
#pragma unroll
      for (int j = 0; j < kRows; ++j) {
        F const factor = (is_end(row, height) ? F(2) : F(1)) * (is_end(position.x + j, width) ? F(2) : F(1));
        F const grad = grads[j] * (scale * factor);
        SymmetricMatrix<F> of_tensor;
        if (is_harris) {
          of_tensor = harris_vjp(tensors[j], k, grad);
        } else {
          F const discriminant = gftt_discriminant(tensors[j]);
          bool const has_root = discriminant > F(1.2e-38);  // the fast root takes smaller ones as 0
          of_tensor = gftt_vjp(tensors[j], has_root ? fast_rsqrt(discriminant) : F(0), grad);
        }
        result[0][j] = of_tensor.xx, result[1][j] = of_tensor.yy, result[2][j] = of_tensor.xy;
      }
      int const first = position.x - position.left;
#pragma unroll
      for (int m = 0; m < 3; ++m) {
        F* const line = gradients.values[position.r][m];
        if (position.x + kRows <= width) {
          write_vector(line, first, result[m]);
        } else {
#pragma unroll
          for (int j = 0; j < kRows; ++j)
            if (position.x + j < width) line[kPad + first + j] = result[m][j];
        }
        if (position.is_near_end<R>(position.x, kRows))
#pragma unroll
          for (int j = 0; j < kRows; ++j)
            if (position.x + j < width)
              position.for_each_outside<R>(Border::reflect, position.x + j, [&](int to) { line[to] = result[m][j]; });
      }
    }
    __syncthreads();
    if (position.x < width) {
      F sums[kRows];
#pragma unroll
      for (int m = 0; m < 3; ++m) {
        sum_across(gradients.values[position.r][m], position.x - position.left, sums);
        write_vector(products.values[position.r][m], position.x - position.left, sums);
      }
    }
    __syncthreads();
    if (column < width) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        int const row = y - 2 * R + r;
        F of_products[3];
#pragma unroll
        for (int m = 0; m < 3; ++m) of_products[m] = down_back.add(m, products.values[r][m][at]);
        F const factor = (is_end(row, height) ? F(0.5) : F(1)) * (is_end(column, width) ? F(0.5) : F(1));
        back.values[r][0][at] = (2 * dx[r] * of_products[0] + dy[r] * of_products[2]) * factor;
        back.values[r][1][at] = (2 * dy[r] * of_products[1] + dx[r] * of_products[2]) * factor;
      }
    }
    __syncthreads();
    if (column < width) {
      F result[kRows];
      bool const at_left = column == 0, at_right = column == width - 1;
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        int const row = y - 2 * R + r - 1;  // of the result
        F const *const u = back.values[r][0] + at, *const v = back.values[r][1] + at;
        GradientRow<F> const below = gradient_row_vjp(at_left ? -u[0] : u[-1], at_right ? -u[0] : u[1],
                                                      at_left ? v[0] : v[-1], v[0], at_right ? v[0] : v[1], sobel);
        result[r] = gradient_vjp(row == 0 ? row_out_of_bounds(middle) : above, middle,
                                 row == height - 1 ? row_out_of_bounds(middle) : below, sobel, derivative_scale);
        above = middle, middle = below;
      }
      if (position.owns(column))
#pragma unroll
        for (int r = 0; r < kRows; ++r) {
          int const row = y - 2 * R + r - 1;
          if (row >= position.y0 && row < position.y1)
            write_pixel(work, pixel + row * work.result.row_stride, result[r]);
        }
    }
  }
}

}  // namespace

template <class T>
int corner_response(Response<T> const& p, CUstream_st* stream) {
  return run(corner_forward<Compute<T>>, work_of(p), kReach, kMoreRows, kBlocks, stream);
}

template <class T>
int corner_response_backward(ResponseBackward<T> const& p, CUstream_st* stream) {
  return run(corner_backward<Compute<T>>, work_of(p), kReachOfGradients, kMoreRowsOfGradients, kBlocksOfGradients,
             stream);
}

KV_INSTANTIATE(corner_response, Response)
KV_INSTANTIATE(corner_response_backward, ResponseBackward)

}  // namespace kv::feature::cuda
