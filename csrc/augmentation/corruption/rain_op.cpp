// Lines of rain: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/rain.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Drops (B, 3) int64: number, height, width; positions (B, N, 2) float32; height and width of all images, or of each;
// pixels of a drop at most. Bytes (B, 1, H, W) of the largest sides, 1 where drops are.
Tensor rain_mask(Tensor const& drops, Tensor const& positions, std::vector<int64_t> const& size, int64_t longest) {
  constexpr char const* op = "rain_mask";
  KV_CHECK(drops.dim() == 2 && drops.size(1) == 3 && drops.scalar_type() == ScalarType::Long, op,
           ": expected int64 drops of shape (B, 3)");
  int64_t const batch = drops.size(0);
  KV_CHECK(positions.dim() == 3 && positions.size(0) == batch && positions.size(2) == 2 &&
               positions.scalar_type() == ScalarType::Float && positions.device() == drops.device(),
           op, ": expected float32 positions of shape (B, N, 2) on the device of drops");
  bool const is_one = size.size() == 2;
  KV_CHECK((is_one || int64_t(size.size()) == 2 * batch) && size.size() >= 2, op,
           ": expected height and width of all images, or of each");
  int64_t tall = 0, wide = 0;
  for (size_t i = 0; i < size.size(); i += 2) {
    KV_CHECK(size[i] >= 0 && size[i + 1] >= 0, op, ": expected a size of two sides");
    tall = max(tall, size[i]), wide = max(wide, size[i + 1]);
  }
  KV_CHECK(drops.is_cpu() || batch <= 65535, op, ": expected at most 65535 samples on CUDA");
  Tensor const own = dense(drops), at = dense(positions),
               y = empty({batch, 1, tall, wide}, drops, Layout::planar, ScalarType::Byte);
  if (y.numel() == 0) return y;
  RainMask<float> const params{data_ptr<int64_t const>(own),
                               data_ptr<float const>(at),
                               data_ptr<uint8_t>(y),
                               batch,
                               positions.size(1),
                               tall,
                               wide,
                               tall,
                               wide,
                               longest};
  if (is_one) {
    KV_RUN(rain_mask, drops, params, batch, tall * wide + 100 * params.most);
    return y;
  }
  for (int64_t first = 0; first < batch; first += kMaxListed) {
    RainMaskList<float> list;
    list.all = params.sample(first);
    list.all.batch = min(batch - first, int64_t(kMaxListed));
    for (int64_t b = 0; b < list.all.batch; ++b)
      list.sizes[b] = {int(size[size_t(2 * (first + b))]), int(size[size_t(2 * (first + b) + 1)])};
    KV_RUN(rain_mask_list, drops, list, list.all.batch, tall * wide + 100 * params.most);
  }
  return y;
}

}  // namespace

KV_OPERATOR(rain_mask, "(Tensor drops, Tensor positions, SymInt[] size, int longest) -> Tensor")

}  // namespace kv::augmentation
