// The gradients of warps of lists of images by a matrix each, for the entries of operators.
#pragma once

#include <type_traits>
#include <utility>

#include "geometry/transform/lists/list_numbers_glue.h"
#include "geometry/transform/lists/warp_list_glue.h"

namespace kv::geometry {

// The gradients of the results of a list: of one result (B, C, h, w), or of a list of results.
struct ListedGradients {
  char const* op;
  Tensors const& grads;
  int64_t count;
  bool is_batch;
  Tensor like;  // a batch

  ListedGradients(char const* op, Tensors const& grads, size_t count)
      : op(op), grads(grads), count(int64_t(count)), is_batch(is_one(op, grads)), like(checked(op, grads, count)) {}
  static bool is_one(char const* op, Tensors const& grads) {
    KV_CHECK(!grads.empty(), op, ": expected grads with at least one tensor");
    return grads[0].dim() == 4;
  }
  static Tensor checked(char const* op, Tensors const& grads, size_t count) {
    bool const is_batch = is_one(op, grads);
    is_batch ? check_images(op, "grads", grads[0]) : check_image_list(op, "grads", grads);
    KV_CHECK(count > 0 && grads.size() == (is_batch ? 1 : count) && (!is_batch || grads[0].size(0) == int64_t(count)),
             op, ": grads do not fit the images");
    return is_batch ? grads[0] : as_batch(grads[0]);
  }
  SamplingOptions options(Interpolation interpolation, int64_t padding, bool align_corners,
                          std::optional<Tensor> const& fill = {}) const {
    return {op, interpolation, parse_padding(op, padding), align_corners, like, fill, {op, {}, count, count, like}};
  }
  // By a matrix of each, whose meaning follows from its sizes.
  Matrix matrices(Tensor const& matrix, bool inverse, bool normalized, bool align_corners) const {
    return {op, matrix, like, count, inverse, normalized, align_corners, {1, 1}, {1, 1}};
  }
};

// The images of a list, and the gradients behind them.
inline std::pair<Tensors, Tensors> split_gradients(char const* op, Tensors const& images_and_grads) {
  KV_CHECK(images_and_grads.size() > 1, op, ": expected images, and gradients behind them");
  if (images_and_grads.back().dim() != 4) return halves(op, images_and_grads);
  return {Tensors(images_and_grads.begin(), images_and_grads.end() - 1), {images_and_grads.back()}};
}

// The gradients to images of a size each.
inline Tensors image_gradients(ListedGradients const& all, SamplingOptions const& a, Matrix const& m,
                               std::vector<int64_t> const& sides, bool antialias = false) {
  char const* const op = all.op;
  size_t const count = size_t(all.count);
  ListSizes const sizes(op, sides, count);
  // On the CPU half types are added up in float32. Expanded gradients have no rows.
  Tensors promoted;
  ScalarType const computed = compute_dtype(all.like);
  for (Tensor const& grad : all.grads) {
    if (!kOnCuda && grad.scalar_type() != computed) {
      promoted.push_back(empty(grad.sizes(), grad, Layout::planar, computed));
      torch::stable::copy_(promoted.back(), grad);
      continue;
    }
    int64_t const w = grad.dim() - 1;
    promoted.push_back(grad.stride(w) == 0 && grad.size(w) > 1 ? dense(grad) : grad);
  }
  Tensor const like = all.is_batch ? promoted[0] : as_batch(promoted[0]);
  int64_t const channels = like.size(1);

  bool const writes_once = !antialias && a.padding == Padding::fill;
  Tensors const sums =
      empty_list(like, channels, sizes, count, Layout::planar, writes_once ? like.scalar_type() : computed);
  if (!writes_once && !antialias) clear_sums(sums);
  BatchOrList const inputs(promoted);
  auto const run = [&]<class T>(Type<T>) {
    SampleListBackward<T> p;
    p.all = {shared_sampling<T>(a, m), {}, {}, nullptr};
    p.all.grad.channels = int(channels);
    p.list.interleaved = false;
    p.tiles_per_block = writes_once ? tiles_per_block_of(sizes, count) : 1;
    Sampling<T> const shared = p.all;
    auto const blocks_on_cuda = [&](size_t b) {
      if (antialias) return ceil_div(sizes[b].height, kGatherTile) * ceil_div(sizes[b].width, kGatherTile);
      ListedImage const grad = inputs[b];
      return blocks_of(writes_once ? sizes[b] : Size{grad.height, grad.width}, p.tiles_per_block);
    };
    for_each_table(
        p.list, count, [&](size_t b) { return checked_planes(op, inputs[b]); },
        [&](size_t b) { return checked_planes(op, listed(sums[b])); },
        [&](size_t b) { return kOnCuda ? blocks_on_cuda(b) : channels; },
        [&](size_t first) {
          skip_samples<T>(p.all, shared, int64_t(first));
          [[maybe_unused]] int64_t const pixels = inputs[first].height * int64_t(inputs[first].width);
          if (antialias)
            KV_RUN(sample_antialiased_list_backward, like, p, p.list.items, kAntialiasedCost * pixels);
          else
            KV_RUN(sample_list_backward, like, p, p.list.items, 8 * pixels);
        });
  };
  if (channels > 0)
#if defined(KV_CUDA)
    dispatch_floating(op, like, run);
#else
    dispatch_compute_dtype(op, like, run);
#endif
  return sums_of_type(sums, all.grads[0].scalar_type());
}

// The gradient to the matrices, by two launches a table.
template <bool Antialias = false>
Tensor matrix_gradient(Tensors const& images, ListedGradients const& all, SamplingOptions const& a, Matrix const& m) {
  char const* const op = all.op;
  check_image_list(op, "images", images);
  check_gradient(op, all.like, as_batch(images[0]), all.like.size(0));
  Layout const layout = layout_of(all.like);
  Tensors rows;  // without gaps
  for (Tensor const& grad : all.grads) {
    Tensor const batch = all.is_batch ? grad : as_batch(grad);
    rows.push_back(layout == Layout::channels_last ? as_layout(batch, layout) : dense(batch));
  }
  auto const grad_of = [&](size_t b) -> ListedImage {
    Tensor const& x = rows[all.is_batch ? 0 : b];
    char const* const data = static_cast<char const*>(x.const_data_ptr());
    int64_t const begin = all.is_batch ? int64_t(b) * x.stride(0) * x.element_size() : 0;
    return {data + begin, x.stride(1), x.stride(2), x.stride(3), int(x.size(2)), int(x.size(3))};
  };
  auto const blocks = [&](size_t b, int per_block) {
    ListedImage const grad = grad_of(b);
    return blocks_of({grad.height, grad.width}, per_block);
  };
  int64_t tiles = 0;
  for (size_t b = 0; b < images.size(); ++b) tiles += blocks(b, 1);
  int const per_block = Antialias ? 1 : tiles_per_block(1, kTile, tiles * kTile);
  Tensor const grad_matrix = empty({all.count, m.use.rows, 3}, m.tensor);
  dispatch_floating(op, all.like, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    std::conditional_t<Antialias, AntialiasedListMatrixBackward<T>, SampleListMatrixBackward<T>> p;
    Sampling<T> const shared = shared_sampling<T>(a, m);
    p.all = {};
    static_cast<Sampling<T>&>(p.all) = shared;
    p.all.x.channels = int(images[0].size(0));
    p.list.interleaved = layout == Layout::channels_last;
    p.tiles_per_block = per_block;
    for_each_table(
        p.list, images.size(), [&](size_t b) { return checked_planes(op, listed(images[b])); },
        [&](size_t b) { return checked_planes(op, grad_of(b)); },
        [&](size_t b) { return kOnCuda ? blocks(b, per_block) : int64_t(grad_of(b).height); },
        [&](size_t first) {
          skip_samples<T>(p.all, shared, int64_t(first));
          Tensor const sums = empty({p.list.items, 9}, all.like, Layout::planar, ScalarType::Double);
          p.all.sums = data_ptr<double>(sums);
          [[maybe_unused]] int64_t const row = p.all.x.channels * int64_t(grad_of(first).width);
          if constexpr (Antialias)
            KV_RUN(sample_antialiased_list_matrix_backward, all.like, p, p.list.items, kAntialiasedCost * row);
          else
            KV_RUN(sample_list_matrix_backward, all.like, p, p.list.items, 8 * row);
          F* const grad = data_ptr<F>(grad_matrix) + int64_t(first) * 3 * m.use.rows;
          WarpMatrixListBackward<F> const gradient{{p.all.coords, p.all.sums, 0, 0, grad}, p.list};
          KV_RUN(warp_matrix_list_backward, all.like, gradient, p.list.count, kItemPixels);
        });
  });
  return grad_matrix;
}

}  // namespace kv::geometry
