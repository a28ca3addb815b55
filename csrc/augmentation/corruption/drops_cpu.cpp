// Drops on the CPU: bands [begin, end) of rows of all layers. Compiled once per instruction set.
#include "augmentation/corruption/drops.h"
#include "core/ceil_div.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::augmentation::KV_ISA {

namespace {

constexpr int kBand = kDropBand;

// Calls f(sample, first row, end) for bands.
template <class T, class Call>
KV_HD void for_each_band(Drops<T> const& drops, int64_t begin, int64_t end, Call const& f) {
  int64_t const bands = ceil_div(drops.height, int64_t(kBand));
  for (int64_t unit = begin; unit < end; ++unit) {
    int const top = int(unit % bands) * kBand;
    f(unit / bands, top, int(min(drops.height, int64_t(top) + kBand)));
  }
}

// Whether a pixel is that of an outline: inside of a drop, next to one in the image that is not.
template <class T>
KV_HD bool is_outline(Drops<T> const& drops, int64_t b, int row, int column) {
  int const width = int(drops.width), at = row * width + column;
  return drops.is_inside(b, at) &&
         !((row == 0 || drops.is_inside(b, at - width)) &&
           (row + 1 == drops.height || drops.is_inside(b, at + width)) && (column == 0 || drops.is_inside(b, at - 1)) &&
           (column + 1 == width || drops.is_inside(b, at + 1)));
}

}  // namespace

template <class T>
void drop_depths(DropDepths<T> const& p, int64_t begin, int64_t end) {
  constexpr int kFar = kFarFromOutline;
  int const height = int(p.drops.height), width = int(p.drops.width);
  Scratch<uint8_t> along_rows(int64_t(kBand + 2 * kFar) * width);
  Scratch<float> distances(int64_t(kBand + 2) * width);
  for_each_band(p.drops, begin, end, [&](int64_t b, int top, int bottom) KV_INLINE {
    int const first = max(top - kFar, 0), last = min(bottom + kFar, height);
    for (int row = first; row < last; ++row) {
      uint8_t* const near = along_rows.data + int64_t(row - first) * width;
      for (int x = 0, steps = kFar; x < width; ++x) {
        steps = is_outline(p.drops, b, row, x) ? 0 : min(steps + 1, kFar);
        near[x] = uint8_t(steps);
      }
      for (int x = width - 2; x >= 0; --x) near[x] = uint8_t(min(int(near[x]), near[x + 1] + 1));
    }
    int const above = max(top - 1, 0), below = min(bottom + 1, height);
    for (int row = above; row < below; ++row)
      for (int x = 0; x < width; ++x) {
        int square = kFar * kFar;
        for (int other = max(row - kFar + 1, 0); other < min(row + kFar, height); ++other) {
          int const across = along_rows.data[int64_t(other - first) * width + x];
          square = min(square, (other - row) * (other - row) + across * across);
        }
        distances.data[int64_t(row - above) * width + x] = sqrt(float(square));
      }
    for (int row = top; row < bottom; ++row)
      for (int x = 0; x < width; ++x) {
        float const sum = sum_of_nine<float>([&](int down, int right) KV_INLINE {
          int64_t const from = reflected(row + down, height) - above;
          return distances.data[from * width + reflected(x + right, width)];
        });
        p.y[(b * height + row) * width + x] = uint8_t(sum / 9);
      }
  });
}

template <class T>
void drop_reliefs(DropReliefs<T> const& p, int64_t begin, int64_t end) {
  int const height = int(p.drops.height), width = int(p.drops.width);
  Scratch<uint8_t> lights(int64_t(kBand + 2) * width);
  for_each_band(p.drops, begin, end, [&](int64_t b, int top, int bottom) KV_INLINE {
    uint8_t const* const depths = p.depths + b * height * width;
    int const above = max(top - 1, 0), below = min(bottom + 1, height);
    for (int row = above; row < below; ++row)
      for (int x = 0; x < width; ++x)
        lights.data[int64_t(row - above) * width + x] = uint8_t(lit([&](int down, int right) KV_INLINE {
          return int(depths[int64_t(reflected(row + down, height)) * width + reflected(x + right, width)]);
        }));
    for (int row = top; row < bottom; ++row)
      for (int x = 0; x < width; ++x) {
        int const sum = sum_of_nine<int>([&](int down, int right) KV_INLINE {
          int64_t const from = reflected(row + down, height) - above;
          return int(lights.data[from * width + reflected(x + right, width)]);
        });
        int64_t const at = int64_t(row) * width + x;
        p.y[b * height * width + at] = T(rounded_ninth(sum)) * p.drops.level(b, at);
      }
  });
}

template <class T>
void mark_stains(MarkStains<T> const& p, int64_t begin, int64_t end) {
  for_each_band(p.drops, begin, end, [&](int64_t b, int top, int bottom) KV_INLINE {
    T const threshold = p.drops.threshold(b);
    T* const y = p.y + b * p.drops.height * p.drops.width;
    for (int64_t at = top * p.drops.width; at < bottom * p.drops.width; ++at)
      y[at] = T(p.drops.value(b, at) > threshold);
  });
}

namespace {

// Calls run(layer, first band, end) for the items [begin, end) of a list.
template <class List, class Run>
KV_HD void for_each_layer(List const& p, int64_t begin, int64_t end, Run const& run) {
  for (int b = p.sample_of(int(begin)); begin < end; ++b) {
    int64_t const first = p.listed[b].first, next = b + 1 < p.count ? p.listed[b + 1].first : p.items;
    int64_t const last = min(end, next);
    run(p.sample(b), begin - first, last - first);
    begin = last;
  }
}

}  // namespace

template <class T>
void drop_depths_list(DropDepthsList<T> const& p, int64_t begin, int64_t end) {
  for_each_layer(p, begin, end,
                 [](DropDepths<T> const& one, int64_t first, int64_t last) { KV_ISA::drop_depths(one, first, last); });
}
template <class T>
void drop_reliefs_list(DropReliefsList<T> const& p, int64_t begin, int64_t end) {
  for_each_layer(p, begin, end, [](DropReliefs<T> const& one, int64_t first, int64_t last) {
    KV_ISA::drop_reliefs(one, first, last);
  });
}
template <class T>
void mark_stains_list(MarkStainsList<T> const& p, int64_t begin, int64_t end) {
  for_each_layer(p, begin, end,
                 [](MarkStains<T> const& one, int64_t first, int64_t last) { KV_ISA::mark_stains(one, first, last); });
}

KV_INSTANTIATE_COMPUTED(drop_depths, DropDepths)
KV_INSTANTIATE_COMPUTED(drop_reliefs, DropReliefs)
KV_INSTANTIATE_COMPUTED(mark_stains, MarkStains)
KV_INSTANTIATE_COMPUTED(drop_depths_list, DropDepthsList)
KV_INSTANTIATE_COMPUTED(drop_reliefs_list, DropReliefsList)
KV_INSTANTIATE_COMPUTED(mark_stains_list, MarkStainsList)

}  // namespace kv::augmentation::KV_ISA
