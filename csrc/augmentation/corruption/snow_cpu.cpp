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

KV_INSTANTIATE_WITH_BYTES(add_snow, AddSnow)

}  // namespace kv::augmentation::KV_ISA
