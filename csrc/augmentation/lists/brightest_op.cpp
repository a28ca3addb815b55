// The largest value of each image of a list: schema and entry, for CPU and CUDA.
#include "augmentation/lists/brightest.h"
#include "augmentation/lists/list_steps.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Images (C, H, W) of different sizes. One tensor (B,) of the type that is computed in.
Tensor brightest_of(Tensors const& images) {
  constexpr char const* op = "brightest_list";
  check_image_list(op, "images", images);
  Tensor const like = as_batch(images[0]);
  Tensor const y = empty({int64_t(images.size())}, like, Layout::planar, compute_dtype(like));
  auto const listed_image = [&](size_t b) { return listed(images[b]); };
  auto const items_of = [&]([[maybe_unused]] size_t b) {
#if defined(KV_CUDA)
    return ceil_div(images[b].size(1) * images[b].size(2), int64_t(kBrightestPixels));
#else
    return int64_t(1);
#endif
  };
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    Brightest<T> p;
    p.channels = int(like.size(1));
    geometry::for_each_table(p.list, images.size(), listed_image, listed_image, items_of, [&](size_t first) {
      p.y = data_ptr<Compute<T>>(y) + first;
      KV_RUN(brightest_list, like, p, p.list.items, like.numel());
    });
  });
  return y;
}
Tensors brightest_list(Tensors const& images) { return {brightest_of(images)}; }

}  // namespace

Tensor steps::brightest(Tensors const& images) { return brightest_of(images); }

KV_OPERATOR(brightest_list, "(Tensor[] images) -> Tensor[]")

}  // namespace kv::augmentation
