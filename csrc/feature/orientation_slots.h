// Frames rotated by the orientations of their patches, one slot for each orientation. Frames and the orientations of
// each frame keep their order, and the first `count` of a sample are kept. An angle that repeats the first one of its
// frame is not an orientation.
#pragma once

#include "core/isa.h"
#include "feature/laf.h"

namespace kv::feature {

// The value type that formulas are evaluated on.
#if defined(__CUDACC__)
using FormulaValue = double;
KV_HD double first_of(double x) { return x; }
#else
using FormulaValue = Double4;
KV_HD double first_of(Double4 x) { return x[0]; }
#endif

template <class F>
struct OrientationSlots {
  F const* frames;     // (batch, count, 2, 3), zeros in empty slots
  F const* responses;  // (batch, count)
  F const* angles;     // (batch, count, peaks) in radians
  F* rotated;          // (batch, count, 2, 3)
  F* scores;           // (batch, count)
  int64_t batch;
  int count, peaks;

  // `i` counts the frames of all samples.
  KV_HD bool is_orientation(int64_t i, int k) const { return k == 0 || angles[i * peaks + k] != angles[i * peaks]; }
  KV_HD int count_orientations(int64_t i) const {
    bool is_filled = false;
    for (int e = 0; e < 6; ++e) is_filled = is_filled || frames[6 * i + e] != 0;
    int sum = 0;
    for (int k = 0; k < peaks; ++k) sum += is_filled && is_orientation(i, k);
    return sum;
  }
  // Writes the orientations of frame i to the slots from `slot` on.
  KV_HD void store(int64_t sample, int64_t slot, int64_t i) const {
    for (int k = 0; k < peaks && slot < count; ++k) {
      if (!is_orientation(i, k)) continue;
      FormulaValue x[7], y[6];
      for (int e = 0; e < 6; ++e) x[e] = FormulaValue{} + double(frames[6 * i + e]);
      x[6] = FormulaValue{} + double(angles[i * peaks + k] * F(57.29577951308232));
      RotateLaf::evaluate(x, y, {});
      for (int e = 0; e < 6; ++e) rotated[6 * (sample * count + slot) + e] = F(first_of(y[e]));
      scores[sample * count + slot] = responses[i];
      ++slot;
    }
  }
  KV_HD void clear(int64_t sample, int64_t slot) const {
    for (int e = 0; e < 6; ++e) rotated[6 * (sample * count + slot) + e] = 0;
    scores[sample * count + slot] = 0;
  }
};

KV_KERNEL(orientation_slots, OrientationSlots)

}  // namespace kv::feature
