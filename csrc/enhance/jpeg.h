// The differentiable JPEG approximation.
//
//   rgb --> luma -------------------------------> blocks --> luma --------------> rgb
//       \-> chroma --> downsampled on both axes > blocks --> chroma, upsampled /
//
// Blocks are 8 x 8 values C = D X D'. Their cosine transform is quantized with the steps s, D' f(C / s) s D, where
//
//   f(q) = round(q) + (q - round(q))^3
//
// All arrows but the first and the last stay inside a block; these two read one adjacent pixel. An image therefore
// takes two passes, with half of its size stored in between as levels: planes of luma, and of blue and red chroma at
// half size, whose sides are multiples of 16 and whose mid-gray is 0. The gradient takes three passes: the first one
// again; from the gradient of rgb to that of the levels before the blocks; and from these levels to the image.
#pragma once

#include "color/luma.h"
#include "core/ceil_div.h"
#include "core/image_list.h"
#include "core/images.h"
#include "core/isa.h"
#include "core/stencils/gradient_list.h"

namespace kv::enhance {

// Tables per image: one quality, and 64 numbers for each table. A stride of 0 broadcasts one to all images. A null
// pointer means the scalar quality, or the table of the standard.
template <class F>
struct JpegTables {
  F const *quality, *luma, *chroma;
  int64_t quality_stride, luma_stride, chroma_stride;
  F number;

  KV_HD void select(int64_t b) {
    if (quality) quality += b * quality_stride;
    if (luma) luma += b * luma_stride;
    if (chroma) chroma += b * chroma_stride;
  }
};

template <class F>
struct JpegLevels {
  F* data;
  int64_t height, width;

  KV_HD int64_t size() const { return height * width / 2 * 3; }
  // Plane 0 is luma, 1 blue and 2 red chroma.
  KV_HD int64_t width_of(int plane) const { return plane == 0 ? width : width / 2; }
  KV_HD F* row(int64_t b, int plane, int64_t y) const {
    F* const image = data + b * size();
    if (plane == 0) return image + y * width;
    return image + height * width + ((plane - 1) * (height / 2) + y) * (width / 2);
  }
};

template <class T>
struct JpegBlocks {
  Images<T const> x;
  JpegLevels<Compute<T>> levels;
  JpegTables<Compute<T>> tables;
};
template <class T>
struct JpegPixels {
  JpegLevels<Compute<T>> levels;
  Images<T> y;
};

// The unit of work: four squares of 16 pixels in a row, each of four blocks of luma and one of each chroma.
constexpr int kJpegSide = 16, kJpegWidth = 64;
constexpr int64_t kJpegTileLevels = kJpegSide * kJpegWidth / 2 * 3;

KV_HD int64_t jpeg_padded(int64_t side) { return ceil_div(side, int64_t(kJpegSide)) * kJpegSide; }
KV_HD int64_t jpeg_tiles(int64_t height, int64_t width) {
  return ceil_div(height, int64_t(kJpegSide)) * ceil_div(width, int64_t(kJpegWidth));
}
// Sample b of a list as a batch of one, whose levels begin in memory where those of its first tile do.
template <class T>
KV_HD JpegBlocks<T> jpeg_sample(Images<T const> const& x, Compute<T>* memory, int64_t first_tile,
                                JpegTables<Compute<T>> tables, int64_t b) {
  tables.select(b);
  return {x, {memory + first_tile * kJpegTileLevels, jpeg_padded(x.height), jpeg_padded(x.width)}, tables};
}

// A list of images of different sizes. An item is a tile, whose levels have a place in memory of their own, so that
// those of an image have one, too.
template <class T>
struct JpegList {
  JpegTables<Compute<T>> all;
  Compute<T>* memory;  // kJpegTileLevels for each item
  ListedSamples list;
  float const* chosen;  // (B,), 0 for samples that are copied; null: all are chosen
  int64_t chosen_stride;
  int channels;

