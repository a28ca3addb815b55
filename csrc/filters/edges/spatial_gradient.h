// Derivatives of an image with the replicate border: (x, y) or, for order 2, (xx, xy, yy).
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "derivative.h"

namespace kv::filters {

// The numbers are stable: exported graphs contain them.
enum class DerivativeMode : int { sobel = 0, diff = 1 };

enum class DerivativeKind { sobel1, sobel2, diff1, diff2 };

// Channel c of a derivative of order n has order c along y and n - c along x.
template <class T>
struct SpatialGradient {
  Planes<T const> x;
  Planes<DerivativeOf<T>> y;  // the channels of plane p start at plane p * (order + 1)
  DerivativeKind kind;
  bool normalized;
};

template <class T>
struct SpatialGradientBackward {
  Planes<T const> grad;
  Planes<T> grad_x;
  DerivativeKind kind;
  bool normalized;
};

KV_KERNEL(spatial_gradient, SpatialGradient)
KV_KERNEL(spatial_gradient_backward, SpatialGradientBackward)

template <class Kernel, int C>
struct Channel {
  static constexpr int value = C;
  KV_HD static auto down() { return typename Kernel::template row<C>{}; }
  KV_HD static auto along() { return typename Kernel::template row<Kernel::order - C>{}; }
  template <class F>
  KV_HD static F scale(bool normalized) {
    constexpr double unit = decltype(down())::unit(C) * decltype(along())::unit(Kernel::order - C);
    return normalized ? F(1 / unit) : F(1);
  }
};

// Calls f(Channel<Kernel, c>{}) for the channels of a derivative kernel.
template <class Kernel, class F>
KV_HD void for_each_channel(F f) {
  f(Channel<Kernel, 0>{});
  f(Channel<Kernel, 1>{});
  if constexpr (Kernel::order == 2) f(Channel<Kernel, 2>{});
}

// Calls f with the derivative kernel of `kind`.
template <class F>
auto dispatch_kernel(DerivativeKind kind, F f) {
  switch (kind) {
    case DerivativeKind::sobel1:
      return f(Sobel1{});
    case DerivativeKind::sobel2:
      return f(Sobel2{});
    case DerivativeKind::diff1:
      return f(Diff1{});
    default:
      return f(Diff2{});
  }
}

}  // namespace kv::filters
