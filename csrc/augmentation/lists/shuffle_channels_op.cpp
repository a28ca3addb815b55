// Shuffled channels: schema and entry, for CPU and CUDA.
#include "augmentation/lists/shuffle_channels.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Channel c of the result of image b is channel orders[b, c], (B or 1, C) int64, of the image.
Tensors shuffle_channels_list(Tensors const& images, Tensor const& orders) {
  geometry::KeptSizes const kept("shuffle_channels_list", images);
  Tensor const& like = kept.largest;
  int64_t const batch = like.size(0), channels = like.size(1);
  KV_CHECK(orders.dim() == 2 && (orders.size(0) == batch || orders.size(0) == 1) && orders.size(1) == channels &&
               orders.scalar_type() == ScalarType::Long && orders.device() == like.device(),
           kept.op, ": expected int64 orders of shape (B, C) on the device of images");
  KV_CHECK(like.size(2) <= INT32_MAX / like.size(3), kept.op, ": expected fewer than 2^31 pixels");
  Tensor const own = dense(orders);
  auto const items_of = [&](geometry::Size size) {
    return (kept.interleaved() ? 1 : channels) * ceil_div(size.height * size.width, int64_t(kShuffledPixels));
  };
  auto const run = [&]<class T>(Type<T>) {
    ShuffleChannels<T> p;
    p.channels = int(channels);
    p.order_stride = own.size(0) > 1 ? channels : 0;
    kept.for_each_table(p.list, images, items_of, [&](size_t first) {
      p.orders = data_ptr<int64_t const>(own) + int64_t(first) * p.order_stride;
      KV_RUN(shuffle_channels_list, like, p, p.list.items, kShuffledPixels);
    });
  };
  switch (like.element_size()) {
    case 1:
      run(Type<uint8_t>{});
      break;
    case 2:
      run(Type<uint16_t>{});
      break;
    case 4:
      run(Type<uint32_t>{});
      break;
    default:
      KV_CHECK(like.element_size() == 8, kept.op, ": expected real images");
      run(Type<uint64_t>{});
  }
  return kept.results;
}

}  // namespace

KV_OPERATOR(shuffle_channels_list, "(Tensor[] images, Tensor orders) -> Tensor[]")

}  // namespace kv::augmentation
