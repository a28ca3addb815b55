// The range of planes on the CPU. Compiled once per instruction set.
#include "channels/flat_plane_cpu.h"
#include "core/product.h"
#include "min_max.h"

namespace kv::enhance::KV_ISA {
namespace {

// The sum of a vector's lanes, in order.
template <class V, int N>
KV_HD double sum_of(V const& v) {
  if constexpr (N == 1) {
    return v;
  } else {
    double sum = 0;
    for (int i = 0; i < N; ++i) sum += v[i];
    return sum;
  }
}

}  // namespace

template <class T>
void min_max(MinMax<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  using V = Lanes<F, N>;
  int64_t const n = p.x.width, step = p.x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const* const x = p.x.plane(plane);
    T* const y = p.y.plane(plane);
    F const first = load<1>(x);
    V low = broadcast<N>(first), high = low;
    F smallest = first, largest = first;
    bool is_number = true;
    auto numbers = low == low;
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) {
      constexpr int M = decltype(width)::value;
      auto const v = load<M>(x + i);
      if constexpr (M == N && N > 1) {
        low = min(low, v), high = max(high, v);
        numbers = numbers & (v == v);
      } else {
        smallest = min(smallest, v), largest = max(largest, v);
        is_number = is_number && v == v;
      }
    });
    for (int i = 0; i < N; ++i) {
      smallest = min(smallest, F(low[i])), largest = max(largest, F(high[i]));
      is_number = is_number && numbers[i];
    }
    if (!is_number) smallest = largest = F(__builtin_nanf(""));
    store<1>(p.range + 2 * plane, smallest);
    store<1>(p.range + 2 * plane + 1, largest);
    F const factor = p.scale / (largest - smallest + p.eps);
    bool const stays = p.keeps_flat && smallest == largest;
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> const v = load<M>(x + i);
      store<M>(y + i, stays ? v : p.mapped(v, smallest, factor));
    });
  }
}

template <class T>
void min_max_list(MinMaxList<T> const& p, int64_t begin, int64_t end) {
  channel_items(p, begin, end, [](MinMax<T> const& one, int64_t first, int64_t last) {
    KV_ISA::min_max(flat_sample(one), first, last);
  });
}

template <class T>
void min_max_backward(MinMaxBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  int64_t const n = p.x.width, step = p.x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const *const x = p.x.plane(plane), *const g = p.grad.plane(plane);
    T* const grad_x = p.grad_x.plane(plane);
    F const smallest = load<1>(p.range + 2 * plane), largest = load<1>(p.range + 2 * plane + 1);
    if (p.keeps_flat && smallest == largest) {
      for_each_pixel<T>(n, step, [&](auto width, int64_t i) {
        constexpr int M = decltype(width)::value;
        store<M>(grad_x + i, load<M>(g + i));
      });
      continue;
    }
    RangeSums<double> all{};
    Lanes<F, N> grad{}, product{}, low{}, high{};
    int pending = 0;
    auto const add_up = [&] {
      all.grad += sum_of<Lanes<F, N>, N>(grad), all.product += sum_of<Lanes<F, N>, N>(product);
      all.smallest += sum_of<Lanes<F, N>, N>(low), all.largest += sum_of<Lanes<F, N>, N>(high);
      grad = product = low = high = Lanes<F, N>{};
      pending = 0;
    };
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) {
      constexpr int M = decltype(width)::value;
      auto const v = load<M>(x + i), u = load<M>(g + i);
      if constexpr (M == N && N > 1) {
        grad = grad + u, product = product + u * (v - smallest);
        low = low + (v == smallest ? broadcast<N>(F(1)) : broadcast<N>(F(0)));
        high = high + (v == largest ? broadcast<N>(F(1)) : broadcast<N>(F(0)));
        if (++pending == 64) add_up();
      } else {
        all.grad += u, all.product += double(u) * (v - smallest);
        all.smallest += v == smallest, all.largest += v == largest;
      }
    });
    add_up();
    RangeGradient<double> const to(all, smallest, largest, p.scale, p.eps);
    F const factor = F(to.factor), grad_smallest = F(to.grad_smallest), grad_largest = F(to.grad_largest);
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) {
      constexpr int M = decltype(width)::value;
      auto const v = load<M>(x + i);
      auto const zero = broadcast<M>(F(0));
      // Rounded, as the gradient of the range is that cancels it in a plane of one pixel.
      auto const own = kv::product(load<M>(g + i), broadcast<M>(factor));
      store<M>(grad_x + i, own + (v == smallest ? broadcast<M>(grad_smallest) : zero) +
                               (v == largest ? broadcast<M>(grad_largest) : zero));
    });
  }
}

template <class T>
void min_max_list_backward(MinMaxBackwardList<T> const& p, int64_t begin, int64_t end) {
  channel_gradient_items(p, begin, end, [](MinMaxBackward<T> const& one, int64_t first, int64_t last) {
    KV_ISA::min_max_backward(one, first, last);
  });
}

KV_INSTANTIATE(min_max, MinMax)
KV_INSTANTIATE(min_max_list, MinMaxList)
KV_INSTANTIATE(min_max_backward, MinMaxBackward)
KV_INSTANTIATE(min_max_list_backward, MinMaxBackwardList)

}  // namespace kv::enhance::KV_ISA
