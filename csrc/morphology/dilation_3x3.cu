// Dilation and erosion on CUDA with centered windows of 3 x 3 pixels, and their gradients: warps go down strips with
// the last rows in registers.
#include "core/reciprocal.cuh"
#include "dilation.cuh"

namespace kv::morphology::cuda {
namespace {

constexpr int kThreads = 256, kFlatThreads = 128;
constexpr int kRows = 24, kTapsRows = 96;  // of a strip
constexpr int kStrip = 4;                  // pixels of a thread
using Strips4 = Strips<kStrip>;

template <class F>
struct NineTaps {
  F offset[9];
  unsigned members;  // bits
  bool flat;

  __device__ __forceinline__ NineTaps(StructuringElement<F> const& window, int64_t sample) {
    int const lane = threadIdx.x % 32;
    F const own = lane < 9 ? window.offset(sample, lane) : minus_infinity<F>();
    members = __ballot_sync(0xffffffffu, own != minus_infinity<F>());
    flat = __ballot_sync(0xffffffffu, own == 0) == 0x1ff;
#pragma unroll
    for (int t = 0; t < 9; ++t) offset[t] = __shfl_sync(0xffffffffu, own, t);
  }
  __device__ __forceinline__ bool has(int t) const { return members >> t & 1; }
};

// IEEE 754 minimumNumber: of a number and NaN, the number.
__device__ __forceinline__ float minimum_number(float a, float b) { return fminf(a, b); }
__device__ __forceinline__ double minimum_number(double a, double b) { return fmin(a, b); }
// Reads rows of images in order, from row `first` on: the thread's P pixels and R pixels on either side, times `sign`,
// and `outside` out of bounds. Each thread loads all of them: the pixels of its neighbors are in the cache, and the
// ends of a warp need no special case.
template <class T, int R, bool Aligned>
struct NeighborRows {
  using F = Compute<T>;
  static constexpr int P = kStrip;
  struct FetchedRow {
    Vector<T, R> left;
    Vector<T, P> own;
    Vector<T, R> right;
  };
  T const* at;
  int64_t const stride;
  int const x, width, height;
  F const sign, outside;
  int y;

  __device__ __forceinline__ NeighborRows(Planes<T const> const& images, int64_t plane, int column, int first,
                                          F sign = 1, F outside = 0)
      : at(images.row(plane, first) + column),
        stride(images.row_stride),
        x(column),
        width(int(images.width)),
        height(int(images.height)),
        sign(sign),
        outside(outside),
        y(first) {}
  // Rows as the window compares them.
  __device__ __forceinline__ NeighborRows(Planes<T const> const& images, int64_t plane, int column, int first,
                                          StructuringElement<F> const& window)
      : NeighborRows(images, plane, column, first, window.sign(), read(round_to<T>(window.value)) * window.sign()) {}
  __device__ __forceinline__ bool has_row(int y) const { return unsigned(y) < unsigned(height); }
  __device__ __forceinline__ bool has_left() const { return x > 0; }
  __device__ __forceinline__ bool has_right() const { return x + P < width; }

  __device__ __forceinline__ FetchedRow next() {
    FetchedRow fetched{};
    if (has_row(y)) {
      if constexpr (Aligned) {
        if (x < width) {
          fetched.own = *reinterpret_cast<Vector<T, P> const*>(at);
          if (has_left()) fetched.left = *reinterpret_cast<Vector<T, R> const*>(at - R);
          if (has_right()) fetched.right = *reinterpret_cast<Vector<T, R> const*>(at + P);
        }
      } else {
#pragma unroll
        for (int i = -R; i < P + R; ++i) {
          T& to = i < 0 ? fetched.left.v[R + i] : i < P ? fetched.own.v[i] : fetched.right.v[i - P];
          if (x + i >= 0 && x + i < width) to = at[i];
        }
      }
    }
    at += stride, ++y;
    return fetched;
  }
  // The values of a fetched row y.
  __device__ __forceinline__ void spread(FetchedRow const& f, int y, F (&v)[P + 2 * R]) const {
    F const nothing = has_row(y) ? -F(0) : outside;  // adding -0 keeps the sign of a 0
    F const to_left = has_left() ? nothing : outside, to_right = has_right() ? nothing : outside;
#pragma unroll
    for (int i = 0; i < P; ++i) v[R + i] = compared(f.own.v[i], x + i, nothing);
#pragma unroll
    for (int i = 0; i < R; ++i) {
      v[i] = compared(f.left.v[i], x - R + i, to_left);
      v[R + P + i] = compared(f.right.v[i], x + P + i, to_right);
    }
  }
  __device__ __forceinline__ void load(F (&v)[P + 2 * R]) {
    int const row = y;
    spread(next(), row, v);
  }

