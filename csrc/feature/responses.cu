// Responses of corners on CUDA.
//
// A block traverses its columns downwards, row by row. A thread has four columns. It adds the products of their
// derivatives to the sums of all rows whose windows contain them, in registers, and completes the first of these rows.
// A completed row goes to shared memory, from where the window along x reads the columns of adjacent threads. Rows out
// of bounds are computed again from the rows that they reflect.
//
// The gradient takes two such passes: the structure tensor, then its transpose. Half of a block's warps run the first
// pass. The other half run the second one, which reads the rows that the first one wrote before the last barrier:
//
//   row y      derivatives, window along y of their products
//   row y - 4  window along x, gradient of the response
//   row y - 8  windows along x and y, gradient of the products     (the other warps from here on)
//   row y - 9  gradient of the derivatives along x
//   row y - 10 and along y
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

static_assert(kDerivativeBorder == Border::replicate, "the derivatives below replicate");

constexpr int R = kWindowReach, kTaps = 2 * R + 1, P = kColumns;
constexpr int kReach = 4, kReachOfGradients = 8;          // columns of a block that are incomplete on either side
constexpr int kDelay = R + 1, kDelayOfGradients = 10;     // rows from the derivatives to the result
constexpr int kBlocks = 6, kBlocksOfGradients = 3;        // of a multiprocessor
constexpr int kUnroll = 2;                                // so that registers of rows are renamed, not moved
constexpr int kRowsOfTensors = kCornerGradientReach + 1;  // that the first pass of the gradient takes below a block
constexpr int kAhead = 8;                                 // rows of the first pass before the second one begins
constexpr int kKept = 9;                                  // rows of derivatives that the second pass reads later

// The running sums along y of a thread's columns, for the 2 R rows that are incomplete; a new row completes the first.
template <class F>
struct RunningSums {
  F sums[3][2 * R][P] = {};

  __device__ __forceinline__ void add(int m, F const (&x)[P], F (&complete)[P]) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      complete[j] = sums[m][0][j] + window_weight<F>(0) * x[j];
#pragma unroll
      for (int t = 1; t < kTaps; ++t)
        sums[m][t - 1][j] =
            t < 2 * R ? sums[m][min(t, 2 * R - 1)][j] + window_weight<F>(t) * x[j] : window_weight<F>(t) * x[j];
    }
  }
};

// The window sums along x for the columns of a line from `at` on.
template <class F>
__device__ __forceinline__ void sum_across(F const* line, int at, F (&sums)[P]) {
  F v[P + 2 * kPad];
  read_window(line, at, v);
#pragma unroll
  for (int j = 0; j < P; ++j) {
    sums[j] = window_weight<F>(0) * v[kPad - R + j];
#pragma unroll
    for (int i = 1; i < kTaps; ++i) sums[j] += window_weight<F>(i) * v[kPad - R + j + i];
  }
}

// Computes the derivatives of a thread's columns row by row, not divided by the sum of their weights. Rows continue by
// reflection, so that each row is read once. In reflected rows the derivative along y has the opposite sign.
template <class F, bool Vectors, bool Common>
struct Derivatives {
  Columns<F, Vectors, Common> const columns;
  F above[P + 2] = {}, middle[P + 2] = {};  // the two rows before the next one
  F next[P + 2] = {};                       // a row that was read ahead, without the border

  // The first row is `y`.
  __device__ __forceinline__ Derivatives(Work<F> const& work, ColumnPosition const& position, int y)
      : columns(work, work.x, position) {
    columns.read(row(y - 1), above);
    columns.read(row(y), middle);
    columns.read(row(y + 1), next);
    columns.replicate(above), columns.replicate(middle);
  }
  __device__ __forceinline__ int height() const { return int(columns.work.x.height); }
  __device__ __forceinline__ int row(int y) const { return y >= 0 && y < height() ? y : reflected(y, height()); }

