// Warps of volumes on the CPU: rows [begin, end) of all outputs in order; for the gradient of the volume, one thread
// takes each channel, so that sums are the same in every run. Compiled once per instruction set.
#include "core/lanes.h"
// After it, for lanes.
#include "geometry/transform/warp3d_taps.h"

namespace kv::geometry::KV_ISA {
namespace {

// Calls voxel(sample, offset in the output, x, y, z, coordinates, divisor) along a row of the output.
template <class T, class Voxel>
KV_HD void for_each_voxel(Warp3d<T> const& p, int64_t row, Voxel voxel) {
  using F = Compute<T>;
  Size3 const& size = p.use.output;
  int64_t const b = row / (size.depth * size.height), z = row / size.height % size.depth, y = row % size.height;
  auto const map = homography3(p.matrices + b * p.matrix_stride, p.use);
  for (int64_t x = 0; x < size.width; ++x) {
    F coords[3];
    F const weight = map.apply(F(x), F(y), F(z), coords);
    voxel(b, (z * size.height + y) * size.width + x, F(x), F(y), F(z), coords, weight);
  }
}

template <int K, class T>
void value_rows(Warp3d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t row = begin; row < end; ++row)
    for_each_voxel(p, row, [&](int64_t b, int64_t at, F, F, F, F const(&coords)[3], F) {
      TapWindow3<K, F> const taps(p, coords);
      for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
        store<1>(p.y + c * p.output_voxels() + at,
                 taps.value(p.x + c * p.source_voxels(), [](T const& x) { return load<1>(&x); }));
    });
}

template <int K, class T>
void scatter_planes(Warp3d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const rows = p.use.output.depth * p.use.output.height;
  for (int64_t c = begin; c < end; ++c) {
    T *const plane = p.x + c * p.source_voxels(), *const grad = p.y + c * p.output_voxels();
    for (int64_t i = 0; i < p.source_voxels(); ++i) plane[i] = 0;
    for (int64_t row = c / p.channels * rows; row < (c / p.channels + 1) * rows; ++row)
      for_each_voxel(p, row, [&](int64_t, int64_t at, F, F, F, F const(&coords)[3], F) {
        TapWindow3<K, F> const taps(p, coords);
        taps.for_each([&](int64_t to, int i, int j, int k) {
          F const weight = taps.weight[0][i] * taps.weight[1][j] * taps.weight[2][k];
          if (weight != 0) plane[to] += weight * grad[at];
        });
      });
  }
}

}  // namespace

template <class T>
void warp3d(Warp3dForward<T> const& p, int64_t begin, int64_t end) {
  p.interpolation == Interpolation::nearest ? value_rows<1, T>(p, begin, end) : value_rows<2, T>(p, begin, end);
}

template <class T>
void warp3d_volume_backward(Warp3dVolumeBackward<T> const& p, int64_t begin, int64_t end) {
  p.interpolation == Interpolation::nearest ? scatter_planes<1, T>(p, begin, end) : scatter_planes<2, T>(p, begin, end);
}

template <class T>
void warp3d_coords_backward(Warp3dCoordsBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t row = begin; row < end; ++row) {
    double* const sums = p.sums + 16 * row;  // a part is a row
    for (int i = 0; i < 16; ++i) sums[i] = 0;
    if (p.interpolation == Interpolation::nearest) continue;
    for_each_voxel(p, row, [&](int64_t b, int64_t at, T x, T y, T z, T const(&coords)[3], T weight) {
      TapWindow3<2, T> const taps(p, coords);
      T grad_coords[3] = {};
      for (int64_t c = b * p.channels; c < (b + 1) * p.channels; ++c)
        taps.accumulate_coord_grads(p.x + c * p.source_voxels(), p.y[c * p.output_voxels() + at], grad_coords);
      accumulate_matrix_grad3(grad_coords, coords, weight, x, y, z, sums);
    });
  }
}

template <class T>
void warp3d_matrix_backward(Warp3dMatrixBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    double sums[16] = {};
    for (int64_t part = b * p.parts; part < (b + 1) * p.parts; ++part)
      for (int i = 0; i < 16; ++i) sums[i] += p.sums[part * 16 + i];
    homography3_vjp(p.matrices + b * p.matrix_stride, p.use, sums, p.grad + b * 4 * p.use.rows);
  }
}

KV_INSTANTIATE(warp3d, Warp3dForward)
KV_INSTANTIATE_COMPUTED(warp3d_volume_backward, Warp3dVolumeBackward)
KV_INSTANTIATE_COMPUTED(warp3d_coords_backward, Warp3dCoordsBackward)
KV_INSTANTIATE_COMPUTED(warp3d_matrix_backward, Warp3dMatrixBackward)

}  // namespace kv::geometry::KV_ISA
