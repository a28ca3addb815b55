// Resizing, one axis after the other: a pixel of the result is the weighted mean of a band of source pixels around its
// coordinate c. CPU and CUDA, images and their gradients share these definitions.
//
//   nearest        floor(i in / out)
//   nearest_exact  floor((i + 1/2) in / out)
//   area           the mean of all pixels from floor(i in / out) to ceil((i + 1) in / out)
//   bilinear       1 - |x|                                          |x| < 1      x = j - c
//   bicubic        Keys' cubic                                      |x| < 2
//   lanczos        sinc(x) sinc(x / 3)                              |x| < 3
//   pyrdown        bilinear, of the image blurred by 1 4 6 4 1
//   pyrup          1 4 6 4 1, of the image resized by bilinear
//
// Antialiased windows are stretched by in / out where that is more than 1. They and Lanczos windows have no taps out of
// bounds and are divided by their sum, as in Pillow; bilinear and bicubic replicate the border there.
//
// Coordinates are fractions of integers, c = (origin + i num) / den, so that bands are exact at any size. The backward
// pass inverts the same bands and uses the same weights.
#pragma once

#include "core/border.h"
#include "core/ceil_div.h"
#include "core/cubic.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv::geometry {

enum class ResizeFilter : int { nearest, nearest_exact, area, bilinear, bicubic, lanczos, pyrdown, pyrup };

struct ResizeAxis {
  ResizeFilter filter;
  Border border;  // of a pyramid's blur
  bool antialias, backward;
  int source, result;        // sizes of the image and of what it is resized to
  int64_t origin, num, den;  // of coordinates
  int64_t unit;              // of the window's x, in 1 / den
  double per_den, per_num;   // 1 / den, 1 / num or 0
  double per_unit;           // 1 / unit
  int max_taps;              // the most pixels that a pixel of the output reads: of a band, or backward its holders
  int max_readers;           // the most pixels of the output that read one pixel

  KV_HD ResizeAxis(ResizeFilter filter, int64_t source, int64_t result, bool align_corners, bool antialias,
                   bool backward, Border border = Border::replicate);
  KV_HD int64_t center(int i) const { return origin + i * num; }
  // n / den and n / num rounded down.
  KV_HD int64_t floor_div(int64_t n) const { return rounded_down(n, den, per_den); }
  KV_HD int64_t floor_div_num(int64_t n) const { return rounded_down(n, num, per_num); }
  // Divisions of integers take CUDA a hundred instructions.
  static KV_HD int64_t rounded_down(int64_t n, int64_t divisor, double reciprocal) {
    int64_t const q = int64_t(double(n) * reciprocal), rest = n - q * divisor;
    return rest < 0 ? q - 1 : rest < divisor ? q : q + 1;
  }
  // Whether taps out of bounds read the border pixel.
  KV_HD bool clamps_taps() const {
    return (filter == ResizeFilter::bilinear || filter == ResizeFilter::bicubic) && !antialias;
  }
  // Whether a band is that of a window around its coordinate, and whether its weights are divided by their sum.
  KV_HD bool has_window() const { return filter >= ResizeFilter::bilinear && filter <= ResizeFilter::lanczos; }
  KV_HD bool is_normalized() const { return has_window() && !clamps_taps(); }
};

template <class T>
struct Resize {
  Planes<T const> x;
  Planes<T> y;
  ResizeAxis rows, columns;
  T const* minuend = nullptr;  // with the layout of y, which is then minuend - resized image
  KV_HD T const* minuend_at(T const* y_element) const { return minuend + (y_element - y.data); }
};

KV_KERNEL(resize, Resize)

namespace cuda {
// For some sizes and windows; the others are not served.
constexpr int kUnsupported = -1;
template <class T>
int resize_octave(Resize<T> const& p, CUstream_st* stream);
template <class T>
int resize_linear(Resize<T> const& p, CUstream_st* stream);
template <class T>
int resize_linear_backward(Resize<T> const& p, CUstream_st* stream);
template <class T>
int resize_strips(Resize<T> const& p, CUstream_st* stream);
template <class T>
int resize_near_half(Resize<T> const& p, CUstream_st* stream);
template <class T>
int resize_columns(Resize<T> const& p, CUstream_st* stream);
}  // namespace cuda

// --- sizes -----------------------------------------------------------------------------------------------------------

// Half of the window's width, in units of x.
KV_HD int filter_radius(ResizeFilter filter) {
  return filter == ResizeFilter::bilinear ? 1 : filter == ResizeFilter::bicubic ? 2 : 3;
}

