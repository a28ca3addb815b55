// Resizing on the CPU, a row of the result at a time. The weighted rows of its band are added up to one line, and its
// pixels are weighted means of that line. The weights along both axes are computed once for all planes.
//
// The first taps of a vector of the result are close together unless the image shrinks a lot. One or two loads and a
// permutation then read them, and likewise the second taps and so on.
#include "core/bytes.h"
#include "core/scratch.h"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::KV_ISA {
namespace {

// The weights of a pixel, `stride` apart. Not inline: they take most of the time to compile.
template <class F>
[[gnu::noinline]] Contributors<F> write_weights(F* to, int64_t stride, ResizeAxis const& axis, int64_t index) {
  Contributors<F> const reads = contributors<F>(axis, int(index));
  for (int k = 0; k < reads.count; ++k) to[k * stride] = weight_at(axis, reads, int(index), k);
  return reads;
}

// The weights of `count` rows of the result from row `first` of all planes on.
template <class F>
struct RowBands {
  int64_t height, first;
  int taps;
  Scratch<F> weights;
  Scratch<Contributors<F>> reads;

  RowBands(ResizeAxis const& axis, int64_t height, int64_t begin, int64_t count)
      : height(height), first(begin), taps(axis.max_taps), weights(count * taps), reads(count) {
    for (int64_t i = 0; i < count; ++i)
      reads.data[i] = write_weights(weights.data + i * taps, 1, axis, (begin + i) % height);
  }
  // Of row `r` of all planes.
  KV_HD int64_t at(int64_t r) const { return (r - first) % height; }
};

// The weights of a row's elements in groups of N, the last of which overlaps the one before it.
template <class F, int N>
struct ColumnBands {
  using Int = typename integer_of<sizeof(F)>::type;
  int64_t size, groups;
  int taps, spread = 0;    // the latter: largest distance within a group
  Scratch<int64_t> from;   // the first element that a group reads
  Scratch<Int> distances;  // from there to the first one that each of its elements reads
  Scratch<F> weights;      // by group, tap and element

