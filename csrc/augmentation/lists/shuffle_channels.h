// Channels of images of different sizes in another order: copies of planes.
#pragma once

#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

constexpr uint32_t kShuffledPixels = 4096;  // of an item

// T is an unsigned integer of the size of elements.
template <class T>
struct ShuffleChannels {
  ListedSamples list;
  int64_t const* orders;  // (B, C): which channel each one becomes
  int64_t order_stride;
  int channels;

  // Copies pixel `item` and those that follow at a distance of `step`, of an item of sample b: of one channel of planar
  // results, or of all channels.
  KV_HD void copy(int b, uint32_t item, uint32_t pixel, uint32_t step) const {
    ListedImage const& x = list.images[b];
    int64_t const* const order = orders + b * order_stride;
    uint32_t const width = uint32_t(x.width), pixels = uint32_t(x.height) * width,
                   parts = (pixels - 1) / kShuffledPixels + 1, channel = list.interleaved ? 0 : item / parts;
    uint32_t const first = (item - channel * parts) * kShuffledPixels, left = pixels - first,
                   last = first + (left < kShuffledPixels ? left : kShuffledPixels);
    bool const is_flat = x.row_stride == x.width * x.step;
    T const* const from = static_cast<T const*>(x.data);
    T* const to = static_cast<T*>(list.results[b].data);
    for (uint32_t i = first + pixel; i < last; i += step) {
      uint32_t const row = is_flat ? 0 : i / width;
      int64_t const at = row * x.row_stride + int64_t(i - row * width) * x.step;
      if (list.interleaved)
        for (int c = 0; c < channels; ++c) to[int64_t(i) * channels + c] = from[order[c] * x.channel_stride + at];
      else
        to[int64_t(channel) * pixels + i] = from[order[channel] * x.channel_stride + at];
    }
  }
};

KV_KERNEL(shuffle_channels_list, ShuffleChannels)

}  // namespace kv::augmentation
