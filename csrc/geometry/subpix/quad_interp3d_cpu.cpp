// Subvoxel peaks on the CPU: rows [begin, end) of all volumes; whole volumes in the backward pass. Compiled once per
// instruction set.
#include <cstddef>

#include "core/lanes.h"
#include "geometry/subpix/quad_interp3d.h"

namespace kv::geometry::KV_ISA {
namespace {

template <class T, class Use>
KV_HD void for_each_peak(ConvQuadInterp3d<T> const& p, int64_t volume, int z, int y, Use use) {
  auto const read = [](T const& x) { return load<1>(&x); };
  int64_t const plane = int64_t(p.size[1]) * p.size[2];
  T const* const x = p.x + volume * p.size[0] * plane;
  uint8_t const* const chosen =
      p.chosen ? p.chosen + (volume * p.size[0] + z) * plane + int64_t(y) * p.size[2] : nullptr;
  for (int i = 0; i < p.size[2]; ++i)
    if (chosen ? chosen[i] != 0 : is_peak(x, p.size, z, y, i, read))
      find_peak(p, x, z, y, i, read, [&](int const(&c)[3], auto const& q) { use(i, c, q); });
}

}  // namespace

template <class T>
void conv_quad_interp3d(ConvQuadInterp3d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.size[2], plane = p.size[1] * width, volume_size = p.size[0] * plane;
  for (int64_t r = begin; r < end; ++r) {
    int const y = int(r % p.size[1]), z = int(r / p.size[1] % p.size[0]);
    int64_t const volume = r / (int64_t(p.size[0]) * p.size[1]);
    T const* const x = p.x + volume * volume_size;
    T* const values = p.values + r * width;
    T* coords[3];
    for (int a = 0; a < 3; ++a) coords[a] = p.coords + (3 * volume + a) * volume_size + z * plane + y * width;
    __builtin_memcpy(static_cast<void*>(values), x + z * plane + y * width, size_t(width) * sizeof(T));
    for (int i = 0; i < width; ++i) {
      store<1>(coords[0] + i, F(z));
      store<1>(coords[1] + i, F(i));
      store<1>(coords[2] + i, F(y));
    }
    for_each_peak(p, volume, z, y, [&](int i, int const(&c)[3], Quadratic<F> const& q) {
      store<1>(values + i, load<1>(x + c[2] * plane + c[1] * width + c[0]) + q.rise());
      store<1>(coords[0] + i, F(c[2]) + q.shift[2]);
      store<1>(coords[1] + i, F(c[0]) + q.shift[0]);
      store<1>(coords[2] + i, F(c[1]) + q.shift[1]);
    });
  }
}

template <class T>
void conv_quad_interp3d_backward(ConvQuadInterp3dBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  ConvQuadInterp3d<T> const& f = p.forward;
  int64_t const width = f.size[2], plane = f.size[1] * width, size = f.size[0] * plane;
  for (int64_t volume = begin; volume < end; ++volume) {
    F* const grad_x = p.grad_x + volume * size;
    for (int64_t i = 0; i < size; ++i) grad_x[i] = load<1>(p.grad_values + volume * size + i);
    for (int z = 0; z < f.size[0]; ++z)
      for (int y = 0; y < f.size[1]; ++y)
        for_each_peak(f, volume, z, y, [&](int i, int const(&c)[3], Quadratic<F> const& q) {
          int64_t const at = z * plane + y * width + i;
          auto const coord = [&](int number) { return load<1>(p.grad_coords + (3 * volume + number) * size + at); };
          F const grad_shift[] = {coord(1), coord(2), coord(0)},
                  grad_value = load<1>(p.grad_values + volume * size + at);
          F* const center = grad_x + c[2] * plane + c[1] * width + c[0];
          grad_x[at] -= grad_value;
          q.vjp(grad_shift, grad_value,
                [&](int dx, int dy, int dz, F number) { center[dz * plane + dy * width + dx] += number; });
        });
  }
}

KV_INSTANTIATE(conv_quad_interp3d, ConvQuadInterp3d)
KV_INSTANTIATE(conv_quad_interp3d_backward, ConvQuadInterp3dBackward)

}  // namespace kv::geometry::KV_ISA