  ColumnBands(ResizeAxis const& axis, int64_t size, int64_t step)
      : size(size),
        groups((size + N - 1) / N),
        taps(axis.max_taps),
        from(groups),
        distances(groups * N),
        weights(groups * taps * N) {
    for (int64_t i = 0; i < groups * taps * N; ++i) weights.data[i] = 0;
    for (int64_t g = 0; g < groups; ++g) {
      int64_t firsts[N], lowest = INT64_MAX;
      for (int i = 0; i < N; ++i) {
        int64_t const e = start(g) + i, x = e / step;
        firsts[i] = write_weights(weights.data + g * taps * N + i, N, axis, x).first * step + e - x * step;
        lowest = min(lowest, firsts[i]);
      }
      from.data[g] = lowest;
      for (int i = 0; i < N; ++i) {
        distances.data[g * N + i] = Int(firsts[i] - lowest);
        spread = max(spread, int(firsts[i] - lowest));
      }
    }
  }
  KV_HD int64_t start(int64_t group) const { return min(group * N, size - N); }
};

// The elements `distance` behind `from`, which are within that many vectors. Special case: more than two vectors take
// .3 to .6 of the time of elements one by one, one thread.
template <int Vectors, int N, class F, class Distance>
KV_HD Lanes<F, N> gathered(F const* from, Distance distance) {
  if constexpr (Vectors == 1) return permuted<N>(load<N>(from), distance);
  Lanes<F, N> value = permuted<N>(load<N>(from), load<N>(from + N), distance);
#pragma GCC unroll 4
  for (int k = 2; k < Vectors; k += 2) {
    auto const behind = distance - k * N;
    value = behind >= 0 ? permuted<N>(load<N>(from + k * N), load<N>(from + (k + 1) * N), behind) : value;
  }
  return value;
}

// A row of the result from its line, or `minuend` minus it. Vectors: how many loads hold what a group reads at a time,
// 0 for more than kMaxVectors. Taps: how many there are, 0 for any number. Says whether all of the row is finite.
constexpr int kMaxVectors = 8;
template <int Vectors, int Taps, int N, class T, class F>
KV_HD bool write_row(T* out, T const* minuend, F const* line, ColumnBands<F, N> const& columns, int64_t step) {
  using V = Lanes<F, N>;
  int const taps = Taps ? Taps : columns.taps;
  V check{};
  for (int64_t g = 0; g < columns.groups; ++g) {
    F const* from = line + columns.from.data[g];
    F const* weights = columns.weights.data + g * taps * N;
    auto const distance = read_lanes<N>(columns.distances.data + g * N);
    V sum{};
    for (int k = 0; k < taps; ++k, from += step, weights += N) {
      V value;
      if constexpr (Vectors > 0) {
        value = gathered<Vectors, N>(from, distance);
      } else {
        for (int i = 0; i < N; ++i) value[i] = from[distance[i]];
      }
      sum += value * load<N>(weights);
    }
    check += sum - sum;
    if (minuend) sum = load<N>(minuend + columns.start(g)) - sum;
    store<N>(out + columns.start(g), sum);
  }
  if constexpr (N == 1) {
    return check == 0;
  } else {
    F total = 0;
    for (int i = 0; i < N; ++i) total += check[i];
    return total == 0;
  }
}

// The same, but a tap of weight 0 contributes nothing, even if it is NaN or inf.
template <int N, class T, class F>
[[gnu::noinline]] void write_row_skipping_zeros(T* out, T const* minuend, F const* line,
                                                ColumnBands<F, N> const& columns, int64_t step) {
  for (int64_t g = 0; g < columns.groups; ++g)
    for (int i = 0; i < N; ++i) {
      F const* from = line + columns.from.data[g] + columns.distances.data[g * N + i];
      F sum = 0;
      for (int k = 0; k < columns.taps; ++k, from += step) {
        F const weight = columns.weights.data[(g * columns.taps + k) * N + i];
        if (weight != 0) sum += *from * weight;
      }
      if (minuend) sum = load<1>(minuend + columns.start(g) + i) - sum;
      store<1>(out + columns.start(g) + i, sum);
    }
}

// The weighted sum of rows, a few vectors at a time. A row of weight 0 contributes nothing, even if it is NaN or inf.
template <class T, class F>
void add_up_rows(T const* first, int64_t row_stride, F const* weights, int count, int64_t size, F* line) {
  constexpr int kBlock = 4;
  auto const add_up = [&](auto width, auto block, int64_t e) {
    constexpr int M = decltype(width)::value, U = decltype(block)::value;
    Lanes<F, M> sums[U]{};
    T const* row = first + e;
    for (int k = 0; k < count; ++k, row += row_stride)
      if (F const weight = weights[k]; weight != 0)
        for (int i = 0; i < U; ++i) sums[i] += load<M>(row + i * M) * weight;
    for (int i = 0; i < U; ++i) store<M>(line + e + i * M, sums[i]);
  };
  constexpr int N = kLanes<T>;
  int64_t e = 0;
  for (; e + kBlock * N <= size; e += kBlock * N) add_up(Width<N>{}, Width<kBlock>{}, e);
  if (e == size) return;
  for_each_vector<T>(size < N ? 0 : min(e, size - N), size,
                     [&](auto width, int64_t e) { add_up(width, Width<1>{}, e); });
}

template <int N, class T>
void resize_rows(Resize<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.y.height;
  RowBands<F> const rows(p.rows, height, begin, min(height, end - begin));
  ColumnBands<F, N> const columns(p.columns, p.y.row_size(), step);
  int64_t const margin = columns.taps * step + kMaxVectors * N;  // a band may be shorter than most of them are
  Scratch<F> line(size + margin);
  for (int64_t e = size; e < size + margin; ++e) line.data[e] = 0;

  auto const write_with = [&](T* out, T const* minuend, auto vectors) {
    constexpr int M = decltype(vectors)::value;
    if (columns.taps == 1) return write_row<M, 1>(out, minuend, line.data, columns, step);
    if (columns.taps == 2) return write_row<M, 2>(out, minuend, line.data, columns, step);
    if (columns.taps == 4) return write_row<M, 4>(out, minuend, line.data, columns, step);
    return write_row<M, 0>(out, minuend, line.data, columns, step);
  };
  auto const write = [&](T* out, T const* minuend) {
    if (columns.spread < N) return write_with(out, minuend, Width<1>{});
    if constexpr (N > 1) {
      if (columns.spread < 2 * N) return write_with(out, minuend, Width<2>{});
      if (columns.spread < 4 * N) return write_with(out, minuend, Width<4>{});
      if (columns.spread < kMaxVectors * N) return write_row<kMaxVectors, 0>(out, minuend, line.data, columns, step);
      return write_row<0, 0>(out, minuend, line.data, columns, step);
    }
    return true;
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, i = rows.at(r);
    Contributors<F> const band = rows.reads.data[i];
    F const* const weights = rows.weights.data + i * rows.taps;
    T const* const first = p.x.row(plane, band.first);
    F const upper = weights[0], lower = band.count == 2 ? weights[1] : 0;  // which stores to the line cannot change
    if (upper != 0 && lower != 0)
      for_each_vector<T>(0, size, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        T const* const from = first + e;
        store<M>(line.data + e, Lanes<F, M>(load<M>(from) * upper + load<M>(from + p.x.row_stride) * lower));
      });
    else
      add_up_rows(first, p.x.row_stride, weights, band.count, size, line.data);
    T* const out = p.y.row(plane, r - plane * height);
    T const* const minuend = p.minuend ? p.minuend_at(out) : nullptr;
    if (!write(out, minuend)) write_row_skipping_zeros(out, minuend, line.data, columns, step);
  }
}

