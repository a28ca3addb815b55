// Peaks of scale spaces on the CPU: bands of rows of all samples, then samples, [begin, end). Compiled once per
// instruction set.
#include "core/any_lane.h"
#include "core/scratch.h"
#include "feature/scale_space/scale_space_peaks.h"

namespace kv::feature::KV_ISA {
namespace {

template <class T>
KV_HD auto response_of(bool differences, int64_t plane) {
  auto const load_one = [](T const* p) KV_INLINE { return load<1>(p); };
  return ResponseAt<T, decltype(load_one)>{differences ? plane : 0, load_one};
}

// Three rows of the response of all levels, around row y.
template <class T>
struct ResponseRows {
  using F = Compute<T>;
  T const* levels;  // of the sample
  int depth, height, width;
  bool differences;
  Scratch<F> memory;

  KV_HD ResponseRows(ScaleSpacePeaks<T> const& p) : differences(p.differences), memory(3 * longest(p)) {}
  // Of a level in all octaves.
  static KV_HD int64_t longest(ScaleSpacePeaks<T> const& p) {
    int64_t size = 0;
    for (int o = 0; o < p.octave_count; ++o) size = max(size, int64_t(p.octaves[o].size[0]) * p.octaves[o].size[2]);
    return size;
  }
  KV_HD void start(PeakOctave<T> const& octave, int64_t sample) {
    levels = octave.of_sample(sample, differences);
    depth = octave.size[0], height = octave.size[1], width = octave.size[2];
  }
  KV_HD F* row(int z, int y) const { return memory.data + (int64_t(y % 3) * depth + z) * width; }
  KV_HD void fill(int y) const {
    int64_t const plane = int64_t(height) * width;
    for (int z = 0; z < depth; ++z) {
      T const* const from = levels + z * plane + int64_t(y) * width;
      F* const to = row(z, y);
      if (differences)
        for_each_vector<T>(0, width, [&](auto n, int64_t x) KV_INLINE {
          constexpr int N = decltype(n)::value;
          store<N>(to + x, Lanes<F, N>(load<N>(from + plane + x) - load<N>(from + x)));
        });
      else
        for_each_vector<T>(0, width, [&](auto n, int64_t x) KV_INLINE {
          constexpr int N = decltype(n)::value;
          store<N>(to + x, load<N>(from + x));
        });
    }
  }

  // Calls visit(x, is_maximum) for the extrema of row y of level z.
  template <class Visit>
  KV_HD void extrema(int z, int y, bool minima, Visit visit) const {
    F const* rows[3][3];
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j) rows[k][j] = row(z + k - 1, y + j - 1);
    auto const visit_extremum = [&](int64_t x) KV_INLINE {
      F const v = rows[1][1][x];
      bool above = true, below = minima;
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j)
          for (int i = -1; i <= 1; ++i) {
            if (k == 1 && j == 1 && i == 0) continue;
            above = above && v > rows[k][j][x + i];
            below = below && v < rows[k][j][x + i];
          }
      if (above || below) visit(int(x), above);
    };
    constexpr int N = kLanes<T>;
    using V = Lanes<F, N>;
    int64_t x = 1;
    for (; x + N < width; x += N) {
      V const v = load<N>(rows[1][1] + x);
      V highest = load<N>(rows[1][1] + x - 1), lowest = highest;
      auto const compare = [&](F const* other) KV_INLINE {
        V const o = load<N>(other + x);
        highest = max(highest, o), lowest = min(lowest, o);
      };
      // The extrema, and pixels beside NaN, which max and min may ignore.
      auto const candidates = [&]() KV_INLINE {
        auto const above = v > highest;
        return minima ? above | (v < lowest) : above;
      };
      // Few pixels are extrema of their level, so most vectors end here.
      compare(rows[1][1] + 1), compare(rows[0][1]), compare(rows[2][1]);
      for (int j = 0; j < 3; j += 2)
        for (int i = -1; i <= 1; ++i) compare(rows[1][j] + i);
      if (!any_lane(candidates())) continue;
      for (int k = 0; k < 3; k += 2)
        for (int j = 0; j < 3; ++j)
          for (int i = -1; i <= 1; ++i) compare(rows[k][j] + i);
      auto const remaining = candidates();
      if (!any_lane(remaining)) continue;
      for (int i = 0; i < N; ++i)
        if (remaining[i]) visit_extremum(x + i);
    }
    for (; x + 1 < width; ++x) visit_extremum(x);
  }
};

