// Filters of lists of images of different sizes, whose results have the sizes of the images: schemas and entries, for
// CPU and CUDA.
#include "augmentation/lists/list_steps.h"
#include "augmentation/lists/listed_images.h"
#include "augmentation/noise_glue.h"
#include "enhance/plane_views.h"
#include "enhance/sharpness.h"
#include "filters/filter2d.h"
#include "filters/separable_glue.h"
#include "filters/smoothing/box_glue.h"
#include "filters/smoothing/median.h"

namespace kv::filters {
namespace {

// Run over the items of a table; `like` is on its device, and an item touches about `cost` elements.
template <class T>
void run([[maybe_unused]] Tensor const& like, SeparableList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(separable_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, Filter2dList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(filter2d_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, BoxList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(box_list, like, p, p.list.items, cost);
}
template <class T>
void run_backward([[maybe_unused]] Tensor const& like, BoxList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(box_list_backward, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, MedianBlurList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(median_blur_list, like, p, p.list.items, cost);
}

template <class T>
void run_backward([[maybe_unused]] Tensor const& like, MedianBlurBackwardList<T> const& p,
                  [[maybe_unused]] int64_t cost) {
  KV_RUN(median_blur_list_backward, like, p, p.items, cost);
}

}  // namespace
}  // namespace kv::filters

namespace kv::enhance {
namespace {

template <class T>
void run([[maybe_unused]] Tensor const& like, SharpnessList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(sharpness_list, like, p, p.list.items, cost);
}
template <class T>
void run([[maybe_unused]] Tensor const& like, SharpnessBackwardList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(sharpness_list_backward, like, p, p.items, cost);
}

}  // namespace
}  // namespace kv::enhance

namespace kv::augmentation {
namespace {

// Windows and sigma as those of gaussian_blur2d.
Tensors gaussian_list(char const* op, Tensors const& images, OptionalTensor const& chosen, OptionalTensor const& sigma,
                      int64_t ky, int64_t kx, double sigma_y, double sigma_x, int64_t border_number, bool transposed,
                      bool in_block = false) {
  ListedImages const list(op, images, chosen, false, in_block);
  Tensor const& like = list.like();
  filters::check_sigma(op, sigma, like);
  Border const border = to_border(op, border_number);
  list.check_window_fits(border, ky, kx);
#if defined(KV_CUDA)
  filters::check_taps(op, ky, kx);
#endif
  Tensor const* const tensor = sigma ? &*sigma : nullptr;
  filters::AxisWeights const weights_x{tensor, kx, true, 1, sigma_x}, weights_y{tensor, ky, true, 0, sigma_y};
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    auto const all = filters::separable_of<T>(weights_x, weights_y, border, true, transposed, list.planes());
    list.filter<filters::SeparableList<T>>(all, ceil_div(kx + ky, 4),
                                           [&](auto const& p, int64_t cost) { filters::run(like, p, cost); });
  });
  return list.kept.results;
}

Tensors gaussian_blur2d_list(Tensors const& images, OptionalTensor const& chosen, OptionalTensor const& sigma,
                             int64_t ky, int64_t kx, double sigma_y, double sigma_x, int64_t border) {
  return gaussian_list("gaussian_blur2d_list", images, chosen, sigma, ky, kx, sigma_y, sigma_x, border, false);
}
Tensors gaussian_blur2d_backward_list(Tensors const& grads, OptionalTensor const& chosen, OptionalTensor const& sigma,
                                      int64_t ky, int64_t kx, double sigma_y, double sigma_x, int64_t border) {
  return gaussian_list("gaussian_blur2d_backward_list", grads, chosen, sigma, ky, kx, sigma_y, sigma_x, border, true);
}

template <bool kTranspose>
Tensors box_list(char const* op, Tensors const& images, OptionalTensor const& chosen, int64_t ky, int64_t kx,
                 int64_t border_number) {
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  Border const border = to_border(op, border_number);
  list.check_window_fits(border, ky, kx);
  auto const filter = [&]<class T>(Type<T>) {
    using F = Compute<T>;
    filters::Box<T> const all{{}, {}, ky, kx, border, 0, F(double(ky) * double(kx))};
    list.filter<filters::BoxList<T>>(all, 1, [&](auto const& p, int64_t cost) {
      if constexpr (kTranspose)
        filters::run_backward(like, p, cost);
      else
        filters::run(like, p, cost);
    });
  };
  if constexpr (kTranspose)
    dispatch_floating(op, like, filter);
  else
    dispatch_floating_and_uint8(op, like, filter);
  return list.kept.results;
}

Tensors box_blur_list(Tensors const& images, OptionalTensor const& chosen, int64_t ky, int64_t kx, int64_t border) {
  return box_list<false>("box_blur_list", images, chosen, ky, kx, border);
}
Tensors box_blur_backward_list(Tensors const& grads, OptionalTensor const& chosen, int64_t ky, int64_t kx,
                               int64_t border) {
  return box_list<true>("box_blur_backward_list", grads, chosen, ky, kx, border);
}

// Kernels (B or 1, y, x) of the type that is computed in.
Tensors filter_list(char const* op, Tensors const& images, OptionalTensor const& chosen, Tensor const& kernel,
                    int64_t border_number, bool same, bool transposed, bool clamps = false) {
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  KV_CHECK(same, op, ": expected results of the sizes of the images");
  KV_CHECK(kernel.dim() == 3 && (kernel.size(0) == 1 || kernel.size(0) == like.size(0)) &&
               kernel.scalar_type() == compute_dtype(like) && kernel.device() == like.device(),
           op,
           ": expected kernel of shape (B or 1, y, x), of the type that is computed in, on the device of the images");
  Border const border = to_border(op, border_number);
  int64_t const ky = kernel.size(1), kx = kernel.size(2);
  list.check_window_fits(border, ky, kx);
  Tensor const weights = dense(kernel);
  bool const accumulates = transposed && border != Border::circular;
  auto const axis = [&](int64_t size) {
    return filters::KernelAxis{int(size), int(transposed ? size / 2 : (size - 1) / 2)};
  };
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    filters::Filter2d<T> all{};
    all.kernel = data_ptr<Compute<T> const>(weights);
    all.kernel_stride = kernel.size(0) == 1 ? 0 : ky * kx;
    all.sample_planes = list.planes();
    all.depth = 1;
    all.axis_z = {1, 0}, all.axis_y = axis(ky), all.axis_x = axis(kx);
    all.flip = transposed;
    all.border = accumulates ? Border::constant : border;
    all.accumulation = accumulates ? border : Border::constant;
    all.clamps = clamps && sizeof(T) > 1;
    list.filter<filters::Filter2dList<T>>(all, 1 + ky * kx / 4,
                                          [&](auto const& p, int64_t cost) { filters::run(like, p, cost); });
  });
  return list.kept.results;
}

Tensors filter2d_list(Tensors const& images, OptionalTensor const& chosen, Tensor const& kernel, int64_t border,
                      bool same) {
  return filter_list("filter2d_list", images, chosen, kernel, border, same, false);
}
Tensors filter2d_clamped_list(Tensors const& images, OptionalTensor const& chosen, Tensor const& kernel,
                              int64_t border) {
  return filter_list("filter2d_clamped_list", images, chosen, kernel, border, true, false, true);
}
Tensors filter2d_backward_list(Tensors const& grads, OptionalTensor const& chosen, Tensor const& kernel, int64_t border,
                               bool same) {
  return filter_list("filter2d_backward_list", grads, chosen, kernel, border, same, true);
}

Tensors median_blur_list(Tensors const& images, OptionalTensor const& chosen, int64_t ky, int64_t kx,
                         int64_t border_number) {
  constexpr char const* op = "median_blur_list";
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  Border const border = to_border(op, border_number);
  list.check_window_fits(border, ky, kx);
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    filters::MedianBlur<T> const all{{}, {}, ky, kx, border};
    list.filter<filters::MedianBlurList<T>>(all, ceil_div(kx * ky, 4),
                                            [&](auto const& p, int64_t cost) { filters::run(like, p, cost); });
  });
  return list.kept.results;
}

