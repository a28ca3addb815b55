// Structural similarity: schemas and entries, for CPU and CUDA.
#include <limits>

#include "core/row_sums.h"
#include "glue/glue.h"
#include "ssim.h"

namespace kv::metrics {
namespace {

// The weights of the window, in the computing type.
template <class F>
std::vector<F> gaussian_window(int64_t size, double sigma) {
  std::vector<double> weights(size);
  double sum = 0;
  for (int64_t t = 0; t < size; ++t) {
    double const d = double(t - size / 2) / sigma;
    sum += weights[t] = __builtin_exp(-d * d / 2);
  }
  std::vector<F> rounded(size);
  for (int64_t t = 0; t < size; ++t) rounded[t] = F(weights[t] / sum);
  return rounded;
}

// The window around the pixels of images (B, C, H, W), or the voxels of volumes (B, C, D, H, W).
struct Window {
  int64_t size;
  double sigma;
  bool valid;
  Border border;

  Window(char const* op, Tensor const& x, int64_t size, double sigma, int64_t padding)
      : size(size),
        sigma(sigma),
        valid(SsimPadding(padding) == SsimPadding::valid),
        border(SsimPadding(padding) == SsimPadding::reflect ? Border::reflect : Border::constant) {
    KV_CHECK(padding >= 0 && padding <= 2, op, ": padding must be one of 0 (reflect), 1 (constant), 2 (valid); got ",
             padding);
    check_window(op, size, size);
    KV_CHECK(size % 2 == 1 && sigma > 0, op, ": expected an odd size and a sigma above 0");
    for (int64_t axis = 2; axis < x.dim(); ++axis) {
      KV_CHECK(!valid || x.size(axis) >= size, op, ": the window is larger than the images");
      check_border(op, border, size / 2, x.size(axis));
    }
  }
  int64_t less() const { return valid ? size - 1 : 0; }
  // The shape of the similarity of x.
  std::vector<int64_t> sizes(Tensor const& x) const {
    std::vector<int64_t> result;
    for (int64_t axis = 0; axis < x.dim(); ++axis) result.push_back(x.size(axis) - (axis < 2 ? 0 : less()));
    return result;
  }
};

// A batch of size 1 in `other` is broadcast.
void check_pair(char const* op, Tensor const& x, Tensor const& y) {
  if (x.dim() == 5)
    check_volumes(op, "input", x);
  else
    check_images(op, "input", x);
  bool same = y.dim() == x.dim() && x.scalar_type() == y.scalar_type() && x.device() == y.device();
  for (int64_t i = 0; same && i < x.dim(); ++i) same = y.size(i) == x.size(i) || (i == 0 && y.size(0) == 1);
  KV_CHECK(same, op, ": other differs in shape, dtype or device from input");
}

Layout common_layout(Tensor const& x) { return x.dim() == 5 ? Layout::planar : layout_of(x); }
Tensor conformed(Tensor const& x, Layout layout) { return x.dim() == 5 ? dense(x) : as_layout(x, layout); }

// The planes of images or of stacked volumes. A batch of size 1 is broadcast.
template <class T>
Planes<T> planes_for(Tensor const& y, int64_t batch, Layout layout) {
  if (y.dim() == 4 && y.size(0) == batch) return planes<T>(y, layout);
  if (y.dim() == 4) {
    Planes<T> p = planes<T>(y, layout);
    bool const planar = layout == Layout::planar;
    p.outer = batch, p.outer_stride = 0;
    p.inner = planar ? y.size(1) : 1, p.inner_stride = planar ? y.stride(1) : 0;
    return p;
  }
  Planes<T> p = stacked_planes<T>(y);
  if (y.size(0) == batch) return p;
  return {p.data, batch, y.size(1) * y.size(2), 0, p.outer_stride, p.row_stride, p.height, p.width, 1};
}

struct Constants {
  double c1, c2, eps;
  bool luminance;
};

template <class T>
SsimImages<T> images(Tensor const& x, Tensor const& y, Layout layout, Window const& window, Compute<T> const* weights,
                     Constants const& c) {
  using F = Compute<T>;
  return {planes_for<T const>(x, x.size(0), layout),
          planes_for<T const>(y, x.size(0), layout),
          weights,
          window.sigma,
          int(window.size),
          x.dim() == 5,
          x.dim() == 5 ? x.size(2) : 1,
          window.border,
          window.valid,
          {F(c.luminance ? c.c1 : 1.0), F(c.c2), F(c.eps), F(c.luminance)}};
}

Tensor ssim(Tensor const& input, Tensor const& other, int64_t size, double sigma, double c1, double c2, double eps,
            int64_t padding, bool luminance) {
  check_pair("ssim", input, other);
  Window const window("ssim", input, size, sigma, padding);
  Layout const layout = common_layout(input);
  Tensor const x = conformed(input, layout), y = conformed(other, layout);
  Tensor const similarity = empty(window.sizes(x), x, layout);
  dispatch_floating("ssim", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const weights = gaussian_window<F>(size, sigma);
    Ssim<T> const params{images<T>(x, y, layout, window, weights.data(), {c1, c2, eps, luminance}),
                         planes_for<T>(similarity, x.size(0), layout),
                         {},
                         nullptr,
                         nullptr};
    KV_RUN(ssim, x, params, params.similarity.rows(), size * params.similarity.row_size());
  });
  return similarity;
}

// Checks a tensor with one number per sample of planar images.
Tensor ssim_loss(Tensor const& input, Tensor const& other, int64_t size, double sigma, double c1, double c2, double eps,
                 int64_t padding, double structure, double absolute) {
  constexpr char const* op = "ssim_loss";
  check_pair(op, input, other);
  Window const window(op, input, size, sigma, padding);
  KV_CHECK(absolute == 0 || !window.valid, op, ": absolute differences go with windows around all pixels");
  Tensor const x = conformed(input, Layout::planar), y = conformed(other, Layout::planar);
  int64_t const rows = x.size(0), channels = x.size(1);
  Tensor const sums = empty({rows}, x, Layout::planar, compute_dtype(x));
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const weights = gaussian_window<F>(size, sigma);
    Planes<T> nothing = planes_for<T>(x, rows, Layout::planar);
    nothing.data = nullptr;
    nothing.height -= window.less(), nothing.width -= window.less();
    Ssim<T> params{images<T>(x, y, Layout::planar, window, weights.data(), {c1, c2, eps, true}),
                   nothing,
                   {F(structure), F(absolute), channels},
                   nullptr,
                   data_ptr<F>(sums)};
#if defined(KV_CUDA)
    int64_t const chunks = channels * max_ssim_chunks(params.images);
#else
    int64_t const chunks = channels * params.images.slices() * nothing.height;
#endif
    Tensor const partial = empty({rows, chunks}, x, Layout::planar, compute_dtype(x));
    params.partial = data_ptr<F>(partial);
    KV_RUN(ssim, x, params, rows * channels * params.images.slices() * nothing.height, size * nothing.row_size());
#if defined(KV_CUDA)
    if (channels == 0) torch::stable::zero_(const_cast<Tensor&>(sums));
#else
    add_chunks(params.partial, rows, chunks, FinalizeSum<F>{F(1), F(0)}, params.sums);
#endif
  });
  return sums;
}

