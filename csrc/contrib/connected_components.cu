// Connected regions on CUDA: each pixel leads to the first neighbour before it; leads become roots; regions that only
// touch elsewhere are joined; leads become roots again.
#include "connected_components.h"
#include "core/launch.cuh"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

// While it runs a label is the index of a pixel in all planes, or -1.
__device__ __forceinline__ int64_t find_root(int64_t const volatile* labels, int64_t i) {
  for (int64_t next = labels[i]; next != i; next = labels[i]) i = next;
  return i;
}

__device__ __forceinline__ void join(int64_t* labels, int64_t a, int64_t b) {
  while (true) {
    a = find_root(labels, a), b = find_root(labels, b);
    if (a == b) return;
    int64_t const low = min(a, b), high = max(a, b);
    int64_t const before = atomicMin(reinterpret_cast<long long*>(labels + high), static_cast<long long>(low));
    if (before == high) return;  // it was a root until now
    a = low, b = before;
  }
}

struct Pixel {
  int64_t at, plane;
  int y, x;
  bool there;
  __device__ __forceinline__ Pixel(int64_t planes, int height, int width)
      : at(blockIdx.x * int64_t(kThreads) + threadIdx.x) {
    int64_t const row = at / width;
    plane = row / height, y = int(row - plane * height), x = int(at - row * width), there = plane < planes;
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads) lead(ConnectedComponents<T> const p) {
  int const width = int(p.x.width);
  Pixel const i(p.x.count(), int(p.x.height), width);
  if (!i.there) return;
  auto const inside = [&](int dy, int dx) {
    return i.y + dy >= 0 && i.x + dx >= 0 && i.x + dx < width && read(p.x.row(i.plane, i.y + dy)[i.x + dx]) == 1;
  };
  int64_t label = -1;
  if (inside(0, 0)) {
    label = i.at;
    if (inside(0, -1)) label = i.at - 1;
    for (int dx = 1; dx >= -1; --dx)
      if (inside(-1, dx)) label = i.at - width + dx;
  }
  p.labels[i.at] = label;
}

__global__ void __launch_bounds__(kThreads) find_roots(int64_t* labels, int64_t count) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < count && labels[i] >= 0) labels[i] = find_root(labels, i);
}

// A pixel leads to one neighbour; the others may not have met anywhere else.
__global__ void __launch_bounds__(kThreads) join_neighbours(int64_t* labels, int64_t planes, int height, int width) {
  Pixel const i(planes, height, width);
  if (!i.there || labels[i.at] < 0) return;
  auto const inside = [&](int dy, int dx) {
    return i.y + dy >= 0 && i.x + dx >= 0 && i.x + dx < width && labels[i.at + dy * width + dx] >= 0;
  };
  // What touches the pixel above touches it as well, so only where that is outside two sides can meet here.
  if (inside(-1, 0)) {
    join(labels, i.at, i.at - width);
    return;
  }
  if (inside(-1, -1))
    join(labels, i.at, i.at - width - 1);
  else if (inside(0, -1))
    join(labels, i.at, i.at - 1);
  if (inside(-1, 1)) join(labels, i.at, i.at - width + 1);
}

__global__ void __launch_bounds__(kThreads) write_labels(int64_t* labels, int64_t count, int64_t pixels) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i >= count) return;
  int64_t const label = labels[i];
  labels[i] = label < 0 ? 0 : label % pixels + 1;
}

}  // namespace

template <class T>
int connected_components(ConnectedComponents<T> const& p, CUstream_st* stream) {
  int const height = int(p.x.height), width = int(p.x.width);
  int64_t const pixels = p.x.height * p.x.width, count = p.x.count() * pixels;
  unsigned const blocks = unsigned(ceil_div(count, kThreads));
  lead<<<blocks, kThreads, 0, stream>>>(p);
  find_roots<<<blocks, kThreads, 0, stream>>>(p.labels, count);
  join_neighbours<<<blocks, kThreads, 0, stream>>>(p.labels, p.x.count(), height, width);
  find_roots<<<blocks, kThreads, 0, stream>>>(p.labels, count);
  write_labels<<<blocks, kThreads, 0, stream>>>(p.labels, count, pixels);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(connected_components, ConnectedComponents)

}  // namespace kv::cuda
