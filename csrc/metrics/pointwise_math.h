// Functions of vectors that losses element by element are made of. Included by *_cpu.cpp files.
#pragma once

#include "core/lanes.h"

namespace kv::KV_ISA {
namespace {

template <class F, int N>
struct PointMath {
  using V = Lanes<F, N>;
  KV_HD static V exp(V x) { return vexp2<F, N>(x * F(1.44269504088896340736)); }
  KV_HD static V sqrt(V x) { return vsqrt(x); }
  KV_HD static V divide(V x, V y) { return x / y; }
  // Of all numbers, those below the normal ones included.
  KV_HD static V log(V x) {
    constexpr F kSmall = sizeof(F) == 4 ? F(1e-37) : F(1e-300), kScale = F(1 << 30);
    V const zero{}, shift = x < kSmall ? broadcast<N>(F(30)) : zero;
    V const scaled = x < kSmall ? V(x * kScale) : x;
    V const found = (vlog2<F, N>(scaled) - shift) * F(0.69314718055994530942);
    V const beyond = x < zero ? broadcast<N>(F(__builtin_nan(""))) : broadcast<N>(-F(__builtin_inf()));
    return x <= zero ? beyond : found;
  }
};

}  // namespace
}  // namespace kv::KV_ISA
