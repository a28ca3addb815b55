// Fractal noise: schema and entry, for CPU and CUDA.
#include "augmentation/noise_glue.h"
#include "augmentation/random_generator/fractal_noise.h"

namespace kv::augmentation {
namespace {

template <class T>
void run_level([[maybe_unused]] Tensor const& like, FractalNoise<T> const& p) {
  KV_RUN(fractal_noise, like, p, p.batch * p.channels, 100 * p.height * p.width);
}
template <class T>
void run_level([[maybe_unused]] Tensor const& like, FractalNoiseList<T> const& p) {
  KV_RUN(fractal_noise_list, like, p, p.count * p.all.channels, 100 * p.all.tall * p.all.wide);
}

// What a sample, or all samples of a size, needs of memory for a plane of its level; 0 of the last one.
template <class T>
int64_t fine_plane_of(FractalNoise<T> const& p) {
  return p.level + 1 < p.levels ? p.fine_height() * p.fine_width() : 0;
}
template <class T>
int64_t fine_plane_of(FractalNoiseList<T> const& p) {
  int64_t most = 0;
  for (int b = 0; b < p.count; ++b) most = max(most, fine_plane_of(p.sample(b)));
  return most;
}

// All levels of planes, each of which writes memory that the next one reads; on the CPU a kernel does all of them.
template <class Params, class T>
void run_levels(Tensor const& like, [[maybe_unused]] int64_t planes, Params& params, FractalNoise<T>& all) {
#if defined(KV_CUDA)
  std::optional<Tensor> before;
  for (;;) {
    std::optional<Tensor> after;
    all.fine = nullptr, all.fine_plane = fine_plane_of(params);
    if (all.fine_plane) after = empty({planes * all.fine_plane}, like, Layout::planar, ScalarType::Double);
    all.coarse = before ? data_ptr<double>(*before) : nullptr, all.fine = after ? data_ptr<double>(*after) : nullptr;
    run_level(like, params);
    if (!after) return;
    all.coarse_plane = all.fine_plane;
    all.next();
    before = after;
  }
#else
  static_cast<void>(all);
  run_level(like, params);
#endif
}

// Roughness (B,), float32 or float64, the type of the result; keys, seeds and plan as those of noise; channels, and
// height and width of all samples, or of each: then planes are as large as the largest, and 0 beyond their own pixels.
Tensor fractal_noise(Tensor const& roughness, Tensor const& keys, std::optional<Tensor> const& seeds,
                     std::vector<int64_t> const& plan, std::vector<int64_t> const& size) {
  constexpr char const* op = "fractal_noise";
  KV_CHECK(roughness.dim() == 1 && roughness.scalar_type() == compute_dtype(roughness), op,
           ": expected float32 or float64 roughness of shape (B,)");
  int64_t const batch = roughness.size(0);
  bool const is_one = size.size() == 3;
  KV_CHECK((is_one || int64_t(size.size()) == 1 + 2 * batch) && size.size() >= 3 && size[0] >= 0, op,
           ": expected channels, and height and width of all samples, or of each");
  int64_t const channels = size[0];
  int64_t tall = 1, wide = 1;
  for (size_t i = 1; i < size.size(); i += 2) {
    KV_CHECK(size[i] >= 1 && size[i + 1] >= 1, op, ": expected sides of at least 1");
    tall = max(tall, size[i]), wide = max(wide, size[i + 1]);
  }
  int64_t const pixels = ((int64_t(1) << FractalNoise<float>::halvings(tall)) + 1) *
                         ((int64_t(1) << FractalNoise<float>::halvings(wide)) + 1);
  KV_CHECK(pixels <= INT32_MAX / 2 && (roughness.is_cpu() || batch * channels <= 65535), op,
           ": expected at most 2^30 pixels, and on CUDA 65535 planes");
  Tensor const y = empty({batch, channels, tall, wide}, roughness);
  NoiseSource const source{op, y, keys, seeds, plan};
  source.check();
  if (y.numel() == 0) return y;
  auto const run_all = [&]<class T>(Type<T>) {
    FractalNoise<T> params{};
    source.set(params.noise);
    params.roughness = data_ptr<T const>(roughness), params.roughness_stride = roughness.stride(0);
    params.y = data_ptr<T>(y);
    params.batch = batch, params.channels = channels, params.tall = tall, params.wide = wide;
    params.start(tall, wide);
    if (is_one) return run_levels(roughness, batch * channels, params, params);
    for (int64_t first = 0; first < batch; first += kMaxListed) {
      FractalNoiseList<T> list{};
      list.all = params;
      list.all.select(first);
      list.count = int(min(batch - first, int64_t(kMaxListed)));
      for (int b = 0; b < list.count; ++b)
        list.sizes[b] = {int(size[size_t(2 * (first + b) + 1)]), int(size[size_t(2 * (first + b) + 2)])};
      run_levels(roughness, list.count * channels, list, list.all);
    }
  };
  roughness.scalar_type() == ScalarType::Double ? run_all(Type<double>{}) : run_all(Type<float>{});
  return y;
}

}  // namespace

KV_OPERATOR(fractal_noise, "(Tensor roughness, Tensor keys, Tensor? seeds, int[] plan, SymInt[] size) -> Tensor")

}  // namespace kv::augmentation
