// Sums of moved copies: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/moved.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Of images (B, C, H, W), moves (B, K, 4) of the type that is computed in.
void check_moves(char const* op, Tensor const& images, Tensor const& moves) {
  check_images(op, "images", images);
  int64_t const batch = images.size(0);
  KV_CHECK(moves.dim() == 3 && (moves.size(0) == batch || moves.size(0) == 1) && moves.size(2) == 4 &&
               moves.scalar_type() == compute_dtype(images) && moves.device() == images.device(),
           op, ": expected moves of shape (B, K, 4), of the type that is computed in, on the device of images");
}

// What the samples have in common.
template <class T>
SumOfMoved<T> shared_moves(int64_t channels, Tensor const& moves) {
  SumOfMoved<T> p{};
  p.channels = channels;
  p.moves = data_ptr<Compute<T> const>(moves);
  p.num_moves = moves.size(1), p.move_stride = moves.size(0) > 1 ? 4 * moves.size(1) : 0;
  return p;
}

Tensor sum_of_moved(Tensor const& images, Tensor const& moves) {
  constexpr char const* op = "sum_of_moved";
  check_moves(op, images, moves);
  int64_t const batch = images.size(0);
  KV_CHECK(images.size(2) <= INT32_MAX / 2 && images.size(3) <= INT32_MAX / 2 &&
               (images.is_cpu() || (batch * images.size(1) <= 65535 && images.size(2) <= 8 * 65535)),
           op, ": expected at most 65535 planes on CUDA, and sides below 2^30");
  Tensor const y = empty_like(images, layout_of(images)), rows = dense(moves);
  dispatch_floating_and_uint8(op, images, [&]<class T>(Type<T>) {
    auto params = shared_moves<T>(images.size(1), rows);
    params.x = data_ptr<T const>(images), params.y = data_ptr<T>(y);
    params.batch = batch, params.height = images.size(2), params.width = images.size(3);
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    KV_RUN(sum_of_moved, images, params, images.numel() ? batch * params.channels * params.height : 0,
           8 * params.width * (1 + params.num_moves));
  });
  return y;
}

// Of images (C, H, W) of different sizes.
Tensors sum_of_moved_list(Tensors const& images, Tensor const& moves) {
  constexpr char const* op = "sum_of_moved_list";
  geometry::KeptSizes const kept(op, images);
  check_moves(op, kept.largest, moves);
  int64_t const channels = kept.largest.size(1);
  Tensor const rows = dense(moves);
  dispatch_floating_and_uint8(op, kept.largest, [&]<class T>(Type<T>) {
    SumOfMovedList<T> p;
    auto const all = shared_moves<T>(channels, rows);
    auto const items_of = [&](geometry::Size size) {
      return ceil_div(channels * size.height, rows_of_item(size.width));
    };
    kept.for_each_table(p.list, images, items_of, [&](size_t first) {
      p.all = all;
      p.all.moves += int64_t(first) * all.move_stride;
      KV_RUN(sum_of_moved_list, kept.largest, p, p.list.items, 8 * kItemPixels * (1 + all.num_moves));
    });
  });
  return kept.results;
}

}  // namespace

KV_OPERATOR(sum_of_moved, "(Tensor images, Tensor moves) -> Tensor")
KV_OPERATOR(sum_of_moved_list, "(Tensor[] images, Tensor moves) -> Tensor[]")

}  // namespace kv::augmentation
