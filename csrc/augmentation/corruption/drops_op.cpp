// Drops: schemas and entries, for CPU and CUDA.
#include "augmentation/corruption/drops.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Calls run(Drops<T>) for layers (B, 1, H, W), float32 or float64, and thresholds (B or 1) of their type.
template <class Run>
void run_drops(char const* op, Tensor const& layers, Tensor const& thresholds, Run run) {
  int64_t const batch = layers.size(0), height = layers.size(2), width = layers.size(3);
  KV_CHECK(layers.size(1) == 1 && layers.scalar_type() == compute_dtype(layers), op,
           ": expected float32 or float64 layers of shape (B, 1, H, W)");
  KV_CHECK(thresholds.dim() == 1 && (thresholds.size(0) == batch || thresholds.size(0) == 1) &&
               thresholds.scalar_type() == layers.scalar_type() && thresholds.device() == layers.device(),
           op, ": expected thresholds of shape (B), of the type and device of layers");
  KV_CHECK(height * width <= INT32_MAX / 2 && (layers.is_cpu() || (batch <= 65535 && height <= 32 * 65535)), op,
           ": expected at most 2^30 pixels, and on CUDA 65535 layers");
  Tensor const x = dense(layers), own = dense(thresholds);
  auto const with = [&]<class T>(Type<T>) {
    run(Drops<T>{data_ptr<T const>(x), data_ptr<T const>(own), batch, height, width, own.size(0) > 1 ? 1 : 0});
  };
  layers.scalar_type() == ScalarType::Double ? with(Type<double>{}) : with(Type<float>{});
}

int64_t drop_bands(Tensor const& layers) { return layers.numel() ? layers.size(0) * ceil_div(layers.size(2), 32) : 0; }

Tensor drop_depths(Tensor const& layers, Tensor const& thresholds) {
  check_images("drop_depths", "layers", layers);
  Tensor const y = empty({layers.size(0), 1, layers.size(2), layers.size(3)}, layers, Layout::planar, ScalarType::Byte);
  run_drops("drop_depths", layers, thresholds, [&]<class T>(Drops<T> const& drops) {
    DropDepths<T> const params{drops, data_ptr<uint8_t>(y)};
    KV_RUN(drop_depths, layers, params, drop_bands(layers), 2000 * drops.width);
  });
  return y;
}

// Depths (B, 1, H, W) of bytes.
Tensor drop_reliefs(Tensor const& layers, Tensor const& thresholds, Tensor const& depths) {
  constexpr char const* op = "drop_reliefs";
  check_images(op, "layers", layers);
  bool fits = depths.dim() == 4 && depths.scalar_type() == ScalarType::Byte && depths.device() == layers.device();
  for (int i = 0; fits && i < 4; ++i) fits = depths.size(i) == layers.size(i);
  KV_CHECK(fits, op, ": expected uint8 depths of the shape and device of layers");
  Tensor const own = dense(depths), y = empty({layers.size(0), 1, layers.size(2), layers.size(3)}, layers);
  run_drops(op, layers, thresholds, [&]<class T>(Drops<T> const& drops) {
    DropReliefs<T> const params{drops, data_ptr<uint8_t const>(own), data_ptr<T>(y)};
    KV_RUN(drop_reliefs, layers, params, drop_bands(layers), 500 * drops.width);
  });
  return y;
}

}  // namespace

KV_OPERATOR(drop_depths, "(Tensor layers, Tensor thresholds) -> Tensor")
KV_OPERATOR(drop_reliefs, "(Tensor layers, Tensor thresholds, Tensor depths) -> Tensor")

}  // namespace kv::augmentation
