// Dilation and erosion on CUDA. Windows of 3 x 3 pixels are walked down in registers; flat ones along x and then along
// y. Others take a tile along y and then along x, if they are flat, too, and else, and in channels-last images, the
// taps of one element after the other. Whether a window is flat is known on the device only, so each block looks.
#include "core/launch.cuh"
#include "dilation.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256, kFlatThreads = 128;

template <class F>
__device__ __forceinline__ F minus_infinity() {
  return -F(__int_as_float(0x7f800000));
}

// larger() in one instruction where there is one.
__device__ __forceinline__ float join(float a, float b) {
#if __CUDA_ARCH__ >= 800
  float most;
  asm("max.NaN.f32 %0, %1, %2;" : "=f"(most) : "f"(a), "f"(b));
  return most;
#else
  return larger(a, b);
#endif
}
__device__ __forceinline__ double join(double a, double b) { return larger(a, b); }
template <class F>
__device__ __forceinline__ Ties<F> join(Ties<F> const& a, Ties<F> const& b) {
  F const most = join(a.most, b.most), count = a.most == most ? a.count : F(0);
  return {most, b.most == most ? count + b.count : count};
}

__device__ __forceinline__ float share(float g, float count) { return __fdividef(g, fmaxf(count, 1.f)); }
__device__ __forceinline__ double share(double g, double count) { return g / fmax(count, 1.); }

// --- windows of 3 x 3 around the middle
// --------------------------------------------------------------------------------------------------------------------

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
__device__ __forceinline__ float quotient(float a, float b) {
  float inverse;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(b));
  return a * inverse;
}
__device__ __forceinline__ double quotient(double a, double b) { return a / b; }

// Rows of x as they are compared, with R pixels beside the thread's and the value where they are outside.
template <class T, int R, bool Aligned>
struct ComparedRows {
  using F = Compute<T>;
  using Line = Strip<R, Aligned, kStrip>;
  using Fetched = typename Line::template Fetched<T>;
  Line const strip;
  Planes<T const> const& x;
  T const* const plane;
  T const beyond;
  F const sign, outside;

  __device__ __forceinline__ ComparedRows(Planes<T const> const& x, int64_t plane, int column, Window<F> const& window)
      : strip(column, int(x.width), Border::constant),
        x(x),
        plane(x.plane(plane)),
        beyond(round_to<T>(window.value)),
        sign(window.sign()),
        outside(read(beyond) * sign) {}

  __device__ __forceinline__ Fetched fetch(int y) const {
    if (y >= 0 && y < int(x.height)) return strip.fetch(plane + y * x.row_stride);
    Fetched fetched;
#pragma unroll
    for (T& pixel : fetched.own.v) pixel = beyond;
#pragma unroll
    for (int i = 0; i < R; ++i) fetched.left[i] = fetched.right[i] = beyond;
    return fetched;
  }
  __device__ __forceinline__ void spread(Fetched const& fetched, F (&v)[kStrip + 2 * R]) const {
    strip.spread(fetched, v);
#pragma unroll
    for (int i = 0; i < kStrip + 2 * R; ++i) {
      int const column = strip.x - R + i;
      bool const own = Aligned && i >= R && i < kStrip + R;  // where it is read at all, it is inside
      v[i] = own || (column >= 0 && column < strip.width) ? v[i] * sign : outside;
    }
  }
  __device__ __forceinline__ void load(F (&v)[kStrip + 2 * R], int y) const { spread(fetch(y), v); }
};

template <class F, int N>
__device__ __forceinline__ void move_up(F (&rows)[3][N]) {
#pragma unroll
  for (int i = 0; i < N; ++i) rows[0][i] = rows[1][i], rows[1][i] = rows[2][i];
}

// Rows y0 ... y1 - 1 of a flat window: the maxima of three neighbours, and of three rows of these. Rows are asked for
// two ahead of the one that is worked on.
template <class T, bool Aligned>
__device__ __forceinline__ void walk_flat(ComparedRows<T, 1, Aligned> const& rows, Planes<T> const& result,
                                          int64_t plane, int y0, int y1) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  T* out = result.row(plane, y0);
  typename ComparedRows<T, 1, Aligned>::Fetched ahead[2] = {rows.fetch(y0 - 1), rows.fetch(y0)};
  F row[P], two[P];  // the maxima of the last row, and of the last two
  auto const next = [&](int y, int slot, F(&most)[P]) {
    F v[P + 2];
    rows.spread(ahead[slot], v);
    ahead[slot] = rows.fetch(y + 2);
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
    rows.strip.store(out, most);
    out += result.row_stride;
  };
