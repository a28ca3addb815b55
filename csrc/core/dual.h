// Dual numbers: a value and its derivatives along N directions. A formula that is a template on its value type computes
// its own Jacobian when it is evaluated on dual numbers. V is a number or Lanes.
#pragma once

#include "hd.h"

namespace kv {

template <class V, int N>
struct Dual {
  V value;
  V d[N];
};

// The scalar type of V.
template <class V>
struct scalar_of {
  using type = decltype(V{}[0] + 0);
};
template <>
struct scalar_of<float> {
  using type = float;
};
template <>
struct scalar_of<double> {
  using type = double;
};
template <class V, int N>
struct scalar_of<Dual<V, N>> : scalar_of<V> {};
template <class V>
using Scalar = typename scalar_of<V>::type;

template <class V>
constexpr bool kIsDual = false;
template <class V, int N>
constexpr bool kIsDual<Dual<V, N>> = true;

// A constant: its derivatives are 0.
template <class V>
KV_HD V constant(Scalar<V> x) {
  V c{};
  if constexpr (kIsDual<V>)
    c.value = c.value + x;
  else
    c = c + x;
  return c;
}
// a - b for a constant b.
template <class V, class U>
KV_HD V subtract_constant(V a, U const& b) {
  if constexpr (kIsDual<V>)
    a.value = a.value - b;
  else
    a = a - b;
  return a;
}

#define KV_DUAL             \
  template <class V, int N> \
  KV_HD
#define KV_FOR_DIRECTIONS for (int i = 0; i < N; ++i)

KV_DUAL Dual<V, N> operator-(Dual<V, N> a) {
  a.value = -a.value;
  KV_FOR_DIRECTIONS a.d[i] = -a.d[i];
  return a;
}
KV_DUAL Dual<V, N> operator+(Dual<V, N> a, Dual<V, N> const& b) {
  a.value = a.value + b.value;
  KV_FOR_DIRECTIONS a.d[i] = a.d[i] + b.d[i];
  return a;
}
KV_DUAL Dual<V, N> operator-(Dual<V, N> a, Dual<V, N> const& b) {
  a.value = a.value - b.value;
  KV_FOR_DIRECTIONS a.d[i] = a.d[i] - b.d[i];
  return a;
}
KV_DUAL Dual<V, N> operator*(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c;
  c.value = a.value * b.value;
  KV_FOR_DIRECTIONS c.d[i] = a.d[i] * b.value + a.value * b.d[i];
  return c;
}
KV_DUAL Dual<V, N> operator/(Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c;
  V const reciprocal = 1 / b.value;
  c.value = a.value * reciprocal;
  KV_FOR_DIRECTIONS c.d[i] = (a.d[i] - c.value * b.d[i]) * reciprocal;
  return c;
}

// With constants.
#define KV_DUAL_WITH(F)                                                             \
  KV_DUAL Dual<V, N> operator+(Dual<V, N> a, F b) {                                 \
    a.value = a.value + b;                                                          \
    return a;                                                                       \
  }                                                                                 \
  KV_DUAL Dual<V, N> operator+(F b, Dual<V, N> const& a) { return a + b; }          \
  KV_DUAL Dual<V, N> operator-(Dual<V, N> const& a, F b) { return a + (-b); }       \
  KV_DUAL Dual<V, N> operator-(F b, Dual<V, N> const& a) { return -a + b; }         \
  KV_DUAL Dual<V, N> operator*(Dual<V, N> a, F b) {                                 \
    a.value = a.value * b;                                                          \
    KV_FOR_DIRECTIONS a.d[i] = a.d[i] * b;                                          \
    return a;                                                                       \
  }                                                                                 \
  KV_DUAL Dual<V, N> operator*(F b, Dual<V, N> const& a) { return a * b; }          \
  KV_DUAL Dual<V, N> operator/(Dual<V, N> const& a, F b) { return a * (F(1) / b); } \
  KV_DUAL auto operator<(Dual<V, N> const& a, F b) { return a.value < b; }          \
  KV_DUAL auto operator>(Dual<V, N> const& a, F b) { return a.value > b; }          \
  KV_DUAL auto operator<=(Dual<V, N> const& a, F b) { return a.value <= b; }        \
  KV_DUAL auto operator>=(Dual<V, N> const& a, F b) { return a.value >= b; }        \
  KV_DUAL auto operator==(Dual<V, N> const& a, F b) { return a.value == b; }
KV_DUAL_WITH(float)
KV_DUAL_WITH(double)
#undef KV_DUAL_WITH

KV_DUAL auto operator<(Dual<V, N> const& a, Dual<V, N> const& b) { return a.value < b.value; }
KV_DUAL auto operator>(Dual<V, N> const& a, Dual<V, N> const& b) { return a.value > b.value; }
KV_DUAL auto operator<=(Dual<V, N> const& a, Dual<V, N> const& b) { return a.value <= b.value; }
KV_DUAL auto operator>=(Dual<V, N> const& a, Dual<V, N> const& b) { return a.value >= b.value; }
KV_DUAL auto operator==(Dual<V, N> const& a, Dual<V, N> const& b) { return a.value == b.value; }

// mask ? a : b, lane by lane.
template <class M, class V>
KV_HD V select(M mask, V const& a, V const& b) {
  return mask ? a : b;
}
template <class M, class V, int N>
KV_HD Dual<V, N> select(M mask, Dual<V, N> const& a, Dual<V, N> const& b) {
  Dual<V, N> c;
  c.value = mask ? a.value : b.value;
  KV_FOR_DIRECTIONS c.d[i] = mask ? a.d[i] : b.d[i];
  return c;
}

#undef KV_FOR_DIRECTIONS
#undef KV_DUAL

}  // namespace kv
