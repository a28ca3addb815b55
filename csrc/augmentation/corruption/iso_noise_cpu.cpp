// The noise of a sensor on the CPU: chunks [begin, end) of all samples. Compiled once per instruction set.
#include "core/lanes.h"

namespace kv::color {
namespace {

// The functions of numbers that formulas of colors use.
template <class F>
KV_HD F floor_of(F x) {
  return F(__builtin_floor(double(x)));
}
template <class F>
KV_HD F absolute(F x) {
  return x < 0 ? -x : x;
}
template <class F>
KV_HD F reciprocal(F x) {
  return 1 / x;
}
template <class F>
KV_HD F quotient(F a, F b) {
  return a / b;
}
template <class F>
KV_HD F nan_max(F a, F b) {
  return a > b || a != a ? a : b;
}
template <class F>
KV_HD F nan_min(F a, F b) {
  return a < b || a != a ? a : b;
}

}  // namespace
}  // namespace kv::color

// Included after those, which its formulas use.
#include "augmentation/corruption/iso_noise.h"

namespace kv::augmentation::KV_ISA {

namespace {

template <class T>
KV_HD void read_color(PixelNoise<T> const& p, int64_t at, Compute<T> (&c)[3]) {
  for (int i = 0; i < 3; ++i) c[i] = load<1>(p.x + at + i * p.channel_stride) / p.full_range;
}

KV_HD void normals(PhiloxWords const& words, float (&n)[4]) {
  for (int i = 0; i < 4; i += 2) {
    Lanes<float, 1> cosine, sine;
    normal_pair<1>(Lanes<int32_t, 1>(int32_t(words.w[i])), Lanes<int32_t, 1>(int32_t(words.w[i + 1])), cosine, sine);
    n[i] = cosine, n[i + 1] = sine;
  }
}
KV_HD void normals(PhiloxWords const& words, double (&n)[4]) { normals_of(words, n); }

}  // namespace

template <class T>
void sum_lightness(IsoNoise<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t unit = begin; unit < end; ++unit) {
    int64_t const b = unit / p.chunks, i = unit % p.chunks;
    double sum = 0, squares = 0;
    for (int64_t pixel = p.begin(i); pixel < p.end(i); ++pixel) {
      F c[3];
      read_color(p.noise, p.noise.offset(b, 0) + pixel * p.noise.step, c);
      within_units(c);
      double const lightness = Hls<F>(c).lightness;
      sum += lightness, squares += lightness * lightness;
    }
    p.sums[2 * unit] = sum, p.sums[2 * unit + 1] = squares;
  }
}

namespace {

template <class T>
KV_HD IsoSample<Compute<T>> iso_sample(IsoNoise<T> const& p, int64_t b) {
  double sums[2] = {};
  for (int64_t k = 0; k < 2 * p.chunks; ++k) sums[k % 2] += p.sums[2 * b * p.chunks + k];
  Compute<T> const* const parameters = p.noise.parameters + b * p.noise.parameter_stride;
  return {parameters[0], parameters[1], sums[0], sums[1], double(p.noise.pixels)};
}

// Calls use(sample, where the pixel begins, its uniform and its normal number) for the chosen pixels of chunks
// [begin, end), and keep(where a pixel begins) for the others.
template <class T, class Use, class Keep>
KV_HD void for_each_pixel(IsoNoise<T> const& p, int64_t begin, int64_t end, Use const& use, Keep const& keep) {
  using F = Compute<T>;
  PixelNoise<T> const& noise = p.noise;
  for (int64_t unit = begin; unit < end; ++unit) {
    int64_t const b = unit / p.chunks, i = unit % p.chunks, first = noise.offset(b, 0);
    IsoSample<F> const sample = iso_sample(p, b);
    float const* const maps = noise.uniform ? noise.numbers(b) : nullptr;
    for (int64_t four = p.begin(i); four < p.end(i); four += 4) {
      F u[4], n[4];
      int const count = int(min(p.end(i) - four, int64_t(4)));
      if (maps) {
        for (int k = 0; k < count; ++k) u[k] = maps[four + k], n[k] = maps[noise.pixels + four + k];
      } else {
        PhiloxWords const words = noise.source(b).words(noise.draw, uint32_t(four / 4));
        for (int k = 0; k < 4; ++k) u[k] = unit_of(words.w[k]);
        normals(noise.source(b).words(noise.draw + 1, uint32_t(four / 4)), n);
      }
      for (int k = 0; k < count; ++k) {
        int64_t const at = first + (four + k) * noise.step;
        noise.is_chosen(b) ? use(sample, at, u[k], n[k]) : keep(at);
      }
    }
  }
}

}  // namespace