#pragma unroll 1
  for (int y = y0; y < y1; y += 2) {
    step(y, 0);
    if (y + 1 < y1) step(y + 1, 1);
  }
}

template <class T, bool Aligned>
__device__ __forceinline__ void walk_taps(ComparedRows<T, 1, Aligned> const& rows, NineTaps<Compute<T>> const& taps,
                                          Planes<T> const& result, int64_t plane, int y0, int y1) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  T* out = result.row(plane, y0);
  F v[3][P + 2];
  rows.load(v[0], y0 - 1);
  rows.load(v[1], y0);
#pragma unroll 1
  for (int y = y0; y < y1; ++y) {
    rows.load(v[2], y + 1);
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
    rows.strip.store(out, most);
    out += result.row_stride;
    move_up(v);
  }
}

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    dilation_3x3(__grid_constant__ Dilation<T> const p, __grid_constant__ Strips4 const strips) {
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const y1 = min(y0 + int(strips.rows), int(p.x.height));
  NineTaps<Compute<T>> const taps(p.window, plane / p.planes);
  ComparedRows<T, 1, Aligned> const rows(p.x, plane, x, p.window);
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
    dilation_3x3_flat_backward(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  if (!NineTaps<F>(p.window, plane / p.planes).flat) return;
  int const height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  ComparedRows<T, 2, Aligned> const rows(p.x, plane, x, p.window);
  Strip<1, Aligned, P> const grads(x, int(p.x.width), Border::constant);
  T const* const grad = p.grad.plane(plane);

  F most[2][P + 2], ties[2][P + 2];      // of three neighbours in x
  F least[2][P] = {}, parts[2][P] = {};  // of three neighbouring windows
  F own[2][P];                           // x itself
  auto ahead = rows.fetch(y0 - 2);
  auto const next_x = [&](int y, F(&m)[P + 2], F(&t)[P + 2], F(&mine)[P]) {
    F v[P + 4];
    rows.spread(ahead, v);
    ahead = rows.fetch(y + 1);
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
    F g[P + 2] = {}, new_most[P + 2], new_ties[P + 2], new_own[P];
    if (q >= 0 && q < height) grads.load(g, grad + q * p.grad.row_stride);
    next_x(q + 1, new_most, new_ties, new_own);
    F m[P + 2], part[P + 2];
#pragma unroll
    for (int i = 0; i < P + 2; ++i) {
      F const older = most[slot][i], last = most[1 - slot][i];
      m[i] = join(join(older, last), new_most[i]);
      part[i] =
          quotient(g[i], sum_where(m[i], older, last, new_most[i], ties[slot][i], ties[1 - slot][i], new_ties[i]));
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
    if (q > y0) grads.store(p.grad_x.row(plane, q - 1), sum);
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
    dilation_3x3_taps_backward(__grid_constant__ DilationBackward<T> const p, __grid_constant__ Strips4 const strips) {
  constexpr int P = kStrip;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  NineTaps<F> const taps(p.window, plane / p.planes);
  if (taps.flat) return;
  ComparedRows<T, 2, Aligned> const rows(p.x, plane, x, p.window);
  Strip<1, Aligned, P> const grads(x, int(p.x.width), Border::constant);
  F v[3][P + 4], most[3][P + 2] = {}, part[3][P + 2] = {};
  rows.load(v[0], y0 - 2);
  rows.load(v[1], y0 - 1);
#pragma unroll 1
  for (int q = y0 - 1; q <= y1; ++q) {
    rows.load(v[2], q + 1);
    F g[P + 2] = {}, count[P + 2] = {};
    if (q >= 0 && q < height) grads.load(g, p.grad.row(plane, q));
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
      grads.store(p.grad_x.row(plane, q - 1), sum);
    }
    move_up(v);
    move_up(most);
    move_up(part);
  }
}

// --- other windows: what is to be done, by taps
// --------------------------------------------------------------------------------------------------------------------

// An element of a row, as kernels with a thread for each count them.
struct Element {
  int64_t plane, row, at;
  int column;
  template <class T>
  __device__ __forceinline__ Element(Planes<T> const& p, int64_t i) {
    int64_t const size = p.row_size(), line = i / size;
    plane = line / p.height, row = line - plane * p.height, at = i - line * size;
    column = int(at / p.step);
  }
  __device__ __forceinline__ Element(int64_t plane, int row, int column)
      : plane(plane), row(row), at(column), column(column) {}
};

// Calls f(value) for the members of the window of an element, with values as they are compared.
template <class T, class Call>
__device__ __forceinline__ void for_each_tap(Planes<T const> const& x, Window<Compute<T>> const& window, int64_t planes,
                                             Element const& e, Call f) {
  using F = Compute<T>;
  int64_t const sample = e.plane / planes;
  F const sign = window.sign();
  T const* const from = x.plane(e.plane) + e.at;
  for (int i = 0; i < window.height; ++i) {
    int64_t const y = e.row + i - window.top;
    bool const inside = y >= 0 && y < x.height;
    T const* const row = from + (inside ? y : 0) * x.row_stride;
    for (int j = 0; j < window.width; ++j) {
      F const offset = window.offset(sample, i * window.width + j);
      if (offset == minus_infinity<F>()) continue;
      int const shift = j - window.left;
      bool const in_row = inside && e.column + shift >= 0 && e.column + shift < x.width;
      f((in_row ? read(row[shift * x.step]) : window.value) * sign + offset);
    }
  }
}

// Each of the three says how it serves one element by taps; those of the gradient also for flat windows of planar
// images where the window stands, what of a pixel goes into it, and what becomes of that.
template <class T>
struct Maximum {
  using F = Compute<T>;
  Dilation<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    F most = minus_infinity<F>();
    for_each_tap<T>(p.x, p.window, p.planes, e, [&](F value) { most = join(most, value); });
    p.y.row(e.plane, e.row)[e.at] = round_to<T>(most * p.window.sign());
  }
};

// The maximum of every window, and the part of its gradient that each of its ties gets.
template <class T>
struct FindTies {
  using F = Compute<T>;
  using Value = Ties<F>;
  DilationBackward<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  KV_HD int top() const { return p.window.top; }
  KV_HD int left() const { return p.window.left; }

  __device__ __forceinline__ Value outside() const { return {p.window.value * p.window.sign(), F(1)}; }
  __device__ __forceinline__ T const* source(int64_t plane) const { return p.x.plane(plane); }
  __device__ __forceinline__ Value load(T const* plane, int y, int x) const {
    return {read(plane[y * p.x.row_stride + x]) * p.window.sign(), F(1)};
  }
  __device__ __forceinline__ void store(Element const& e, Value const& ties) const {
    F* const found = p.found + 2 * ((e.plane * p.x.height + e.row) * p.x.row_size() + e.at);
    found[0] = ties.most;
    found[1] = share(read(p.grad.row(e.plane, e.row)[e.at]), ties.count);
  }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    Value ties{minus_infinity<F>(), F(0)};
    for_each_tap<T>(p.x, p.window, p.planes, e, [&](F value) { ties.add(value, F(1)); });
    store(e, ties);
  }
};

// Their sums. The minimum of maxima is the maximum of what is negated.
template <class T>
struct SumTies {
  using F = Compute<T>;
  using Value = Ties<F>;
  DilationBackward<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  KV_HD int top() const { return p.window.height - 1 - p.window.top; }
  KV_HD int left() const { return p.window.width - 1 - p.window.left; }

  __device__ __forceinline__ Value outside() const { return {minus_infinity<F>(), F(0)}; }
  __device__ __forceinline__ F const* source(int64_t plane) const {
    return p.found + 2 * plane * p.x.height * p.x.row_size();
  }
  __device__ __forceinline__ Value load(F const* plane, int y, int x) const {
    F const* const found = plane + 2 * (y * p.x.row_size() + x);
    F const most = found[0];
    return most == most ? Value{-most, found[1]} : outside();
  }
  __device__ __forceinline__ F own(Element const& e) const {
    return read(p.x.row(e.plane, e.row)[e.at]) * p.window.sign();
  }
  __device__ __forceinline__ void store(Element const& e, Value const& ties) const {
    p.grad_x.row(e.plane, e.row)[e.at] = round_to<T>(own(e) == -ties.most ? ties.count : F(0));
  }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    Window<F> const& window = p.window;
    int64_t const sample = e.plane / p.planes;
    F const* const from = source(e.plane);
    F const x = own(e);
    F sum = 0;
    for (int i = 0; i < window.height; ++i) {
      int const down = window.top - i;
      if (e.row + down < 0 || e.row + down >= p.x.height) continue;
      for (int j = 0; j < window.width; ++j) {
        F const offset = window.offset(sample, i * window.width + j);
        int const shift = window.left - j;
        if (offset == minus_infinity<F>() || e.column + shift < 0 || e.column + shift >= p.x.width) continue;
        F const* const found = from + 2 * ((e.row + down) * p.x.row_size() + e.at + shift * p.x.step);
        sum += x + offset == found[0] ? found[1] : F(0);
      }
    }
    p.grad_x.row(e.plane, e.row)[e.at] = round_to<T>(sum);
  }
};

