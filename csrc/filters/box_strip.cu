// Window sums on CUDA at a cost that hardly depends on the window's size: planar images, odd square windows of 9 x 9 to
// 31 x 31 pixels.
//
// Each warp walks down a strip of 128 columns, whose rows come by strip_rows.cuh, a thread four of them. Along x and
// along y alike, a window is the end of one group of four, some whole groups, and the beginning of another group:
//
//   ... | . . # # | # # # # | # # # # | # . . . | ...
//
// so a row costs a few sums of groups, and a row of windows the sum from each row to the end of its group, which the
// thread keeps in shared memory for as long as windows reach back.
#include "box.h"
#include "strip_rows.cuh"

namespace kv::cuda {

// The launcher, for windows as above; Box<uint8_t> has no transpose.
template <class T>
int box_strips(Box<T> const& p, BoxAxis const& axis, CUstream_st* stream);

namespace {

constexpr int kWarps = 2;  // of a block, which work alone
constexpr int kRing = 4;
constexpr int kGroup = 4;   // of rows, and the pixels of a thread
constexpr int kDepth = 32;  // rows kept
constexpr int kResident = 5;

template <class T>
struct alignas(16) WarpMemory {
  Pack<float, kGroup> to_end[kDepth][32];  // from a row to the end of its group
  T rows[kRing][32 * kGroup + 2 * kHalo];
  float packs[32 + 2 * kHalo / kGroup];  // sums of four pixels of the row
};

// v[i] becomes v[i + offset], for the first four and offset < 4.
__device__ __forceinline__ void shift(float (&v)[8], int offset) {
#pragma unroll
  for (int i = 0; i < 6; ++i) v[i] = offset & 1 ? v[i + 1] : v[i];
#pragma unroll
  for (int i = 0; i < 4; ++i) v[i] = offset & 2 ? v[i + 2] : v[i];
}

template <class T>
__device__ __forceinline__ void read_packs(T const* at, float (&v)[8]) {
#pragma unroll
  for (int k = 0; k < 8; k += kGroup) {
    auto const pack = *reinterpret_cast<Pack<T, kGroup> const*>(at + k);
#pragma unroll
    for (int i = 0; i < kGroup; ++i) v[k + i] = read(pack.v[i]);
  }
}

// The sums over the windows of `radius` around the thread's pixels of a row.
template <class T>
__device__ __forceinline__ void sum_row(T const* row, float* packs, int radius, float (&h)[kGroup]) {
  int const lane = threadIdx.x % 32;
  auto const sum_pack = [&](int i) {
    auto const pack = *reinterpret_cast<Pack<T, kGroup> const*>(row + i * kGroup);
    packs[i] = (read(pack.v[0]) + read(pack.v[1])) + (read(pack.v[2]) + read(pack.v[3]));
  };
  constexpr int kBeside = kHalo / kGroup;
  sum_pack(kBeside + lane);
  if (lane < 2 * kBeside) sum_pack(lane < kBeside ? lane : 32 + lane);
  __syncwarp();

  int const first = -((radius + kGroup - 1) / kGroup), last = radius / kGroup;  // packs, 0 being the thread's own
  T const* const own = row + kHalo + kGroup * lane;
  float left[8], right[8], whole = 0;
  read_packs(own + first * kGroup, left);
  read_packs(own + last * kGroup, right);
  for (int i = first + 2; i < last; ++i) whole += packs[kBeside + lane + i];
#pragma unroll
  for (int i = 1; i < 8; ++i) {
    left[7 - i] += left[8 - i];
    right[i] += right[i - 1];
  }
  shift(left, -radius - first * kGroup);
  shift(right, radius - last * kGroup);
#pragma unroll
  for (int i = 0; i < kGroup; ++i) h[i] = left[i] + whole + right[i];
}

__device__ __forceinline__ bool is_end(int i, int n) { return i == 0 || i == n - 1; }

// Mirrored: the transpose of a reflected border, D^-1 A D, where D doubles the first and the last pixel of an axis.
template <class T, bool Mirrored>
__global__ void __launch_bounds__(32 * kWarps, kResident)
    box_strip(__grid_constant__ Box<T> const p, __grid_constant__ Strips<kGroup> const strips, Border border,
              bool aligned) {
  __shared__ WarpMemory<T> memory[kWarps];
  WarpMemory<T>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const lane = threadIdx.x % 32, left = x - kGroup * lane, radius = int(p.kx) / 2, taps = int(p.ky);
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);
  StripRows<T, kGroup, kRing, bool> rows(shared.rows, p.x, plane, border, border, aligned, left, radius, y0 - radius,
                                         y1 - y0 + taps - 1);

