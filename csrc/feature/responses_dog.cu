// Differences of two Gaussian blurs on CUDA.
//
// A block goes down its columns, four rows at a time. A thread has four columns, and the rows of their windows along y
// in registers. Both blurs weight the same sums of two pixels at equal distances. Their rows go to shared memory, from
// where the windows along x read the columns of adjacent threads.
#include "core/with_constant.cuh"
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int R = kCoarseReach, P = kColumns;
constexpr int kRows = 4;    // completed together
constexpr int kReach = 8;   // columns of a block that are incomplete on either side
constexpr int kBlocks = 8;  // of a multiprocessor

// The weights at distances along an axis. In the transpose the first and the last pixel of an axis are multiplied by
// `end_in` before the windows and by `end_out` after them.
template <class F>
struct Blurs {
  F fine[kFineReach + 1], coarse[kCoarseReach + 1];
  bool transposed;
  static constexpr F end_in = 2, end_out = F(0.5);
};

// Rows of both blurs in shared memory. Column `left` of the block is at kReach.
template <class F>
struct RowGroup {
  alignas(16) F fine[kRows][kBlockColumns<F> + 2 * kReach], coarse[kRows][kBlockColumns<F> + 2 * kReach];
};

// The sums of two pixels at distances up to `Reach` from a pixel, itself at distance 0; at(i) is the pixel i further.
template <int Reach, class F, class At>
__device__ __forceinline__ void pairs_around(At at, F (&pairs)[Reach + 1]) {
  pairs[0] = at(0);
#pragma unroll
  for (int d = 1; d <= Reach; ++d) pairs[d] = at(-d) + at(d);
}
template <int N, int M, class F>
__device__ __forceinline__ F weighted_sum(F const (&weights)[N], F const (&pairs)[M]) {
  F sum = weights[0] * pairs[0];
#pragma unroll
  for (int d = 1; d < N; ++d) sum += weights[d] * pairs[d];
  return sum;
}

__device__ __forceinline__ bool is_end(int i, int n) { return i == 0 || i == n - 1; }

// The columns of a thread in a row of shared memory, and the columns out of bounds that reflect them.
template <bool Vectors>
struct ReflectedColumns {
  int const x, width, at, left, right;  // column x + j is reflected to left - j and to right - j
  bool const near_left, near_right;     // some are reflected

  __device__ __forceinline__ explicit ReflectedColumns(ColumnPosition const& p)
      : x(p.x),
        width(p.width),
        at(kReach + p.at),
        left(kReach - p.x),
        right(kReach + 2 * (p.width - 1) - p.x - p.left),
        near_left(p.x <= R),
        near_right(p.x < p.width && p.x + P + R >= p.width && p.width - p.left <= p.columns) {}

  template <class F>
  __device__ __forceinline__ void write(F* row, F const (&v)[P]) const {
    if constexpr (Vectors) {
      if (x < width) *reinterpret_cast<Vector<F, P>*>(row + at) = {v[0], v[1], v[2], v[3]};
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (x + j < width) row[at + j] = v[j];
    }
  }
  // Writes reflected columns from `to` on down. The first and the last column reflect to themselves.
  template <class F>
  __device__ __forceinline__ void write_reflected(F* row, int to, F const (&v)[P]) const {
#pragma unroll
    for (int j = 0; j < P; ++j)
      if (Vectors || x + j < width) row[to - j] = v[j];
  }
};

// The rows of a thread's columns that windows along y read, for groups of `Rows` rows that are completed together. New
// rows take the registers of the oldest ones, so that no register moves.
template <class F, bool Vectors, int Reach, int Rows>
struct RowRing {
  static constexpr int kWindow = Rows + 2 * Reach, kTurns = (kWindow + Rows - 1) / Rows, kSize = kTurns * Rows;
  Columns<F, Vectors> const columns;
  Border const border;
  F const end;  // factor of the first and the last row of the image
  int next, turn = 0;
  F rows[kSize][kColumns];

  // The first group begins with row `y`.
  __device__ __forceinline__ RowRing(Work<F> const& work, ColumnPosition const& position, Border border, F end)
      : columns(work, work.x, position), border(border), end(end), next(position.y0 + Reach + Rows) {
    read<kWindow, 0>(position.y0 - Reach);
  }
  // Calls use(row) for a group, where row(i) is row i of its windows. Reads the rows of the next group if `more`.
  template <class Use>
  __device__ __forceinline__ void advance(bool more, Use use) {
    with_constant<kTurns>(turn, [&](auto turn) {
      constexpr int kFirst = Rows * decltype(turn)::value;
      use([&](int i) -> F(&)[kColumns] { return rows[(kFirst + i) % kSize]; });
      if (more) read<Rows, kFirst + kWindow>(next);
    });
    next += Rows;
    turn = turn + 1 == kTurns ? 0 : turn + 1;
  }

