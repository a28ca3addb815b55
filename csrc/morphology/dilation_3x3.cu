// Dilation and erosion on CUDA by windows of 3 x 3 pixels around the middle, and their gradients: warps walk down
// strips with the last rows in registers.
#include "core/reciprocal.cuh"
#include "dilation.cuh"

namespace kv::cuda {
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

  __device__ __forceinline__ NineTaps(Window<F> const& window, int64_t sample) {
    int const lane = threadIdx.x % 32;
    F const own = lane < 9 ? window.offset(sample, lane) : minus_infinity<F>();
    members = __ballot_sync(0xffffffffu, own != minus_infinity<F>());
    flat = __ballot_sync(0xffffffffu, own == 0) == 0x1ff;
#pragma unroll
    for (int t = 0; t < 9; ++t) offset[t] = __shfl_sync(0xffffffffu, own, t);
  }
  __device__ __forceinline__ bool has(int t) const { return members >> t & 1; }
};

// The smaller one, or the one that is no NaN.
__device__ __forceinline__ float lesser(float a, float b) { return fminf(a, b); }
__device__ __forceinline__ double lesser(double a, double b) { return fmin(a, b); }
// Rows of images one after the other, from row `y` on, with R pixels beside the thread's: times `sign`, and `outside`
// where there is nothing. Each thread reads them all: the memory of its neighbours is near, and there is no other end
// of a warp's row.
template <class T, int R, bool Aligned>
struct NearRows {
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

  __device__ __forceinline__ NearRows(Planes<T const> const& images, int64_t plane, int column, int first, F sign = 1,
                                      F outside = 0)
      : at(images.row(plane, first) + column),
        stride(images.row_stride),
        x(column),
        width(int(images.width)),
        height(int(images.height)),
        sign(sign),
        outside(outside),
        y(first) {}
  // As a window compares them.
  __device__ __forceinline__ NearRows(Planes<T const> const& images, int64_t plane, int column, int first,
                                      Window<F> const& window)
      : NearRows(images, plane, column, first, window.sign(), read(round_to<T>(window.value)) * window.sign()) {}
  __device__ __forceinline__ bool has_row(int y) const { return unsigned(y) < unsigned(height); }
  __device__ __forceinline__ bool has_left() const { return x > 0; }
  __device__ __forceinline__ bool has_right() const { return x + P < width; }

