// Thin-plate splines on CUDA. A block takes a chunk of a sample's points, a thread four of them and all centers. One
// block per sample solves for the weights.
#include "core/launch.cuh"
#include "geometry/transform/thin_plate.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32;
constexpr int kEach = kThinPlateChunk / kThreads;  // points of a thread
constexpr int kCenters = 32;                       // whose sums are in shared memory at once

__device__ __forceinline__ double log_of(double x) { return ::log2(x); }
// Of numbers that are at least kMinSquare; of others it is not used.
__device__ __forceinline__ float log_of(float x) {
  float y;
  asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

// A thread's points.
template <class T>
struct Points {
  int64_t b, first;
  T const *centers, *weights, *affine;
  T x[kEach], y[kEach];

  __device__ __forceinline__ Points(ThinPlate<T> const& p, unsigned parts) : b(blockIdx.x / parts) {
    first = int64_t(blockIdx.x - unsigned(b) * parts) * kThinPlateChunk + threadIdx.x;
    centers = p.centers + b * p.center_stride;
    weights = p.weights + b * p.weight_stride;
    affine = p.affine + b * p.affine_stride;
#pragma unroll
    for (int k = 0; k < kEach; ++k) {
      int64_t const i = first + k * kThreads;
      x[k] = y[k] = 0;
      if (i >= p.count) continue;
      if (p.points) {
        x[k] = p.points[b * p.point_stride + 2 * i];
        y[k] = p.points[b * p.point_stride + 2 * i + 1];
      } else {
        unsigned const row = unsigned(i) / unsigned(p.width);
        x[k] = p.pixel(0, unsigned(i) - row * unsigned(p.width));
        y[k] = p.pixel(1, row);
      }
    }
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads) thin_plate_points(__grid_constant__ ThinPlate<T> const p, unsigned parts) {
  Points<T> const points(p, parts);
  T const* const a = points.affine;
  T u[kEach], v[kEach];
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    u[k] = points.x[k] * a[2] + (points.y[k] * a[4] + a[0]);
    v[k] = points.x[k] * a[3] + (points.y[k] * a[5] + a[1]);
  }
#pragma unroll 2
  for (int64_t n = 0; n < 2 * p.center_count; n += 2) {
    T const at_x = points.centers[n], at_y = points.centers[n + 1];
    T const weight_x = points.weights[n], weight_y = points.weights[n + 1];
#pragma unroll
    for (int k = 0; k < kEach; ++k) {
      T const dx = points.x[k] - at_x, dy = points.y[k] - at_y, square = dx * dx + dy * dy;
      T const value = radial_basis<T>(square, log_of(square));
      u[k] += value * weight_x;
      v[k] += value * weight_y;
    }
  }
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    int64_t const i = points.first + k * kThreads;
    if (i >= p.count) continue;
    p.result[p.at(points.b, i, 0)] = u[k];
    p.result[p.at(points.b, i, 1)] = v[k];
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    thin_plate_points_backward(__grid_constant__ ThinPlate<T> const p, unsigned parts) {
  __shared__ T shared_sums[kWarps][4 * kCenters];
  Points<T> const points(p, parts);
  T const* const a = points.affine;
  T* const sums = p.sums + blockIdx.x * (4 * p.center_count + 6);
  int const warp = threadIdx.x / 32, lane = threadIdx.x % 32;
  T u[kEach], v[kEach], grad_x[kEach], grad_y[kEach], affine[6] = {};
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    int64_t const i = points.first + k * kThreads;
    bool const in_bounds = i < p.count;
    u[k] = in_bounds ? p.grad[p.at(points.b, i, 0)] : T(0);
    v[k] = in_bounds ? p.grad[p.at(points.b, i, 1)] : T(0);
    grad_x[k] = u[k] * a[2] + v[k] * a[3];
    grad_y[k] = u[k] * a[4] + v[k] * a[5];
    affine[0] += u[k];
    affine[1] += v[k];
    affine[2] += u[k] * points.x[k];
    affine[3] += v[k] * points.x[k];
    affine[4] += u[k] * points.y[k];
    affine[5] += v[k] * points.y[k];
  }
  // The sums of a warp, by its first thread; of the block, to `to(i)`.
  auto const put = [&](int i, T value) {
    value = warp_reduce(value, Sum());
    if (lane == 0) shared_sums[warp][i] = value;
  };
  auto const add = [&](int count, auto to) {
    __syncthreads();
    if (int(threadIdx.x) < count) {
      T sum = 0;
#pragma unroll
      for (int w = 0; w < kWarps; ++w) sum += shared_sums[w][threadIdx.x];
      sums[to(int(threadIdx.x))] = sum;
    }
    __syncthreads();
  };
#pragma unroll
  for (int i = 0; i < 6; ++i) put(i, affine[i]);
  add(6, [&](int i) { return 4 * p.center_count + i; });
#pragma unroll 1
  for (int64_t first = 0; first < p.center_count; first += kCenters) {
    int const count = int(min(p.center_count - first, int64_t(kCenters)));
#pragma unroll 1
    for (int n = 0; n < count; ++n) {
      int64_t const at = 2 * (first + n);
      T const at_x = points.centers[at], at_y = points.centers[at + 1];
      T const weight_x = points.weights[at], weight_y = points.weights[at + 1];
      T terms[4] = {};
#pragma unroll
      for (int k = 0; k < kEach; ++k) {
        T const dx = points.x[k] - at_x, dy = points.y[k] - at_y, square = dx * dx + dy * dy, log = log_of(square);
        T const value = radial_basis<T>(square, log);
        T const along = (u[k] * weight_x + v[k] * weight_y) * radial_basis_derivative<T>(square, log);
        grad_x[k] += along * dx;
        grad_y[k] += along * dy;
        terms[0] -= along * dx;
        terms[1] -= along * dy;
        terms[2] += value * u[k];
        terms[3] += value * v[k];
      }
#pragma unroll
      for (int i = 0; i < 4; ++i) put(4 * n + i, terms[i]);
    }
    add(4 * count, [&](int i) {
      int const part = i % 4;
      return 2 * (first + i / 4) + part % 2 + part / 2 * 2 * p.center_count;
    });
  }
  if (!p.grad_points) return;
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    int64_t const i = points.first + k * kThreads;
    if (i >= p.count) continue;
    p.grad_points[2 * (points.b * p.count + i)] = grad_x[k];
    p.grad_points[2 * (points.b * p.count + i) + 1] = grad_y[k];
  }
}