KV_HD ResizeAxis::ResizeAxis(ResizeFilter filter, int64_t source, int64_t result, bool align_corners, bool antialias,
                             bool backward, Border border)
    : filter(filter),
      border(border),
      antialias(antialias),
      backward(backward),
      source(int(source)),
      result(int(result)),
      origin(source - result),
      num(2 * source),
      den(2 * result) {
  if (align_corners && filter >= ResizeFilter::bilinear) {
    origin = 0;
    num = result > 1 ? source - 1 : 0;
    den = result > 1 ? result - 1 : 1;
  }
  unit = antialias ? max(num, den) : den;
  per_den = 1. / double(den);
  per_num = num ? 1. / double(num) : 0;
  per_unit = unit == den ? per_den : per_num;
  // n / den and n / num rounded up.
  auto const ceil_div_den = [&](int64_t n) { return floor_div(n + den - 1); };
  auto const ceil_div_num = [&](int64_t n) { return floor_div_num(n + num - 1); };
  bool const shrinks = num > den;
  int64_t taps, readers;  // pixels in a band, and bands that a pixel is in
  switch (filter) {
    case ResizeFilter::nearest:
    case ResizeFilter::nearest_exact:
      taps = 1, readers = ceil_div(result, source);
      break;
    case ResizeFilter::area:
      taps = source % result ? source / result + 2 : source / result;
      readers = shrinks ? 2 : ceil_div(result, source) + 1;
      break;
    case ResizeFilter::pyrdown:
      taps = 6, readers = num ? ceil_div_num(6 * den) : result;
      break;
    case ResizeFilter::pyrup:
      taps = 4, readers = num ? ceil_div_num(2 * den) + 4 : result;
      break;
    default:  // windows are 0 at both ends
      taps = ceil_div_den(2 * filter_radius(filter) * unit);
      readers = num ? ceil_div_num(2 * filter_radius(filter) * unit) : result;
  }
  max_taps = int(backward ? min(readers, result) : min(taps, source));
  max_readers = int(backward ? min(taps, source) : min(readers, result));
}

// --- windows ---------------------------------------------------------------------------------------------------------

template <class F>
KV_HD F sin_pi(F x) {  // by its series; 0 at the integers
  int const nearest = int(x + F(0.5));
  F const r = (x - F(nearest)) * F(3.14159265358979323846), square = r * r;
  F sum = 1;
#pragma unroll 1
  for (int n = 20; n > 0; n -= 2) sum = 1 - sum * square / F(n * (n + 1));
  return nearest % 2 ? -r * sum : r * sum;
}

template <class F>
KV_HD F filter_at(ResizeFilter filter, bool antialias, F x) {
  x = x < 0 ? -x : x;
  if (filter == ResizeFilter::bilinear) return x < 1 ? 1 - x : F(0);
  if (filter == ResizeFilter::bicubic) {
    F const k = antialias ? F(-0.5) : F(-0.75);  // as Pillow and OpenCV
    if (x <= 1) return cubic_inner(k, x);
    return x < 2 ? cubic_outer(k, x - 1, 2 - x) : F(0);
  }
  if (x == 0) return 1;
  F const y = x * F(3.14159265358979323846);
  return x < 3 ? 3 * sin_pi(x) * sin_pi(x / 3) / (y * y) : F(0);
}

// The weight of pixel j of n in the pixel at t of the image blurred by 1 4 6 4 1.
template <class F>
KV_HD F blur_weight(Border border, int t, int j, int n) {
  F sum = 0;
#pragma unroll 1
  for (int d = -2; d <= 2; ++d)
    if (border_index(border, t + d, n) == j) sum += F(d == 0 ? 0.375 : d * d == 1 ? 0.25 : 0.0625);
  return sum;
}

// --- bands -----------------------------------------------------------------------------------------------------------

// The band of source pixels of pixel i of the result.
template <class F>
struct Band {
  int first, last;
  F norm;
};

// Both taps of a coordinate, clamped to the image, and the weight of the second one.
template <class F>
struct LinearTaps {
  int a, b;
  F t;
  KV_HD F weight(int j) const { return (j == a ? 1 - t : F(0)) + (j == b ? t : F(0)); }
};
template <class F>
KV_HD LinearTaps<F> linear_taps(ResizeAxis const& a, int i) {
  int64_t const n = a.center(i), first = a.floor_div(n), rest = n - first * a.den;
  int const at = int(first), last = a.source - 1;
  return {clamp(at, 0, last), clamp(rest ? at + 1 : at, 0, last), F(rest) / F(a.den)};
}

// |j den - center(i)| < reach
template <class F>
KV_HD Band<F> window_band(ResizeAxis const& a, int i) {
  int64_t const n = a.center(i), reach = filter_radius(a.filter) * a.unit;
  int64_t const first = a.floor_div(n - reach) + 1, last = a.floor_div(n + reach - 1);
  return {int(max(first, int64_t(0))), int(min(last, int64_t(a.source - 1))), 1};
}

template <class F>
KV_HD Band<F> extent(ResizeAxis const& a, int i) {
  int const last = a.source - 1;
  switch (a.filter) {
    case ResizeFilter::nearest:
    case ResizeFilter::nearest_exact: {
      int const at = int(a.floor_div(i * a.num + (a.filter == ResizeFilter::nearest ? 0 : a.source)));
      return {at, at, 1};
    }
    case ResizeFilter::area: {
      int const from = int(a.floor_div(i * a.num)), to = int(a.floor_div(i * a.num + a.num - 1));
      return {from, to, F(1) / F(to - from + 1)};
    }
    case ResizeFilter::pyrdown: {
      LinearTaps<F> const p = linear_taps<F>(a, i);
      return {max(p.a - 2, 0), min(p.b + 2, last), 1};
    }
    case ResizeFilter::pyrup: {
      LinearTaps<F> const from = linear_taps<F>(a, max(i - 2, 0)), to = linear_taps<F>(a, min(i + 2, a.result - 1));
      return {from.a, to.b, 1};
    }
    default:
      return window_band<F>(a, i);
  }
}

