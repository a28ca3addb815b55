// Points and normals of depth images on the CPU: rows [begin, end) of all images in order. Compiled once per
// instruction set.
#include "core/lanes.h"
// After it, for vsqrt.
#include "depth_points.h"

namespace kv::KV_ISA {
namespace {

template <int N, class F>
KV_HD Lanes<F, N> columns_from(int64_t first) {
  if constexpr (N == 1) {
    return F(first);
  } else {
    Lanes<F, N> v;
    for (int i = 0; i < N; ++i) v[i] = F(i);
    return v + F(first);
  }
}

// Vectors where pixels are beside one another in both images, single ones elsewhere.
template <class T, class A, class B, class Call>
KV_HD void for_each_pixel(A const& a, B const& b, int64_t begin, int64_t end, Call f) {
  if (a.step == 1 && b.step == 1)
    for_each_vector<T>(begin, end, f);
  else
    for (int64_t x = begin; x < end; ++x) f(Width<1>{}, x);
}

}  // namespace

template <class T>
void depth_points(DepthPoints<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.y.height, y = r % p.y.height;
    Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
    T const* const depth = p.depth.row(b, 0, y);
    for_each_pixel<T>(p.depth, p.y, 0, p.y.width, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> ray[3], d = load<N>(depth + x * p.depth.step);
      rays.at(columns_from<N, F>(x), F(y), ray);
      for (int k = 0; k < 3; ++k) store<N>(p.y.row(b, k, y) + x * p.y.step, Lanes<F, N>(ray[k] * d));
    });
  }
}

template <class T>
void depth_points_backward(DepthPointsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.grad.height, y = r % p.grad.height;
    Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
    for_each_pixel<T>(p.grad, p.to_depth, 0, p.grad.width, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> ray[3], sum{};
      rays.at(columns_from<N, F>(x), F(y), ray);
      for (int k = 0; k < 3; ++k) sum += ray[k] * load<N>(p.grad.row(b, k, y) + x * p.grad.step);
      store<N>(p.to_depth.row(b, 0, y) + x, sum);
    });
  }
}

template <class T>
void depth_normals(DepthPoints<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.y.height, width = p.y.width;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
    int64_t const rows[] = {max(y - 1, int64_t(0)), y, min(y + 1, height - 1)};
    auto const pixel = [&](auto lanes, int64_t left, int64_t x, int64_t right) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      V normal[3];
      auto const point = [&](int j, int i, V(&to)[3]) {
        int64_t const column = i == 0 ? left : i == 1 ? x : right;
        V const d = load<N>(p.depth.row(b, 0, rows[j]) + column * p.depth.step);
        rays.at(columns_from<N, F>(column), F(rows[j]), to);
        for (int k = 0; k < 3; ++k) to[k] = to[k] * d;
      };
      normal_of(point, normal);
      for (int k = 0; k < 3; ++k) store<N>(p.y.row(b, k, y) + x * p.y.step, normal[k]);
    };
    pixel(Width<1>{}, 0, 0, min(int64_t(1), width - 1));
    for_each_pixel<T>(p.depth, p.y, 1, width - 1, [&](auto lanes, int64_t x) { pixel(lanes, x - 1, x, x + 1); });
    if (width > 1) pixel(Width<1>{}, width - 2, width - 1, width - 1);
  }
}

KV_INSTANTIATE(depth_points, DepthPoints)
KV_INSTANTIATE(depth_points_backward, DepthPointsBackward)
KV_INSTANTIATE(depth_normals, DepthPoints)

}  // namespace kv::KV_ISA
