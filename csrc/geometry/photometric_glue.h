// What the photometric operators have in common. Included by transform/photometric_op.cpp and depth/photometric_op.cpp.
#pragma once

#include "geometry/transform/photometric.h"
#include "geometry/transform/sampling_glue.h"

namespace kv {

inline Distance distance_of(char const* op, std::string const& name) {
  if (name == "l1") return Distance::l1;
  if (name == "l2") return Distance::l2;
  KV_CHECK(name == "charbonnier", op, ": distance must be one of l1, l2, charbonnier; got '", name, "'");
  return Distance::charbonnier;
}

}  // namespace kv
