// Noise of images, a function of a key, the sample and the pixel: normal and uniform noise, and salt and pepper.
// noise.py of kvision.augmentation defines them. The words of a pixel are those of the block at its position / 4 in the
// plane. Included by noise_cpu.cpp, noise.cu and noise_op.cpp.
#pragma once

#include "augmentation/draws.h"
#include "core/normal.h"

namespace kv::augmentation {

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
  int64_t key;  // or its index, where the keys are on the device
  uint32_t position, draw;
  bool same_on_batch;

  KV_HD DrawSource source(int64_t b) const {
    int64_t const own = seeds ? seeds[b * seed_stride] : keys ? keys[key * key_stride] : key;
    return {uint64_t(own), seeds || same_on_batch ? 0 : uint32_t(b), position};
  }
  KV_HD bool is_chosen(int64_t b) const { return !chosen || chosen[b * chosen_stride] != 0; }
  KV_HD int64_t offset(int64_t b, int64_t c) const { return b * channels * pixels + c * channel_stride; }
  // Blocks of four pixels in a plane. Planes begin with a block of their own.
  KV_HD int64_t blocks() const { return (pixels + 3) / 4; }
};

// Pixels of a unit of work on the CPU.
constexpr int kNoiseChunk = 1024;

KV_KERNEL(gaussian_noise, PixelNoise)
KV_KERNEL(uniform_noise, PixelNoise)
KV_KERNEL(salt_and_pepper, PixelNoise)

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

// A uniform variate in [-1, 1] of a word.
template <class F>
KV_HD F symmetric_of(uint32_t word) {
  return F(int32_t(word)) * F(0x1p-31);
}

}  // namespace kv::augmentation
