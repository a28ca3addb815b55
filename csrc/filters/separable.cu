// Separable filters on CUDA: what serves any layout, type and size, and the gradient to the weights. The fast kernel is
// in separable_strip.cuh.
#include "separable_strip.cuh"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;
constexpr int kSharedMemory = 200 << 10;  // bytes of a block that we ask for at most

template <class F>
__device__ __forceinline__ void load_weights(Taps<F> const& taps, int64_t sample, F scale, F* weights) {
  for (int t = threadIdx.x; t < taps.size; t += blockDim.x) weights[t] = tap(taps, sample, t);
  __syncthreads();
  F sum = 0;
  if (taps.gaussian)
    for (int t = 0; t < taps.size; ++t) sum += weights[t];
  __syncthreads();
  if (taps.gaussian) scale /= sum;
  for (int t = threadIdx.x; t < taps.size; t += blockDim.x) weights[t] *= scale;
  __syncthreads();
}

// A kernel's dynamic shared memory as an array of F.
template <class F>
__device__ __forceinline__ F* shared_memory() {
  extern __shared__ __align__(16) unsigned char bytes[];
  return reinterpret_cast<F*>(bytes);
}

// --- any layout: one thread walks down one column of elements
// --------------------------------------------------------------------

// The rows within `reach` of the one computed, filtered along x, are kept in shared memory: that of a position at the
// position modulo their number.
template <class T>
__global__ void separable_any(Separable<T> const p, int rows, int reach) {
  using F = Compute<T>;
  F *const kx = shared_memory<F>(), *const ky = kx + p.kx.size, *const ring = ky + p.ky.size;
  int const width = int(p.y.width), height = int(p.y.height), in_width = int(p.x.width), in_height = int(p.x.height);
  int64_t const step = p.y.step, across = (p.y.row_size() + blockDim.x - 1) / blockDim.x;
  int64_t const down = (height + rows - 1) / rows, line = blockIdx.x / across, plane = line / down;
  int const y0 = int(line - plane * down) * rows, y1 = min(y0 + rows, height);
  load_weights(p.kx, plane / p.planes, F(1), kx);
  load_weights(p.ky, plane / p.planes, p.alpha, ky);

  int64_t const e = (blockIdx.x - line * across) * blockDim.x + threadIdx.x;
  if (e >= p.y.row_size()) return;
  int const column = int(e / step);
  int64_t const channel = e - column * step;
  int const kept = 2 * reach + 1;
  auto const at = [&](int position) -> F& { return ring[(position + kept) % kept * blockDim.x + threadIdx.x]; };
  for (int position = y0 - reach; position < y1 + reach; ++position) {
    F along_x = 0;
    int const inside = border_index(p.border, position, in_height);
    if (inside >= 0) {
      T const* const row = p.x.row(plane, inside) + channel;
      for_each_position(p.fold, column, width, p.kx.front(), p.kx.back(), [&](int q) {
        int const left = q - p.kx.before;
        if (left >= 0 && left + p.kx.size <= in_width) {
          T const* const first = row + left * step;
#pragma unroll 8
          for (int t = 0; t < p.kx.size; ++t) along_x += kx[t] * read(first[t * step]);
          return;
        }
#pragma unroll 1
        for (int t = 0; t < p.kx.size; ++t) {
          int const x = border_index(p.border, left + t, in_width);
          if (x >= 0) along_x += kx[t] * read(row[x * step]);
        }
      });
    }
    at(position) = along_x;
    int const y = position - reach;
    if (y < y0) continue;
    F sum = 0;
    for_each_position(p.fold, y, height, p.ky.front(), p.ky.back(), [&](int q) {
      // Of the rows that are kept, first those up to the end of the ring, then those from its beginning.
      int const top = q - p.ky.before, first = max(top, y - reach), last = min(top + p.ky.size, y + reach + 1);
      int t = first - top;
      for (int from = first; from < last;) {
        F const* slot = &at(from);
        int const end = t + min(last - from, kept - (from + kept) % kept);
        from += end - t;
#pragma unroll 8
        for (; t < end; ++t, slot += blockDim.x) sum += ky[t] * *slot;
      }
    });
    if (p.beta != 0) sum += p.beta * read(p.x.row(plane, y)[e]);
    p.y.row(plane, y)[e] = round_to<T>(sum);
  }
}

template <class T>
int launch_any(Separable<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int const reach = max(p.ky.before, p.ky.size - 1 - p.ky.before);
  auto const bytes = [&](int threads) { return sizeof(F) * (p.kx.size + p.ky.size + (2 * reach + 1) * threads); };
  int threads = kThreads;
  while (threads > 32 && bytes(threads) > kSharedMemory) threads /= 2;
  if (int error = cudaFuncSetAttribute(separable_any<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes(threads)))
    return error;
  int64_t const lines = p.y.count() * ceil_div(p.y.row_size(), threads);
  int const rows = rows_of_strips(lines, p.y.height, max(p.ky.size, 8), 1024, 1024);
  int64_t const blocks = lines * ceil_div(p.y.height, rows);
  separable_any<<<unsigned(blocks), threads, bytes(threads), stream>>>(p, rows, reach);
  return cudaGetLastError();
}

