// Model inputs on the CPU: rows [begin, end) of the patches of all images. Compiled once per instruction set.
//
// Bytes: two rows of the image at a time are resized along x, to pairs of levels. The pairs of a band, which a few
// lines hold, are weighted by one instruction a pair, and the sums are normalized and copied to the patches.
//
//   rows 2 k, 2 k + 1   -> line of pairs (a | b << 16)    exact sums of 16-bit weights, rounded and saturated
//   lines of a band     -> a row of the resized image     likewise
//
// Floating-point images are resized by the kernel of resize.h.
#include "contrib/vision_patches.h"
#include "core/bytes.h"
#include "core/scratch.h"

namespace kv::contrib::KV_ISA {
namespace {

using geometry::Resize;
using geometry::ResizeAxis;

// Integer weights of the pixels of an axis. Not inline: they take most of the time to compile.
struct Weights {
  int taps, bits = 0;
  Scratch<int> first;
  Scratch<int16_t> weights;  // `taps` of each pixel, 0 after the last one

  [[gnu::noinline]] explicit Weights(ResizeAxis const& axis)
      : taps((axis.max_taps + 2) / 2 * 2), first(axis.result), weights(int64_t(axis.result) * taps) {
    Scratch<double> exact(int64_t(axis.result) * taps);
    double largest = 0;
    for (int i = 0; i < axis.result; ++i) {
      geometry::Band<double> const band = geometry::window_band<double>(axis, i);
      double* const to = exact.data + int64_t(i) * taps;
      double sum = 0;
      for (int k = 0; k < taps; ++k) {
        int const j = band.first + k;
        to[k] = j <= band.last ? geometry::window_at<double>(axis, j * axis.den - axis.center(i)) : 0;
        sum += to[k];
      }
      first.data[i] = band.first;
      for (int k = 0; k < taps; ++k) to[k] /= sum, largest = max(largest, to[k]);
    }
    bits = weight_bits(largest);
    for (int64_t k = 0; k < int64_t(axis.result) * taps; ++k) weights.data[k] = to_weight(exact.data[k], bits);
  }
  KV_HD int16_t const* of(int64_t i) const { return weights.data + i * taps; }
};

// Two levels of bytes in each number, which follow from two sums.
template <int N>
KV_HD Lanes<int32_t, N> paired_levels(Lanes<int32_t, N> a, Lanes<int32_t, N> b) {
#if defined(__AVX2__)
  if constexpr (N == 8) {
    __m256i const order = _mm256_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15, 0, 1, 8, 9, 2, 3, 10,
                                           11, 4, 5, 12, 13, 6, 7, 14, 15);
    __m256i const words = _mm256_min_epu16(_mm256_packus_epi32((__m256i)a, (__m256i)b), _mm256_set1_epi16(255));
    return (Lanes<int32_t, N>)_mm256_shuffle_epi8(words, order);
  }
#endif
  auto const level = [](Lanes<int32_t, N> v) {
    v = v > 0 ? v : Lanes<int32_t, N>{};
    return Lanes<int32_t, N>(v < 255 ? v : Lanes<int32_t, N>{} + 255);
  };
  return level(a) | level(b) << 16;
}

// Levels of bytes from sums, as numbers.
template <int N>
KV_HD Lanes<float, N> levels_of(Lanes<int32_t, N> v) {
#if defined(__AVX2__)
  if constexpr (N == 8) {
    __m256i const level =
        _mm256_min_epi32(_mm256_max_epi32((__m256i)v, _mm256_setzero_si256()), _mm256_set1_epi32(255));
    return (Lanes<float, N>)_mm256_cvtepi32_ps(level);
  }
#endif
  v = v > 0 ? v : Lanes<int32_t, N>{};
  v = v < 255 ? v : Lanes<int32_t, N>{} + 255;
  return __builtin_convertvector(v, Lanes<float, N>);
}

// What `store` does with finite numbers.
template <int N>
KV_HD void store_finite(float* p, Lanes<float, N> v) {
  store<N>(p, v);
}
template <int N>
KV_HD void store_finite(BFloat16* p, Lanes<float, N> v) {
#if defined(__AVX2__)
  if constexpr (N == 8) {
    auto bits = (Lanes<uint32_t, N>)v;
    bits = (bits + 0x7fff + ((bits >> 16) & 1)) >> 16;
    __m128i const low = _mm256_castsi256_si128((__m256i)bits), high = _mm256_extracti128_si256((__m256i)bits, 1);
    return _mm_storeu_si128((__m128i*)p, _mm_packus_epi32(low, high));
  }
#endif
  store<N>(p, v);
}

// Resizes two rows of bytes along x. N pixels of the result, in parts of four, read the taps 2 j and 2 j + 1 of all of
// them from 16 bytes that begin 2 j pixels after the first one of a part. Parts whose taps are farther apart are
// computed one by one.
struct ByteColumns {
  static constexpr int N = kPartInts, kBytes = 16 * kParts;
  Weights const weights;
  int64_t width, groups;
  int pairs;
  bool are_near = true, are_nearest = true;  // within 16 bytes the taps of a pair of all of a part, those of all pairs
  Scratch<int> from;                         // by group and part
  Scratch<uint8_t> index;                    // by group
  Scratch<int16_t> factors;                  // by group and pair

