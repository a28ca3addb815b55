// Traverses a chunk of a plane on CUDA: a block takes a few rows, its threads take four pixels at a time.
#pragma once

#include <initializer_list>

#include "core/launch.cuh"

namespace kv::geometry::cuda {

constexpr int kThreads = 256, kVectorSize = 4;

// Calls f(count, index in the plane, column, row) for the block's pixels, in vectors if planes are `vectorized`. `maps`
// has the width and height of planes of T, and the rows of a chunk.
template <class T, class Maps, class Call>
__device__ __forceinline__ void for_each_vector(Maps const& maps, int64_t chunk, bool vectorized, Call f) {
  unsigned const width = unsigned(maps.width), start = unsigned(chunk * maps.rows) * width;
  unsigned const end = unsigned(min((chunk + 1) * maps.rows, maps.height)) * width;
  auto const take = [&](auto count) {
    constexpr int P = decltype(count)::value;
#pragma unroll 1
    for (unsigned i = start + P * threadIdx.x; i < end; i += P * kThreads) {
      unsigned const row = i / width;
      f(count, i, i - row * width, row);
    }
  };
  if (sizeof(T) < 8 && vectorized)
    take(std::integral_constant<int, sizeof(T) < 8 ? kVectorSize : 1>{});
  else
    take(std::integral_constant<int, 1>{});
}

// Whether planes at these addresses (null: none) can be read in vectors: all are aligned, and no vector has pixels of
// two rows.
template <class T>
bool is_vectorizable(int64_t width, std::initializer_list<void const*> planes) {
  for (void const* at : planes)
    if (reinterpret_cast<uintptr_t>(at) % sizeof(Vector<T, kVectorSize>) != 0) return false;
  return width % kVectorSize == 0;
}

}  // namespace kv::geometry::cuda
