// Transposes of separable filters with border accumulation, on CUDA: planar images, square windows of odd sizes from 3
// to 31. separable.h defines the accumulation.
//
// Warps go down strips as in separable_strip.cuh. Along x, each of 15 threads a side computes one position out of
// bounds. Along y,
//
//   replicate   rows out of bounds are completed like all others, and added to the first or last row.
//   reflect     is the forward pass with the gradient of the first and the last row doubled and their result halved;
//               rows out of bounds count with the reversed weights. For an inner row its reflection contributes what
//               is accumulated. The first and the last row have no reflection: both contributions come from the same
//               side and are equal.
#include "core/block_reduce.cuh"
#include "separable_strip.cuh"

namespace kv::filters::cuda {
namespace {

template <class T, int K, int P>
struct alignas(16) BackwardMemory {
  T rows[kRing<K>][kRingPitch<T, P, bool>];
  float x[32];
  float y[3][32];                // weights, first the one that completes a row; reversed weights; the sum of both
  float border_sums[2][32 * P];  // accumulated from the left and from the right border
};

template <class T, int K, int P>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    separable_backward_strip(__grid_constant__ Separable<T> const p, __grid_constant__ Strips<P> const strips,
                             bool aligned) {
  constexpr int R = K / 2;
  __shared__ BackwardMemory<T, K, P> memory[kWarps];
  BackwardMemory<T, K, P>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.locate(plane, x, y0)) return;
  int const lane = threadIdx.x % 32, x0 = x - P * lane;
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);
  bool const reflects = p.accumulation == Border::reflect, replicates = !reflects;

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
    for (int i = 0; i < P; ++i) shared.border_sums[0][32 * i + lane] = shared.border_sums[1][32 * i + lane] = 0;
  }

  // The border along x. Threads 0 to 15 serve the left side, the others the right side. Thread i of a side has the i-th
  // position out of bounds, whose window covers the R - i + 1 pixels at that end of the row.
  int const position = lane % 16;
  bool const is_left = lane < 16;
  bool const at_left = x0 == 0;
  bool const at_right = x0 + 32 * P >= width - R;
  auto const accumulate_border_x = [&](T const* row, float(&h)[P]) {
    bool const has_position = position >= 1 && position <= R && (is_left ? at_left : at_right);
    int const pixels = has_position ? R - position + 1 : 0, inward = is_left ? 1 : -1;
    T const* const at = row + kHalo + (is_left ? 0 : width - 1 - x0);
    float const* const weights = shared.x + R + inward * position;
    float sum = 0;
#pragma unroll
    for (int i = 0; i < R; ++i)
      if (i < pixels) sum += weights[inward * i] * read(at[inward * i]);
    int target = reflects ? position : 0;
    if (replicates) sum = warp_reduce<16>(sum, Sum());
    if (!is_left) target = width - 1 - target - x0;
    if (has_position && (reflects || position == 1) && target >= 0 && target < 32 * P)
      shared.border_sums[is_left ? 0 : 1][target] = sum;
    __syncwarp();
#pragma unroll
    for (int i = 0; i < P; ++i) h[i] += shared.border_sums[0][P * lane + i] + shared.border_sums[1][P * lane + i];
  };

  T* const out = p.y.plane(plane) + x;
  int const out_stride = int(p.y.row_stride * sizeof(T));
  auto const put = [&](int y, float const(&v)[P]) { store_pixels(row_at(out, y, out_stride), v, x, width, aligned); };

  float sums[K - 1][P] = {};
  float border_row[P] = {};
#pragma unroll 1
  for (int i = 0; i < rows.count; ++i) {
    int const row_index = first + i, y = row_index - R;  // the row that is read, and the row that it completes
    T const* const row = rows.row(i);
    float v[P + 2 * kBefore<K, P>], h[P], result[P];
    float4 four;
    read_windows<K, P>(row, v, aligned);
    filter_row<K>(v, [&](int t) { return weight_at(shared.x, t, four); }, h);
    if (at_left || at_right) accumulate_border_x(row, h);

    float const* weights = shared.y[0];
    float beta = p.beta, scale = 1;
    if (reflects) {
      int const source = border_index(Border::reflect, row_index, height);
      bool const on_border = source == 0 || source == height - 1;
      if (on_border)
        weights = shared.y[2], beta *= 2;
      else if (source != row_index)
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
      for (int j = 0; j < P; ++j) border_row[j] += result[j];
      if (i == rows.count - 1) put(height - 1, border_row);
      continue;
    }
    if (y == 0) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = result[j] * scale + border_row[j], border_row[j] = 0;
    } else if (y == height - 1) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] *= scale;
    }
    if (y >= y0) put(y, result);
  }
}

template <class T, int K>
void launch_backward(Separable<T> const& p, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, rows_per_strip<K, P>(p.y, kResident<K, P>));
  bool const aligned = is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y);
  separable_backward_strip<T, K, P><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips, aligned);
}

template <class T, int K = 3>
void launch_backward_of_size(Separable<T> const& p, CUstream_st* stream) {
  if constexpr (K <= kLargest) {
    if (p.kx.size != K) return launch_backward_of_size<T, K + 2>(p, stream);
    launch_backward<T, K>(p, stream);
  }
}

}  // namespace

template <class T>
int separable_backward_strips(Separable<T> const& p, CUstream_st* stream) {
  launch_backward_of_size(p, stream);
  return cudaGetLastError();
}

template int separable_backward_strips(Separable<float> const&, CUstream_st*);
template int separable_backward_strips(Separable<Half> const&, CUstream_st*);
template int separable_backward_strips(Separable<BFloat16> const&, CUstream_st*);

}  // namespace kv::filters::cuda
