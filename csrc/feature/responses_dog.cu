// Differences of two Gaussian blurs on CUDA.
//
// A block traverses its columns downwards, four rows at a time. Along y each thread has one column and adds each new
// row to the running sums of both windows. Along x it has four columns of one of the four rows, so that it loads
// vectors and its four windows read them from registers. It sums both blurs along x and subtracts them.
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int R = kCoarseReach, kCoarsePad = 8, kReach = 8, kMoreRows = 2 * R + 2;
constexpr int kBlocks = 3;  // of a multiprocessor
constexpr int kRows = 4;    // processed together; also the columns of a thread along x

// Four rows in shared memory: M values for each column.
template <class F, int M>
struct RowGroup {
  alignas(16) F values[kRows][M][kBlockColumns<F> + 2 * kCoarsePad];  // column `left` of the block is at kCoarsePad
};

// The position of a thread, and the columns near the ends of the rows.
struct BlockPosition : RowGroupPosition<kRows> {
  using RowGroupPosition<kRows>::RowGroupPosition;
  // Whether the thread writes some of its columns along x.
  __device__ __forceinline__ bool owns_some() const { return x + kRows > first && x < last; }
  // Calls f(index in the block's row) for every position out of bounds within `Reach` that reads column `c`.
  template <int Reach, class F>
  __device__ __forceinline__ void for_each_reader_out_of_bounds(Border border, int c, F f) const {
    for_each_reader(border, c, width, left == 0 ? Reach : 0, Reach, [&](int i) {
      if (i != c && i - left < int(blockDim.x) + kCoarsePad) f(kCoarsePad + i - left);
    });
  }
  template <int Reach>
  __device__ __forceinline__ bool is_near_end(int c, int count) const {
    return c < width && (c <= Reach || c + count + Reach >= width);
  }
};

// Writes those of a thread's columns along x that the block owns.
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

template <class F>
struct BlurWeights {
  F fine[kFineReach + 1], coarse[kCoarseReach + 1];
};

// The sums of a blur along x for kRows elements of `v` from `First` on.
template <int Reach, int First, class F, int N>
__device__ __forceinline__ void blur(F const (&v)[N], F const (&weights)[Reach + 1], F (&sums)[kRows]) {
#pragma unroll
  for (int j = 0; j < kRows; ++j) {
    sums[j] = weights[0] * v[First + j];
#pragma unroll
    for (int d = 1; d <= Reach; ++d) sums[j] += weights[d] * (v[First + j - d] + v[First + j + d]);
  }
}

// The running sums along y of one blur, for the rows that are incomplete; a new row completes the first.
template <int Reach, class F>
struct RunningBlur {
  F sums[2 * R] = {};

  __device__ __forceinline__ F add(F x, F const (&weights)[Reach + 1]) {
    auto const plus = [&](F sum, int t) {
      int const d = t < R ? R - t : t - R;
      return d <= Reach ? sum + weights[min(d, Reach)] * x : sum;
    };
    F const complete = plus(sums[0], 0);
#pragma unroll
    for (int t = 1; t <= 2 * R; ++t) sums[t - 1] = plus(t < 2 * R ? sums[min(t, 2 * R - 1)] : F(0), t);
    return complete;
  }
};

template <class F>
__global__ void __launch_bounds__(kBlockColumns<F>, kBlocks)
    difference(__grid_constant__ Work<F> const work, __grid_constant__ BlurWeights<F> const weights, F end_in,
               F end_out) {
  __shared__ RowGroup<F, 2> groups[2];
  BlockPosition const position(work, kReach);
  int const height = position.height, width = position.width, column = position.column;
  uint8_t const* const pixels = work.x.plane(position.plane) + min(column, width - 1) * work.x.step;
  F const end_in_x = end_factor(column, width, end_in);
  RunningBlur<kFineReach, F> fine;
  RunningBlur<kCoarseReach, F> coarse;
  int group = 0;
  for (int y = position.y0 - R; y - R < position.y1; y += kRows, group ^= 1) {
    if (column < width) {
      F row[kRows];
      dispatch_floating_dtype<F>(work.stored, [&](auto type) {
        using T = decltype(type);
#pragma unroll
        for (int r = 0; r < kRows; ++r) {
          int const at = border_index(Border::reflect, y + r, height);
          row[r] = read(*reinterpret_cast<T const*>(pixels + at * work.x.row_stride)) *
                   (end_in_x * end_factor(at, height, end_in));
        }
      });
      int const at = int(threadIdx.x) + kCoarsePad;
      F values[kRows][2];
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        values[r][0] = fine.add(row[r], weights.fine), values[r][1] = coarse.add(row[r], weights.coarse);
#pragma unroll
        for (int m = 0; m < 2; ++m) groups[group].values[r][m][at] = values[r][m];
      }
      if (position.is_near_end<R>(column, 1))
        position.for_each_reader_out_of_bounds<R>(Border::reflect, column, [&](int to) {
#pragma unroll
          for (int r = 0; r < kRows; ++r)
#pragma unroll
            for (int m = 0; m < 2; ++m) groups[group].values[r][m][to] = values[r][m];
        });
    }
    __syncthreads();
    int const row = y - R + position.r, first = position.x - position.left;
    if (row < position.y0 || row >= position.y1 || !position.owns_some()) continue;
    F const(&lines)[2][kBlockColumns<F> + 2 * kCoarsePad] = groups[group].values[position.r];
    F fine_window[12], coarse_window[20], result[kRows], sums[kRows];
    read_window(lines[1], first, coarse_window);
    blur<kCoarseReach, 8>(coarse_window, weights.coarse, result);
    read_window(lines[0], first + 4, fine_window);
    blur<kFineReach, 4>(fine_window, weights.fine, sums);
    F const end_out_y = end_factor(row, height, end_out);
#pragma unroll
    for (int j = 0; j < kRows; ++j)
      result[j] = (result[j] - sums[j]) * (end_out_y * end_factor(position.x + j, width, end_out));
    write_row(work, position, row, result);
  }
}

}  // namespace

template <class T>
int difference_of_gaussians(DifferenceOfGaussians<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p);
  BlurWeights<F> weights;
  for (int d = 0; d <= kFineReach; ++d) weights.fine[d] = p.fine[d];
  for (int d = 0; d <= kCoarseReach; ++d) weights.coarse[d] = p.coarse[d];
  ColumnGrid const grid(work.x.count(), work.x.height, work.x.width, kBlockColumns<F>, kReach, kMoreRows, kBlocks, 0);
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  difference<F><<<grid.blocks, grid.columns, 0, stream>>>(work, weights, p.transposed ? F(2) : F(1),
                                                          p.transposed ? F(0.5) : F(1));
  return cudaGetLastError();
}

KV_INSTANTIATE(difference_of_gaussians, DifferenceOfGaussians)

}  // namespace kv::feature::cuda
