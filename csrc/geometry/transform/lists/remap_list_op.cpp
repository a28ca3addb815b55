// Maps of lists of images of different sizes: schemas and entries, for CPU and CUDA.
#include "geometry/transform/lists/list_numbers_glue.h"
#include "geometry/transform/lists/remap_list.h"
#include "geometry/transform/lists/warp_list_glue.h"

namespace kv::geometry {
namespace {

// Images (C, H, W), or gradients of results, with maps (2, h, w) in one tensor, of each or of each of their channels.
// The maps are displacements in results of the sizes of images, or, with the sizes of what is written, coordinates.
struct MappedImages {
  char const* op;
  size_t count, maps_of_each;
  bool displaces;
  std::vector<int64_t> sides;  // of what is written
  Tensor like;                 // a batch
  int64_t channels;
  SamplingOptions options;
  Tensor maps;
  std::vector<int64_t> map_begins;  // where those of each image begin

  MappedImages(char const* op, Tensors const& images, Tensor const& all_maps, std::optional<Tensor> const& fill,
               std::vector<int64_t> const& sizes, int64_t interpolation, int64_t padding, bool align_corners,
               bool by_channel, bool backward)
      : op(op),
        count(images.size()),
        displaces(sizes.empty()),
        sides(displaces ? sides_of(op, images) : sizes),
        like(as_batch(images[0])),
        channels(like.size(1)),
        options(op, interpolation, padding, align_corners, like, fill, {op, {}, int64_t(count), int64_t(count), like}) {
    maps_of_each = by_channel ? size_t(channels) : 1;
    KV_CHECK(sides.size() == 2 * count, op, ": expected height and width of each of ", count, " images");
    std::vector<int64_t> const of_results = backward ? sides_of(op, images) : sides;
    std::vector<int64_t> of_maps;
    for (size_t i = 0; i < maps_of_each * count; ++i)
      for (size_t k = 0; k < 2; ++k) of_maps.push_back(of_results[2 * (i / maps_of_each) + k]);
    map_begins = offsets_in_block(2, {op, of_maps, maps_of_each * count}, maps_of_each * count);
    KV_CHECK(all_maps.dim() == 1 && all_maps.size(0) == map_begins.back() &&
                 all_maps.scalar_type() == compute_dtype(like) && all_maps.device() == like.device(),
             op, ": expected maps of shape (", map_begins.back(),
             ",), of the type that is computed in, for the images");
    KV_CHECK(map_begins.back() / kBlockUnit <= UINT32_MAX, op, ": expected smaller images");
    maps = dense(all_maps);
  }
  static std::vector<int64_t> sides_of(char const* op, Tensors const& images) {
    check_image_list(op, "images", images);
    std::vector<int64_t> sides;
    for (Tensor const& x : images) sides.push_back(x.size(1)), sides.push_back(x.size(2));
    return sides;
  }
  ListSizes sizes() const { return {op, sides, count}; }

  // What the samples share.
  template <class T>
  Sampling<T> shared() const {
    SampleCoords<Compute<T>> coords{};
    coords.x.data = data_ptr<Compute<T> const>(maps);
    coords.scale[0] = coords.scale[1] = 1, coords.own = displaces;
    return options.of<T>({1, 1}, coords);
  }

