// A link of the chains of a list on CUDA: a block has neighboring pixels of a result, row by row.
#include "geometry/transform/composed/link_coords_list.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256, kPixels = kLinkPixels / kThreads;

template <class F>
__global__ void __launch_bounds__(kThreads) link_coords(__grid_constant__ LinkCoordsList<F> const p) {
  __shared__ Homography<F> inverse;
  int const b = p.sample_of(int(blockIdx.x)), width = p.width[b], count = p.height[b] * width;
  Link<F> const link = p.link(b);
  if (link.is_matrix()) {
    if (threadIdx.x == 0) inverse = narrowed<F>(link.inverse(0));
    __syncthreads();
  }
  F const* const from = p.from + p.offset(b);
  F* const to = p.to + p.offset(b);
  int const begin = (int(blockIdx.x) - p.first[b]) * kLinkPixels + int(threadIdx.x);
  F u[kPixels], v[kPixels];
#pragma unroll
  for (int k = 0; k < kPixels; ++k) {
    int const at = min(begin + k * kThreads, count - 1), row = at / width;
    u[k] = p.from ? from[at] : F(at - row * width);
    v[k] = p.from ? from[count + at] : F(row);
  }
  follow(link, inverse, 0, u, v, [](F const* plane, int at) { return plane[at]; });
#pragma unroll
  for (int k = 0; k < kPixels; ++k) {
    int const at = begin + k * kThreads;
    if (at >= count) return;
    to[at] = u[k];
    to[count + at] = v[k];
  }
}

}  // namespace

template <class F>
int link_coords_list(LinkCoordsList<F> const& p, CUstream_st* stream) {
  link_coords<F><<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(link_coords_list, LinkCoordsList)

}  // namespace kv::geometry::cuda
