// Fractal noise: schema and entry, for CPU and CUDA.
#include "augmentation/noise_glue.h"
#include "augmentation/random_generator/fractal_noise.h"

namespace kv::augmentation {
namespace {

// How often a side of at least n pixels, 2^k + 1, halves: at least once, to 3.
int halvings(int64_t n) {
  int k = 1;
  while ((int64_t(1) << k) + 1 < n) ++k;
  return k;
}

// Roughness (B,), float32 or float64, the type of the result; keys, seeds and plan as those of noise; channels, height
// and width.
Tensor fractal_noise(Tensor const& roughness, Tensor const& keys, std::optional<Tensor> const& seeds,
                     std::vector<int64_t> const& plan, std::vector<int64_t> const& size) {
  constexpr char const* op = "fractal_noise";
  KV_CHECK(roughness.dim() == 1 && roughness.scalar_type() == compute_dtype(roughness), op,
           ": expected float32 or float64 roughness of shape (B,)");
  KV_CHECK(size.size() == 3 && size[0] >= 0 && size[1] >= 1 && size[2] >= 1, op,
           ": expected channels, height and width");
  int64_t const batch = roughness.size(0), channels = size[0], height = size[1], width = size[2];
  int const down = halvings(height), across = halvings(width), levels = min(down, across);
  // The first level has 3 pixels along its shorter side.
  int64_t const rows = (int64_t(1) << (down - levels + 1)) + 1, columns = (int64_t(1) << (across - levels + 1)) + 1;
  int64_t const tall = (int64_t(1) << down) + 1, wide = (int64_t(1) << across) + 1;
  KV_CHECK(tall * wide <= INT32_MAX / 2 && (roughness.is_cpu() || batch * channels <= 65535), op,
           ": expected at most 2^30 pixels, and on CUDA 65535 planes");
  Tensor const y = empty({batch, channels, height, width}, roughness);
  NoiseSource const source{op, y, keys, seeds, plan};
  source.check();
  if (y.numel() == 0) return y;
  auto const run = [&]<class T>(Type<T>) {
    FractalNoise<T> params{};
    source.set(params.noise);
    params.roughness = data_ptr<T const>(roughness), params.roughness_stride = roughness.stride(0);
    params.y = data_ptr<T>(y);
    params.batch = batch, params.channels = channels, params.height = height, params.width = width;
    params.h = (rows + 1) / 2, params.w = (columns + 1) / 2, params.levels = levels;
    params.is_upright = columns == 3;
#if defined(KV_CUDA)
    std::optional<Tensor> before;
    for (;;) {
      std::optional<Tensor> after;
      if (!params.is_last())
        after = empty({batch, channels, params.fine_height(), params.fine_width()}, roughness, Layout::planar,
                      ScalarType::Double);
      params.coarse = before ? data_ptr<double>(*before) : nullptr;
      params.fine = after ? data_ptr<double>(*after) : nullptr;
      KV_RUN(fractal_noise, roughness, params, 1, 0);
      if (params.is_last()) return;
      params.next();
      before = after;
    }
#else
    KV_RUN(fractal_noise, roughness, params, batch * channels, 100 * height * width);
#endif
  };
  roughness.scalar_type() == ScalarType::Double ? run(Type<double>{}) : run(Type<float>{});
  return y;
}

}  // namespace

KV_OPERATOR(fractal_noise, "(Tensor roughness, Tensor keys, Tensor? seeds, int[] plan, SymInt[] size) -> Tensor")

}  // namespace kv::augmentation
