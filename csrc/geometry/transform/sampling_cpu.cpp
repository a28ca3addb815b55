// Sampling on the CPU: rows [begin, end) of all outputs in order. Compiled once per instruction set.
//
// A chunk of a row is processed at a time: first its sampling coordinates, then its pixels by vectors, with taps and
// weights shared by all channels. Where all taps are in bounds they are read directly; else each is padded or filled.
#include "geometry/transform/sampling_cpu.h"

#include "core/bytes.h"
#include "core/scratch.h"
#include "geometry/transform/whole_pixels_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// The taps of the next row of coordinates are mostly below those of this one. Rows of a tile are too many, and too
// short, for the hardware prefetcher, so the row at that distance from the first tap and the next output row are
// prefetched.
constexpr int kRowsAhead = 4;

// p[at], p[at + step] and so on. Special case: taps of bytes and of planes of floats in one or two accesses are 1.4 to
// WW times as fast as one by one, one thread.
template <int N, class T, class At, class V>
KV_HD void gather_four(T const* p, At const& at, int64_t step, V (&taps)[4]) {
  if constexpr (sizeof(T) == 1 && N > 1)
    if (step == 1 || step == 3) {
      auto const words_at = [&](int64_t offset) {
        Lanes<uint32_t, N> words;
        for (int n = 0; n < N; ++n) {
          uint32_t word;
          __builtin_memcpy(&word, p + at[n] + offset, sizeof(word));
          words[n] = word;
        }
        return words;
      };
      // Bytes 0 to 3, of pixels of three channels also 6 to 9.
      auto const left = words_at(0), right = step == 1 ? left >> 16 : words_at(6);
      int const next = step == 1 ? 8 : 24;
      Lanes<uint32_t, N> const bytes[] = {left & 255, (left >> next) & 255, right & 255, (right >> next) & 255};
      for (int i = 0; i < 4; ++i) taps[i] = __builtin_convertvector(__builtin_bit_cast(Lanes<int32_t, N>, bytes[i]), V);
      return;
    }
  if constexpr (__is_same(T, float) && N == 8)
    if (step == 1) {
      V rows[4];  // the taps of lanes n and n + 4
      for (int n = 0; n < 4; ++n)
        rows[n] =
            __builtin_shufflevector(read_lanes<4>(p + at[n]), read_lanes<4>(p + at[n + 4]), 0, 1, 2, 3, 4, 5, 6, 7);
      V const a = __builtin_shufflevector(rows[0], rows[1], 0, 8, 1, 9, 4, 12, 5, 13),
              b = __builtin_shufflevector(rows[0], rows[1], 2, 10, 3, 11, 6, 14, 7, 15),
              c = __builtin_shufflevector(rows[2], rows[3], 0, 8, 1, 9, 4, 12, 5, 13),
              d = __builtin_shufflevector(rows[2], rows[3], 2, 10, 3, 11, 6, 14, 7, 15);
      taps[0] = __builtin_shufflevector(a, c, 0, 1, 8, 9, 4, 5, 12, 13);
      taps[1] = __builtin_shufflevector(a, c, 2, 3, 10, 11, 6, 7, 14, 15);
      taps[2] = __builtin_shufflevector(b, d, 0, 1, 8, 9, 4, 5, 12, 13);
      taps[3] = __builtin_shufflevector(b, d, 2, 3, 10, 11, 6, 7, 14, 15);
      return;
    }
  for (int i = 0; i < 4; ++i) taps[i] = gather<N>(p + i * step, at);
}

// The value in one channel. A tap of weight 0 contributes nothing, even if it is inf or NaN. Where such taps are
// multiplied anyway, the sum becomes NaN and is then computed again.
template <int K, int N, class T>
struct Value : TapWindow<K, N, T> {
  using typename TapWindow<K, N, T>::F;
  using typename TapWindow<K, N, T>::V;
  V wx[K], wy[K];

  KV_HD void set(Sample<T> const& p, V u, V v) {
    TapWindow<K, N, T>::set(p, u, v, p.x.row_stride, p.x.step);
    tap_weights(this->tx, wx);
    tap_weights(this->ty, wy);
  }
  KV_HD V at(Sample<T> const& p, T const* plane, F fill) const {
    if (this->inside) {
      __builtin_prefetch(plane + kRowsAhead * p.x.row_stride + this->first[0]);
      V const sum = inner(p.x, plane);
      if (sizeof(T) == 1 || K == 1 || all<N>(sum - sum == 0)) return sum;
    }
    return this->outside ? V(V{} + fill) : outer(p, plane, fill);
  }