template <class Job>
__global__ void __launch_bounds__(kThreads) by_taps(__grid_constant__ Job const job) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < job.image().rows() * job.image().row_size()) job.by_taps(Element(job.image(), i));
}

// --- flat windows: a block makes a tile, along y from the image to shared memory, along x from there
// --------------------------------------------------------------------------------------------------------------------

constexpr int kTileWidth = 128, kLargestTile = 256;  // of a window

// What the `size` elements from 0, from 1, ... from N - 1 on make: they have those from N - 1 to size - 1 in common.
template <int N, class Read, class Write>
__device__ __forceinline__ void join_windows(int size, Read read, Write write) {
  auto common = read(N - 1);
#pragma unroll 4
  for (int i = N; i < size; ++i) common = join(common, read(i));
  decltype(common) first[N];
  first[N - 1] = common;
#pragma unroll
  for (int j = N - 2; j >= 0; --j) first[j] = join(read(j), first[j + 1]);
  write(0, first[0]);
  if constexpr (N > 1) {
    auto behind = read(size);
#pragma unroll
    for (int j = 1; j < N; ++j) {
      if (j > 1) behind = join(behind, read(size + j - 1));
      write(j, join(first[j], behind));
    }
  }
}

// Calls f(position, group) for all groups of N of `count` neighbours at `positions` places, by the threads of a block.
template <class Call>
__device__ __forceinline__ void for_each_group(int positions, int groups, Call f) {
  for (int i = threadIdx.x; i < positions * groups; i += int(blockDim.x)) {
    int const group = i / positions;
    f(i - group * positions, group);
  }
}

