// Images behind a layer on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include "augmentation/corruption/layer.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void add_layer(AddLayer<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.height, y = r % p.height, b = plane / p.channels, c = plane % p.channels;
    T const* const x = p.x + b * p.x_strides[0] + c * p.x_strides[1] + y * p.x_strides[2];
    T* const result = p.y + b * p.y_strides[0] + c * p.y_strides[1] + y * p.y_strides[2];
    F const* const layer = p.layer_of(b) + c * p.layer_strides[1] + y * p.layer_strides[2];
    LayerFactors<F> const factors(p, b, c);
    for (int64_t i = 0; i < p.width; ++i) {
      F const value = factors.behind(F(load<1>(x + i * p.x_strides[3])), layer[i * p.layer_strides[3]]);
      store<1>(result + i * p.y_strides[3], Lanes<F, 1>(value));
    }
  }
}

KV_INSTANTIATE_WITH_BYTES(add_layer, AddLayer)

}  // namespace kv::augmentation::KV_ISA