// The window at a distance in units of 1 / den. The product is as exact in float as a division.
template <class F>
KV_HD F window_at(ResizeAxis const& a, int64_t distance) {
  return filter_at(a.filter, a.antialias, sizeof(F) == 4 ? F(double(distance) * a.per_unit) : F(distance) / F(a.unit));
}

// A pixel's weight in pixel i of the result, before it is divided by their sum.
template <class F>
KV_HD F unnormalized_weight(ResizeAxis const& a, int i, int j) {
  // Coordinates are at most half a pixel out of bounds.
  int const from = a.clamps_taps() && j == 0 ? -2 : j, to = a.clamps_taps() && j == a.source - 1 ? j + 2 : j;
  F sum = 0;
#pragma unroll 1
  for (int t = from; t <= to; ++t) sum += window_at<F>(a, t * a.den - a.center(i));
  return sum;
}

template <class F>
KV_HD Band<F> normalized_band(ResizeAxis const& a, int i) {
  Band<F> band = extent<F>(a, i);
  if (a.is_normalized()) {
    F sum = 0;
#pragma unroll 1
    for (int j = band.first; j <= band.last; ++j) sum += unnormalized_weight<F>(a, i, j);
    band.norm = 1 / sum;
  }
  return band;
}

// The weight of source pixel j in pixel i of the result, whose band holds it.
template <class F>
KV_HD F band_weight(ResizeAxis const& a, Band<F> const& band, int i, int j) {
  if (a.filter <= ResizeFilter::area) return band.norm;
  if (a.filter == ResizeFilter::pyrdown) {
    LinearTaps<F> const p = linear_taps<F>(a, i);
    return (1 - p.t) * blur_weight<F>(a.border, p.a, j, a.source) + p.t * blur_weight<F>(a.border, p.b, j, a.source);
  }
  if (a.filter == ResizeFilter::pyrup) {
    F sum = 0;
#pragma unroll 1
    for (int q = max(i - 2, 0); q <= min(i + 2, a.result - 1); ++q)
      sum += blur_weight<F>(a.border, i, q, a.result) * linear_taps<F>(a, q).weight(j);
    return sum;
  }
  return unnormalized_weight<F>(a, i, j) * band.norm;
}

// The `count` pixels, from the first one on, that a kernel reads for pixel `index` of its output. In the backward pass
// they are the pixels of the result whose bands contain source pixel `index`; there may be none.
template <class F>
struct Contributors {
  int first, count;
  F norm;  // of an image's band
};
// The pixels of the result whose windows hold source pixel j, where coordinates differ.
template <class F>
KV_HD Contributors<F> window_holders(ResizeAxis const& a, int j) {
  int64_t const reach = filter_radius(a.filter) * a.unit, n = j * a.den - a.origin;
  int64_t const first = clamp(a.floor_div_num(n - reach) + 1, int64_t(0), int64_t(a.result));
  int64_t const last = min(a.floor_div_num(n + reach - 1), int64_t(a.result - 1));
  return {int(first), int(max(last - first + 1, int64_t(0))), 1};
}

// Without the norm that divides by the sum of weights.
template <class F>
KV_HD Contributors<F> unnormalized_contributors(ResizeAxis const& a, int index) {
  if (!a.backward) {
    Band<F> const band = extent<F>(a, index);
    return {band.first, band.last - band.first + 1, band.norm};
  }
  if (a.has_window() && a.num) return window_holders<F>(a, index);
  // An estimate to start the search from: bands move to the right with i.
  int i = int(clamp(double(index * a.den - a.origin) * a.per_num, 0., double(a.result - 1)));
  while (i > 0 && extent<F>(a, i - 1).last >= index) --i;
  while (i < a.result && extent<F>(a, i).last < index) ++i;
  int count = 0;
  while (count < a.max_taps && i + count < a.result && extent<F>(a, i + count).first <= index) ++count;
  return {i, count, 1};
}
template <class F>
KV_HD Contributors<F> contributors(ResizeAxis const& a, int index) {
  if (a.backward) return unnormalized_contributors<F>(a, index);
  Band<F> const band = normalized_band<F>(a, index);
  return {band.first, band.last - band.first + 1, band.norm};
}
// The weight of the k-th of them.
template <class F>
KV_HD F weight_at(ResizeAxis const& a, Contributors<F> const& reads, int index, int k) {
  int const at = reads.first + k;
  if (!a.backward) return band_weight(a, Band<F>{reads.first, reads.first + reads.count - 1, reads.norm}, index, at);
  return band_weight(a, normalized_band<F>(a, at), at, index);
}

}  // namespace kv::geometry
