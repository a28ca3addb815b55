// Bilateral blur: schemas and entries, for CPU and CUDA.
#include "bilateral.h"
#include "glue/images.h"

namespace kv::filters {
namespace {

// The checked arguments that all entries have in common.
struct Arguments {
  Tensor x, guide, sigma_color, sigma_space;
  bool joint, l1;
  int ky, kx;
  Border border;

  Arguments(char const* op, Tensor const& input, std::optional<Tensor> const& guidance,
            std::optional<Tensor> const& colors, std::optional<Tensor> const& spaces, int64_t ky, int64_t kx,
            int64_t border, int64_t distance)
      : x(input),
        guide(guidance ? *guidance : x),
        sigma_color(colors ? dense(*colors) : x),
        sigma_space(spaces ? dense(*spaces) : x),
        joint(guidance.has_value()),
        l1(distance == int64_t(ColorDistance::l1)),
        ky(int(ky)),
        kx(int(kx)),
        border(to_border(op, border)) {
    KV_CHECK(l1 || distance == int64_t(ColorDistance::l2), op, ": distance must be 0 (l1) or 1 (l2), got ", distance);
    check_window(op, ky, kx);
    KV_CHECK(ky % 2 == 1 && kx % 2 == 1, op, ": expected odd kernel sizes, got ", ky, ", ", kx);
    check_border(op, this->border, ky / 2, x.size(2));
    check_border(op, this->border, kx / 2, x.size(3));
    auto const matches = [&](Tensor const& t, int64_t dims) {
      return t.dim() == dims && t.scalar_type() == compute_dtype(x) && t.device() == x.device() &&
             (t.size(0) == 1 || t.size(0) == x.size(0));
    };
    KV_CHECK(!joint || (matches(guide, 4) && guide.size(2) == x.size(2) && guide.size(3) == x.size(3)), op,
             ": guidance does not fit input");
    KV_CHECK(!colors || matches(sigma_color, 1), op, ": sigma_color does not fit input");
    KV_CHECK(!spaces || (matches(sigma_space, 2) && sigma_space.size(1) == 2), op, ": sigma_space does not fit input");
    has_colors = colors.has_value();
    has_spaces = spaces.has_value();
  }

  template <class F>
  Sigmas<F> sigmas(double color, double y, double x) const {
    auto const data = [](Tensor const& t) { return static_cast<F const*>(t.const_data_ptr()); };
    return {F(color),
            F(y),
            F(x),
            has_colors ? data(sigma_color) : nullptr,
            has_spaces ? data(sigma_space) : nullptr,
            sigma_color.size(0) == 1 ? 0 : 1,
            sigma_space.size(0) == 1 ? 0 : 2};
  }

