// The exact distance transform on CUDA: a warp scans a row, a thread computes the envelope of a line. Lines of a warp
// are neighbors, so that each step of all of them reads one span of memory.
#include "core/launch.cuh"
#include "distance_exact.h"

namespace kv::contrib::cuda {
namespace {

constexpr int kWarps = 8, kThreads = 64;  // small blocks, because one image has few lines

template <class T>
__global__ void __launch_bounds__(32 * kWarps) scan(__grid_constant__ DistanceScan<T> const p) {
  int64_t const row = int64_t(blockIdx.x) * kWarps + threadIdx.x / 32;
  if (row >= p.rows) return;
  int const lane = threadIdx.x % 32, width = int(p.width);
  T const* const image = p.image + row * p.width;
  int* const squared = p.squared + row * p.width;
  unsigned const up_to_lane = (2u << lane) - 1;
  int last = kNoSource;
  for (int x0 = 0; x0 < width; x0 += 32) {  // distances to the left
    int const x = x0 + lane;
    unsigned const sources = __ballot_sync(~0u, x < width && image[x] == T(1)), before = sources & up_to_lane;
    int const left = before ? x0 + 31 - __clz(int(before)) : last;
    if (x < width) squared[x] = left == kNoSource ? kNoSource : x - left;
    if (sources) last = x0 + 31 - __clz(int(sources));
  }
  int next = kNoSource;
  for (int x0 = (width - 1) / 32 * 32; x0 >= 0; x0 -= 32) {  // and to the right
    int const x = x0 + lane, left = x < width ? squared[x] : kNoSource;
    unsigned const sources = __ballot_sync(~0u, left == 0), after = sources & ~(up_to_lane >> 1);
    int const source = after ? x0 + __ffs(int(after)) - 1 : next;
    int const right = source == kNoSource ? kNoSource : source - x;
    int const nearest = right == kNoSource ? left : left == kNoSource ? right : min(left, right);
    if (x < width) squared[x] = nearest == kNoSource ? kNoSource : nearest * nearest;
    if (sources) next = x0 + __ffs(int(sources)) - 1;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) envelope(__grid_constant__ DistanceEnvelope<T> const p) {
  int64_t const line = int64_t(blockIdx.x) * kThreads + threadIdx.x;
  if (line >= p.outer * p.inner) return;
  int64_t const outer = line / p.inner, at = outer * p.length * p.inner + (line - outer * p.inner);
  int const* __restrict__ const squared = p.squared + at;
  Member* __restrict__ const members = p.members + at;
  lower_envelope<8>(
      int(p.length), [&](int i) { return __ldg(squared + i * p.inner); }, [&](int k) { return members[k * p.inner]; },
      [&](int k, Member m) { members[k * p.inner] = m; },
      [&](int q, int value) { store_distance(p, at + q * p.inner, value); });
}

}  // namespace

template <class T>
int distance_scan(DistanceScan<T> const& p, CUstream_st* stream) {
  scan<T><<<unsigned(ceil_div(p.rows, int64_t(kWarps))), 32 * kWarps, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int distance_envelope(DistanceEnvelope<T> const& p, CUstream_st* stream) {
  envelope<T><<<unsigned(ceil_div(p.outer * p.inner, int64_t(kThreads))), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(distance_scan, DistanceScan)
KV_INSTANTIATE_COMPUTED(distance_envelope, DistanceEnvelope)

}  // namespace kv::contrib::cuda
