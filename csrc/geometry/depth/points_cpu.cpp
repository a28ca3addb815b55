// Points and normals of depth images on the CPU: rows [begin, end) of all images in order. Compiled once per
// instruction set.
#include "core/iota.h"
#include "core/lanes.h"
#include "core/scratch.h"
// Included after core/lanes.h, whose vsqrt it uses.
#include "geometry/depth/points.h"

namespace kv::geometry::KV_ISA {
namespace {

// Calls f for vectors if pixels are adjacent in both images, else for single pixels.
template <class T, class A, class B, class Call>
KV_HD void for_each_pixel(A const& a, B const& b, int64_t begin, int64_t end, Call f) {
  if (a.step == 1 && b.step == 1)
    for_each_vector<T>(begin, end, f);
  else
    for (int64_t x = begin; x < end; ++x) f(Width<1>{}, x);
}

// Calls f(lanes, x, along_x, along_y) with the derivatives of points along a row of depth, once for each pixel. Uses
// vectors if pixels are adjacent in `other`, too.
template <class T, class P, class Other, class Call>
KV_HD void for_each_tangents(P const& p, Other const& other, int64_t b, int64_t y, Call f) {
  using F = Compute<T>;
  int64_t const height = p.depth.height, width = p.depth.width;
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  int64_t const rows[] = {max(y - 1, int64_t(0)), y, min(y + 1, height - 1)};
  F const down[] = {rays.down(F(rows[0])), rays.down(F(rows[1])), rays.down(F(rows[2]))};
  auto const pixel = [&](auto lanes, int64_t left, int64_t x, int64_t right) {
    constexpr int N = decltype(lanes)::value;
    using V = Lanes<F, N>;
    V along_x[3], along_y[3];
    auto const column = [&](int64_t at) {
      V const u = rays.across(iota<N, F>(at));
      V z[3];
      for (int j = 0; j < 3; ++j) z[j] = rays.z_of(u, down[j], load<N>(p.depth.row(b, 0, rows[j]) + at * p.depth.step));
      return PointColumn<V>(u, down, z);
    };
    tangents_of(column(left), column(x), column(right), along_x, along_y);
    f(lanes, x, along_x, along_y);
  };
  pixel(Width<1>{}, 0, 0, min(int64_t(1), width - 1));
  for_each_pixel<T>(p.depth, other, 1, width - 1, [&](auto lanes, int64_t x) { pixel(lanes, x - 1, x, x + 1); });
  if (width > 1) pixel(Width<1>{}, width - 2, width - 1, width - 1);
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
      rays.at(iota<N, F>(x), F(y), ray);
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
    for_each_pixel<T>(p.grad, p.grad_depth, 0, p.grad.width, [&](auto lanes, int64_t x) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> ray[3], sum{};
      rays.at(iota<N, F>(x), F(y), ray);
      for (int k = 0; k < 3; ++k) sum += ray[k] * load<N>(p.grad.row(b, k, y) + x * p.grad.step);
      store<N>(p.grad_depth.row(b, 0, y) + x, sum);
    });
  }
}

template <class T>
void depth_normals(DepthPoints<T> const& p, int64_t begin, int64_t end) {
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.y.height, y = r % p.y.height;
    for_each_tangents<T>(p, p.y, b, y, [&](auto lanes, int64_t x, auto const& along_x, auto const& along_y) {
      constexpr int N = decltype(lanes)::value;
      Lanes<Compute<T>, N> normal[3];
      normal_of(along_x, along_y, normal);
      for (int k = 0; k < 3; ++k) store<N>(p.y.row(b, k, y) + x * p.y.step, normal[k]);
    });
  }
}

