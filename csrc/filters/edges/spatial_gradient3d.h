// Derivatives of a volume by differences, with the replicate border: (x, y, z) or, for order 2, (xx, yy, zz, xy, yz,
// xz).
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "derivative.h"

namespace kv::filters {

template <class T>
struct SpatialGradient3d {
  Planes<T const> x;  // plane z of volume v is v * depth + z
  Planes<T> y;        // plane z of channel c is (v * 3 * order + c) * depth + z
  int64_t depth;
  int order;
};

template <class T>
struct SpatialGradient3dBackward {
  Planes<T const> grad;
  Planes<T> grad_x;
  int64_t depth;
  int order;
};

KV_KERNEL(spatial_gradient3d, SpatialGradient3d)
KV_KERNEL(spatial_gradient3d_backward, SpatialGradient3dBackward)

// Channel `Index`, of order X, Y, Z along the axes. at(k, j, i) is the voxel k - 1, j - 1, i - 1 away along z, y, x.
template <class Kernel, int Index, int X, int Y, int Z>
struct Channel3d {
  static constexpr int index = Index;
  template <int Along>
  using Row = typename Kernel::template row<Along>;
  static constexpr double unit = Row<X>::unit(X) * Row<Y>::unit(Y) * Row<Z>::unit(Z);

  template <class F, class At>
  KV_HD static auto derivative(At at) {
    constexpr F scale = F(1 / unit);
    return Row<Z>::dot([&](int k) {
             return Row<Y>::dot([&](int j) { return Row<X>::dot([&](int i) { return at(k, j, i); }); });
           }) *
           scale;
  }
  // first and last: whether the voxel is the first and the last one along x, y, z.
  template <class F, class At>
  KV_HD static auto derivative_vjp(At at, bool const (&first)[3], bool const (&last)[3]) {
    constexpr F scale = F(1 / unit);
    auto const along_x = [&](int k, int j) {
      return Row<X>::dot_vjp([&](int i) { return at(k, j, i); }, first[0], last[0]);
    };
    auto const along_y = [&](int k) {
      return Row<Y>::dot_vjp([&](int j) { return along_x(k, j); }, first[1], last[1]);
    };
    return Row<Z>::dot_vjp(along_y, first[2], last[2]) * scale;
  }
};

// Calls f(Channel3d{}) for the channels of an order.
template <int Order, class F>
KV_HD void for_each_channel3d(F f) {
  if constexpr (Order == 1) {
    f(Channel3d<Diff1, 0, 1, 0, 0>{});
    f(Channel3d<Diff1, 1, 0, 1, 0>{});
    f(Channel3d<Diff1, 2, 0, 0, 1>{});
  } else {
    f(Channel3d<Diff2, 0, 2, 0, 0>{});
    f(Channel3d<Diff2, 1, 0, 2, 0>{});
    f(Channel3d<Diff2, 2, 0, 0, 2>{});
    f(Channel3d<Diff2, 3, 1, 1, 0>{});
    f(Channel3d<Diff2, 4, 0, 1, 1>{});
    f(Channel3d<Diff2, 5, 1, 0, 1>{});
  }
}

}  // namespace kv::filters
