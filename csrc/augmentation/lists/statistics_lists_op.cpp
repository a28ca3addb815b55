// Operators on lists of images of different sizes by statistics of channels or by blocks: schemas and entries, for CPU
// and CUDA.
#include "augmentation/lists/list_steps.h"
#include "augmentation/lists/listed_images.h"
#include "enhance/channels/channel_contrast.h"
#include "enhance/clahe.h"
#include "enhance/equalize.h"
#include "enhance/jpeg_glue.h"
#include "enhance/min_max.h"
#include "enhance/plane_views.h"

namespace kv::enhance {
namespace {

template <class T>
void run([[maybe_unused]] Tensor const& like, EqualizeList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(equalize_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, MinMaxList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(min_max_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, ChannelContrastList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(channel_contrast_list, like, p, p.list.items, cost);
}
template <class T>
void run_backward([[maybe_unused]] Tensor const& like, EqualizeBackwardList<T> const& p,
                  [[maybe_unused]] int64_t cost) {
  KV_RUN(equalize_list_backward, like, p, p.items, cost);
}
template <class T>
void run_backward([[maybe_unused]] Tensor const& like, MinMaxBackwardList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(min_max_list_backward, like, p, p.items, cost);
}
template <class T>
void run_backward([[maybe_unused]] Tensor const& like, ChannelContrastBackwardList<T> const& p,
                  [[maybe_unused]] int64_t cost) {
  KV_RUN(channel_contrast_list_backward, like, p, p.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, ClaheList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(clahe_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, JpegList<T> const& p) {
  constexpr int64_t cost = 16 * kJpegSide * kJpegWidth;
  KV_RUN(jpeg_blocks_list, like, p, p.list.items, cost);
  KV_RUN(jpeg_pixels_list, like, p, p.list.items, cost / 4);
}
template <class T>
void run_backward([[maybe_unused]] Tensor const& like, JpegListBackward<T> const& p) {
  constexpr int64_t cost = 16 * kJpegSide * kJpegWidth;
  KV_RUN(jpeg_blocks_again, like, p, p.items, cost);
  KV_RUN(jpeg_blocks_list_backward, like, p, p.items, 2 * cost);
  KV_RUN(jpeg_pixels_list_backward, like, p, p.items, cost / 4);
}

}  // namespace
}  // namespace kv::enhance

namespace kv::augmentation {
namespace {

// Kernels count the pixels of a plane in int.
void check_pixels(ListedImages const& list) {
  Tensor const& like = list.like();
  KV_CHECK(like.size(2) <= INT32_MAX / like.size(3), list.kept.op, ": expected fewer than 2^31 pixels a plane");
}

// What is known of each channel of a list, `size` numbers.
void check_of_channels(ListedImages const& list, char const* name, Tensor const& x, int64_t size) {
  Tensor const& like = list.like();
  KV_CHECK(x.dim() > 1 && x.size(0) == like.size(0) && x.size(1) == like.size(1) &&
               x.numel() == size * like.size(0) * like.size(1) && x.scalar_type() == like.scalar_type() &&
               x.device() == like.device(),
           list.kept.op, ": expected ", name, " of each channel, of the type of the images");
}

// The results, and behind them (B, C): a Change of each channel.
Tensors equalized(Tensors const& images, OptionalTensor const& chosen, bool opencv, bool in_block) {
  ListedImages const list("equalize_list", images, chosen, true, in_block);
  Tensor const& like = list.like();
  check_pixels(list);
  Tensor const counts = empty({like.size(0) * like.size(1), enhance::kLevels}, like, Layout::planar, ScalarType::Int);
  Tensor const changed = empty({like.size(0), like.size(1)}, like);
  dispatch_floating_and_uint8(list.kept.op, like, [&]<class T>(Type<T>) {
    enhance::Equalize<T> all{};
    all.opencv = opencv;
    all.counts = data_ptr<int32_t>(counts);
    all.parts = 1;
    all.sample_planes = like.size(1);
    all.changed = data_ptr<T>(changed);
    list.filter_channels<enhance::EqualizeList<T>>(all, 2,
                                                   [&](auto const& p, int64_t cost) { enhance::run(like, p, cost); });
  });
  Tensors results = list.kept.results;
  results.push_back(changed);
  return results;
}

Tensors equalize_list(Tensors const& images, OptionalTensor const& chosen, bool opencv) {
  return equalized(images, chosen, opencv, false);
}

// The gradients of images. The list has the images, and behind them the gradients of the results.
Tensors equalize_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen,
                               OptionalTensor const& changed) {
  constexpr char const* op = "equalize_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen, true);
  Tensor const& like = list.like();
  check_pixels(list);
  if (changed) check_of_channels(list, "changes", *changed, 1);
  Tensor const of_channels = changed ? dense(*changed) : like;
  Tensors const grads = list.in_layout_of_images(given, true);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    enhance::EqualizeBackward<T> all{};
    all.changed = changed ? data_ptr<T const>(of_channels) : nullptr;
    all.sample_planes = like.size(1);
    list.channel_gradients<enhance::EqualizeBackwardList<T>>(
        all, grads, 1, [&](auto const& p, int64_t cost) { enhance::run_backward(like, p, cost); });
  });
  return list.kept.results;
}

// The results, and behind them (B, C, 2): the smallest and the largest value of each channel.
Tensors normalize_min_max_list(Tensors const& images, OptionalTensor const& chosen, double low, double high, double eps,
                               bool clamps, bool keeps_flat) {
  ListedImages const list("normalize_min_max_list", images, chosen, true);
  Tensor const& like = list.like();
  check_pixels(list);
  int64_t const planes = like.size(0) * like.size(1), pixels = like.size(2) * like.size(3);
  enhance::Chunks const chunks(planes, pixels);
  Tensor const range = empty({like.size(0), like.size(1), 2}, like);
  dispatch_floating(list.kept.op, like, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    Tensor const memory = enhance::working_memory<F>(like, 2 * planes * chunks.count);
    enhance::MinMax<T> all{};
    all.low = F(low), all.scale = F(high - low), all.eps = F(eps);
    all.chunk = chunks.size;
    all.partial = data_ptr<F>(memory);
    all.clamps = clamps, all.keeps_flat = keeps_flat;
    all.range = data_ptr<T>(range);
    all.sample_planes = like.size(1);
    list.filter_channels<enhance::MinMaxList<T>>(all, 2,
                                                 [&](auto const& p, int64_t cost) { enhance::run(like, p, cost); });
  });
  Tensors results = list.kept.results;
  results.push_back(range);
  return results;
}

Tensors normalize_min_max_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen,
                                        Tensor const& range, double low, double high, double eps,
                                        [[maybe_unused]] bool clamps, bool keeps_flat) {
  constexpr char const* op = "normalize_min_max_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen, true);
  Tensor const& like = list.like();
  check_pixels(list);
  check_of_channels(list, "the range", range, 2);
  int64_t const planes = like.size(0) * like.size(1);
  enhance::Chunks const chunks(planes, like.size(2) * like.size(3));
  Tensor const ranges = dense(range);
  Tensors const grads = list.in_layout_of_images(given, true);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    Tensor const memory = enhance::working_memory<F>(like, 4 * planes * chunks.count);
    enhance::MinMaxBackward<T> all{};
    all.range = data_ptr<T const>(ranges);
    all.scale = F(high - low), all.eps = F(eps);
    all.chunk = chunks.size;
    all.partial = data_ptr<F>(memory);
    all.keeps_flat = keeps_flat;
    all.sample_planes = like.size(1);
    list.channel_gradients<enhance::MinMaxBackwardList<T>>(
        all, grads, 2, [&](auto const& p, int64_t cost) { enhance::run_backward(like, p, cost); });
  });
  return list.kept.results;
}

