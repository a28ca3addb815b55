// Patches of local affine frames: schemas and entries, for CPU and CUDA.
#include "geometry/transform/pyramid_glue.h"
#include "glue/batch.h"
#include "patches.h"

namespace kv::feature {
namespace {

constexpr int64_t kLargestPatch = (1 << 15) - 1;

// Shapes of levels: each has half the height and width of the one before, rounded down.
PyramidShape pyramid_shape(char const* op, std::vector<int64_t> const& size, int64_t levels) {
  KV_CHECK(size.size() == 2 && size[0] > 0 && size[1] > 0 && size[0] <= INT32_MAX && size[1] <= INT32_MAX, op,
           ": expected a size of height and width");
  KV_CHECK(levels > 0 && levels <= kMaxLevels, op, ": expected 1 to ", kMaxLevels, " levels, got ", levels);
  PyramidShape shape{};
  shape.levels = int(levels);
  for (int l = 0; l < shape.levels; ++l) {
    shape.heights[l] = int(size[0] >> l), shape.widths[l] = int(size[1] >> l);
    KV_CHECK(shape.heights[l] > 0 && shape.widths[l] > 0, op, ": there is no level ", l, " of this image");
    KV_CHECK(int64_t(shape.heights[l]) * shape.widths[l] <= INT32_MAX, op, ": expected less than 2^31 pixels");
    shape.offsets[l] = shape.size;
    shape.size += int64_t(shape.heights[l]) * shape.widths[l];
  }
  return shape;
}

struct PatchArguments {
  Tensor pyramid, frames;
  PyramidShape shape;
  int64_t batch, count, channels, n;

  // Images and frames of one sample serve all of `samples`.
  PatchArguments(char const* op, Tensor const& x, Tensor const& laf, std::vector<int64_t> const& size, int64_t levels,
                 int64_t patch_size, double window, int64_t samples)
      : shape(pyramid_shape(op, size, levels)), batch(samples), n(patch_size) {
    KV_CHECK(patch_size > 0 && patch_size <= kLargestPatch, op, ": expected patch_size of 1 to ", kLargestPatch,
             ", got ", patch_size);
    KV_CHECK(window > 0, op, ": expected a window of more than 0");
    KV_CHECK(x.dim() == 3 && x.size(2) == shape.size && (x.size(0) == batch || x.size(0) == 1), op,
             ": expected a pyramid of shape (B, C, ", shape.size, ")");
    KV_CHECK(laf.dim() == 4 && (laf.size(0) == batch || laf.size(0) == 1) && laf.size(2) == 2 && laf.size(3) == 3 &&
                 laf.scalar_type() == compute_dtype(x) && laf.device() == x.device(),
             op, ": expected laf of shape (B, N, 2, 3) of the type that computes");
    pyramid = expand_batch(x, batch), frames = expand_batch(laf, batch);
    channels = x.size(1), count = laf.size(1);
    KV_CHECK(channels <= INT32_MAX && batch * count <= INT32_MAX, op, ": expected less than 2^31 patches");
  }
};

Tensor sample_patches(Tensor const& pyramid, Tensor const& laf, std::vector<int64_t> size, int64_t levels,
                      int64_t patch_size, double window) {
  constexpr char const* op = "sample_patches";
  PatchArguments const a(op, pyramid, laf, size, levels, patch_size, window, pyramid.dim() > 0 ? pyramid.size(0) : 0);
  Tensor const patches = empty({a.batch, a.count, a.channels, a.n, a.n}, pyramid);
  dispatch_floating(op, a.pyramid, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SamplePatches<T> const params{nullptr,
                                  data_ptr<T const>(a.pyramid),
                                  data_ptr<F const>(a.frames),
                                  data_ptr<T>(patches),
                                  a.shape,
                                  a.batch,
                                  a.count,
                                  int(a.channels),
                                  int(a.n),
                                  F(window)};
    KV_RUN(sample_patches, a.pyramid, params, patches.numel() > 0 ? a.batch * a.count : 0,
           4 * (1 + a.channels) * a.n * a.n);
  });
  return patches;
}

// Builds the pyramid of the images, by pyrdown with the reflect border, and samples patches from it.
Tensor pyramid_patches(Tensor const& input, Tensor const& laf, int64_t levels, int64_t patch_size, double window) {
  constexpr char const* op = "pyramid_patches";
  check_images(op, "input", input);
  int64_t const batch = input.size(0), channels = input.size(1), height = input.size(2), width = input.size(3);
  PyramidShape shape = pyramid_shape(op, {height, width}, levels);
  KV_CHECK(patch_size > 0 && patch_size <= kLargestPatch && window > 0, op, ": expected a patch_size of 1 to ",
           kLargestPatch, " and a window of more than 0");
  KV_CHECK(laf.dim() == 4 && (laf.size(0) == batch || laf.size(0) == 1) && laf.size(2) == 2 && laf.size(3) == 3 &&
               laf.scalar_type() == compute_dtype(input) && laf.device() == input.device(),
           op, ": expected laf of shape (B, N, 2, 3) of the type that computes");
  for (int l = 0; l + 1 < shape.levels; ++l)
    check_border(op, Border::reflect, 2, min(shape.heights[l], shape.widths[l]));
  // The images are level 0; `pyramid` holds the levels from 1 on.
  shape.size -= height * width;
  for (int l = 1; l < shape.levels; ++l) shape.offsets[l] -= height * width;
  Tensor const image = dense(input), frames = expand_batch(laf, batch);
  int64_t const count = laf.size(1);
  KV_CHECK(channels <= INT32_MAX && batch * count <= INT32_MAX, op, ": expected less than 2^31 patches");
  Tensor const pyramid = empty({batch, channels, shape.size}, image);
  Tensor const patches = empty({batch, count, channels, patch_size, patch_size}, image);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    int64_t const planes = batch * channels;
    Planes<T const> level = adjacent_planes(data_ptr<T const>(image), planes, height, width);
    for (int l = 1; l < shape.levels; ++l) {
      T* const data = data_ptr<T>(pyramid) + shape.offsets[l];
      int64_t const h = shape.heights[l], w = shape.widths[l];
      Planes<T> const next{data, planes, 1, shape.size, 0, w, h, w, 1};
      geometry::resize_planes(image, level, next, geometry::ResizeFilter::pyrdown, false, Border::reflect);
      level = {data, planes, 1, shape.size, 0, w, h, w, 1};
    }
    SamplePatches<T> const params{data_ptr<T const>(image),
                                  data_ptr<T const>(pyramid),
                                  data_ptr<F const>(frames),
                                  data_ptr<T>(patches),
                                  shape,
                                  batch,
                                  count,
                                  int(channels),
                                  int(patch_size),
                                  F(window)};
    KV_RUN(sample_patches, image, params, patches.numel() > 0 ? batch * count : 0,
           4 * (1 + channels) * patch_size * patch_size);
  });
  return patches;
}