  // The derivatives of row y. Calls are in the order of rows. Reads a row ahead.
  __device__ __forceinline__ void advance(int y, F (&dx)[P], F (&dy)[P]) {
    bool const sobel = Common || columns.work.arguments.sobel;
    F below[P + 2];
#pragma unroll
    for (int i = 0; i < P + 2; ++i) below[i] = next[i];
    columns.replicate(below);
    columns.read(row(y + 2), next);
    auto const differentiate = [&](F const(&a)[P + 2], F const(&b)[P + 2], F const(&c)[P + 2]) {
      GradientColumn<F> column_sums[P + 2];
#pragma unroll
      for (int i = 0; i < P + 2; ++i) column_sums[i] = gradient_column(a[i], b[i], c[i], sobel);
#pragma unroll
      for (int j = 0; j < P; ++j)
        gradient(column_sums[j], column_sums[j + 1], column_sums[j + 2], sobel, F(1), dx[j], dy[j]);
    };
    differentiate(above, middle, below);
    if (y <= 0 || y >= height() - 1) {  // derivatives have the replicate border
      int const at = row(y);
      if (at == 0) differentiate(middle, middle, below);
      if (at == height() - 1) differentiate(above, middle, middle);
      bool const backwards = at > 0 && at < height() - 1 && row(y + 1) < at;
#pragma unroll
      for (int j = 0; j < P; ++j) dy[j] = backwards ? -dy[j] : dy[j];
    }
#pragma unroll
    for (int i = 0; i < P + 2; ++i) above[i] = middle[i], middle[i] = below[i];
  }
};

// The structure tensor in shared memory, or its gradient.
template <class F>
using Tensors = Lines<F, 3>;

template <class F>
__device__ __forceinline__ void write_tensors(Tensors<F>& lines, int at, F const (&v)[3][P]) {
#pragma unroll
  for (int m = 0; m < 3; ++m) write_vector(lines.values[m], at, v[m]);
}

// Adds the products of derivatives to the running sums, and writes the row of sums that they complete.
template <class F>
__device__ __forceinline__ void add_products(int at, F const (&dx)[P], F const (&dy)[P], RunningSums<F>& down,
                                             Tensors<F>& lines) {
  F products[3][P], complete[3][P];
#pragma unroll
  for (int j = 0; j < P; ++j)
    products[0][j] = dx[j] * dx[j], products[1][j] = dy[j] * dy[j], products[2][j] = dx[j] * dy[j];
#pragma unroll
  for (int m = 0; m < 3; ++m) down.add(m, products[m], complete[m]);
  write_tensors(lines, at, complete);
}

// The barriers of `count` rows that only the other pass has.
__device__ __forceinline__ void synchronize_rows(int count) {
#pragma unroll 1
  for (int i = 0; i < count; ++i) synchronize_block();
}

// The factor by which unscaled derivatives change the response.
template <class F>
__device__ __forceinline__ F derivative_factor(bool sobel, bool is_harris) {
  F const square = gradient_scale<F>(sobel) * gradient_scale<F>(sobel);
  return is_harris ? square * square : square;
}

// Common: images of float32 and Sobel filters, as constants.
template <class F, bool Vectors, bool Common>
__global__ void __launch_bounds__(kColumnThreads<F>, kBlocks) corner_forward(__grid_constant__ Work<F> const work) {
  __shared__ Tensors<F> lines[2];
  ColumnPosition const position(work, kReach, int(blockDim.x), int(threadIdx.x));
  Columns<F, Vectors, Common> const columns(work, work.result, position);
  Derivatives<F, Vectors, Common> derivatives(work, position, position.y0 - R);
  ReflectedColumns<F, 3, R> const ends(position);
  RunningSums<F> down;
  bool const is_harris = work.arguments.kind == CornerKind::harris, writes = position.owns_some();
  F const k = work.arguments.k_of(position.plane);
  F const scale =
      work.arguments.scale_of(position.plane) * derivative_factor<F>(Common || work.arguments.sobel, is_harris);
  int now = 0;
#pragma unroll kUnroll
  for (int y = position.y0 - R; y < position.y1 + kDelay; ++y, now ^= 1) {
    // Nothing that changes rows and sums is conditional: branches would move their registers.
    F dx[P], dy[P];
    derivatives.advance(y, dx, dy);
    add_products(position.at, dx, dy, down, lines[now]);
    ends.fill(lines[now ^ 1]);
    int const row = y - kDelay;
    if (row >= position.y0 && writes) {
      F sums[3][P], result[P];
#pragma unroll
      for (int m = 0; m < 3; ++m) sum_across(lines[now ^ 1].values[m], position.at, sums[m]);
#pragma unroll
      for (int j = 0; j < P; ++j) {
        SymmetricMatrix<F> const tensor{sums[0][j], sums[1][j], sums[2][j]};
        result[j] = scale * (is_harris ? harris(tensor, k) : gftt(tensor, fast_sqrt(gftt_discriminant(tensor))));
      }
      columns.write(position, row, result);
    }
    __syncthreads();
  }
}

