// Points and normals of depth images on CUDA: a thread four neighbouring pixels, 16 bytes an access where it can.
#include "core/launch.cuh"
#include "depth_points.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256, kRun = 4;  // pixels of a thread

// Groups of kRun pixels of a batch of images, one after the other.
struct Runs {
  unsigned across;
  int64_t count;
  Runs(int64_t batch, int64_t height, int64_t width)
      : across(unsigned(ceil_div(width, kRun))), count(batch * height * across) {}
  unsigned blocks() const { return unsigned(ceil_div(count, kThreads)); }
  // The thread's sample, row and first column.
  __device__ __forceinline__ bool place(int64_t height, int64_t& b, int& y, int& x) const {
    int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
    if (i >= count) return false;
    int64_t const row = i / across;
    b = row / height;
    y = int(row - b * height);
    x = int(i - row * across) * kRun;
    return true;
  }
};

// Whether rows can be read in fours.
template <class T>
bool in_fours(Images<T> const& p) {
  int64_t const bytes = sizeof(T) * kRun > 16 ? 16 : sizeof(T) * kRun;
  auto const fits = [&](int64_t stride) { return stride * int64_t(sizeof(T)) % bytes == 0; };
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && fits(p.batch_stride) && fits(p.channel_stride) &&
         fits(p.row_stride) && p.step == 1 && p.width % kRun == 0;
}

// The rim stands beside itself.
template <class T, class F>
__device__ __forceinline__ void load_run(T const* row, int64_t step, int x, int width, bool fours, F (&v)[kRun]) {
  Pack<std::remove_const_t<T>, kRun> pack{};
  if (fours)
    pack = *reinterpret_cast<Pack<T, kRun> const*>(row + x);
  else
    for (int i = 0; i < kRun; ++i) pack.v[i] = row[min(x + i, width - 1) * step];
#pragma unroll
  for (int i = 0; i < kRun; ++i) v[i] = read(pack.v[i]);
}
template <class T, class F>
__device__ __forceinline__ void store_run(T* row, int64_t step, int x, int width, bool fours, F const (&v)[kRun]) {
  if (fours)
    store_pack(row + x, v);
  else
    for (int i = 0; i < kRun; ++i)
      if (x + i < width) row[(x + i) * step] = round_to<T>(v[i]);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    points_of(__grid_constant__ DepthPoints<T> const p, Runs runs, bool read_fours, bool write_fours) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  if (!runs.place(p.y.height, b, y, x)) return;
  int const width = int(p.y.width);
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  F d[kRun], points[3][kRun];
  load_run(p.depth.row(b, 0, y), p.depth.step, x, width, read_fours, d);
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F ray[3];
    rays.at(F(x + i), F(y), ray);
#pragma unroll
    for (int k = 0; k < 3; ++k) points[k][i] = ray[k] * d[i];
  }
#pragma unroll
  for (int k = 0; k < 3; ++k) store_run(p.y.row(b, k, y), p.y.step, x, width, write_fours, points[k]);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    points_backward(__grid_constant__ DepthPointsBackward<T> const p, Runs runs, bool read_fours, bool write_fours) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  if (!runs.place(p.grad.height, b, y, x)) return;
  int const width = int(p.grad.width);
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  F grad[3][kRun], sums[kRun];
#pragma unroll
  for (int k = 0; k < 3; ++k) load_run(p.grad.row(b, k, y), p.grad.step, x, width, read_fours, grad[k]);
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F ray[3];
    rays.at(F(x + i), F(y), ray);
    sums[i] = ray[0] * grad[0][i] + ray[1] * grad[1][i] + ray[2] * grad[2][i];
  }
  store_run(p.to_depth.row(b, 0, y), p.to_depth.step, x, width, write_fours, sums);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    normals_of(__grid_constant__ DepthPoints<T> const p, Runs runs, bool read_fours, bool write_fours) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  if (!runs.place(p.y.height, b, y, x)) return;
  int const width = int(p.y.width), height = int(p.y.height);
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  int const rows[] = {max(y - 1, 0), y, min(y + 1, height - 1)};
  F d[3][kRun + 2], normals[3][kRun];
#pragma unroll
  for (int j = 0; j < 3; ++j) {
    T const* const row = p.depth.row(b, 0, rows[j]);
    F own[kRun];
    load_run(row, p.depth.step, x, width, read_fours, own);
    d[j][0] = read(row[max(x - 1, 0) * p.depth.step]);
    d[j][kRun + 1] = read(row[min(x + kRun, width - 1) * p.depth.step]);
#pragma unroll
    for (int i = 0; i < kRun; ++i) d[j][i + 1] = own[i];
  }
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F normal[3];
    auto const point = [&](int j, int k, F(&to)[3]) {
      rays.at(F(clamp(x + i + k - 1, 0, width - 1)), F(rows[j]), to);
#pragma unroll
      for (int n = 0; n < 3; ++n) to[n] *= d[j][i + k];
    };
    normal_of(point, normal);
#pragma unroll
    for (int k = 0; k < 3; ++k) normals[k][i] = normal[k];
  }
#pragma unroll
  for (int k = 0; k < 3; ++k) store_run(p.y.row(b, k, y), p.y.step, x, width, write_fours, normals[k]);
}

}  // namespace

template <class T>
int depth_points(DepthPoints<T> const& p, CUstream_st* stream) {
  Runs const runs(p.y.batch, p.y.height, p.y.width);
  points_of<T><<<runs.blocks(), kThreads, 0, stream>>>(p, runs, in_fours(p.depth), in_fours(p.y));
  return cudaGetLastError();
}

template <class T>
int depth_points_backward(DepthPointsBackward<T> const& p, CUstream_st* stream) {
  Runs const runs(p.grad.batch, p.grad.height, p.grad.width);
  points_backward<T><<<runs.blocks(), kThreads, 0, stream>>>(p, runs, in_fours(p.grad), in_fours(p.to_depth));
  return cudaGetLastError();
}

template <class T>
int depth_normals(DepthPoints<T> const& p, CUstream_st* stream) {
  Runs const runs(p.y.batch, p.y.height, p.y.width);
  normals_of<T><<<runs.blocks(), kThreads, 0, stream>>>(p, runs, in_fours(p.depth), in_fours(p.y));
  return cudaGetLastError();
}

KV_INSTANTIATE(depth_points, DepthPoints)
KV_INSTANTIATE(depth_points_backward, DepthPointsBackward)
KV_INSTANTIATE(depth_normals, DepthPoints)

}  // namespace kv::cuda
