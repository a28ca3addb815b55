// Connected components on CUDA by union-find: each pixel gets an earlier neighbor as its parent; parents become roots;
// the trees of adjacent pixels are united; parents become roots again.
#include "connected_components.h"
#include "core/launch.cuh"

namespace kv::contrib::cuda {
namespace {

constexpr int kThreads = 256;

// Until write_labels a label is the index of the pixel's parent among all planes, or -1.
__device__ __forceinline__ int64_t find_root(int64_t const volatile* labels, int64_t i) {
  for (int64_t next = labels[i]; next != i; next = labels[i]) i = next;
  return i;
}

__device__ __forceinline__ void unite(int64_t* labels, int64_t a, int64_t b) {
  while (true) {
    a = find_root(labels, a), b = find_root(labels, b);
    if (a == b) return;
    int64_t const low = min(a, b), high = max(a, b);
    int64_t const before = atomicMin(reinterpret_cast<long long*>(labels + high), static_cast<long long>(low));
    if (before == high) return;  // `high` was a root
    a = low, b = before;
  }
}

struct Pixel {
  int64_t at, plane;
  int y, x;
  bool in_bounds;
  __device__ __forceinline__ Pixel(int64_t planes, int height, int width)
      : at(blockIdx.x * int64_t(kThreads) + threadIdx.x) {
    int64_t const row = at / width;
    plane = row / height, y = int(row - plane * height), x = int(at - row * width), in_bounds = plane < planes;
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads) init_parents(ConnectedComponents<T> const p) {
  int const width = int(p.x.width);
  Pixel const i(p.x.count(), int(p.x.height), width);
  if (!i.in_bounds) return;
  auto const is_foreground = [&](int dy, int dx) {
    return i.y + dy >= 0 && i.x + dx >= 0 && i.x + dx < width && read(p.x.row(i.plane, i.y + dy)[i.x + dx]) == 1;
  };
  int64_t label = -1;
  if (is_foreground(0, 0)) {
    label = i.at;
    if (is_foreground(0, -1)) label = i.at - 1;
    for (int dx = 1; dx >= -1; --dx)
      if (is_foreground(-1, dx)) label = i.at - width + dx;
  }
  p.labels[i.at] = label;
}

__global__ void __launch_bounds__(kThreads) find_roots(int64_t* labels, int64_t count) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < count && labels[i] >= 0) labels[i] = find_root(labels, i);
}

// A pixel has one neighbor as its parent; the others may be in other trees.
__global__ void __launch_bounds__(kThreads) unite_neighbors(int64_t* labels, int64_t planes, int height, int width) {
  Pixel const i(planes, height, width);
  if (!i.in_bounds || labels[i.at] < 0) return;
  auto const is_foreground = [&](int dy, int dx) {
    return i.y + dy >= 0 && i.x + dx >= 0 && i.x + dx < width && labels[i.at + dy * width + dx] >= 0;
  };
  // All neighbors of the pixel above are united with it by other threads. Only where that pixel is background can two
  // trees meet here.
  if (is_foreground(-1, 0)) {
    unite(labels, i.at, i.at - width);
    return;
  }
  if (is_foreground(-1, -1))
    unite(labels, i.at, i.at - width - 1);
  else if (is_foreground(0, -1))
    unite(labels, i.at, i.at - 1);
  if (is_foreground(-1, 1)) unite(labels, i.at, i.at - width + 1);
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
  init_parents<<<blocks, kThreads, 0, stream>>>(p);
  find_roots<<<blocks, kThreads, 0, stream>>>(p.labels, count);
  unite_neighbors<<<blocks, kThreads, 0, stream>>>(p.labels, p.x.count(), height, width);
  find_roots<<<blocks, kThreads, 0, stream>>>(p.labels, count);
  write_labels<<<blocks, kThreads, 0, stream>>>(p.labels, count, pixels);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(connected_components, ConnectedComponents)

}  // namespace kv::contrib::cuda
