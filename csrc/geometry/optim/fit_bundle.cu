// Bundles on CUDA: a warp for each point, a block for each camera, and for the Schur complement a launch for every 32
// columns, in which a block factors these again and updates one tile behind them.
#include "core/launch.cuh"
#include "geometry/optim/fit_bundle.h"

namespace kv::geometry::cuda {
namespace {

using bundles::kTile;

constexpr int kWarp = 32, kCameraThreads = 256, kFactorThreads = 128, kSolveThreads = 512;
constexpr int kStaticBytes = 4096;  // at least the shared memory of reduce_cameras besides its rows

// The threads of a warp, as a group.
struct Warp {
  __device__ __forceinline__ int thread_rank() const { return threadIdx.x % kWarp; }
  __device__ __forceinline__ int num_threads() const { return kWarp; }
  __device__ __forceinline__ void sync() const { __syncwarp(); }
};

template <class T>
__global__ void __launch_bounds__(kMaxThreads) start_problems(__grid_constant__ FitBundle<T> const p) {
  int64_t const at = blockIdx.x * int64_t(kMaxThreads) + threadIdx.x, all = p.num_cameras + p.num_points;
  if (at < p.batch * all) bundles::start(p, at / all, at % all);
}

template <class T>
__global__ void __launch_bounds__(kWarp) linearize_points(__grid_constant__ FitBundle<T> const p) {
  bundles::linearize_point(p, blockIdx.x / p.num_points, blockIdx.x % p.num_points, ThreadBlock{});
}

// Each warp adds to six rows of its own in shared memory, where there is room for several of them.
template <class T>
__global__ void __launch_bounds__(kCameraThreads) reduce_cameras(__grid_constant__ FitBundle<T> const p, int warps) {
  extern __shared__ double rows[];
  __shared__ double products[kCameraThreads / kWarp][18];
  int64_t const b = blockIdx.x / p.num_cameras, c = blockIdx.x % p.num_cameras, width = 6 * (c + 1);
  if (p.is_idle(b)) return;
  double own[27];
  bundles::linearize_camera(p, b, c, own, ThreadBlock{});
  for (int64_t i = threadIdx.x; i < warps * 6 * width; i += blockDim.x) rows[i] = 0;
  __syncthreads();
  int const warp = threadIdx.x / kWarp;
  if (warp < warps)
    bundles::add_couplings(p, b, c, warp, warps, rows + warp * 6 * width, width, products[warp], Warp{});
  __syncthreads();
  for (int64_t entry = threadIdx.x; entry < 6 * width; entry += blockDim.x) {
    int64_t const i = entry / width, k = entry % width, within = k - 6 * c;
    double sum = 0;
    for (int w = 0; w < warps; ++w) sum += rows[w * 6 * width + entry];
    p.row(b, 6 * c + i)[k] = (within >= 0 && within <= i ? own[pose_fits::entry(int(i), int(within))] : 0) - sum;
  }
  if (threadIdx.x < 6) p.row(b, p.size())[6 * c + threadIdx.x] = own[21 + threadIdx.x];
}

// The columns of `panel`. A block has the tile (i, j) of the lower triangle. It factors the tile of the diagonal, D,
// and solves for the tiles i and j of the panel; three warps have a row of one of the tiles in each thread. Then the
// tile is stored, as part of the factor, if it is of the panel, and updated otherwise. The factor is in the upper
// triangle, transposed, where no other block reads, and its tiles of the diagonal are apart.
template <class T>
__global__ void __launch_bounds__(kFactorThreads) factor_panel(__grid_constant__ FitBundle<T> const p, int panel) {
  __shared__ double tiles[3][kTile][kTile + 1], columns[2][kTile], pivots[2];
  int64_t const b = blockIdx.y;
  if (p.is_idle(b)) return;
  int i = 0, j = int(blockIdx.x);
  while (j > i) j -= ++i;
  i += panel, j += panel;
  int const warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp;
  int const tile_rows[] = {panel, i, j}, first = panel * kTile;
  int const pivots_left = p.size() - first < kTile ? int(p.size() - first) : kTile;
  for (int t = 0; t < 3; ++t)
    for (int r = warp; r < kTile; r += kFactorThreads / kWarp)
      tiles[t][r][lane] = p.row(b, tile_rows[t] * kTile + r)[first + lane];
  __syncthreads();
  double a[kTile];
  int const own = warp < 3 ? warp : 0;
#pragma unroll
  for (int k = 0; k < kTile; ++k) a[k] = tiles[own][lane][k];
#pragma unroll
  for (int k = 0; k < kTile; ++k) {
    if (k < pivots_left) {
      if (warp == 0) {
        double const pivot = __shfl_sync(0xffffffffu, a[k], k), inverse = pivot > 0 ? ::rsqrt(pivot) : small::nan();
        a[k] *= inverse;
        columns[k % 2][lane] = a[k];
        if (lane == 0) pivots[k % 2] = inverse;
      }
      __syncthreads();
      if (warp != 0) a[k] *= pivots[k % 2];
#pragma unroll
      for (int m = k + 1; m < kTile; ++m) a[m] -= a[k] * columns[k % 2][m];
    }
  }
  if (i == panel) {
    if (warp == 0)
#pragma unroll
      for (int k = 0; k < kTile; ++k) tiles[0][lane][k] = a[k];
    __syncthreads();
    for (int r = warp; r < kTile; r += kFactorThreads / kWarp)
      p.diagonal[((b * p.pitch + first) + r) * kTile + lane] = tiles[0][r][lane];
  } else if (j == panel) {
    if (warp == 1)
#pragma unroll
      for (int k = 0; k < kTile; ++k) p.row(b, first + k)[i * kTile + lane] = a[k];
  } else {
    if (warp == 1 || warp == 2)
#pragma unroll
      for (int k = 0; k < kTile; ++k) tiles[warp][lane][k] = a[k];
    __syncthreads();
    constexpr int kRows = kTile * kWarp / kFactorThreads;
    double sums[kRows] = {};
    for (int k = 0; k < pivots_left; ++k)
#pragma unroll
      for (int r = 0; r < kRows; ++r) sums[r] += tiles[1][warp * kRows + r][k] * tiles[2][lane][k];
#pragma unroll
    for (int r = 0; r < kRows; ++r) p.row(b, i * kTile + warp * kRows + r)[j * kTile + lane] -= sums[r];
  }
}

// Back substitution, a tile after the other from the last one; a warp has a column of the tile.
template <class T>
__global__ void __launch_bounds__(kSolveThreads) solve_cameras(__grid_constant__ FitBundle<T> const p) {
  extern __shared__ double x[];
  __shared__ double tile[kTile][kTile + 1], rest[kTile];
  int64_t const b = blockIdx.x;
  if (p.is_idle(b)) return;
  int const warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp, size = int(p.size());
  for (int first = (size - 1) / kTile * kTile; first >= 0; first -= kTile) {
    int const width = size - first < kTile ? size - first : kTile;
    bool const has_right_side = size / kTile == first / kTile;  // as a row of the tile of the diagonal
    for (int r = warp; r < kTile; r += kSolveThreads / kWarp)
      tile[r][lane] = p.diagonal[((b * p.pitch + first) + r) * kTile + lane];
    __syncthreads();
    for (int c = warp; c < width; c += kSolveThreads / kWarp) {
      double const* const column = p.row(b, first + c);
      double sum = 0;
      for (int r = first + kTile + lane; r < size; r += kWarp) sum += column[r] * x[r];
      sum = warp_reduce(sum, Sum());
      if (lane == 0) rest[c] = (has_right_side ? tile[size - first][c] : column[size]) - sum;
    }
    __syncthreads();
    if (warp == 0) {
      double y = rest[lane];
      for (int k = width - 1; k >= 0; --k) {
        double const solved = __shfl_sync(0xffffffffu, y, k) / tile[k][k];
        if (lane == k) y = solved;
        if (lane < k) y -= tile[k][lane] * solved;
      }
      if (lane < width) x[first + lane] = y;
    }
    __syncthreads();
  }
  for (int i = threadIdx.x; i < size; i += kSolveThreads)
    p.camera_terms[18 * (b * p.num_cameras + i / 6) + 12 + i % 6] = x[i];
  __syncthreads();
  for (int64_t c = threadIdx.x; c < p.num_cameras; c += kSolveThreads) bundles::move_camera(p, b, c);
}

template <class T>
__global__ void __launch_bounds__(kWarp) evaluate_points(__grid_constant__ FitBundle<T> const p) {
  bundles::evaluate_point(p, blockIdx.x / p.num_points, blockIdx.x % p.num_points, ThreadBlock{});
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) accept_steps(__grid_constant__ FitBundle<T> const p) {
  bundles::accept(p, blockIdx.x, ThreadBlock{});
}

template <class T>
__global__ void __launch_bounds__(kMaxThreads) finish_problems(__grid_constant__ FitBundle<T> const p) {
  int64_t const at = blockIdx.x * int64_t(kMaxThreads) + threadIdx.x, all = p.num_cameras + p.num_points;
  if (at < p.batch * all) bundles::finish(p, at / all, at % all);
}

}  // namespace

template <class T>
int bundle_start(FitBundle<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.batch * (p.num_cameras + p.num_points);
  start_problems<T><<<unsigned(ceil_div(rows, kMaxThreads)), kMaxThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int bundle_points(FitBundle<T> const& p, CUstream_st* stream) {
  linearize_points<T><<<unsigned(p.batch * p.num_points), kWarp, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int bundle_cameras(FitBundle<T> const& p, CUstream_st* stream) {
  int const bytes = int(6 * p.size() * sizeof(double)), left = int(max_shared_bytes()) - kStaticBytes;
  int const warps = clamp(left / bytes, 1, kCameraThreads / kWarp);
  if (int const error =
          cudaFuncSetAttribute(reduce_cameras<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, warps * bytes))
    return error;
  reduce_cameras<T><<<unsigned(p.batch * p.num_cameras), kCameraThreads, warps * bytes, stream>>>(p, warps);
  return cudaGetLastError();
}

template <class T>
int bundle_factor(FitBundle<T> const& p, CUstream_st* stream) {
  int const tiles = int(p.pitch / kTile);
  for (int panel = 0; panel * kTile < p.size(); ++panel) {
    int const left = tiles - panel;
    factor_panel<T><<<dim3(unsigned(left * (left + 1) / 2), unsigned(p.batch)), kFactorThreads, 0, stream>>>(p, panel);
  }
  return cudaGetLastError();
}

template <class T>
int bundle_solve(FitBundle<T> const& p, CUstream_st* stream) {
  solve_cameras<T><<<unsigned(p.batch), kSolveThreads, unsigned(p.size() * sizeof(double)), stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int bundle_evaluate(FitBundle<T> const& p, CUstream_st* stream) {
  evaluate_points<T><<<unsigned(p.batch * p.num_points), kWarp, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int bundle_accept(FitBundle<T> const& p, CUstream_st* stream) {
  accept_steps<T><<<unsigned(p.batch), kMaxThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int bundle_finish(FitBundle<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.batch * (p.num_cameras + p.num_points);
  finish_problems<T><<<unsigned(ceil_div(rows, kMaxThreads)), kMaxThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(bundle_start, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_points, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_cameras, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_factor, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_solve, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_evaluate, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_accept, FitBundle, double)
KV_INSTANTIATE_ONE(bundle_finish, FitBundle, double)

}  // namespace kv::geometry::cuda