  explicit ByteColumns(ResizeAxis const& axis)
      : weights(axis),
        width(axis.result),
        groups((width + N - 1) / N),
        pairs(weights.taps / 2),
        from(groups * kParts),
        index(groups * kBytes),
        factors(groups * pairs * 2 * N) {
    for (int64_t g = 0; g < groups; ++g)
      for (int i = 0; i < N; ++i) {
        int64_t const x = min(g * N + i, width - 1);
        int& begin = from.data[g * kParts + i / 4];
        if (i % 4 == 0) begin = weights.first.data[x];
        int const distance = weights.first.data[x] - begin;
        are_near = are_near && distance + 1 < 16;
        are_nearest = are_nearest && distance + 2 * pairs <= 16;
        uint8_t* const to = index.data + g * kBytes + 4 * i;
        to[0] = uint8_t(distance), to[2] = uint8_t(distance + 1), to[1] = to[3] = kNoByte;
        for (int j = 0; j < pairs; ++j)
          for (int k = 0; k < 2; ++k)
            factors.data[((g * pairs + j) * N + i) * 2 + k] = g * N + i < width ? weights.of(x)[2 * j + k] : 0;
      }
  }
  // How many bytes after the end of a row may be read, and numbers after the end of a line written.
  KV_HD int64_t margin() const { return 2 * pairs + 16; }
  static constexpr int64_t kLineMargin = N;

  KV_HD void write(uint8_t const* a, uint8_t const* b, int32_t* line) const {
    if (!are_near) return write_far(a, b, line);
    if (pairs == 3 && are_nearest) return write_near<3, true>(a, b, line);
    if (pairs == 3) return write_near<3>(a, b, line);
    if (pairs == 2) return write_near<2>(a, b, line);
    write_near<0>(a, b, line);
  }

