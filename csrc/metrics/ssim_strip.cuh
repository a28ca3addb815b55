// Structural similarity on CUDA: planar images, windows of 5, 7 and 11 pixels, one launch each way. Included by
// ssim.cu, ssim_half.cu and ssim_bfloat16.cu, which say for which types it is compiled.
//
// Each warp walks down a strip of 32 P columns of both images, whose rows come by filters/strip_rows.cuh. A row is
// filtered along x from shared memory; along y there are running sums, as in filters/separable_strip.cuh.
#pragma once

#include "filters/strip_rows.cuh"
#include "ssim.h"

namespace kv::cuda {
namespace {

constexpr int kWarps = 4;     // of a block, which work alone
constexpr int kPixelsOf = 2;  // of a thread: the sums of four means take 4 * (K - 1) registers for each
constexpr int kRing = 8;      // rows of each image; the copies of both wait in one line

template <int K>
struct SsimWeights {
  float w[K];  // as an argument of the kernel they are constants, which cost no registers
};

// The sums along y: of the K - 1 rows of means that a row still belongs to, of which it completes the first.
template <int M, int K, int P>
struct RunningSums {
  float sums[M][K - 1][P] = {};

  __device__ __forceinline__ void add(float const (&row)[M][P], SsimWeights<K> const& weights,
                                      float (&complete)[M][P]) {
#pragma unroll
    for (int m = 0; m < M; ++m)
#pragma unroll
      for (int t = 0; t < K; ++t)
#pragma unroll
        for (int j = 0; j < P; ++j) {
          float const sum = t < K - 1 ? fmaf(weights.w[t], row[m][j], sums[m][t][j]) : weights.w[t] * row[m][j];
          (t == 0 ? complete[m][j] : sums[m][max(t - 1, 0)][j]) = sum;
        }
  }
};

// What goes into the four means, filtered along x: the windows around a thread's pixels of a row of each image.
template <int K, int P, class T>
__device__ __forceinline__ void filter_pixels(T const* x, T const* y, SsimWeights<K> const& weights, float (&h)[4][P]) {
  constexpr int first = kBefore<K, P> - K / 2;
  float a[P + 2 * kBefore<K, P>], b[P + 2 * kBefore<K, P>];
  read_windows<K, P>(x, a);
  read_windows<K, P>(y, b);
#pragma unroll
  for (int i = 0; i < P + K - 1; ++i) {
    float const u = a[first + i], v = b[first + i], d = u - v, values[4] = {u, v, fmaf(u, u, v * v), d * d};
#pragma unroll
    for (int j = 0; j < P; ++j)
      if (i - j >= 0 && i - j < K)
#pragma unroll
        for (int m = 0; m < 4; ++m)
          h[m][j] = i == j ? weights.w[0] * values[m] : fmaf(weights.w[i - j], values[m], h[m][j]);
  }
}

template <class T>
struct alignas(16) SsimMemory {
  T x[kRing][32 * kPixelsOf + 2 * kHalo], y[kRing][32 * kPixelsOf + 2 * kHalo];
};

template <class T, int K>
__global__ void __launch_bounds__(32 * kWarps)
    ssim_strip(__grid_constant__ Ssim<T> const p, __grid_constant__ SsimWeights<K> const weights,
               __grid_constant__ Strips<kPixelsOf> const strips, bool aligned) {
  constexpr int P = kPixelsOf, R = K / 2;
  __shared__ SsimMemory<T> memory[kWarps];
  SsimMemory<T>& shared = memory[threadIdx.x / 32];
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  SsimImages<T> const& images = p.images;
  int const width = int(p.similarity.width), height = int(p.similarity.height), y1 = min(y0 + int(strips.rows), height);
  int const before = images.before(), left = x - P * int(threadIdx.x % 32) + R - before;  // as windows see it
  using Image = StripRows<T, P, R, kRing, bool>;
  Border const border = images.border;
  Image first(shared.x, images.x, plane, border, border, aligned, left, y0 - before, y1 - y0 + K - 1);
  Image second(shared.y, images.y, plane, border, border, aligned, left, y0 - before, y1 - y0 + K - 1);

  T* const out = p.similarity.plane(plane) + x;
  int const out_stride = int(p.similarity.row_stride * sizeof(T));
  RunningSums<4, K, P> sums;
#pragma unroll 1
  for (int i = 0; i < first.count; ++i) {
    T const* const row_x = first.row(i);
    T const* const row_y = second.row(i);
    float h[4][P], means[4][P], result[P];
    filter_pixels<K, P>(row_x, row_y, weights, h);
    sums.add(h, weights, means);
    if (i < K - 1) continue;
#pragma unroll
    for (int j = 0; j < P; ++j)
      result[j] = ssim_of_means(Means<float>{means[0][j], means[1][j], means[2][j], means[3][j]}, images.constants);
    store_pixels(row_below(out, y0 + i - (K - 1), out_stride), result, x, width, aligned);
  }
}

// A strip of the gradients is narrower than that of the derivatives it is made of, by kMargin columns on either side
// that is not the rim of the image. Columns and rows are those of the images, also of derivatives: those of the pixel
// in the middle of a window.
template <int K>
constexpr int kMargin = (K / 2 + kPixelsOf - 1) / kPixelsOf * kPixelsOf;
template <int K>
constexpr int kAdvance = 32 * kPixelsOf - 2 * kMargin<K>;

struct GradientStrips {
  unsigned across, down, count, rows;
};

template <class T, int K, int M>
struct alignas(16) SsimBackwardMemory {
  SsimMemory<T> images;
  float derivatives[M][32 * kPixelsOf + 2 * kMargin<K>];  // from kMargin on; beside them what lies beyond the image
};

// M: 3 for the gradient to x, 4 for both.
template <class T, int K, int M>
__global__ void __launch_bounds__(32 * kWarps)
    ssim_backward_strip(__grid_constant__ SsimBackward<T> const p, __grid_constant__ SsimWeights<K> const weights,
                        __grid_constant__ GradientStrips const strips, bool aligned) {
  constexpr int P = kPixelsOf, R = K / 2, margin = kMargin<K>;
  __shared__ SsimBackwardMemory<T, K, M> memory[kWarps];
  SsimBackwardMemory<T, K, M>& shared = memory[threadIdx.x / 32];
  unsigned const warp = blockIdx.x * kWarps + threadIdx.x / 32;
  if (warp >= strips.count) return;
  unsigned const line = warp / strips.across;
  int64_t const plane = line / strips.down;
  int const lane = threadIdx.x % 32, left = int(warp - line * strips.across) * kAdvance<K>, x = left + P * lane;
  int const y0 = int((line - unsigned(plane) * strips.down) * strips.rows);
  SsimImages<T> const& images = p.images;
  int const width = int(images.x.width), height = int(images.x.height), y1 = min(y0 + int(strips.rows), height);
  bool const mirrored = images.border == Border::reflect;
  int const offset = images.valid ? R : 0;  // of the first derivative
  int const columns = int(p.grad.width), rows = int(p.grad.height);

  using Image = StripRows<T, P, R, kRing, bool>;
  Border const border = images.border;
  Image first(shared.images.x, images.x, plane, border, border, aligned, left, y0 - 2 * R, y1 - y0 + 4 * R);
  Image second(shared.images.y, images.y, plane, border, border, aligned, left, y0 - 2 * R, y1 - y0 + 4 * R);
  for (int i = lane; i < M * (32 * P + 2 * margin); i += 32) shared.derivatives[0][i] = 0;

  // Beyond the image a mirrored row of derivatives is filled in, by the thread of each of its R positions on either
  // side.
  int const outside = lane < 16 ? -1 - lane : width + lane - 16;
  int const mirror = lane < 16 ? 1 + lane : width - 2 - (lane - 16);
  bool const fills = mirrored && lane % 16 < R && outside >= left - R && outside < left + 32 * P + R && mirror >= left;
  bool const gives = (left == 0 || P * lane >= margin) && P * lane < 32 * P - margin;

  T const* const g = p.grad.plane(plane);
  T const *const image_x = images.x.plane(plane), *const image_y = images.y.plane(plane);
  T *const to_x = p.grad_x.plane(plane) + x, *const to_y = M == 4 ? p.grad_y.plane(plane) + x : nullptr;
  auto const row_of = [](auto* first_row, int y, int64_t stride) { return first_row + y * stride; };
  RunningSums<4, K, P> sums;
  RunningSums<M, K, P> gradients;
#pragma unroll 1
  for (int i = 0; i < first.count; ++i) {
    int const center = y0 - 3 * R + i;  // the row whose means this one completes
    int const place = border_index(mirrored ? Border::reflect : Border::constant, center - offset, rows);
    bool const inside = i >= 2 * R && place >= 0;
    float of_result[P] = {};
    if (inside) {
      T const* const row = row_of(g, place, p.grad.row_stride);
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (x + j >= offset && x + j - offset < columns) of_result[j] = read(row[x + j - offset]);
    }
    T const* const row_x = first.row(i);
    T const* const row_y = second.row(i);
    float h[4][P], means[4][P];
    filter_pixels<K, P>(row_x, row_y, weights, h);
    sums.add(h, weights, means);
    if (i < 2 * R) continue;

#pragma unroll
    for (int j = 0; j < P; ++j) {
      Means<float> d{};
      if (inside && x + j >= offset && x + j - offset < columns) {
        if (mirrored && (center == 0 || center == height - 1)) of_result[j] *= 2;
        if (mirrored && (x + j == 0 || x + j == width - 1)) of_result[j] *= 2;
        d = ssim_of_means_vjp(Means<float>{means[0][j], means[1][j], means[2][j], means[3][j]}, images.constants,
                              of_result[j]);
      }
      float* const to = &shared.derivatives[0][margin + P * lane + j];
      constexpr int stride = 32 * P + 2 * margin;
      to[0] = d.x, to[stride] = d.squares, to[2 * stride] = d.apart;
      if (M == 4) to[(M - 1) * stride] = d.y;
    }
    __syncwarp();
    if (fills) {
#pragma unroll
      for (int m = 0; m < M; ++m)
        shared.derivatives[m][margin + outside - left] = shared.derivatives[m][margin + mirror - left];
    }
    __syncwarp();
    float filtered[M][P], complete[M][P];
#pragma unroll
    for (int m = 0; m < M; ++m) {
      float const* const from = &shared.derivatives[m][margin + P * lane - R];
#pragma unroll
      for (int k = 0; k < P + K - 1; ++k) {
        float const value = from[k];
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (k - j >= 0 && k - j < K)
            filtered[m][j] = k == j ? weights.w[0] * value : fmaf(weights.w[k - j], value, filtered[m][j]);
      }
    }
    __syncwarp();  // before the next row of derivatives
    gradients.add(filtered, weights, complete);
    if (i < 4 * R || !gives || x >= width) continue;

    int const y = center - R;
    T const* const at_x = row_of(image_x, y, images.x.row_stride) + x;
    T const* const at_y = row_of(image_y, y, images.y.row_stride) + x;
    float result_x[P], result_y[P];
#pragma unroll
    for (int j = 0; j < P; ++j) {
      bool const there = x + j < width;
      float const a = there ? read(at_x[j]) : 0.f, b = there ? read(at_y[j]) : 0.f, apart = (a - b) * complete[2][j];
      float scale = 1;
      if (mirrored && (y == 0 || y == height - 1)) scale *= 0.5f;
      if (mirrored && (x + j == 0 || x + j == width - 1)) scale *= 0.5f;
      result_x[j] = scale * (complete[0][j] + 2 * (a * complete[1][j] + apart));
      result_y[j] = scale * (complete[M - 1][j] + 2 * (b * complete[1][j] - apart));
    }
    store_pixels(row_of(to_x, y, p.grad_x.row_stride), result_x, x, width, aligned);
    if (M == 4) store_pixels(row_of(to_y, y, p.grad_y.row_stride), result_y, x, width, aligned);
  }
}

template <int K, class T>
SsimWeights<K> weights_of(SsimImages<T> const& images) {
  SsimWeights<K> weights;
  for (int t = 0; t < K; ++t) weights.w[t] = images.weights[t];
  return weights;
}

// Whether rows can be walked down by offsets in ints.
template <class T>
bool fits_strips(SsimImages<T> const& images) {
  return images.x.row_stride * int64_t(sizeof(T)) <= INT32_MAX &&
         images.y.row_stride * int64_t(sizeof(T)) <= INT32_MAX && images.x.width <= INT32_MAX / 2 && images.x.step == 1;
}

template <class T, int K>
void launch_ssim(Ssim<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixelsOf;
  Planes<T> const& out = p.similarity;
  int64_t const lines = out.count() * ceil_div(out.width, 32 * P), resident = 12 * int64_t(multiprocessors());
  int const rows = rows_of_strips(lines, out.height, K, resident, resident);
  bool const aligned = is_strip<P>(p.images.x) && is_strip<P>(p.images.y) && is_strip<P>(out) && !p.images.valid;
  Strips<P> const strips(out.count(), out.height, out.width, rows);
  ssim_strip<T, K><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, weights_of<K>(p.images), strips, aligned);
}

template <class T, int K>
void launch_ssim_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  constexpr int P = kPixelsOf, margin = kMargin<K>;
  Planes<T> const& out = p.grad_x;
  int64_t const across = max(ceil_div(out.width - margin, kAdvance<K>), int64_t(1)), lines = out.count() * across;
  int64_t const resident = 8 * int64_t(multiprocessors());
  int const rows = rows_of_strips(lines, out.height, 2 * K - 1, resident, resident);
  int64_t const down = ceil_div(out.height, rows);
  GradientStrips const strips{unsigned(across), unsigned(down), unsigned(lines * down), unsigned(rows)};
  bool const both = p.grad_y.data;
  bool const aligned =
      is_strip<P>(p.images.x) && is_strip<P>(p.images.y) && is_strip<P>(out) && (!both || is_strip<P>(p.grad_y));
  unsigned const blocks = unsigned(ceil_div(strips.count, kWarps));
  SsimWeights<K> const weights = weights_of<K>(p.images);
  if (both)
    ssim_backward_strip<T, K, 4><<<blocks, 32 * kWarps, 0, stream>>>(p, weights, strips, aligned);
  else
    ssim_backward_strip<T, K, 3><<<blocks, 32 * kWarps, 0, stream>>>(p, weights, strips, aligned);
}

}  // namespace

template <class T>
int ssim(Ssim<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    if (!fits_strips(p.images)) return cudaErrorInvalidValue;
    if (p.images.size == 5) launch_ssim<T, 5>(p, stream);
    if (p.images.size == 7) launch_ssim<T, 7>(p, stream);
    if (p.images.size == 11) launch_ssim<T, 11>(p, stream);
    return cudaGetLastError();
  }
  return cudaErrorInvalidValue;
}

template <class T>
int ssim_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    if (!fits_strips(p.images)) return cudaErrorInvalidValue;
    if (p.images.size == 5) launch_ssim_backward<T, 5>(p, stream);
    if (p.images.size == 7) launch_ssim_backward<T, 7>(p, stream);
    if (p.images.size == 11) launch_ssim_backward<T, 11>(p, stream);
    return cudaGetLastError();
  }
  return cudaErrorInvalidValue;
}

}  // namespace kv::cuda