// Calls f(row, column) for all of them, a warp for a row after the other.
template <class Call>
__device__ __forceinline__ void for_each_place(int rows, int columns, Call f) {
#pragma unroll 1
  for (int row = threadIdx.x / 32; row < rows; row += int(blockDim.x) / 32)
    for (int column = threadIdx.x % 32; column < columns; column += 32) f(row, column);
}

// The tile of a block: its plane, and its first row and column.
struct Place {
  int64_t plane;
  int y, x;
  __device__ __forceinline__ Place(int across, int down, int rows, int columns) {
    unsigned const line = blockIdx.x / unsigned(across), p = line / unsigned(down);
    plane = p, y = int(line - p * down) * rows, x = int(blockIdx.x - line * across) * columns;
  }
};

// Calls f(N) with how many neighbouring windows of `size` elements a thread takes at once.
template <class Call>
__device__ __forceinline__ void with_group(int size, Call f) {
  if (size >= 15)
    f(std::integral_constant<int, 15>{});
  else if (size >= 5)
    f(std::integral_constant<int, 5>{});
  else
    f(std::integral_constant<int, 1>{});
}

// Whether the window of a sample is flat, by all threads of a block.
template <class F>
__device__ __forceinline__ bool is_flat(Window<F> const& window, int64_t sample) {
  bool flat = true;
  for (int i = threadIdx.x; i < window.height * window.width; i += int(blockDim.x))
    flat = flat && window.offset(sample, i) == 0;
  return __syncthreads_and(flat);
}

// Two groups of rows: for windows of 15 x 15 pixels each thread then takes one group along y and one along x.
constexpr int kMaximaRows = 30, kMaximaThreads = 288, kMaximaStride = kTileWidth + 1;
// Odd strides, so that the threads of a warp, which take rows, read different banks. Groups may reach behind the last
// column.
constexpr int maxima_stride(int window) { return (kTileWidth + 15 + window) | 1; }