// Of all channels of a list.
template <class T>
int64_t contrast_chunks(ListedImages const& list) {
  int64_t chunks = 0;
  for (Tensor const& x : list.images) chunks += enhance::contrast_chunks<T>(x.size(1) * x.size(2));
  return list.channels() * chunks;
}

Tensors channel_contrast_list(Tensors const& images, OptionalTensor const& chosen, double factor) {
  ListedImages const list("channel_contrast_list", images, chosen, true);
  Tensor const& like = list.like();
  check_pixels(list);
  dispatch_floating_and_uint8(list.kept.op, like, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    Tensor const memory = enhance::working_memory<F>(like, contrast_chunks<T>(list));
    enhance::ChannelContrast<T> all{};
    all.factor = F(factor), all.most = sizeof(T) == 1 ? 255 : 1;
    all.partial = static_cast<F*>(memory.mutable_data_ptr());
    list.filter_channels<enhance::ChannelContrastList<T>>(
        all, 2, [&](auto const& p, int64_t cost) { enhance::run(like, p, cost); });
  });
  return list.kept.results;
}

Tensors channel_contrast_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen, double factor) {
  constexpr char const* op = "channel_contrast_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen, true);
  Tensor const& like = list.like();
  check_pixels(list);
  Tensors const grads = list.in_layout_of_images(given, true);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    int64_t const chunks = contrast_chunks<T>(list);
    Tensor const memory = enhance::working_memory<F>(like, 2 * chunks);
    enhance::ChannelContrastBackward<T> all{};
    all.factor = F(factor);
    all.partial = static_cast<F*>(memory.mutable_data_ptr());
    all.partial_grads = all.partial + chunks;
    list.channel_gradients<enhance::ChannelContrastBackwardList<T>>(
        all, grads, 3, [&](auto const& p, int64_t cost) { enhance::run_backward(like, p, cost); });
  });
  return list.kept.results;
}