 private:
  // A pixel that was not read is 0.
  __device__ __forceinline__ F compared(T pixel, int column, F added) const {
    return Aligned || (column >= 0 && column < width) ? read(pixel) * sign + added : outside;
  }
};

template <class T, bool Aligned>
__device__ __forceinline__ void store_row(T* to, int x, int width, Compute<T> const (&v)[kStrip]) {
  if constexpr (Aligned) {
    if (x < width) store_vector(to, v);
  } else {
#pragma unroll
    for (int i = 0; i < kStrip; ++i)
      if (x + i < width) to[i] = round_to<T>(v[i]);
  }
}

template <class F, int N>
__device__ __forceinline__ void move_up(F (&rows)[3][N]) {
#pragma unroll
  for (int i = 0; i < N; ++i) rows[0][i] = rows[1][i], rows[1][i] = rows[2][i];
}

// Rows y0 ... y1 - 1 of a flat window: the maxima of three adjacent pixels, and of three rows of these. Two rows are
// prefetched.
template <class T, bool Aligned>
__device__ __forceinline__ void dilate_flat(NeighborRows<T, 1, Aligned>& rows, Planes<T> const& result, int64_t plane,
                                            int y0, int y1) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  T* out = result.row(plane, y0) + rows.x;
  typename NeighborRows<T, 1, Aligned>::FetchedRow ahead[2] = {rows.next(), rows.next()};
  F row[P], two[P];  // the maxima of the last row, and of the last two rows
  auto const next = [&](int y, int slot, F(&most)[P]) {
    F v[P + 2];
    rows.spread(ahead[slot], y, v);
    ahead[slot] = rows.next();
    F pair[P + 1];
#pragma unroll
    for (int i = 0; i <= P; ++i) pair[i] = combine(v[i], v[i + 1]);
#pragma unroll
    for (int i = 0; i < P; ++i) most[i] = combine(pair[i], v[i + 2]);
  };
  F first[P];
  next(y0 - 1, 0, first);
  next(y0, 1, row);
#pragma unroll
  for (int i = 0; i < P; ++i) two[i] = combine(first[i], row[i]);
  auto const step = [&](int y, int slot) {
    F below[P], most[P];
    next(y + 1, slot, below);
#pragma unroll
    for (int i = 0; i < P; ++i) {
      most[i] = combine(two[i], below[i]) * rows.sign;
      two[i] = combine(row[i], below[i]), row[i] = below[i];
    }
    store_row<T, Aligned>(out, rows.x, rows.width, most);
    out += result.row_stride;
  };
#pragma unroll 1
  for (int y = y0; y < y1; y += 2) {
    step(y, 0);
    if (y + 1 < y1) step(y + 1, 1);
  }
}

template <class T, bool Aligned>
__device__ __forceinline__ void dilate_taps(NeighborRows<T, 1, Aligned>& rows, NineTaps<Compute<T>> const& taps,
                                            Planes<T> const& result, int64_t plane, int y0, int y1) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  T* out = result.row(plane, y0) + rows.x;
  F v[3][P + 2];
  rows.load(v[0]);
  rows.load(v[1]);
#pragma unroll 1
  for (int y = y0; y < y1; ++y) {
    rows.load(v[2]);
    F most[P];
#pragma unroll
    for (int j = 0; j < P; ++j) most[j] = minus_infinity<F>();
#pragma unroll
    for (int t = 0; t < 9; ++t)
      if (taps.has(t)) {
#pragma unroll
        for (int j = 0; j < P; ++j) most[j] = combine(most[j], v[t / 3][j + t % 3] + taps.offset[t]);
      }
#pragma unroll
    for (int j = 0; j < P; ++j) most[j] *= rows.sign;
    store_row<T, Aligned>(out, rows.x, rows.width, most);
    out += result.row_stride;
    move_up(v);
  }
}

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    dilation_3x3_strip(__grid_constant__ Dilation<T> const p, __grid_constant__ Strips4 const strips) {
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));
  NineTaps<Compute<T>> const taps(p.window, plane / p.planes);
  NeighborRows<T, 1, Aligned> rows(p.x, plane, x, y0 - 1, p.window);
  if (taps.flat)
    dilate_flat(rows, p.y, plane, y0, y1);
  else
    dilate_taps(rows, taps, p.y, plane, y0, y1);
}