// The gradients of the images. The list has the images, and behind them the gradients of the results.
Tensors median_blur_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen, Tensors const& medians,
                                  int64_t ky, int64_t kx, int64_t border_number) {
  constexpr char const* op = "median_blur_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  Border const border = to_border(op, border_number);
  list.check_window_fits(border, ky, kx);
  Tensors const grads = list.in_layout_of_images(given), stored = list.as_results(medians);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    filters::MedianBlurBackward<T> all{};
    all.ky = ky, all.kx = kx, all.border = border;
    list.gradients<filters::MedianBlurBackwardList<T>>(all, grads, ceil_div(kx * ky, 4),
                                                       [&](auto& p, size_t first, int64_t cost) {
                                                         for (int i = 0; i < p.count; ++i)
                                                           p.medians[i] = stored[first + size_t(i)].const_data_ptr();
                                                         filters::run_backward(like, p, cost);
                                                       });
  });
  return list.kept.results;
}

Tensors sharpness_list(Tensors const& images, OptionalTensor const& chosen, OptionalTensor const& factor,
                       double number) {
  constexpr char const* op = "sharpness_list";
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  enhance::check_planes(op, like);
  dispatch_floating_and_uint8(op, like, [&]<class T>(Type<T>) {
    enhance::Sharpness<T> all{};
    all.factor = enhance::plane_parameter<Compute<T>>(op, "factor", like, factor, number);
    list.filter<enhance::SharpnessList<T>>(all, 3, [&](auto const& p, int64_t cost) { enhance::run(like, p, cost); });
  });
  return list.kept.results;
}

