// The largest value of each image of a list on the CPU: images [begin, end). Compiled once per instruction set.
#include "augmentation/lists/brightest.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void brightest_list(Brightest<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t b = begin; b < end; ++b) {
    auto const x = images_of<T>(p.list.images[b], p.channels);
    F most = 0;
    for (int c = 0; c < p.channels; ++c)
      for (int64_t row = 0; row < x.height; ++row)
        for (int64_t i = 0; i < x.width; ++i) {
          F const value = load<1>(x.row(0, c, row) + i * x.step);
          most = value > most || value != value ? value : most;
        }
    p.y[b] = most;
  }
}

KV_INSTANTIATE_WITH_BYTES(brightest_list, Brightest)

}  // namespace kv::augmentation::KV_ISA
