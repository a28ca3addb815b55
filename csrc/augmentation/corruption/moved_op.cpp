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

template <class T>
void run([[maybe_unused]] Tensor const& like, SumOfMoved<T> const& p, int64_t rows, bool backward) {
  [[maybe_unused]] int64_t const cost = 8 * p.width * (1 + p.num_moves);
  if constexpr (sizeof(T) > 1)
    if (backward) {
      KV_RUN(sum_of_moved_backward, like, p, rows, 8 * cost);
      return;
    }
  KV_RUN(sum_of_moved, like, p, rows, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, SumOfMovedList<T> const& p, bool backward) {
  [[maybe_unused]] int64_t const cost = 8 * kItemPixels * (1 + p.all.num_moves);
  if constexpr (sizeof(T) > 1)
    if (backward) {
      KV_RUN(sum_of_moved_backward_list, like, p, p.list.items, 8 * cost);
      return;
    }
  KV_RUN(sum_of_moved_list, like, p, p.list.items, cost);
}

// Of images, or, backward, of the gradients of results.
Tensor moved(char const* op, Tensor const& images, Tensor const& moves, bool backward) {
  check_moves(op, images, moves);
  int64_t const batch = images.size(0);
  KV_CHECK(images.size(2) <= INT32_MAX / 2 && images.size(3) <= INT32_MAX / 2 &&
               (images.is_cpu() || (batch * images.size(1) <= 65535 && images.size(2) <= 8 * 65535)),
           op, ": expected at most 65535 planes on CUDA, and sides below 2^30");
  Tensor const y = empty_like(images, layout_of(images)), rows = dense(moves);
  auto const of_type = [&]<class T>(Type<T>) {
    auto params = shared_moves<T>(images.size(1), rows);
    params.x = data_ptr<T const>(images), params.y = data_ptr<T>(y);
    params.batch = batch, params.height = images.size(2), params.width = images.size(3);
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    run(images, params, images.numel() ? batch * params.channels * params.height : 0, backward);
  };
  backward ? dispatch_floating(op, images, of_type) : dispatch_floating_and_uint8(op, images, of_type);
  return y;
}
Tensor sum_of_moved(Tensor const& images, Tensor const& moves) { return moved("sum_of_moved", images, moves, false); }
Tensor sum_of_moved_backward(Tensor const& grad, Tensor const& moves) {
  return moved("sum_of_moved_backward", grad, moves, true);
}

// Of images (C, H, W) of different sizes.
Tensors moved_list(char const* op, Tensors const& images, Tensor const& moves, bool backward) {
  geometry::KeptSizes const kept(op, images);
  Tensor const& like = kept.largest;
  check_moves(op, like, moves);
  int64_t const channels = like.size(1);
  Tensor const rows = dense(moves);
  auto const of_type = [&]<class T>(Type<T>) {
    SumOfMovedList<T> p;
    auto const all = shared_moves<T>(channels, rows);
    auto const items_of = [&](geometry::Size size) {
      return ceil_div(channels * size.height, rows_of_item(size.width));
    };
    kept.for_each_table(p.list, images, items_of, [&](size_t first) {
      p.all = all;
      p.all.moves += int64_t(first) * all.move_stride;
      run(like, p, backward);
    });
  };
  backward ? dispatch_floating(op, like, of_type) : dispatch_floating_and_uint8(op, like, of_type);
  return kept.results;
}
Tensors sum_of_moved_list(Tensors const& images, Tensor const& moves) {
  return moved_list("sum_of_moved_list", images, moves, false);
}
Tensors sum_of_moved_backward_list(Tensors const& grads, Tensor const& moves) {
  return moved_list("sum_of_moved_backward_list", grads, moves, true);
}

}  // namespace

KV_OPERATOR(sum_of_moved, "(Tensor images, Tensor moves) -> Tensor")
KV_OPERATOR(sum_of_moved_backward, "(Tensor grad, Tensor moves) -> Tensor")
KV_OPERATOR(sum_of_moved_list, "(Tensor[] images, Tensor moves) -> Tensor[]")
KV_OPERATOR(sum_of_moved_backward_list, "(Tensor[] grads, Tensor moves) -> Tensor[]")

}  // namespace kv::augmentation
