// Two images mixed: alpha x + beta y + gamma, with weights that are numbers or the images' or channels' own. Included
// by mix_cpu.cpp, mix.cu and mix_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct Mix {
  // A weight: the number where there are no data.
  struct Weight {
    Compute<T> const* data;
    int64_t of_image, of_channel;  // strides
    Compute<T> number;
  };
  Planes<T const> x, y;  // of one row each: inner ones are channels with weights of their own
  Planes<T> mixed;
  Weight alpha, beta, gamma;

  KV_HD Compute<T> weight_of(Weight const& w, int64_t plane) const {
    if (!w.data) return w.number;
    return w.data[plane / x.inner * w.of_image + plane % x.inner * w.of_channel];
  }
};

KV_KERNEL(mix, Mix)

// The unit of work on the CPU.
constexpr int64_t kMixed = 16384;

}  // namespace kv