  // Fills tables, and calls run(first sample of the table), of all channels or of one after the other.
  template <class List, class ItemsOf, class Run>
  void for_each_table(List& p, Tensors const& images, Tensors const& results, ItemsOf items_of, Run run) const {
    auto const* const fill = p.all.fill;
    p.channels.count = int(channels);
    for (size_t begin = 0; begin < count && channels > 0; begin += kMaxListed)
      for (size_t channel = 0; channel < maps_of_each; ++channel) {
        p.channels.only = maps_of_each > 1 ? int(channel) : -1;
        p.list.count = int(std::min(count - begin, size_t(kMaxListed)));
        int64_t items = 0;
        for (int i = 0; i < p.list.count; ++i) {
          size_t const b = begin + size_t(i);
          ListedImage const x = checked_planes(op, listed(images[b]));
          KV_CHECK(x.row_stride <= INT32_MAX && x.step <= INT32_MAX, op,
                   ": expected strides of less than 2^31 elements");
          p.list.images[i] = {x.data, x.channel_stride, int(x.row_stride), int(x.step), x.height, x.width};
          Size const size = sizes()[b];
          p.list.results[i] = {results[b].mutable_data_ptr(), int(size.height), int(size.width)};
          p.list.maps[i] = uint32_t(map_begins[maps_of_each * b + channel] / kBlockUnit);
          p.list.first[i] = int(items);
          items += items_of(b);
          KV_CHECK(items <= INT32_MAX, op, ": expected results of less than 2^31 blocks");
        }
        p.list.items = int(items);
        if (fill) p.all.fill = fill + int64_t(begin) * p.all.fill_batch_stride;
        run(begin);
      }
  }
};

Tensors remap_list(Tensors const& images, Tensor const& maps, std::optional<Tensor> const& fill,
                   std::vector<int64_t> const& sizes, int64_t interpolation, int64_t padding, bool align_corners,
                   bool by_channel) {
  MappedImages const all("remap_list", images, maps, fill, sizes, interpolation, padding, align_corners, by_channel,
                         false);
  Layout const layout = all.maps_of_each > 1 ? Layout::planar : layout_of(all.like);
  Tensors const readable = in_layout(images, layout_of(all.like)),
                results = empty_list(all.like, all.channels, all.sizes(), all.count, layout);
  dispatch_floating_and_uint8(all.op, all.like, [&]<class T>(Type<T>) {
    RemapList<T> p;
    p.all = {all.shared<T>(), {}, {}, {}};
    p.list.interleaved = layout == Layout::channels_last;
    // Tiles of maps share only their block's place in the table. H200: two are 1.05 times as fast as one or four.
    p.tiles_per_block = std::min(2, tiles_per_block_of(all.sizes(), all.count));
    auto const items_of = [&](size_t b) {
      Size const size = all.sizes()[b];
      return kOnCuda ? blocks_of(size, p.tiles_per_block) : ceil_div(size.height, rows_of_item(size.width));
    };
    all.for_each_table(p, readable, results, items_of,
                       [&](size_t) { KV_RUN(remap_list, all.like, p, p.list.items, 4 * all.channels * kItemPixels); });
  });
  return results;
}

// The gradients of images, of the sizes of those of the results, or of others.
Tensors remap_list_backward(Tensors const& grads, Tensor const& maps, std::vector<int64_t> const& sizes,
                            int64_t interpolation, int64_t padding, bool align_corners, bool by_channel) {
  MappedImages const all("remap_list_backward", grads, maps, {}, sizes, interpolation, padding, align_corners,
                         by_channel, true);
  ScalarType const computed = compute_dtype(all.like);
  Tensors const sums = empty_list(all.like, all.channels, all.sizes(), all.count, Layout::planar, computed);
  clear_sums(sums);
  // On the CPU half types are added up in float32. Expanded gradients have no rows.
  Tensors readable;
  for (Tensor const& grad : grads) {
    if (!kOnCuda && grad.scalar_type() != computed) {
      readable.push_back(empty(grad.sizes(), grad, Layout::planar, computed));
      torch::stable::copy_(readable.back(), grad);
    } else {
      readable.push_back(grad.stride(2) == 0 && grad.size(2) > 1 ? dense(grad) : grad);
    }
  }
  auto const run = [&]<class T>(Type<T>) {
    RemapListBackward<T> p;
    p.all = {all.shared<T>(), {}, {}, nullptr};
    p.list.interleaved = false;
    int64_t const planes = all.channels / int64_t(all.maps_of_each);
    all.for_each_table(
        p, readable, sums,
        [&](size_t b) { return kOnCuda ? blocks_of({grads[b].size(1), grads[b].size(2)}, 1) : planes; },
        [&](size_t first) {
          [[maybe_unused]] int64_t const cost = 8 * readable[first].size(1) * readable[first].size(2);
          KV_RUN(remap_list_backward, all.like, p, p.list.items, cost);
        });
  };
#if defined(KV_CUDA)
  dispatch_floating(all.op, all.like, run);
#else
  dispatch_compute_dtype(all.op, readable[0], run);
#endif
  return sums_of_type(sums, all.like.scalar_type());
}

}  // namespace

// Images (C, H, W) of different sizes, and displacements in pixels, one map (2, H, W) after the other, each at a
// multiple of 16 numbers: of each image, or of each of its channels. With `sizes`, height and width of each result, or
// backward of each image, they are coordinates (2, h, w) of results.
#define KV_REMAP_LIST "SymInt[] sizes, int interpolation, int padding, bool align_corners, bool by_channel) -> Tensor[]"
KV_OPERATOR(remap_list, "(Tensor[] images, Tensor maps, Tensor? fill, " KV_REMAP_LIST)
KV_OPERATOR(remap_list_backward, "(Tensor[] grads, Tensor maps, " KV_REMAP_LIST)
#undef KV_REMAP_LIST

}  // namespace kv::geometry
