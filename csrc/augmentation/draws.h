// Random parameters of augmentations as pure functions of a key, a sample and a draw; draws.py of kvision.augmentation
// defines them. The kinds but beta and normal give the same bits on every device and instruction set.
#pragma once

#include "core/isa.h"
#include "core/philox.h"
#include "core/same_bits.h"

namespace kv::augmentation {

// What they draw is explained in draws.py.
enum class DrawKind : uint8_t {
  chosen,
  uniform,
  integer,
  exponential_of_uniform,
  permutation,
  resized_crop,
  rectangle,
  beta,
  normal,
  uniform_and_affine,
  uniform_of_sample,
  rectangles,
  number
};
constexpr int kDrawKinds = 13;

// How many numbers a kind takes, and how many columns it gives: 0 for as many as its first number says.
constexpr int kDrawNumbers[kDrawKinds] = {0, 3, 4, 3, 3, 6, 6, 3, 3, 5, 3, 10, 1};
constexpr int kDrawColumns[kDrawKinds] = {1, 1, 1, 1, 0, 4, 4, 1, 1, 2, 1, 0, 1};

constexpr int kMaxDraws = 64, kMaxDrawNumbers = 256;  // of a launch, whose parameters take less than 4 KB
constexpr int kMaxListedNumbers = 3072;  // of all samples of a launch, whose parameters take 32,764 bytes at most
constexpr int kFewListedNumbers = 768;   // the longer the parameters of a launch, the longer it takes the host

// Tries for a crop that lies in the image; tries for a number of the gamma distribution, each of which is accepted with
// a probability above .95.
constexpr int kCropTries = 10, kGammaTries = 8;

// The draw that decides about p, and the sample that decides about p_batch.
constexpr uint32_t kChosenDraw = 0, kBatchSample = 0xFFFFFFFF;

// What the words of a sample depend on besides the draw.
struct DrawSource {
  uint64_t key;
  uint32_t sample, position;  // in the batch, and in the chain

  KV_HD PhiloxWords words(uint32_t draw, uint32_t block = 0) const {
    return philox(key, draw, block, sample, position);
  }
  // Whether the sample is chosen by p, and its batch by p_batch.
  KV_HD bool is_chosen(double p, double p_batch) const {
    return (p >= 1 || unit(words(kChosenDraw).w[0]) < p) &&
           (p_batch >= 1 || unit(philox(key, kChosenDraw, 0, kBatchSample, position).w[0]) < p_batch);
  }
};

struct Draw {
  int64_t key;  // or its index, where the keys are on the device
  uint32_t position;
  uint16_t index, column, number, probability;  // the positions of its column, numbers, and p before p_batch
  DrawKind kind;
  bool same_on_batch;
};

// T is the type of the result, float. A launch has samples from first() on.
template <class T>
struct DrawParameters {
  T* result;  // (B, columns)
  int64_t batch;
  int64_t const *keys, *seeds;  // on the device; null: the draws have their keys, there are no seeds
  int64_t key_stride, seed_stride;
  int columns, count;
  Draw draws[kMaxDraws];
  double numbers[kMaxDrawNumbers];

  KV_HD DrawParameters const& common() const { return *this; }
  KV_HD int64_t first() const { return 0; }
  KV_HD int64_t samples() const { return batch; }
  KV_HD DrawSource source(Draw const& d, int64_t b) const { return source_of_sample(d, d.same_on_batch ? 0 : b, b); }
  KV_HD DrawSource source_of_sample(Draw const& d, int64_t b) const { return source_of_sample(d, b, b); }
  // A seed is one of a sample: its index in the batch takes no part.
  KV_HD DrawSource source_of_sample(Draw const& d, int64_t sample, int64_t b) const {
    int64_t const key = seeds ? seeds[b * seed_stride] : keys ? keys[d.key * key_stride] : d.key;
    return {uint64_t(key), seeds ? 0 : uint32_t(sample), d.position};
  }
};

// Some draws of a list, which are for images of different sizes, have numbers of their own for each sample: `width` in
// all. They are those whose numbers begin behind kMaxDrawNumbers. Of samples from `begin` on.
template <class T, int Most = kMaxListedNumbers>
struct DrawListParameters {
  DrawParameters<T> all;
  int64_t begin;
  int count, width;  // samples, and numbers of each
  double listed[Most];