// Beyond the image stands its rim, which every window that reaches there has anyway, and the value outside joins the
// result at last.
template <class T>
__global__ void __launch_bounds__(kMaximaThreads, 4)
    maxima_by_tiles(__grid_constant__ Dilation<T> const p, int across, int down) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char bytes[];
  Window<F> const& window = p.window;
  int const height = int(p.x.height), width = int(p.x.width), stride = maxima_stride(window.width);
  Place const at(across, down, kMaximaRows, kTileWidth);
  int const y0 = at.y, x0 = at.x, rows = min(kMaximaRows, height - y0), columns = min(kTileWidth, width - x0);
  if (!is_flat(window, at.plane / p.planes)) {
    for_each_place(rows, columns, [&](int y, int x) { Maximum<T>{p}.by_taps(Element(at.plane, y0 + y, x0 + x)); });
    return;
  }

  F* const along_y = reinterpret_cast<F*>(bytes);   // (rows, stride)
  F* const found = along_y + kMaximaRows * stride;  // (rows, kMaximaStride)
  F const sign = window.sign(), outside = window.value * sign;
  int const top = y0 - window.top, left = x0 - window.left, step = int(p.x.row_stride);
  T const* const source = p.x.plane(at.plane);
  with_group(window.height, [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    for_each_group(columns + window.width - 1, (rows + N - 1) / N, [&](int column, int group) {
      T const* const from = source + clamp(left + column, 0, width - 1);
      int const y = top + group * N;
      join_windows<N>(
          window.height, [&](int i) { return read(from[unsigned(clamp(y + i, 0, height - 1) * step)]) * sign; },
          [&](int j, F value) {
            if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
          });
    });
  });
  __syncthreads();
  with_group(window.width, [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    for_each_group(rows, (columns + N - 1) / N, [&](int row, int group) {
      F const* const from = along_y + row * stride + group * N;
      join_windows<N>(
          window.width, [&](int i) { return from[i]; },
          [&](int j, F value) {
            if (group * N + j < columns) found[row * kMaximaStride + group * N + j] = value;
          });
    });
  });
  __syncthreads();
  bool const inside =
      top >= 0 && left >= 0 && top + rows + window.height - 1 <= height && left + columns + window.width - 1 <= width;
  bool const whole = inside || outside == minus_infinity<F>();
  T* const out = p.y.row(at.plane, y0) + x0;
  for_each_place(rows, columns, [&](int y, int x) {
    F most = found[y * kMaximaStride + x];
    if (!whole && (top + y < 0 || left + x < 0 || top + y + window.height > height || left + x + window.width > width))
      most = join(most, outside);
    out[y * p.y.row_stride + x] = round_to<T>(most * sign);
  });
}

// --- the gradient of flat windows
// --------------------------------------------------------------------------------------------------------------------

constexpr int kTiesRows = 32;
// Windows that a thread takes at once. Along x it is odd, so that the threads of a warp read different banks.
constexpr int kDown = 8, kAcross = 7;
constexpr int tile_stride(int window) { return kTileWidth + kAcross + window; }

template <class Job>
__global__ void __launch_bounds__(kThreads) by_tiles(__grid_constant__ Job const job, int across, int down) {
  using Value = typename Job::Value;
  extern __shared__ __align__(16) unsigned char bytes[];
  auto const& window = job.p.window;
  auto const& image = job.image();
  int const height = int(image.height), width = int(image.width), stride = tile_stride(window.width);
  int64_t const line = blockIdx.x / across, plane = line / down;
  int const x0 = int(blockIdx.x - line * across) * kTileWidth, y0 = int(line - plane * down) * kTiesRows;
  int const rows = min(kTiesRows, height - y0), columns = min(kTileWidth, width - x0);

  auto const for_each_pixel = [&](auto f) {
    for (int i = threadIdx.x; i < kTileWidth * rows; i += kThreads) {
      int const y = i / kTileWidth, x = i % kTileWidth;
      if (x < columns) f(Element(plane, y0 + y, x0 + x), y * kTileWidth + x);
    }
  };
  if (!is_flat(window, plane / job.p.planes)) {
    for_each_pixel([&](Element const& e, int) { job.by_taps(e); });
    return;
  }

  Value* const along_y = reinterpret_cast<Value*>(bytes);  // (rows, stride)
  Value* const found = along_y + kTiesRows * stride;       // (rows, kTileWidth)
  auto const* const source = job.source(plane);
  int const top = y0 - job.top(), left = x0 - job.left();
  auto const go_down = [&](auto width_of_group) {
    constexpr int N = decltype(width_of_group)::value;
    for_each_group(columns + window.width - 1, (rows + N - 1) / N, [&](int column, int group) {
      int const x = left + column, y = top + group * N;
      bool const inside = x >= 0 && x < width;
      join_windows<N>(
          window.height,
          [&](int i) { return inside && y + i >= 0 && y + i < height ? job.load(source, y + i, x) : job.outside(); },
          [&](int j, Value const& value) {
            if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
          });
    });
  };
  if (window.height >= kDown)
    go_down(std::integral_constant<int, kDown>{});
  else
    go_down(std::integral_constant<int, 1>{});
  __syncthreads();
  auto const go_across = [&](auto width_of_group) {
    constexpr int N = decltype(width_of_group)::value;
    int const groups = (columns + N - 1) / N;
    for_each_group(groups, rows, [&](int group, int row) {
      Value const* const from = along_y + row * stride + group * N;
      join_windows<N>(
          window.width, [&](int i) { return from[i]; },
          [&](int j, Value const& value) {
            if (group * N + j < columns) found[row * kTileWidth + group * N + j] = value;
          });
    });
  };
  if (window.width >= kAcross)
    go_across(std::integral_constant<int, kAcross>{});
  else
    go_across(std::integral_constant<int, 1>{});
  __syncthreads();
  for_each_pixel([&](Element const& e, int at) { job.store(e, found[at]); });
}

