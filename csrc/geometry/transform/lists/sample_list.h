// Sampling of lists of images of different sizes: a sample of a list is a batch of one, for which the kernels of
// sampling.h are run.
#pragma once

#include "core/image_list.h"
#include "geometry/transform/antialiased/warp_antialiased.h"

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

// The gradients of the matrices, as sums of the items: the list has the images, and the gradients of the results, which
// are read.
template <class Gradient>
struct ListMatrixBackward {
  Gradient all;
  ListedSamples list;
  int tiles_per_block;  // on CUDA
};
template <class T>
struct SampleListMatrixBackward : ListMatrixBackward<SampleCoordsBackward<T>> {};
template <class T>
struct AntialiasedListMatrixBackward : ListMatrixBackward<AntialiasedCoordsBackward<T>> {};

// Adds up these sums, by the same list.
template <class T>
struct WarpMatrixListBackward {
  WarpMatrixBackward<T> all;
  ListedSamples list;
};

template <class F>
KV_HD void select_coords(SampleCoords<F>& coords, int b, Size source, Size output) {
  coords.matrices += b * coords.matrix_stride;
  coords.use.source = source;
  coords.use.output = output;
}
// The samples of one image, of which sample b is the only one.
template <class S>
KV_HD void select_sample(S& p, int b, Size source, Size output) {
  p.x_axis.size = int(source.width);
  p.y_axis.size = int(source.height);
  select_coords(p.coords, b, source, output);
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

template <template <class> class Gradient, class T>
KV_HD void set_sample(Gradient<T>& one, ListMatrixBackward<Gradient<T>> const& p, int b) {
  ListedImage const& image = p.list.images[b];
  ListedResult const& grad = p.list.results[b];
  select_sample(one, b, {image.height, image.width}, {grad.height, grad.width});
  one.x = images_of<T>(image, p.all.x.channels);
  one.grad = images_of<T const>(grad, p.all.x.channels, p.list.interleaved);
  one.sums += 9 * int64_t(p.list.first[b]);
}

template <class T>
KV_HD void set_sample(WarpMatrixBackward<T>& one, WarpMatrixListBackward<T> const& p, int b) {
  ListedImage const& image = p.list.images[b];
  ListedResult const& grad = p.list.results[b];
  select_coords(one.coords, b, {image.height, image.width}, {grad.height, grad.width});
  one.sums += 9 * int64_t(p.list.first[b]);
  one.parts = end_of_items(p.list, b) - p.list.first[b];
  one.batch = 1;
  one.grad += 3 * b * one.coords.use.rows;
}

// On the CPU an item is some rows of a result, or backward a plane, or of matrices a row; on CUDA a block. To add up
// sums, it is a sample.
KV_KERNEL(sample_list, SampleList)
KV_KERNEL(sample_antialiased_list, SampleList)
KV_KERNEL(sample_list_backward, SampleListBackward)
KV_KERNEL(sample_antialiased_list_backward, SampleListBackward)
KV_KERNEL(sample_list_matrix_backward, SampleListMatrixBackward)
KV_KERNEL(sample_antialiased_list_matrix_backward, AntialiasedListMatrixBackward)
KV_KERNEL(warp_matrix_list_backward, WarpMatrixListBackward)

}  // namespace kv::geometry