// The size of the gradient's working memory, of which a pixel of the similarity of x needs `each` elements. It is at
// most the size of x, unless that is small or below the minimum: one volume, or for tiles some rows of an image.
template <class T>
[[maybe_unused]] int64_t room_for(Tensor const& x, Window const& window, SsimImages<T> const& images, int64_t each) {
  constexpr int64_t little = 1 << 25, number = sizeof(Compute<T>);
  auto const sizes = window.sizes(x);
  int64_t const rows = sizes[sizes.size() - 2];
  int64_t all = each, minimum = each * sizes.back() * (has_ssim_tiles(images) ? min(rows, window.size + 64) : rows);
  if (x.dim() == 5) minimum *= sizes[2];
  for (int64_t const n : sizes) all *= n;
  return min(max(max(little, x.numel() * int64_t(sizeof(T))) / number, minimum), max(all, int64_t(1)));
}

// The gradient of the first image, and with `grad_other` also of the second one: from the gradient of the similarity,
// or from the gradients of the samples' losses.
Tensor gradients(char const* op, Tensor const& grad, Tensor const& input, Tensor const& other, Tensor* grad_other,
                 int64_t size, double sigma, Constants const& c, int64_t padding,
                 std::optional<SsimLoss<double>> const& loss = {}) {
  check_pair(op, input, other);
  Window const window(op, input, size, sigma, padding);
  if (loss) {
    KV_CHECK(grad.dim() == 1 && grad.size(0) == input.size(0) && grad.scalar_type() == compute_dtype(input) &&
                 grad.device() == input.device(),
             op, ": expected grad to be that of the losses");
    KV_CHECK(loss->absolute == 0 || !window.valid, op, ": absolute differences go with windows around all pixels");
  } else {
    bool fits =
        grad.dim() == input.dim() && grad.scalar_type() == input.scalar_type() && grad.device() == input.device();
    for (int64_t i = 0; fits && i < input.dim(); ++i) fits = grad.size(i) == window.sizes(input)[i];
    KV_CHECK(fits, op, ": grad differs in shape, dtype or device from the similarity");
  }
  Layout const layout = loss ? Layout::planar : common_layout(input);
  Tensor const x = conformed(input, layout), y = conformed(other, layout);
  Tensor const g = loss ? dense(grad) : conformed(grad, layout);
  auto const like_x = [&] {
    std::vector<int64_t> sizes;
    for (int64_t axis = 0; axis < x.dim(); ++axis) sizes.push_back(x.size(axis));
    return empty(sizes, x, layout);
  };
  Tensor const grad_x = like_x();
  if (grad_other) *grad_other = like_x();
  int64_t const batch = x.size(0);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const weights = gaussian_window<F>(size, sigma);
    Planes<T> grad_y = planes_for<T>(grad_other ? *grad_other : grad_x, batch, layout);
    if (!grad_other) grad_y.data = nullptr;
    SsimBackward<T> params{images<T>(x, y, layout, window, weights.data(), c),
                           planes_for<T const>(loss ? x : g, batch, layout),
                           planes_for<T>(grad_x, batch, layout),
                           grad_y,
                           {},
                           nullptr,
                           nullptr,
                           0};
    if (loss) {
      params.grad.data = nullptr;
      params.grad.height -= window.less(), params.grad.width -= window.less();
      params.loss = {F(loss->structure), F(loss->absolute), x.size(1)};
      params.of_loss = data_ptr<F>(g);
    }
#if defined(KV_CUDA)
    std::optional<Tensor> derivatives;
    if (!has_ssim_strips(params.images, params.grad_y.data ? 2 : 1)) {
      params.room = room_for(x, window, params.images, 4);
      derivatives = empty({params.room}, x, Layout::planar, compute_dtype(x));
      params.derivatives = data_ptr<F>(*derivatives);
    }
#endif
    int64_t const chunks = params.images.volumes ? grad_x.size(3) : 1;  // tasks of the CPU, in rows
    KV_RUN(ssim_backward, x, params, params.grad_x.rows() / chunks, 2 * size * params.grad_x.row_size() * chunks);
  });
  return grad_x;
}