 private:
  KV_HD V inner(Images<T const> const& image, T const* plane) const {
    if constexpr (K == 1) {
      return this->read(image, plane, 0, 0);
    } else if constexpr (K == 2) {
      V a, b, c, d;
      gather_two<N>(plane, this->first, image.step, a, b);
      gather_two<N>(plane + image.row_stride, this->first, image.step, c, d);
      return (a * wx[0] + b * wx[1]) * wy[0] + (c * wx[0] + d * wx[1]) * wy[1];
    } else {
      V sum{};
#pragma GCC unroll 1
      for (int j = 0; j < K; ++j) {
        V taps[K], row{};
        gather_four<N>(plane + j * image.row_stride, this->first, image.step, taps);
        for (int i = 0; i < K; ++i) row += taps[i] * wx[i];
        sum += row * wy[j];
      }
      return sum;
    }
  }
  V outer(Sample<T> const& p, T const* plane, F fill) const {
    V sum{};
#pragma GCC unroll 1
    for (int j = 0; j < K; ++j)
#pragma GCC unroll 1
      for (int i = 0; i < K; ++i) {
        V const weight = wx[i] * wy[j], value = this->find(p, p.x, plane, fill, j, i);
        sum += weight == 0 ? V{} : V(weight * value);
      }
    return sum;
  }
};

// --- bytes -----------------------------------------------------------------------------------------------------------

// Bilinear samples of bytes in fixed point: numbers of 16 bits with kFraction bits below a level, weights of
// kWeightBits. Both taps of a row are read at once; rows are weighted first, then pairs of taps.
constexpr int kFraction = 6, kWeightBits = 14;
constexpr int kSamples = kPartInts;

struct ByteWeights {
  using Int = Lanes<int32_t, kSamples>;
  using Words = Lanes<int16_t, 2 * kSamples>;
  Int x, y;  // two words each: the weights of both columns, and twice that of the lower row

  KV_HD ByteWeights(Lanes<float, kSamples> tx, Lanes<float, kSamples> ty) {
    constexpr float one = 1 << kWeightBits;
    Int const right = __builtin_convertvector(tx * one + 0.5f, Int),
              lower = __builtin_convertvector(ty * one + 0.5f, Int);
    x = (right << 16) + ((1 << kWeightBits) - right);
    y = (lower << 16) + lower;
  }
  KV_HD static Words along_y(Words upper, Words lower, Int weights) {
    return (upper << kFraction) + rounded_product<2 * kSamples>((lower - upper) << (kFraction + 15 - kWeightBits),
                                                                __builtin_bit_cast(Words, weights));
  }
  KV_HD static Int along_x(Words taps, Int weights) {
    Int const sum = pair_products<kSamples>(taps, __builtin_bit_cast(Words, weights));
    return (sum + (1 << (kFraction + kWeightBits - 1))) >> (kFraction + kWeightBits);
  }
};

// One channel whose pixels are adjacent.
KV_HD void sample_plane(uint8_t const* plane, int64_t row_stride, Offsets<kSamples> const& at, ByteWeights const& w,
                        uint8_t* out) {
  auto const read = [&](uint8_t const* from) {
    Lanes<uint16_t, kSamples> pairs;
    for (int i = 0; i < kSamples; ++i) pairs[i] = load_bits<uint16_t>(from + at[i]);
    return to_words<2 * kSamples>(__builtin_bit_cast(Lanes<uint8_t, 2 * kSamples>, pairs));
  };
  auto const taps = ByteWeights::along_y(read(plane), read(plane + row_stride), w.y);
  store_clamped<kSamples>(out, ByteWeights::along_x(taps, w.x));
}

// Permutations of 16 bytes: words r g b r' g' b' to pairs r r' g g' b b', and bytes r g b 0 to r g b.
struct ByteOrders {
  alignas(32) uint8_t pairs[32], dense[32];

