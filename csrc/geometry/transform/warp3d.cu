// Warps of volumes on CUDA. A block takes a chunk of an output's voxels, a thread one voxel after the other with all
// channels of each. The gradient of the volume is summed by atomics.
#include "geometry/transform/matrix_formula.cuh"
#include "geometry/transform/sampling.cuh"
#include "geometry/transform/warp3d_taps.h"

namespace kv::geometry::cuda {
namespace {

template <class T>
__device__ __forceinline__ Homography3<Compute<T>> map_of(Warp3d<T> const& p, int64_t b) {
  return homography3(p.matrices + b * p.matrix_stride, p.use);
}
template <class T>
__device__ __forceinline__ Homography3<Compute<T>> map_of(Warp3dForward<T> const& p, int64_t b) {
  Compute<T> made[16];
  Compute<T> const* matrix = p.matrices + b * p.matrix_stride;
  if (p.formula.id != WarpFormula::none) {
    make_space_matrix(p.formula, b, made);
    matrix = made;
  }
  return homography3(matrix, p.use);
}

// Calls voxel(sample, offset in the output, x, y, z, coordinates, divisor) for the thread's voxels.
template <class P, class Voxel>
__device__ __forceinline__ void for_each_voxel(P const& p, Voxel voxel) {
  using F = Compute<decltype(stored_in(p))>;
  __shared__ Homography3<F> shared_map;
  int64_t const b = blockIdx.x / p.parts, part = blockIdx.x - b * p.parts;
  if (threadIdx.x == 0) shared_map = map_of(p, b);
  __syncthreads();
  Homography3<F> const map = shared_map;
  Size3 const& size = p.use.output;
  int64_t const last = min((part + 1) * p.part_voxels, p.output_voxels());
#pragma unroll 1
  for (int64_t at = part * p.part_voxels + threadIdx.x; at < last; at += kThreads) {
    int64_t const row = at / size.width;
    F const x = F(at - row * size.width), y = F(row % size.height), z = F(row / size.height);
    F coords[3];
    F const weight = map.apply(x, y, z, coords);
    voxel(b, at, x, y, z, coords, weight);
  }
}

// Limits the registers, so that as many blocks are resident as without formulas, whose code would need twice as many.
template <int K, class T>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 3)
    forward_parts(__grid_constant__ Warp3dForward<T> const p) {
  using F = Compute<T>;
  for_each_voxel(p, [&](int64_t b, int64_t at, F, F, F, F const(&coords)[3], F) {
    TapWindow3<K, F> const taps(p, coords);
#pragma unroll 1
    for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
      p.y[c * p.output_voxels() + at] =
          round_to<T>(taps.value(p.x + c * p.source_voxels(), [](T x) { return F(read(x)); }));
  });
}

template <int K, class F>
__global__ void __launch_bounds__(kThreads) volume_backward_parts(__grid_constant__ Warp3dVolumeBackward<F> const p) {
  for_each_voxel(p, [&](int64_t b, int64_t at, F, F, F, F const(&coords)[3], F) {
    TapWindow3<K, F> const taps(p, coords);
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
__global__ void __launch_bounds__(kThreads) coords_backward_parts(__grid_constant__ Warp3dCoordsBackward<F> const p) {
  F sums[16] = {};
  if (p.interpolation != Interpolation::nearest)
    for_each_voxel(p, [&](int64_t b, int64_t at, F x, F y, F z, F const(&coords)[3], F weight) {
      TapWindow3<2, F> const taps(p, coords);
      F grad_coords[3] = {};
#pragma unroll 1
      for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
        taps.accumulate_coord_grads(p.x + c * p.source_voxels(), p.y[c * p.output_voxels() + at], grad_coords);
      accumulate_matrix_grad3(grad_coords, coords, weight, x, y, z, sums);
    });
  store_block_sums<kThreads>(sums, p.sums + int64_t(blockIdx.x) * 16);
}

// One block per sample.
template <class F>
__global__ void reduce_matrix_grads(Warp3dMatrixBackward<F> p) {
  int64_t const b = blockIdx.x;
  double* const total = sum_rows<kThreads, 16>(p.sums + b * p.parts * 16, p.parts);
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
int warp3d(Warp3dForward<T> const& p, CUstream_st* stream) {
  return launch(p.interpolation, [&](auto taps) {
    forward_parts<taps.value, T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  });
}

template <class T>
int warp3d_volume_backward(Warp3dVolumeBackward<T> const& p, CUstream_st* stream) {
  size_t const bytes = size_t(p.batch * p.channels * p.source_voxels()) * sizeof(T);
  if (cudaError_t const error = cudaMemsetAsync(p.x, 0, bytes, stream)) return error;
  return launch(p.interpolation, [&](auto taps) {
    volume_backward_parts<taps.value, T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  });
}

template <class T>
int warp3d_coords_backward(Warp3dCoordsBackward<T> const& p, CUstream_st* stream) {
  coords_backward_parts<T><<<unsigned(p.batch * p.parts), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int warp3d_matrix_backward(Warp3dMatrixBackward<T> const& p, CUstream_st* stream) {
  reduce_matrix_grads<T><<<unsigned(p.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(warp3d, Warp3dForward)
KV_INSTANTIATE_COMPUTED(warp3d_volume_backward, Warp3dVolumeBackward)
KV_INSTANTIATE_COMPUTED(warp3d_coords_backward, Warp3dCoordsBackward)
KV_INSTANTIATE_COMPUTED(warp3d_matrix_backward, Warp3dMatrixBackward)

}  // namespace kv::geometry::cuda
