// The noise of a sensitive sensor: Poisson counts of the deviation of an image's lightness, and a normal hue.
// corruption/noises.py of kvision.augmentation defines it.
#pragma once

#include "augmentation/noise.h"
#include "color/hue.h"
#include "core/ceil_div.h"
#include "core/stencils/gradient_list.h"

namespace kv::augmentation {

// RGB images. Parameters are the deviation of hue in turns and the intensity. `uniform` has two planes a sample,
// uniform and normal numbers, in place of those of the draw and the next one; or null.
template <class T>
struct IsoNoise {
  PixelNoise<T> noise;
  double* sums;  // (B, chunks, 2): of the lightness and its square
  int64_t chunk, chunks;

  KV_HD int64_t begin(int64_t i) const { return i * chunk; }
  KV_HD int64_t end(int64_t i) const { return min((i + 1) * chunk, noise.pixels); }
};

KV_KERNEL(sum_lightness, IsoNoise)
KV_KERNEL(iso_noise, IsoNoise)

// Pixels of a chunk are a multiple of this, and there are at most so many chunks.
constexpr int64_t kIsoPixels = 1024, kIsoChunks = 128;
KV_HD int64_t iso_chunk(int64_t pixels) {
  return kIsoPixels * max(ceil_div(pixels, kIsoPixels * kIsoChunks), int64_t(1));
}
KV_HD int64_t iso_chunks(int64_t pixels) { return ceil_div(pixels, iso_chunk(pixels)); }

// The same of images of different sizes, whose items are chunks.
template <class T>
struct IsoNoiseList {
  PixelNoiseList<T> noise;
  double* sums;

  KV_HD int sample_of(int item) const { return noise.list.sample_of(item); }
  KV_HD int first_of(int b) const { return noise.list.first[b]; }
  // A sample as a batch of one.
  KV_HD IsoNoise<T> sample(int b) const {
    PixelNoise<T> const one = noise.sample(b);
    return {one, sums + 2 * noise.list.first[b], iso_chunk(one.pixels), iso_chunks(one.pixels)};
  }
};

KV_KERNEL(sum_lightness_list, IsoNoiseList)
KV_KERNEL(iso_noise_list, IsoNoiseList)

// The gradients y of images x; those of results, `grad`, lie as they do. Counts have none.
template <class T>
struct IsoNoiseBackward : IsoNoise<T> {
  T const* grad;

  KV_HD void select(int64_t b) { this->noise.skip(b); }
  KV_HD PixelNoise<T> given() const {
    PixelNoise<T> given = this->noise;
    given.x = grad;
    return given;
  }
};
template <class T>
struct IsoNoiseBackwardList : GradientList<IsoNoiseBackward<T>, T> {
  double* sums;

  KV_HD int first_of(int b) const { return this->first[b]; }
  KV_HD IsoNoiseBackward<T> sample(int b) const {
    IsoNoiseBackward<T> one = this->all;
    one.select(b);
    PixelNoise<T>& noise = one.noise;
    noise.skip_numbers(this->images, b);
    noise.batch = 1, noise.pixels = int64_t(this->images[b].height) * this->images[b].width;
    noise.x = static_cast<T const*>(this->images[b].data), noise.y = static_cast<T*>(this->results[b].data);
    one.grad = static_cast<T const*>(this->grads[b].data);
    if (noise.step == 1) noise.channel_stride = noise.pixels;
    one.sums = sums + 2 * first_of(b), one.chunk = iso_chunk(noise.pixels), one.chunks = iso_chunks(noise.pixels);
    return one;
  }
};

KV_KERNEL(iso_noise_backward, IsoNoiseBackward)
KV_KERNEL(sum_lightness_again, IsoNoiseBackwardList)
KV_KERNEL(iso_noise_list_backward, IsoNoiseBackwardList)

// Colors within [0, 1]; NaN stays.
template <class F>
KV_HD void within_units(F (&c)[3]) {
  for (int i = 0; i < 3; ++i) c[i] = c[i] < 0 ? F(0) : c[i] > 1 ? F(1) : c[i];
}

// The floor of small numbers.
template <class F>
KV_HD F floor_of_small(F x) {
  F const whole = F(int(x));
  return whole > x ? whole - 1 : whole;
}

// Hue in sixths of a turn, lightness and saturation, as rgb_to_hls of kvision.color.
template <class F>
struct Hls {
  F sixths, lightness, saturation;

