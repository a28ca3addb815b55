// Transposes that fold the result at the border, on CUDA: planar images, kernels of equal odd sizes from 3 to 31.
// Included by separable_fold_<type>.cu, which say for which types it is compiled. separable.h says what is folded.
//
// The walk of separable_strip.cuh, with rows fetched into registers. Along x each of 15 threads a side computes one
// position outside the image. Along y,
//
//   replicate   the rows outside are completed like any other, and added to the rim instead of stored.
//   reflect     is the forward pass with the gradient of the two rim rows doubled and their result halved, where rows
//               outside count with the weights in reverse. For a row inside, the copy beyond the border stands for what
//               is folded; for a rim row, which has no copy, both come from the same side and are equal.
#pragma once

#include "separable_strip.cuh"

namespace kv::cuda {
namespace {

// Rows fetched ahead, while the sums leave room for more of them: what is on its way hides the latency of memory.
template <int K, int P>
constexpr int kAhead = P * (K - 1) <= 40 ? 4 : 2;

template <int K, int P>
constexpr int kFoldRegisters = P * (K + 5) + 5 * kAhead<K, P> + 32;
template <int K, int P>
constexpr int kFoldResident = 512 / (kFoldRegisters<K, P> < 170 ? kFoldRegisters<K, P> : 170);

template <class T, int P>
struct alignas(16) FoldMemory {
  T row[2][32 * P + 2 * kHalo];
  int columns[32 * P];
  float x[32];
  float y[3][32];           // first the weight that completes a row; those in reverse; the sum of the two
  float folded[2][32 * P];  // what the left and the right border add to a row
};

template <class T, int K, int P>
__global__ void __launch_bounds__(32 * kWarps, kFoldResident<K, P>)
    separable_fold(__grid_constant__ Separable<T> const p, __grid_constant__ Strips<P> const strips, bool aligned) {
  constexpr int R = K / 2;
  __shared__ FoldMemory<T, P> memory[kWarps];
  FoldMemory<T, P>& shared = memory[threadIdx.x / 32];
  int const lane = threadIdx.x % 32;
  unsigned const warp = blockIdx.x * kWarps + threadIdx.x / 32;
  if (warp >= strips.count) return;
  unsigned const line = warp / strips.across, plane = line / strips.down;
  int const x0 = int(warp - line * strips.across) * 32 * P, y0 = int((line - plane * strips.down) * strips.rows);
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);
  int const in_height = int(p.x.height);
  bool const reflects = p.fold == Border::reflect, replicates = p.fold == Border::replicate;

  // What the thread fetches of a row: its own P pixels, or where those are not P neighbours in an aligned row, every
  // 32nd pixel, by a table of columns; and one pixel beside the strip.
  int const left = x0 + R - p.kx.before;  // the position in the image of the strip's first pixel, as windows see it
  bool const whole = aligned && left == x0 && x0 + 32 * P <= width;
  auto const column = [&](int i) { return border_index(p.border, left + i, int(p.x.width)); };
  if (!whole)
    for (int i = lane; i < 32 * P; i += 32) shared.columns[i] = column(i);  // each thread reads what it wrote
  int const beside = lane < kHalo ? lane - kHalo : 32 * P + lane - kHalo;
  int const beside_column = beside >= -R && beside < 32 * P + R ? column(beside) : -1;
  T const* const in = p.x.plane(plane);
  int const stride = int(p.x.row_stride * sizeof(T));
  auto const row_of = [&](T const* of_first_row, int y) {  // one instruction
    return reinterpret_cast<T const*>(reinterpret_cast<char const*>(of_first_row) + int64_t(y) * stride);
  };
  T const *const own_at = in + x0 + P * lane, *const beside_at = in + beside_column;

  struct Row {
    Pack<T, P> own;
    T beside;
  };
  auto const fetch = [&](int q) {
    Row row{};
    int const y = border_index(reflects ? Border::reflect : p.border, q + R - p.ky.before, in_height);
    if (y < 0) return row;
    if (whole) {
      row.own = *reinterpret_cast<Pack<T, P> const*>(row_of(own_at, y));
    } else {
#pragma unroll
      for (int i = 0; i < P; ++i) {
        int const x = shared.columns[32 * i + lane];
        if (x >= 0) row.own.v[i] = row_of(in, y)[x];
      }
    }
    if (beside_column >= 0) row.beside = *row_of(beside_at, y);
    return row;
  };
  auto const share = [&](Row const& row, T* to) {
    if (whole) {
      *reinterpret_cast<Pack<T, P>*>(to + kHalo + P * lane) = row.own;
    } else {
#pragma unroll
      for (int i = 0; i < P; ++i) to[kHalo + 32 * i + lane] = row.own.v[i];
    }
    to[kHalo + beside] = row.beside;
  };

  int const first = y0 - R, last = y1 + (replicates && y1 == height ? 2 * R : R);
  Row ahead[kAhead<K, P>];
#pragma unroll
  for (int i = 0; i < kAhead<K, P>; ++i) ahead[i] = fetch(first + i);

  {
    int64_t const sample = plane / p.planes;
    shared.x[lane] = weight_of_lane(p.kx, sample, lane);
    float const weight = p.alpha * weight_of_lane(p.ky, sample, lane);
    float const reversed = __shfl_sync(0xffffffffu, weight, (K - 1 - lane) & 31);
    shared.y[0][lane] = reversed;
    shared.y[1][lane] = weight;
    shared.y[2][lane] = weight + reversed;
#pragma unroll
    for (int i = 0; i < P; ++i) shared.folded[0][32 * i + lane] = shared.folded[1][32 * i + lane] = 0;
  }

