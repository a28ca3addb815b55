// Fractal noise by the diamond-square algorithm, whose numbers are drawn. random_generator/fractal_noise.py of
// kvision.augmentation defines it.
#pragma once

#include "augmentation/noise.h"
#include "contrib/diamond_square.h"
#include "core/image_list.h"

namespace kv::augmentation {

// A level of all planes: the first one puts pixels between noise at the corners and along one axis, the next ones
// between the pixels of the level before it. T is the type of the result, float or double; levels are double.
template <class T>
struct FractalNoise {
  PixelNoise<double> noise;  // its images are not used; its draw is that of the first level
  T const* roughness;        // (B,)
  double *coarse, *fine;     // (B, C, h, w), of the level before; (B, C, 2 h - 1, 2 w - 1), null of the last one
  int64_t coarse_plane, fine_plane;  // elements of a plane; more than it needs in lists
  T* y;                              // (B, C, tall, wide): the upper left part of the last one, and 0 beyond it
  int64_t batch, channels, height, width, tall, wide, roughness_stride;
  int64_t h, w;  // of the coarse level; of the first one the corners
  int level;     // 0 is the first one
  int levels;
  bool is_upright;  // the first one has two columns, not two rows, of noise

  // Begins with the first level, of a map of a size. It has 3 pixels along its shorter side.
  KV_HD void start(int64_t rows, int64_t columns) {
    height = rows, width = columns;
    int const down = halvings(rows), across = halvings(columns);
    levels = min(down, across), level = 0;
    h = (int64_t(1) << (down - levels)) + 1, w = (int64_t(1) << (across - levels)) + 1;
    is_upright = w == 2;
  }
  // How often a side of at least n pixels, 2^k + 1, halves: at least once, to 3.
  static KV_HD int halvings(int64_t n) {
    int k = 1;
    while ((int64_t(1) << k) + 1 < n) ++k;
    return k;
  }
  // Leaves the parameters and the memory of sample b.
  KV_HD void select(int64_t b) {
    noise.skip(b);
    roughness += b * roughness_stride;
    y += b * channels * tall * wide;
    if (coarse) coarse += b * channels * coarse_plane;
    if (fine) fine += b * channels * fine_plane;
  }
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

// The same of samples of different sizes, in planes as large as the largest of them.
template <class T>
struct FractalNoiseList {
  FractalNoise<T> all;  // of which the level counts, too
  int count;
  struct Size {
    int height, width;
  } sizes[kMaxListed];

  // A sample as a batch of one, at the level of all; it may have fewer.
  KV_HD FractalNoise<T> sample(int b) const {
    FractalNoise<T> one = all;
    one.select(b);
    one.batch = 1;
    one.start(sizes[b].height, sizes[b].width);
    while (one.level < all.level) one.next();
    return one;
  }
};

KV_KERNEL(fractal_noise, FractalNoise)
KV_KERNEL(fractal_noise_list, FractalNoiseList)

}  // namespace kv::augmentation
