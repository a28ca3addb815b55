// A warp and a program of color steps in one pass over a list of images of different sizes, whose results have one
// size.
#pragma once

#include "augmentation/warp_and_color.h"
#include "core/image_list.h"

namespace kv::augmentation {

// The members of WarpAndColor are those of all samples, without images. The table has the images of samples from
// `first` on.
template <class T>
struct WarpAndColorList : WarpAndColor<T> {
  int64_t first;
  int count;
  ListedImage images[kMaxListed];

  KV_HD int64_t first_sample() const { return first; }
  KV_HD ListedImage const& image(int64_t b) const { return images[b - first]; }
};

KV_KERNEL(warp_and_color_list, WarpAndColorList)

}  // namespace kv::augmentation
