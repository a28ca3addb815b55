// Structural similarity of two images, from four Gaussian means of the windows: of x, of y, of x^2 + y^2, of (x - y)^2.
//
//   A = mx^2 + my^2 + c1      a = (mx - my)^2                 luminance 1 - a / A
//   B = var x + var y + c2    b = var (x - y)                 structure 1 - b / B
//   similarity = ((A - a) (B - b) + eps) / (A B + eps) = 1 - (A b + a (B - b)) / (A B + eps)
//
// Without luminance A is 1 and a is 0. The kernels compute the dissimilarity, which is the last fraction. It stays
// accurate where images are nearly equal and is exactly 0 where they are equal. Negative values are clamped to 0, so
// that no similarity exceeds 1 despite rounding. Included by ssim_cpu.cpp, ssim_op.cpp and the CUDA files.
//
// The gradient applies the transpose of the means to the derivatives of the similarity by the means, times the gradient
// g of the result:
//
//   dx = M(dmx) + x M(dsquares) + (x - y) M(dapart)
//   dy = M(dmy) + y M(dsquares) - (x - y) M(dapart)
//
// dsquares and dapart are twice the derivatives by these means. The transpose differs from the means M only at the
// border. With zeros around the image it is the same operator. For 'valid' windows it pads the result with zeros. For a
// reflected border it is D^-1 A D, where A are the means and D doubles the first and the last pixel of an axis;
// filters/smoothing/box.h has the proof.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/shared_memory.h"
#include "core/view.h"

namespace kv::metrics {

// Windows that cross the border read reflected pixels or zeros; or no window crosses it. Exported graphs contain these
// numbers.
enum class SsimPadding : int { reflect, constant, valid };

template <class F>
struct SsimConstants {
  F c1, c2, eps;
  F luminance;  // 1; or 0 for similarity without luminance, where c1 is 1
};

// The means, or the derivatives by the means.
template <class V>
struct Means {
  V x, y, squares, apart;
};

template <class V>
KV_HD V at_least_0(V x) {
  return max(x, V{});
}
#if defined(__CUDA_ARCH__)
// One instruction, which replaces NaN by 0; a mean is NaN as well then, and with it A.
__device__ __forceinline__ float at_least_0(float x) { return fmaxf(x, 0); }
#endif

// The terms of the formulas above; 1 - similarity = numerator / denominator.
template <class V>
struct SsimTerms {
  V A, a, B, b, difference, variance_of_both, variance_of_difference, numerator, denominator;

  template <class F>
  KV_HD SsimTerms(Means<V> const& m, SsimConstants<F> const& c) {
    V const mean_squares = m.x * m.x + m.y * m.y;
    difference = m.x - m.y;
    V const apart = difference * difference;
    variance_of_both = m.squares - mean_squares, variance_of_difference = m.apart - apart;
    A = c.luminance * mean_squares + c.c1, a = c.luminance * apart;
    B = at_least_0(variance_of_both) + c.c2, b = at_least_0(variance_of_difference);
    numerator = at_least_0(V(A * b + a * (B - b))), denominator = A * B + c.eps;
  }
};

// `inverse` is 1 / denominator, g the gradient of the similarity.
template <class V, class F>
KV_HD Means<V> ssim_of_means_vjp(Means<V> const& m, SsimTerms<V> const& t, V inverse, V g, F luminance) {
  V const zero = V{}, unlike = t.numerator * inverse, scale = -2 * g * inverse, of_luminance = luminance * scale;
  V const d_A = (t.b - unlike * t.B) * of_luminance, d_a = (t.B - t.b) * of_luminance;
  V d_B = (t.a - unlike * t.A) * scale, d_b = (t.A - t.a) * scale;
  d_B = t.variance_of_both >= zero ? d_B : zero;
  d_b = t.variance_of_difference >= zero ? d_b : zero;
  V const of_both = d_A - d_B, of_difference = (d_a - d_b) * t.difference;
  return {m.x * of_both + of_difference, m.y * of_both - of_difference, d_B, d_b};
}

// Two images of one layout and their window. `border` is reflect, or constant for zeros. With `valid`, where `border`
// is constant, windows stay inside the images and the similarity is smaller by size - 1 pixels.
template <class T>
struct SsimImages {
  Planes<T const> x, y;
  Compute<T> const* weights;  // `size` of them, in host memory
  double sigma;               // of the window
  int size;
  bool volumes;   // windows extend across planes as well, in groups of `depth`
  int64_t depth;  // 1 for images
  Border border;
  bool valid;
  SsimConstants<Compute<T>> constants;

