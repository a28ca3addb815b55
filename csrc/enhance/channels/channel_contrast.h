// Contrast of channels: pixels x of a plane become (x - mean) factor + mean, clamped, around the mean of the plane; and
// the gradient. A plane is summed, and then mapped. enhance/channels/channel_contrast.py defines it.
#pragma once

#include "core/isa.h"
#include "core/stencils/gradient_list.h"
#include "core/view.h"

namespace kv::enhance {

// The sum of a plane is that of its chunks, whatever the other planes of a batch or of a list are. A chunk has 32 KB.
template <class T>
constexpr int kContrastChunk = 32768 / int(sizeof(T));
template <class T>
KV_HD int64_t contrast_chunks(int64_t pixels) {
  return (pixels + kContrastChunk<T> - 1) / kContrastChunk<T>;
}

template <class T>
struct ChannelContrast {
  using F = Compute<T>;
  Planes<T const> x;  // flat: each plane is one row
  Planes<T> y;
  F factor, most;  // the largest result: 255 for bytes, 1 for floats
  F* partial;      // CUDA: the sums of all chunks

  KV_HD void select(int64_t) {}
  template <class V>
  KV_HD V mapped(V x, F mean) const {
    V const y = (x - mean) * factor + mean, zero = V{}, top = V{} + most;
    V const above = y < zero ? zero : y;  // NaN stays
    return above > top ? top : above;
  }
};

// Of lists `partial` are those of the blocks.
template <class T>
struct ChannelContrastList : FilterList<ChannelContrast<T>, T> {};

template <class T>
struct ChannelContrastBackward {
  using F = Compute<T>;
  Planes<T const> grad, x;  // flat
  Planes<T> grad_x;
  F factor;
  F *partial, *partial_grads;  // CUDA: the sums of all chunks, and those of gradients

  KV_HD void select(int64_t) {}
  // The gradient of a result before it was clamped.
  template <class V>
  KV_HD V before_clamp(V grad, V x, F mean) const {
    V const y = (x - mean) * factor + mean, zero = V{}, one = V{} + F(1);
    return y < zero ? zero : (y > one ? zero : grad);
  }
};

template <class T>
struct ChannelContrastBackwardList : GradientList<ChannelContrastBackward<T>, T, true> {};

KV_KERNEL(channel_contrast, ChannelContrast)
KV_KERNEL(channel_contrast_list, ChannelContrastList)
KV_KERNEL(channel_contrast_backward, ChannelContrastBackward)
KV_KERNEL(channel_contrast_list_backward, ChannelContrastBackwardList)

}  // namespace kv::enhance
