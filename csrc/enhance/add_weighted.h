// Parameters of add_weighted, alpha x + beta y + gamma. A weight is a number, or a tensor with one value per image or
// per channel.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::enhance {

template <class T>
struct AddWeighted {
  // A weight: `number` if there is no tensor.
  struct Weight {
    Compute<T> const* data;
    int64_t of_image, of_channel;  // strides
    Compute<T> number;
  };
  Planes<T const> x, y;  // one row per plane; an inner plane is a channel with its own weights
  Planes<T> result;
  Weight alpha, beta, gamma;

  KV_HD Compute<T> weight_of(Weight const& w, int64_t plane) const {
    if (!w.data) return w.number;
    return w.data[plane / x.inner * w.of_image + plane % x.inner * w.of_channel];
  }
};

KV_KERNEL(add_weighted, AddWeighted)

// The unit of work on the CPU.
constexpr int64_t kAddWeightedChunk = 16384;

}  // namespace kv::enhance