  KV_HD int before() const { return valid ? 0 : size / 2; }
  KV_HD int64_t slices() const { return volumes && valid ? depth - size + 1 : depth; }  // of the similarity
};

// A loss for each row of planes, rows being consecutive: `structure` times the sum of 1 - similarity, plus `absolute`
// times the sum of abs(x - y).
template <class F>
struct SsimLoss {
  F structure, absolute;
  int64_t planes;  // of a row
};

// Computes the similarity, or the loss if the similarity has no data.
template <class T>
struct Ssim {
  SsimImages<T> images;
  Planes<T> similarity;
  SsimLoss<Compute<T>> loss;
  Compute<T>* partial;  // partial sums: on the CPU per row of the similarity, on CUDA per warp
  Compute<T>* sums;     // CUDA: of the rows
};

template <class T>
struct SsimBackward {
  SsimImages<T> images;
  Planes<T const> grad;      // of the similarity; without data, the gradient of the loss is used
  Planes<T> grad_x, grad_y;  // grad_y.data is null where it is not needed
  SsimLoss<Compute<T>> loss;
  Compute<T> const* of_loss;  // the gradient of each row's loss
  Compute<T>* derivatives;    // CUDA, unless has_ssim_strips: working memory for the derivatives by the means
  int64_t room;               // its number of elements
};

// Windows of several scales around the pixels of the same images.
constexpr int kMaxSsimScales = 16, kMaxSsimWeights = 400;  // over all scales
template <class F>
struct SsimScales {
  int count, sizes[kMaxSsimScales];
  F const* weights[kMaxSsimScales];  // in host memory
};

// The loss of a sample's pixels: `structure` times the sum over its planes of 1 - the product of the similarities of
// all scales, plus `absolute` times the mean of abs(x - y) in the last window, summed over planes. Only the last scale
// has luminance. The window of `images` is that of the last scale, and borders are zeros.
template <class T>
struct MsSsim {
  SsimImages<T> images;
  SsimScales<Compute<T>> scales;
  SsimLoss<Compute<T>> loss;
  Compute<T>* map;  // (samples, height, width)
};

template <class T>
struct MsSsimBackward {
  SsimImages<T> images;
  SsimScales<Compute<T>> scales;
  SsimLoss<Compute<T>> loss;
  Compute<T> const* of_map;  // the gradient of the map
  Planes<T> grad_x, grad_y;  // grad_y.data is null where it is not needed
  Compute<T>* derivatives;   // CUDA: working memory for the derivatives by the means
  int64_t room;              // its number of elements
};

// CUDA has four kinds of kernels: strips for small windows over planar images (ssim.cu), tiles for images and for
// volumes with windows of usual sizes (ssim_tiles.cu, ssim_volumes.cu), and one for all remaining cases (ssim_any.cu).
constexpr int kSsimStripBytes[3] = {54 << 10, 88 << 10, 106 << 10};  // without gradients, with one, with two
template <class T>
bool has_ssim_strips(SsimImages<T> const& p, int gradients) {
  bool const usual = p.size >= 3 && p.size <= 11;
  return usual && kSsimStripBytes[gradients] <= max_shared_bytes() && !p.volumes && sizeof(T) < 8 && p.x.step == 1 &&
         min(p.x.height, p.x.width) >= p.size && max(p.x.height, p.x.width) < INT32_MAX / 2 &&
         // Special case, H200: 1.60 (ssim11 backward) to 2.6 (l1_ssim_loss11) times as fast as tiles.
         max(p.x.row_stride, p.y.row_stride) < INT32_MAX / 4;
}
template <class T>
bool has_ssim_tiles(SsimImages<T> const& p) {
  int64_t const longest = max(max(p.x.row_stride, p.y.row_stride), p.x.width);
  // Special case, H200: 3.5 (ssim21 backward) to 6.9 (ssim_loss31) times as fast as any window.
  return !p.volumes && p.size <= kMaxSsimWeights && p.x.height < INT32_MAX / int64_t(sizeof(T)) / longest;
}

// The tiles of a plane, wide enough that the columns of a tile and of its halo occupy all threads.
struct SsimTiles {
  static constexpr int kRows = 8, kMaxThreads = 320;
  int columns, threads, stride;  // stride of rows in shared memory, chosen so that a thread of each row reads at once
  int64_t across, down;