  constexpr ByteOrders() : pairs{}, dense{} {
    for (int i = 0; i < 32; ++i) {
      int const k = i % 16, channel = k / 4, tap = k / 2 % 2;
      pairs[i] = channel < 3 ? uint8_t(6 * tap + 2 * channel + k % 2) : kNoByte;
      dense[i] = k < 12 ? uint8_t(k / 3 * 4 + k % 3) : kNoByte;
    }
  }
};
constexpr ByteOrders kOrders;

// The two pixels of a row for samples i and i + 4.
template <int Parts>
KV_HD Lanes<int16_t, 8 * Parts> read_pixels(uint8_t const* p, Offsets<4 * Parts> const& at, int i) {
  if constexpr (Parts == 1) {
    return load_words<8>(p + at[i]);
  } else {
    int64_t left, right;
    __builtin_memcpy(&left, p + at[i], 8);
    __builtin_memcpy(&right, p + at[i + 4], 8);
    return to_words<16>(__builtin_bit_cast(Lanes<uint8_t, 16>, Lanes<int64_t, 2>{left, right}));
  }
}

// Numbers i and i + 4, four times each.
template <int i, class V, int... k>
KV_HD V repeated(V v, std::integer_sequence<int, k...>) {
  return __builtin_shufflevector(v, v, (k / 4 * 4 + i)...);
}

// Three interleaved channels, samples i and i + 4 in a vector.
KV_HD void sample_interleaved(uint8_t const* image, int64_t row_stride, Offsets<kSamples> const& at,
                              ByteWeights const& w, uint8_t* out) {
  using Bytes = Lanes<uint8_t, 4 * kSamples>;
  using Int = ByteWeights::Int;
  Bytes const pairs = load_bytes<4 * kSamples>(kOrders.pairs), dense = load_bytes<4 * kSamples>(kOrders.dense);
  auto const sum = [&](auto lane) KV_INLINE {
    constexpr int i = decltype(lane)::value;
    constexpr std::make_integer_sequence<int, kSamples> lanes;
    auto const v = ByteWeights::along_y(read_pixels<kParts>(image, at, i),
                                        read_pixels<kParts>(image + row_stride, at, i), repeated<i>(w.y, lanes));
    Bytes const taps = permuted_bytes(__builtin_bit_cast(Bytes, v), pairs);
    return ByteWeights::along_x(__builtin_bit_cast(ByteWeights::Words, taps), repeated<i>(w.x, lanes));
  };
  Int const first = sum(Width<0>{}), second = sum(Width<1>{}), third = sum(Width<2>{}), fourth = sum(Width<3>{});
  Bytes const pixels = permuted_bytes(clamped_bytes<kSamples>(first, second, third, fourth), dense);
  for (int k = 0; k < kParts; ++k) __builtin_memcpy(out + 12 * k, reinterpret_cast<char const*>(&pixels) + 16 * k, 12);
}

// Whether an image has three channels, interleaved.
template <class T>
KV_HD bool is_interleaved(Images<T> const& x) {
  return x.channels == 3 && x.channel_stride == 1 && x.step == 3;
}

// --- chunks ----------------------------------------------------------------------------------------------------------