  KV_HD bool copies(int b) const { return chosen && chosen[b * chosen_stride] == 0; }
  KV_HD int sample_of(int item) const { return list.sample_of(item); }
  KV_HD int first_of(int b) const { return list.first[b]; }
  KV_HD ListedSamples const& table() const { return list; }
  // A sample as a batch of one.
  KV_HD JpegBlocks<T> blocks(int b) const {
    return jpeg_sample(images_of<T>(list.images[b], channels), memory, first_of(b), all, b);
  }
  KV_HD JpegPixels<T> pixels(int b) const {
    return {blocks(b).levels, images_of<T>(list.results[b], channels, list.interleaved)};
  }
};

template <class T>
struct JpegBlocksBackward {
  JpegBlocks<T> forward;
  Images<T const> grad;
  JpegLevels<Compute<T>> grad_levels;  // null: not needed
  Compute<T>* gradients;  // of the quantization steps of luma and chroma: (B, chunks, 128); null: not needed
  int64_t chunks;
};
template <class T>
struct JpegPixelsBackward {
  JpegLevels<Compute<T>> grad_levels;
  Images<T> grad_x;
};
// Gradients of the images of a list, in three passes over its tiles; those of images that are not chosen are copied.
template <class T>
struct JpegListBackward : GradientList<JpegTables<Compute<T>>, T> {
  Compute<T>*memory, *grad_memory;  // kJpegTileLevels for each item