// Windows of several scales. All but the last one are trimmed to the weights that matter in type F.
template <class F>
struct Scales {
  std::vector<std::vector<F>> weights;
  SsimScales<F> result{};

  Scales(char const* op, int64_t size, std::vector<double> const& sigmas) {
    int64_t all = 0;
    KV_CHECK(!sigmas.empty() && sigmas.size() <= kMaxSsimScales, op, ": expected 1 to ", kMaxSsimScales, " sigmas");
    for (double const sigma : sigmas) {
      bool const last = weights.size() + 1 == sigmas.size();
      KV_CHECK(sigma > 0, op, ": expected sigmas above 0");
      std::vector<F> window = gaussian_window<F>(size, sigma);
      int64_t adjacent = size / 2;
      while (!last && adjacent > 0 &&
             window[size / 2 + adjacent] < window[size / 2] * std::numeric_limits<F>::epsilon() / 16)
        --adjacent;
      all += 2 * adjacent + 1;
      weights.emplace_back(window.begin() + (size / 2 - adjacent), window.begin() + (size / 2 + adjacent + 1));
    }
    KV_CHECK(all <= kMaxSsimWeights, op, ": the windows are too large");
    for (auto const& window : weights) {
      result.sizes[result.count] = int(window.size());
      result.weights[result.count++] = window.data();
    }
  }
};

