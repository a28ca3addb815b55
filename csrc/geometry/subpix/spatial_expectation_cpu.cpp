// Mean coordinates on the CPU: chunks [begin, end) of all planes, each a few rows. Compiled once per instruction set.
#include "core/lanes.h"
#include "geometry/subpix/spatial_expectation.h"

namespace kv::geometry::KV_ISA {
namespace {

template <int N, class F>
KV_HD Lanes<F, N> counted_from(int64_t first) {
  F numbers[N];
  for (int i = 0; i < N; ++i) numbers[i] = F(i);
  return load<N>(numbers) + F(first);
}

// exp(scale x)
template <class F>
struct ScaledExp {
  F scale;
  template <int N>
  KV_HD Lanes<F, N> of(Lanes<F, N> x) const {
    return vexp2<F, N>(x * (scale * F(1.44269504088896340736)));
  }
};

}  // namespace

template <class T>
void spatial_expectation(SpatialExpectation<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  HeatMaps<T> const& maps = p.maps;
  ScaledExp<F> const exp{maps.scale};
  for (int64_t i = begin; i < end; ++i) {
    int64_t const plane = i / maps.chunks(), first = i % maps.chunks() * maps.rows;
    int64_t const last = min(first + maps.rows, maps.height);
    auto sums = ExpectationSums<F>::nothing(maps.softmax);
    if (maps.softmax) {
      T const* const from = maps.data + (plane * maps.height + first) * maps.width;
      Lanes<F, N> maximum = broadcast<N>(sums.maximum);
      for_each_vector<T>(0, (last - first) * maps.width, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        if constexpr (M == 1)
          sums.maximum = max(sums.maximum, F(load<1>(from + e)));
        else
          maximum = max(maximum, load<M>(from + e));
      });
      for (int k = 0; k < N; ++k) sums.maximum = max(sums.maximum, F(maximum[k]));
    }
    for (int64_t y = first; y < last; ++y) {
      T const* const row = maps.data + (plane * maps.height + y) * maps.width;
      auto const value = [&](auto width, int64_t x) {
        constexpr int M = decltype(width)::value;
        using V = Lanes<F, M>;
        V const v = load<M>(row + x);
        return maps.softmax ? exp.template of<M>(V(v - sums.maximum)) : v;
      };
      Lanes<F, N> all{}, along{};
      int64_t x = 0;
      for (; x + N <= maps.width; x += N) {
        Lanes<F, N> const v = value(Width<N>{}, x);
        all += v, along += v * maps.along_x.at(counted_from<N, F>(x));
      }
      F sum = 0, sum_x = 0;
      for (; x < maps.width; ++x) {
        F const v = value(Width<1>{}, x);
        sum += v, sum_x += v * maps.along_x.at(F(x));
      }
      for (int k = 0; k < N; ++k) sum += all[k], sum_x += along[k];
      sums.sum += sum, sums.x += sum_x, sums.y += sum * maps.along_y.at(F(y));
    }
    p.partial[i] = sums;
  }
}

template <class T>
void spatial_expectation_backward(SpatialExpectationBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  HeatMaps<T> const& maps = p.maps;
  ScaledExp<F> const exp{maps.scale};
  for (int64_t i = begin; i < end; ++i) {
    int64_t const plane = i / maps.chunks(), first = i % maps.chunks() * maps.rows;
    ExpectationGradient<T> const gradient(p, plane);
    for (int64_t y = first; y < min(first + maps.rows, maps.height); ++y) {
      int64_t const row = (plane * maps.height + y) * maps.width;
      for_each_vector<T>(0, maps.width, [&](auto width, int64_t x) {
        constexpr int M = decltype(width)::value;
        using V = Lanes<F, M>;
        V const across = maps.along_x.at(counted_from<M, F>(x)), down = broadcast<M>(maps.along_y.at(F(y)));
        V const value = load<M>(maps.data + row + x);
        store<M>(p.grad_input + row + x, gradient.at(value, across, down, [&](V v) { return exp.template of<M>(v); }));
      });
    }
  }
}

KV_INSTANTIATE(spatial_expectation, SpatialExpectation)
KV_INSTANTIATE(spatial_expectation_backward, SpatialExpectationBackward)

}  // namespace kv::geometry::KV_ISA