  KV_HD int first_of(int b) const { return this->first[b]; }
  KV_HD JpegListBackward const& table() const { return *this; }
  KV_HD JpegBlocks<T> blocks(int b) const {
    return jpeg_sample(images_of<T>(this->images[b], this->channels), memory, first_of(b), this->all, b);
  }
  KV_HD JpegBlocksBackward<T> blocks_backward(int b) const {
    JpegBlocks<T> const forward = blocks(b);
    JpegLevels<Compute<T>> const& levels = forward.levels;
    return {forward, given(b), {grad_memory + (levels.data - memory), levels.height, levels.width}, nullptr, 0};
  }
  KV_HD JpegPixelsBackward<T> pixels_backward(int b) const {
    return {blocks_backward(b).grad_levels, images_of<T>(this->results[b], this->channels, this->interleaved)};
  }
  KV_HD Images<T const> given(int b) const { return images_of<T>(this->grads[b], this->channels); }
};
template <class F>
struct JpegStepsBackward {
  JpegTables<F> tables;
  F const* gradients;
  int64_t batch, chunks;
  F *grad_quality, *grad_luma, *grad_chroma;  // (B), (B, 64), (B, 64)
};

KV_KERNEL(jpeg_blocks, JpegBlocks)
KV_KERNEL(jpeg_pixels, JpegPixels)
KV_KERNEL(jpeg_blocks_list, JpegList)
KV_KERNEL(jpeg_pixels_list, JpegList)
KV_KERNEL(jpeg_blocks_backward, JpegBlocksBackward)
KV_KERNEL(jpeg_pixels_backward, JpegPixelsBackward)
KV_KERNEL(jpeg_blocks_again, JpegListBackward)
KV_KERNEL(jpeg_blocks_list_backward, JpegListBackward)
KV_KERNEL(jpeg_pixels_list_backward, JpegListBackward)
KV_KERNEL(jpeg_steps_backward, JpegStepsBackward)

// --- color -----------------------------------------------------------------------------------------------------------

constexpr double kJpegFromBlue = 0.564, kJpegFromRed = 0.713;  // the factors of b - y and r - y

// RGB to luma, blue and red chroma; and back.
template <class V>
struct JpegColor {
  V v[3];
};
// Levels around 0: 255 (y, cb, cr) - 128.
template <class F, class V>
KV_HD JpegColor<V> jpeg_levels(V const& r, V const& g, V const& b) {
  V const y = r * F(kLumaRed) + g * F(kLumaGreen) + b * F(kLumaBlue);
  return {{y * F(255) - F(128), (b - y) * F(255 * kJpegFromBlue) - F(0.5), (r - y) * F(255 * kJpegFromRed) - F(0.5)}};
}
template <class F, class V>
KV_HD JpegColor<V> jpeg_levels_vjp(V const& luma, V const& blue, V const& red) {
  V const of_b = blue * F(255 * kJpegFromBlue), of_r = red * F(255 * kJpegFromRed);
  V const y = luma * F(255) - of_b - of_r;
  return {{y * F(kLumaRed) + of_r, y * F(kLumaGreen), y * F(kLumaBlue) + of_b}};
}

// RGB before clipping.
template <class F, class V>
KV_HD JpegColor<V> jpeg_rgb(V const& luma, V const& blue, V const& red) {
  V const y = (luma + F(128)) * F(1 / 255.);
  V const b = (blue + F(0.5)) * F(1 / 255. / kJpegFromBlue), r = (red + F(0.5)) * F(1 / 255. / kJpegFromRed);
  return {{y + r, y - b * F(kLumaBlue / kLumaGreen) - r * F(kLumaRed / kLumaGreen), y + b}};
}
template <class F, class V>
KV_HD JpegColor<V> jpeg_rgb_vjp(V const& r, V const& g, V const& b) {
  return {{(r + g + b) * F(1 / 255.), (b - g * F(kLumaBlue / kLumaGreen)) * F(1 / 255. / kJpegFromBlue),
           (r - g * F(kLumaRed / kLumaGreen)) * F(1 / 255. / kJpegFromRed)}};
}
template <class F, class V>
KV_HD V jpeg_clip(V const& x) {
  V const none = x * F(0);  // NaN stays NaN
  return x < F(0) ? none : x > F(1) ? none + F(1) : x;
}
// The gradient with respect to the levels, from the gradient g of clipped rgb.
template <class F, class V>
KV_HD JpegColor<V> jpeg_clipped_rgb_vjp(V const& luma, V const& blue, V const& red, JpegColor<V> g) {
  JpegColor<V> const x = jpeg_rgb<F>(luma, blue, red);
  for (int c = 0; c < 3; ++c) {
    V const none = g.v[c] * F(0);
    g.v[c] = x.v[c] >= F(0) ? (x.v[c] <= F(1) ? g.v[c] : none) : none;
  }
  return jpeg_rgb_vjp<F>(g.v[0], g.v[1], g.v[2]);
}

// --- downsampling and upsampling along one axis ----------------------------------------------------------------------

// Downsampling: a Gaussian of sigma 0.5 smooths the image, and pixel i is the mean of two smoothed ones. It has four
// taps:
//
//   2i - 1   2i   2i + 1   2i + 2
//     a       b      b       a        a = e^-2 b / (1 + e^-2)
//
// The border reflects the image without repeating its last pixel.
constexpr double kJpegOuter = 0.5 * 0.13533528323661269 / (1 + 2 * 0.13533528323661269);
constexpr double kJpegInner = 0.5 - kJpegOuter;
template <class F, class V>
KV_HD V jpeg_halved(V const& a, V const& b, V const& c, V const& d) {
  return (a + d) * F(kJpegOuter) + (b + c) * F(kJpegInner);
}

// An interpolation between two pixels of the downsampled image: the near one and the far one, which may be equal.
template <class F>
struct JpegPair {
  int near, far;
  F near_weight, far_weight;
};
// The transpose of downsampling: the gradient of pixel i of n, from the gradients of downsampled pixels.
template <class F>
KV_HD JpegPair<F> jpeg_halved_vjp(int i, int n) {
  int const near = i / 2, far = i % 2 ? near + 1 : near - 1;
  bool const has_far = far >= 0 && far < n / 2, mirrored = i == 1 || i == n - 2;
  return {near, has_far ? far : near, F(mirrored ? kJpegInner + kJpegOuter : kJpegInner), F(has_far ? kJpegOuter : 0)};
}
// Upsampling: pixel i of n, bilinear in the downsampled image, whose border is replicated.
template <class F>
KV_HD JpegPair<F> jpeg_doubled(int i, int n) {
  return {i / 2, i % 2 ? min(i / 2 + 1, n / 2 - 1) : max(i / 2 - 1, 0), F(0.75), F(0.25)};
}
// The transpose of upsampling, of the gradients of pixels 2i - 1 ... 2i + 2; the first and last pixel also serve those
// out of bounds.
template <class F, class V>
KV_HD V jpeg_doubled_vjp(V const& a, V const& b, V const& c, V const& d) {
  return (b + c) * F(0.75) + (a + d) * F(0.25);
}

// --- blocks ----------------------------------------------------------------------------------------------------------

// Row `frequency` of the orthonormal cosine transform D.
template <class F>
KV_HD constexpr F jpeg_cosine(int frequency, int i) {
  constexpr double half_cos[] = {0.5,
                                 0.49039264020161522,
                                 0.46193976625564337,
                                 0.41573480615127262,
                                 0.35355339059327376,
                                 0.27778511650980109,
                                 0.19134171618254489,
                                 0.097545161008064135,
                                 0};
  if (frequency == 0) return F(half_cos[4]);
  int const angle = (2 * i + 1) * frequency % 32, m = angle > 16 ? 32 - angle : angle;  // in 16ths of pi
  return F(m > 8 ? -half_cos[16 - m] : half_cos[m]);
}
// Coefficient k of eight values, from the sums (k even) or differences (k odd) of x[i] and x[7 - i].
template <class F, int k, class V>
KV_HD V jpeg_frequency(V const (&x)[4]) {
  constexpr F a = jpeg_cosine<F>(k, 0), b = jpeg_cosine<F>(k, 1), c = jpeg_cosine<F>(k, 2), d = jpeg_cosine<F>(k, 3);
  return x[0] * a + x[1] * b + x[2] * c + x[3] * d;
}
template <class F, class V>
KV_HD void jpeg_transform(V (&v)[8]) {
  V const sums[] = {v[0] + v[7], v[1] + v[6], v[2] + v[5], v[3] + v[4]};
  V const differences[] = {v[0] - v[7], v[1] - v[6], v[2] - v[5], v[3] - v[4]};
  v[0] = jpeg_frequency<F, 0>(sums);
  v[1] = jpeg_frequency<F, 1>(differences);
  v[2] = jpeg_frequency<F, 2>(sums);
  v[3] = jpeg_frequency<F, 3>(differences);
  v[4] = jpeg_frequency<F, 4>(sums);
  v[5] = jpeg_frequency<F, 5>(differences);
  v[6] = jpeg_frequency<F, 6>(sums);
  v[7] = jpeg_frequency<F, 7>(differences);
}
// The inverse: values i and 7 - i.
template <class F, int i, class V>
KV_HD void jpeg_values(V const (&frequencies)[8], V& value, V& opposite) {
  constexpr F a = jpeg_cosine<F>(0, i), b = jpeg_cosine<F>(2, i), c = jpeg_cosine<F>(4, i), d = jpeg_cosine<F>(6, i);
  constexpr F e = jpeg_cosine<F>(1, i), f = jpeg_cosine<F>(3, i), g = jpeg_cosine<F>(5, i), h = jpeg_cosine<F>(7, i);
  V const(&v)[8] = frequencies;
  V const even = v[0] * a + v[2] * b + v[4] * c + v[6] * d, odd = v[1] * e + v[3] * f + v[5] * g + v[7] * h;
  value = even + odd;
  opposite = even - odd;
}
template <class F, class V>
KV_HD void jpeg_inverse(V (&v)[8]) {
  V const frequencies[] = {v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]};
  jpeg_values<F, 0>(frequencies, v[0], v[7]);
  jpeg_values<F, 1>(frequencies, v[1], v[6]);
  jpeg_values<F, 2>(frequencies, v[2], v[5]);
  jpeg_values<F, 3>(frequencies, v[3], v[4]);
}