Tensors equalize_clahe_list(Tensors const& images, OptionalTensor const& chosen, OptionalTensor const& clip_limits,
                            double clip_limit, int64_t rows, int64_t columns, bool opencv) {
  ListedImages const list("equalize_clahe_list", images, chosen);
  Tensor const& like = list.like();
  check_pixels(list);
  KV_CHECK(rows > 0 && columns > 0 && rows <= enhance::kMaxTiles && columns <= enhance::kMaxTiles, list.kept.op,
           ": expected a grid of 1 to ", enhance::kMaxTiles, " tiles along each axis, got ", rows, " x ", columns);
#if defined(KV_CUDA)
  int64_t const planes = min(like.size(0), int64_t(kMaxListed)) * like.size(1);
#else
  int64_t const planes = 0;
#endif
  Tensor const tables = empty({planes, rows * columns * enhance::kLevels}, like, Layout::planar, ScalarType::Byte);
  dispatch_floating_and_uint8(list.kept.op, like, [&]<class T>(Type<T>) {
    enhance::Clahe<T> all{};
    all.clip_limits = enhance::plane_parameter<Compute<T>>(list.kept.op, "clip_limits", like, clip_limits, 0);
    all.to_levels = opencv;
    all.tables = planes ? data_ptr<uint8_t>(tables) : nullptr;
    list.filter_channels<enhance::ClaheList<T>>(all, 4, [&](auto& p, int64_t cost) {
      p.rows = int(rows), p.columns = int(columns), p.clip_limit = clip_limit;
      enhance::run(like, p, cost);
    });
  });
  return list.kept.results;
}

enhance::JpegNumbers jpeg_numbers(ListedImages const& list, OptionalTensor const& quality,
                                  OptionalTensor const& table_y, OptionalTensor const& table_c, double number) {
  Tensor const& like = list.like();
  KV_CHECK(like.size(1) == 3, list.kept.op, ": expected images of 3 channels, got ", like.size(1));
  check_pixels(list);
  return {list.kept.op, like, quality, table_y, table_c, number};
}
Tensor jpeg_levels(Tensor const& like, int64_t tiles) {
  return empty({tiles * enhance::kJpegTileLevels}, like, Layout::planar, compute_dtype(like));
}