// The sum of value_a, value_b and value_c over those of a, b and c that equal `which`.
template <class F>
__device__ __forceinline__ F sum_where(F which, F a, F b, F c, F value_a, F value_b, F value_c) {
  F sum = a == which ? value_a : F(0);
  sum = b == which ? sum + value_b : sum;
  return c == which ? sum + value_c : sum;
}

// The gradient of a flat window, in two steps of three adjacent elements and three rows each: the maxima of x with
// their tie counts, and the minima of these maxima with their gradients. A maximum that is NaN has none. The last two
// rows of each are in registers; a new row replaces the older one, `slot`.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kFlatThreads, sizeof(Compute<T>) == 8 ? 1 : 4)
    flat_backward_strip(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  if (!NineTaps<F>(p.window, plane / p.planes).flat) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height)), width = int(p.x.width);
  NeighborRows<T, 2, Aligned> rows(p.x, plane, x, y0 - 2, p.window);
  NeighborRows<T, 1, Aligned> grads(p.grad, plane, x, y0 - 1);
  T* out = p.grad_x.row(plane, y0) + x;

  F most[2][P + 2], ties[2][P + 2];       // of three adjacent pixels
  F minima[2][P] = {}, parts[2][P] = {};  // of three adjacent windows
  F own[2][P];                            // x itself
  auto ahead = rows.next();
  auto grad_ahead = grads.next();
  auto const next_x = [&](int y, F(&m)[P + 2], F(&t)[P + 2], F(&center)[P]) {
    F v[P + 4];
    rows.spread(ahead, y, v);
    ahead = rows.next();
#pragma unroll
    for (int i = 0; i < P + 2; ++i) {
      m[i] = combine(combine(v[i], v[i + 1]), v[i + 2]);
      F const one(1), none(0);
      t[i] = (v[i] == m[i] ? one : none) + (v[i + 1] == m[i] ? one : none) + (v[i + 2] == m[i] ? one : none);
    }
#pragma unroll
    for (int i = 0; i < P; ++i) center[i] = v[i + 2];
  };
  next_x(y0 - 2, most[0], ties[0], own[0]);
  next_x(y0 - 1, most[1], ties[1], own[1]);
  auto const step = [&](int q, int slot) {
    F g[P + 2], new_most[P + 2], new_ties[P + 2], new_own[P];
    grads.spread(grad_ahead, q, g);
    grad_ahead = grads.next();
    next_x(q + 1, new_most, new_ties, new_own);
    F m[P + 2], part[P + 2];
#pragma unroll
    for (int i = 0; i < P + 2; ++i) {
      F const older = most[slot][i], last = most[1 - slot][i];
      m[i] = combine(combine(older, last), new_most[i]);
      part[i] = g[i] * fast_reciprocal(
                           sum_where(m[i], older, last, new_most[i], ties[slot][i], ties[1 - slot][i], new_ties[i]));
      most[slot][i] = new_most[i], ties[slot][i] = new_ties[i];
    }
    F sum[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      F const older = minima[slot][i], last = minima[1 - slot][i];
      F const low = minimum_number(minimum_number(m[i], m[i + 1]), m[i + 2]),
              lowest = minimum_number(minimum_number(older, last), low);
      F const value_low = sum_where(low, m[i], m[i + 1], m[i + 2], part[i], part[i + 1], part[i + 2]);
      F const value_lowest = sum_where(lowest, older, last, low, parts[slot][i], parts[1 - slot][i], value_low);
      sum[i] = own[slot][i] == lowest ? value_lowest : F(0);
      minima[slot][i] = low, parts[slot][i] = value_low, own[slot][i] = new_own[i];
    }
    if (q <= y0) return;
    store_row<T, Aligned>(out, x, width, sum);
    out += p.grad_x.row_stride;
  };
