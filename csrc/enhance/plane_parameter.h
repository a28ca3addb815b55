// A parameter of planes: one number for all of them, or numbers of images or channels. Included by sharpness.h and
// clahe.h; plane_views.h makes one of a tensor.
#pragma once

#include "core/hd.h"

namespace kv::enhance {

// The number if there is no tensor.
template <class F>
struct PlaneParameter {
  F const* data;
  int64_t of_image, of_channel;  // strides
  int64_t channels;
  F number;

  KV_HD F of(int64_t plane) const {
    return data ? data[plane / channels * of_image + plane % channels * of_channel] : number;
  }
};

}  // namespace kv::enhance
