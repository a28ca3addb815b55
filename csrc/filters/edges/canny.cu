// Non-maximum suppression and hysteresis of Canny on CUDA, without synchronization with the host.
#include "canny.h"
#include "core/row_prefetcher.cuh"

namespace kv::filters::cuda {
namespace {

constexpr int kSuppressing = 128;  // threads of a block

// Non-maximum suppression. Each warp goes down a strip with three rows of the image and three rows of squared
// magnitudes in registers, and the next row on its way.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kSuppressing) suppress_strip(CannySuppress<T> p, Strips<> strips) {
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  using Row = Strip<2, Aligned, 4, kSuppressing / 32>;
  Row const strip(x, width, Border::replicate);
  RowCursor<T> rows(p.x, plane, y0 - 2);
  T *magnitudes = p.magnitude.row(plane, y0), *edges = p.edges.row(plane, y0);

  F a[8], b[8], c[8];                      // rows of x
  F above[6], middle[6], below[6];         // squared magnitudes
  F gx[4], gy[4], next_gx[4], next_gy[4];  // gradients of the current row and of the one below
  typename Row::template FetchedRow<T> fetched;
  auto const advance = [&](int y) {  // computes row y of squared magnitudes
#pragma unroll
    for (int i = 0; i < 8; ++i) a[i] = b[i], b[i] = c[i];
#pragma unroll
    for (int i = 0; i < 6; ++i) above[i] = middle[i], middle[i] = below[i];
#pragma unroll
    for (int i = 0; i < 4; ++i) gx[i] = next_gx[i], gy[i] = next_gy[i];
    strip.spread(fetched, c);
    if (y < y1) fetched = strip.fetch(rows.next());
    bool const row_in_bounds = y >= 0 && y < height;
    SobelColumn<F> columns[8];
#pragma unroll
    for (int i = 0; i < 8; ++i) columns[i] = sobel_column(a[i], b[i], c[i]);
#pragma unroll
    for (int i = 0; i < 6; ++i) {
      F u, v;
      sobel_gradients(columns[i], columns[i + 1], columns[i + 2], F(1), u, v);
      bool const in_bounds = row_in_bounds && x + i - 1 >= 0 && x + i - 1 < width;
      below[i] = in_bounds ? u * u + v * v + p.eps : p.eps;
      if (i > 0 && i < 5) next_gx[i - 1] = u, next_gy[i - 1] = v;
    }
  };
#pragma unroll
  for (int i = 0; i < 8; ++i) a[i] = b[i] = c[i] = 0;
#pragma unroll
  for (int i = 0; i < 6; ++i) above[i] = middle[i] = below[i] = 0;
#pragma unroll
  for (int i = 0; i < 4; ++i) next_gx[i] = next_gy[i] = 0;
  strip.load(b, rows.next());
  strip.load(c, rows.next());
  fetched = strip.fetch(rows.next());
  advance(y0 - 1);
  advance(y0);
  for (int y = y0; y < y1; ++y) {
    advance(y + 1);
    F magnitude[4], edge[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      bool const ridge = is_ridge(gx[i], gy[i], above[i], above[i + 1], above[i + 2], middle[i], middle[i + 1],
                                  middle[i + 2], below[i], below[i + 1], below[i + 2], p.eps);
      magnitude[i] = ridge ? sqrt(middle[i + 1]) : F(0);
      edge[i] = (magnitude[i] > p.low ? F(0.5) : F(0)) + (magnitude[i] > p.high ? F(0.5) : F(0));
    }
    strip.store(magnitudes, magnitude);
    strip.store(edges, edge);
    magnitudes += p.magnitude.row_stride;
    edges += p.edges.row_stride;
  }
}

// Hysteresis labels connected edges by union-find: in tiles of 32 x 32 pixels in shared memory, then across the borders
// of tiles. A pixel that is no edge has the label kNone. The label of an edge pixel is its parent: 1 + the index of
// another pixel of the edge, or its own at a root, or 0 where the edge is known to be strong. All strong edges have the
// root 0. The smaller of two roots wins, so the order of threads changes paths but not roots.
constexpr int kSide = 32, kNone = -1;

__device__ __forceinline__ int root(int const volatile* labels, int label) {
  while (label > 0) {
    int const next = labels[label - 1];
    if (next == label) break;
    label = next;
  }
  return label;
}

__device__ __forceinline__ void unite(int* labels, int i, int j) {
  int const volatile* const latest = labels;
  int a = root(labels, latest[i]), b = root(labels, latest[j]);
  while (a != b) {
    if (a < b) {
      int const t = a;
      a = b, b = t;
    }
    int const before = atomicMin(labels + a - 1, b);
    if (before == a) return;  // a was a root and b is its parent now
    a = root(labels, before);
  }
}

// Unites pixel i with its neighbors above; `up` is the row stride. Where the pixel directly above is an edge, its
// neighbors are united with it already. Where an adjacent pixel of the same row is an edge, it unites its own
// neighbors.
template <class IsEdge>
__device__ __forceinline__ void unite_above(int* labels, int i, int up, int x, int width, IsEdge is_edge) {
  bool const left = x > 0, right = x + 1 < width;
  if (is_edge(i - up)) {
    if (!(left && is_edge(i - 1) && is_edge(i - up - 1))) unite(labels, i, i - up);
    return;
  }
  if (left && !is_edge(i - 1) && is_edge(i - up - 1)) unite(labels, i, i - up - 1);
  if (right && !is_edge(i + 1) && is_edge(i - up + 1)) unite(labels, i, i - up + 1);
}

// One block for each tile; a warp takes four of its rows. The pixels of a run start with its first pixel as their
// parent, or 0 if one of them is strong.
template <class T>
__global__ void __launch_bounds__(256) label_tiles(CannyHysteresis<T> p, unsigned across, unsigned down) {
  __shared__ int labels[kSide * kSide];
  int const width = int(p.edges.width), height = int(p.edges.height), lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  unsigned const tile_row = blockIdx.x / across;
  int64_t const plane = tile_row / down;
  int const y0 = int(tile_row % down) * kSide, x = int(blockIdx.x % across) * kSide + lane;
  T const* const edges_at = p.edges.row(plane, y0 + warp) + x;
  Compute<T> edge[4];
#pragma unroll
  for (int k = 0; k < 4; ++k)
    edge[k] = x < width && y0 + warp + 8 * k < height ? read(edges_at[8 * k * p.edges.row_stride]) : Compute<T>(0);
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    unsigned const edges = __ballot_sync(0xffffffffu, edge[k] > 0), strong = __ballot_sync(0xffffffffu, edge[k] == 1);
    unsigned const before = ~edges & ((1u << lane) - 1), after = ~edges & ~((2u << lane) - 1);
    int const first = 32 - __clz(before), last = after ? __ffs(after) - 2 : 31;  // of the run
    unsigned const run = (0xffffffffu >> (31 - last)) & (0xffffffffu << first);
    int const i = (warp + 8 * k) * kSide;
    labels[i + lane] = !(edge[k] > 0) ? kNone : strong & run ? 0 : i + first + 1;
  }
  __syncthreads();
  auto const is_edge = [&](int i) { return labels[i] != kNone; };
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    int const y = warp + 8 * k, i = y * kSide + lane;
    if (y > 0 && edge[k] > 0) unite_above(labels, i, kSide, lane, kSide, is_edge);
  }
  __syncthreads();
  if (x >= width) return;
  int* const to = p.labels + (plane * height + y0 + warp) * width + x;
  int const corner = y0 * width + x - lane;
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    int const row = warp + 8 * k;
    if (y0 + row >= height) return;
    int const label = root(labels, labels[row * kSide + lane]), at = label - 1;
    to[8 * k * int64_t(width)] = label <= 0 ? label : corner + at / kSide * width + at % kSide + 1;
  }
}

