// A batch of images for kernels that process all channels of a pixel. Included by the headers of such operators.
#pragma once

#include "hd.h"

namespace kv {

// Images with any strides, in elements; planar or channels-last.
template <class T>
struct Images {
  T* data;
  int64_t batch_stride, channel_stride, row_stride, step;  // batch_stride 0: one image serves the batch
  int64_t batch, height, width;
  int channels;

  KV_HD T* row(int64_t b, int c, int64_t y) const {
    return data + b * batch_stride + c * channel_stride + y * row_stride;
  }
};

}  // namespace kv
