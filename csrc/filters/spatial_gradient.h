// Derivatives of an image with the replicate border: (x, y) or, for order 2, (xx, xy, yy). Included by
// spatial_gradient_cpu.cpp, spatial_gradient.cu and spatial_gradient_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "derivative.h"

namespace kv {

enum class Gradient { sobel1, sobel2, diff1, diff2 };

// Channel c of order n is of order c along y and n - c along x.
template <class T>
struct SpatialGradient {
  Planes<T const> x;
  Planes<T> y;  // plane p has its channels at p * (order + 1) and after
  Gradient kind;
  bool normalized;
};

template <class T>
struct SpatialGradientBackward {
  Planes<T const> grad;
  Planes<T> grad_x;
  Gradient kind;
  bool normalized;
};

KV_KERNEL(spatial_gradient, SpatialGradient)
KV_KERNEL(spatial_gradient_backward, SpatialGradientBackward)

template <class Member, int C>
struct Channel {
  static constexpr int value = C;
  KV_HD static auto down() { return typename Member::template row<C>{}; }
  KV_HD static auto along() { return typename Member::template row<Member::order - C>{}; }
  template <class F>
  KV_HD static F scale(bool normalized) {
    constexpr double unit = decltype(down())::unit(C) * decltype(along())::unit(Member::order - C);
    return normalized ? F(1 / unit) : F(1);
  }
};

// Calls f(Channel<Member, c>{}) for the channels of a member.
template <class Member, class F>
KV_HD void for_each_channel(F f) {
  f(Channel<Member, 0>{});
  f(Channel<Member, 1>{});
  if constexpr (Member::order == 2) f(Channel<Member, 2>{});
}

// Calls f with the member `kind` names.
template <class F>
auto with_member(Gradient kind, F f) {
  switch (kind) {
    case Gradient::sobel1:
      return f(Sobel1{});
    case Gradient::sobel2:
      return f(Sobel2{});
    case Gradient::diff1:
      return f(Diff1{});
    default:
      return f(Diff2{});
  }
}

}  // namespace kv
