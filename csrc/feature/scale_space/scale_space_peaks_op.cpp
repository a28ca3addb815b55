// Peaks of scale spaces: schemas and entries, for CPU and CUDA.
#include "feature/scale_space/scale_space_peaks_glue.h"
#include "glue/batch.h"

namespace kv::feature {
namespace {

// The size of a volume and how to refine, checked.
template <class T>
geometry::ConvQuadInterp3d<T> peak_search(Tensor const& levels, bool differences, int64_t steps, double largest_shift,
                                          int64_t radius, bool along_scale) {
  auto search = refinement<T>(steps, largest_shift, radius, along_scale);
  search.size[0] = int(levels.size(1) - differences);
  search.size[1] = int(levels.size(2)), search.size[2] = int(levels.size(3));
  return search;
}

void check_scale_space(char const* op, Tensor const& levels, bool differences, int64_t steps, int64_t radius) {
  check_images(op, "levels", levels);
  KV_CHECK(levels.size(1) > differences, op, ": expected at least ", differences ? 2 : 1, " levels");
  KV_CHECK(levels.size(1) * levels.size(2) * levels.size(3) <= INT32_MAX, op, ": volumes are too large");
  check_refinement(op, steps, radius);
}

// `x` contiguous with one row for each sample.
Tensor of_each_sample(char const* op, char const* name, Tensor const& x, Tensor const& levels,
                      std::vector<int64_t> const& sizes) {
  bool fits = x.dim() == int64_t(sizes.size()) && (x.size(0) == 1 || x.size(0) == sizes[0]);
  for (size_t i = 1; fits && i < sizes.size(); ++i) fits = x.size(int64_t(i)) == sizes[i];
  KV_CHECK(fits && x.scalar_type() == compute_dtype(levels) && x.device() == levels.device(), op, ": ", name,
           " does not fit the levels");
  return expand_batch(x, sizes[0]);
}

std::tuple<Tensor, Tensor> scale_space_peaks(Tensor const& input, std::optional<Tensor> const& weights,
                                             Tensor const& scales, bool differences, bool minima, int64_t count,
                                             double levels_of_octave, double margin, double edge_ratio,
                                             double threshold, int64_t steps, double largest_shift, int64_t radius,
                                             bool along_scale) {
  constexpr char const* op = "scale_space_peaks";
  check_scale_space(op, input, differences, steps, radius);
  check_peak_count(op, count);
  int64_t const samples = input.size(0), height = input.size(2), width = input.size(3);
  Tensor const levels = dense(input), from = of_each_sample(op, "scales", scales, levels, {samples});
  std::optional<Tensor> allowed;
  if (weights) allowed = of_each_sample(op, "weights", *weights, levels, {samples, height, width});
  Tensor const peaks = empty({samples, count, 4}, levels, Layout::planar, compute_dtype(levels));
  Tensor const voxels = empty({samples, count}, levels, Layout::planar, ScalarType::Long);
  dispatch_floating(op, levels, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    ScaleSpacePeaks<T> params{};
    params.octaves[0] = {data_ptr<T const>(levels), {int(levels.size(1) - differences), int(height), int(width)}};
    params.octave_count = 1;
    params.weights = allowed ? data_ptr<F const>(*allowed) : nullptr;
    params.scales = data_ptr<F const>(from);
    params.peaks = data_ptr<F>(peaks), params.voxels = data_ptr<int64_t>(voxels);
    params.search = refinement<T>(steps, largest_shift, radius, along_scale);
    params.samples = samples, params.count = count;
    params.differences = differences, params.minima = minima;
    params.levels_of_octave = F(levels_of_octave), params.margin = F(margin);
    params.edge_ratio = F(edge_ratio), params.threshold = F(threshold);
    run_scale_space_peaks(levels, params);
  });
  return {peaks, voxels};
}

Tensor scale_space_peaks_backward(Tensor const& grad, Tensor const& input, Tensor const& voxels, bool differences,
                                  int64_t steps, double largest_shift, int64_t radius, bool along_scale) {
  constexpr char const* op = "scale_space_peaks_backward";
  check_scale_space(op, input, differences, steps, radius);
  KV_CHECK(grad.dim() == 3, op, ": expected grad of shape (B, N, 4)");
  int64_t const samples = grad.size(0), count = grad.size(1);
  check_sizes(op, "input", input, input, {samples, input.size(1), input.size(2), input.size(3)});
  Tensor const levels = expand_batch(input, samples);
  Tensor const to_peaks = of_each_sample(op, "grad", grad, levels, {samples, count, 4});
  KV_CHECK(voxels.dim() == 2 && voxels.size(1) == count && voxels.scalar_type() == ScalarType::Long, op,
           ": voxels do not fit the gradients");
  check_sizes(op, "voxels", voxels, voxels, {samples, count});
  Tensor const at = expand_batch(voxels, samples);
  Tensor const grad_levels =
      empty({samples, levels.size(1), levels.size(2), levels.size(3)}, levels, Layout::planar, compute_dtype(levels));
  dispatch_floating(op, levels, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    ScaleSpacePeaksBackward<T> const params{
        data_ptr<F const>(to_peaks),
        data_ptr<T const>(levels),
        data_ptr<int64_t const>(at),
        data_ptr<F>(grad_levels),
        peak_search<T>(levels, differences, steps, largest_shift, radius, along_scale),
        samples,
        count,
        differences};
    KV_RUN(scale_space_peaks_backward, levels, params, samples, levels.size(1) * levels.size(2) * levels.size(3));
  });
  return grad_levels;
}

}  // namespace

#define KV_REFINEMENT "int steps, float largest_shift, int radius, bool along_scale"

// Levels (B, L, H, W), weights (B, H, W) and scales (B,) to peaks (B, N, 4), which are level, x, y and value, and
// voxels (B, N). On the CPU only.
KV_OPERATOR(scale_space_peaks,
            "(Tensor levels, Tensor? weights, Tensor scales, bool differences, bool minima, int count, "
            "float levels_of_octave, float margin, float edge_ratio, float threshold, " KV_REFINEMENT
            ") -> (Tensor, Tensor)")
KV_OPERATOR(scale_space_peaks_backward,
            "(Tensor grad, Tensor levels, Tensor voxels, bool differences, " KV_REFINEMENT ") -> Tensor")

#undef KV_REFINEMENT

}  // namespace kv::feature
