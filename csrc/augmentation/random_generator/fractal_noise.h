// Fractal noise by the diamond-square algorithm, whose numbers are drawn. random_generator/fractal_noise.py of
// kvision.augmentation defines it.
#pragma once

#include "augmentation/noise.h"
#include "contrib/diamond_square.h"

namespace kv::augmentation {

// A level of all planes: the first one puts pixels between noise at the corners and along one axis, the next ones
// between the pixels of the level before it. T is the type of the result, float or double; levels are double.
template <class T>
struct FractalNoise {
  PixelNoise<double> noise;  // its images are not used; its draw is that of the first level
  T const* roughness;        // (B,)
  double *coarse, *fine;     // (B, C, h, w), of the level before; (B, C, 2 h - 1, 2 w - 1), null of the last one
  T* y;                      // (B, C, height, width): the upper left part of the last one
  int64_t batch, channels, height, width, roughness_stride;
  int64_t h, w;  // of the coarse level; of the first one the corners
  int level;     // 0 is the first one
  int levels;
  bool is_upright;  // the first one has two columns, not two rows, of noise

  KV_HD int64_t fine_height() const { return 2 * h - 1; }
  KV_HD int64_t fine_width() const { return 2 * w - 1; }
  // Blocks of a plane in a map of so many numbers.
  static KV_HD int64_t blocks(int64_t numbers) { return (numbers + 3) / 4; }
  // The words of four adjacent numbers of a plane of the noise of a level.
  KV_HD PhiloxWords words(DrawSource const& source, int64_t c, int64_t numbers, int64_t block) const {
    return source.words(noise.draw + uint32_t(level), uint32_t(c * blocks(numbers) + block));
  }
  static KV_HD double number_of(uint32_t word) { return (word ^ 0x80000000u) * 0x1p-32; }
  // The noise at the corners of the first level.
  KV_HD double corner(DrawSource const& source, int64_t c, int64_t v, int64_t u) const {
    int64_t const i = is_upright ? u * h + v : v * w + u;
    return number_of(words(source, c, h * w, i / 4).w[i % 4]);
  }
  // The weight of noise in a level, of a sample.
  KV_HD double weight(int64_t b) const {
    double const factor = double(roughness[b * roughness_stride]);
    double product = level > 0 ? 1 : 0;
    for (int i = 0; i < level; ++i) product *= factor;
    return product;
  }
  KV_HD bool is_last() const { return level + 1 == levels; }
  KV_HD void next() { h = fine_height(), w = fine_width(), ++level; }
};

KV_KERNEL(fractal_noise, FractalNoise)

}  // namespace kv::augmentation