  __device__ __forceinline__ FetchedRow next() {
    FetchedRow found{};
    if (has_row(y)) {
      if constexpr (Aligned) {
        if (x < width) {
          found.own = *reinterpret_cast<Vector<T, P> const*>(at);
          if (has_left()) found.left = *reinterpret_cast<Vector<T, R> const*>(at - R);
          if (has_right()) found.right = *reinterpret_cast<Vector<T, R> const*>(at + P);
        }
      } else {
#pragma unroll
        for (int i = -R; i < P + R; ++i) {
          T& to = i < 0 ? found.left.v[R + i] : i < P ? found.own.v[i] : found.right.v[i - P];
          if (x + i >= 0 && x + i < width) to = at[i];
        }
      }
    }
    at += stride, ++y;
    return found;
  }
  // Of what was read of row y.
  __device__ __forceinline__ void spread(FetchedRow const& f, int y, F (&v)[P + 2 * R]) const {
    F const nothing = has_row(y) ? -F(0) : outside;  // which leaves the sign of a 0
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

// Rows y0 ... y1 - 1 of a flat window: the maxima of three neighbours, and of three rows of these. Rows are asked for
// two ahead of the one that is worked on.
template <class T, bool Aligned>
__device__ __forceinline__ void walk_flat(NearRows<T, 1, Aligned>& rows, Planes<T> const& result, int64_t plane, int y0,
                                          int y1) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  T* out = result.row(plane, y0) + rows.x;
  typename NearRows<T, 1, Aligned>::FetchedRow ahead[2] = {rows.next(), rows.next()};
  F row[P], two[P];  // the maxima of the last row, and of the last two
  auto const next = [&](int y, int slot, F(&most)[P]) {
    F v[P + 2];
    rows.spread(ahead[slot], y, v);
    ahead[slot] = rows.next();
    F pair[P + 1];
#pragma unroll
    for (int i = 0; i <= P; ++i) pair[i] = join(v[i], v[i + 1]);
#pragma unroll
    for (int i = 0; i < P; ++i) most[i] = join(pair[i], v[i + 2]);
  };
  F first[P];
  next(y0 - 1, 0, first);
  next(y0, 1, row);
#pragma unroll
  for (int i = 0; i < P; ++i) two[i] = join(first[i], row[i]);
  auto const step = [&](int y, int slot) {
    F below[P], most[P];
    next(y + 1, slot, below);
#pragma unroll
    for (int i = 0; i < P; ++i) {
      most[i] = join(two[i], below[i]) * rows.sign;
      two[i] = join(row[i], below[i]), row[i] = below[i];
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
__device__ __forceinline__ void walk_taps(NearRows<T, 1, Aligned>& rows, NineTaps<Compute<T>> const& taps,
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
        for (int j = 0; j < P; ++j) most[j] = join(most[j], v[t / 3][j + t % 3] + taps.offset[t]);
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
    walk_3x3(__grid_constant__ Dilation<T> const p, __grid_constant__ Strips4 const strips) {
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));
  NineTaps<Compute<T>> const taps(p.window, plane / p.planes);
  NearRows<T, 1, Aligned> rows(p.x, plane, x, y0 - 1, p.window);
  if (taps.flat)
    walk_flat(rows, p.y, plane, y0, y1);
  else
    walk_taps(rows, taps, p.y, plane, y0, y1);
}

// Of three numbers the sum of what belongs to those that are `which`.
template <class F>
__device__ __forceinline__ F sum_where(F which, F a, F b, F c, F of_a, F of_b, F of_c) {
  F sum = a == which ? of_a : F(0);
  sum = b == which ? sum + of_b : sum;
  return c == which ? sum + of_c : sum;
}

// The gradient of a flat window, each step of three neighbours and then of three rows: the maxima of x with their ties,
// and the minima of these maxima with their parts. A maximum that is NaN has no part in them. Of each there are two
// rows, and a new one takes the place of the older, `slot`.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kFlatThreads, sizeof(Compute<T>) == 8 ? 1 : 4)
    walk_flat_backward(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  if (!NineTaps<F>(p.window, plane / p.planes).flat) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height)), width = int(p.x.width);
  NearRows<T, 2, Aligned> rows(p.x, plane, x, y0 - 2, p.window);
  NearRows<T, 1, Aligned> grads(p.grad, plane, x, y0 - 1);
  T* out = p.grad_x.row(plane, y0) + x;

  F most[2][P + 2], ties[2][P + 2];      // of three neighbours in x
  F least[2][P] = {}, parts[2][P] = {};  // of three neighbouring windows
  F own[2][P];                           // x itself
  auto ahead = rows.next();
  auto grad_ahead = grads.next();
  auto const next_x = [&](int y, F(&m)[P + 2], F(&t)[P + 2], F(&mine)[P]) {
    F v[P + 4];
    rows.spread(ahead, y, v);
    ahead = rows.next();
#pragma unroll
    for (int i = 0; i < P + 2; ++i) {
      m[i] = join(join(v[i], v[i + 1]), v[i + 2]);
      F const one(1), none(0);
      t[i] = (v[i] == m[i] ? one : none) + (v[i + 1] == m[i] ? one : none) + (v[i + 2] == m[i] ? one : none);
    }
#pragma unroll
    for (int i = 0; i < P; ++i) mine[i] = v[i + 2];
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
      m[i] = join(join(older, last), new_most[i]);
      part[i] = g[i] * fast_reciprocal(
                           sum_where(m[i], older, last, new_most[i], ties[slot][i], ties[1 - slot][i], new_ties[i]));
      most[slot][i] = new_most[i], ties[slot][i] = new_ties[i];
    }
    F sum[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      F const older = least[slot][i], last = least[1 - slot][i];
      F const low = lesser(lesser(m[i], m[i + 1]), m[i + 2]), lowest = lesser(lesser(older, last), low);
      F const of_low = sum_where(low, m[i], m[i + 1], m[i + 2], part[i], part[i + 1], part[i + 2]);
      F const of_lowest = sum_where(lowest, older, last, low, parts[slot][i], parts[1 - slot][i], of_low);
      sum[i] = own[slot][i] == lowest ? of_lowest : F(0);
      least[slot][i] = low, parts[slot][i] = of_low, own[slot][i] = new_own[i];
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

// The gradient of another window. Row q of maxima and parts comes from the rows of x around it, row q - 1 of the
// gradient from the maxima around that.
template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    walk_taps_backward(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height)), width = int(p.x.width);
  NineTaps<F> const taps(p.window, plane / p.planes);
  if (taps.flat) return;
  NearRows<T, 2, Aligned> rows(p.x, plane, x, y0 - 2, p.window);
  NearRows<T, 1, Aligned> grads(p.grad, plane, x, y0 - 1);
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
        for (int i = 0; i < P + 2; ++i) most[2][i] = join(most[2][i], v[t / 3][i + t % 3] + taps.offset[t]);
      }
#pragma unroll
    for (int t = 0; t < 9; ++t)
      if (taps.has(t)) {
#pragma unroll
        for (int i = 0; i < P + 2; ++i) count[i] += v[t / 3][i + t % 3] + taps.offset[t] == most[2][i] ? F(1) : F(0);
      }
#pragma unroll
    for (int i = 0; i < P + 2; ++i) part[2][i] = share(g[i], count[i]);
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
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);
  with_alignment<T>(is_vectorizable<kStrip>(p.x) && is_vectorizable<kStrip>(p.y), [&](auto aligned) {
    walk_3x3<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  return cudaGetLastError();
}

template <class T>
int dilation_3x3_backward(DilationBackward<T> const& p, CUstream_st* stream) {
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);
  Strips4 const long_strips(p.x.count(), p.x.height, p.x.width, kTapsRows);  // few to find that the window is flat
  bool const aligned =
      is_vectorizable<kStrip>(p.x) && is_vectorizable<kStrip>(p.grad) && is_vectorizable<kStrip>(p.grad_x);
  with_alignment<T>(aligned, [&](auto aligned) {
    walk_flat_backward<T, aligned.value><<<strips.blocks(kFlatThreads / 32), kFlatThreads, 0, stream>>>(p, strips);
    walk_taps_backward<T, aligned.value><<<long_strips.blocks(), kThreads, 0, stream>>>(p, long_strips);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(dilation_3x3, Dilation)
KV_INSTANTIATE(dilation_3x3_backward, DilationBackward)

}  // namespace kv::cuda
