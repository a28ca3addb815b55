// Gradients of transformed points on CUDA: a block takes a chunk of a matrix's points and sums the matrix's gradient.
#include "geometry/transform_points.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;

template <class Map, class T>
__global__ void __launch_bounds__(kThreads)
    gradients_of(__grid_constant__ TransformPointsBackward<T> const p, int64_t parts, bool vectorized) {
  using F = Compute<T>;
  __shared__ F shared[Map::entries][kThreads / 32];
  int64_t const matrix = blockIdx.x / parts, part = blockIdx.x - matrix * parts, start = matrix * p.count;
  int64_t const begin = part * p.part - Run::before(start), end = part + 1 < parts ? begin + p.part : p.count;
  F const* const from = p.matrices + matrix * p.matrix_stride;
  F m[Map::entries], sums[Map::entries] = {};
#pragma unroll
  for (int i = 0; i < Map::entries; ++i) m[i] = __ldg(from + i);
  for (int64_t at = begin + threadIdx.x * kRun; at < end; at += blockDim.x * kRun) {
    Run const run(start, at, end, vectorized);
    F points[kRun][Map::in], grad[kRun][Map::out], grad_points[kRun][Map::in];
    load_arguments<Map>(p.points, p.depth, run, points);
    load_points<Map::out>(p.grad, run, grad);
#pragma unroll
    for (int i = 0; i < kRun; ++i) {
      F grad_m[Map::entries];
      Map::vjp(m, p.distance, points[i], grad[i], grad_points[i], grad_m);
#pragma unroll
      for (int e = 0; e < Map::entries; ++e)
        if (run.has(i) && p.partial) sums[e] += grad_m[e];
    }
    if constexpr (__is_same(Map, Unproject)) {
      store_points<2>(p.grad_points, run, grad_points);
      store_points<1>(p.grad_depth, run, grad_points, 2);
    } else {
      store_points<Map::in>(p.grad_points, run, grad_points);
    }
  }
  if (!p.partial) return;
#pragma unroll
  for (int e = 0; e < Map::entries; ++e) {
    F const sum = warp_reduce(sums[e], Sum());
    if (threadIdx.x % 32 == 0) shared[e][threadIdx.x / 32] = sum;
  }
  __syncthreads();
  if (threadIdx.x < Map::entries) {
    F sum = 0;
    for (unsigned w = 0; w < blockDim.x / 32; ++w) sum += shared[threadIdx.x][w];
    p.partial[blockIdx.x * Map::entries + threadIdx.x] = sum;
  }
}

// Adds the sums of all chunks, one warp for each entry, always in the same order.
template <class F>
__global__ void add_parts(F const* partial, int64_t parts, int entries, F* sums) {
  int64_t const matrix = blockIdx.x / entries, e = blockIdx.x - matrix * entries;
  F sum = 0;
  for (int64_t i = threadIdx.x; i < parts; i += 32) sum += partial[(matrix * parts + i) * entries + e];
  sum = warp_reduce(sum, Sum());
  if (threadIdx.x == 0) sums[blockIdx.x] = sum;
}

}  // namespace

template <class T>
int transform_points_backward(TransformPointsBackward<T> const& p, CUstream_st* stream) {
  int64_t const parts = p.parts(), target = ceil_div(ceil_div(min(p.part, p.count), kRun), 32) * 32;
  unsigned const threads = unsigned(min(target, int64_t(kThreads))), blocks = unsigned(p.matrices_count * parts);
  bool const vectorized =
      is_vectorizable<T>(p.points, p.depth, p.grad) && is_vectorizable<T>(p.grad_points, p.grad_depth, nullptr);
  with_map(p.map, [&](auto map) {
    using Map = decltype(map);
    gradients_of<Map><<<blocks, threads, 0, stream>>>(p, parts, vectorized);
    if (p.partial)
      add_parts<<<unsigned(p.matrices_count * Map::entries), 32, 0, stream>>>(p.partial, parts, Map::entries,
                                                                              p.grad_matrix);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(transform_points_backward, TransformPointsBackward)

}  // namespace kv::geometry::cuda
