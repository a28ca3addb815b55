// A step of the approximate distance transform: pixels that the window around a source reaches get their distance and
// become sources.
#pragma once

#include "core/isa.h"

namespace kv::contrib {

// Of images (depth 1) or volumes, dense.
template <class T>
struct DistanceStep {
  T const *grown, *total;                // sources are 1; the distances of earlier steps
  T const* kernel;                       // weights of the window, the last axis fastest
  int64_t planes, depth, height, width;  // a plane may be a volume
  int radius, radius_z;                  // of the window; radius_z is 0 for images
  T distance, scale;                     // how far earlier steps have reached; a weight w is at distance scale * log w
  T *next, *next_total;

  KV_HD int64_t pixels() const { return depth * height * width; }
};

KV_KERNEL(distance_step, DistanceStep)

// Whether a pixel with that weighted sum of its window is reached now: sources have at least 1.
template <class V>
KV_HD auto is_reached(V const& near) {
  return (near > 0) & (near < 1);
}

}  // namespace kv::contrib