std::tuple<Tensor, Tensor> sample_patches_backward(Tensor const& grad, Tensor const& pyramid, Tensor const& laf,
                                                   std::vector<int64_t> size, int64_t levels, int64_t patch_size,
                                                   double window, bool wants_pyramid, bool wants_laf) {
  constexpr char const* op = "sample_patches_backward";
  KV_CHECK(grad.dim() == 5, op, ": grad does not fit the patches");
  PatchArguments const a(op, pyramid, laf, size, levels, patch_size, window, grad.size(0));
  KV_CHECK(grad.size(1) == a.count && grad.size(2) == a.channels && grad.size(3) == a.n && grad.size(4) == a.n &&
               grad.scalar_type() == pyramid.scalar_type() && grad.device() == pyramid.device(),
           op, ": grad does not fit the patches");
  Tensor const g = dense(grad);
  Tensor grad_pyramid =
      empty({a.batch, wants_pyramid ? a.channels : 0, a.shape.size}, pyramid, Layout::planar, compute_dtype(pyramid));
  Tensor grad_laf = empty({a.batch, wants_laf ? a.count : 0, 2, 3}, laf);
  if (grad_pyramid.numel() > 0) torch::stable::zero_(grad_pyramid);
  if (grad.numel() == 0) {  // there are no patches, or frames of images without channels
    if (grad_laf.numel() > 0) torch::stable::zero_(grad_laf);
    return {grad_pyramid, grad_laf};
  }
  dispatch_floating(op, a.pyramid, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SamplePatchesBackward<T> const params{data_ptr<T const>(g),
                                          data_ptr<T const>(a.pyramid),
                                          data_ptr<F const>(a.frames),
                                          wants_pyramid ? data_ptr<F>(grad_pyramid) : nullptr,
                                          wants_laf ? data_ptr<F>(grad_laf) : nullptr,
                                          a.shape,
                                          a.batch,
                                          a.count,
                                          int(a.channels),
                                          int(a.n),
                                          F(window)};
    int64_t const rows = (wants_pyramid ? a.batch * a.channels : 0) + (wants_laf ? a.batch * a.count : 0);
    KV_RUN(sample_patches_backward, a.pyramid, params, rows, 8 * (1 + a.channels) * a.n * a.n);
  });
  return {grad_pyramid, grad_laf};
}

}  // namespace

#define KV_PATCHES "SymInt[] size, int levels, int patch_size, float window"

// A pyramid (B, C, P) has the rows of all levels of an image of `size`, one after the other.
KV_OPERATOR(sample_patches, "(Tensor pyramid, Tensor laf, " KV_PATCHES ") -> Tensor")
// `sample_patches` of a pyramid that the operator builds.
KV_OPERATOR(pyramid_patches, "(Tensor input, Tensor laf, int levels, int patch_size, float window) -> Tensor")
KV_OPERATOR(sample_patches_backward, "(Tensor grad, Tensor pyramid, Tensor laf, " KV_PATCHES
                                     ", bool wants_pyramid, bool wants_laf)"
                                     " -> (Tensor, Tensor)")

}  // namespace kv::feature