// --- bytes -----------------------------------------------------------------------------------------------------------

// Bytes are resized in fixed point. Lines have kFraction bits below a level, so that 16 bits hold what negative weights
// add to the range of bytes. Weights, which may exceed 1, have kWeightBits.
constexpr int kWeightBits = 14, kFraction = 6, kMaxByteTaps = 64;

// The weights of one pixel. The largest one takes the rounding errors, so that a constant image stays constant.
inline Contributors<float> write_byte_weights(int16_t* to, ResizeAxis const& axis, int64_t index) {
  float weights[kMaxByteTaps];
  Contributors<float> const reads = write_weights(weights, 1, axis, index);
  float sum = 0;
  int rest = 0, largest = 0;
  for (int k = 0; k < reads.count; ++k) {
    to[k] = int16_t(vfloor(weights[k] * (1 << kWeightBits) + 0.5f));
    sum += weights[k], rest -= to[k];
    if (weights[k] > weights[largest]) largest = k;
  }
  if (reads.count > 0) to[largest] += int16_t(rest + int(vfloor(sum * (1 << kWeightBits) + 0.5f)));
  return reads;
}

// How a row of bytes comes from its line, N elements at a time, in parts of four elements. Taps are read in pairs. A
// part reads its first pairs from `chunks` of eight adjacent elements, the first of which begins at `from`; `index`
// permutes them. The next pairs are two pixels further on.
struct ByteColumns {
  static constexpr int kBytes = 16 * kParts, N = kPartInts, kMaxChunks = 4;
  using Bytes = Lanes<uint8_t, kBytes>;
  int64_t size, groups;
  int pairs, chunks;
  Scratch<int64_t> from;     // by group and part
  Scratch<uint8_t> index;    // by group and chunk
  Scratch<int16_t> weights;  // by group and pair

  KV_HD int64_t start(int64_t group) const { return min(group * N, size - N); }