Window ms_window(char const* op, Tensor const& x, Tensor const& y, int64_t size, std::vector<double> const& sigmas) {
  check_images(op, "input", x);
  check_pair(op, x, y);
  return Window(op, x, size, sigmas.empty() ? 0 : sigmas.back(), int64_t(SsimPadding::constant));
}

// The loss (B, H, W), the mean over the channels.
Tensor ms_ssim(Tensor const& input, Tensor const& other, std::vector<double> const& sigmas, int64_t size, double c1,
               double c2, double structure, double absolute) {
  constexpr char const* op = "ms_ssim";
  Window const window = ms_window(op, input, other, size, sigmas);
  Tensor const x = conformed(input, Layout::planar), y = conformed(other, Layout::planar);
  int64_t const channels = x.size(1), rows = x.size(0) * x.size(2);
  Tensor const map = empty({x.size(0), x.size(2), x.size(3)}, x, Layout::planar, compute_dtype(x));
  KV_CHECK(channels > 0, op, ": expected input with at least one channel");
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Scales<F> const scales(op, size, sigmas);
    MsSsim<T> const params{images<T>(x, y, Layout::planar, window, scales.weights.back().data(), {c1, c2, 0, true}),
                           scales.result,
                           {F(structure / channels), F(absolute / channels), channels},
                           data_ptr<F>(map)};
#if defined(KV_CUDA)
    KV_CHECK(has_ssim_tiles(params.images), op, ": the images are too large");
#endif
    KV_RUN(ms_ssim, x, params, rows, channels * 4 * size * x.size(3));
  });
  return map;
}

Tensor ms_ssim_gradients(char const* op, Tensor const& grad, Tensor const& input, Tensor const& other,
                         Tensor* grad_other, std::vector<double> const& sigmas, int64_t size, double c1, double c2,
                         double structure, double absolute) {
  Window const window = ms_window(op, input, other, size, sigmas);
  bool const fits = grad.dim() == 3 && grad.size(0) == input.size(0) && grad.size(1) == input.size(2) &&
                    grad.size(2) == input.size(3) && grad.scalar_type() == compute_dtype(input) &&
                    grad.device() == input.device();
  KV_CHECK(fits, op, ": expected grad to be that of the map");
  Tensor const x = conformed(input, Layout::planar), y = conformed(other, Layout::planar), g = dense(grad);
  std::vector<int64_t> const sizes{x.size(0), x.size(1), x.size(2), x.size(3)};
  Tensor const grad_x = empty(sizes, x);
  if (grad_other) *grad_other = empty(sizes, x);
  int64_t const batch = x.size(0), channels = x.size(1);
  KV_CHECK(channels > 0, op, ": expected input with at least one channel");
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Scales<F> const scales(op, size, sigmas);
    Planes<T> grad_y = planes_for<T>(grad_other ? *grad_other : grad_x, batch, Layout::planar);
    if (!grad_other) grad_y.data = nullptr;
    MsSsimBackward<T> params{images<T>(x, y, Layout::planar, window, scales.weights.back().data(), {c1, c2, 0, true}),
                             scales.result,
                             {F(structure / channels), F(absolute / channels), channels},
                             data_ptr<F>(g),
                             planes_for<T>(grad_x, batch, Layout::planar),
                             grad_y,
                             nullptr,
                             0};
#if defined(KV_CUDA)
    KV_CHECK(has_ssim_tiles(params.images), op, ": the images are too large");
    params.room = room_for(x, window, params.images, 5 * scales.result.count);
    Tensor const derivatives = empty({params.room}, x, Layout::planar, compute_dtype(x));
    params.derivatives = data_ptr<F>(derivatives);
#endif
    KV_RUN(ms_ssim_backward, x, params, params.grad_x.rows(), 8 * size * x.size(3));
  });
  return grad_x;
}

