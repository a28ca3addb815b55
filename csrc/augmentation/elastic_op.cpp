// Displacements of elastic transforms: schema and entry, for CPU and CUDA.
#include "augmentation/elastic_glue.h"
#include "filters/separable_glue.h"

namespace kv::augmentation {
namespace {

// Noise of the size and type of `like`, drawn in float32.
Tensor drawn_noise(Tensor const& like, NoiseSource const& source) {
  Tensor const drawn = empty(like.sizes(), like, Layout::planar, ScalarType::Float);
  Tensor zeros = empty(like.sizes(), drawn), standard = empty({1, 2}, drawn);
  torch::stable::zero_(zeros);
  torch::stable::zero_(standard);
  Tensor scale = torch::stable::select(standard, 1, 1);
  torch::stable::fill_(scale, 1);
  PixelNoise<float> n;
  set_images(n, zeros, drawn, Layout::planar);
  source.set(n);
  set_chosen(n, {});
  n.parameters = data_ptr<float const>(standard);
  n.parameter_stride = 0;
  n.full_range = 1;
  KV_RUN(uniform_noise, drawn, n, noise_units(drawn), 8 * kNoiseChunk);
  if (like.scalar_type() == ScalarType::Float) return drawn;
  Tensor converted = empty(like.sizes(), like);
  return torch::stable::copy_(converted, drawn);
}

#if defined(KV_CUDA)
void set_gaussian(float (&weights)[kMaxElasticTaps + 1], int64_t size, double sigma) {
  filters::Taps<double> const taps{nullptr, 0, sigma, int(size), int(size / 2), true, false};
  double sum = 0;
  for (int t = 0; t < int(size); ++t) sum += filters::tap_weight(taps, 0, t);
  for (int t = 0; t <= kMaxElasticTaps; ++t)
    weights[t] = t < int(size) ? float(filters::tap_weight(taps, 0, t) / sum) : 0;
}

bool fits_kernel(Tensor const& result, ElasticBlur const& blur) {
  return result.scalar_type() == ScalarType::Float && result.size(3) % 4 == 0 && result.numel() > 0 &&
         result.size(2) * result.size(3) <= INT32_MAX && blur.ky <= kMaxElasticTaps && blur.kx <= kMaxElasticTaps &&
         // Special case, H200: 1.27 (elastic5) to 1.58 (elastic) times as fast as noise and two blurs.
         blur.ky % 2 == 1 && blur.kx % 2 == 1 && cuda::has_elastic_displacements();
}
#endif

}  // namespace

void write_displacements(char const* op, Tensor const* noise, NoiseSource const* source, ElasticBlur const& blur,
                         Tensor const& result) {
  check_window(op, blur.ky, blur.kx);
  if (source) source->check();
#if defined(KV_CUDA)
  if (fits_kernel(result, blur)) {
    ElasticDisplacements p;
    Tensor x = source ? result : dense(*noise);
    if (!source && reinterpret_cast<uintptr_t>(x.const_data_ptr()) % 16 != 0) {  // the kernel reads vectors
      Tensor copy = empty(x.sizes(), x);
      x = torch::stable::copy_(copy, x);
    }
    set_images(p.noise, x, result, Layout::planar);
    set_chosen(p.noise, {});
    if (source) {
      p.noise.x = nullptr;
      source->set(p.noise);
    }
    p.height = int(result.size(2)), p.width = int(result.size(3));
    p.taps_y = int(blur.ky), p.taps_x = int(blur.kx);
    set_gaussian(p.ky, blur.ky, blur.sigma_y);
    set_gaussian(p.kx, blur.kx, blur.sigma_x);
    for (int i = 0; i < 2; ++i) p.scale[i] = float(blur.scale[i]);
    KV_RUN(elastic_displacements, result, p, 1, 0);
    return;
  }
#endif
  Tensor const x = source ? drawn_noise(result, *source) : as_layout(*noise, Layout::planar);
  auto const plane = [](Tensor of, int64_t axis) { return torch::stable::narrow(of, 1, axis, 1); };
  for (int64_t axis = 0; axis < 2; ++axis)
    filters::separable_into(op, plane(x, axis), plane(result, axis), Layout::planar,
                            {nullptr, blur.kx, true, 1, blur.sigma_x}, {nullptr, blur.ky, true, 0, blur.sigma_y},
                            Border::constant, true, false, blur.scale[axis], 0);
}

namespace {

// Without keys `noise` is the noise. With keys the noise is drawn, and only the size and the type of `noise` are read.
Tensor elastic_displacements(Tensor const& noise, std::optional<Tensor> const& keys, std::optional<Tensor> const& seeds,
                             std::vector<int64_t> const& plan, int64_t ky, int64_t kx, double sigma_y, double sigma_x,
                             double scale_x, double scale_y) {
  constexpr char const* op = "elastic_displacements";
  check_images(op, "noise", noise);
  KV_CHECK(noise.size(1) == 2, op, ": expected noise of shape (B, 2, H, W), got ", noise.size(1), " channels");
  KV_CHECK(keys || !seeds, op, ": expected keys with the seeds");
  Tensor const result = empty(noise.sizes(), noise);
  std::optional<NoiseSource> source;
  if (keys) source.emplace(NoiseSource{op, result, *keys, seeds, plan});
  write_displacements(op, &noise, source ? &*source : nullptr, {ky, kx, sigma_y, sigma_x, {scale_x, scale_y}}, result);
  return as_layout(result, layout_of(noise));
}

}  // namespace

// Displacements of elastic transforms: given noise (B, 2, H, W), or noise drawn by keys, after a Gaussian blur, times
// the scales.
KV_OPERATOR(elastic_displacements,
            "(Tensor noise, Tensor? keys, Tensor? seeds, int[] plan, int ky, int kx, float sigma_y, "
            "float sigma_x, float scale_x, float scale_y) -> Tensor")

}  // namespace kv::augmentation