  ByteColumns(ResizeAxis const& axis, int64_t size, int64_t step)
      : size(size),
        groups((size + N - 1) / N),
        pairs((axis.max_taps + 1) / 2),
        from(groups * kParts),
        index(groups * kMaxChunks * kBytes),
        weights(groups * pairs * 2 * N) {
    int64_t const width = size / step;
    Scratch<int16_t> pixel_weights(width * 2 * pairs);
    Scratch<int64_t> firsts(width);
    for (int64_t x = 0; x < width; ++x) {
      int16_t* const to = pixel_weights.data + x * 2 * pairs;
      for (int k = 0; k < 2 * pairs; ++k) to[k] = 0;
      firsts.data[x] = write_byte_weights(to, axis, x).first;
    }
    int64_t reach = 0;  // from the first element that a part reads to the last one of its first pairs
    auto const for_each = [&](auto call) {
      int64_t x = 0, channel = 0;
      for (int64_t g = 0; g < groups; ++g) {
        if (g + 1 == groups) x = start(g) / step, channel = start(g) - x * step;
        for (int i = 0; i < N; ++i, ++channel) {
          if (channel == step) ++x, channel = 0;
          call(g, i, x, firsts.data[x] * step + channel);
        }
      }
    };
    for_each([&](int64_t g, int i, int64_t, int64_t first) {
      int64_t& lowest = from.data[g * kParts + i / 4];
      if (i % 4 == 0 || first < lowest) lowest = first;
    });
    for_each([&](int64_t g, int i, int64_t, int64_t first) {
      reach = max(reach, first - from.data[g * kParts + i / 4] + step);
    });
    chunks = int(min(reach / 8 + 1, int64_t(kMaxChunks + 1)));
    if (!serves()) return;
    for_each([&](int64_t g, int i, int64_t x, int64_t first) {
      auto const* const pair = reinterpret_cast<uint32_t const*>(pixel_weights.data + x * 2 * pairs);
      for (int j = 0; j < pairs; ++j)
        __builtin_memcpy(weights.data + ((g * pairs + j) * N + i) * 2, pair + j, sizeof(uint32_t));
      int const distance = int(first - from.data[g * kParts + i / 4]);
      for (int c = 0; c < chunks; ++c) {
        uint8_t* const to = index.data + (g * chunks + c) * kBytes + 4 * i;
        for (int tap = 0; tap < 2; ++tap) {
          int const at = 2 * (distance + tap * int(step)) - 16 * c;
          to[2 * tap] = at >= 0 && at < 16 ? uint8_t(at) : kNoByte;
          to[2 * tap + 1] = at >= 0 && at < 16 ? uint8_t(at + 1) : kNoByte;
        }
      }
    });
  }
  KV_HD bool serves() const { return chunks <= kMaxChunks; }
};

// Pairs: how many there are, 0 for any number.
template <int Chunks, int Pairs>
void write_byte_row(uint8_t* out, int16_t const* line, ByteColumns const& columns, int64_t step) {
  constexpr int N = ByteColumns::N, kBytes = ByteColumns::kBytes;
  int const pairs = Pairs ? Pairs : columns.pairs;
  int16_t const* weights = columns.weights.data;
  auto const bytes_at = [=](int64_t i) { return reinterpret_cast<uint8_t const*>(line + i); };
  for (int64_t g = 0; g < columns.groups; ++g) {
    int64_t const* const from = columns.from.data + g * kParts;
    Lanes<int32_t, N> sum = broadcast<N>(int32_t(1 << (kFraction + kWeightBits - 1)));
    for (int j = 0; j < pairs; ++j, weights += 2 * N) {
      ByteColumns::Bytes taps{};
      int64_t const at = 2 * j * step;
      for (int c = 0; c < Chunks; ++c)
        taps |=
            permuted_bytes(load_parts<kParts>(bytes_at(from[0] + at + 8 * c), bytes_at(from[kParts - 1] + at + 8 * c)),
                           load_bytes<kBytes>(columns.index.data + (g * Chunks + c) * kBytes));
      using Words = Lanes<int16_t, 2 * N>;
      sum += pair_products<N>(__builtin_bit_cast(Words, taps), read_lanes<2 * N>(weights));
    }
    store_clamped<N>(out + columns.start(g), Lanes<int32_t, N>(sum >> (kFraction + kWeightBits)));
  }
}

