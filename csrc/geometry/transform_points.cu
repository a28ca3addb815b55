// Points transformed by matrices on CUDA.
#include "geometry/transform_points.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;

template <class Map, class T>
__global__ void __launch_bounds__(kThreads)
    map_of(__grid_constant__ TransformPoints<T> const p, int64_t runs_of_matrix, int64_t runs, bool vectorized) {
  using F = Compute<T>;
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= runs) return;
  int64_t const matrix = runs_of_matrix == runs ? 0 : i / runs_of_matrix, start = matrix * p.count;
  int64_t const at = (i - matrix * runs_of_matrix) * kRun - Run::before(start);
  if (at >= p.count) return;
  Run const run(start, at, p.count, vectorized);
  F const* const from = p.matrices + matrix * p.matrix_stride;
  F m[Map::entries], points[kRun][Map::in], y[kRun][Map::out];
#pragma unroll
  for (int i = 0; i < Map::entries; ++i) m[i] = __ldg(from + i);
  load_arguments<Map>(p.points, p.depth, run, points);
#pragma unroll
  for (int i = 0; i < kRun; ++i) Map::value(m, p.distance, points[i], y[i]);
  store_points<Map::out>(p.y, run, y);
}

}  // namespace

template <class T>
int transform_points(TransformPoints<T> const& p, CUstream_st* stream) {
  int64_t const matrices = p.total / p.count, before = matrices > 1 && p.count % kRun != 0 ? kRun - 1 : 0;  // at most
  int64_t const runs_of_matrix = ceil_div(p.count + before, kRun), runs = runs_of_matrix * matrices;
  unsigned const blocks = unsigned(ceil_div(runs, kThreads));
  bool const vectorized = is_vectorizable<T>(p.points, p.depth, p.y);
  with_map(p.map, [&](auto map) {
    map_of<decltype(map)><<<blocks, kThreads, 0, stream>>>(p, runs_of_matrix, runs, vectorized);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(transform_points, TransformPoints)

}  // namespace kv::geometry::cuda