// Whether a pixel of an image differs from its first one.
template <class T>
KV_HD bool varies(T const* image, int64_t pixels) {
  for (int64_t i = 1; i < pixels; ++i)
    if (!(load<1>(image + i) == load<1>(image))) return true;
  return pixels > 0 && !(load<1>(image) == load<1>(image));
}

}  // namespace

template <class T>
void find_scale_space_peaks(ScaleSpacePeaks<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  ResponseRows<T> rows(p);
  for (int64_t band = begin; band < end; ++band) {
    int64_t const sample = band / p.parts_of_sample;
    int const part = int(band % p.parts_of_sample);
    PeakOctave<T> const& octave = p.octave_of_part(part);
    auto const read = response_of<T>(p.differences, octave.plane());
    rows.start(octave, sample);
    int64_t const count = peak_rows(rows.width), first = (part - octave.first_part) * count;
    int const from = int(max(first, int64_t(1))), to = int(min(first + count, int64_t(rows.height - 1)));
    StrongestPeaks<F> strongest{p.bands + band * p.count, p.count, 0};
    if (from < to) rows.fill(from - 1), rows.fill(from);
    for (int y = from; y < to; ++y) {
      rows.fill(y + 1);
      for (int z = 1; z + 1 < rows.depth; ++z)
        rows.extrema(z, y, p.minima, [&](int x, bool is_maximum) KV_INLINE {
          auto const around = [&](int dy, int dx) KV_INLINE { return rows.row(z, y + dy)[x + dx]; };
          refine_peak(p, octave, sample, rows.levels, z, y, x, is_maximum, read, around,
                      [&](ScaleSpacePeak<F> const& peak) KV_INLINE { strongest.add(peak); });
        });
    }
    p.sizes[band] = strongest.size;
  }
}

template <class T>
void sort_scale_space_peaks(ScaleSpacePeaks<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Scratch<ScaleSpacePeak<F>> memory(p.count);
  for (int64_t sample = begin; sample < end; ++sample) {
    StrongestPeaks<F> strongest{memory.data, p.count, 0};
    bool const has_peaks = !p.images || varies(p.images + sample * p.pixels, p.pixels);
    int64_t const first = sample * p.parts_of_sample, last = has_peaks ? first + p.parts_of_sample : first;
    for (int64_t band = first; band < last; ++band)
      for (int64_t i = 0; i < p.sizes[band]; ++i) strongest.add(p.bands[band * p.count + i]);
    int64_t const count = strongest.size;
    strongest.sort();
    for (int64_t i = 0; i < p.count; ++i)
      store_peak(p, sample * p.count + i, i < count ? memory.data[i] : ScaleSpacePeak<F>{0, 0, 0, 0, 0, -1});
  }
}

template <class T>
void scale_space_peaks_backward(ScaleSpacePeaksBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const plane = int64_t(p.search.size[1]) * p.search.size[2], size = (p.search.size[0] + p.differences) * plane;
  auto const read = response_of<T>(p.differences, plane);
  for (int64_t sample = begin; sample < end; ++sample) {
    T const* const levels = p.levels + sample * size;
    F* const grad = p.grad_levels + sample * size;
    auto const add = [&](int64_t voxel, F number) KV_INLINE {
      if (p.differences)
        grad[voxel + plane] += number, grad[voxel] -= number;
      else
        grad[voxel] += number;
    };
    for (int64_t i = 0; i < size; ++i) grad[i] = 0;
    for (int64_t k = sample * p.count; k < (sample + 1) * p.count; ++k) peak_vjp(p, k, levels, read, add);
  }
}

KV_INSTANTIATE(find_scale_space_peaks, ScaleSpacePeaks)
KV_INSTANTIATE(sort_scale_space_peaks, ScaleSpacePeaks)
KV_INSTANTIATE(scale_space_peaks_backward, ScaleSpacePeaksBackward)

}  // namespace kv::feature::KV_ISA