// One thread for each pixel in the first row or column of a tile.
template <class T>
__global__ void join_tiles(CannyHysteresis<T> p) {
  unsigned const width = unsigned(p.edges.width), height = unsigned(p.edges.height);
  unsigned const on_rows = (height - 1) / kSide * width, each = on_rows + (width - 1) / kSide * height;
  unsigned const n = blockIdx.x * blockDim.x + threadIdx.x, plane = n / each, k = n - plane * each;
  if (plane >= p.edges.count()) return;
  int* const labels = p.labels + plane * p.edges.height * p.edges.width;
  int const volatile* const latest = labels;
  auto const is_edge = [&](int i) { return latest[i] != kNone; };
  if (k < on_rows) {
    int const x = int(k % width), i = int((k / width + 1) * kSide * width) + x;
    if (is_edge(i)) unite_above(labels, i, int(width), x, int(width), is_edge);
  } else {
    unsigned const y = (k - on_rows) % height;
    int const i = int(y * width + ((k - on_rows) / height + 1) * kSide), up = int(width);
    if (!is_edge(i)) return;
    if (is_edge(i - 1)) return unite(labels, i, i - 1);
    if (y > 0 && is_edge(i - up - 1)) unite(labels, i, i - up - 1);
    if (y + 1 < height && is_edge(i + up - 1)) unite(labels, i, i + up - 1);
  }
}