// Windows that are not too large for it, flat or not, in one launch and without other memory: first the maxima of all
// windows that have a pixel of the tile, with the parts of their ties, then the sums of these. One kernel for all
// types, which takes a while to compile; it looks at the type where it reads and writes images.
constexpr int kGradientThreads = 288;

enum class Stored : int { float32, float16, bfloat16 };
template <class T>
constexpr Stored kStored = __is_same(T, float)  ? Stored::float32
                           : __is_same(T, Half) ? Stored::float16
                                                : Stored::bfloat16;

// Calls f with a number of the type.
template <class Call>
__device__ __forceinline__ void with_type(Stored type, Call f) {
  if (type == Stored::float32)
    f(float());
  else if (type == Stored::float16)
    f(Half());
  else
    f(BFloat16());
}
struct AnyGradient {
  DilationBackward<float> p;  // of images that are stored as `type`
  Stored type;
};
template <class T>
auto as_floats(Planes<T> const& p) {
  using F = std::conditional_t<std::is_const_v<T>, float const, float>;
  return Planes<F>{reinterpret_cast<F*>(p.data),
                   p.outer,
                   p.inner,
                   p.outer_stride,
                   p.inner_stride,
                   p.row_stride,
                   p.height,
                   p.width,
                   p.step};
}
// Row y of a plane of them, as what they are.
template <class T, class F>
__device__ __forceinline__ auto row_of(Planes<F> const& images, int64_t plane, int64_t y, T) {
  using Type = std::conditional_t<std::is_const_v<F>, T const, T>;
  return reinterpret_cast<Type*>(images.data) + (images.row(plane, y) - images.data);
}

