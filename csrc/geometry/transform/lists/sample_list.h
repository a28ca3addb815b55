// Sampling of lists of images of different sizes: a sample of a list is a batch of one, for which the kernels of
// sampling.h are run.
#pragma once

#include "core/image_list.h"
#include "geometry/transform/sampling.h"

namespace kv::geometry {

// `all` is what the samples have in common, with the matrices and fills of all of them and without images.
template <class T>
struct SampleList {
  Sample<T> all;
  ListedSamples list;
  int tiles_per_block, byte_side;  // on CUDA
};

// The gradients of the images: the list has those of the results, and what is written; on CUDA what is added to, zeros,
// unless pixels beyond the images are a fill.
template <class T>
struct SampleListBackward {
  SampleImageBackward<T> all;
  ListedSamples list;
  int tiles_per_block;  // on CUDA
};

// The samples of one image, of which sample b is the only one.
template <class S>
KV_HD void select_sample(S& p, int b, Size source, Size output) {
  p.x_axis.size = int(source.width);
  p.y_axis.size = int(source.height);
  p.coords.matrices += b * p.coords.matrix_stride;
  p.coords.use.source = source;
  p.coords.use.output = output;
  if (p.fill) p.fill += b * p.fill_batch_stride;
  p.images = 1;
}

// A sample of a list, as a batch of one.
template <class List>
KV_HD auto sample_at(List const& p, int b) -> decltype(p.all) {
  auto one = p.all;
  set_sample(one, p, b);
  return one;
}

// Of what is `p.all` yet.
template <class T>
KV_HD void set_sample(Sample<T>& one, SampleList<T> const& p, int b) {
  ListedImage const& image = p.list.images[b];
  ListedResult const& result = p.list.results[b];
  select_sample(one, b, {image.height, image.width}, {result.height, result.width});
  one.x = images_of<T>(image, p.all.x.channels);
  one.y = images_of<T>(result, p.all.x.channels, p.list.interleaved);
}

template <class T>
KV_HD void set_sample(SampleImageBackward<T>& one, SampleListBackward<T> const& p, int b) {
  ListedImage const& grad = p.list.images[b];
  ListedResult const& image = p.list.results[b];
  select_sample(one, b, {image.height, image.width}, {grad.height, grad.width});
  one.grad = images_of<T>(grad, p.all.grad.channels);
  one.grad_x = images_of<T>(image, p.all.grad.channels, false);
  one.sums = static_cast<Compute<T>*>(image.data);
}

// On the CPU an item is some rows of a result, or backward a plane; on CUDA a block.
KV_KERNEL(sample_list, SampleList)
KV_KERNEL(sample_antialiased_list, SampleList)
KV_KERNEL(sample_list_backward, SampleListBackward)

}  // namespace kv::geometry
