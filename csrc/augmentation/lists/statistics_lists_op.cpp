// Operators on lists of images of different sizes by statistics of channels: schemas and entries, for CPU and CUDA.
#include "augmentation/lists/listed_images.h"
#include "enhance/equalize.h"

namespace kv::enhance {
namespace {

template <class T>
void run([[maybe_unused]] Tensor const& like, EqualizeList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(equalize_list, like, p, p.list.items, cost);
}

}  // namespace
}  // namespace kv::enhance

namespace kv::augmentation {
namespace {

Tensors equalize_list(Tensors const& images, OptionalTensor const& chosen, bool opencv) {
  ListedImages const list("equalize_list", images, chosen, true);
  Tensor const& like = list.like();
  KV_CHECK(like.size(2) <= INT32_MAX / like.size(3), list.kept.op, ": expected fewer than 2^31 pixels a plane");
  Tensor const counts = empty({like.size(0) * like.size(1), enhance::kLevels}, like, Layout::planar, ScalarType::Int);
  dispatch_floating_and_uint8(list.kept.op, like, [&]<class T>(Type<T>) {
    enhance::Equalize<T> all{};
    all.opencv = opencv;
    all.counts = data_ptr<int32_t>(counts);
    all.parts = 1;
    all.sample_counts = like.size(1) * enhance::kLevels;
    list.filter_channels<enhance::EqualizeList<T>>(all, 2,
                                                   [&](auto const& p, int64_t cost) { enhance::run(like, p, cost); });
  });
  return list.kept.results;
}

}  // namespace

// `chosen` (B,) float32: images whose value is 0 stay as they are. What follows are the arguments of the operators on
// batches.
KV_OPERATOR(equalize_list, "(Tensor[] images, Tensor? chosen, bool opencv) -> Tensor[]")

}  // namespace kv::augmentation
