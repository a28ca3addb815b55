// Warps by a matrix of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/list_numbers_glue.h"
#include "geometry/transform/lists/warp_list_glue.h"
#include "geometry/transform/warp_glue.h"

namespace kv::geometry {
namespace {

Tensors warp_list(Tensors const& images, Tensor const& matrix, std::optional<Tensor> const& fill,
                  std::vector<int64_t> const& sides, int64_t interpolation, int64_t padding, bool align_corners,
                  bool inverse, bool normalized) {
  char const* const op = "warp_list";
  check_image_list(op, "images", images);
  int64_t const batch = int64_t(images.size());
  Tensor const like = as_batch(images[0]);
  SamplingOptions const a(op, interpolation, padding, align_corners, like, fill, {op, {}, batch, batch, like});
  Matrix const m(op, matrix, like, batch, inverse, normalized, align_corners, {1, 1}, {1, 1});
  return warped_list(images, a, m, sides);
}

// The gradients of images of a size each.
Tensors warp_list_backward(Tensors const& grads, Tensor const& matrix, std::vector<int64_t> const& sides,
                           int64_t interpolation, int64_t padding_number, bool align_corners, bool inverse,
                           bool normalized) {
  char const* const op = "warp_list_backward";
  size_t const count = sides.size() / 2;
  ListSizes const sizes(op, sides, count);
  int64_t const batch = int64_t(count);
  KV_CHECK(!grads.empty() && count > 0, op, ": expected grads with at least one tensor");
  bool const is_batch = grads[0].dim() == 4;
  if (is_batch) {
    check_images(op, "grads", grads[0]);
    KV_CHECK(grads.size() == 1 && grads[0].size(0) == batch, op, ": grads do not fit the images");
  } else {
    check_image_list(op, "grads", grads);
    KV_CHECK(grads.size() == count, op, ": grads do not fit the images");
  }
  // On the CPU half types are added up in float32. Expanded gradients have no rows.
  Tensors promoted;
  [[maybe_unused]] ScalarType const computed = compute_dtype(grads[0]);
  for (Tensor const& grad : grads) {
#if !defined(KV_CUDA)
    if (grad.scalar_type() != computed) {
      promoted.push_back(empty(grad.sizes(), grad, Layout::planar, computed));
      torch::stable::copy_(promoted.back(), grad);
      continue;
    }
#endif
    int64_t const w = grad.dim() - 1;
    promoted.push_back(grad.stride(w) == 0 && grad.size(w) > 1 ? dense(grad) : grad);
  }
  Tensor const like = is_batch ? promoted[0] : as_batch(promoted[0]);
  int64_t const channels = like.size(1);
  Padding const padding = parse_padding(op, padding_number);
  SamplingOptions const a(op, parse_interpolation(op, interpolation), padding, align_corners, like, {},
                          {op, {}, batch, batch, like});
  Matrix const m(op, matrix, like, batch, inverse, normalized, align_corners, {1, 1}, {1, 1});

  bool const writes_once = padding == Padding::fill;
  Tensors const sums =
      empty_list(like, channels, sizes, count, Layout::planar, writes_once ? like.scalar_type() : compute_dtype(like));
  if (!writes_once) clear_sums(sums);
  BatchOrList const inputs(promoted);
  auto const run = [&]<class T>(Type<T>) {
    SampleListBackward<T> p;
    p.all = {shared_sampling<T>(a, m), {}, {}, nullptr};
    p.all.grad.channels = int(channels);
    p.list.interleaved = false;
    p.tiles_per_block = writes_once ? tiles_per_block_of(sizes, count) : 1;
    Sampling<T> const all = p.all;
    for_each_table(
        p.list, count, [&](size_t b) { return checked_planes(op, inputs[b]); },
        [&](size_t b) { return checked_planes(op, listed(sums[b])); },
        [&](size_t b) {
          ListedImage const grad = inputs[b];
          return kOnCuda ? blocks_of(writes_once ? sizes[b] : Size{grad.height, grad.width}, p.tiles_per_block)
                         : channels;
        },
        [&](size_t first) {
          skip_samples<T>(p.all, all, int64_t(first));
          [[maybe_unused]] int64_t const cost = 8 * inputs[first].height * int64_t(inputs[first].width);
          KV_RUN(sample_list_backward, like, p, p.list.items, cost);
        });
  };
  if (channels > 0)
#if defined(KV_CUDA)
    dispatch_floating(op, like, run);
#else
    dispatch_compute_dtype(op, like, run);
#endif
  return sums_of_type(sums, grads[0].scalar_type());
}

}  // namespace

// `images` (C, H, W) of different sizes, one for each sample. `size` is one height and width, of a result (B, C, h, w),
// or those of a list of results.
KV_OPERATOR(warp_list, "(Tensor[] images, Tensor matrix, Tensor? fill, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor[]")
// `size` has height and width of each image. The gradients are one tensor (B, C, h, w), or one of each result.
KV_OPERATOR(warp_list_backward, "(Tensor[] grads, Tensor matrix, SymInt[] size, " KV_WARP_OPTIONS ") -> Tensor[]")

}  // namespace kv::geometry
