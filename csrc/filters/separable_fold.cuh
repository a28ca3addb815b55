// Transposes that fold the result at the border, on CUDA: planar images, kernels of equal odd sizes from 3 to 31.
// Included by separable_fold.cu, which says for which types it is compiled. separable.h says what is folded.
//
// The walk of separable_strip.cuh. Along x each of 15 threads a side computes one position outside the image. Along y,
//
//   replicate   the rows outside are completed like any other, and added to the rim instead of stored.
//   reflect     is the forward pass with the gradient of the two rim rows doubled and their result halved, where rows
//               outside count with the weights in reverse. For a row inside, the copy beyond the border stands for what
//               is folded; for a rim row, which has no copy, both come from the same side and are equal.
#pragma once

#include "separable_strip.cuh"

namespace kv::cuda {
namespace {

template <class T, int K, int P>
struct alignas(16) FoldMemory {
  T rows[kRing<K>][32 * P + 2 * kHalo];
  float x[32];
  float y[3][32];           // first the weight that completes a row; those in reverse; the sum of the two
  float folded[2][32 * P];  // what the left and the right border add to a row
};

template <class T, int K, int P>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    separable_fold(__grid_constant__ Separable<T> const p, __grid_constant__ Strips<P> const strips, bool aligned) {
  constexpr int R = K / 2;
  __shared__ FoldMemory<T, K, P> memory[kWarps];
  FoldMemory<T, K, P>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const lane = threadIdx.x % 32, x0 = x - P * lane;
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);
  bool const reflects = p.fold == Border::reflect, replicates = !reflects;

  int const first = y0 - R, last = y1 + (replicates && y1 == height ? 2 * R : R);
  RowPrefetcher<T, P, R, kRing<K>, bool> rows(shared.rows, p.x, plane, Border::constant,
                                              reflects ? Border::reflect : Border::constant, aligned, x0, first,
                                              last - first);

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

  T* const out = p.y.plane(plane) + x;
  int const out_stride = int(p.y.row_stride * sizeof(T));
  auto const put = [&](int y, float const(&v)[P]) { store_pixels(row_at(out, y, out_stride), v, x, width, aligned); };

  float sums[K - 1][P] = {};
  float rim[P] = {};
#pragma unroll 1
  for (int i = 0; i < rows.count; ++i) {
    int const now = first + i, y = now - R;  // the row read, and the one that it completes
    T const* const row = rows.row(i);
    float v[P + 2 * kBefore<K, P>], h[P], result[P];
    float4 four;
    read_windows<K, P>(row, v);
    filter_row<K>(v, [&](int t) { return weight_at(shared.x, t, four); }, h);
    if (folds_left || folds_right) fold_row(row, h);

    float const* weights = shared.y[0];
    float beta = p.beta, scale = 1;
    if (reflects) {
      int const inside = border_index(Border::reflect, now, height);
      bool const on_rim = inside == 0 || inside == height - 1;
      if (on_rim)
        weights = shared.y[2], beta *= 2;
      else if (inside != now)
        weights = shared.y[1];
      if (y == 0 || y == height - 1) scale = 0.5f;
    }
    add_row<K>(h, [&](int t) { return weight_at(weights, t, four); }, sums, result);
    if (p.beta != 0) {
#pragma unroll
      for (int j = 0; j < P; ++j) sums[R - 1][j] = fmaf(beta, v[kBefore<K, P> + j], sums[R - 1][j]);
    }

    if (replicates && ((y < 0 && y0 == 0) || y >= height - 1)) {
#pragma unroll
      for (int j = 0; j < P; ++j) rim[j] += result[j];
      if (i == rows.count - 1) put(height - 1, rim);
      continue;
    }
    if (y == 0) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = result[j] * scale + rim[j], rim[j] = 0;
    } else if (y == height - 1) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] *= scale;
    }
    if (y >= y0) put(y, result);
  }
}

template <class T, int K>
void launch_fold(Separable<T> const& p, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, strip_rows<K, P>(p.y, kResident<K, P>));
  bool const aligned = is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y);
  separable_fold<T, K, P><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, aligned);
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