template <class T>
void depth_normals_backward(DepthNormalsBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.depth.height, width = p.depth.width, padded = width + 2;
  Scratch<F> const scratch(3 * 6 *
                           padded);  // for three rows, the gradients to both derivatives; 0 outside of the image
  for (int64_t i = 0; i < 3 * 6 * padded; ++i) scratch.data[i] = 0;
  auto const gradients = [&](int64_t y, int k) { return scratch.data + ((y + 3) % 3 * 6 + k) * padded + 1; };
  auto const fill = [&](int64_t b, int64_t y) {
    if (y < 0 || y >= height) {
      for (int64_t x = 0; x < 6 * padded; ++x) gradients(y, 0)[x - 1] = 0;
      return;
    }
    for_each_tangents<T>(p, p.grad, b, y, [&](auto lanes, int64_t x, auto const& along_x, auto const& along_y) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> grad[3], grad_x[3], grad_y[3];
      for (int k = 0; k < 3; ++k) grad[k] = load<N>(p.grad.row(b, k, y) + x * p.grad.step);
      normal_vjp(along_x, along_y, grad, grad_x, grad_y);
      for (int k = 0; k < 3; ++k)
        store<N>(gradients(y, k) + x, grad_x[k]), store<N>(gradients(y, 3 + k) + x, grad_y[k]);
    });
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    for (int64_t next = r == begin || y == 0 ? y - 1 : y + 1; next <= y + 1; ++next) fill(b, next);
    Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
    Taken<F> const down(y, height);
    auto const pixel = [&](auto lanes, int64_t x, Taken<F> const& across) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> ray[3], grad_point[3] = {};
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) {
          F const *const grad_x = gradients(y - 1 + j, k) + x, *const grad_y = gradients(y - 1 + j, 3 + k) + x;
          for (int i = 0; i < 3; ++i)
            grad_point[k] += load<N>(grad_x + i - 1) * (across.difference[i] * down.mean[j]) +
                             load<N>(grad_y + i - 1) * (across.mean[i] * down.difference[j]);
        }
      if (p.to_points) {
        for (int k = 0; k < 3; ++k) store<N>(p.to.row(b, k, y) + x * p.to.step, grad_point[k]);
      } else {
        rays.at(iota<N, F>(x), F(y), ray);
        store<N>(p.to.row(b, 0, y) + x * p.to.step, dot3(ray, grad_point));
      }
    };
    pixel(Width<1>{}, 0, Taken<F>(0, width));
    for_each_pixel<T>(p.to, p.to, 1, width - 1, [&](auto lanes, int64_t x) { pixel(lanes, x, Taken<F>(1, 3)); });
    pixel(Width<1>{}, width - 1, Taken<F>(width - 1, width));
  }
}

// A chunk is a row: its pixels in vectors, then the remaining ones.
template <class T>
void depth_points_camera_backward(DepthPointsCameraBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / p.grad.height, y = r % p.grad.height, step = p.grad.step, depth_step = p.depth.step;
    Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
    Lanes<F, N> lanes[4] = {};
    F rest[4] = {};
    auto const add = [&](auto width, int64_t x, auto& sums) KV_INLINE {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> g[3], d = load<M>(p.depth.row(b, 0, y) + x * depth_step);
      for (int k = 0; k < 3; ++k) g[k] = load<M>(p.grad.row(b, k, y) + x * step);
      rays.add_gradients(iota<M, F>(x), F(y), d, g, sums);
    };
    int64_t x = 0;
    if (step == 1 && depth_step == 1)
      for (; x + N <= p.grad.width; x += N) add(Width<N>{}, x, lanes);
    for (; x < p.grad.width; ++x) add(Width<1>{}, x, rest);
    for (int k = 0; k < 4; ++k) {
      double sum = rest[k];
      for (int i = 0; i < N; ++i) sum += lanes[k][i];
      p.partial[4 * r + k] = sum;
    }
  }
}

KV_INSTANTIATE(depth_points, DepthPoints)
KV_INSTANTIATE(depth_points_backward, DepthPointsBackward)
KV_INSTANTIATE(depth_normals, DepthPoints)
KV_INSTANTIATE(depth_normals_backward, DepthNormalsBackward)
KV_INSTANTIATE(depth_points_camera_backward, DepthPointsCameraBackward)

}  // namespace kv::geometry::KV_ISA
