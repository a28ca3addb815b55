// Samples of lists for kernels whose images have strides of sample, channel, row and pixel. Included by headers of
// kernels.
#pragma once

#include "core/image_list.h"

namespace kv::augmentation {

// Gives a kernel the images of sample b, as a batch of one; the result.
template <class T, template <class> class Kernel>
KV_HD Images<T> place_sample(Kernel<T>& one, ListedSamples const& list, int b) {
  auto const x = images_of<T>(list.images[b], int(one.channels));
  auto const y = images_of<T>(list.results[b], int(one.channels), list.interleaved);
  one.x = x.data, one.y = y.data;
  one.batch = 1, one.height = y.height, one.width = y.width;
  int64_t const of_x[] = {0, x.channel_stride, x.row_stride, x.step},
                of_y[] = {0, y.channel_stride, y.row_stride, y.step};
  for (int i = 0; i < 4; ++i) one.x_strides[i] = of_x[i], one.y_strides[i] = of_y[i];
  return y;
}

}  // namespace kv::augmentation
