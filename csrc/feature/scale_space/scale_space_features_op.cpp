// The strongest features of images in one call: their scale space, its response, and the peaks of all octaves. Schema
// and entry, for CPU and CUDA.
#include "feature/scale_space/hessian.h"
#include "feature/scale_space/scale_space_peaks_glue.h"
#include "geometry/transform/pyramid_glue.h"

namespace kv::feature {
namespace {

// How many images have their levels in memory at once. On the CPU they are one for every few threads, which share it
// well: levels that are written again are in memory that the system has cleared, and partly in caches.
int64_t images_at_once(int64_t batch) {
#if defined(KV_CUDA)
  return batch;
#else
  constexpr int64_t kThreadsOfImage = 4;
  return min(batch, ceil_div(torch::stable::get_num_threads(), kThreadsOfImage));
#endif
}

// The levels (B, L, H, W) of each octave of images (B, 1, H, W). The first level of the first octave is the image,
// resized to the size of the octave and blurred. That of other octaves is level `next` of the previous octave, resized.
// Each following level is a blur of the level before it.
struct ScaleSpace {
  std::vector<Tensor> octaves;

  ScaleSpace(Tensor const& like, int64_t batch, int64_t levels, std::vector<int64_t> const& sizes) {
    for (size_t o = 0; 2 * o < sizes.size(); ++o)
      octaves.push_back(empty({batch, levels, sizes[2 * o], sizes[2 * o + 1]}, like));
  }