 private:
  // Once: all pairs are read at once. Special case: 1.1 times as fast, one thread.
  template <int Pairs, bool Once = false>
  KV_HD void write_near(uint8_t const* a, uint8_t const* b, int32_t* line) const {
    using Words = Lanes<int16_t, 2 * N>;
    int const count = Pairs ? Pairs : pairs;
    int16_t const* next = factors.data;
    for (int64_t g = 0; g < groups; ++g) {
      int const first = from.data[g * kParts], second = from.data[g * kParts + kParts - 1];
      auto const order = load_bytes<kBytes>(index.data + g * kBytes);
      Lanes<int32_t, N> sum_a = broadcast<N>(int32_t(1) << weights.bits >> 1), sum_b = sum_a;
      auto const parts_of = [&](uint8_t const* row) { return load_parts<kParts>(row + first, row + second); };
      auto const bytes_a = parts_of(a), bytes_b = parts_of(b);
      for (int j = 0; j < count; ++j, next += 2 * N) {
        Words const weight = read_lanes<2 * N>(next);
        auto const taps = [&](uint8_t const* row, auto bytes) {
          if constexpr (Once)
            return __builtin_bit_cast(Words, permuted_bytes(bytes, order + uint8_t(2 * j)));
          else
            return __builtin_bit_cast(Words, permuted_bytes(parts_of(row + 2 * j), order));
        };
        sum_a += pair_products<N>(taps(a, bytes_a), weight);
        sum_b += pair_products<N>(taps(b, bytes_b), weight);
      }
      write_lanes<N>(line + g * N, paired_levels<N>(sum_a >> weights.bits, sum_b >> weights.bits));
    }
  }
  [[gnu::noinline]] void write_far(uint8_t const* a, uint8_t const* b, int32_t* line) const {
    for (int64_t x = 0; x < width; ++x) {
      int16_t const* const weight = weights.of(x);
      int const first = weights.first.data[x];
      int32_t sum_a = 1 << weights.bits >> 1, sum_b = sum_a;
      for (int k = 0; k < weights.taps; ++k) sum_a += a[first + k] * weight[k], sum_b += b[first + k] * weight[k];
      line[x] = paired_levels<1>(sum_a >> weights.bits, sum_b >> weights.bits);
    }
  }
};

// The patches of a row of them, which are written channel by channel and row by row: those of all channels would not
// fit the first cache.
template <class U>
struct PatchRow {
  int const patch, channels, repeats, columns;
  int64_t const stride;
  Scratch<U*> patches;
  Scratch<U> rows;  // of each channel, where these are interleaved, else one

  template <class T>
  PatchRow(VisionPatches<T> const& p, PatchImage const& image)
      : patch(p.patch),
        channels(p.channels),
        repeats(p.repeats),
        columns(image.columns),
        stride(int64_t(columns) * patch + kVectorBytes),
        patches(columns),
        rows(stride * (repeats ? 1 : channels * patch)) {}