  // Along x, what the border adds. Threads 0 to 15 are the left side's, the others the right one's. Thread i of a side
  // has the i-th position outside; its window ends in the image, on R - i + 1 pixels from the rim on.
  int const outside = lane % 16;
  bool const is_left = lane < 16;
  bool const folds_left = x0 == 0;
  bool const folds_right = x0 + 32 * P >= width - R;
  auto const fold_row = [&](T const* row, float(&h)[P]) {
    bool const mine = outside >= 1 && outside <= R && (is_left ? folds_left : folds_right);
    int const pixels = mine ? R - outside + 1 : 0, inward = is_left ? 1 : -1;
    T const* const at = row + kHalo + (is_left ? 0 : width - 1 - x0);
    float const* const weights = shared.x + R + inward * outside;
    float sum = 0;
#pragma unroll
    for (int i = 0; i < R; ++i)
      if (i < pixels) sum += weights[inward * i] * read(at[inward * i]);
    int onto = reflects ? outside : 0;
    if (replicates) {
#pragma unroll
      for (int i = 8; i > 0; i /= 2) sum += __shfl_xor_sync(0xffffffffu, sum, i);
    }
    if (!is_left) onto = width - 1 - onto - x0;
    if (mine && (reflects || outside == 1) && onto >= 0 && onto < 32 * P) shared.folded[is_left ? 0 : 1][onto] = sum;
    __syncwarp();
#pragma unroll
    for (int i = 0; i < P; ++i) h[i] += shared.folded[0][P * lane + i] + shared.folded[1][P * lane + i];
  };

  T* out = p.y.row(plane, y0);
  Strip<0, true, P> const packs(x0 + P * lane, width, Border::constant);
  Strip<0, false, P> const pixels(x0 + P * lane, width, Border::constant);
  auto const put = [&](float const(&v)[P]) { aligned ? packs.store(out, v) : pixels.store(out, v); };

  float sums[K - 1][P] = {};
  float rim[P] = {};
  for (int q = first; q < last; q += kAhead<K, P>) {
#pragma unroll
    for (int b = 0; b < kAhead<K, P>; ++b) {
      int const now = q + b;
      if (now >= last) break;
      T* const row = shared.row[b % 2];
      share(ahead[b], row);
      __syncwarp();
      if (now + kAhead<K, P> < last) ahead[b] = fetch(now + kAhead<K, P>);

      // Along x, from packs of P pixels.
      constexpr int kBefore = (R + P - 1) / P * P;
      float v[P + 2 * kBefore], h[P] = {};
#pragma unroll
      for (int i = 0; i < P + 2 * kBefore; i += P) {
        Pack<T, P> const pack = *reinterpret_cast<Pack<T, P> const*>(row + kHalo + P * lane - kBefore + i);
#pragma unroll
        for (int k = 0; k < P; ++k) v[i + k] = read(pack.v[k]);
      }
      float4 four;
#pragma unroll
      for (int t = 0; t < K; ++t) {
        float const weight = weight_at(shared.x, t, four);
#pragma unroll
        for (int i = 0; i < P; ++i) h[i] = fmaf(weight, v[kBefore - R + t + i], h[i]);
      }
      if (folds_left || folds_right) fold_row(row, h);

      // Along y.
      float const* weights = shared.y[0];
      float beta = p.beta, scale = 1;
      int const y = now - R;
      if (reflects) {
        int const inside = border_index(Border::reflect, now, height);
        bool const on_rim = inside == 0 || inside == height - 1;
        if (on_rim)
          weights = shared.y[2], beta *= 2;
        else if (inside != now)
          weights = shared.y[1];
        if (y == 0 || y == height - 1) scale = 0.5f;
      }
      float result[P];
#pragma unroll
      for (int t = 0; t < K; ++t) {
        float const weight = weight_at(weights, t, four);
#pragma unroll
        for (int i = 0; i < P; ++i) {
          float const sum = t < K - 1 ? fmaf(weight, h[i], sums[t][i]) : weight * h[i];
          if (t == 0)
            result[i] = sum;
          else
            sums[t - 1][i] = sum;
        }
      }
      if (p.beta != 0) {
#pragma unroll
        for (int i = 0; i < P; ++i) sums[R - 1][i] = fmaf(beta, v[kBefore + i], sums[R - 1][i]);
      }

      if (replicates && ((y < 0 && y0 == 0) || y >= height - 1)) {
#pragma unroll
        for (int i = 0; i < P; ++i) rim[i] += result[i];
        if (y == last - 1 - R) put(rim);
        continue;
      }
      if (y == 0) {
#pragma unroll
        for (int i = 0; i < P; ++i) result[i] = result[i] * scale + rim[i], rim[i] = 0;
      } else if (y == height - 1) {
#pragma unroll
        for (int i = 0; i < P; ++i) result[i] *= scale;
      }
      if (y < y0) continue;
      put(result);
      out += p.y.row_stride;
    }
  }
}

template <class T, int K>
void launch_fold(Separable<T> const& p, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, strip_rows<K, P>(p.y, kFoldResident<K, P>));
  bool const aligned = is_strip<P>(p.x) && is_strip<P>(p.y);
  separable_fold<T, K, P><<<unsigned(ceil_div(strips.count, kWarps)), 32 * kWarps, 0, stream>>>(p, strips, aligned);
}

template <class T, int K = 3>
void launch_fold_of_size(Separable<T> const& p, CUstream_st* stream) {
  if constexpr (K <= kLargest) {
    if (p.kx.size != K) return launch_fold_of_size<T, K + 2>(p, stream);
    launch_fold<T, K>(p, stream);
  }
}

}  // namespace

}  // namespace kv::cuda
