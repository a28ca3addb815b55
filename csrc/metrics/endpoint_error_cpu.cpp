// Endpoint errors on the CPU: chunks [begin, end) of all rows. Compiled once per instruction set.
#include "core/lanes.h"
#include "endpoint_error.h"

namespace kv::metrics::KV_ISA {
namespace {

// The lanes I of two vectors, counted through both.
template <int... I, class V>
KV_HD V chosen(V a, V b) {
  return __builtin_shufflevector(a, b, I...);
}

// Both components of M 2-vectors.
template <class F, int M>
struct Components {
  using V = Lanes<F, M>;
  V first, second;

  template <class T>
  KV_HD static Components of(T const* from, bool planar, int64_t adjacent) {
    if constexpr (M > 1)
      if (!planar) {
        V const a = load<M>(from), b = load<M>(from + M);
        return {every_second<0>(a, b), every_second<1>(a, b)};
      }
    return {V(load<M>(from)), V(load<M>(from + adjacent))};
  }
  template <class T>
  KV_HD void to(T* to, bool planar, int64_t adjacent) const {
    if constexpr (M > 1)
      if (!planar) {
        store<M>(to, joined(std::make_integer_sequence<int, M>(), From<0>()));
        store<M>(to + M, joined(std::make_integer_sequence<int, M>(), From<M / 2>()));
        return;
      }
    store<M>(to, first), store<M>(to + adjacent, second);
  }

 private:
  template <int First>
  struct From {};
  template <int... I, int First>
  KV_HD V joined(std::integer_sequence<int, I...>, From<First>) const {
    return chosen<First + I / 2 + I % 2 * M...>(first, second);
  }
};

template <int M, class T>
KV_HD Components<Compute<T>, M> difference(VectorPairs<T> const& p, int64_t row, int64_t i) {
  using C = Components<Compute<T>, M>;
  C const x = C::of(p.x + row * p.x_stride + p.at(i), p.planar, p.adjacent());
  C const y = C::of(p.y + row * p.y_stride + p.at(i), p.planar, p.adjacent());
  return {x.first - y.first, x.second - y.second};
}

template <class F, int M>
KV_HD Lanes<F, M> length(Components<F, M> const& d) {
  return vsqrt(Lanes<F, M>(d.first * d.first + d.second * d.second));
}

}  // namespace

template <class T>
void endpoint_error(EndpointError<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  int64_t const chunks = p.pairs.chunks(), size = p.pairs.size;
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / chunks, first = i % chunks * kEndpointChunk, last = min(first + kEndpointChunk, size);
    if (p.map) {
      for_each_vector<T>(first, last, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        store<M>(p.map + row * size + e, length<F, M>(difference<M>(p.pairs, row, e)));
      });
      continue;
    }
    Lanes<F, N> sums{};
    int64_t e = first;
    for (; e + N <= last; e += N) sums += length<F, N>(difference<N>(p.pairs, row, e));
    F sum = 0;
    for (; e < last; ++e) sum += length<F, 1>(difference<1>(p.pairs, row, e));
    for (int l = 0; l < N; ++l) sum += sums[l];
    p.partial[i] = sum;
  }
}

template <class T>
void endpoint_error_backward(EndpointErrorBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const chunks = p.pairs.chunks(), size = p.pairs.size;
  for (int64_t i = begin; i < end; ++i) {
    int64_t const row = i / chunks, first = i % chunks * kEndpointChunk, last = min(first + kEndpointChunk, size);
    F const of_row = p.grad ? F(0) : p.grad_of_sum[row] * p.factor;
    for_each_vector<T>(first, last, [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      using V = Lanes<F, M>;
      auto d = difference<M>(p.pairs, row, e);
      V const zero{}, error = length<F, M>(d), g = p.grad ? V(load<M>(p.grad + row * size + e)) : zero + of_row;
      V const scale = error == zero ? zero : V(g / error);
      d.first *= scale, d.second *= scale;
      d.to(p.grad_x + 2 * row * size + p.pairs.at(e), p.pairs.planar, p.pairs.adjacent());
    });
  }
}

KV_INSTANTIATE(endpoint_error, EndpointError)
KV_INSTANTIATE(endpoint_error_backward, EndpointErrorBackward)

}  // namespace kv::metrics::KV_ISA
