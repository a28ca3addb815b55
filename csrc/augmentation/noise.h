// Noise of images, a function of a key, the sample and the pixel: normal and uniform noise, and salt and pepper.
// noise.py of kvision.augmentation defines them. The words of a pixel are those of the
// block at its position / 4 in the plane.
#pragma once

#include "augmentation/draws.h"
#include "core/image_list.h"
#include "core/normal.h"

namespace kv::augmentation {

// How noise changes pixels, as a sum of flags.
namespace NoiseForm {
constexpr int multiply = 1, clamp = 2,
              shared = 4;  // of normal and uniform noise: factors; within the range; of all channels
constexpr int by_channel = 8,
              random = 16;  // of hit pixels: those of each channel; they get uniform noise of the next draw
constexpr int unit = 32;    // of uniform noise: in [0, 1] in place of [-1, 1]
constexpr int all = 63;     // of those that operators take
constexpr int alone = 64;   // normal and uniform noise takes the place of the images
}  // namespace NoiseForm

// Dense images, planar or channels-last.
template <class T>
struct PixelNoise {
  T const* x;
  T* y;
  int64_t batch, channels, pixels;  // pixels of a plane
  int64_t channel_stride, step;     // from a pixel to the next channel, and to the next pixel
  Compute<T> const* parameters;  // (B, 2): mean and standard deviation or half of the width, or amount and fraction of
                                 // salt; for full_range 1
  float const* chosen;           // (B,), 0 for samples that pass unchanged; null: all are chosen
  Compute<T> full_range, salt;   // 255 for bytes, 1 for floats; the value of salt
  int64_t const *keys, *seeds;   // on the device; null: `key` is the key, there are no seeds
  int64_t key_stride, seed_stride, parameter_stride, chosen_stride;
  int64_t key;               // or its index, where the keys are on the device
  float const* uniform;      // planes of numbers of each image, one image after the other, in place of words; or null
  int64_t uniform_planes;    // of each image
  Compute<T> const* values;  // of hit pixels, of each channel, or one with a stride of 0, in place of salt and pepper;
  int64_t value_stride;      // or null
  uint32_t position, draw;
  int64_t first_sample;  // the number of the first image among all samples
  int form;
  bool same_on_batch;

  KV_HD DrawSource source(int64_t b) const {
    int64_t const own = seeds ? seeds[b * seed_stride] : keys ? keys[key * key_stride] : key;
    return {uint64_t(own), seeds || same_on_batch ? 0 : uint32_t(first_sample + b), position};
  }
  // Leaves samples out at the front; images are not among what it changes.
  KV_HD void skip(int64_t count) {
    parameters += count * parameter_stride;
    if (chosen) chosen += count * chosen_stride;
    if (seeds) seeds += count * seed_stride;
    first_sample += count;
  }
  KV_HD bool is_chosen(int64_t b) const { return !chosen || chosen[b * chosen_stride] != 0; }
  KV_HD int64_t offset(int64_t b, int64_t c) const { return b * channels * pixels + c * channel_stride; }
  // The numbers that are given for sample b.
  KV_HD float const* numbers(int64_t b) const { return uniform + b * uniform_planes * pixels; }
  // Leaves out the given numbers of images before number b of a list. Only replays have them, so that the sum is no
  // matter.
  KV_HD void skip_numbers(ListedImage const* images, int b) {
    if (uniform) uniform += uniform_planes * pixels_before(images, b);
  }
  // Blocks of four pixels in a plane. Planes begin with a block of their own.
  KV_HD int64_t blocks() const { return (pixels + 3) / 4; }
  KV_HD bool has(int flag) const { return form & flag; }
  // The number of a block for the words of normal and uniform noise.
  KV_HD uint32_t numbered(int64_t c, int64_t block) const {
    return uint32_t((has(NoiseForm::shared) ? 0 : c * blocks()) + block);
  }
  // Pixels x with noise n.
  template <class V>
  KV_HD V noisy(V x, V n) const {
    using F = Compute<T>;
    V y = has(NoiseForm::alone) ? n : x + n;
    if (has(NoiseForm::multiply)) y = x * n;
    if (has(NoiseForm::clamp)) {  // NaN stays
      V const low = V{}, high = V{} + F(full_range);
      y = y < low ? low : y;
      y = y > high ? high : y;
    }
    return y;
  }
};

// Pixels of a unit of work on the CPU.
constexpr int kNoiseChunk = 1024;

KV_KERNEL(gaussian_noise, PixelNoise)
KV_KERNEL(uniform_noise, PixelNoise)
KV_KERNEL(salt_and_pepper, PixelNoise)
KV_KERNEL(shot_noise, PixelNoise)

// The same of images of different sizes: `all` is what the samples of the table have in common.
template <class T>
struct PixelNoiseList {
  PixelNoise<T> all;
  ListedSamples list;