// Rounds half to even. Numbers from 2^22 (float64: 2^51) on may stay as they are.
template <class F, class V>
KV_HD V jpeg_round(V const& x) {
  constexpr F shift = sizeof(F) == 4 ? F(0x1.8p23) : F(0x1.8p52), limit = shift / F(3);
  V const whole = (x + shift) - shift;
  return x < limit ? (x > -limit ? whole : x) : x;
}
template <class F, class V>
KV_HD V jpeg_quantized(V const& coefficient, V const& step) {
  V const q = coefficient / step, whole = jpeg_round<F>(q), rest = q - whole;
  return (whole + rest * rest * rest) * step;
}
// The vjp: `g` becomes the gradient of the coefficient, and the gradient of the step is added to `derivative`.
template <class F, class V>
KV_HD void jpeg_quantized_vjp(V const& coefficient, V const& step, V& g, V& derivative) {
  V const q = coefficient / step, whole = jpeg_round<F>(q), rest = q - whole, square = rest * rest;
  derivative += g * (whole + square * rest - q * square * F(3));
  g = g * square * F(3);
}

// --- quantization steps ----------------------------------------------------------------------------------------------

// The example tables of ISO/IEC 10918-1, annex K. `i`: vertical frequency times 8, plus the horizontal one.
KV_HD int jpeg_standard(bool chroma, int i) {
  constexpr uint8_t luminance[] = {16, 11, 10, 16, 24,  40,  51,  61,  12, 12, 14, 19, 26,  58,  60,  55,
                                   14, 13, 16, 24, 40,  57,  69,  56,  14, 17, 22, 29, 51,  87,  80,  62,
                                   18, 22, 37, 56, 68,  109, 103, 77,  24, 35, 55, 64, 81,  104, 113, 92,
                                   49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99};
  constexpr uint8_t low_chrominance[] = {17, 18, 24, 47, 18, 21, 26, 66, 24, 26, 56, 99, 47, 66, 99, 99};
  constexpr int high_chrominance = 99;  // from frequency 4 on
  if (!chroma) return luminance[i];
  return i / 8 < 4 && i % 8 < 4 ? low_chrominance[i / 8 * 4 + i % 8] : high_chrominance;
}