template <int K, int N, class T>
void sample_chunk(Sample<T> const& p, CoordRow<Compute<T>> const& coords, int64_t b, int64_t y, int64_t first,
                  int64_t count) {
  T const* const planes = p.x.row(p.image_of(b), 0, 0);
  T* const row = p.y.row(b, 0, y) + first * p.y.step;
  [[maybe_unused]] bool const interleaved = is_interleaved(p.x) && is_interleaved(p.y);
  [[maybe_unused]] bool const planar = p.x.step == 1 && p.y.step == 1;
  for (int64_t i = 0; i * N < count; ++i) {
    int64_t const e = vector_start<N>(i, count);
    Value<K, N, T> value;
    value.set(p, load<N>(coords.u + e), load<N>(coords.v + e));
    if constexpr (K == 2 && sizeof(T) == 1 && N == kSamples) {
      // Special case, one thread: interleaved bytes are 1.1 (AVX2) to 2.8 times (AVX-512) as fast as floats,
      // planes 1.03 to 1.16. Two pixels are read as 8 bytes, so there must be a third one.
      bool const reads_pixels = interleaved && value.inside && all<N>(value.x <= p.x_axis.size - 3);
      if (reads_pixels || (planar && value.inside)) {
        ByteWeights const weights(value.tx, value.ty);
        int64_t const below = kRowsAhead * p.x.row_stride + value.first[0];
        for (int c = 0; c < (reads_pixels ? 1 : p.x.channels); ++c) {
          T const* const from = planes + c * p.x.channel_stride;
          T* const out = row + c * p.y.channel_stride + e * p.y.step;
          __builtin_prefetch(from + below);
          __builtin_prefetch(out + p.y.row_stride, 1);
          reads_pixels ? sample_interleaved(from, p.x.row_stride, value.first, weights, out)
                       : sample_plane(from, p.x.row_stride, value.first, weights, out);
        }
        continue;
      }
    }
    if constexpr (K == 1 && N > 1)
      if (value.inside) {  // Special case: 1.1 to 2.2 times as fast, one thread.
        int64_t const step = p.y.step, below = kRowsAhead * p.x.row_stride + value.first[0];
        int const channels = interleaved ? 1 : p.x.channels;
        for (int c = 0; c < channels; ++c) {
          T const* const from = planes + c * p.x.channel_stride;
          T* const out = row + c * p.y.channel_stride + e * step;
          __builtin_prefetch(from + below);
          __builtin_prefetch(out + p.y.row_stride, 1);
          for (int n = 0; n < N; ++n) {
            T const* const pixel = from + value.first[n];
            T* const to = out + n * step;
            to[0] = pixel[0];
            if (interleaved) to[1] = pixel[1], to[2] = pixel[2];
          }
        }
        continue;
      }
    for (int c = 0; c < p.x.channels; ++c) {
      auto const sampled = value.at(p, planes + c * p.x.channel_stride, p.fill_value(b, c));
      T* const out = row + c * p.y.channel_stride + e * p.y.step;
      __builtin_prefetch(out + p.y.row_stride, 1);
      if (N == 1 || p.y.step == 1) {
        store<N>(out, sampled);
      } else if constexpr (N > 1) {
        for (int n = 0; n < N; ++n) store<1>(out + n * p.y.step, sampled[n]);
      }
    }
  }
}

// --- rows and columns apart ------------------------------------------------------------------------------------------

// A map that only scales and shifts, as those of crops and resizing, reads the same two columns in every row. Rows of
// the source are resampled along x once, and each row of the result is the weighted mean of two of them. Special case:
// 1.3 to 2.7 times as fast as sampling pixel by pixel, 1.0 to 1.6 where images shrink to between 0.8 and a half. Those
// that shrink more read each row once, and gain nothing; bytes come here all the same, as their sampling is less exact.
template <class T>
KV_HD bool samples_rows_and_columns(Sample<T> const& p, Homography<double> const& map) {
  auto const is_small = [](double x) { return x > -(1 << 20) && x < 1 << 20; };
  constexpr double kMost = sizeof(T) == 1 ? 1 << 20 : 2;
  auto const is_served = [](double scale) { return scale > -kMost && scale < kMost; };
  return map.affine && map.m[1] == 0 && map.m[3] == 0 && is_served(map.m[0]) && is_small(map.m[2]) &&
         is_served(map.m[4]) && is_small(map.m[5]) && p.x.step == 1 && p.y.step == 1 &&
         p.x_axis.padding != Padding::reflection && p.y.width >= kCoordLanes<T>;
}

// The pair of adjacent taps at a coordinate, and the weight of the second one. Beyond the image are kMargin pixels of
// padding on each side.
constexpr int kMargin = 4;
struct TapPair {
  int first;
  float t;
  KV_HD TapPair(Axis<float> const& axis, double x) {
    x = x > -kMargin ? x : -kMargin;
    x = x < axis.size + kMargin - 1 ? x : axis.size + kMargin - 1;
    first = int(x + kMargin) - kMargin;
    t = float(x - first);
    if (first == axis.size + kMargin - 1) --first, t = 1;
  }
};

template <class T>
struct ColumnTaps {
  static constexpr int N = kCoordLanes<T>;
  int64_t groups;
  int begin, end;       // the columns of the source that are read
  int spread = 0;       // the largest distance of first taps in a group
  Scratch<int> from;    // the first element that a group reads, in a line with its margin
  Scratch<int> offset;  // from there to the first tap of each element
  Scratch<float> t;

