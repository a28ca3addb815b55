// Canny's thinning and hysteresis on CUDA, without a word from the host in between.
#include "canny.h"
#include "core/launch.cuh"

namespace kv::cuda {
namespace {

constexpr int kRows = 16;

// Thinning. Each warp walks down a strip with three rows of the image and three rows of squared magnitudes in
// registers.
template <class T, bool Aligned>
__global__ void __launch_bounds__(256) suppress_strip(CannySuppress<T> p, Strips<> strips) {
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  Strip<2, Aligned> const strip(x, width, Border::replicate);
  RowsDown<T> rows(p.x, plane, y0 - 2);
  T *magnitudes = p.magnitude.row(plane, y0), *edges = p.edges.row(plane, y0);

  F a[8], b[8], c[8];                      // rows of x
  F above[6], beside[6], below[6];         // squared magnitudes
  F gx[4], gy[4], next_gx[4], next_gy[4];  // gradients of the rows beside and below
  auto const down = [&](int y) {           // brings in the row y of squared magnitudes
#pragma unroll
    for (int i = 0; i < 8; ++i) a[i] = b[i], b[i] = c[i];
#pragma unroll
    for (int i = 0; i < 6; ++i) above[i] = beside[i], beside[i] = below[i];
#pragma unroll
    for (int i = 0; i < 4; ++i) gx[i] = next_gx[i], gy[i] = next_gy[i];
    strip.load(c, rows.next());
    bool const row_inside = y >= 0 && y < height;
    SobelColumn<F> columns[8];
#pragma unroll
    for (int i = 0; i < 8; ++i) columns[i] = sobel_column(a[i], b[i], c[i]);
#pragma unroll
    for (int i = 0; i < 6; ++i) {
      F u, v;
      sobel_gradients(columns[i], columns[i + 1], columns[i + 2], F(1), u, v);
      bool const inside = row_inside && x + i - 1 >= 0 && x + i - 1 < width;
      below[i] = inside ? u * u + v * v + p.eps : p.eps;
      if (i > 0 && i < 5) next_gx[i - 1] = u, next_gy[i - 1] = v;
    }
  };
#pragma unroll
  for (int i = 0; i < 8; ++i) a[i] = b[i] = c[i] = 0;
#pragma unroll
  for (int i = 0; i < 6; ++i) above[i] = beside[i] = below[i] = 0;
#pragma unroll
  for (int i = 0; i < 4; ++i) next_gx[i] = next_gy[i] = 0;
  strip.load(b, rows.next());
  strip.load(c, rows.next());
  down(y0 - 1);
  down(y0);
  for (int y = y0; y < y1; ++y) {
    down(y + 1);
    F magnitude[4], edge[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      bool const ridge = is_ridge(gx[i], gy[i], above[i], above[i + 1], above[i + 2], beside[i], beside[i + 1],
                                  beside[i + 2], below[i], below[i + 1], below[i + 2], p.eps);
      magnitude[i] = ridge ? sqrt(beside[i + 1]) : F(0);
      edge[i] = (magnitude[i] > p.low ? F(0.5) : F(0)) + (magnitude[i] > p.high ? F(0.5) : F(0));
    }
    strip.store(magnitudes, magnitude);
    strip.store(edges, edge);
    magnitudes += p.magnitude.row_stride;
    edges += p.edges.row_stride;
  }
}

// Hysteresis is labelling: pixels of an edge that hang together get one root by union-find, the lowest index among
// them. label[i] is the index of a pixel nearer to the root, i itself at the root, kNone off the edges, and kStrong at
// a root once a strong pixel was found below it. Which thread comes first changes the trees, not the roots.
constexpr int kNone = -1, kStrong = -2;

__device__ __forceinline__ int find(int const volatile* labels, int i) {
  for (int next = labels[i]; next != i && next >= 0; next = labels[i]) i = next;
  return i;
}

__device__ __forceinline__ void unite(int* labels, int i, int j) {
  while (true) {
    i = find(labels, i);
    j = find(labels, j);
    if (i == j) return;
    if (i < j) {
      int const t = i;
      i = j, j = t;
    }
    int const before = atomicMin(labels + i, j);
    if (before == i) return;  // i was a root and now hangs below j
    i = before;
  }
}

// Calls f(plane's labels, plane, y, x, index, whether x is inside) for 32 pixels of a row a warp.
template <class T, class F>
__device__ __forceinline__ void for_each_pixel(CannyHysteresis<T> const& p, F f) {
  int const height = int(p.edges.height), width = int(p.edges.width);
  unsigned const across = unsigned(width + 31) / 32;
  int64_t const warps = p.edges.rows() * across, all = int64_t(gridDim.x) * (blockDim.x / 32);
  for (int64_t warp = int64_t(blockIdx.x) * (blockDim.x / 32) + threadIdx.x / 32; warp < warps; warp += all) {
    int64_t const row = warp / across, plane = row / height;
    int const x = int(warp - row * across) * 32 + threadIdx.x % 32, y = int(row - plane * height);
    f(p.labels + plane * height * width, plane, y, x, y * width + x, x < width);
  }
}

// Runs of a warp's pixels get their first pixel as root at once.
template <class T>
__global__ void label_runs(CannyHysteresis<T> p) {
  for_each_pixel(p, [&](int* labels, int64_t plane, int y, int x, int i, bool inside) {
    bool const candidate = inside && read(p.edges.row(plane, y)[x]) > 0;
    unsigned const candidates = __ballot_sync(0xffffffffu, candidate);
    int const lane = threadIdx.x % 32;
    unsigned const gaps_before = ~candidates & ((1u << lane) - 1);
    int const first = gaps_before ? 32 - __clz(gaps_before) : 0;
    if (inside) labels[i] = candidate ? i - (lane - first) : kNone;
  });
}

// Joins each pixel with the row above, and runs across the ends of warps. Where the pixel above is an edge, its own
// neighbours are joined with it already.
template <class T>
__global__ void join_rows(CannyHysteresis<T> p) {
  int const width = int(p.edges.width);
  for_each_pixel(p, [&](int* labels, int64_t, int y, int x, int i, bool inside) {
    if (!inside || labels[i] == kNone) return;
    auto const join = [&](int other) {
      if (labels[other] == kNone) return false;
      unite(labels, i, other);
      return true;
    };
    if (x % 32 == 0 && x > 0) join(i - 1);
    if (y == 0 || join(i - width)) return;
    if (x > 0) join(i - width - 1);
    if (x + 1 < width) join(i - width + 1);
  });
}

template <class T>
__global__ void mark_strong(CannyHysteresis<T> p) {
  for_each_pixel(p, [&](int* labels, int64_t plane, int y, int x, int i, bool inside) {
    if (inside && read(p.edges.row(plane, y)[x]) == 1) labels[find(labels, i)] = kStrong;
  });
}

template <class T>
__global__ void keep_marked(CannyHysteresis<T> p) {
  for_each_pixel(p, [&](int* labels, int64_t plane, int y, int x, int i, bool inside) {
    if (!inside) return;
    bool const kept = labels[i] != kNone && labels[find(labels, i)] == kStrong;
    p.kept.row(plane, y)[x] = round_to<T>(kept ? 1 : 0);
  });
}

}  // namespace

template <class T>
int canny_suppress(CannySuppress<T> const& p, CUstream_st* stream) {
  Strips<> const strips(p.x.count(), p.x.height, p.x.width, kRows);
  if (is_strip<4>(p.x) && is_strip<4>(p.magnitude) && is_strip<4>(p.edges))
    suppress_strip<T, true><<<strips.blocks(), 256, 0, stream>>>(p, strips);
  else
    suppress_strip<T, false><<<strips.blocks(), 256, 0, stream>>>(p, strips);
  return cudaGetLastError();
}

template <class T>
int canny_hysteresis(CannyHysteresis<T> const& p, CUstream_st* stream) {
  int64_t const warps = p.edges.rows() * ceil_div(p.edges.width, 32);
  unsigned const blocks = unsigned(min(ceil_div(warps, 8), int64_t(1) << 30));
  label_runs<<<blocks, 256, 0, stream>>>(p);
  join_rows<<<blocks, 256, 0, stream>>>(p);
  mark_strong<<<blocks, 256, 0, stream>>>(p);
  keep_marked<<<blocks, 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(canny_suppress, CannySuppress)
KV_INSTANTIATE(canny_hysteresis, CannyHysteresis)

}  // namespace kv::cuda