// Each thread has adjacent pixels, of one plane or several. Labels and results are contiguous.
constexpr int kAtOnce = 4;
template <class T>
__global__ void __launch_bounds__(256) keep_strong(T* results, int const* labels, int64_t plane_size, int64_t size) {
  int64_t const first = (blockIdx.x * int64_t(256) + threadIdx.x) * kAtOnce;
  if (first >= size) return;
  bool const all = first + kAtOnce <= size;
  Vector<int, kAtOnce> own;
  if (all) {
    own = *reinterpret_cast<Vector<int, kAtOnce> const*>(labels + first);
  } else {
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) own.v[i] = first + i < size ? labels[first + i] : kNone;
  }
  if (max(max(own.v[0], own.v[1]), max(own.v[2], own.v[3])) > 0) {
    int64_t const plane = size <= UINT32_MAX ? uint32_t(first) / uint32_t(plane_size) : first / plane_size;
    int64_t start = plane * plane_size;
#pragma unroll
    for (int i = 0; i < kAtOnce; ++i) {
      while (first + i >= start + plane_size) start += plane_size;
      own.v[i] = root(labels + start, own.v[i]);
    }
  }
  Compute<T> result[kAtOnce];
#pragma unroll
  for (int i = 0; i < kAtOnce; ++i) result[i] = own.v[i] == 0 ? 1 : 0;
  if (all) return store_vector(results + first, result);
#pragma unroll
  for (int i = 0; i < kAtOnce; ++i)
    if (first + i < size) results[first + i] = round_to<T>(result[i]);
}

}  // namespace

template <class T>
int canny_suppress(CannySuppress<T> const& p, CUstream_st* stream) {
  // 20 strips fit on a multiprocessor at a time. A strip reads 4 rows more than it completes, and starts slowly.
  int64_t const columns = p.x.count() * ceil_div(p.x.width, 128), resident = 20 * multiprocessors();
  int const rows = strip_height(columns, p.x.height, 7, resident, resident);
  Strips<> const strips(p.x.count(), p.x.height, p.x.width, rows);
  with_alignment<T>(
      is_vectorizable<4>(p.x) && is_vectorizable<4>(p.magnitude) && is_vectorizable<4>(p.edges), [&](auto aligned) {
        suppress_strip<T, aligned.value><<<strips.blocks(kSuppressing / 32), kSuppressing, 0, stream>>>(p, strips);
      });
  return cudaGetLastError();
}

template <class T>
int canny_hysteresis(CannyHysteresis<T> const& p, CUstream_st* stream) {
  int64_t const planes = p.edges.count(), height = p.edges.height, width = p.edges.width;
  unsigned const across = unsigned(ceil_div(width, kSide)), down = unsigned(ceil_div(height, kSide));
  label_tiles<<<unsigned(planes * across * down), 256, 0, stream>>>(p, across, down);
  int64_t const borders = planes * ((height - 1) / kSide * width + (width - 1) / kSide * height);
  if (borders > 0) join_tiles<<<unsigned(ceil_div(borders, 256)), 256, 0, stream>>>(p);
  int64_t const size = planes * height * width;
  keep_strong<<<unsigned(ceil_div(size, 256 * kAtOnce)), 256, 0, stream>>>(p.result.data, p.labels, height * width,
                                                                           size);
  return cudaGetLastError();
}

KV_INSTANTIATE(canny_suppress, CannySuppress)
KV_INSTANTIATE(canny_hysteresis, CannyHysteresis)

}  // namespace kv::filters::cuda