  KV_HD explicit Hls(F const (&c)[3]) {
    F const high = max(max(c[0], c[1]), c[2]), low = min(min(c[0], c[1]), c[2]), range = high - low, sum = high + low;
    F const room = min(sum, 2 - sum), own = range + F(1e-8);
    F const total = c[0] + c[1] + c[2];
    lightness = total == total ? sum * F(0.5) : total;
    saturation = range / (room == 0 ? F(1) : room + F(1e-8));
    sixths = high == c[0] ? (c[1] - c[2]) / own : high == c[1] ? 2 + (c[2] - c[0]) / own : 4 + (c[0] - c[1]) / own;
  }
  // Sixths of any number of turns.
  KV_HD void to_rgb(F (&c)[3]) const {
    F const depth = saturation * min(lightness, 1 - lightness);
    constexpr int kFirst[] = {5, 3, 1};
    for (int i = 0; i < 3; ++i) {
      F const turned = (sixths + F(kFirst[i])) * F(1. / 6), k = 6 * (turned - floor_of_small(turned));
      F const lack = min(max(min(k, 4 - k), F(0)), F(1));
      c[i] = lightness + depth - 2 * depth * lack;
    }
  }
};

// What the pixels of a sample have in common. If one is NaN, the rate and all results are.
template <class F>
struct IsoSample {
  F sixths, intensity, rate;  // the deviation of hue, and the rate of counts

  // Of the sums of all lightnesses and their squares.
  KV_HD IsoSample(F shift, F intensity, double sum, double squares, double pixels)
      : sixths(6 * shift * intensity), intensity(intensity) {
    double const mean = sum / pixels;
    rate = F(sqrt(max(squares / pixels - mean * mean, 0.))) * intensity;
  }
  template <class Exp, class Sqrt>
  KV_HD void change(F (&c)[3], F u, F normal, Exp const& exponential_of, Sqrt const& root_of) const {
    within_units(c);
    if (rate != rate) {
      c[0] = c[1] = c[2] = rate;
      return;
    }
    Hls<F> own(c);
    own.sixths += sixths * normal;
    F const lighter =
        own.lightness + poisson_quantile(u, rate, exponential_of, root_of) * intensity * (1 - own.lightness);
    own.lightness = lighter < 0 ? F(0) : lighter > 1 ? F(1) : lighter;
    own.to_rgb(c);
    within_units(c);
  }
  // The gradient of the color c, for that of the result, which it replaces.
  template <class V, class Exp, class Sqrt>
  KV_HD void vjp(V const (&c)[3], V (&g)[3], F u, F normal, Exp const& exponential_of, Sqrt const& root_of) const {
    using D = Dual<V, 3>;
    D y[3];
    for (int i = 0; i < 3; ++i) {
      y[i] = constant<D>(F(0));
      y[i].value = c[i] < F(0) ? constant<V>(F(0)) : c[i] > F(1) ? constant<V>(F(1)) : c[i];
      y[i].d[i] = constant<V>(c[i] < F(0) || c[i] > F(1) ? F(0) : F(1));
    }
    color::rgb_to_hls(y, F(1e-8));
    y[0] = y[0] + F(color::kTwoPi / 6) * sixths * normal;
    D const lighter = y[1] + (F(1) - y[1]) * (poisson_quantile(u, rate, exponential_of, root_of) * intensity);
    y[1] = lighter < F(0) ? constant<D>(F(0)) : lighter > F(1) ? constant<D>(F(1)) : lighter;
    color::hls_to_rgb(y);
    V sums[3] = {};
    for (int j = 0; j < 3; ++j)
      for (int i = 0; i < 3; ++i)
        if (!(y[j] < F(0)) && !(y[j] > F(1))) sums[i] = sums[i] + g[j] * y[j].d[i];
    for (int i = 0; i < 3; ++i) g[i] = rate == rate ? sums[i] : constant<V>(rate);
  }
};

}  // namespace kv::augmentation