// --- the gradient to the weights
// ------------------------------------------------------------------------------------------

static_assert(kWeightsTileWidth == kThreads);

// A block walks down the positions that its tile reads. With g 0 outside of the tile and gv(q, c) the sum over i of
// ky[i] g(q + before_y - i, c),
//
//   dkx[j] = sum over q, c of gv(q, c) x(q, c - before_x + j)      dky[i] = sum over q, c of g(q + before_y - i, c)
//   h(q, c)
//
// so each position needs one row of x, shared for its neighbours, and of g the last rows, each thread its own column.
// The sums belong to warps, a weight each, their terms to its threads.
template <class T>
__global__ void __launch_bounds__(kThreads) weights_of_tiles(SeparableWeights<T> const p) {
  using F = Compute<T>;
  constexpr int kStride = kThreads + 1;  // of the rows of g: no two of a column in one bank
  int const taps_x = p.kx.size, taps_y = p.ky.size, taps = taps_x + taps_y, thread = threadIdx.x, lane = thread % 32;
  F *const kx = shared_memory<F>(), *const ky = kx + taps_x, *const x = ky + taps_y, *const h = x + kThreads + taps_x;
  F *const gv = h + kThreads, *const g = gv + kThreads, *const sums = g + taps_y * kStride;
  int64_t const tile = blockIdx.x, across = p.across(), line = tile / across, plane = line / p.down();
  int64_t const x0 = (tile - line * across) * kThreads, column = x0 + thread;
  int const y0 = int((line - plane * p.down()) * p.tile_height), y1 = int(min(y0 + p.tile_height, p.grad.height));
  bool const inside = column < p.grad.width;
  load_weights(p.kx, plane / p.planes, F(1), kx);
  load_weights(p.ky, plane / p.planes, F(1), ky);
  for (int i = thread; i < 32 * taps; i += kThreads) sums[i] = 0;
  for (int i = 0; i < taps_y; ++i) g[i * kStride + thread] = 0;

  int newest = 0;  // where row q + before_y of g is kept; those above it precede it
  auto const row_of_g = [&](int i) { return g + (newest >= i ? newest - i : newest - i + taps_y) * kStride; };
  for (int q = y0 - p.ky.before; q < y1 - p.ky.before + taps_y - 1; ++q) {
    newest = newest + 1 < taps_y ? newest + 1 : 0;
    int const y = q + p.ky.before;
    int64_t const source = border_index(p.border, int64_t(q), p.x.height);
    g[newest * kStride + thread] = y < y1 && inside ? read(p.grad.row(plane, y)[column]) : F(0);
    for (int i = thread; i < kThreads + taps_x - 1; i += kThreads) {
      int64_t const at = border_index(p.border, x0 - p.kx.before + i, p.x.width);
      x[i] = source >= 0 && at >= 0 ? read(p.x.row(plane, source)[at]) : F(0);
    }
    __syncthreads();
    F along_x = 0, along_y = 0;
    for (int j = 0; j < taps_x; ++j) along_x += kx[j] * x[thread + j];
    for (int i = 0; i < taps_y; ++i) along_y += ky[i] * row_of_g(i)[thread];
    h[thread] = inside ? along_x : F(0);
    gv[thread] = along_y;
    __syncthreads();
    for (int t = thread / 32; t < taps; t += kThreads / 32) {
      F const* const a = t < taps_x ? gv : h;
      F const* const b = t < taps_x ? x + t : row_of_g(t - taps_x);
      F sum = 0;
      for (int i = lane; i < kThreads; i += 32) sum += a[i] * b[i];
      sums[32 * t + lane] += sum;
    }
    __syncthreads();
  }
  for (int t = thread / 32; t < taps; t += kThreads / 32) {
    F const sum = warp_sum(sums[32 * t + lane]);
    if (lane == 0) p.sums[tile * taps + t] = sum;
  }
}

}  // namespace

template <class T>
int separable(Separable<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    bool const symmetric = p.kx.gaussian && p.ky.gaussian;
    if (has_strips(p.x, p.ky.size, p.kx.size)) {
      if (p.fold == Border::constant) return separable_strips(p, 1, stream);
      if constexpr (sizeof(T) > 1)
        return p.fold == Border::reflect && symmetric ? separable_mirrors(p, 1, stream) : separable_folds(p, stream);
    }
  }
  return launch_any(p, stream);
}

template <class T>
int separable_weights(SeparableWeights<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int const taps = p.kx.size + p.ky.size;
  size_t const bytes = sizeof(F) * (taps + 3 * kThreads + p.kx.size + p.ky.size * (kThreads + 1) + 32 * taps);
  if (int error = cudaFuncSetAttribute(weights_of_tiles<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  unsigned const tiles = unsigned(p.grad.count() * p.down() * p.across());
  weights_of_tiles<<<tiles, kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(separable, Separable)
KV_INSTANTIATE(separable_weights, SeparableWeights)

}  // namespace kv::cuda