// A block adds up 32 sums of a sample; its warps take parts in turn.
template <class T>
__global__ void __launch_bounds__(kThreads) sum_parts(ThinPlateReduction<T> p, unsigned blocks) {
  __shared__ double parts[kWarps][32];
  int64_t const b = blockIdx.x / blocks, width = p.width(), i = int64_t(blockIdx.x % blocks) * 32 + threadIdx.x % 32;
  double sum = 0;
  if (i < width)
    for (int64_t part = threadIdx.x / 32; part < p.parts; part += kWarps)
      sum += p.sums[(b * p.parts + part) * width + i];
  parts[threadIdx.x / 32][threadIdx.x % 32] = sum;
  __syncthreads();
  if (threadIdx.x >= 32 || i >= width) return;
  for (int w = 1; w < kWarps; ++w) sum += parts[w][threadIdx.x];
  p.set(b, i, sum);
}

// Systems that fit are solved in shared memory.
constexpr size_t kShared = 48 << 10;
template <class T>
size_t bytes(ThinPlateWeights<T> const& p) {
  return size_t(p.size() * p.width()) * sizeof(T);
}

template <class T>
__global__ void __launch_bounds__(kThreads) solve(ThinPlateWeights<T> p, bool shared) {
  extern __shared__ double shared_system[];
  T* const system = shared ? shared_system : p.systems + blockIdx.x * p.size() * p.width();
  auto const log = [](T x) { return log_of(x); };
  auto const subtract = [](T* row, int64_t k, int64_t rows, int64_t width) {
    each(ThreadBlock{}, rows, width - k - 1, [&](int64_t i, int64_t j) {
      T* const to = row + (i + 1) * width + k;
      to[1 + j] -= to[0] * row[k + 1 + j];
    });
  };
  solve_thin_plate_weights(p, blockIdx.x, system, ThreadBlock{}, log, subtract);
}

}  // namespace

template <class T>
int thin_plate(ThinPlate<T> const& p, CUstream_st* stream) {
  int64_t const parts = thin_plate_chunks(p.count);
  thin_plate_points<<<unsigned(p.batch * parts), kThreads, 0, stream>>>(p, unsigned(parts));
  return cudaGetLastError();
}

template <class T>
int thin_plate_backward(ThinPlate<T> const& p, CUstream_st* stream) {
  int64_t const parts = thin_plate_chunks(p.count);
  thin_plate_points_backward<<<unsigned(p.batch * parts), kThreads, 0, stream>>>(p, unsigned(parts));
  return cudaGetLastError();
}

template <class T>
int reduce_thin_plate_grads(ThinPlateReduction<T> const& p, CUstream_st* stream) {
  int64_t const blocks = ceil_div(p.width(), 32);
  sum_parts<<<unsigned(p.batch * blocks), kThreads, 0, stream>>>(p, unsigned(blocks));
  return cudaGetLastError();
}

template <class T>
int thin_plate_weights(ThinPlateWeights<T> const& p, CUstream_st* stream) {
  bool const shared = bytes(p) <= kShared;
  solve<<<unsigned(p.batch), kThreads, shared ? bytes(p) : 0, stream>>>(p, shared);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(thin_plate, ThinPlate)
KV_INSTANTIATE_COMPUTED(thin_plate_backward, ThinPlate)
KV_INSTANTIATE_COMPUTED(reduce_thin_plate_grads, ThinPlateReduction)
KV_INSTANTIATE_ONE(thin_plate_weights, ThinPlateWeights, double)

}  // namespace kv::geometry::cuda