  SsimTiles(int64_t height, int64_t width, int size) {
    int64_t min_work = INT64_MAX;
    int64_t const max_threads = max_shared_bytes() < 96 << 10 ? 96 : max_shared_bytes() < 192 << 10 ? 160 : kMaxThreads;
    int64_t const fewest = (width + max_threads - 1) / max_threads;
    for (int64_t parts = fewest; parts <= 3 * fewest; ++parts) {
      int64_t const each = (width + kRows * parts - 1) / (kRows * parts) * kRows, line = each + size - 1;
      int64_t const rounds = (line + max_threads - 1) / max_threads;
      int64_t const busy = max((line + 32 * rounds - 1) / (32 * rounds), (each + 31) / 32) * 32;
      int64_t const work = parts * busy * (rounds + 1);
      if (work < min_work)
        min_work = work, columns = int(each), threads = int(busy), across = (width + each - 1) / each;
    }
    stride = (columns + size - 1 + kRows - 1) / kRows * kRows + 1;
    down = (height + kRows - 1) / kRows;
  }
  int64_t count() const { return across * down; }
  int64_t chunks() const { return count() * (threads / 32); }
};

// The tiles of a volume.
struct SsimVolumeTiles {
  static constexpr int kSide = 8, kColumns = 32, kThreads = 256, kMaxTaps = 21, kMaxBytes = 200 << 10;
  int64_t across, down, parts, bytes;  // bytes: of shared memory

  SsimVolumeTiles(int64_t depth, int64_t height, int64_t width, int size, int64_t number)
      : across((width + kColumns - 1) / kColumns),
        down((height + kSide - 1) / kSide),
        parts((depth + kSide - 1) / kSide),
        bytes(4 * number * kSide * (kSide + size - 1) * (kColumns + size)) {}
  int64_t count() const { return across * down * parts; }
  int64_t chunks() const { return count() * (kThreads / 32); }
};
template <class T>
bool has_ssim_volume_tiles(SsimImages<T> const& p) {
  SsimVolumeTiles const tiles(p.depth, p.x.height, p.x.width, p.size, sizeof(Compute<T>));
  return p.volumes && p.size <= tiles.kMaxTaps &&
         tiles.bytes <= min(int64_t(tiles.kMaxBytes), max_shared_bytes() - 2048) &&
         // Special case, H200: 1.13 (ssim3d backward) to 1.97 (ssim3d) times as fast as any window.
         p.depth < INT32_MAX / int64_t(sizeof(T)) / (p.x.height * p.x.width);
}

// Splits a volume, or an image, into parts of `slices` slices and `rows` rows by 32 columns.
struct SsimBlocks {
  int rows, slices;
  int64_t across, down, parts, bytes;  // bytes: of shared memory

  SsimBlocks(int64_t depth, int64_t height, int64_t width, int size, int deep, int64_t number) : rows(8) {
    auto const memory = [&] {
      int64_t const threads = 32 * rows, ring = deep > 0 ? (2 * deep + 1) * threads : 0;
      return number *
             (4 * (rows * (32 + size - 1) + threads + ring) + (size + 3) / 4 * 4);  // weights are read in fours
    };
    while (rows > 1 && memory() > max_shared_bytes(100 << 10)) rows /= 2;
    bytes = memory();
    slices = int(min(depth, int64_t(2 * size)));
    across = (width + 31) / 32, down = (height + rows - 1) / rows, parts = (depth + slices - 1) / slices;
  }
  int64_t count() const { return across * down * parts; }
  int64_t chunks() const { return count() * rows; }
};

// CUDA: the maximum size of `partial` per plane of an image, or per volume.
template <class T>
int64_t max_ssim_chunks(SsimImages<T> const& p) {
  if (has_ssim_strips(p, 0)) return (p.x.width / 240 + 1) * 8 * (p.x.height / 8 + 1);
  if (has_ssim_tiles(p)) return SsimTiles(p.x.height, p.x.width, p.size).chunks();
  if (has_ssim_volume_tiles(p)) return SsimVolumeTiles(p.depth, p.x.height, p.x.width, p.size, 0).chunks();
  return SsimBlocks(p.depth, p.x.height, p.x.width, p.size, p.volumes ? p.size / 2 : 0, sizeof(Compute<T>)).chunks();
}

KV_KERNEL(ssim, Ssim)
KV_KERNEL(ssim_backward, SsimBackward)
KV_KERNEL(ms_ssim, MsSsim)
KV_KERNEL(ms_ssim_backward, MsSsimBackward)

}  // namespace kv::metrics