template <class F, bool Vectors, bool Common>
__global__ void __launch_bounds__(2 * kColumnThreads<F>, kBlocksOfGradients)
    corner_backward(__grid_constant__ Work<F> const work) {
  __shared__ Tensors<F> products[2], gradients[2];
  __shared__ Lines<F, 2> kept[kKept], back[2];  // dx and dy; u and v
  int const threads = int(blockDim.x) / 2;
  bool const is_first_half = int(threadIdx.x) < threads;
  ColumnPosition const position(work, kReachOfGradients, threads, int(threadIdx.x) - (is_first_half ? 0 : threads));
  bool const is_harris = work.arguments.kind == CornerKind::harris, sobel = Common || work.arguments.sobel;
  int const height = position.height, width = position.width, first = position.y0 - kCornerGradientReach;
  ReflectedColumns<F, 3, R> const ends(position);
  int now = 0, slot = 0;

  if (is_first_half) {
    Derivatives<F, Vectors, Common> derivatives(work, position, first);
    Columns<F, Vectors, Common> const grads(work, work.grad, position);
    RunningSums<F> down;
    F const k = work.arguments.k_of(position.plane);
    F const scale = work.arguments.scale_of(position.plane) * derivative_factor<F>(sobel, is_harris);
#pragma unroll kUnroll
    for (int y = first; y < position.y1 + kDelayOfGradients; ++y, now ^= 1, slot = slot + 1 == kKept ? 0 : slot + 1) {
      if (y < position.y1 + kRowsOfTensors) {
        int const row = derivatives.row(y - kDelay);
        F grad[P];
        grads.read(row, grad);
        F dx[P], dy[P];
        derivatives.advance(y, dx, dy);
        add_products(position.at, dx, dy, down, products[now]);
        write_vector(kept[slot].values[0], position.at, dx);
        write_vector(kept[slot].values[1], position.at, dy);
        ends.fill(products[now ^ 1]);
        F sums[3][P], result[3][P];
#pragma unroll
        for (int m = 0; m < 3; ++m) sum_across(products[now ^ 1].values[m], position.at, sums[m]);
        F const row_factor = scale * end_factor(row, height, F(2));
#pragma unroll
        for (int j = 0; j < P; ++j) {
          SymmetricMatrix<F> const tensor{sums[0][j], sums[1][j], sums[2][j]};
          F const g = grad[j] * (row_factor * end_factor(position.x + j, width, F(2)));
          SymmetricMatrix<F> grad_tensor;
          if (is_harris) {
            grad_tensor = harris_vjp(tensor, k, g);
          } else {
            F const discriminant = gftt_discriminant(tensor);
            bool const has_root = discriminant > F(1.2e-38);  // the fast root flushes subnormal numbers to 0
            grad_tensor = gftt_vjp(tensor, has_root ? fast_rsqrt(discriminant) : F(0), g);
          }
          result[0][j] = grad_tensor.xx, result[1][j] = grad_tensor.yy, result[2][j] = grad_tensor.xy;
        }
        write_tensors(gradients[now], position.at, result);
      }
      synchronize_block();
    }
    return;
  }

  synchronize_rows(kAhead);
  now = kAhead % 2, slot = kAhead % kKept;
  Columns<F, Vectors, Common> const columns(work, work.result, position);
  RunningSums<F> down;
  GradientRow<F> above[P] = {}, middle[P] = {};
  F u[P] = {}, v[P] = {};
#pragma unroll kUnroll
  for (int y = first + kAhead; y < position.y1 + kDelayOfGradients;
       ++y, now ^= 1, slot = slot + 1 == kKept ? 0 : slot + 1) {
    ends.fill(gradients[now ^ 1]);
    // The gradient of the derivatives of the previous row. u and v of adjacent threads are in shared memory.
    F const *const u_line = back[now ^ 1].values[0] + kPad + position.at, *const v_line = back[now ^ 1].values[1] +
                                                                                          kPad + position.at;
    F around_u[P + 2], around_v[P + 2], result[P];
    around_u[0] = u_line[-1], around_u[P + 1] = u_line[P], around_v[0] = v_line[-1], around_v[P + 1] = v_line[P];
#pragma unroll
    for (int j = 0; j < P; ++j) around_u[j + 1] = u[j], around_v[j + 1] = v[j];
    if (position.x == 0) around_u[0] = -u[0], around_v[0] = v[0];
#pragma unroll
    for (int j = Vectors ? P - 1 : 0; j < P; ++j)
      if (position.x + j == width - 1) around_u[j + 2] = -u[j], around_v[j + 2] = v[j];
    int const row = y - kDelayOfGradients;
#pragma unroll
    for (int j = 0; j < P; ++j) {
      GradientRow<F> const below =
          gradient_row_vjp(around_u[j], around_u[j + 2], around_v[j], around_v[j + 1], around_v[j + 2], sobel);
      result[j] = gradient_vjp(row == 0 ? row_out_of_bounds(middle[j]) : above[j], middle[j],
                               row == height - 1 ? row_out_of_bounds(middle[j]) : below, sobel, F(1));
      above[j] = middle[j], middle[j] = below;
    }
    if (row >= position.y0 && row < position.y1) columns.write(position, row, result);

    F grad_products[3][P];
#pragma unroll
    for (int m = 0; m < 3; ++m) {
      F sums[P];
      sum_across(gradients[now ^ 1].values[m], position.at, sums);
      down.add(m, sums, grad_products[m]);
    }
    // The ring holds rows y - 8 to y, so row y - 8 is in the slot after that of row y.
    Lines<F, 2> const& derivatives = kept[slot + 1 == kKept ? 0 : slot + 1];
    F dx[P], dy[P];
    read_vector(derivatives.values[0], position.at, dx);
    read_vector(derivatives.values[1], position.at, dy);
    F const row_factor = end_factor(y - kDelay - 1 - R, height, F(0.5));
#pragma unroll
    for (int j = 0; j < P; ++j) {
      F const factor = row_factor * end_factor(position.x + j, width, F(0.5));
      u[j] = (2 * dx[j] * grad_products[0][j] + dy[j] * grad_products[2][j]) * factor;
      v[j] = (2 * dy[j] * grad_products[1][j] + dx[j] * grad_products[2][j]) * factor;
    }
    write_vector(back[now].values[0], position.at, u);
    write_vector(back[now].values[1], position.at, v);
    synchronize_block();
  }
}

}  // namespace