template <class T>
void iso_noise(IsoNoise<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  PixelNoise<T> const& noise = p.noise;
  for_each_pixel(
      p, begin, end,
      [&](IsoSample<F> const& sample, int64_t at, F u, F n) KV_INLINE {
        F c[3];
        read_color(noise, at, c);
        sample.change(
            c, u, n, [](F exponent) KV_INLINE { return F(__builtin_exp(exponent)); },
            [](F square) KV_INLINE { return F(__builtin_sqrt(square)); });
        for (int j = 0; j < 3; ++j)
          store<1>(noise.y + at + j * noise.channel_stride, Lanes<F, 1>(c[j] * noise.full_range));
      },
      [&](int64_t at) KV_INLINE {
        for (int j = 0; j < 3; ++j) noise.y[at + j * noise.channel_stride] = noise.x[at + j * noise.channel_stride];
      });
}

template <class T>
void iso_noise_backward(IsoNoiseBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  PixelNoise<T> const& noise = p.noise;
  for_each_pixel(
      p, begin, end,
      [&](IsoSample<F> const& sample, int64_t at, F u, F n) KV_INLINE {
        Lanes<F, 1> c[3], g[3];
        for (int j = 0; j < 3; ++j) {
          c[j] = load<1>(noise.x + at + j * noise.channel_stride);
          g[j] = load<1>(p.grad + at + j * noise.channel_stride);
        }
        sample.vjp(
            c, g, u, n, [](F exponent) KV_INLINE { return F(__builtin_exp(exponent)); },
            [](F square) KV_INLINE { return F(__builtin_sqrt(square)); });
        for (int j = 0; j < 3; ++j) store<1>(noise.y + at + j * noise.channel_stride, g[j]);
      },
      [&](int64_t at) KV_INLINE {
        for (int j = 0; j < 3; ++j) noise.y[at + j * noise.channel_stride] = p.grad[at + j * noise.channel_stride];
      });
}

template <class T>
void sum_lightness_list(IsoNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.noise.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::sum_lightness(p.sample(b), first, last); });
}
template <class T>
void iso_noise_list(IsoNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.noise.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::iso_noise(p.sample(b), first, last); });
}

template <class T>
void sum_lightness_again(IsoNoiseBackwardList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::sum_lightness<T>(p.sample(b), first, last); });
}
template <class T>
void iso_noise_list_backward(IsoNoiseBackwardList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::iso_noise_backward(p.sample(b), first, last); });
}

KV_INSTANTIATE_WITH_BYTES(sum_lightness, IsoNoise)
KV_INSTANTIATE_WITH_BYTES(iso_noise, IsoNoise)
KV_INSTANTIATE_WITH_BYTES(sum_lightness_list, IsoNoiseList)
KV_INSTANTIATE_WITH_BYTES(iso_noise_list, IsoNoiseList)
KV_INSTANTIATE(iso_noise_backward, IsoNoiseBackward)
KV_INSTANTIATE(sum_lightness_again, IsoNoiseBackwardList)
KV_INSTANTIATE(iso_noise_list_backward, IsoNoiseBackwardList)

}  // namespace kv::augmentation::KV_ISA
