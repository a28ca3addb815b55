// Tables of lists, for the entries of operators.
#pragma once

#include "geometry/transform/sampling_glue.h"
#include "glue/image_list.h"

namespace kv::geometry {

// Height and width of all images, or of each.
struct ListSizes {
  char const* op;
  std::vector<int64_t> const& sides;

  ListSizes(char const* op, std::vector<int64_t> const& sides, size_t count) : op(op), sides(sides) {
    KV_CHECK(is_one() || sides.size() == 2 * count, op, ": expected one size or ", count, " sizes, got ", sides.size(),
             " numbers");
  }
  bool is_one() const { return sides.size() == 2; }
  Size operator[](size_t b) const {
    size_t const at = is_one() ? 0 : 2 * b;
    return checked_size(op, {sides[at], sides[at + 1]});
  }
};

// A batch (B, C, H, W), or as many tensors (C, H, W): what is read or written for each sample.
struct BatchOrList {
  Tensors const& tensors;
  bool is_batch;
  int64_t bytes;  // from an image of a batch to the next one

  explicit BatchOrList(Tensors const& tensors)
      : tensors(tensors),
        is_batch(tensors[0].dim() == 4),
        bytes(is_batch ? tensors[0].stride(0) * tensors[0].element_size() : 0) {}
  ListedImage operator[](size_t b) const {
    if (!is_batch) return listed(tensors[b]);
    Tensor const& x = tensors[0];
    char const* const data = static_cast<char const*>(x.const_data_ptr()) + int64_t(b) * bytes;
    return {data, x.stride(1), x.stride(2), x.stride(3), int(x.size(2)), int(x.size(3))};
  }
};

// A batch (B, C, H, W), or images (C, H, W), of which those are copied that have not the layout.
inline Tensors in_layout(Tensors const& inputs, Layout layout) {
  Tensors readable;
  readable.reserve(inputs.size());
  for (Tensor const& x : inputs) {
    int64_t const c = x.dim() - 3, w = x.dim() - 1, channels = x.size(c);
    bool const fits = layout == Layout::channels_last ? x.stride(c) == 1 && (x.stride(w) == channels || x.size(w) == 1)
                                                      : x.stride(w) == 1 || x.size(w) == 1;
    if (fits) {
      readable.push_back(x);
    } else if (x.dim() == 4) {
      readable.push_back(as_layout(x, layout));
    } else {
      Tensor const copy = as_layout(as_batch(x), layout);
      readable.push_back(
          view_of(copy, {channels, copy.size(2), copy.size(3)}, {copy.stride(1), copy.stride(2), copy.stride(3)}));
    }
  }
  return readable;
}

// Where results (C, h, w) of a size each begin in one block of memory, in elements: at vectors. The last entry is its
// length.
inline std::vector<int64_t> offsets_in_block(int64_t channels, ListSizes const& sizes, size_t count) {
  std::vector<int64_t> offsets(count + 1);
  for (size_t b = 0; b < count; ++b)
    offsets[b + 1] = offsets[b] + ceil_div(channels * sizes[b].height * sizes[b].width, 16) * 16;
  return offsets;
}

// Results (C, h, w), of a size each, of the type of `like` or of another one, in one block of memory, which has less
// host time than an allocation each. `like` is a batch.
inline Tensors list_in_block(Tensor const& like, int64_t channels, ListSizes const& sizes, size_t count,
                             std::optional<ScalarType> type = {}, Tensor* block = nullptr,
                             Layout layout = Layout::planar) {
  std::vector<int64_t> const offsets = offsets_in_block(channels, sizes, count);
  Tensor const memory = empty({offsets.back()}, like, Layout::planar, type);
  Tensors results;
  results.reserve(count);
  for (size_t b = 0; b < count; ++b) {
    int64_t const h = sizes[b].height, w = sizes[b].width;
    int64_t const planar[] = {h * w, w, 1}, interleaved[] = {1, w * channels, channels};
    results.push_back(view_of(memory, {channels, h, w}, layout == Layout::planar ? planar : interleaved, offsets[b]));
  }
  if (block) *block = memory;
  return results;
}

// The same, as results of an operator: some have memory of their own, as programs of torch.compile require. Lists that
// are too long for those share a block: allocations would take 3 us of the host each, on an H200 beside 2 for all else.
constexpr size_t kMostWithOwnMemory = 16;
inline Tensors empty_list(Tensor const& like, int64_t channels, ListSizes const& sizes, size_t count, Layout layout,
                          std::optional<ScalarType> type = {}) {
  if (count > kMostWithOwnMemory) return list_in_block(like, channels, sizes, count, type, nullptr, layout);
  Tensors results;
  results.reserve(count);
  for (size_t b = 0; b < count; ++b)
    results.push_back(empty({channels, sizes[b].height, sizes[b].width}, like, layout, type));
  return results;
}

// One result (B, C, h, w), of one size; or a list of results, of a size each.
inline Tensors empty_results(Tensor const& like, ListSizes const& sizes, size_t count, Layout layout,
                             bool are_gradients = false) {
  int64_t const channels = like.size(1);
  if (sizes.is_one() && !are_gradients)
    return {empty({int64_t(count), channels, sizes[0].height, sizes[0].width}, like, layout)};
  return empty_list(like, channels, sizes, count, layout);
}

// Fills tables of at most kMaxListed samples each, and calls run(first sample of the table). `image_of(b)` is what is
// read for sample b, `result_of(b)` what is written, `items_of(b)` the number of its items.
template <class ImageOf, class ResultOf, class ItemsOf, class Run>
void for_each_table(ListedSamples& list, size_t count, ImageOf image_of, ResultOf result_of, ItemsOf items_of,
                    Run run) {
  for (size_t begin = 0; begin < count; begin += kMaxListed) {
    list.count = int(std::min(count - begin, size_t(kMaxListed)));
    int64_t items = 0;
    for (int i = 0; i < list.count; ++i) {
      size_t const b = begin + size_t(i);
      list.images[i] = image_of(b);
      ListedImage const result = result_of(b);
      list.results[i] = {const_cast<void*>(result.data), result.height, result.width};
      list.first[i] = int(items);
      items += items_of(b);
      KV_CHECK(items <= INT32_MAX, "lists: expected results of less than 2^31 blocks");
    }
    list.items = int(items);
    run(begin);
  }
}

// A list of images (C, H, W) whose results have their sizes.
struct ListSides {
  char const* op;
  std::vector<int64_t> sides;
  Tensor largest;  // stands for a batch (B, C, H, W) in checks