template <class T>
int corner_response(Response<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  constexpr bool kSingle = __is_same(T, float);
  // Special case, H200: 1.00 (gftt_response) to 1.07 (harris_response) times as fast as any derivative.
  bool const common = kSingle && p.arguments.sobel;
  auto* const any = common ? corner_forward<F, false, kSingle> : corner_forward<F, false, false>;
  auto* const vectors = common ? corner_forward<F, kHasVectors<F>, kSingle> : corner_forward<F, kHasVectors<F>, false>;
  return run(any, vectors, work_of(p), 1, kReach, R + kDelay, kBlocks, 1, 0, stream);
}

template <class T>
int corner_response_backward(ResponseBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  constexpr bool kSingle = __is_same(T, float);
  // Special case, H200: 1.00 (gftt_response backward) to 1.20 (unaligned harris_response backward) times as fast as any
  // derivative.
  bool const common = kSingle && p.arguments.sobel;
  auto* const any = common ? corner_backward<F, false, kSingle> : corner_backward<F, false, false>;
  auto* const vectors =
      common ? corner_backward<F, kHasVectors<F>, kSingle> : corner_backward<F, kHasVectors<F>, false>;
  return run(any, vectors, work_of(p), 2, kReachOfGradients, kCornerGradientReach + kDelayOfGradients,
             kBlocksOfGradients, 1, 0, stream);
}

KV_INSTANTIATE(corner_response, Response)
KV_INSTANTIATE(corner_response_backward, ResponseBackward)

}  // namespace kv::feature::cuda
