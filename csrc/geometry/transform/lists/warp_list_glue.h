// Warps of lists of images by a matrix each, for the entries of operators.
#pragma once

#include "geometry/transform/lists/list_glue.h"
#include "geometry/transform/lists/sample_list.h"

namespace kv::geometry {

// What the samples share, without images.
template <class T>
Sampling<T> shared_sampling(SamplingOptions const& a, Matrix const& m) {
  return a.of<T>(m.use.source, m.coords<Compute<T>>());
}
template <class T>
void skip_samples(Sampling<T>& p, Sampling<T> const& all, int64_t count) {
  p.coords.matrices = all.coords.matrices + count * all.coords.matrix_stride;
  if (all.fill) p.fill = all.fill + count * all.fill_batch_stride;
}

inline ListedImage checked_planes([[maybe_unused]] char const* op, ListedImage const& x) {
#if defined(KV_CUDA)
  KV_CHECK(int64_t(x.height) * x.row_stride <= INT32_MAX, op, ": expected planes of less than 2^31 elements, got ",
           x.height, " rows of ", x.row_stride);
#endif
  return x;
}

#if defined(KV_CUDA)
constexpr bool kOnCuda = true;
#else
constexpr bool kOnCuda = false;
#endif

// Blocks of tiles of a result, on CUDA.
inline int64_t blocks_of(Size size, int tiles_per_block) {
  return ceil_div(size.height, kTile) * ceil_div(size.width, kTile * tiles_per_block);
}
inline int tiles_per_block_of(ListSizes const& sizes, size_t count) {
  int64_t tiles = 0;
  for (size_t b = 0; b < count; ++b) tiles += blocks_of(sizes[b], 1);
  return tiles_per_block(1, kTile, tiles * kTile);
}

// Blocks of a result of bytes, and the side of a block for `count` of them.
inline int64_t byte_blocks_of(Size size, int side) { return ceil_div(size.height, side) * ceil_div(size.width, side); }
inline int byte_side_of(ListSizes const& sizes, size_t count) {
  int64_t anchors = 0;
  for (size_t b = 0; b < count; ++b) anchors += byte_blocks_of(sizes[b], kByteAnchor);
  return byte_side(anchors);
}

// Warps images to `results` of a layout: a batch (B, C, h, w), or a list.
inline void warp_to(Tensors const& results, Layout layout, Tensors const& images, SamplingOptions const& a,
                    Matrix const& m, ListSizes const& sizes, bool antialias = false) {
  char const* const op = a.op;
  size_t const count = images.size();
  int64_t const channels = images[0].size(0);
  Tensor const like = as_batch(images[0]);
  if (channels == 0) return;
  BatchOrList const outputs(results);
  int const per_block = antialias ? 1 : tiles_per_block_of(sizes, count);
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    SampleList<T> p;
    p.all = {shared_sampling<T>(a, m), {}, {}, {}};
    p.all.x.channels = int(channels);
    p.list.interleaved = layout == Layout::channels_last;
    p.tiles_per_block = per_block;
    bool const by_anchors = sizeof(T) == 1 && !antialias && p.all.interpolation == Interpolation::bilinear;
    p.byte_side = by_anchors ? byte_side_of(sizes, count) : 0;
    Sampling<T> const all = p.all;
    for_each_table(
        p.list, count, [&](size_t b) { return checked_planes(op, listed(images[b])); },
        [&](size_t b) { return checked_planes(op, outputs[b]); },
        [&](size_t b) {
          if (!kOnCuda) return ceil_div(sizes[b].height, rows_of_item(sizes[b].width));
          return by_anchors ? byte_blocks_of(sizes[b], p.byte_side) : blocks_of(sizes[b], per_block);
        },
        [&](size_t first) {
          skip_samples<T>(p.all, all, int64_t(first));
          if (antialias)
            KV_RUN(sample_antialiased_list, like, p, p.list.items, kAntialiasedCost * channels * kItemPixels);
          else
            KV_RUN(sample_list, like, p, p.list.items, 4 * channels * kItemPixels);
        });
  });
}

// One result (B, C, h, w), of one size; or a list of results, of a size each.
inline Tensors warped_list(Tensors const& images, SamplingOptions const& a, Matrix const& m,
                           std::vector<int64_t> const& sides, bool antialias = false) {
  ListSizes const sizes(a.op, sides, images.size());
  Tensor const like = as_batch(images[0]);
  Tensors const results = empty_results(like, sizes, images.size(), layout_of(like));
  warp_to(results, layout_of(like), images, a, m, sizes, antialias);
  return results;
}

}  // namespace kv::geometry
