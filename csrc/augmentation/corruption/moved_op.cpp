// Sums of moved copies: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/moved.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), moves (B, K, 4) of the type that is computed in.
Tensor sum_of_moved(Tensor const& images, Tensor const& moves) {
  constexpr char const* op = "sum_of_moved";
  check_images(op, "images", images);
  int64_t const batch = images.size(0);
  KV_CHECK(moves.dim() == 3 && (moves.size(0) == batch || moves.size(0) == 1) && moves.size(2) == 4 &&
               moves.scalar_type() == compute_dtype(images) && moves.device() == images.device(),
           op, ": expected moves of shape (B, K, 4), of the type that is computed in, on the device of images");
  KV_CHECK(images.size(2) <= INT32_MAX / 2 && images.size(3) <= INT32_MAX / 2 &&
               (images.is_cpu() || (batch * images.size(1) <= 65535 && images.size(2) <= 8 * 65535)),
           op, ": expected at most 65535 planes on CUDA, and sides below 2^30");
  Tensor const y = empty_like(images, layout_of(images)), rows = dense(moves);
  dispatch_floating_and_uint8(op, images, [&]<class T>(Type<T>) {
    SumOfMoved<T> params{data_ptr<T const>(images),
                         data_ptr<T>(y),
                         batch,
                         images.size(1),
                         images.size(2),
                         images.size(3),
                         {},
                         {},
                         data_ptr<Compute<T> const>(rows),
                         moves.size(1),
                         moves.size(0) > 1 ? 4 * moves.size(1) : 0};
    for (int i = 0; i < 4; ++i) params.x_strides[i] = images.stride(i), params.y_strides[i] = y.stride(i);
    KV_RUN(sum_of_moved, images, params, images.numel() ? batch * params.channels * params.height : 0,
           8 * params.width * (1 + params.num_moves));
  });
  return y;
}

}  // namespace

KV_OPERATOR(sum_of_moved, "(Tensor images, Tensor moves) -> Tensor")

}  // namespace kv::augmentation
