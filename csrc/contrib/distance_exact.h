// The exact distance transform: the squared distance along the last axis, then along each axis before it as the lower
// envelope of the parabolas squared(i) + (q - i)^2 (Felzenszwalb, Huttenlocher 2012), in integers, without a division.
// A line of n pixels takes O(n).
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

// A pixel whose parabola is in an envelope, and its squared distance without this axis.
struct Member {
  int at, squared;
};

// A pass along an axis with `length` pixels, between `outer` axes before and `inner` ones after it, dense.
template <class T>
struct DistanceEnvelope {
  int const* squared;
  int64_t outer, length, inner;
  Member* members;  // CUDA: of each line those in the envelope
  int* next;        // squared distances, or null in the last pass, which writes
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

// Calls put(q, squared distance) for all q of a line. squared(i) is the distance without this axis; set(k, member)
// keeps the envelope and get(k) reads it. kAhead values, at least 2, are loaded before they are needed: a thread of a
// GPU waits for memory.
//
//   a, b, c: pixels with parabolas in this order. b is nowhere the lowest if it meets a after it meets c:
//   (F(b) - F(a)) / (b - a) >= (F(c) - F(b)) / (c - b)  with  F(i) = squared(i) + i^2
template <int kAhead, class Squared, class Get, class Set, class Put>
KV_HD void lower_envelope(int length, Squared const& squared, Get const& get, Set const& set, Put const& put) {
  auto const F = [](Member const& m) KV_INLINE { return int64_t(m.squared) + int64_t(m.at) * m.at; };
  int count = 0;
  Member top{}, below{};
  for (int q0 = 0; q0 < length; q0 += kAhead) {
    int own[kAhead];
#pragma unroll
    for (int j = 0; j < kAhead; ++j) own[j] = q0 + j < length ? squared(q0 + j) : kNoSource;
#pragma unroll
    for (int j = 0; j < kAhead; ++j) {
      if (own[j] == kNoSource) continue;
      Member const m{q0 + j, own[j]};
      while (count > 1 && (F(top) - F(below)) * (m.at - top.at) >= (F(m) - F(top)) * (top.at - below.at)) {
        top = below;
        if (--count > 1) below = get(count - 2);
      }
      set(count++, m);
      below = top;
      top = m;
    }
  }
  if (count == 0) {
    for (int q = 0; q < length; ++q) put(q, kNoSource);
    return;
  }
  Member next[kAhead];  // the member whose turn it is, and those after it
#pragma unroll
  for (int j = 0; j < kAhead; ++j)
    if (j < count) next[j] = get(j);
  int k = 0;
  for (int q = 0; q < length; ++q) {
    auto const value = [&](Member const& m) KV_INLINE { return m.squared + (q - m.at) * (q - m.at); };
    int lowest = value(next[0]);
    while (k + 1 < count && value(next[1]) <= lowest) {
      lowest = value(next[1]);
#pragma unroll
      for (int j = 0; j + 1 < kAhead; ++j) next[j] = next[j + 1];
      if (++k + kAhead - 1 < count) next[kAhead - 1] = get(k + kAhead - 1);
    }
    put(q, lowest);
  }
}

}  // namespace kv::contrib
