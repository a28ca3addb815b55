// Whether a comparison holds, of lanes for any of them. Vectors are for *_cpu.cpp files, which include it first.
#pragma once

#include "hd.h"
#if !defined(__CUDACC__)
#include "lanes.h"
#endif

namespace kv {

KV_HD bool any_lane(bool mask) { return mask; }
KV_HD bool any_lane(int mask) { return mask != 0; }

#if !defined(__CUDACC__)
template <class M>
KV_HD bool any_lane(M mask) {
#if defined(__AVX512F__)
  if constexpr (sizeof(M) == 64) return _mm512_movepi32_mask((__m512i)mask) != 0;
#endif
#if defined(__AVX2__)
  if constexpr (sizeof(M) == 32) return _mm256_movemask_epi8((__m256i)mask) != 0;
#endif
#if defined(__x86_64__)
  if constexpr (sizeof(M) == 16) return _mm_movemask_epi8((__m128i)mask) != 0;
#endif
  bool any = false;
  for (int i = 0; i < int(sizeof(M) / sizeof(mask[0])); ++i) any = any || mask[i] != 0;
  return any;
}
#endif

}  // namespace kv
