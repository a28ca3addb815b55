// Maps of lists of images of different sizes: a sample of a list is a batch of one with a map of its own, displacements
// or coordinates, for which the kernels of sampling.h are run. The results have the sizes of the maps.
#pragma once

#include "core/image_list.h"
#include "geometry/transform/lists/sample_list.h"

namespace kv::geometry {

// Maps lie in a block of memory, where each begins at a multiple of so many elements.
constexpr int kBlockUnit = 16;

// An image that is read. Tables have maps and sizes of results besides, so that strides are short.
struct MappedImage {
  void const* data;
  int64_t channel_stride;
  int row_stride, step, height, width;

  KV_HD ListedImage listed() const { return {data, channel_stride, row_stride, step, height, width}; }
};

// What is read and what is written for each of `count` samples, and where its map (2, H, W) begins in the block.
struct MappedSamples {
  int count, items;
  bool interleaved;  // results
  MappedImage images[kMaxListed];
  ListedResult results[kMaxListed];
  uint32_t maps[kMaxListed];  // in units
  int first[kMaxListed];

  KV_HD int sample_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return first[i]; });
  }
};

// Where each channel has a map of its own, one of them is sampled at a time.
struct MappedChannels {
  int count, only;  // only: or -1 for all

  template <class T>
  KV_HD Images<T> of(Images<T> all) const {
    if (only >= 0) all.data += only * all.channel_stride, all.channels = 1;
    return all;
  }
};

// `all` is what the samples have in common, with the block of maps.
template <class T>
struct RemapList {
  Sample<T> all;
  MappedSamples list;
  MappedChannels channels;
  int tiles_per_block;  // on CUDA
};

// The gradients of the images: the list has those of the results, and what is written, which is planar.
template <class T>
struct RemapListBackward {
  SampleImageBackward<T> all;
  MappedSamples list;
  MappedChannels channels;
};

// The samples of one image of a size, by the map of another one that begins at a unit of its block.
template <class S>
KV_HD void select_mapped(S& p, int b, uint32_t map, MappedChannels const& channels, Size source, Size size) {
  select_sample(p, b, source, size);
  if (p.fill && channels.only >= 0) p.fill += channels.only * p.fill_channel_stride;
  auto& along_x = p.coords.x;
  along_x.data += int64_t(kBlockUnit) * map;
  along_x.row_stride = size.width, along_x.step = 1;
  along_x.batch = 1, along_x.height = size.height, along_x.width = size.width, along_x.channels = 1;
  p.coords.y = along_x;
  p.coords.y.data += size.height * size.width;
}

template <class T>
KV_HD void set_sample(Sample<T>& one, RemapList<T> const& p, int b) {
  ListedImage const image = p.list.images[b].listed();
  ListedResult const& result = p.list.results[b];
  select_mapped(one, b, p.list.maps[b], p.channels, {image.height, image.width}, {result.height, result.width});
  one.x = p.channels.of(images_of<T>(image, p.channels.count));
  one.y = p.channels.of(images_of<T>(result, p.channels.count, p.list.interleaved));
}

template <class T>
KV_HD void set_sample(SampleImageBackward<T>& one, RemapListBackward<T> const& p, int b) {
  ListedImage const grad = p.list.images[b].listed();
  ListedResult const& image = p.list.results[b];
  select_mapped(one, b, p.list.maps[b], p.channels, {image.height, image.width}, {grad.height, grad.width});
  one.grad = p.channels.of(images_of<T>(grad, p.channels.count));
  auto const sums = p.channels.of(images_of<Compute<T>>(image, p.channels.count, false));
  one.sums = sums.data;
  // On the CPU, where these are of one type, the sums are the gradient.
  one.grad_x = {reinterpret_cast<T*>(sums.data),
                0,
                sums.channel_stride,
                sums.row_stride,
                1,
                1,
                sums.height,
                sums.width,
                sums.channels};
}

// On the CPU an item is some rows of a result, or backward a plane; on CUDA a block.
KV_KERNEL(remap_list, RemapList)
KV_KERNEL(remap_list_backward, RemapListBackward)

}  // namespace kv::geometry
