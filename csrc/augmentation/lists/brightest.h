// The largest value of each image of a list, at least 0. lists/brightest.py of kvision.augmentation defines it.
#pragma once

#include "core/image_list.h"
#include "core/isa.h"

namespace kv::augmentation {

template <class T>
struct Brightest {
  Compute<T>* y;  // (B,)
  ListedSamples list;
  int channels;
};

// On the CPU an item is an image, on CUDA a part of one.
constexpr int kBrightestPixels = 4096;
KV_KERNEL(brightest_list, Brightest)

}  // namespace kv::augmentation