  ListSides(char const* op, Tensors const& images) : op(op) {
    check_image_list(op, "images", images);
    sides.reserve(2 * images.size());
    Tensor const* most = &images[0];
    for (Tensor const& x : images) {
      sides.push_back(x.size(1)), sides.push_back(x.size(2));
      if (x.size(1) * x.size(2) > most->size(1) * most->size(2)) most = &x;
    }
    int64_t const count = int64_t(images.size()), channels = most->size(0);
    largest = view_of(*most, {count, channels, most->size(1), most->size(2)},
                      {0, most->stride(0), most->stride(1), most->stride(2)});
  }
  ListSizes sizes() const { return {op, sides, sides.size() / 2}; }
  Tensors empty(Layout layout, std::optional<ScalarType> type = {}) const {
    return empty_list(largest, largest.size(1), sizes(), sides.size() / 2, layout, type);
  }

  // Fills tables of images and of results of a layout, and calls run(first sample of the table).
  template <class ItemsOf, class Run>
  void for_each_table(ListedSamples& list, Tensors const& images, Tensors const& results, Layout layout,
                      ItemsOf items_of, Run run) const {
    if (largest.size(1) == 0) return;
    ListSizes const all = sizes();
    list.interleaved = layout == Layout::channels_last;
    geometry::for_each_table(
        list, images.size(), [&](size_t b) { return listed(images[b]); }, [&](size_t b) { return listed(results[b]); },
        [&](size_t b) { return items_of(all[b]); }, run);
  }
};

// One whose results have the type of the images, too: those of an operator, or, `in_block`, dense ones that follow each
// other in one block.
struct KeptSizes : ListSides {
  Layout layout;
  Tensor block;
  Tensors results;

  KeptSizes(char const* op, Tensors const& images, bool in_block = false)
      : ListSides(op, images),
        layout(in_block ? Layout::planar : layout_of(as_batch(images[0]))),
        results(in_block ? list_in_block(largest, largest.size(1), sizes(), images.size(), {}, &block)
                         : empty(layout)) {}
  bool interleaved() const { return layout == Layout::channels_last; }

  // Fills tables of images, which have the layout, and calls run(first sample of the table).
  template <class ItemsOf, class Run>
  void for_each_table(ListedSamples& list, Tensors const& images, ItemsOf items_of, Run run) const {
    ListSides::for_each_table(list, images, results, layout, items_of, run);
  }
};

// A call that resizes a list of images, or the gradients of its results, which are one batch or a list.
struct ListResizing {
  char const* op;
  Tensors const& inputs;
  bool backward;
  size_t count;
  ListSizes sizes;  // of the results
  Tensor like;      // a batch
  Layout layout;
  bool interleaved;
  int64_t channels;

  ListResizing(char const* op, Tensors const& inputs, std::vector<int64_t> const& sides, bool backward)
      : op(op),
        inputs(inputs),
        backward(backward),
        count(checked_count(op, inputs, backward)),
        sizes(op, sides, count),
        like(inputs[0].dim() == 4 ? inputs[0] : as_batch(inputs[0])),
        layout(layout_of(like)),
        interleaved(layout == Layout::channels_last),
        channels(like.size(1)) {}

  static size_t checked_count(char const* op, Tensors const& inputs, bool backward) {
    KV_CHECK(!inputs.empty(), op, ": expected at least one image");
    bool const is_batch = inputs[0].dim() == 4;
    is_batch ? check_images(op, "grads", inputs[0]) : check_image_list(op, backward ? "grads" : "images", inputs);
    return is_batch ? size_t(inputs[0].size(0)) : inputs.size();
  }

  // The results, which run(type, tables) computes: tables(list, items_of, launch) fills the list and calls
  // launch(first sample) for each of its tables; items_of(size) is the number of the items of a result. A batch of
  // results may be written to `memory`.
  template <class Run>
  Tensors results(Run run, std::optional<Tensor> const& memory = {}) const {
    Tensors const results = memory ? Tensors{*memory} : empty_results(like, sizes, count, layout, backward);
    if (channels == 0) return results;
    Tensors const readable = in_layout(inputs, layout);
    BatchOrList const from(readable), to(results);
    auto const tables = [&](ListedSamples& list, auto items_of, auto launch) {
      list.interleaved = interleaved;
      for_each_table(
          list, count, [&](size_t b) { return from[b]; }, [&](size_t b) { return to[b]; },
          [&](size_t b) { return items_of(sizes[b]); }, launch);
    };
    auto const of_type = [&](auto type) { run(type, tables); };
    if (backward)
      dispatch_floating(op, like, of_type);
    else
      dispatch_floating_and_uint8(op, like, of_type);
    return results;
  }
};

}  // namespace kv::geometry
