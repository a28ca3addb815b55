// The exact distance transform on the CPU: rows, then tiles of lines, [begin, end). Compiled once per instruction set.
#include "core/scratch.h"
#include "distance_exact.h"

namespace kv::contrib::KV_ISA {

template <class T>
void distance_scan(DistanceScan<T> const& p, int64_t begin, int64_t end) {
  int const width = int(p.width);
  for (int64_t row = begin; row < end; ++row) {
    T const* const image = p.image + row * p.width;
    int* const squared = p.squared + row * p.width;
    int last = kNoSource;
    for (int x = 0; x < width; ++x) {
      if (image[x] == T(1)) last = x;
      squared[x] = last == kNoSource ? kNoSource : x - last;
    }
    int next = kNoSource;
    for (int x = width - 1; x >= 0; --x) {
      int const left = squared[x];
      if (left == 0) next = x;
      int const nearest = next == kNoSource ? left : left == kNoSource ? next - x : min(left, next - x);
      squared[x] = nearest == kNoSource ? kNoSource : nearest * nearest;
    }
  }
}

// A tile is kLines neighboring lines, a cache line of each pixel, copied so that each line is dense.
template <class T>
void distance_envelope(DistanceEnvelope<T> const& p, int64_t begin, int64_t end) {
  int const length = int(p.length);
  Scratch<int> const tile(kLines * p.length), result(kLines * p.length);
  Scratch<Member> const members(p.length);
  int64_t const tiles = ceil_div(p.inner, kLines);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const first = i % tiles * kLines, at = i / tiles * p.length * p.inner + first;
    int const lines = int(min(kLines, p.inner - first));
    for (int q = 0; q < length; ++q)
      for (int line = 0; line < lines; ++line) tile.data[line * length + q] = p.squared[at + q * p.inner + line];
    for (int line = 0; line < lines; ++line) {
      int const* const squared = tile.data + line * length;
      int* const out = result.data + line * length;
      lower_envelope<2>(
          length, [&](int j) { return squared[j]; }, [&](int k) { return members.data[k]; },
          [&](int k, Member m) { members.data[k] = m; }, [&](int q, int value) { out[q] = value; });
    }
    for (int q = 0; q < length; ++q)
      for (int line = 0; line < lines; ++line)
        store_distance(p, at + q * p.inner + line, result.data[line * length + q]);
  }
}

KV_INSTANTIATE_COMPUTED(distance_scan, DistanceScan)
KV_INSTANTIATE_COMPUTED(distance_envelope, DistanceEnvelope)

}  // namespace kv::contrib::KV_ISA