  ColumnTaps(Sample<T> const& p, Homography<double> const& map)
      : groups((p.y.width + N - 1) / N), from(groups), offset(groups * N), t(groups * N) {
    int first = INT32_MAX, last = INT32_MIN;
    for (int64_t g = 0; g < groups; ++g) {
      int lowest = INT32_MAX, highest = INT32_MIN;
      for (int i = 0; i < N; ++i) {
        TapPair const taps(p.x_axis, double(start(g, p.y.width) + i) * map.m[0] + map.m[2]);
        t.data[g * N + i] = taps.t;
        offset.data[g * N + i] = taps.first + kMargin;
        lowest = min(lowest, taps.first + kMargin), highest = max(highest, taps.first + kMargin);
      }
      from.data[g] = lowest;
      for (int i = 0; i < N; ++i) offset.data[g * N + i] -= lowest;
      spread = max(spread, highest - lowest);
      first = min(first, lowest), last = max(last, highest);
    }
    begin = clamp(first - kMargin, 0, p.x_axis.size - 1), end = clamp(last - kMargin + 2, begin + 1, p.x_axis.size);
  }
  KV_HD static int64_t start(int64_t group, int64_t width) { return min(group * N, width - N); }
};

// A row of the result along x, from a line with margins. Vectors: how many loads hold the first taps of a group, 0 for
// any number.
template <int Vectors, class T>
KV_HD void resample_line(ColumnTaps<T> const& columns, float const* line, int64_t width, float* to) {
  constexpr int N = ColumnTaps<T>::N;
  using V = Lanes<float, N>;
  for (int64_t g = 0; g < columns.groups; ++g) {
    float const* const from = line + columns.from.data[g];
    V const t = load<N>(columns.t.data + g * N);
    V a, b;
    if constexpr (Vectors == 0) {
      for (int i = 0; i < N; ++i) {
        float const* const pair = from + columns.offset.data[g * N + i];
        a[i] = pair[0], b[i] = pair[1];
      }
    } else {
      auto const offset = read_lanes<N>(columns.offset.data + g * N);
      if constexpr (Vectors == 1) {
        a = permuted<N>(load<N>(from), offset);
        b = permuted<N>(load<N>(from + 1), offset);
      } else {
        a = permuted<N>(load<N>(from), load<N>(from + N), offset);
        b = permuted<N>(load<N>(from + 1), load<N>(from + N + 1), offset);
      }
    }
    store<N>(to + ColumnTaps<T>::start(g, width), V(a * (1 - t) + b * t));
  }
}

