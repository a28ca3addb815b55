// Chunks of planes and the memory of their ranges, for the entries of operators.
#pragma once

#include "min_max.h"
#include "plane_views.h"

namespace kv::enhance {

// CUDA: splits planes into chunks, enough for all multiprocessors, and few enough for the block that combines them.
struct Chunks {
  int64_t size, count;
  Chunks(int64_t planes, int64_t pixels)
      : size(max(clamp(planes * pixels / 1024, int64_t(4096), int64_t(16384)), (pixels + 1023) / 1024)),
        count(ceil_div(pixels, size)) {
    size = (size + 7) / 8 * 8;
  }
};

// CUDA: working memory, in the type that T is computed in.
template <class F>
Tensor working_memory([[maybe_unused]] Tensor const& like, [[maybe_unused]] int64_t count) {
#if defined(KV_CUDA)
  return empty({count}, like, Layout::planar, sizeof(F) == 8 ? ScalarType::Double : ScalarType::Float);
#else
  return empty({0}, like, Layout::planar, ScalarType::Float);
#endif
}

}  // namespace kv::enhance
