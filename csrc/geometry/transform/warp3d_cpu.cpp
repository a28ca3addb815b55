// Warps of volumes on the CPU: rows [begin, end) of all outputs in order; for the gradient of the volume, one thread
// takes each channel, so that sums are the same in every run. Compiled once per instruction set.
#include "core/iota.h"
#include "core/lanes.h"
// After it, for lanes.
#include "geometry/transform/warp3d_taps.h"

namespace kv::geometry::KV_ISA {
namespace {

constexpr int64_t kChunk = 64;  // voxels whose coordinates are computed before the first of them is sampled

// The taps of a voxel of the output, in the order of z, y, x. Those out of bounds are at 0 with the weight 0.
template <int K, class F>
struct Taps {
  static constexpr int kCount = K * K * K;
  int64_t at[kCount];
  F weight[kCount];
  bool inside[kCount];
};

// Sampling coordinates, their divisors, taps and fractions of a chunk of a row of the output.
template <int K, class T>
struct RowChunk {
  using F = Compute<T>;
  F coords[3][kChunk], divisor[kChunk], fraction[3][kChunk];
  int pixel[3][K][kChunk];

  KV_HD void fill(Warp3d<T> const& p, Homography3<F> const& map, int64_t first, int64_t y, int64_t z, int64_t count) {
    for_each_vector<F>(0, count, [&](auto lanes, int64_t i) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      auto const row = [&](int r) {
        F const* const m = map.m + 4 * r;
        return V(iota<N, F>(first + i) * m[0] + (F(y) * m[1] + (F(z) * m[2] + m[3])));
      };
      V const weight = row(3);
      store<N>(divisor + i, weight);
      for (int axis = 0; axis < 3; ++axis) {
        V const at = row(axis) / weight;
        store<N>(coords[axis] + i, at);
        V t;
        auto const tap = first_tap<K, F>(near_image(p.axis(axis), at), t);
        store<N>(fraction[axis] + i, t);
        for (int k = 0; k < K; ++k) {
          Lanes<int, N> const indices = pixel_at(p.axis(axis), Lanes<int, N>(tap + k));
          __builtin_memcpy(pixel[axis][k] + i, &indices, sizeof(indices));
        }
      }
    });
  }

