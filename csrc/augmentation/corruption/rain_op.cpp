// Lines of rain: schema and entry, for CPU and CUDA.
#include "augmentation/corruption/rain.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Drops (B, 3) int64: number, height, width; positions (B, N, 2) float32; height and width of images; pixels
// of a drop at most. Bytes (B, 1, H, W), 1 where drops are.
Tensor rain_mask(Tensor const& drops, Tensor const& positions, std::vector<int64_t> const& size, int64_t longest) {
  constexpr char const* op = "rain_mask";
  KV_CHECK(drops.dim() == 2 && drops.size(1) == 3 && drops.scalar_type() == ScalarType::Long, op,
           ": expected int64 drops of shape (B, 3)");
  int64_t const batch = drops.size(0);
  KV_CHECK(positions.dim() == 3 && positions.size(0) == batch && positions.size(2) == 2 &&
               positions.scalar_type() == ScalarType::Float && positions.device() == drops.device(),
           op, ": expected float32 positions of shape (B, N, 2) on the device of drops");
  KV_CHECK(size.size() == 2 && size[0] >= 0 && size[1] >= 0, op, ": expected a size of two sides");
  KV_CHECK(drops.is_cpu() || batch <= 65535, op, ": expected at most 65535 samples on CUDA");
  Tensor const own = dense(drops), at = dense(positions),
               y = empty({batch, 1, size[0], size[1]}, drops, Layout::planar, ScalarType::Byte);
  RainMask<float> const params{data_ptr<int64_t const>(own),
                               data_ptr<float const>(at),
                               data_ptr<uint8_t>(y),
                               batch,
                               positions.size(1),
                               size[0],
                               size[1],
                               longest};
  KV_RUN(rain_mask, drops, params, y.numel() ? batch : 0, size[0] * size[1] + 100 * params.most);
  return y;
}

}  // namespace

KV_OPERATOR(rain_mask, "(Tensor drops, Tensor positions, SymInt[] size, int longest) -> Tensor")

}  // namespace kv::augmentation