  // Computes the levels of the images `source`, at most B.
  template <class T>
  void build(char const* op, Tensor const& like, Planes<T const> source, std::vector<int64_t> const& windows,
             std::vector<double> const& sigmas, int64_t next) const {
    int64_t const batch = source.count(), levels = int64_t(sigmas.size());
    for (size_t o = 0; o < octaves.size(); ++o) {
      int64_t const h = octaves[o].size(2),
                    w = octaves[o].size(3), *const window = windows.data() + int64_t(o) * levels;
      T* const data = data_ptr<T>(octaves[o]);
      auto const level = [&](int64_t l) { return planes_of_level(data, batch, levels, l, h, w); };
      auto const level_to_read = [&](int64_t l) { return planes_of_level<T const>(data, batch, levels, l, h, w); };
      // If the first level is resized and blurred, the second one, which is not written yet, holds what is resized.
      bool const is_blurred = window[0] > 0, is_resized = h != source.height || w != source.width;
      Planes<T> const first = level(is_blurred && is_resized ? 1 : 0);
      if (is_resized || !is_blurred)
        geometry::resize_planes(like, source, first, geometry::ResizeFilter::bilinear, true);
      if (is_blurred)
        filters::blur_planes(op, like, is_resized ? level_to_read(1) : source, level(0), window[0], sigmas[0]);
      for (int64_t l = 1; l < levels; ++l)
        filters::blur_planes(op, like, level_to_read(l - 1), level(l), window[l], sigmas[size_t(l)]);
      source = level_to_read(next);
    }
  }
};

// Computes the responses of the levels (B, L, H, W) of an octave, which have these blurs, of the first `batch` images.
template <class T>
void hessian_responses(Tensor const& octave, Tensor const& response, int64_t batch, std::vector<double> const& blurs,
                       bool sobel) {
  using F = Compute<T>;
  int64_t const levels = octave.size(1), planes = batch * levels, h = octave.size(2), w = octave.size(3);
  Planes<T const> const x = adjacent_planes(data_ptr<T const>(octave), planes, h, w);
  Planes<T> const y = adjacent_planes(data_ptr<T>(response), planes, h, w);
#if defined(KV_CUDA)
  LevelHessian<T> params{x, y, sobel, {}, int(levels), {}};
  for (int64_t l = 0; l < levels; ++l) {
    F const square = F(blurs[size_t(l)]) * F(blurs[size_t(l)]);
    params.factors[l] = square * square;
  }
  KV_RUN(level_hessian, octave, params, planes * h, 0);
#else
  std::vector<F> sigmas;  // of all planes
  for (int64_t p = 0; p < planes; ++p) sigmas.push_back(F(blurs[size_t(p % levels)]));
  Response<T> const params{x, y, {{nullptr, 0, 0}, {sigmas.data(), 1, 0}, 1, CornerKind::harris, sobel}};
  KV_RUN(hessian_response, octave, params, planes * h, 3 * w);
#endif
}

std::tuple<Tensor, Tensor> scale_space_features(Tensor const& input, std::vector<int64_t> sizes,
                                                std::vector<int64_t> windows, std::vector<double> sigmas, int64_t next,
                                                std::vector<double> blurs, int64_t mode, bool minima, int64_t count,
                                                double scale, double levels_of_octave, double margin, double edge_ratio,
                                                double threshold, int64_t steps, double largest_shift, int64_t radius,
                                                bool along_scale) {
  constexpr char const* op = "scale_space_features";
  check_images(op, "input", input);
  int64_t const octaves = int64_t(sizes.size() / 2), levels = int64_t(sigmas.size());
  bool const differences = mode < 0;
  KV_CHECK(input.size(1) == 1, op, ": expected images of one channel");
  KV_CHECK(octaves > 0 && octaves <= kMaxOctaves && sizes.size() % 2 == 0, op, ": expected the sizes of 1 to ",
           kMaxOctaves, " octaves");
  KV_CHECK(levels > 1 && levels <= kMaxScales && int64_t(windows.size()) == octaves * levels && next >= 0 &&
               next < levels && (differences || int64_t(blurs.size()) == levels),
           op, ": expected windows and sigmas of 2 to ", kMaxScales, " levels");
  KV_CHECK(mode <= 1, op, ": mode must be -1 (differences), 0 (sobel) or 1 (diff), got ", mode);
  for (int64_t size : sizes)
    KV_CHECK(size > 0 && size < 1 << 30, op, ": expected sizes of 1 to 2^30 pixels, got ", size);
  check_refinement(op, steps, radius);
  check_peak_count(op, count);
  Tensor const image = dense(input);
  int64_t const batch = image.size(0);
  ScalarType const computes = compute_dtype(image);
  Tensor const frames = empty({batch, count, 2, 3}, image, Layout::planar, computes);
  Tensor const scores = empty({batch, count}, image, Layout::planar, computes);
  dispatch_floating(op, image, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    int64_t const images_at_a_time = images_at_once(batch), height = image.size(2), width = image.size(3);
    ScaleSpace const space(image, images_at_a_time, levels, sizes);
    std::vector<Tensor> responses;
    ScaleSpacePeaks<T> params{};
    for (int64_t o = 0; o < octaves; ++o) {
      Tensor const& octave = space.octaves[size_t(o)];
      int64_t const h = octave.size(2), w = octave.size(3);
      Tensor const& response = differences ? octave : responses.emplace_back(empty(octave.sizes(), octave));
      // The centers of the corner pixels of an octave and of the image coincide.
      auto const step = [](int64_t image_side, int64_t side) {
        return side > 1 ? F(double(image_side - 1) / double(side - 1)) : F(1);
      };
      params.octaves[o] = {data_ptr<T const>(response),
                           {int(levels - differences), int(h), int(w)},
                           0,
                           0,
                           step(width, w),
                           step(height, h)};
    }
    params.octave_count = int(octaves);
    params.pixels = height * width;
    params.search = refinement<T>(steps, largest_shift, radius, along_scale);
    params.count = count, params.scale = F(scale);
    params.differences = differences, params.minima = minima;
    params.levels_of_octave = F(levels_of_octave), params.margin = F(margin);
    params.edge_ratio = F(edge_ratio), params.threshold = F(threshold);
    for (int64_t first = 0; first < batch; first += images_at_a_time) {
      params.samples = min(images_at_a_time, batch - first);
      params.images = data_ptr<T const>(image) + first * params.pixels;
      params.frames = data_ptr<F>(frames) + first * count * 6, params.scores = data_ptr<F>(scores) + first * count;
      space.build(op, image, adjacent_planes(params.images, params.samples, height, width), windows, sigmas, next);
      for (size_t o = 0; o < responses.size(); ++o)
        hessian_responses<T>(space.octaves[o], responses[o], params.samples, blurs, mode == 0);
      run_scale_space_peaks(image, params);
    }
  });
  return {frames, scores};
}

}  // namespace

// Images (B, 1, H, W) to the frames (B, N, 2, 3) and scores (B, N) of the strongest peaks of their scale space.
KV_OPERATOR(
    scale_space_features,
    "(Tensor input, int[] sizes, int[] windows, float[] sigmas, int next, float[] blurs, int mode, bool minima, "
    "int count, float scale, float levels_of_octave, float margin, float edge_ratio, float threshold, "
    "int steps, float largest_shift, int radius, bool along_scale) -> (Tensor, Tensor)")

}  // namespace kv::feature