  KV_HD Taps<K, F> taps(Warp3d<T> const& p, int64_t i) const {
    Size3 const& size = p.use.source;
    F weight[3][K];
    for (int axis = 0; axis < 3; ++axis) tap_weights(fraction[axis][i], weight[axis]);
    Taps<K, F> taps;
    for (int c = 0; c < K; ++c)
      for (int b = 0; b < K; ++b)
        for (int a = 0; a < K; ++a) {
          int const z = pixel[2][c][i], y = pixel[1][b][i], x = pixel[0][a][i], k = (c * K + b) * K + a;
          bool const inside = (uint64_t(z) < uint64_t(size.depth)) & (uint64_t(y) < uint64_t(size.height)) &
                              (uint64_t(x) < uint64_t(size.width));
          taps.inside[k] = inside;
          taps.at[k] = inside ? (z * size.height + y) * size.width + x : 0;
          taps.weight[k] = inside ? weight[0][a] * weight[1][b] * weight[2][c] : F(0);
        }
    return taps;
  }
};

// Calls chunk(z, y, first, count) for the chunks of a row of the output, after they were filled.
template <int K, class T, class Body>
KV_HD void for_each_chunk(Warp3d<T> const& p, int64_t row, RowChunk<K, T>& chunk, Body body) {
  Size3 const& size = p.use.output;
  int64_t const b = row / (size.depth * size.height), z = row / size.height % size.depth, y = row % size.height;
  auto const map = homography3(p.matrices + b * p.matrix_stride, p.use);
  for (int64_t x = 0; x < size.width; x += kChunk) {
    int64_t const count = min(kChunk, size.width - x);
    chunk.fill(p, map, x, y, z, count);
    body(b, z, y, x, count);
  }
}

// A tap of weight 0 contributes nothing, even if it is inf or NaN.
template <int K, class T>
void value_rows(Warp3d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Size3 const& size = p.use.output;
  RowChunk<K, T> chunk;
  for (int64_t row = begin; row < end; ++row)
    for_each_chunk(p, row, chunk, [&](int64_t b, int64_t z, int64_t y, int64_t x, int64_t count) {
      T* const to = p.y + b * p.channels * p.output_voxels() + (z * size.height + y) * size.width + x;
      for (int64_t i = 0; i < count; ++i) {
        auto const taps = chunk.taps(p, i);
        for (int64_t c = 0; c < p.channels; ++c) {
          T const* const from = p.x + (b * p.channels + c) * p.source_voxels();
          F sum = 0;
          for (int k = 0; k < taps.kCount; ++k)
            sum += taps.weight[k] != 0 ? taps.weight[k] * load<1>(from + taps.at[k]) : F(0);
          store<1>(to + c * p.output_voxels() + i, sum);
        }
      }
    });
}

// Channels [begin, end) of all samples; those of a sample read the same taps.
template <int K, class T>
void scatter_planes(Warp3d<T> const& p, int64_t begin, int64_t end) {
  Size3 const& size = p.use.output;
  int64_t const rows = size.depth * size.height;
  for (T* voxel = p.x + begin * p.source_voxels(); voxel < p.x + end * p.source_voxels(); ++voxel) *voxel = 0;
  RowChunk<K, T> chunk;
  while (begin < end) {
    int64_t const sample = begin / p.channels, last = min(end, (sample + 1) * p.channels);
    for (int64_t row = sample * rows; row < (sample + 1) * rows; ++row)
      for_each_chunk(p, row, chunk, [&](int64_t, int64_t z, int64_t y, int64_t x, int64_t count) {
        T const* const grad = p.y + (z * size.height + y) * size.width + x;
        for (int64_t i = 0; i < count; ++i) {
          auto const taps = chunk.taps(p, i);
          for (int64_t c = begin; c < last; ++c) {
            T* const plane = p.x + c * p.source_voxels();
            T const g = grad[c * p.output_voxels() + i];
            for (int k = 0; k < taps.kCount; ++k)
              if (taps.weight[k] != 0) plane[taps.at[k]] += taps.weight[k] * g;
          }
        }
      });
    begin = last;
  }
}

// The gradient of the coordinates of a voxel, of the sums over channels of gradients times taps.
template <class F>
KV_HD void grad_of_coords(F const (&sums)[8], F x, F y, F z, F (&grad)[3]) {
  auto const lerp = [](F t, F a, F b) { return a * (1 - t) + b * t; };
  F const(&s)[8] = sums;
  grad[0] = lerp(z, lerp(y, s[1] - s[0], s[3] - s[2]), lerp(y, s[5] - s[4], s[7] - s[6]));
  grad[1] = lerp(z, lerp(x, s[2] - s[0], s[3] - s[1]), lerp(x, s[6] - s[4], s[7] - s[5]));
  grad[2] = lerp(y, lerp(x, s[4] - s[0], s[5] - s[1]), lerp(x, s[6] - s[2], s[7] - s[3]));
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
  Size3 const& size = p.use.output;
  RowChunk<2, T> chunk;
  for (int64_t row = begin; row < end; ++row) {
    double* const sums = p.sums + 16 * row;  // a part is a row
    for (int i = 0; i < 16; ++i) sums[i] = 0;
    if (p.interpolation == Interpolation::nearest) continue;
    for_each_chunk(p, row, chunk, [&](int64_t b, int64_t z, int64_t y, int64_t x, int64_t count) {
      T const* const grad = p.y + b * p.channels * p.output_voxels() + (z * size.height + y) * size.width + x;
      for (int64_t i = 0; i < count; ++i) {
        auto const taps = chunk.taps(p, i);
        T products[8] = {}, grad_coords[3];
        for (int64_t c = 0; c < p.channels; ++c) {
          T const* const from = p.x + (b * p.channels + c) * p.source_voxels();
          T const g = grad[c * p.output_voxels() + i];
          for (int k = 0; k < 8; ++k) products[k] += taps.inside[k] ? g * from[taps.at[k]] : T(0);
        }
        grad_of_coords(products, chunk.fraction[0][i], chunk.fraction[1][i], chunk.fraction[2][i], grad_coords);
        T const coords[3] = {chunk.coords[0][i], chunk.coords[1][i], chunk.coords[2][i]};
        accumulate_matrix_grad3(grad_coords, coords, chunk.divisor[i], T(x + i), T(y), T(z), sums);
      }
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
