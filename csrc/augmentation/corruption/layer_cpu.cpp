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

template <class T>
void fog_factors(FogFactors<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) p.find(b);
}

template <class T>
void fog_list_backward(FogBackwardList<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t item = begin; item < end; ++item) {
    auto const one = p.sample(int(item));
    int64_t const rows = one.x.count() * one.x.height;
    if (p.copies(int(item))) {
      for (int64_t r = 0; r < rows; ++r) copy_gradients<false>(one, r / one.x.height, r % one.x.height, 0, 1);
      continue;
    }
    F const most = *one.brightest;
    // Calls use(x, m, gradient, where that of x is stored, the factors).
    auto const for_each_value = [&](auto const& use) KV_INLINE {
      for (int64_t r = 0; r < rows; ++r) {
        int64_t const c = r / one.x.height, y = r % one.x.height;
        T const *const x = one.x.row(c, y), *const grad = one.grad.row(c, y);
        F const* const layer = one.layer_of(0) + c * one.layer_strides[1] + y * one.layer_strides[2];
        LayerFactors<F> const factors(one, 0, c);
        for (int64_t i = 0; i < one.x.width; ++i)
          use(F(load<1>(x + i * one.x.step)), layer[i * one.layer_strides[3]], F(load<1>(grad + i * one.grad.step)),
              one.grad_x.row(c, y) + i * one.grad_x.step, factors);
      }
    };
    LayerFactors<F> const slopes(one.slopes, F(1));
    double of_most = 0, count = 0;
    for_each_value([&](F x, F m, F g, T*, LayerFactors<F> const& factors)
                       KV_INLINE { of_most += factors.vjp_of_factors(slopes, x, m, g), count += x == most; });
    F const share = F(of_most / max(count, 1.));
    for_each_value([&](F x, F m, F g, T* to, LayerFactors<F> const& factors)
                       KV_INLINE { store<1>(to, Lanes<F, 1>(factors.vjp(x, m, g) + (x == most ? share : F(0)))); });
  }
}

KV_INSTANTIATE_WITH_BYTES(add_layer, AddLayer)
KV_INSTANTIATE_WITH_BYTES(add_layer_list, AddLayerList)
KV_INSTANTIATE(add_layer_list_backward, AddLayerBackwardList)
KV_INSTANTIATE_WITH_BYTES(fog_factors, FogFactors)
KV_INSTANTIATE(fog_list_backward, FogBackwardList)

}  // namespace kv::augmentation::KV_ISA
