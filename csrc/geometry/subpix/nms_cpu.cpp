// Local maxima on the CPU: rows [begin, end) of all planes in order. Compiled once per instruction set.
#include <cstddef>

#include "core/lanes.h"
#include "geometry/subpix/nms.h"

namespace kv::geometry::KV_ISA {
namespace {

// The result of a comparison as 0 and 1.
template <int N, class M>
KV_HD void store_flags(uint8_t* to, M mask) {
  if constexpr (N == 1)
    *to = mask ? 1 : 0;
  else
    write_lanes<N>(to,
                   __builtin_convertvector(__builtin_convertvector(mask & 1, Lanes<uint16_t, N>), Lanes<uint8_t, N>));
}

template <int N, class F>
KV_HD Lanes<F, N> load_flags(uint8_t const* from) {
  if constexpr (N == 1)
    return F(*from);
  else
    return __builtin_convertvector(read_lanes<N>(from), Lanes<F, N>);
}

// A row of an output, or null if the output is not requested.
template <class T>
KV_HD T* row_of(Planes<T> const& planes, int64_t plane, int64_t row) {
  return planes.data ? planes.row(plane, row) : nullptr;
}

}  // namespace

template <class T>
void nms(Nms<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size();
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.x.height, y = r % p.x.height;
    T const* const center = p.x.row(plane, y);
    T* const values = row_of(p.y, plane, y);
    uint8_t *const maxima = row_of(p.maxima, plane, y), *const minima = row_of(p.minima, plane, y);
    int64_t first, last;
    p.fitting(plane, y, first, last);
    auto const clear = [&](int64_t from, int64_t to) {
      if (values) __builtin_memset(static_cast<void*>(values + from), 0, size_t(to - from) * sizeof(T));
      if (maxima) __builtin_memset(maxima + from, 0, size_t(to - from));
      if (minima) __builtin_memset(minima + from, 0, size_t(to - from));
    };
    clear(0, first * step);
    clear(last * step, size);
    for_each_vector<T>(first * step, last * step, [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      V const v = load<N>(center + e);
      auto above = (v == v) | (v != v), below = above;
      for (int k = -p.before[0]; k <= p.after[0]; ++k)
        for (int j = -p.before[1]; j <= p.after[1]; ++j) {
          T const* const row = center + k * p.x.outer_stride + j * p.x.row_stride + e;
          for (int i = -p.before[2]; i <= p.after[2]; ++i) {
            if (i == 0 && j == 0 && k == 0) continue;
            V const other = load<N>(row + i * step);
            above &= v > other;
            below &= v < other;
          }
        }
      if (values) store<N>(values + e, V(above ? v : V{}));
      if (maxima) store_flags<N>(maxima + e, above);
      if (minima) store_flags<N>(minima + e, below);
    });
  }
}

template <class T>
void apply_nms_mask(ApplyNmsMask<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for_each_vector<T>(begin, end, [&](auto lanes, int64_t i) {
    constexpr int N = decltype(lanes)::value;
    using V = Lanes<F, N>;
    V const x = load<N>(p.x + i), none{};
    store<N>(p.result + i, V(load_flags<N, F>(p.flags + i) != 0 ? x : none));
  });
}

KV_INSTANTIATE(nms, Nms)
KV_INSTANTIATE(apply_nms_mask, ApplyNmsMask)

}  // namespace kv::geometry::KV_ISA
