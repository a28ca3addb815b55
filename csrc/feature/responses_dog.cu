// Differences of two Gaussian blurs on CUDA; responses.cuh says how a block goes through an image. A step along y adds
// each new row to the running sums of both windows, a step along x sums both and subtracts.
#include "responses.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int R = kCoarseReach, kWidePad = 8, kReach = 8, kMoreRows = 2 * R + 2;
constexpr int kBlocks = 3;  // of a multiprocessor

template <class F>
struct BlurWeights {
  F fine[kFineReach + 1], coarse[kCoarseReach + 1];
};

// The sums in the window of a blur around the kRows elements of `v` from `First` on.
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
__global__ void __launch_bounds__(kThreads<F>, kBlocks)
    difference(__grid_constant__ Work<F> const work, __grid_constant__ BlurWeights<F> const weights, F end_in,
               F end_out) {
  __shared__ RowGroup<F, 2, kWidePad> groups[2];
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
      int const at = int(threadIdx.x) + kWidePad;
      F values[kRows][2];
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        values[r][0] = fine.add(row[r], weights.fine), values[r][1] = coarse.add(row[r], weights.coarse);
#pragma unroll
        for (int m = 0; m < 2; ++m) groups[group].values[r][m][at] = values[r][m];
      }
      if (position.is_near_end<R>(column, 1))
        position.for_each_outside<R, kWidePad>(Border::reflect, column, [&](int to) {
#pragma unroll
          for (int r = 0; r < kRows; ++r)
#pragma unroll
            for (int m = 0; m < 2; ++m) groups[group].values[r][m][to] = values[r][m];
        });
    }
    __syncthreads();
    int const row = y - R + position.r, first = position.x - position.left;
    if (row < position.y0 || row >= position.y1 || !position.owns_some()) continue;
    F const(&lines)[2][kThreads<F> + 2 * kWidePad] = groups[group].values[position.r];
    F around[12], wide[20], result[kRows], sums[kRows];
    read_window(lines[1], first, wide);
    blur<kCoarseReach, 8>(wide, weights.coarse, result);
    read_window(lines[0], first + 4, around);
    blur<kFineReach, 4>(around, weights.fine, sums);
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
  Grid const grid(work.x.count(), work.x.height, work.x.width, kThreads<F>, kReach, kMoreRows, kBlocks);
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  difference<F><<<grid.blocks, grid.threads, 0, stream>>>(work, weights, p.transposed ? F(2) : F(1),
                                                          p.transposed ? F(0.5) : F(1));
  return cudaGetLastError();
}

KV_INSTANTIATE(difference_of_gaussians, DifferenceOfGaussians)

}  // namespace kv::feature::cuda
