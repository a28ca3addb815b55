// Mean coordinates on CUDA: one block for a few rows of a plane. Its threads read four pixels at a time, once, and keep
// sums relative to the largest number so far. A second kernel, with a block for each plane, combines the chunks.
#include "geometry/subpix/plane_vectors.cuh"
#include "geometry/subpix/spatial_expectation.h"

namespace kv::geometry::cuda {
namespace {

template <class F>
struct ScaledExp {
  F scale;
  __device__ __forceinline__ F operator()(F x) const {
    if constexpr (sizeof(F) == 4)
      return fast_exp2(x * (scale * F(1.44269504088896340736)));
    else
      return ::exp(x * scale);
  }
};

// The sums over a block's threads; the first thread gets them.
template <class F>
__device__ __forceinline__ ExpectationSums<F> block_reduce(ExpectationSums<F> sums, bool softmax,
                                                           ScaledExp<F> const& exp) {
  __shared__ ExpectationSums<F> warp_sums[kThreads / 32];
  sums = warp_reduce(sums, [softmax, exp](ExpectationSums<F> a, ExpectationSums<F> b) {
    a.add(b, softmax, exp);
    return a;
  });
  if (threadIdx.x % 32 == 0) warp_sums[threadIdx.x / 32] = sums;
  __syncthreads();
  if (threadIdx.x == 0)
    for (int w = 1; w < kThreads / 32; ++w) sums.add(warp_sums[w], softmax, exp);
  return sums;
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    expectation_chunks(__grid_constant__ SpatialExpectation<T> const p, unsigned chunks, bool vectorized) {
  using F = Compute<T>;
  HeatMaps<T> const& maps = p.maps;
  ScaledExp<F> const exp{maps.scale};
  int64_t const plane = blockIdx.x / chunks;
  T const* const from = maps.data + plane * maps.height * maps.width;
  auto sums = ExpectationSums<F>::nothing(maps.softmax);
  for_each_vector<T>(maps, blockIdx.x - plane * chunks, vectorized,
                     [&](auto count, unsigned i, unsigned x, unsigned row) {
                       constexpr int P = decltype(count)::value;
                       Vector<T, P> const vector = *reinterpret_cast<Vector<T, P> const*>(from + i);
                       F v[P], maximum = sums.maximum;
#pragma unroll
                       for (int k = 0; k < P; ++k) v[k] = read(vector.v[k]), maximum = v[k] > maximum ? v[k] : maximum;
                       if (maps.softmax) {
                         sums.rescale(maximum, exp);
#pragma unroll
                         for (int k = 0; k < P; ++k) v[k] = exp(v[k] - maximum);
                       }
                       F const y = maps.along_y.at(F(row));
#pragma unroll
                       for (int k = 0; k < P; ++k)
                         sums.sum += v[k], sums.x += v[k] * maps.along_x.at(F(x + k)), sums.y += v[k] * y;
                     });
  sums = block_reduce(sums, maps.softmax, exp);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sums;
}

template <class F>
__global__ void __launch_bounds__(kThreads) finalize_expectation(ExpectationSums<F> const* partial, unsigned chunks,
                                                                 bool softmax, F scale, F* coords, F* parts) {
  ScaledExp<F> const exp{scale};
  auto sums = ExpectationSums<F>::nothing(softmax);
  for (unsigned i = threadIdx.x; i < chunks; i += kThreads) sums.add(partial[blockIdx.x * chunks + i], softmax, exp);
  sums = block_reduce(sums, softmax, exp);
  if (threadIdx.x == 0) sums.store(coords + 2 * blockIdx.x, parts + 2 * blockIdx.x, softmax);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    expectation_backward(__grid_constant__ SpatialExpectationBackward<T> const p, unsigned chunks, bool vectorized) {
  using F = Compute<T>;
  HeatMaps<T> const& maps = p.maps;
  ScaledExp<F> const exp{maps.scale};
  int64_t const plane = blockIdx.x / chunks, offset = plane * maps.height * maps.width;
  ExpectationGradient<T> const gradient(p, plane);
  for_each_vector<T>(
      maps, blockIdx.x - plane * chunks, vectorized, [&](auto count, unsigned i, unsigned x, unsigned row) {
        constexpr int P = decltype(count)::value;
        Vector<T, P> const vector = *reinterpret_cast<Vector<T, P> const*>(maps.data + offset + i);
        F result[P];
#pragma unroll
        for (int k = 0; k < P; ++k)
          result[k] = gradient.at(read(vector.v[k]), maps.along_x.at(F(x + k)), maps.along_y.at(F(row)), exp);
        store_vector(p.grad_input + offset + i, result);
      });
}

}  // namespace

template <class T>
int spatial_expectation(SpatialExpectation<T> const& p, CUstream_st* stream) {
  HeatMaps<T> const& maps = p.maps;
  unsigned const chunks = unsigned(maps.chunks()), planes = unsigned(maps.planes);
  expectation_chunks<<<planes * chunks, kThreads, 0, stream>>>(p, chunks, is_vectorizable<T>(maps.width, {maps.data}));
  finalize_expectation<<<planes, kThreads, 0, stream>>>(p.partial, chunks, maps.softmax, maps.scale, p.coords, p.parts);
  return cudaGetLastError();
}

template <class T>
int spatial_expectation_backward(SpatialExpectationBackward<T> const& p, CUstream_st* stream) {
  unsigned const chunks = unsigned(p.maps.chunks());
  expectation_backward<<<unsigned(p.maps.planes) * chunks, kThreads, 0, stream>>>(
      p, chunks, is_vectorizable<T>(p.maps.width, {p.maps.data, p.grad_input}));
  return cudaGetLastError();
}

KV_INSTANTIATE(spatial_expectation, SpatialExpectation)
KV_INSTANTIATE(spatial_expectation_backward, SpatialExpectationBackward)

}  // namespace kv::geometry::cuda