// The gradients of the images. The list has the images, and behind them the gradients of the results.
Tensors sharpness_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen,
                                OptionalTensor const& factor, double number) {
  constexpr char const* op = "sharpness_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen);
  Tensor const& like = list.like();
  enhance::check_planes(op, like);
  Tensors const grads = list.in_layout_of_images(given);
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    enhance::SharpnessBackward<T> all{};
    all.factor = enhance::plane_parameter<Compute<T>>(op, "factor", like, factor, number);
    list.gradients<enhance::SharpnessBackwardList<T>>(
        all, grads, 6, [&](auto const& p, size_t, int64_t cost) { enhance::run(like, p, cost); });
  });
  return list.kept.results;
}

}  // namespace

Tensors steps::gaussian_blur(Tensors const& images, OptionalTensor const& sigma, int64_t ky, int64_t kx, double sigma_y,
                             double sigma_x, Border border) {
  OptionalTensor const all;
  return gaussian_list("gaussian_blur2d_list", images, all, sigma, ky, kx, sigma_y, sigma_x, int64_t(border), false,
                       true);
}

// `chosen` (B,) float32: images whose value is 0 stay as they are. What follows are the arguments of the operators on
// batches.
#define KV_GAUSSIAN \
  "Tensor? chosen, Tensor? sigma, int ky, int kx, float sigma_y, float sigma_x, int border) -> Tensor[]"
KV_OPERATOR(gaussian_blur2d_list, "(Tensor[] images, " KV_GAUSSIAN)
KV_OPERATOR(gaussian_blur2d_backward_list, "(Tensor[] grads, " KV_GAUSSIAN)
#undef KV_GAUSSIAN
KV_OPERATOR(filter2d_list, "(Tensor[] images, Tensor? chosen, Tensor kernel, int border, bool same) -> Tensor[]")
KV_OPERATOR(filter2d_clamped_list, "(Tensor[] images, Tensor? chosen, Tensor kernel, int border) -> Tensor[]")
KV_OPERATOR(filter2d_backward_list,
            "(Tensor[] grads, Tensor? chosen, Tensor kernel, int border, bool same) -> Tensor[]")
KV_OPERATOR(box_blur_list, "(Tensor[] images, Tensor? chosen, int ky, int kx, int border) -> Tensor[]")
KV_OPERATOR(median_blur_list, "(Tensor[] images, Tensor? chosen, int ky, int kx, int border) -> Tensor[]")
KV_OPERATOR(median_blur_list_backward,
            "(Tensor[] images_and_grads, Tensor? chosen, Tensor[] medians, int ky, int kx, int border) -> Tensor[]")
KV_OPERATOR(sharpness_list, "(Tensor[] images, Tensor? chosen, Tensor? factor, float number) -> Tensor[]")
KV_OPERATOR(sharpness_list_backward,
            "(Tensor[] images_and_grads, Tensor? chosen, Tensor? factor, float number) -> Tensor[]")
KV_OPERATOR(box_blur_backward_list, "(Tensor[] grads, Tensor? chosen, int ky, int kx, int border) -> Tensor[]")

}  // namespace kv::augmentation