Tensors jpeg_list(Tensors const& images, OptionalTensor const& chosen, OptionalTensor const& quality,
                  OptionalTensor const& table_y, OptionalTensor const& table_c, double number) {
  ListedImages const list("jpeg_list", images, chosen);
  Tensor const& like = list.like();
  auto const numbers = jpeg_numbers(list, quality, table_y, table_c, number);
  dispatch_floating(list.kept.op, like, [&]<class T>(Type<T>) {
    using List = enhance::JpegList<T>;
    auto const tiles_of = [](geometry::Size size) { return enhance::jpeg_tiles(size.height, size.width); };
    list.for_each_table<List>(numbers.tables<Compute<T>>(), tiles_of, [&](List& p) {
      Tensor const levels = jpeg_levels(like, p.list.items);
      p.memory = data_ptr<Compute<T>>(levels);
      enhance::run(like, p);
    });
  });
  return list.kept.results;
}

Tensors jpeg_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen, OptionalTensor const& quality,
                           OptionalTensor const& table_y, OptionalTensor const& table_c, double number) {
  constexpr char const* op = "jpeg_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  auto const numbers = jpeg_numbers(list, quality, table_y, table_c, number);
  Tensors const grads = list.in_layout_of_images(given);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    using List = enhance::JpegListBackward<T>;
    auto const tiles_of = [](Tensor const& x) { return enhance::jpeg_tiles(x.size(1), x.size(2)); };
    list.for_each_gradient_table<List>(numbers.tables<Compute<T>>(), grads, tiles_of, [&](List& p, size_t) {
      Tensor const levels = jpeg_levels(like, 2 * int64_t(p.items));
      p.memory = data_ptr<Compute<T>>(levels);
      p.grad_memory = p.memory + int64_t(p.items) * enhance::kJpegTileLevels;
      enhance::run_backward(like, p);
    });
  });
  return list.kept.results;
}

}  // namespace

Tensors steps::equalize(Tensors const& images, bool opencv) {
  OptionalTensor const all;
  Tensors results = equalized(images, all, opencv, true);
  results.pop_back();
  return results;
}

// `chosen` (B,) float32: images whose value is 0 stay as they are. What follows are the arguments of the operators on
// batches.
KV_OPERATOR(equalize_list, "(Tensor[] images, Tensor? chosen, bool opencv) -> Tensor[]")
KV_OPERATOR(equalize_list_backward, "(Tensor[] images_and_grads, Tensor? chosen, Tensor? changed) -> Tensor[]")
KV_OPERATOR(normalize_min_max_list,
            "(Tensor[] images, Tensor? chosen, float low, float high, float eps, bool clamps, bool keeps_flat)"
            " -> Tensor[]")
KV_OPERATOR(normalize_min_max_list_backward,
            "(Tensor[] images_and_grads, Tensor? chosen, Tensor range, float low, float high, float eps, bool clamps,"
            " bool keeps_flat) -> Tensor[]")
KV_OPERATOR(channel_contrast_list, "(Tensor[] images, Tensor? chosen, float factor) -> Tensor[]")
KV_OPERATOR(channel_contrast_list_backward, "(Tensor[] images_and_grads, Tensor? chosen, float factor) -> Tensor[]")
KV_OPERATOR(equalize_clahe_list,
            "(Tensor[] images, Tensor? chosen, Tensor? clip_limits, float clip_limit, int rows, int columns,"
            " bool opencv) -> Tensor[]")
KV_OPERATOR(jpeg_list,
            "(Tensor[] images, Tensor? chosen, Tensor? quality, Tensor? table_y, Tensor? table_c, float number)"
            " -> Tensor[]")
KV_OPERATOR(jpeg_list_backward,
            "(Tensor[] images_and_grads, Tensor? chosen, Tensor? quality, Tensor? table_y, Tensor? table_c,"
            " float number) -> Tensor[]")

}  // namespace kv::augmentation