Tensor ms_ssim_backward(Tensor const& grad, Tensor const& input, Tensor const& other, std::vector<double> const& sigmas,
                        int64_t size, double c1, double c2, double structure, double absolute) {
  return ms_ssim_gradients("ms_ssim_backward", grad, input, other, nullptr, sigmas, size, c1, c2, structure, absolute);
}

std::tuple<Tensor, Tensor> ms_ssim_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                                 std::vector<double> const& sigmas, int64_t size, double c1, double c2,
                                                 double structure, double absolute) {
  Tensor grad_y = input;  // replaced
  Tensor const grad_x = ms_ssim_gradients("ms_ssim_backward_both", grad, input, other, &grad_y, sigmas, size, c1, c2,
                                          structure, absolute);
  return {grad_x, grad_y};
}

Tensor ssim_backward(Tensor const& grad, Tensor const& input, Tensor const& other, int64_t size, double sigma,
                     double c1, double c2, double eps, int64_t padding, bool luminance) {
  return gradients("ssim_backward", grad, input, other, nullptr, size, sigma, {c1, c2, eps, luminance}, padding);
}

std::tuple<Tensor, Tensor> ssim_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                              int64_t size, double sigma, double c1, double c2, double eps,
                                              int64_t padding, bool luminance) {
  Tensor grad_y = input;  // replaced
  Tensor const grad_x =
      gradients("ssim_backward_both", grad, input, other, &grad_y, size, sigma, {c1, c2, eps, luminance}, padding);
  return {grad_x, grad_y};
}

Tensor ssim_loss_backward(Tensor const& grad, Tensor const& input, Tensor const& other, int64_t size, double sigma,
                          double c1, double c2, double eps, int64_t padding, double structure, double absolute) {
  return gradients("ssim_loss_backward", grad, input, other, nullptr, size, sigma, {c1, c2, eps, true}, padding,
                   SsimLoss<double>{structure, absolute, 0});
}

std::tuple<Tensor, Tensor> ssim_loss_backward_both(Tensor const& grad, Tensor const& input, Tensor const& other,
                                                   int64_t size, double sigma, double c1, double c2, double eps,
                                                   int64_t padding, double structure, double absolute) {
  Tensor grad_y = input;  // replaced
  Tensor const grad_x = gradients("ssim_loss_backward_both", grad, input, other, &grad_y, size, sigma,
                                  {c1, c2, eps, true}, padding, SsimLoss<double>{structure, absolute, 0});
  return {grad_x, grad_y};
}

}  // namespace

KV_OPERATOR(ssim,
            "(Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, int padding, "
            "bool luminance) -> Tensor")
KV_OPERATOR(ssim_backward,
            "(Tensor grad, Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, "
            "int padding, bool luminance) -> Tensor")
KV_OPERATOR(ssim_backward_both,
            "(Tensor grad, Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, "
            "int padding, bool luminance) -> (Tensor grad_input, Tensor grad_other)")

KV_OPERATOR(ssim_loss,
            "(Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, int padding, "
            "float structure, float absolute) -> Tensor")
KV_OPERATOR(ssim_loss_backward,
            "(Tensor grad, Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, "
            "int padding, float structure, float absolute) -> Tensor")
KV_OPERATOR(ssim_loss_backward_both,
            "(Tensor grad, Tensor input, Tensor other, int size, float sigma, float c1, float c2, float eps, "
            "int padding, float structure, float absolute) -> (Tensor grad_input, Tensor grad_other)")

KV_OPERATOR(ms_ssim,
            "(Tensor input, Tensor other, float[] sigmas, int size, float c1, float c2, float structure, "
            "float absolute) -> Tensor")
KV_OPERATOR(ms_ssim_backward,
            "(Tensor grad, Tensor input, Tensor other, float[] sigmas, int size, float c1, float c2, float structure, "
            "float absolute) -> Tensor")
KV_OPERATOR(ms_ssim_backward_both,
            "(Tensor grad, Tensor input, Tensor other, float[] sigmas, int size, float c1, float c2, float structure, "
            "float absolute) -> (Tensor grad_input, Tensor grad_other)")

}  // namespace kv::metrics