// Rows [begin, end) of a sample. `sampled(y, first, count)` samples a part of a row, for rows with NaN or inf, of which
// taps of weight 0 contribute nothing.
template <class T, class Sampled>
void sample_rows_and_columns(Sample<T> const& p, Homography<double> const& map, int64_t b, int64_t begin, int64_t end,
                             Sampled sampled) {
  constexpr int N = ColumnTaps<T>::N;
  ColumnTaps<T> const columns(p, map);
  int64_t const source = p.x.width, width = p.y.width, height = p.x.height;
  Scratch<float> line(source + 2 * kMargin + 3 * N), rows(2 * width);
  for (int64_t i = source; i < source + 2 * kMargin + 3 * N; ++i) line.data[i] = 0;
  bool const fills = p.x_axis.padding == Padding::fill;
  for (int c = 0; c < p.x.channels; ++c) {
    float const fill = p.fill_value(b, c);
    T const* const plane = p.x.row(p.image_of(b), c, 0);
    int64_t kept[2] = {INT64_MIN, INT64_MIN};  // the rows of the source that are in `rows`
    // Row v of the source along x; of two adjacent rows one is even.
    auto const row_at = [&](int64_t v) -> float const* {
      if (!fills) v = clamp(v, int64_t(0), height - 1);
      float* const to = rows.data + (v & 1) * width;
      if (kept[v & 1] == v) return to;
      kept[v & 1] = v;
      if (v < 0 || v >= height) {
        for (int64_t x = 0; x < width; ++x) to[x] = fill;
        return to;
      }
      T const* const from = plane + v * p.x.row_stride;
      for_each_vector<T>(columns.begin, columns.end, [&](auto lanes, int64_t x) {
        constexpr int M = decltype(lanes)::value;
        store<M>(line.data + kMargin + x, load<M>(from + x));
      });
      float const left = fills ? fill : float(load<1>(from)), right = fills ? fill : float(load<1>(from + source - 1));
      for (int i = 0; i < kMargin; ++i) line.data[i] = left, line.data[kMargin + source + i] = right;
      if (columns.spread < N)
        resample_line<1>(columns, line.data, width, to);
      else if (columns.spread < 2 * N)
        resample_line<2>(columns, line.data, width, to);
      else
        resample_line<0>(columns, line.data, width, to);
      return to;
    };
    for (int64_t y = begin; y < end; ++y) {
      TapPair const taps(p.y_axis, double(y) * map.m[4] + map.m[5]);
      float const* const upper = row_at(taps.first);
      float const* const lower = taps.t > 0 ? row_at(taps.first + 1) : upper;
      T* const to = p.y.row(b, c, y);
      Lanes<float, N> check{};
      for (int64_t g = 0; g < columns.groups; ++g) {
        int64_t const x = columns.start(g, width);
        Lanes<float, N> const above = load<N>(upper + x), below = load<N>(lower + x),
                              v = above * (1 - taps.t) + below * taps.t;
        if constexpr (sizeof(T) > 1) check += v - v;
        store<N>(to + x, v);
      }
      if constexpr (sizeof(T) > 1) {
        float total = 0;
        for (int i = 0; i < N; ++i) total += check[i];
        if (total != 0)
          for (int64_t x = 0; x < width; x += kTileColumns) sampled(y, x, min(width - x, kTileColumns));
      }
    }
  }
}

template <int K, class T>
void sample_rows(Sample<T> const& p, int64_t begin, int64_t end) {
  CoordRow<Compute<T>> coords;
  int64_t const height = p.y.height;
  auto const sampled = [&](int64_t b, int64_t y, int64_t first, int64_t count) {
    coords.fill(p.coords, b, y, first, count);
    dispatch_lanes(p.x, count,
                   [&](auto lanes) { sample_chunk<K, decltype(lanes)::value>(p, coords, b, y, first, count); });
  };
  while (begin < end) {
    int64_t const b = begin / height, last = min(end, (b + 1) * height);
    auto const sampled_of_image = [&](int64_t y, int64_t first, int64_t count) { sampled(b, y, first, count); };
    // Special case: 2.8 to 7.4 times as fast as sampling, one thread.
    if (K <= 2 && !p.coords.has_map() && moves_whole_pixels(coords.map_of(p.coords, b))) {
      copy_rows(p.x, p.image_of(b), p.y, b, coords.map_of(p.coords, b), begin - b * height, last - b * height,
                [&](Images<T> const& plane, int c, int64_t y, int64_t first, int64_t count) {
                  if (p.x_axis.padding == Padding::fill)
                    fill_pixels(plane, b, y, first, count, [&](int k) { return p.fill_value(b, c + k); });
                  else if (c == 0)  // of all channels
                    for (int64_t x = 0; x < count; x += kTileColumns)
                      sampled(b, y, first + x, min(count - x, kTileColumns));
                });
      begin = last;
      continue;
    }
    if constexpr (K == 2 && sizeof(Compute<T>) == 4 && kCoordLanes<T> > 1)
      if (!p.coords.has_map() && samples_rows_and_columns(p, coords.map_of(p.coords, b))) {
        sample_rows_and_columns(p, coords.map_of(p.coords, b), b, begin - b * height, last - b * height,
                                sampled_of_image);
        begin = last;
        continue;
      }
    for_each_row_chunk(begin, last, height, p.y.width, sampled);
    begin = last;
  }
}

}  // namespace

template <class T>
void sample(Sample<T> const& p, int64_t begin, int64_t end) {
  switch (p.interpolation) {
    case Interpolation::nearest:
      return sample_rows<1>(p, begin, end);
    case Interpolation::bilinear:
      return sample_rows<2>(p, begin, end);
    case Interpolation::bicubic:
      return sample_rows<4>(p, begin, end);
  }
}

KV_INSTANTIATE_WITH_BYTES(sample, Sample)

}  // namespace kv::geometry::KV_ISA