#pragma unroll 1
  for (int q = y0 - 1; q <= y1; q += 2) {
    step(q, 0);
    if (q < y1) step(q + 1, 1);
  }
}

// The gradient of a window that is not flat. Row q of maxima and tie gradients is computed from the rows of x around
// it; row q - 1 of the gradient from the maxima around that row.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    taps_backward_strip(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height)), width = int(p.x.width);
  NineTaps<F> const taps(p.window, plane / p.planes);
  if (taps.flat) return;
  NeighborRows<T, 2, Aligned> rows(p.x, plane, x, y0 - 2, p.window);
  NeighborRows<T, 1, Aligned> grads(p.grad, plane, x, y0 - 1);
  T* out = p.grad_x.row(plane, y0) + x;
  F v[3][P + 4], most[3][P + 2] = {}, part[3][P + 2] = {};
  rows.load(v[0]);
  rows.load(v[1]);
#pragma unroll 1
  for (int q = y0 - 1; q <= y1; ++q) {
    rows.load(v[2]);
    F g[P + 2], count[P + 2] = {};
    grads.load(g);
#pragma unroll
    for (int i = 0; i < P + 2; ++i) most[2][i] = minus_infinity<F>();
#pragma unroll
    for (int t = 0; t < 9; ++t)
      if (taps.has(t)) {
#pragma unroll
        for (int i = 0; i < P + 2; ++i) most[2][i] = combine(most[2][i], v[t / 3][i + t % 3] + taps.offset[t]);
      }
#pragma unroll
    for (int t = 0; t < 9; ++t)
      if (taps.has(t)) {
#pragma unroll
        for (int i = 0; i < P + 2; ++i) count[i] += v[t / 3][i + t % 3] + taps.offset[t] == most[2][i] ? F(1) : F(0);
      }
#pragma unroll
    for (int i = 0; i < P + 2; ++i) part[2][i] = tie_gradient(g[i], count[i]);
    if (q > y0) {
      F sum[P] = {};
#pragma unroll
      for (int t = 0; t < 9; ++t)
        if (taps.has(t)) {
#pragma unroll
          for (int j = 0; j < P; ++j) {
            int const row = 2 - t / 3, at = j + 2 - t % 3;
            sum[j] += v[0][j + 2] + taps.offset[t] == most[row][at] ? part[row][at] : F(0);
          }
        }
      store_row<T, Aligned>(out, x, width, sum);
      out += p.grad_x.row_stride;
    }
    move_up(v);
    move_up(most);
    move_up(part);
  }
}

}  // namespace

template <class T>
int dilation_3x3(Dilation<T> const& p, CUstream_st* stream) {
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);  // in waves: 0.9x at 299x299
  with_alignment<T>(is_vectorizable<kStrip>(p.x) && is_vectorizable<kStrip>(p.y), [&](auto aligned) {
    dilation_3x3_strip<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  return cudaGetLastError();
}

template <class T>
int dilation_3x3_backward(DilationBackward<T> const& p, CUstream_st* stream) {
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);
  // Special case, H200: 0.99 (dilate cross3 backward) to 2.6 (dilation3 backward) times as fast as tap by tap.
  Strips4 const long_strips(p.x.count(), p.x.height, p.x.width,
                            kTapsRows);  // few strips, most of which only find that the window is flat
  bool const aligned =
      is_vectorizable<kStrip>(p.x) && is_vectorizable<kStrip>(p.grad) && is_vectorizable<kStrip>(p.grad_x);
  with_alignment<T>(aligned, [&](auto aligned) {
    flat_backward_strip<T, aligned.value><<<strips.blocks(kFlatThreads / 32), kFlatThreads, 0, stream>>>(p, strips);
    taps_backward_strip<T, aligned.value><<<long_strips.blocks(), kThreads, 0, stream>>>(p, long_strips);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(dilation_3x3, Dilation)
KV_INSTANTIATE(dilation_3x3_backward, DilationBackward)

}  // namespace kv::morphology::cuda
