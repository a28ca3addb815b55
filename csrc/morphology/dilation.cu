// Dilation and erosion on CUDA. What the offsets are is known on the device only: each block looks whether its window
// is flat. Flat ones of 3 x 3 are walked down in registers, larger ones go through shared memory in steps of 1, 2, 4
// ... pixels; for others, and for channels-last images, a thread takes the taps of one element.
#include "core/launch.cuh"
#include "dilation.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

// An element of a row, as kernels with a thread for each count them.
struct Element {
  int64_t plane, row, at;
  int column;
  bool there;
  template <class T>
  __device__ __forceinline__ Element(Planes<T> const& p, int64_t i) {
    int64_t const size = p.row_size(), line = i / size;
    there = line < p.rows();
    plane = line / p.height, row = line - plane * p.height, at = i - line * size;
    column = int(at / p.step);
  }
};

template <class F>
__device__ __forceinline__ F minus_infinity() {
  return -F(__int_as_float(0x7f800000));
}

// Calls f(offset, value) for the members of the window of an element, with values as they are compared.
template <class T, class Call>
__device__ __forceinline__ void for_each_tap(Planes<T const> const& x, Offsets<Compute<T>> const& window,
                                             int64_t planes, Element const& e, Call f) {
  using F = Compute<T>;
  F const* const offsets = window.data + e.plane / planes * window.stride;
  F const sign = window.erode ? F(-1) : F(1);
  for (int i = 0; i < window.height; ++i) {
    int64_t const y = e.row + i - window.top;
    bool const inside = y >= 0 && y < x.height;
    T const* const row = x.row(e.plane, inside ? y : 0) + e.at;
    for (int j = 0; j < window.width; ++j) {
      F const offset = offsets[i * window.width + j];
      if (offset == minus_infinity<F>()) continue;
      int const shift = j - window.left;
      bool const in_row = inside && e.column + shift >= 0 && e.column + shift < x.width;
      f(offset, (in_row ? read(row[shift * x.step]) : window.value) * sign + offset);
    }
  }
}

template <class T>
__device__ __forceinline__ void dilate(Dilation<T> const& p, Element const& e) {
  using F = Compute<T>;
  F most = minus_infinity<F>();
  for_each_tap<T>(p.x, p.window, p.planes, e, [&](F, F value) { most = larger(most, value); });
  p.y.row(e.plane, e.row)[e.at] = round_to<T>(p.window.erode ? -most : most);
}

template <class T>
__global__ void __launch_bounds__(kThreads) dilation_any(Dilation<T> const p) {
  Element const e(p.y, blockIdx.x * int64_t(kThreads) + threadIdx.x);
  if (e.there) dilate(p, e);
}

// --- flat 3 x 3 windows, geodesic
// --------------------------------------------------------------------------------------------------------------------

constexpr int kRows = 8;  // of a strip

// A replicated pixel is in the window already, so it stands for what lies outside of the image.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads) dilation_3x3(Dilation<T> const p, Strips<kPixels<T>> const strips) {
  constexpr int P = kPixels<T>;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));
  F const* const offsets = p.window.data + plane / p.planes * p.window.stride;
  bool flat = true;
  for (int i = 0; i < 9; ++i) flat = flat && offsets[i] == 0;
  if (!flat) {
    for (int64_t y = y0; y < y1; ++y)
      for (int j = 0; j < P && x + j < p.x.width; ++j)
        dilate(p, Element(p.y, (plane * p.y.height + y) * p.y.width + x + j));
    return;
  }
  F const sign = p.window.erode ? F(-1) : F(1);
  Strip<1, Aligned, P> const strip(x, int(p.x.width), Border::replicate);
  RowsDown<T> rows(p.x, plane, y0 - 1);
  T* out = p.y.row(plane, y0);
  F above[P], middle[P];  // of a row, the maxima of three along x
  auto const next = [&](F(&most)[P]) {
    F v[P + 2];
    strip.load(v, rows.next());
#pragma unroll
    for (int j = 0; j < P; ++j) most[j] = larger(larger(v[j] * sign, v[j + 1] * sign), v[j + 2] * sign);
  };
  next(above);
  next(middle);
#pragma unroll 2
  for (int y = y0; y < y1; ++y) {
    F below[P], result[P];
    next(below);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      result[j] = larger(larger(above[j], middle[j]), below[j]) * sign;
      above[j] = middle[j], middle[j] = below[j];
    }
    strip.store(out, result);
    out += p.y.row_stride;
  }
}

// --- larger flat windows: a block makes a tile
// --------------------------------------------------------------------------------------------------------------------

constexpr int kTileWidth = 64, kTileHeight = 32, kLargestTile = 64;  // of a window

// The maxima of `window` elements from each on, `step` apart, for the first `rows` x `columns` elements of a tile,
// whose rows are `stride` apart: in `from`, which it leaves to `spare`.
template <class F>
__device__ __forceinline__ void maxima(F*& from, F*& spare, int window, int step, int rows, int columns, int stride,
                                       bool along_y) {
  int reach = 1;
  auto const combine = [&](int distance, int more) {  // `more` elements than are wanted in the end
    int const wide = columns + (along_y ? 0 : more), tall = rows + (along_y ? more : 0);
    for (int i = threadIdx.x; i < wide * tall; i += kThreads) {
      int const y = i / wide, at = y * stride + i - y * wide;
      spare[at] = larger(from[at], from[at + distance * step]);
    }
    __syncthreads();
    F* const done = spare;
    spare = from, from = done;
  };
  for (; 2 * reach <= window; reach *= 2) combine(reach, window - 2 * reach);
  if (reach < window) combine(window - reach, 0);
}

