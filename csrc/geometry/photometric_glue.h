// Shared code of the photometric operators.
#pragma once

#include "geometry/transform/photometric.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {

inline Distance parse_distance(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(Distance::l1) && number <= int64_t(Distance::charbonnier), op,
           ": distance must be 0 (l1), 1 (l2) or 2 (charbonnier), got ", number);
  return Distance(number);
}

}  // namespace kv::geometry