// The weighted sum of rows, a few vectors at a time.
KV_HD void add_up_bytes(uint8_t const* first, int64_t row_stride, int16_t const* weights, int count, int64_t size,
                        int16_t* line) {
  constexpr int kWords = kVectorBytes / 2, kBlock = 4;
  auto const add_up = [&](auto width, auto block, int64_t e) {
    constexpr int M = decltype(width)::value, U = decltype(block)::value;
    Lanes<int16_t, M> sums[U]{};
    uint8_t const* row = first + e;
    for (int k = 0; k < count; ++k, row += row_stride) {
      Lanes<int16_t, M> const weight = broadcast<M>(weights[k]);
      for (int i = 0; i < U; ++i)
        sums[i] += rounded_product<M>(load_words<M>(row + i * M) << (kFraction + 15 - kWeightBits), weight);
    }
    for (int i = 0; i < U; ++i) write_lanes<M>(line + e + i * M, sums[i]);
  };
  int64_t e = 0;
  for (; e + kBlock * kWords <= size; e += kBlock * kWords) add_up(Width<kWords>{}, Width<kBlock>{}, e);
  if (e == size) return;
  for_each_vector<uint8_t, kWords>(size < kWords ? 0 : min(e, size - kWords), size,
                                   [&](auto width, int64_t e) { add_up(width, Width<1>{}, e); });
}

// Says whether it serves these sizes. Special case: 1.8 to 3.5 times as fast as floats, 1.0 where images shrink to a
// fourteenth, one thread; numbers of pairs as constants are 1.1 to 1.4 of that.
bool resize_bytes(Resize<uint8_t> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.y.height;
  if (p.y.row_size() < ByteColumns::N || max(p.rows.max_taps, p.columns.max_taps) > kMaxByteTaps) return false;
  ByteColumns const columns(p.columns, p.y.row_size(), step);
  if (!columns.serves()) return false;
  int64_t const margin = 2 * columns.pairs * step + 8 * ByteColumns::kMaxChunks;  // bands end beyond the line
  int64_t const count = min(height, end - begin);
  int const taps = p.rows.max_taps;
  Scratch<int16_t> line(size + margin), weights(count * taps);
  Scratch<Contributors<float>> bands(count);
  for (int64_t e = size; e < size + margin; ++e) line.data[e] = 0;
  for (int64_t i = 0; i < count; ++i)
    bands.data[i] = write_byte_weights(weights.data + i * taps, p.rows, (begin + i) % height);
  auto const write = [&](uint8_t* out, auto chunks) {
    constexpr int M = decltype(chunks)::value;
    if (columns.pairs == 1) return write_byte_row<M, 1>(out, line.data, columns, step);
    if (columns.pairs == 2) return write_byte_row<M, 2>(out, line.data, columns, step);
    if (columns.pairs == 3) return write_byte_row<M, 3>(out, line.data, columns, step);
    write_byte_row<M, 0>(out, line.data, columns, step);
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, i = (r - begin) % height;
    Contributors<float> const band = bands.data[i];
    uint8_t const* const first = p.x.row(plane, band.first);
    int16_t const* const of_band = weights.data + i * taps;
    add_up_bytes(first, p.x.row_stride, of_band, band.count, size, line.data);
    uint8_t* const out = p.y.row(plane, r - plane * height);
    if (columns.chunks == 1)
      write(out, Width<1>{});
    else if (columns.chunks == 2)
      write(out, Width<2>{});
    else if (columns.chunks == 3)
      write(out, Width<3>{});
    else
      write(out, Width<4>{});
  }
  return true;
}

}  // namespace

template <class T>
void resize(Resize<T> const& p, int64_t begin, int64_t end) {
  if constexpr (sizeof(T) == 1)
    if (resize_bytes(p, begin, end)) return;
  constexpr int N = kLanes<T>;
  if (p.y.row_size() < N)
    resize_rows<1>(p, begin, end);
  else
    resize_rows<N>(p, begin, end);
}

KV_INSTANTIATE_WITH_BYTES(resize, Resize)

}  // namespace kv::geometry::KV_ISA