 private:
  bool has_colors, has_spaces;
};

std::tuple<Tensor, Tensor> bilateral_blur(Tensor const& input, std::optional<Tensor> const& guidance,
                                          std::optional<Tensor> const& sigma_color,
                                          std::optional<Tensor> const& sigma_space, int64_t ky, int64_t kx,
                                          double color, double space_y, double space_x, int64_t border,
                                          int64_t distance, bool keeps_totals) {
  check_images("bilateral_blur", "input", input);
  Arguments const a("bilateral_blur", input, guidance, sigma_color, sigma_space, ky, kx, border, distance);
#if !defined(KV_CUDA)
  KV_CHECK(!keeps_totals, "bilateral_blur: the CPU keeps no totals");
#endif
  Tensor const y = empty_like(a.x, layout_of(a.x));
  int64_t const batch = a.x.size(0);
  Tensor const totals = empty({batch, keeps_totals ? 1 : 0, a.x.size(2), a.x.size(3)}, a.x);
  dispatch_floating_and_uint8("bilateral_blur", a.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Bilateral<T> const params{images<T const>(a.x, batch),
                              a.joint ? images<F const>(a.guide, batch) : Images<F const>{},
                              images<T>(y, batch),
                              images<T>(totals, batch),
                              a.sigmas<F>(color, space_y, space_x),
                              a.ky,
                              a.kx,
                              a.border,
                              a.l1,
                              a.joint};
    KV_RUN(bilateral_blur, a.x, params, y.numel() > 0 ? batch * y.size(2) : 0, y.size(1) * y.size(3) * ky * kx);
  });
  return {y, totals};
}

std::tuple<Tensor, Tensor> bilateral_blur_backward(
    Tensor const& grad, Tensor const& input, std::optional<Tensor> const& guidance,
    std::optional<Tensor> const& sigma_color, std::optional<Tensor> const& sigma_space,
    std::optional<Tensor> const& output, std::optional<Tensor> const& totals, int64_t ky, int64_t kx, double color,
    double space_y, double space_x, int64_t border, int64_t distance, bool needs_x, bool needs_guide) {
  char const* const op = "bilateral_blur_backward";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  Arguments const a(op, input, guidance, sigma_color, sigma_space, ky, kx, border, distance);
  int64_t const batch = a.x.size(0), h = a.x.size(2), w = a.x.size(3);
  if (output) check_like(op, "output", *output, input);
  KV_CHECK(output.has_value() == totals.has_value(), op, ": expected both output and totals, or none");
  KV_CHECK(!totals || (totals->dim() == 4 && totals->size(0) == batch && totals->size(1) == 1 && totals->size(2) == h &&
                       totals->size(3) == w && totals->scalar_type() == input.scalar_type() &&
                       totals->device() == input.device()),
           op, ": totals does not fit input");
  needs_guide = needs_guide && a.joint;
  Layout const layout = layout_of(grad);
  Tensor const grad_x = empty({batch, needs_x ? a.x.size(1) : 0, h, w}, grad, layout);
  Tensor const grad_guide = empty({batch, needs_guide ? a.guide.size(1) : 0, h, w}, grad, layout);
  dispatch_floating(op, a.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    BilateralBackward<T> const params{images<T const>(grad, batch),
                                      images<T const>(a.x, batch),
                                      output ? images<T const>(*output, batch) : Images<T const>{},
                                      totals ? images<T const>(*totals, batch) : Images<T const>{},
                                      a.joint ? images<F const>(a.guide, batch) : Images<F const>{},
                                      images<T>(grad_x, batch),
                                      images<T>(grad_guide, batch),
                                      a.sigmas<F>(color, space_y, space_x),
                                      a.ky,
                                      a.kx,
                                      a.border,
                                      a.l1,
                                      a.joint,
                                      needs_x,
                                      needs_guide};
    int64_t const rows = grad_x.numel() + grad_guide.numel() > 0 ? batch * h : 0;
    KV_RUN(bilateral_blur_backward, a.x, params, rows, 4 * a.x.size(1) * w * ky * kx);
  });
  return {grad_x, grad_guide};
}

Tensor bilateral_blur_sigma_sums(Tensor const& grad, Tensor const& input, std::optional<Tensor> const& guidance,
                                 std::optional<Tensor> const& sigma_color, std::optional<Tensor> const& sigma_space,
                                 int64_t ky, int64_t kx, double color, double space_y, double space_x, int64_t border,
                                 int64_t distance) {
  char const* const op = "bilateral_blur_sigma_sums";
  check_images(op, "input", input);
  check_like(op, "grad", grad, input);
  Arguments const a(op, input, guidance, sigma_color, sigma_space, ky, kx, border, distance);
  int64_t const batch = a.x.size(0), h = a.x.size(2);
  Tensor const sums = empty({batch, 3, h}, grad);
  dispatch_floating(op, a.x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    BilateralSigmas<T> const params{images<T const>(grad, batch),
                                    images<T const>(a.x, batch),
                                    a.joint ? images<F const>(a.guide, batch) : Images<F const>{},
                                    static_cast<T*>(sums.mutable_data_ptr()),
                                    a.sigmas<F>(color, space_y, space_x),
                                    a.ky,
                                    a.kx,
                                    a.border,
                                    a.l1,
                                    a.joint};
    KV_RUN(bilateral_blur_sigma_sums, a.x, params, batch * h, 2 * a.x.size(1) * a.x.size(3) * ky * kx);
  });
  return sums;
}

}  // namespace

KV_OPERATOR(bilateral_blur,
            "(Tensor input, Tensor? guidance, Tensor? sigma_color, Tensor? sigma_space, int ky, int kx, float color, "
            "float space_y, float space_x, int border, int distance, bool keeps_totals) -> (Tensor, Tensor)")
KV_OPERATOR(bilateral_blur_backward,
            "(Tensor grad, Tensor input, Tensor? guidance, Tensor? sigma_color, Tensor? sigma_space, Tensor? output, "
            "Tensor? totals, int ky, int kx, float color, float space_y, float space_x, int border, int distance, "
            "bool wants_input, bool wants_guidance) -> (Tensor, Tensor)")
KV_OPERATOR(bilateral_blur_sigma_sums,
            "(Tensor grad, Tensor input, Tensor? guidance, Tensor? sigma_color, Tensor? sigma_space, int ky, int kx, "
            "float color, float space_y, float space_x, int border, int distance) -> Tensor")

}  // namespace kv::filters