  // How often more the rim of a mirrored row is read: pixel 0 also stands at position 2 (width - 1), and the last one
  // at
  // -(width - 1), where the window of a narrow image may reach.
  int firsts[kGroup] = {}, lasts[kGroup] = {};
  bool reads_rim = false;
  if constexpr (Mirrored) {
#pragma unroll
    for (int j = 0; j < kGroup; ++j) {
      auto const reads = [&](int at) { return x + j < width && abs(at - x - j) <= radius; };
      firsts[j] = reads(0) + reads(2 * (width - 1)), lasts[j] = reads(width - 1) + reads(1 - width);
      reads_rim |= firsts[j] + lasts[j] > 0;
    }
  }
  auto const read_again = [&](T pixel, int const(&times)[kGroup], float(&h)[kGroup]) {
#pragma unroll
    for (int j = 0; j < kGroup; ++j) h[j] += times[j] > 0 ? float(times[j]) * read(pixel) : 0.f;
  };

  int const whole = (taps - 1) / kGroup, rest = (taps - 1) % kGroup, out_stride = int(p.y.row_stride * sizeof(T));
  T* const out = p.y.plane(plane) + x;
  float const divisor = p.divisor, reciprocal = 1 / divisor;
  auto const kept = [&](int row) -> Pack<float, kGroup>& { return shared.to_end[row % kDepth][lane]; };
  auto const add = [](Pack<float, kGroup> const& pack, float(&sum)[kGroup]) {
#pragma unroll
    for (int j = 0; j < kGroup; ++j) sum[j] += pack.v[j];
  };
#pragma unroll 1
  for (int first = 0; first < rows.count; first += kGroup) {
    // Whole groups between the one that a window begins in, which is `whole` or `whole` + 1 groups back, and this one.
    float fewer[kGroup] = {}, more[kGroup], begun[kGroup] = {}, h[kGroup][kGroup] = {};
    for (int back = 1; back < whole; ++back) add(kept(kDepth + first - back * kGroup), fewer);
#pragma unroll
    for (int j = 0; j < kGroup; ++j) more[j] = fewer[j];
    add(kept(kDepth + first - whole * kGroup), more);

#pragma unroll
    for (int k = 0; k < kGroup; ++k) {
      int const i = first + k, y = y0 + i - (taps - 1);  // the row that this one completes
      if (i >= rows.count) break;
      T const* const row = rows.row(i);
      sum_row(row, shared.packs, radius, h[k]);
      if constexpr (Mirrored) {
        if (reads_rim) {
          read_again(row[kHalo - left], firsts, h[k]);
          read_again(row[kHalo - left + width - 1], lasts, h[k]);
        }
        if (is_end(border_index(Border::reflect, y + radius, height), height)) {
#pragma unroll
          for (int j = 0; j < kGroup; ++j) h[k][j] *= 2;
        }
      }
#pragma unroll
      for (int j = 0; j < kGroup; ++j) begun[j] += h[k][j];
      if (i < taps - 1) continue;
      float result[kGroup];
#pragma unroll
      for (int j = 0; j < kGroup; ++j) result[j] = begun[j] + (k < rest ? more[j] : fewer[j]);
      add(kept(i - (taps - 1)), result);
#pragma unroll
      for (int j = 0; j < kGroup; ++j) {
        if (Mirrored && is_end(y, height)) result[j] /= 2;
        if (Mirrored && is_end(x + j, width)) result[j] /= 2;
        if (p.centre != 0 && x + j < width) result[j] += p.centre * read(p.x.row(plane, y)[x + j]);
        result[j] = quotient<T>(result[j], divisor, reciprocal);
      }
      store_pixels(row_below(out, y, out_stride), result, x, width, aligned);
    }
    float sum[kGroup] = {};
#pragma unroll
    for (int k = kGroup - 1; k >= 0; --k) {
      Pack<float, kGroup>& to = kept(first + k);
#pragma unroll
      for (int j = 0; j < kGroup; ++j) to.v[j] = sum[j] += h[k][j];
    }
  }
}

}  // namespace

template <class T>
int box_strips(Box<T> const& p, BoxAxis const& axis, CUstream_st* stream) {
  int64_t const machine = multiprocessors(), resident = machine * kResident * kWarps;
  int64_t const lines = p.y.count() * ceil_div(p.y.width, 32 * kGroup);
  Strips<kGroup> const strips(p.y.count(), p.y.height, p.y.width,
                              rows_of_strips(lines, p.y.height, int(p.ky), resident, resident));
  bool const aligned = is_strip<kGroup>(p.x) && is_strip<kGroup>(p.y);
  auto kernel = box_strip<T, false>;
  if constexpr (sizeof(T) > 1)
    if (axis.doubled) kernel = box_strip<T, true>;
  kernel<<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, axis.border, aligned);
  return cudaGetLastError();
}

template int box_strips(Box<float> const&, BoxAxis const&, CUstream_st*);
template int box_strips(Box<Half> const&, BoxAxis const&, CUstream_st*);
template int box_strips(Box<BFloat16> const&, BoxAxis const&, CUstream_st*);
template int box_strips(Box<uint8_t> const&, BoxAxis const&, CUstream_st*);

}  // namespace kv::cuda
