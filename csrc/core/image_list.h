// Lists of images of different sizes, as tables that kernels take as a parameter. A CUDA graph keeps the parameters of
// its kernels, so that a replay reads the tables of the call that was captured. Included by headers of kernels for
// lists.
#pragma once

#include "images.h"
#include "view.h"

namespace kv {

// CUDA kernels have 32,764 bytes of parameters; longer lists take several launches.
constexpr int kMaxListed = 512;

// An image (C, H, W) that is read, with any strides, in elements.
struct ListedImage {
  void const* data;
  int64_t channel_stride, row_stride, step;
  int height, width;
};

// An image that is written: dense, planar or channels-last as all of them are.
struct ListedResult {
  void* data;
  int height, width;
};

template <class T>
KV_HD Images<T const> images_of(ListedImage const& x, int channels) {
  return {static_cast<T const*>(x.data), 0, x.channel_stride, x.row_stride, x.step, 1, x.height, x.width, channels};
}
template <class T>
KV_HD Images<T> images_of(ListedResult const& y, int channels, bool interleaved) {
  int64_t const width = y.width, step = interleaved ? channels : 1;
  return {
      static_cast<T*>(y.data), 0, interleaved ? 1 : y.height * width, width * step, step, 1, y.height, width, channels};
}

// An image whose pixels are adjacent, as planes, or as one of interleaved pixels.
template <class T>
KV_HD Planes<T> planes_of(Images<T> const& x, bool interleaved) {
  int64_t const planes = interleaved ? 1 : x.channels, step = interleaved ? x.channels : 1;
  return {x.data, planes, 1, x.channel_stride, 0, x.row_stride, x.height, x.width, step};
}

// The entry of a table that an item belongs to. Those of entry i begin at first_of(i).
template <class FirstOf>
KV_HD int entry_of_item(int count, int item, FirstOf first_of) {
  int low = 0, high = count - 1;
  while (low < high) {
    int const middle = (low + high + 1) / 2;
    if (first_of(middle) <= item)
      low = middle;
    else
      high = middle - 1;
  }
  return low;
}

// Where the items of entry b of a table end.
template <class List>
KV_HD int end_of_items(List const& list, int b) {
  return b + 1 < list.count ? list.first[b + 1] : list.items;
}

// The work of a table on the CPU: calls run(entry, first, last) for the items [begin, end) of each entry, counted from
// its first one.
template <class List, class Run>
KV_HD void for_each_sample(List const& list, int64_t begin, int64_t end, Run run) {
  while (begin < end) {
    int const b = list.sample_of(int(begin));
    int64_t const first = list.first[b], last = min(end, int64_t(end_of_items(list, b)));
    run(b, begin - first, last - first);
    begin = last;
  }
}

// What is read and what is written for each of `count` samples. A kernel's work is a number of items, parts of a
// result; those of sample b begin at first[b].
struct ListedSamples {
  int count, items;
  bool interleaved;  // results
  ListedImage images[kMaxListed];
  ListedResult results[kMaxListed];
  int first[kMaxListed];

  // The sample of an item.
  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
};

// The pixels of the images before number b.
KV_HD int64_t pixels_before(ListedImage const* images, int b) {
  int64_t pixels = 0;
  for (int i = 0; i < b; ++i) pixels += int64_t(images[i].height) * images[i].width;
  return pixels;
}

// On the CPU an item is some rows of a result.
constexpr int64_t kItemPixels = 4096;
KV_HD int64_t rows_of_item(int64_t width) { return max(int64_t(1), kItemPixels / width); }

}  // namespace kv
