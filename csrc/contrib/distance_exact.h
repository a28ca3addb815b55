// The exact distance transform: the squared distance along the last axis, then along each axis before it as the lower
// envelope of the parabolas squared(i) + (q - i)^2 (Felzenszwalb, Huttenlocher 2012), in integers, without a division.
// A line of n pixels takes O(n). Included by distance_exact_cpu.cpp, distance_exact.cu and distance_exact_op.cpp.
#pragma once

#include <cmath>

#include "core/ceil_div.h"
#include "core/isa.h"

namespace kv::contrib {

constexpr int64_t kLines = 16;  // of a tile on the CPU
constexpr int kNoSource = -1;   // a squared distance where a line has no source yet

// The first pass, of rows: sources are pixels equal to 1.
template <class T>
struct DistanceScan {
  T const* image;
  int64_t rows, width;
  int* squared;
};

// A pass along an axis with `length` pixels, between `outer` axes before and `inner` ones after it, dense.
template <class T>
struct DistanceEnvelope {
  int const* squared;
  int64_t outer, length, inner;
  int* members;  // CUDA: of each line those pixels whose parabolas are in the envelope
  int* next;     // squared distances, or null in the last pass, which writes
  T* distance;
};

KV_KERNEL(distance_scan, DistanceScan)
KV_KERNEL(distance_envelope, DistanceEnvelope)

template <class T>
KV_HD void store_distance(DistanceEnvelope<T> const& p, int64_t at, int squared) {
  if (p.next)
    p.next[at] = squared;
  else
    p.distance[at] = squared == kNoSource ? T(INFINITY) : T(::sqrt(double(squared)));
}

// Calls put(q, squared distance) for all q of a line. squared(i) is the distance without this axis; the envelope is
// kept by set(k, i) and read by get(k).
//
//   a, b, c: pixels with parabolas in this order. b is nowhere the lowest if it meets a after it meets c:
//   (F(b) - F(a)) / (b - a) >= (F(c) - F(b)) / (c - b)  with  F(i) = squared(i) + i^2
template <class Squared, class Get, class Set, class Put>
KV_HD void lower_envelope(int length, Squared const& squared, Get const& get, Set const& set, Put const& put) {
  auto const F = [&](int i) { return int64_t(squared(i)) + int64_t(i) * i; };
  int count = 0, top = 0, below = 0;
  int64_t f_top = 0, f_below = 0;
  for (int q = 0; q < length; ++q) {
    int const own = squared(q);
    if (own == kNoSource) continue;
    int64_t const f = own + int64_t(q) * q;
    while (count > 1 && (f_top - f_below) * (q - top) >= (f - f_top) * (top - below)) {
      top = below;
      f_top = f_below;
      if (--count > 1) {
        below = get(count - 2);
        f_below = F(below);
      }
    }
    set(count++, q);
    below = top;
    f_below = f_top;
    top = q;
    f_top = f;
  }
  if (count == 0) {
    for (int q = 0; q < length; ++q) put(q, kNoSource);
    return;
  }
  int k = 1, member = get(0), offset = squared(member);
  int next = count > 1 ? get(1) : 0, next_offset = count > 1 ? squared(next) : 0;
  for (int q = 0; q < length; ++q) {
    int value = offset + (q - member) * (q - member);
    while (k < count) {
      int const beyond = next_offset + (q - next) * (q - next);
      if (beyond > value) break;
      value = beyond;
      member = next;
      offset = next_offset;
      if (++k < count) {
        next = get(k);
        next_offset = squared(next);
      }
    }
    put(q, value);
  }
}

}  // namespace kv::contrib
