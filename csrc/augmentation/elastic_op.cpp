// Displacements of elastic transforms: schema and entry, for CPU and CUDA.
#include "augmentation/elastic_glue.h"
#include "augmentation/lists/list_steps.h"
#include "augmentation/lists/listed_maps_glue.h"
#include "filters/separable_glue.h"

namespace kv::augmentation {
namespace {

// The parameters of noise in [-1, 1], (1, 2).
Tensor standard_noise(Tensor const& like) {
  Tensor const standard = empty({1, 2}, like);
  Tensor scale = torch::stable::select(standard, 1, 1), mean = torch::stable::select(standard, 1, 0);
  torch::stable::zero_(mean);
  torch::stable::fill_(scale, 1);
  return standard;
}

// Noise of the size and type of `like`, drawn in float32; 0 in samples that are not chosen.
Tensor drawn_noise(Tensor const& like, NoiseSource const& source, std::optional<Tensor> const& chosen) {
  Tensor const drawn = empty(like.sizes(), like, Layout::planar, ScalarType::Float), standard = standard_noise(drawn);
  Tensor zeros = empty(like.sizes(), drawn);
  torch::stable::zero_(zeros);
  PixelNoise<float> n;
  set_images(n, zeros, drawn, Layout::planar);
  source.set(n);
  set_chosen(n, chosen);
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

bool fits_kernel(ScalarType type, ElasticBlur const& blur) {
  return type == ScalarType::Float && blur.ky <= kMaxElasticTaps && blur.kx <= kMaxElasticTaps &&
         // Special case, H200: 1.27 (elastic5) to 1.58 (elastic) times as fast as noise and two blurs.
         blur.ky % 2 == 1 && blur.kx % 2 == 1 && cuda::has_elastic_displacements();
}

void set_blur(ElasticDisplacements& p, ElasticBlur const& blur) {
  p.taps_y = int(blur.ky), p.taps_x = int(blur.kx);
  set_gaussian(p.ky, blur.ky, blur.sigma_y);
  set_gaussian(p.kx, blur.kx, blur.sigma_x);
  for (int i = 0; i < 2; ++i) p.scale[i] = float(blur.scale[i]);
}

// Fills the maps of a block with noise that the kernel draws and blurs; `p` has the blur and the scales.
void draw_maps(char const* op, MapBlock const& block, Tensor const& result, ElasticDisplacementsList& p,
               Tensor const& keys, std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
               std::vector<int64_t> const& plan) {
  int64_t height = 1, width = 1;
  for (int64_t b = 0; b < block.count; ++b)
    if (block.sides[size_t(2 * b)] * block.sides[size_t(2 * b + 1)] > height * width)
      height = block.sides[size_t(2 * b)], width = block.sides[size_t(2 * b + 1)];
  KV_CHECK(2 * height * width <= INT32_MAX, op, ": expected maps of less than 2^31 numbers");
  Tensor const all = view_of(result, {block.count, 2, height, width}, {0, height * width, width, 1});
  NoiseSource const source{op, all, keys, seeds, plan};
  source.check();
  p.all.noise.channels = 2, p.all.noise.step = 1;
  p.all.noise.y = data_ptr<float>(result);
  set_chosen(p.all.noise, chosen);
  source.set(p.all.noise);
  ElasticDisplacements const shared = p.all;
  block.for_each_table(p.list, [&](int64_t first) {
    p.all = shared;
    p.all.noise.skip(first);
    KV_RUN(elastic_displacements_list, result, p, 1, 0);
  });
}
#endif

// The windows of a blur for images of a size.
ElasticBlur blur_of_size(filters::SideBlur const& blur, int64_t height, int64_t width) {
  filters::Taps<double> x{}, y{};
  blur.x.set(x, width), blur.y.set(y, height);
  double const scale_x = blur.factor(blur.x, width, height, width),
               scale_y = blur.factor(blur.y, height, height, width);
  return {y.size, x.size, y.sigma, x.sigma, {scale_x, scale_y}};
}

bool is_one_size(std::vector<int64_t> const& sides) {
  for (size_t i = 2; i < sides.size(); ++i)
    if (sides[i] != sides[i - 2]) return false;
  return true;
}

#if defined(KV_CUDA)
// The windows for the largest images of a list.
ElasticBlur largest_blur(filters::SideBlur const& blur, std::vector<int64_t> const& sides) {
  int64_t height = 1, width = 1;
  for (size_t i = 0; i + 1 < sides.size(); i += 2)
    height = std::max(height, sides[i]), width = std::max(width, sides[i + 1]);
  return blur_of_size(blur, height, width);
}
#endif

}  // namespace

#if defined(KV_CUDA)
std::optional<Tensor> blurred_maps_of_sides(char const* op, Tensor const& parameters, Tensor const& keys,
                                            std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                                            std::vector<int64_t> const& plan, std::vector<int64_t> const& sides,
                                            filters::SideBlur const& blur, Border border) {
  ElasticBlur const largest = largest_blur(blur, sides);
  // Sums of this kernel have another order than those of a batch, whose bits images of one size have.
  if (!fits_kernel(parameters.scalar_type(), largest) || is_one_size(sides) ||
      (border != Border::reflect && border != Border::constant))
    return {};
  MapBlock const block(op, parameters.size(0), sides);
  check_chosen(op, chosen, parameters);
  Tensor const scales = dense(parameters), result = block.empty_like(parameters);
  ElasticDisplacementsList p{};
  p.all.noise.parameters = data_ptr<float const>(scales), p.all.noise.parameter_stride = 2;
  p.all.taps_y = int(largest.ky), p.all.taps_x = int(largest.kx);
  p.all.is_mirrored = border == Border::reflect;
  p.by_sides = blur;
  draw_maps(op, block, result, p, keys, seeds, chosen, plan);
  return result;
}
#endif

void write_displacements(char const* op, Tensor const* noise, NoiseSource const* source, ElasticBlur const& blur,
                         Tensor const& result, std::optional<Tensor> const& chosen) {
  check_window(op, blur.ky, blur.kx);
  if (source) source->check();
#if defined(KV_CUDA)
  if (fits_kernel(result.scalar_type(), blur) && result.numel() > 0 && result.size(2) * result.size(3) <= INT32_MAX) {
    ElasticDisplacements p{};
    Tensor x = source ? result : dense(*noise);
    if (!source && reinterpret_cast<uintptr_t>(x.const_data_ptr()) % 16 != 0) {  // the kernel reads vectors
      Tensor copy = empty(x.sizes(), x);
      x = torch::stable::copy_(copy, x);
    }
    set_images(p.noise, x, result, Layout::planar);
    set_chosen(p.noise, chosen);
    if (source) {
      p.noise.x = nullptr;
      source->set(p.noise);
    }
    p.height = int(result.size(2)), p.width = int(result.size(3));
    set_blur(p, blur);
    KV_RUN(elastic_displacements, result, p, 1, 0);
    return;
  }
#endif
  Tensor const x = source ? drawn_noise(result, *source, chosen) : as_layout(*noise, Layout::planar);
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

// Of drawn noise, or of given noise, which is packed as they are, maps of a list. `like` (B, 0) has the type and the
// device; the scales are half the width and half the height, less half a pixel each with align_corners, times alpha.
// Windows are those for images of `unit` pixels along each side, and scale with the images, if it is not 0.
Tensor elastic_displacements_list(Tensor const& like, std::optional<Tensor> const& noise, Tensor const& keys,
                                  std::optional<Tensor> const& seeds, std::optional<Tensor> const& chosen,
                                  std::vector<int64_t> const& plan, int64_t ky, int64_t kx, double sigma_y,
                                  double sigma_x, double alpha_x, double alpha_y, bool align_corners, int64_t unit,
                                  std::vector<int64_t> const& sides) {
  constexpr char const* op = "elastic_displacements_list";
  KV_CHECK(like.dim() == 2 && like.scalar_type() == compute_dtype(like), op,
           ": expected like of shape (B, 0), float32 or float64");
  int64_t const count = like.size(0);
  MapBlock const block(op, count, sides);
  check_chosen(op, chosen, like);
  check_window(op, ky, kx);
  Tensor const result = block.empty_like(like);
  KV_CHECK(unit >= 0, op, ": expected unit of at least 0");
  double const each = unit > 0 ? 1 / double(unit) : 1;
  auto const axis = [&](int64_t taps, double sigma, double alpha) {
    return filters::SideGaussian{sigma * each, double(taps / 2) * each, taps > 1, unit > 0, alpha};
  };
  filters::SideBlur blur{axis(kx, sigma_x, alpha_x), axis(ky, sigma_y, alpha_y)};
  blur.scales = true;
  blur.less = align_corners ? 1 : 0, blur.unit = unit > 0 ? each : 0;
  if (count > 0 && is_one_size(sides)) blur.x.fix(sides[1]), blur.y.fix(sides[0]);  // of the bits of a batch
  std::optional<Tensor> given;
  if (noise) {
    KV_CHECK(noise->dim() == 1 && noise->size(0) == result.size(0) && noise->scalar_type() == like.scalar_type() &&
                 noise->device() == like.device() && !chosen,
             op, ": expected packed noise of the type and device of like, 0 of samples that are not chosen");
    given = dense(*noise);
  }
  auto const map_of = [&](Tensor const& of, int64_t b) {
    return view_of(of, {1, 2, sides[size_t(2 * b)], sides[size_t(2 * b + 1)]}, block.begins[size_t(b)]);
  };
  auto const row = [](std::optional<Tensor> const& of, int64_t b) -> std::optional<Tensor> {
    if (!of || of->size(0) == 1) return of;
    Tensor all = *of;
    return torch::stable::narrow(all, 0, b, 1);
  };
#if defined(KV_CUDA)
  if (like.scalar_type() == ScalarType::Float && count > 0) {
    ElasticBlur const largest = largest_blur(blur, sides);
    if (!fits_kernel(ScalarType::Float, largest) && given) {
      Tensors each;
      for (int64_t b = 0; b < count; ++b) each.push_back(torch::stable::select(map_of(*given, b), 0, 0));
      return steps::gaussian_blur_of_sides(each, blur, Border::constant);
    }
    if (!fits_kernel(ScalarType::Float, largest)) {
      Tensor const standard = standard_noise(like);
      return steps::gaussian_blur_of_sides(
          steps::drawn_noise(like, 2, sides, false, standard, keys, seeds, chosen, plan), blur, Border::constant);
    }
    ElasticDisplacementsList p{};
    set_blur(p.all, largest);
    p.by_sides = blur;
    if (given) {
      p.all.noise.x = data_ptr<float const>(*given);
      draw_maps(op, block, result, p, keys, seeds, chosen, {0, 0, 1, 0});
    } else {
      draw_maps(op, block, result, p, keys, seeds, chosen, plan);
    }
    return result;
  }
#endif
  if (given) {
    for (int64_t b = 0; b < count; ++b) {
      Tensor const one = map_of(result, b), own = map_of(*given, b);
      write_displacements(op, &own, nullptr, blur_of_size(blur, one.size(2), one.size(3)), one);
    }
    return result;
  }
  KV_CHECK(plan.size() >= 4, op, ": expected a plan of four to six numbers");
  std::vector<int64_t> own = plan;
  own.resize(6);
  int64_t const first = own[5];
  for (int64_t b = 0; b < count; ++b) {
    Tensor const one = map_of(result, b);
    own[5] = first + b;
    std::optional<Tensor> const seed = row(seeds, b);
    NoiseSource const source{op, one, keys, seed, own};
    write_displacements(op, nullptr, &source, blur_of_size(blur, one.size(2), one.size(3)), one, row(chosen, b));
  }
  return result;
}

}  // namespace

// Displacements of elastic transforms: given noise (B, 2, H, W), or noise drawn by keys, after a Gaussian blur, times
// the scales.
KV_OPERATOR(elastic_displacements,
            "(Tensor noise, Tensor? keys, Tensor? seeds, int[] plan, int ky, int kx, float sigma_y, "
            "float sigma_x, float scale_x, float scale_y) -> Tensor")
KV_OPERATOR(elastic_displacements_list,
            "(Tensor like, Tensor? noise, Tensor keys, Tensor? seeds, Tensor? chosen, int[] plan, int ky, int kx, "
            "float sigma_y, "
            "float sigma_x, float alpha_x, float alpha_y, bool align_corners, int unit, SymInt[] size) -> Tensor")

}  // namespace kv::augmentation
