// Color programs on lists of images of different sizes: a sample is an image, with as many pixels as it has. Included
// by program_list*.cpp, program_list.cu and program_list_glue.h.
#pragma once

#include "color/program.h"
#include "core/image_list.h"

namespace kv::color {

// An image and its result, or the gradient of it: rows of planes, or of interleaved pixels, without gaps.
struct ListedPixels {
  void const* x;
  void* y;
  int sample, pixels;
  int first, part;  // of its items, and of its partial sums of a mean, in the launch
  bool as_values;   // the numbers of all channels are one row, of a program that computes every value alone
  bool by_vectors;  // on CUDA
};

struct ProgramTable {
  int64_t samples;  // of the whole list, which decide how many items a sample has
  int count, items;
  ListedPixels listed[kMaxListed];

  KV_HD int entry_of(int item) const {
    return entry_of_item(count, item, [&](int i) { return listed[i].first; });
  }
  KV_HD int end_of(int i) const { return i + 1 < count ? listed[i + 1].first : items; }
  KV_HD Pixels pixels_of(Pixels x, void* data, ListedPixels const& own) const {
    x.data = data;
    if (own.as_values)
      x.channels = 1, x.step = 1;
    else if (x.step == 1)
      x.channel_stride = own.pixels;
    return x;
  }
};

// `all` is what the samples share: the images of batches without their memory, and the parameters of all samples.
template <class F>
struct ProgramList : ProgramTable {
  Program<F> all;
};

// The gradient of each result, or one number that is that of all its elements.
template <class F>
struct ProgramBackwardList : ProgramTable {
  ProgramBackward<F> all;
  void const* grads[kMaxListed];
  bool is_scalar[kMaxListed];

  KV_HD Pixels grad_of(int i) const {
    Pixels grad = pixels_of(all.grad, const_cast<void*>(grads[i]), listed[i]);
    if (is_scalar[i]) grad.channel_stride = grad.step = 0;
    return grad;
  }
};

// The program `all` of a table as that of entry i, a batch of one.
template <class F>
KV_HD Program<F> program_of(ProgramTable const& list, Program<F> const& all, int i) {
  ListedPixels const& own = list.listed[i];
  Program<F> p = all;
  p.x = list.pixels_of(p.x, const_cast<void*>(own.x), own);
  p.samples = 1;
  p.pixels = p.mean_pixels = own.as_values ? own.pixels * int64_t(all.x.channels) : own.pixels;
  p.parts_count = mean_parts_of<F>(list.samples, p.pixels);
  p.parts += own.part;
  p.means += own.sample;
  for (int k = 0; k < p.tensor_count; ++k) {
    ParameterTensor& tensor = p.tensor[k];
    tensor.data = static_cast<char const*>(tensor.data) + own.sample * tensor.image_stride * size_of(tensor.type);
  }
  return p;
}
// The image of table entry i as a batch of one.
template <class F>
KV_HD Program<F> program_at(ProgramList<F> const& list, int i) {
  Program<F> p = program_of(list, list.all, i);
  p.y = list.pixels_of(p.y, list.listed[i].y, list.listed[i]);
  return p;
}
template <class F>
KV_HD ProgramBackward<F> program_at(ProgramBackwardList<F> const& list, int i) {
  ProgramBackward<F> p = list.all;
  p.forward = program_of(list, list.all.forward, i);
  p.grad = list.grad_of(i);
  p.grad_x = list.pixels_of(p.grad_x, list.listed[i].y, list.listed[i]);
  return p;
}

KV_KERNEL(program_list, ProgramList)
KV_KERNEL(program_list_backward, ProgramBackwardList)

namespace cuda {
// Whether one launch serves a sample around a mean.
bool takes_clusters(ProgramList<float> const& p, int i);
int program_list_by_clusters(ProgramList<float> const& p, CUstream_st* stream);
}  // namespace cuda

}  // namespace kv::color
