// Connected components on the CPU, planes [begin, end): one pass unites each pixel with its earlier neighbors, a second
// one replaces parents by roots. Compiled once per instruction set.
#include "connected_components.h"
#include "core/lanes.h"

namespace kv::contrib::KV_ISA {
namespace {

// Labels are 1 + the index of the parent. Paths are halved on the way.
KV_HD int64_t find_root(int64_t* labels, int64_t label) {
  while (labels[label - 1] != label) label = labels[label - 1] = labels[labels[label - 1] - 1];
  return label;
}

KV_HD void unite(int64_t* labels, int64_t pixel, int64_t neighbor) {
  int64_t const a = find_root(labels, labels[pixel]), b = find_root(labels, labels[neighbor]);
  if (a < b)
    labels[b - 1] = a;
  else
    labels[a - 1] = b;
}

}  // namespace

template <class T>
void connected_components(ConnectedComponents<T> const& p, int64_t begin, int64_t end) {
  int64_t const height = p.x.height, width = p.x.width;
  for (int64_t plane = begin; plane < end; ++plane) {
    int64_t* const labels = p.labels + plane * height * width;
    for (int64_t y = 0; y < height; ++y) {
      T const* const row = p.x.row(plane, y);
      for (int64_t x = 0; x < width; ++x) {
        int64_t const i = y * width + x;
        labels[i] = 0;
        if (load<1>(row + x) != 1) continue;
        auto const is_foreground = [&](int64_t at) { return labels[at] != 0; };
        bool const left = x > 0 && is_foreground(i - 1), above = y > 0 && is_foreground(i - width);
        bool const above_left = y > 0 && x > 0 && is_foreground(i - width - 1);
        bool const above_right = y > 0 && x + 1 < width && is_foreground(i - width + 1);
        // All neighbors of the pixel above are united with it already, and the left pixel with the one above it.
        labels[i] = above ? labels[i - width] : left ? labels[i - 1] : above_left ? labels[i - width - 1] : i + 1;
        if (!above && above_right) unite(labels, i, i - width + 1);
      }
    }
    for (int64_t i = 0; i < height * width; ++i)
      if (labels[i] != 0) labels[i] = labels[labels[i] - 1];  // the parent is earlier, so its label is its root
  }
}

KV_INSTANTIATE_WITH_BYTES(connected_components, ConnectedComponents)

}  // namespace kv::contrib::KV_ISA
