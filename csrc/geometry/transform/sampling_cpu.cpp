// Sampling on the CPU: rows [begin, end) of all outputs in order. Compiled once per instruction set.
//
// A chunk of a row is processed at a time: first its sampling coordinates, then its pixels by vectors, with taps and
// weights shared by all channels. Where all taps are in bounds they are read directly; else each is padded or filled.
#include "geometry/transform/sampling_cpu.h"

#include "core/scratch.h"
#include "geometry/transform/whole_pixels_cpu.h"

namespace kv::geometry::KV_ISA {
namespace {

// The taps of the next row of coordinates are mostly below those of this one. Rows of a tile are too many, and too
// short, for the hardware prefetcher, so the row at that distance from the first tap and the next output row are
// prefetched.
constexpr int kRowsAhead = 4;

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
        V row{};
        for (int i = 0; i < K; ++i) row += this->read(image, plane, j, i) * wx[i];
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

template <int K, int N, class T>
void sample_chunk(Sample<T> const& p, CoordRow<Compute<T>> const& coords, int64_t b, int64_t y, int64_t first,
                  int64_t count) {
  T const* const planes = p.x.row(p.image_of(b), 0, 0);
  T* const row = p.y.row(b, 0, y) + first * p.y.step;
  for (int64_t i = 0; i * N < count; ++i) {
    int64_t const e = vector_start<N>(i, count);
    Value<K, N, T> value;
    value.set(p, load<N>(coords.u + e), load<N>(coords.v + e));
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
// the source are resampled along x once, and each row of the result is the weighted mean of two of them.
template <class T>
KV_HD bool samples_rows_and_columns(Sample<T> const& p, Homography<double> const& map) {
  auto const is_small = [](double x) { return x > -(1 << 20) && x < 1 << 20; };
  return map.affine && map.m[1] == 0 && map.m[3] == 0 && is_small(map.m[0]) && is_small(map.m[2]) &&
         is_small(map.m[4]) && is_small(map.m[5]) && p.x.step == 1 && p.y.step == 1 &&
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
  int spread = 0;       // the largest distance of first taps in a group
  Scratch<int> from;    // the first element that a group reads, in a line with its margin
  Scratch<int> offset;  // from there to the first tap of each element
  Scratch<float> t;

  ColumnTaps(Sample<T> const& p, Homography<double> const& map)
      : groups((p.y.width + N - 1) / N), from(groups), offset(groups * N), t(groups * N) {
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
    }
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
      auto const offset = *reinterpret_cast<Lanes<int, N> const*>(columns.offset.data + g * N);
      if constexpr (Vectors == 1) {
        a = __builtin_shuffle(load<N>(from), offset);
        b = __builtin_shuffle(load<N>(from + 1), offset);
      } else {
        a = __builtin_shuffle(load<N>(from), load<N>(from + N), offset);
        b = __builtin_shuffle(load<N>(from + 1), load<N>(from + N + 1), offset);
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
      for_each_vector<T>(0, source, [&](auto lanes, int64_t x) {
        constexpr int M = decltype(lanes)::value;
        store<M>(line.data + kMargin + x, load<M>(from + x));
      });
      float const left = fills ? fill : line.data[kMargin], right = fills ? fill : line.data[kMargin + source - 1];
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
