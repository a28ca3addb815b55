// Snow on the CPU: rows [begin, end) of all samples. Compiled once per instruction set.
#include "augmentation/corruption/snow.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void add_snow(AddSnow<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.height, row = r % p.height;
    T const* const x = p.x + b * p.x_strides[0] + row * p.x_strides[2];
    T* const y = p.y + b * p.y_strides[0] + row * p.y_strides[2];
    for (int64_t i = 0; i < p.width; ++i) {
      T* const to = y + i * p.y_strides[3];
      p.whiten(
          x + i * p.x_strides[3], p.snow(b, row * p.width + i),
          [](T const& from) KV_INLINE { return F(load<1>(&from)); },
          [&](int c, F value) KV_INLINE { store<1>(to + c * p.y_strides[1], Lanes<F, 1>(value)); });
    }
  }
}

// An item is some rows of a sample.
template <class T>
void add_snow_list(AddSnowList<T> const& p, int64_t begin, int64_t end) {
  for (int b = p.sample_of(int(begin)); begin < end; ++b) {
    AddSnow<T> const one = p.sample(b);
    int64_t const first = p.listed[b].first, next = b + 1 < p.count ? p.listed[b + 1].first : p.items,
                  last = min(end, next), rows = rows_of_item(one.width), from = (begin - first) * rows,
                  to = min((last - first) * rows, one.height);
    if (!p.copies(b))
      KV_ISA::add_snow(one, from, to);
    else
      for (int64_t row = from; row < to; ++row)
        for (int64_t c = 0; c < one.channels; ++c)
          for (int64_t i = 0; i < one.width; ++i) {
            int64_t const at = row * one.x_strides[2] + c * one.x_strides[1] + i * one.x_strides[3];
            one.y[at] = one.x[at];
          }
    begin = last;
  }
}

KV_INSTANTIATE_WITH_BYTES(add_snow, AddSnow)
KV_INSTANTIATE_WITH_BYTES(add_snow_list, AddSnowList)

}  // namespace kv::augmentation::KV_ISA