  template <class T>
  KV_HD void begin(VisionPatches<T> const& p, PatchImage const& image, int i) const {
    for (int j = 0; j < columns; ++j)
      patches.data[j] = static_cast<U*>(p.patches) + p.index(image, i, j) * p.elements();
  }
  // Whether rows are written to the patches as they are computed, `kVector` elements at a time.
  static constexpr int kVector = kPartInts;
  KV_HD bool is_direct() const { return repeats > 0 && patch >= kVector; }
  // The elements of row y of a channel in patch j; those of its repeats are patch * patch elements apart.
  KV_HD U* at(int j, int c, int y) const { return patches.data[j] + int64_t(c * repeats * patch + y) * patch; }
  // Otherwise, where to write row y of a channel before it is copied.
  KV_HD U* row(int c, int y) const { return rows.data + (repeats ? 0 : (y * channels + c) * stride); }
  KV_HD void finish_row(int c, int y) const {
    if (repeats == 0) return;
    for (int j = 0; j < columns; ++j)
      for (int t = 0; t < repeats; ++t)
        __builtin_memcpy(at(j, c, y) + int64_t(t) * patch * patch, rows.data + j * patch, patch * sizeof(U));
  }
  KV_HD void finish() const {
    if (repeats > 0) return;
    for (int y = 0; y < patch; ++y)
      for (int j = 0; j < columns; ++j) {
        U* to = patches.data[j] + y * patch * channels;
        U const* const from = row(0, y) + j * patch;
        if (channels == 3) {
          for (int x = 0; x < patch; ++x, to += 3)
            to[0] = from[x], to[1] = from[x + stride], to[2] = from[x + 2 * stride];
        } else {
          for (int x = 0; x < patch; ++x)
            for (int c = 0; c < channels; ++c) *to++ = from[x + c * stride];
        }
      }
  }
};

// Rows [begin, end) of the patches of an image of bytes.
template <class U>
void write_bytes(VisionPatches<uint8_t> const& p, PatchImage const& image, int begin, int end) {
  constexpr int N = kPartInts;
  using Words = Lanes<int16_t, 2 * N>;
  int const width = image.columns * p.patch, height = image.rows * p.patch;
  ByteColumns const columns(p.axis(image.width, width));
  Weights const rows(p.axis(image.height, height));
  PatchRow<U> const out(p, image);
  // Lines of pairs of rows, those that a row of patches reads.
  int most = 0;
  for (int i = begin; i < end; ++i) {
    int const from = rows.first.data[i * p.patch], to = rows.first.data[(i + 1) * p.patch - 1];
    most = max(most, (to + rows.taps) / 2 - from / 2 + 1);
  }
  int const held = most + 1;
  int64_t const stride = columns.groups * N + ByteColumns::kLineMargin;
  Scratch<int32_t> lines(p.channels * held * stride);
  Scratch<uint8_t> copies(2 * (image.width + columns.margin()));
  // A row, or its copy where its pixels are not adjacent or memory may end after it.
  auto const row_of = [&](int c, int y, int which) -> uint8_t const* {
    uint8_t const* const row = p.row(image, c, y);
    if (image.step == 1 && (image.height - 1 - y) * image.row_stride >= columns.margin()) return row;
    uint8_t* const copy = copies.data + which * (image.width + columns.margin());
    for (int x = 0; x < image.width; ++x) copy[x] = row[x * image.step];
    for (int64_t x = image.width; x < image.width + columns.margin(); ++x) copy[x] = 0;
    return copy;
  };
  // The first pair that is not yet in a line of the channel.
  int next[kMaxPatchChannels];
  for (int& pair : next) pair = rows.first.data[begin * p.patch] / 2;
  for (int i = begin; i < end; ++i) {
    out.begin(p, image, i);
    for (int c = 0; c < p.channels; ++c) {
      auto const line = [&](int pair) { return lines.data + (c * held + pair % held) * stride; };
      int const last = rows.first.data[(i + 1) * p.patch - 1] + rows.taps, all = (image.height + 1) / 2;
      next[c] = max(next[c], rows.first.data[i * p.patch] / 2);
      for (; next[c] < all && 2 * next[c] < last; ++next[c]) {
        int const at = 2 * next[c];
        uint8_t const* const a = row_of(c, at, 0);
        columns.write(a, at + 1 < image.height ? row_of(c, at + 1, 1) : a, line(next[c]));
      }
      // So many patches at a time that they and their part of the lines stay in the first cache.
      int const block = out.is_direct() ? 16 : image.columns;
      for (int j = 0; j < image.columns; j += block)
        for (int y = 0; y < p.patch; ++y) {
          int const first = rows.first.data[i * p.patch + y], first_pair = first / 2;
          int const pairs = min((first % 2 + rows.taps) / 2, all - first_pair);
          int16_t const* const weights = rows.of(i * p.patch + y);
          auto const factors = [&](int k) {  // of both rows of a pair
            int const at = 2 * k - first % 2;
            int const a = at >= 0 ? weights[at] : 0, b = at + 1 < rows.taps ? weights[at + 1] : 0;
            return broadcast<N>(int32_t(uint32_t(a & 0xffff) | uint32_t(b) << 16));
          };
          auto const with = [&](auto count) {
            constexpr int K = decltype(count)::value;
            int32_t const* from[K > 0 ? K : 1];
            Lanes<int32_t, N> factor[K > 0 ? K : 1];
            for (int k = 0; k < K; ++k)
              from[k] = line(first_pair + min(k, pairs - 1)), factor[k] = k < pairs ? factors(k) : Lanes<int32_t, N>{};
            float const scale = p.scale[c], offset = p.offset[c];
            auto const pixels = [&](int64_t x) {  // N of them
              Lanes<int32_t, N> sum = broadcast<N>(int32_t(1) << rows.bits >> 1);
              auto const add = [&](int32_t const* at, Lanes<int32_t, N> weight) {
                auto const pair = read_lanes<N>(at + x);
                sum += pair_products<N>(__builtin_bit_cast(Words, pair), __builtin_bit_cast(Words, weight));
              };
              if constexpr (K > 0) {
                for (int k = 0; k < K; ++k) add(from[k], factor[k]);
              } else {
                for (int k = 0; k < pairs; ++k) add(line(first_pair + k), factors(k));
              }
              return Lanes<float, N>(levels_of<N>(sum >> rows.bits) * scale + offset);
            };
            if (!out.is_direct()) {
              U* const to = out.row(c, y);
              for (int64_t x = 0; x < width; x += N) store_finite<N>(to + x, pixels(x));
              return out.finish_row(c, y);
            }
            int64_t const plane = int64_t(p.patch) * p.patch;
            for (int b = j; b < min(j + block, image.columns); ++b) {
              U* const to = out.at(b, c, y);
              for (int x = 0;; x = min(x + N, p.patch - N)) {
                Lanes<float, N> const values = pixels(int64_t(b) * p.patch + x);
                store_finite<N>(to + x, values);
                for (int t = 1; t < p.repeats; ++t) store_finite<N>(to + t * plane + x, values);
                if (x + N == p.patch) break;
              }
            }
          };
          if (pairs <= 3)
            with(Width<3>{});
          else
            with(Width<0>{});
        }
    }
    out.finish();
  }
}

template <class U>
void write_floats(VisionPatches<float> const& p, PatchImage const& image, int begin, int end) {
  int64_t const width = image.columns * p.patch, height = image.rows * p.patch, first = begin * p.patch;
  int64_t const rows = (end - begin) * p.patch;
  ResizeAxis const down = p.axis(image.height, height), across = p.axis(image.width, width);
  Scratch<float> resized(rows * width * p.channels);
  bool const is_adjacent = image.step == 1;
  Scratch<float> copy(is_adjacent ? 1 : int64_t(image.height) * image.width);
  for (int c = 0; c < p.channels; ++c) {
    if (!is_adjacent)
      for (int64_t y = 0; y < image.height; ++y)
        for (int64_t x = 0; x < image.width; ++x) copy.data[y * image.width + x] = p.row(image, c, y)[x * image.step];
    float const* const plane = is_adjacent ? p.row(image, c, 0) : copy.data;
    int64_t const stride = is_adjacent ? image.row_stride : image.width;
    Resize<float> const q{{plane, 1, 1, 0, 0, stride, image.height, image.width, 1},
                          {resized.data + (c * rows - first) * width, 1, 1, 0, 0, width, height, width, 1},
                          down,
                          across};
    geometry::KV_ISA::resize(q, first, first + rows);
  }
  PatchRow<U> const out(p, image);
  for (int i = begin; i < end; ++i) {
    out.begin(p, image, i);
    for (int c = 0; c < p.channels; ++c)
      for (int y = 0; y < p.patch; ++y) {
        float const* const from = resized.data + (c * rows + (i - begin) * p.patch + y) * width;
        U* const to = out.row(c, y);
        for_each_vector<float>(0, width, [&](auto n, int64_t x) {
          constexpr int M = decltype(n)::value;
          store<M>(to + x, Lanes<float, M>(load<M>(from + x) * p.scale[c] + p.offset[c]));
        });
        out.finish_row(c, y);
      }
    out.finish();
  }
}

// What follows the patches of an image.
template <class T>
void write_padding(VisionPatches<T> const& p, PatchImage const& image, int sample) {
  int64_t const count = int64_t(image.rows) * image.columns, size = size_of(p.dtype) * p.elements();
  __builtin_memset(static_cast<char*>(p.patches) + (image.first_patch + count) * size, 0, (p.padded - count) * size);
  for (int64_t i = 0; i < p.padded; ++i) p.mask[sample * p.padded + i] = i < count;
}

}  // namespace

template <class T>
void vision_patches(VisionPatches<T> const& p, int64_t begin, int64_t end) {
  for (int n = 0; n < p.count; ++n) {
    PatchImage const& image = p.images[n];
    int const first = int(max(begin - image.first_unit, int64_t(0)));
    int const last = int(min(end - image.first_unit, int64_t(image.rows)));
    if (first >= last) continue;
    auto const write = [&](auto type) {
      using U = decltype(type);
      if constexpr (sizeof(T) == 1)
        write_bytes<U>(p, image, first, last);
      else
        write_floats<U>(p, image, first, last);
    };
    p.dtype == DType::bfloat16 ? write(BFloat16{}) : write(float{});
    if (p.repeats == 0 && first == 0) write_padding(p, image, n);
  }
}

KV_INSTANTIATE_ONE(vision_patches, VisionPatches, float)
KV_INSTANTIATE_ONE(vision_patches, VisionPatches, uint8_t)

}  // namespace kv::contrib::KV_ISA