__global__ void __launch_bounds__(kGradientThreads, 3)
    gradient_by_tiles(__grid_constant__ AnyGradient const any, int across, int down) {
  DilationBackward<float> const& p = any.p;
  using Value = Ties<float>;
  extern __shared__ __align__(16) unsigned char bytes[];
  Window<float> const& window = p.window;
  GradientTile const tile(window);
  Place const at(across, down, tile.kRows, tile.kColumns);
  int const height = int(p.x.height), width = int(p.x.width), y0 = at.y, x0 = at.x;
  int64_t const sample = at.plane / p.planes;
  int const rows = min(tile.kRows, height - y0), columns = min(tile.kColumns, width - x0);
  // The windows, and the first of them.
  int const rows_of_windows = rows + window.height - 1, windows_of_row = columns + window.width - 1;
  int const top = y0 + window.top - (window.height - 1), left = x0 + window.left - (window.width - 1);
  bool const flat = is_flat(window, sample);
  Value* const found = reinterpret_cast<Value*>(bytes);                         // (rows of windows, tile.windows)
  Value* const along_y = reinterpret_cast<Value*>(bytes + tile.first_bytes());  // (rows of windows, tile.pixels)
  float* const pixels =
      flat ? reinterpret_cast<float*>(found) : reinterpret_cast<float*>(along_y);  // (.., tile.pixels)

  float const sign = window.sign();
  int const columns_of_pixels = windows_of_row + window.width - 1;
  with_type(any.type, [&](auto stored) {
    auto const* const first = row_of(p.x, at.plane, 0, stored) + (left - window.left);
    for_each_place(rows_of_windows + window.height - 1, columns_of_pixels, [&](int row, int column) {
      int const y = top - window.top + row, x = left - window.left + column;
      bool const inside = y >= 0 && y < height && x >= 0 && x < width;
      pixels[row * tile.pixels + column] = (inside ? read(first[y * p.x.row_stride + column]) : window.value) * sign;
    });
  });
  __syncthreads();

  // Maxima and ties to what the pixels get of them. The minimum of maxima is the maximum of what is negated.
  auto const share_out = [&] {
    with_type(any.type, [&](auto stored) {
      auto const* const grad = row_of(p.grad, at.plane, 0, stored) + left;
      for_each_place(rows_of_windows, windows_of_row, [&](int row, int column) {
        int const y = top + row, x = left + column;
        Value& of = found[row * tile.windows + column];
        Value const ties = of;
        bool const counts = y >= 0 && y < height && x >= 0 && x < width && ties.most == ties.most;
        of = {minus_infinity<float>(), 0};
        if (counts) of = {-ties.most, share(read(grad[y * p.grad.row_stride + column]), ties.count)};
      });
    });
    __syncthreads();
  };
  auto const store = [&](auto sum) {
    with_type(any.type, [&](auto stored) {
      auto const* const x_row = row_of(p.x, at.plane, y0, stored) + x0;
      auto* const out = row_of(p.grad_x, at.plane, y0, stored) + x0;
      for_each_place(rows, columns, [&](int y, int x) {
        float const own = read(x_row[y * p.x.row_stride + x]) * sign;
        out[y * p.grad_x.row_stride + x] = round_to<decltype(stored)>(sum(y, x, own));
      });
    });
  };

  if (!flat) {
    auto const for_each_member = [&](auto f) {
      for (int i = 0; i < window.height; ++i)
        for (int j = 0; j < window.width; ++j) {
          float const offset = window.offset(sample, i * window.width + j);
          if (offset != minus_infinity<float>()) f(i, j, offset);
        }
    };
    for_each_place(rows_of_windows, windows_of_row, [&](int row, int column) {
      Value ties{minus_infinity<float>(), 0};
      for_each_member(
          [&](int i, int j, float offset) { ties.add(pixels[(row + i) * tile.pixels + column + j] + offset, 1.f); });
      found[row * tile.windows + column] = ties;
    });
    __syncthreads();
    share_out();
    for_each_place(rows, columns, [&](int y, int x) {
      float const own = pixels[(y + window.height - 1) * tile.pixels + x + window.width - 1];
      float sum = 0;
      for_each_member([&](int i, int j, float offset) {
        Value const& of = found[(y + window.height - 1 - i) * tile.windows + x + window.width - 1 - j];
        sum += own + offset == -of.most ? of.count : 0.f;
      });
      with_type(any.type, [&](auto stored) {
        row_of(p.grad_x, at.plane, y0 + y, stored)[x0 + x] = round_to<decltype(stored)>(sum);
      });
    });
    return;
  }

  // Calls join_windows for `rows` rows of windows at each of `columns` columns, from `from(row, column)`.
  auto const go_down = [&](int rows, int columns, int stride, auto read_at) {
    with_group(window.height, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(columns, (rows + N - 1) / N, [&](int column, int group) {
        join_windows<N>(
            window.height, [&](int i) { return read_at(group * N + i, column); },
            [&](int j, Value const& value) {
              if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
            });
      });
    });
    __syncthreads();
  };
  auto const go_across = [&](int rows, int columns, int stride) {
    with_group(window.width, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(rows, (columns + N - 1) / N, [&](int row, int group) {
        Value const* const from = along_y + row * stride + group * N;
        join_windows<N>(
            window.width, [&](int i) { return from[i]; },
            [&](int j, Value const& value) {
              if (group * N + j < columns) found[row * tile.windows + group * N + j] = value;
            });
      });
    });
    __syncthreads();
  };
  go_down(rows_of_windows, columns_of_pixels, tile.pixels,
          [&](int row, int column) { return Value{pixels[row * tile.pixels + column], 1}; });
  go_across(rows_of_windows, windows_of_row, tile.pixels);
  share_out();
  go_down(rows, windows_of_row, tile.windows, [&](int row, int column) { return found[row * tile.windows + column]; });
  go_across(rows, columns, tile.windows);
  store([&](int y, int x, float own) {
    Value const& of = found[y * tile.windows + x];
    return own == -of.most ? of.count : 0.f;
  });
}