  KV_HD DrawParameters<T> const& common() const { return all; }
  KV_HD int64_t first() const { return begin; }
  KV_HD int64_t samples() const { return count; }
  KV_HD double const* numbers(Draw const& d, int64_t i) const {
    return d.number >= kMaxDrawNumbers ? listed + i * width + (d.number - kMaxDrawNumbers) : all.numbers + d.number;
  }
};

KV_KERNEL(draw_parameters, DrawParameters)
KV_KERNEL(draw_list_parameters, DrawListParameters)
namespace cuda {
template <class T>
int draw_list_parameters(DrawListParameters<T, kFewListedNumbers> const& params, CUstream_st* stream);
}  // namespace cuda

// --- the kinds -------------------------------------------------------------------------------------------------------

KV_HD double uniform_of(uint32_t word, double lowest, double highest) {
  return fused(unit(word), highest - lowest, lowest);
}

// The position of a window among those in [0, size): a whole number.
KV_HD double offset_of(uint32_t word, double size, double side) {
  return up_to(word, uint64_t(int64_t(size - side) + 1));
}

// x, y, width, height.
struct DrawnBox {
  double v[4];
};

// Numbers: lowest and highest fraction of the area, logarithms of the lowest and highest width / height, height, width.
// The first of the tries that lies in the image; else the largest crop of an allowed aspect, in the center.
KV_HD DrawnBox resized_crop(DrawSource const& source, uint32_t index, double const* n) {
  double const height = n[4], width = n[5];
#pragma unroll 1
  for (uint32_t attempt = 0; attempt < kCropTries; ++attempt) {
    PhiloxWords const words = source.words(index, attempt);
    double const area = uniform_of(words.w[0], n[0], n[1]) * (height * width),
                 aspect = exponential(uniform_of(words.w[1], n[2], n[3]));
    double const w = nearest(sqrt(area * aspect)), h = nearest(sqrt(area / aspect));
    if (w >= 1 && w <= width && h >= 1 && h <= height)
      return {{offset_of(words.w[2], width, w), offset_of(words.w[3], height, h), w, h}};
  }
  double const min_ratio = exponential(n[2]), max_ratio = exponential(n[3]);
  bool const too_narrow = width / height<min_ratio, too_wide = width / height> max_ratio;
  double const w = too_wide ? max(nearest(height * max_ratio), 1.) : width,
               h = too_narrow ? max(nearest(width / min_ratio), 1.) : height;
  return {{double(int64_t(width - w) / 2), double(int64_t(height - h) / 2), w, h}};
}

// Numbers: lowest and highest fraction of the area, lowest and highest height / width, height, width.
KV_HD DrawnBox rectangle(DrawSource const& source, uint32_t index, double const* n) {
  PhiloxWords const words = source.words(index);
  double const low = n[2], high = n[3], height = n[4], width = n[5], u = unit(words.w[1]);
  double const area = uniform_of(words.w[0], n[0], n[1]) * (height * width);
  double aspect = fused(u, high - low, low);
  if (low < 1 && high > 1)  // as often wide as high
    aspect = u < 0.5 ? fused(2 * u, 1 - low, low) : fused(2 * u - 1, high - 1, 1);
  double const w = clamp(nearest(sqrt(area / aspect)), 1., width), h = clamp(nearest(sqrt(area * aspect)), 1., height);
  return {{offset_of(words.w[2], width, w), offset_of(words.w[3], height, h), w, h}};
}

// Whole pixels, at least one where the lowest length is above 0, and at most all. Numbers: lowest and highest length,
// whether these are pixels and not fractions of the size.
KV_HD double length_of(uint32_t word, double const* n, double size) {
  double const length =
      n[2] != 0 ? n[0] + up_to(word, uint64_t(int64_t(n[1] - n[0]) + 1)) : nearest(uniform_of(word, n[0], n[1]) * size);
  return clamp(length, n[0] > 0 ? min(1., size) : 0., size);
}

// Numbers: four times the most rectangles, the fewest, those of heights and of widths for length_of, height, width.
template <class T>
KV_HD void draw_rectangles(DrawSource const& source, uint32_t index, double const* n, T* boxes) {
  int const most = int(n[0]) / 4, fewest = int(n[1]);
  int const count = fewest + int(up_to(source.words(index).w[0], uint64_t(most - fewest + 1)));
  double const height = n[8], width = n[9];
  for (int i = 0; i < most; ++i) {
    PhiloxWords const words = source.words(index, uint32_t(1 + i));
    double const h = length_of(words.w[2], n + 2, height), w = length_of(words.w[3], n + 5, width);
    double const box[] = {offset_of(words.w[0], width, w), offset_of(words.w[1], height, h), w, h};
    for (int k = 0; k < 4; ++k) boxes[4 * i + k] = i < count ? T(box[k]) : T(0);
  }
}

// The shuffle of Durstenfeld, in the result itself: entry i is swapped with one of entries i to n - 1.
template <class T>
KV_HD void permute(DrawSource const& source, uint32_t index, int n, T* entries) {
  for (int i = 0; i < n; ++i) entries[i] = T(i);
  PhiloxWords words{};
  for (int i = 0; i < n - 1; ++i) {
    if (i % 4 == 0) words = source.words(index, uint32_t(i / 4));
    int const other = i + int(up_to(words.w[i % 4], uint64_t(n - i)));
    T const current = entries[i];
    entries[i] = entries[other];
    entries[other] = current;
  }
}

// --- kinds that take logarithms and cosines of the C library or CUDA -------------------------------------------------

#if defined(__CUDA_ARCH__)
KV_HD double logarithm(double x) { return ::log(x); }
KV_HD double cos_2pi(double x) { return ::cospi(2 * x); }
#else
KV_HD double logarithm(double x) { return __builtin_log(x); }
KV_HD double cos_2pi(double x) { return __builtin_cos(6.283185307179586477 * x); }
#endif

// The number in (0, 1) of a word.
KV_HD double open_unit(uint32_t word) { return unit(word) + 0x1p-33; }

// A variate of the standard normal distribution, by the transform of Box and Muller.
KV_HD double normal_of(uint32_t a, uint32_t b) { return sqrt(-2 * logarithm(open_unit(a))) * cos_2pi(unit(b)); }

// The logarithm of a variate of the gamma distribution (Marsaglia and Tsang, ACM TOMS 26, 2000). Each try is accepted
// with a probability above .95.
KV_HD double log_gamma_variate(DrawSource const& source, uint32_t index, uint32_t block, double alpha) {
  double const d = (alpha < 1 ? alpha + 1 : alpha) - 1 / 3.0, c = 1 / sqrt(9 * d);
  double log_v = 0, boost = 0;
#pragma unroll 1
  for (uint32_t attempt = 0; attempt < kGammaTries; ++attempt) {
    PhiloxWords const words = source.words(index, block + attempt);
    if (attempt == 0 && alpha < 1) boost = logarithm(open_unit(words.w[3])) / alpha;
    double const x = normal_of(words.w[0], words.w[1]), root = fused(c, x, 1), v = root * root * root;
    if (v <= 0) continue;
    double const log = logarithm(v);
    if (logarithm(open_unit(words.w[2])) < fused(0.5 * x, x, d) + d * (log - v)) {
      log_v = log;
      break;
    }
  }
  return log_v + logarithm(d) + boost;
}

// --- one draw of one sample ------------------------------------------------------------------------------------------

// With numbers `n`.
template <class T>
KV_HD void draw_sample(DrawParameters<T> const& p, double const* n, Draw const& d, int64_t b) {
  DrawSource const source = p.source(d, b);
  T* const result = p.result + b * p.columns + d.column;
  double const* const probability = p.numbers + d.probability;
  bool const chosen = source.is_chosen(probability[0], probability[1]);
  switch (d.kind) {
    case DrawKind::chosen:
      result[0] = T(chosen);
      break;
    case DrawKind::uniform:
      result[0] = T(chosen ? uniform_of(source.words(d.index).w[0], n[0], n[1]) : n[2]);
      break;
    case DrawKind::integer:
      result[0] = T(chosen ? fused(n[1], up_to(source.words(d.index).w[0], uint64_t(n[2])), n[0]) : n[3]);
      break;
    case DrawKind::exponential_of_uniform:
      result[0] = T(chosen ? exponential(uniform_of(source.words(d.index).w[0], n[0], n[1])) : n[2]);
      break;
    case DrawKind::permutation:
      if (chosen)
        permute(source, d.index, int(n[0]), result);
      else
        for (int i = 0; i < int(n[0]); ++i) result[i] = T(fused(n[2], i, n[1]));
      break;
    case DrawKind::resized_crop:
    case DrawKind::rectangle: {
      DrawnBox box{{0, 0, 0, 0}};
      if (d.kind == DrawKind::rectangle) {
        if (chosen) box = rectangle(source, d.index, n);
      } else {
        box = chosen ? resized_crop(source, d.index, n) : DrawnBox{{0, 0, n[5], n[4]}};
      }
      for (int i = 0; i < 4; ++i) result[i] = T(box.v[i]);
      break;
    }
    case DrawKind::beta:  // the ratio of a gamma variate to the sum of two
      result[0] = T(chosen ? 1 / (1 + exponential(log_gamma_variate(source, d.index, 1 << 16, n[1]) -
                                                  log_gamma_variate(source, d.index, 0, n[0])))
                           : n[2]);
      break;
    case DrawKind::normal:
      if (chosen) {
        PhiloxWords const words = source.words(d.index);
        result[0] = T(fused(n[1], normal_of(words.w[0], words.w[1]), n[0]));
      } else {
        result[0] = T(n[2]);
      }
      break;
    case DrawKind::uniform_and_affine:
      // The second column is made of the first one as it is stored.
      result[0] = T(chosen ? uniform_of(source.words(d.index).w[0], n[0], n[1]) : n[4]);
      result[1] = T(fused(n[2], chosen ? double(result[0]) : n[4], n[3]));
      break;
    case DrawKind::uniform_of_sample:  // also under same_on_batch
      result[0] = T(chosen ? uniform_of(p.source_of_sample(d, b).words(d.index).w[0], n[0], n[1]) : n[2]);
      break;
    case DrawKind::rectangles:
      if (chosen)
        draw_rectangles(source, d.index, n, result);
      else
        for (int i = 0; i < int(n[0]); ++i) result[i] = T(0);
      break;
    case DrawKind::number:
      result[0] = T(n[0]);
      break;
  }
}

// Sample i of a launch.
template <class T>
KV_HD void draw_sample(DrawParameters<T> const& p, Draw const& d, int64_t b) {
  draw_sample(p, p.numbers + d.number, d, b);
}
template <class T, int Most>
KV_HD void draw_sample(DrawListParameters<T, Most> const& p, Draw const& d, int64_t i) {
  draw_sample(p.all, p.numbers(d, i), d, p.begin + i);
}

}  // namespace kv::augmentation