// A value and its derivative.
template <class F>
struct JpegDual {
  F value, derivative;
};
template <class F>
KV_HD JpegDual<F> jpeg_floor(F x) {
  F const whole = F(__builtin_floor(double(x))), rest = x - whole - F(0.5);
  return {whole + rest * rest * rest, F(3) * rest * rest};
}
// The percentage by which a quality scales the tables.
template <class F>
KV_HD JpegDual<F> jpeg_percent(F quality) {
  F const q = quality < F(1) ? F(1) : quality > F(100) ? F(100) : quality;
  JpegDual<F> const result = jpeg_floor(q < F(50) ? F(5000) / q : F(200) - F(2) * q);
  F const derivative = q < F(50) ? F(-5000) / (q * q) : F(-2);
  return {result.value, quality >= F(1) && quality <= F(100) ? result.derivative * derivative : F(0)};
}
// A quantization step and its derivative with respect to the table times the percentage.
template <class F>
KV_HD JpegDual<F> jpeg_step(F table, F percent) {
  F const x = (table * percent + F(50)) / F(100);
  F const inside = x < F(1) ? F(1) : x > F(255) ? F(255) : x, excess = x - inside;
  F const left = excess == F(0) ? F(1) : F(__builtin_exp(-__builtin_fabs(double(excess))));
  F const more = F(0.02) * (F(1) - left);
  JpegDual<F> const step = jpeg_floor(inside + (excess < F(0) ? -more : more));
  return {step.value, step.derivative * (excess == F(0) ? F(1) : F(0.02) * left) / F(100)};
}

template <class F>
KV_HD F jpeg_quality(JpegTables<F> const& t, int64_t b) {
  return t.quality ? t.quality[b * t.quality_stride] : t.number;
}
// Entry i of the table for luma, or i - 64 of the table for chroma.
template <class F>
KV_HD F jpeg_table(JpegTables<F> const& t, int64_t b, int i) {
  F const* const table = i < 64 ? t.luma : t.chroma;
  if (!table) return F(jpeg_standard(i >= 64, i % 64));
  return table[b * (i < 64 ? t.luma_stride : t.chroma_stride) + i % 64];
}

}  // namespace kv::enhance