  // A sample as a batch of one.
  KV_HD PixelNoise<T> sample(int b) const {
    PixelNoise<T> one = all;
    one.skip(b);
    one.skip_numbers(list.images, b);
    one.batch = 1;
    one.x = static_cast<T const*>(list.images[b].data);
    one.y = static_cast<T*>(list.results[b].data);
    one.pixels = int64_t(list.images[b].height) * list.images[b].width;
    if (one.step == 1) one.channel_stride = one.pixels;
    return one;
  }
};

// On the CPU an item is a chunk of pixels, on CUDA kListedRuns of a block of threads, which finds its sample once.
KV_KERNEL(gaussian_noise_list, PixelNoiseList)
KV_KERNEL(uniform_noise_list, PixelNoiseList)
KV_KERNEL(salt_and_pepper_list, PixelNoiseList)
KV_KERNEL(shot_noise_list, PixelNoiseList)

constexpr int kNoiseThreads = 256, kListedRuns = 4;

// What becomes of the pixels of a word: with unit(word) below the amount they are hit, below that times `fraction` by
// salt.
struct SaltAndPepper {
  uint64_t salt, pepper;  // the first words that are not hit

  template <class F>
  KV_HD SaltAndPepper(F amount, F fraction)
      : salt(words_below(double(amount) * double(fraction))), pepper(words_below(double(amount))) {}
  static KV_HD uint64_t words_below(double x) {
    double const bound = x > 0 ? min(x, 1.) * 0x1p32 : 0;
    uint64_t const whole = uint64_t(bound);
    return whole + (double(whole) < bound);
  }
  KV_HD bool is_hit(uint32_t word) const { return word < pepper; }
  KV_HD bool is_salt(uint32_t word) const { return word < salt; }
};

// Normal variates in double, of the words of one block.
KV_HD void normals_of(PhiloxWords const& words, double (&n)[4]) {
#pragma unroll
  for (int i = 0; i < 4; i += 2) {
    uint32_t const a = words.w[i], b = words.w[i + 1];
    double const u = float(int32_t(a >> 1)) * 0x1p-31f + 0x1p-32f;
    double const radius = sqrt(-2 * logarithm(u)), turns = (b >> 30) * 0.25 + int32_t(b << 2) * 0x1p-34;
    n[i] = radius * cos_2pi(turns);
    n[i + 1] = radius * cos_2pi(turns - 0.25);
  }
}

// What a hit pixel gets for a word, in [0, 1).
template <class F>
KV_HD F fill_of(uint32_t word) {
  return F(word >> 8) * F(0x1p-24);
}

// The same number as that of symmetric_of, in [0, 1].
template <class F = float>
KV_HD F unit_of(uint32_t word) {
  return F(word ^ 0x80000000u) * F(0x1p-32);
}

// A uniform variate in [-1, 1] of a word.
template <class F>
KV_HD F symmetric_of(uint32_t word) {
  return F(int32_t(word)) * F(0x1p-31);
}

// The quantile of the standard normal distribution, relatively within 1e-6 (Giles, Approximating the erfinv function,
// GPU Computing Gems, 2011).
template <class F>
KV_HD F normal_quantile(F u) {
  F const x = 2 * u - 1;
  F w = -F(logarithm(double((1 - x) * (1 + x)))), sum;
  if (w < 5) {
    constexpr float c[] = {2.81022636e-8f,  3.43273939e-7f,  -3.5233877e-6f, -4.39150654e-6f, 2.1858087e-4f,
                           -1.25372503e-3f, -4.17768164e-3f, 0.246640727f,   1.50140941f};
    w -= F(2.5);
    sum = c[0];
    for (int i = 1; i < 9; ++i) sum = sum * w + c[i];
  } else {
    constexpr float c[] = {-2.00214257e-4f, 1.00950558e-4f, 1.34934322e-3f, -3.67342844e-3f, 5.73950773e-3f,
                           -7.6224613e-3f,  9.43887047e-3f, 1.00167406f,    2.83297682f};
    w = F(sqrt(double(w))) - 3;
    sum = c[0];
    for (int i = 1; i < 9; ++i) sum = sum * w + c[i];
  }
  return F(1.4142135623730951) * sum * x;
}

// The least count whose cumulative probability is at least u. Up to 64 by the sum of probabilities; above by the
// expansion of Giles (Algorithm 955, ACM TOMS 42, 2016), one off with a probability of 1e-4 at most.
template <class F, class Exp, class Sqrt>
KV_HD F poisson_quantile(F u, F rate, Exp const& exponential_of, Sqrt const& root_of) {
  if (rate <= 64) {
    F probability = exponential_of(-rate), sum = probability, count = 0;
    while (sum < u) {
      count += 1;
      probability *= rate / count;
      F const next = sum + probability;
      if (next == sum && count > rate) break;
      sum = next;
    }
    return count;
  }
  F const z = normal_quantile(min(max(u, F(1e-7)), F(1 - 1e-7))), root = root_of(rate);
  F const correction = (F(1) / 3 + z * z / 6) - z * (F(1) / 36 + z * z / 72) / root;
  return F(int64_t(max(rate + root * z + correction, F(0))));
}

// Pixels of light to a power, counted in photons of a step, the first parameter; the power is the second one. NaN
// stays.
template <class F, class Pow, class Exp, class Sqrt>
KV_HD F shot(F x, F u, F step, F power, Pow const& power_of, Exp const& exponential_of, Sqrt const& root_of) {
  if (x != x) return x;
  x = min(max(x, F(0)), F(1));
  F const light = power == 1 ? x : power_of(x, power);
  F const y = min(poisson_quantile(u, light / step, exponential_of, root_of) * step, F(1));
  return power == 1 ? y : power_of(y, 1 / power);
}

}  // namespace kv::augmentation
