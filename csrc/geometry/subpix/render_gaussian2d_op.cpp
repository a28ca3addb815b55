// Heat maps of Gaussians: schemas and entries, for CPU and CUDA.
#include "geometry/subpix/render_gaussian2d.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

// Means and standard deviations (P, 2), or (1, 2) for all maps, checked.
struct Gaussians {
  Tensor mean, std;
  int64_t planes, height, width;
  bool normalized;

  Gaussians(char const* op, Tensor const& m, Tensor const& s, int64_t height, int64_t width, bool normalized)
      : mean(dense(m)), std(dense(s)), planes(0), height(height), width(width), normalized(normalized) {
    KV_CHECK(m.dim() == 2 && m.size(1) == 2 && s.dim() == 2 && s.size(1) == 2 && s.scalar_type() == m.scalar_type() &&
                 s.device() == m.device(),
             op, ": expected mean and std of shape (P, 2), of one type and device");
    KV_CHECK(m.size(0) == s.size(0) || m.size(0) == 1 || s.size(0) == 1, op,
             ": expected as many rows of mean as of std, or 1");
    KV_CHECK(height > 0 && width > 0 && height < int64_t(1) << 31 && width < int64_t(1) << 31 &&
                 height * width < int64_t(1) << 31,
             op, ": expected a size from 1 to 2^31 - 1 pixels, got ", height, " x ", width);
    planes = m.size(0) == 1 ? s.size(0) : m.size(0);
  }
  template <class T>
  RenderGaussian2d<T> params() const {
    using F = Compute<T>;
    RenderGaussian2d<T> p{};
    p.mean = data_ptr<T const>(mean);
    p.std = data_ptr<T const>(std);
    p.mean_stride = mean.size(0) == 1 ? 0 : 2;
    p.std_stride = std.size(0) == 1 ? 0 : 2;
    p.planes = planes;
    p.height = height;
    p.width = width;
    // Every chunk sums the weights of both axes once.
    int64_t const chunk = std::max<int64_t>(kExpectationChunk, 16 * (height + width));
    p.rows = clamp(chunk / width, int64_t(1), height);
    p.along_x = CoordAxis<F>::of(width, normalized);
    p.along_y = CoordAxis<F>::of(height, normalized);
    return p;
  }
};

Tensor render_gaussian2d(Tensor const& mean, Tensor const& std, int64_t height, int64_t width, bool normalized) {
  constexpr char const* op = "render_gaussian2d";
  Gaussians const gaussians(op, mean, std, height, width, normalized);
  Tensor const maps = empty({gaussians.planes, height, width}, gaussians.mean);
  dispatch_floating(op, gaussians.mean, [&](auto type) {
    using T = typename decltype(type)::type;
    RenderGaussian2d<T> p = gaussians.params<T>();
    p.maps = data_ptr<T>(maps);
    KV_RUN(render_gaussian2d, maps, p, p.planes * p.chunks(), 2 * p.rows * width);
  });
  return maps;
}

// Gradients to the mean and the standard deviation of each map, also if all maps share them.
std::tuple<Tensor, Tensor> render_gaussian2d_backward(Tensor const& grad, Tensor const& mean, Tensor const& std,
                                                      bool normalized) {
  constexpr char const* op = "render_gaussian2d_backward";
  KV_CHECK(grad.dim() == 3 && grad.scalar_type() == mean.scalar_type() && grad.device() == mean.device(), op,
           ": expected grad of shape (P, H, W), of mean's type and device");
  Gaussians const gaussians(op, mean, std, grad.size(1), grad.size(2), normalized);
  KV_CHECK(grad.size(0) == gaussians.planes, op, ": expected grad of ", gaussians.planes, " maps, got ", grad.size(0));
  Tensor const g = dense(grad), grad_mean = empty({gaussians.planes, 2}, gaussians.mean),
               grad_std = empty({gaussians.planes, 2}, gaussians.mean);
  dispatch_floating(op, gaussians.mean, [&](auto type) {
    using T = typename decltype(type)::type;
    RenderGaussian2d<T> p = gaussians.params<T>();
    Tensor const partial = empty({p.planes, p.chunks(), 4}, g, Layout::planar, compute_dtype(g));
    p.grad = data_ptr<T const>(g);
    p.partial = data_ptr<Compute<T>>(partial);
    p.grad_mean = data_ptr<T>(grad_mean);
    p.grad_std = data_ptr<T>(grad_std);
    KV_RUN(render_gaussian2d_backward, g, p, p.planes * p.chunks(), 2 * p.rows * p.width);
#if !defined(KV_CUDA)
    for (int64_t i = 0; i < 4 * p.planes; ++i) {
      Compute<T> sum = 0;
      for (int64_t k = 0; k < p.chunks(); ++k) sum += p.partial[4 * (i / 4 * p.chunks() + k) + i % 4];
      T* const to = (i % 4 < 2 ? p.grad_mean : p.grad_std) + i / 4 * 2 + i % 2;
      if constexpr (sizeof(T) > 2)
        *to = sum;
      else if constexpr (std::is_same_v<T, Half>)
        *to = to_half(sum);
      else
        *to = to_bfloat16(sum);
    }
#endif
  });
  return {grad_mean, grad_std};
}

}  // namespace

KV_OPERATOR(render_gaussian2d, "(Tensor mean, Tensor std, int height, int width, bool normalized) -> Tensor")
KV_OPERATOR(render_gaussian2d_backward, "(Tensor grad, Tensor mean, Tensor std, bool normalized) -> (Tensor, Tensor)")

}  // namespace kv::geometry