// Doubles go by taps: tiles of theirs would take a quarter of the time that this file takes to compile.
template <class T>
bool has_tiles(Planes<T const> const& image, Window<Compute<T>> const& window) {
  return sizeof(T) < 8 && image.step == 1 && max(window.height, window.width) <= kLargestTile &&
         image.height * image.row_stride <= INT32_MAX;
}

// A kernel for tiles of so many rows and columns.
template <class Params, class Image>
int launch_tiles(void (*kernel)(Params, int, int), Params const& params, Image const& image, int rows, int columns,
                 int threads, int64_t bytes, CUstream_st* stream) {
  int const across = int(ceil_div(image.width, columns)), down = int(ceil_div(image.height, rows));
  if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes))) return error;
  kernel<<<unsigned(image.count() * across * down), threads, bytes, stream>>>(params, across, down);
  return cudaGetLastError();
}

template <class Job>
int launch_taps(Job const& job, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(job.image().rows() * job.image().row_size(), kThreads));
  by_taps<<<blocks, kThreads, 0, stream>>>(job);
  return cudaGetLastError();
}

template <class T, class Job>
int launch_ties(Job const& job, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8)
    if (has_tiles<T>(job.image(), job.p.window)) {
      int const bytes = int(sizeof(typename Job::Value)) * kTiesRows * (tile_stride(job.p.window.width) + kTileWidth);
      return launch_tiles(by_tiles<Job>, job, job.image(), kTiesRows, kTileWidth, kThreads, bytes, stream);
    }
  return launch_taps(job, stream);
}

}  // namespace

template <class T>
int dilation(Dilation<T> const& p, CUstream_st* stream) {
  if (p.x.step > 1 || !is_3x3(p.window)) {
    if constexpr (sizeof(T) < 8)
      if (has_tiles<T>(p.x, p.window)) {
        int const bytes = int(sizeof(Compute<T>)) * kMaximaRows * (maxima_stride(p.window.width) + kMaximaStride);
        return launch_tiles(maxima_by_tiles<T>, p, p.x, kMaximaRows, kTileWidth, kMaximaThreads, bytes, stream);
      }
    return launch_taps(Maximum<T>{p}, stream);
  }
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);
  with_alignment<T>(is_strip<kStrip>(p.x) && is_strip<kStrip>(p.y), [&](auto aligned) {
    dilation_3x3<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
  });
  return cudaGetLastError();
}

template <class T>
int dilation_backward(DilationBackward<T> const& p, CUstream_st* stream) {
  if (p.found) {
    if (int error = launch_ties<T>(FindTies<T>{p}, stream)) return error;
    return launch_ties<T>(SumTies<T>{p}, stream);
  }
  if constexpr (sizeof(T) < 8)
    if (!is_3x3(p.window)) {
      AnyGradient const any{{as_floats(p.grad), as_floats(p.x), as_floats(p.grad_x), p.window, p.planes, nullptr},
                            kStored<T>};
      return launch_tiles(gradient_by_tiles, any, p.x, GradientTile::kRows, GradientTile::kColumns, kGradientThreads,
                          GradientTile(p.window).bytes(), stream);
    }
  Strips4 const strips(p.x.count(), p.x.height, p.x.width, kRows);
  Strips4 const long_strips(p.x.count(), p.x.height, p.x.width, kTapsRows);  // few to find that the window is flat
  bool const aligned = is_strip<kStrip>(p.x) && is_strip<kStrip>(p.grad) && is_strip<kStrip>(p.grad_x);
  with_alignment<T>(aligned, [&](auto aligned) {
    dilation_3x3_flat_backward<T, aligned.value>
        <<<strips.blocks(kFlatThreads / 32), kFlatThreads, 0, stream>>>(p, strips);
    dilation_3x3_taps_backward<T, aligned.value><<<long_strips.blocks(), kThreads, 0, stream>>>(p, long_strips);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(dilation, Dilation)
KV_INSTANTIATE(dilation_backward, DilationBackward)

}  // namespace kv::cuda