template <class T>
__global__ void __launch_bounds__(kThreads) dilation_tile(Dilation<T> const p, int across, int down) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char bytes[];
  Offsets<F> const& window = p.window;
  int const height = int(p.y.height), width = int(p.y.width), stride = kTileWidth + window.width - 1;
  int64_t const line = blockIdx.x / across, plane = line / down;
  int const x0 = int(blockIdx.x - line * across) * kTileWidth, y0 = int(line - plane * down) * kTileHeight;
  int const rows = min(kTileHeight, height - y0), columns = min(kTileWidth, width - x0);

  F const* const offsets = window.data + plane / p.planes * window.stride;
  bool flat = true;
  for (int i = threadIdx.x; i < window.height * window.width; i += kThreads) flat = flat && offsets[i] == 0;
  if (!__syncthreads_and(flat)) {
    for (int i = threadIdx.x; i < rows * columns; i += kThreads) {
      int const y = i / columns;
      dilate(p, Element(p.y, (plane * height + y0 + y) * width + x0 + i - y * columns));
    }
    return;
  }
  F const sign = window.erode ? F(-1) : F(1);
  F* tile = reinterpret_cast<F*>(bytes);
  F* spare = tile + stride * (kTileHeight + window.height - 1);
  for (int i = threadIdx.x; i < stride * (rows + window.height - 1); i += kThreads) {
    int const r = i / stride, y = y0 - window.top + r, x = x0 - window.left + i - r * stride;
    bool const inside = y >= 0 && y < height && x >= 0 && x < width;
    tile[i] = (inside ? read(p.x.row(plane, y)[x]) : window.value) * sign;
  }
  __syncthreads();
  maxima(tile, spare, window.width, 1, rows + window.height - 1, columns, stride, false);
  maxima(tile, spare, window.height, stride, rows, columns, stride, true);
  for (int i = threadIdx.x; i < rows * columns; i += kThreads) {
    int const y = i / columns, x = i - y * columns;
    p.y.row(plane, y0 + y)[x0 + x] = round_to<T>(tile[y * stride + x] * sign);
  }
}

// --- gradients: the maximum of every window and the part of its gradient that each of its ties gets, then their sums
// --------------------------------------------------------------------------------------------------------------------

template <class T>
__global__ void __launch_bounds__(kThreads) find_ties(DilationBackward<T> const p) {
  using F = Compute<T>;
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  Element const e(p.x, i);
  if (!e.there) return;
  Ties<F> ties{minus_infinity<F>(), F(0)};
  for_each_tap<T>(p.x, p.window, p.planes, e, [&](F, F value) { ties.add(value, F(1)); });
  F const g = read(p.grad.row(e.plane, e.row)[e.at]);
  p.found[2 * i] = ties.most;
  p.found[2 * i + 1] = g / max(ties.count, F(1));
}

template <class T>
__global__ void __launch_bounds__(kThreads) sum_ties(DilationBackward<T> const p) {
  using F = Compute<T>;
  Element const e(p.x, blockIdx.x * int64_t(kThreads) + threadIdx.x);
  if (!e.there) return;
  Offsets<F> const& window = p.window;
  F const* const offsets = window.data + e.plane / p.planes * window.stride;
  F const x = read(p.x.row(e.plane, e.row)[e.at]) * (window.erode ? F(-1) : F(1));
  F sum = 0;
  for (int i = 0; i < window.height; ++i) {
    int64_t const y = e.row + window.top - i;
    if (y < 0 || y >= p.x.height) continue;
    F const* const found = p.found + 2 * ((e.plane * p.x.height + y) * p.x.row_size() + e.at);
    for (int j = 0; j < window.width; ++j) {
      F const offset = offsets[i * window.width + j];
      int const shift = window.left - j;
      if (offset == minus_infinity<F>() || e.column + shift < 0 || e.column + shift >= p.x.width) continue;
      F const* const at = found + 2 * shift * p.x.step;
      sum += x + offset == at[0] ? at[1] : F(0);
    }
  }
  p.grad_x.row(e.plane, e.row)[e.at] = round_to<T>(sum);
}

}  // namespace

template <class T>
int dilation(Dilation<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  constexpr int P = kPixels<T>;
  Offsets<F> const& window = p.window;
  int const largest = max(window.height, window.width);
  if (p.x.step > 1 || largest > kLargestTile) {
    unsigned const blocks = unsigned(ceil_div(p.y.rows() * p.y.row_size(), kThreads));
    dilation_any<<<blocks, kThreads, 0, stream>>>(p);
  } else if (window.height == 3 && window.width == 3 && window.top == 1 && window.left == 1 &&
             window.value == (window.erode ? F(INFINITY) : -F(INFINITY))) {
    Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kRows);
    with_alignment<T>(is_strip<P>(p.x) && is_strip<P>(p.y), [&](auto aligned) {
      dilation_3x3<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
    });
  } else {
    int const across = int(ceil_div(p.y.width, kTileWidth)), down = int(ceil_div(p.y.height, kTileHeight));
    int const bytes = int(2 * sizeof(F)) * (kTileWidth + window.width - 1) * (kTileHeight + window.height - 1);
    if (int error = cudaFuncSetAttribute(dilation_tile<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
      return error;
    unsigned const blocks = unsigned(p.y.count() * across * down);
    dilation_tile<<<blocks, kThreads, bytes, stream>>>(p, across, down);
  }
  return cudaGetLastError();
}

template <class T>
int dilation_backward(DilationBackward<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(p.x.rows() * p.x.row_size(), kThreads));
  find_ties<<<blocks, kThreads, 0, stream>>>(p);
  sum_ties<<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(dilation, Dilation)
KV_INSTANTIATE(dilation_backward, DilationBackward)

}  // namespace kv::cuda