 private:
  // Reads N rows from `y` on, whose places begin at `First`.
  template <int N, int First>
  __device__ __forceinline__ void read(int y) {
    int const height = int(columns.work.x.height);
    auto const values_of = [&](int i) -> F(&)[kColumns] { return rows[(First + i) % kSize]; };
    if (y > 0 && y + N < height) {
      uint8_t const* const at = columns.row(y);
      columns.template read_rows<N>([&](int i) { return at + i * columns.planes.row_stride; }, values_of);
      return;
    }
    auto const row_of = [&](int i) { return border_index(border, y + i, height); };
    columns.template read_rows<N>([&](int i) { return columns.row(row_of(i)); }, values_of);
    if (end != 1)
#pragma unroll
      for (int i = 0; i < N; ++i)
        if (is_end(row_of(i), height))
#pragma unroll
          for (int j = 0; j < kColumns; ++j) values_of(i)[j] *= end;
  }
};

template <class F, bool Vectors>
__global__ void __launch_bounds__(kColumnThreads<F>, kBlocks)
    difference(__grid_constant__ Work<F> const work, __grid_constant__ Blurs<F> const blurs) {
  __shared__ RowGroup<F> groups[2];
  ColumnPosition const position(work, kReach, int(blockDim.x), int(threadIdx.x));
  int const height = position.height, width = position.width, x = position.x, y1 = position.y1;
  Columns<F, Vectors> const results(work, work.result, position);
  ReflectedColumns<Vectors> const reflected(position);
  bool const writes = position.owns_some(), transposed = blurs.transposed;

  RowRing<F, Vectors, R, kRows> ring(work, position, Border::reflect, transposed ? blurs.end_in : F(1));
  uint8_t* out = results.row(position.y0);
  int now = 0;
#pragma unroll 1
  for (int y = position.y0; y < y1; y += kRows, now ^= 1) {
    F fine[kRows][P], coarse[kRows][P];
    ring.advance(y + kRows < y1, [&](auto row) {
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int j = 0; j < P; ++j) {
          F pairs[R + 1];
          pairs_around<R>([&](int i) { return row(r + R + i)[j]; }, pairs);
          fine[r][j] = weighted_sum(blurs.fine, pairs);
          coarse[r][j] = weighted_sum(blurs.coarse, pairs);
        }
    });

    auto const for_each_line = [&](auto f) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) f(groups[now].fine[r], fine[r]), f(groups[now].coarse[r], coarse[r]);
    };
    if (transposed && (reflected.near_left || reflected.near_right))
      for_each_line([&](F*, F(&v)[P]) {
#pragma unroll
        for (int j = 0; j < P; ++j) v[j] *= is_end(x + j, width) ? blurs.end_in : F(1);
      });
    for_each_line([&](F* row, F const(&v)[P]) { reflected.write(row, v); });
    if (reflected.near_left)
      for_each_line([&](F* row, F const(&v)[P]) { reflected.write_reflected(row, reflected.left, v); });
    if (reflected.near_right)
      for_each_line([&](F* row, F const(&v)[P]) { reflected.write_reflected(row, reflected.right, v); });
    __syncthreads();

    if (writes) {
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        F along_fine[P + 2 * 4], along_coarse[P + 2 * kReach], result[P];
        read_window(groups[now].coarse[r], position.at, along_coarse);
        read_window(groups[now].fine[r], position.at + kReach - 4, along_fine);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          F coarse_pairs[kCoarseReach + 1], fine_pairs[kFineReach + 1];
          pairs_around<kCoarseReach>([&](int i) { return along_coarse[kReach + j + i]; }, coarse_pairs);
          pairs_around<kFineReach>([&](int i) { return along_fine[4 + j + i]; }, fine_pairs);
          result[j] = weighted_sum(blurs.coarse, coarse_pairs);
#pragma unroll
          for (int d = 0; d <= kFineReach; ++d) result[j] -= blurs.fine[d] * fine_pairs[d];
        }
        if (transposed)
#pragma unroll
          for (int j = 0; j < P; ++j)
            result[j] *= (is_end(y + r, height) ? blurs.end_out : F(1)) * (is_end(x + j, width) ? blurs.end_out : F(1));
        if (y + r < y1) results.write_at(position, out, result);
        out += work.result.row_stride;
      }
    }
  }
}

}  // namespace

template <class T>
int difference_of_gaussians(DifferenceOfGaussians<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Blurs<F> blurs{{}, {}, p.transposed};
  for (int d = 0; d <= kFineReach; ++d) blurs.fine[d] = p.fine[d];
  for (int d = 0; d <= kCoarseReach; ++d) blurs.coarse[d] = p.coarse[d];
  return run(difference<F, false>, difference<F, kHasVectors<F>>, work_of(p), 1, kReach, R, kBlocks, kRows, stream,
             blurs);
}

KV_INSTANTIATE(difference_of_gaussians, DifferenceOfGaussians)

}  // namespace kv::feature::cuda
