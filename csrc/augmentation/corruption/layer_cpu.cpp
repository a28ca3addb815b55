// Images behind a layer on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include "augmentation/corruption/layer.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {
namespace {

template <class T>
KV_HD void put_behind(AddLayer<T> const& p, int64_t b, int64_t c, int64_t y) {
  using F = Compute<T>;
  T const* const x = p.row(p.x, b, c, y);
  T* const result = p.row(p.y, b, c, y);
  F const* const layer = p.layer_of(b) + c * p.layer_strides[1] + y * p.layer_strides[2];
  LayerFactors<F> const factors(p, b, c);
  for (int64_t i = 0; i < p.x.width; ++i) {
    F const value = factors.behind(F(load<1>(x + i * p.x.step)), layer[i * p.layer_strides[3]]);
    store<1>(result + i * p.y.step, Lanes<F, 1>(value));
  }
}

}  // namespace

template <class T>
void add_layer(AddLayer<T> const& p, int64_t begin, int64_t end) {
  int64_t const planes = p.planes_per_sample();
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height, b = plane / planes;
    if (planes > 1)
      put_behind(p, b, plane % planes, y);
    else
      for (int64_t c = 0; c < p.channels; ++c) put_behind(p, b, c, y);
  }
}

template <class T>
void add_layer_list(AddLayerList<T> const& p, int64_t begin, int64_t end) {
  filter_items(p, begin, end,
               [](AddLayer<T> const& one, int64_t first, int64_t last) { KV_ISA::add_layer(one, first, last); });
}

template <class T>
void add_layer_list_backward(AddLayerBackwardList<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  gradient_items(p, begin, end, [](AddLayerBackward<T> const& one, int64_t first, int64_t last) {
    for (int64_t r = first; r < last; ++r) {
      int64_t const c = r / one.x.height, y = r % one.x.height;
      T const *const x = one.x.row(c, y), *const grad = one.grad.row(c, y);
      T* const to = one.grad_x.row(c, y);
      F const* const layer = one.layer_of(0) + c * one.layer_strides[1] + y * one.layer_strides[2];
      LayerFactors<F> const factors(one, 0, c);
      for (int64_t i = 0; i < one.x.width; ++i) {
        F const g = factors.vjp(F(load<1>(x + i * one.x.step)), layer[i * one.layer_strides[3]],
                                F(load<1>(grad + i * one.grad.step)));
        store<1>(to + i * one.grad_x.step, Lanes<F, 1>(g));
      }
    }
  });
}

KV_INSTANTIATE_WITH_BYTES(add_layer, AddLayer)
KV_INSTANTIATE_WITH_BYTES(add_layer_list, AddLayerList)
KV_INSTANTIATE(add_layer_list_backward, AddLayerBackwardList)

}  // namespace kv::augmentation::KV_ISA
