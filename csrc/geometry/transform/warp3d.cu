// Warps of volumes on CUDA: a block takes a run of an output's voxels, a thread one after the other and of each all
// channels. The gradient to the volume is summed by atomics.
#include "geometry/transform/matrix_formula.cuh"
#include "geometry/transform/sampling.cuh"
#include "geometry/transform/warp3d_taps.h"

namespace kv::cuda {
namespace {

template <class T>
__device__ __forceinline__ Homography3<Compute<T>> map_of(Warp3d<T> const& p, int64_t b) {
  return homography3(p.matrices + b * p.matrix_stride, p.use);
}
template <class T>
__device__ __forceinline__ Homography3<Compute<T>> map_of(Warp3dValue<T> const& p, int64_t b) {
  Compute<T> made[16];
  Compute<T> const* matrix = p.matrices + b * p.matrix_stride;
  if (p.formula.by != MatrixBy::given) {
    make_space_matrix(p.formula, b, made);
    matrix = made;
  }
  return homography3(matrix, p.use);
}

// Calls voxel(sample, offset in the output, x, y, z, place, its weight) for the thread's ones.
template <class P, class Voxel>
__device__ __forceinline__ void for_each_voxel(P const& p, Voxel voxel) {
  using F = Compute<decltype(stored_in(p))>;
  __shared__ Homography3<F> shared_map;
  int64_t const b = blockIdx.x / p.parts, part = blockIdx.x - b * p.parts;
  if (threadIdx.x == 0) shared_map = map_of(p, b);
  __syncthreads();
  Homography3<F> const map = shared_map;
  Size3 const& size = p.use.output;
  int64_t const last = min((part + 1) * kVoxelsOfPart, p.output_voxels());
#pragma unroll 1
  for (int64_t at = part * kVoxelsOfPart + threadIdx.x; at < last; at += kThreads) {
    int64_t const row = at / size.width;
    F const x = F(at - row * size.width), y = F(row % size.height), z = F(row / size.height);
    F place[3];
    F const weight = map.at(x, y, z, place);
    voxel(b, at, x, y, z, place, weight);
  }
}

// As many blocks at once as without formulas, whose code would take twice the registers.
template <int K, class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 3)
    value_parts(__grid_constant__ Warp3dValue<T> const p) {
  using F = Compute<T>;
  for_each_voxel(p, [&](int64_t b, int64_t at, F, F, F, F const(&place)[3], F) {
    Taps3<K, F> const taps(p, place);
#pragma unroll 1
    for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
      p.y[c * p.output_voxels() + at] =
          round_to<T>(taps.value(p.x + c * p.source_voxels(), [](T x) { return F(read(x)); }));
  });
}

template <int K, class F>
__global__ void __launch_bounds__(kThreads) transpose_parts(__grid_constant__ Warp3dTranspose<F> const p) {
  for_each_voxel(p, [&](int64_t b, int64_t at, F, F, F, F const(&place)[3], F) {
    Taps3<K, F> const taps(p, place);
#pragma unroll 1
    for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c) {
      F* const plane = p.x + c * p.source_voxels();
      F const g = p.y[c * p.output_voxels() + at];
      taps.for_each([&](int64_t to, int i, int j, int k) {
        F const weight = taps.weight[0][i] * taps.weight[1][j] * taps.weight[2][k];
        if (weight != 0) atomicAdd(plane + to, weight * g);
      });
    }
  });
}

template <class F>
__global__ void __launch_bounds__(kThreads) slope_parts(__grid_constant__ Warp3dSlopes<F> const p) {
  F sums[16] = {};
  if (p.interpolation != Interpolation::nearest)
    for_each_voxel(p, [&](int64_t b, int64_t at, F x, F y, F z, F const(&place)[3], F weight) {
      Taps3<2, F> const taps(p, place);
      F to_place[3] = {};
#pragma unroll 1
      for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
        taps.add_slopes(p.x + c * p.source_voxels(), p.y[c * p.output_voxels() + at], to_place);
      add_to_matrix3(to_place, place, weight, x, y, z, sums);
    });
  add_block(sums, p.sums + int64_t(blockIdx.x) * 16);
}

// A block a sample.
template <class F>
__global__ void matrix_samples(Warp3dMatrix<F> p) {
  int64_t const b = blockIdx.x;
  double* const total = add_parts<16>(p.sums + b * p.parts * 16, p.parts);
  if (threadIdx.x == 0) homography3_vjp(p.matrices + b * p.matrix_stride, p.use, total, p.grad + b * 4 * p.use.rows);
}

// Calls run with the number of taps along an axis, as a type.
template <class Run>
int launch(Interpolation interpolation, Run run) {
  if (interpolation == Interpolation::nearest)
    run(std::integral_constant<int, 1>{});
  else
    run(std::integral_constant<int, 2>{});
  return cudaGetLastError();
}

}  // namespace

template <class T>
int warp3d(Warp3dValue<T> const& p, CUstream_st* stream) {
  return launch(p.interpolation, [&](auto taps) {
    value_parts<taps.value, T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  });
}

template <class T>
int warp3d_transpose(Warp3dTranspose<T> const& p, CUstream_st* stream) {
  size_t const bytes = size_t(p.batch * p.channels * p.source_voxels()) * sizeof(T);
  if (cudaError_t const error = cudaMemsetAsync(p.x, 0, bytes, stream)) return error;
  return launch(p.interpolation, [&](auto taps) {
    transpose_parts<taps.value, T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  });
}

template <class T>
int warp3d_slopes(Warp3dSlopes<T> const& p, CUstream_st* stream) {
  slope_parts<T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int warp3d_matrix(Warp3dMatrix<T> const& p, CUstream_st* stream) {
  matrix_samples<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(warp3d, Warp3dValue)
KV_INSTANTIATE_COMPUTED(warp3d_transpose, Warp3dTranspose)
KV_INSTANTIATE_COMPUTED(warp3d_slopes, Warp3dSlopes)
KV_INSTANTIATE_COMPUTED(warp3d_matrix, Warp3dMatrix)

}  // namespace kv::cuda
