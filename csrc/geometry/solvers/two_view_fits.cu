// Fits of two views on CUDA: one block for each model. Its threads take correspondences in turns.
#include "core/launch.cuh"
#include "geometry/solvers/two_view_fits.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 128;  // each has up to 49 sums in registers
constexpr unsigned kMany = 1000;

struct Vector {
  static constexpr int kCount = 1;
  using V = double;
  static __device__ __forceinline__ V load(double const* x) { return *x; }
  static __device__ __forceinline__ V root(V x) { return ::sqrt(x); }
  static __device__ __forceinline__ V exp2(V x) { return ::exp2(x); }
  static __device__ __forceinline__ double sum(V x) { return x; }
};

template <class Kind, class T>
__global__ void __launch_bounds__(kThreads) fit_models(__grid_constant__ TwoViewFits<T> const p) {
  two_view::fit_from<Kind, Vector>(p, blockIdx.x, ThreadBlock{});
}

}  // namespace

template <class T>
int two_view_fits(TwoViewFits<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.batch * p.num_models);
  // Of many models each has a warp, which does not wait for others while it fits: 1.03x to 1.13x of RANSAC on batches.
  unsigned const threads = p.count > kThreads && blocks < kMany ? kThreads : 32;
  two_view::dispatch_kind(p.model, [&](auto kind) { fit_models<decltype(kind)><<<blocks, threads, 0, stream>>>(p); });
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(two_view_fits, TwoViewFits, double)

}  // namespace kv::geometry::cuda
