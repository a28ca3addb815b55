// The gradient of the image on CUDA, by scattering: a warp adds a blocklet of the output to its taps, in private sums
// in shared memory. These are then added by atomics to a zeroed buffer of the compute type. Where the taps of the
// blocklet exceed the sums, the warp adds directly to the buffer. Included by sampling_image_backward.cu and
// lists/warp_list_backward.cu.
#pragma once

#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kScatterWarps = 4;                         // of a block, which work alone
constexpr int kBlockletWidth = 16, kBlockletHeight = 8;  // output pixels that a warp takes at a time
constexpr int kCoordsPerLane = kBlockletWidth * kBlockletHeight / 32;

// A warp's sums, in shared memory: of pixels in rows of `pitch`, for some channels.
template <class F>
struct Sums {
  static constexpr int kCells = 576;  // of a channel: a blocklet rotated by any angle, or 1.5 times as large
  static constexpr int kChannels = sizeof(F) == 8 ? 1 : 3;  // at a time
  static __host__ __device__ int channels(int of) { return min(of, kChannels); }
  static size_t bytes(int of) { return kScatterWarps * kCells * (channels(of) * sizeof(F) + sizeof(int)); }
};

// Adds four sums to memory, at a multiple of their size.
template <class F>
__device__ __forceinline__ void add_four(F* to, Vector<F, 4> const& sums) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  constexpr bool at_once = sizeof(F) == 4;
#else
  constexpr bool at_once = false;
#endif
  if constexpr (at_once) {
    asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(__cvta_generic_to_global(to)), "f"(sums.v[0]),
                 "f"(sums.v[1]), "f"(sums.v[2]), "f"(sums.v[3])
                 : "memory");
  } else {
#pragma unroll
    for (int i = 0; i < 4; ++i)
      if (sums.v[i] != 0) atomicAdd(to + i, sums.v[i]);
  }
}

// A coordinate of the same value under reflection, whose taps pixel_at supports. Relative to `origin`; NaN is 0. A
// coordinate near the image does not change, so that adjacent ones stay adjacent.
template <class F>
__device__ __noinline__ F reflected_near(Axis<F> const& axis, F x, int origin) {
  F const first = F(-origin), reach = F(axis.size < 8 ? 1 : axis.size / 2);
  return x >= first - reach && x < first + (F(axis.size - 1) + reach) ? x : reflected(axis, x + F(origin)) - F(origin);
}

// Adds N channels of one output pixel directly to the sums in memory.
template <int K, int N, class T, class F>
__device__ __forceinline__ void scatter_pixel(SampleImageBackward<T> const& p, F* sums, F u, F v, Tile<F> const& tile,
                                              F const (&g)[N]) {
  F wx[K], wy[K], tx, ty;
  int const column = first_tap<K, F>(u, tx) + tile.u, row = first_tap<K, F>(v, ty) + tile.v;
  int const width = p.x_axis.size, stride = int(p.grad_x.row_stride);
  [[maybe_unused]] bool const rows_are_aligned = stride % 4 == 0 && column >= 0 && column + K <= width;
  tap_weights(tx, wx);
  tap_weights(ty, wy);
#pragma unroll
  for (int j = 0; j < K; ++j) {
    int const y = pixel_at(p.y_axis, row + j);
    if (unsigned(y) >= unsigned(p.y_axis.size)) continue;
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F* const line = sums + k * p.grad_x.channel_stride + y * stride;
      F taps[8] = {};  // from the beginning of a vector on
#pragma unroll
      for (int i = 0; i < K; ++i) {
        F const weight = wx[i] * wy[j];
        taps[i] = weight == 0 ? F(0) : weight * g[k];
      }
      if constexpr (K > 1 && sizeof(F) == 4)
        if (rows_are_aligned) {
#pragma unroll
          for (int by = 1; by <= 2; by *= 2)
#pragma unroll
            for (int i = 7; i >= 0; --i)
              if (column & by) taps[i] = i < by ? F(0) : taps[max(i - by, 0)];
          F* const to = line + (column & -4);
          add_four(to, Vector<F, 4>{taps[0], taps[1], taps[2], taps[3]});
          if (taps[4] != 0 || taps[5] != 0 || taps[6] != 0)
            add_four(to + 4, Vector<F, 4>{taps[4], taps[5], taps[6], 0});
          continue;
        }
#pragma unroll
      for (int i = 0; i < K; ++i) {
        int const x = pixel_at(p.x_axis, column + i);
        if (unsigned(x) < unsigned(width) && taps[i] != 0) atomicAdd(line + x, taps[i]);
      }
    }
  }
}

// The output pixels of a run are two apart, so that few of them have a tap in common, and their sums in different
// banks:
//
//   0 1 0 1      those that do take turns: each writes its index to the cell of its first tap, and the one whose
//   2 3 2 3      index stays adds. Only the warp itself accesses its sums: plain additions, where atomics on floats are
//   1 0 1 0      loops.
//   3 2 3 2
template <int K, class T>
__device__ __forceinline__ void scatter_block(SampleImageBackward<T> const& p, TileGrid const& tiles) {
  using F = Compute<T>;
  constexpr int kCells = Sums<F>::kCells;
  __shared__ Tile<F> tile;
  extern __shared__ __align__(16) unsigned char shared_sums[];
  tile.init_for_block(tiles, p);
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, lane_x = lane % 8, lane_y = lane / 8;
  int const width = int(p.grad.width), height = int(p.grad.height),
            pixels = Sums<F>::channels(p.grad.channels) * kCells;
  F* const sums = reinterpret_cast<F*>(shared_sums) + warp * pixels;
  int* const numbers =
      reinterpret_cast<int*>(reinterpret_cast<F*>(shared_sums) + kScatterWarps * pixels) + warp * kCells;
  TileCoords<F> const coords(p.coords, tile);
  bool const filled = p.x_axis.padding == Padding::fill, reflects = p.x_axis.padding == Padding::reflection;
  // The coordinates next to the image that represent all those out of bounds; none under reflection.
  F const first_u = reflects ? -INFINITY : F(-4 - tile.u), last_u = reflects ? INFINITY : F(p.x_axis.size + 3 - tile.u);
  F const first_v = reflects ? -INFINITY : F(-4 - tile.v), last_v = reflects ? INFINITY : F(p.y_axis.size + 3 - tile.v);
#pragma unroll 1
  for (int blocklet = warp; blocklet < kTile * kTile / (kBlockletWidth * kBlockletHeight); blocklet += kScatterWarps) {
    int const x0 = tile.x + blocklet % (kTile / kBlockletWidth) * kBlockletWidth + 2 * lane_x;
    int const y0 = tile.y + blocklet / (kTile / kBlockletWidth) * kBlockletHeight + 2 * lane_y;
    auto const x_of = [&](int run) { return x0 + ((lane_y + run) & 1); };
    auto const y_of = [&](int run) { return y0 + run / 2; };

    // The sampling coordinates, which of them have taps, and the bounding box of the first taps.
    F u[kCoordsPerLane], v[kCoordsPerLane];
    if (!p.coords.has_map()) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        tile.map.apply(F(x_of(run) - tile.x), F(y_of(run) - tile.y), u[run], v[run]);
    } else {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        coords.near(min(y_of(run), height - 1), min(x_of(run), width - 1), u[run], v[run]);
    }
    if (reflects) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run) {
        u[run] = reflected_near(p.x_axis, u[run], tile.u);
        v[run] = reflected_near(p.y_axis, v[run], tile.v);
      }
    }
    TapBounds box = TapBounds::empty();
    unsigned count = 0;
    bool far = false;
#pragma unroll
    for (int run = 0; run < kCoordsPerLane; ++run) {
      u[run] = vclamp(u[run], first_u, last_u);
      v[run] = vclamp(v[run], first_v, last_v);
      F t;
      int const column = near_tap<K>(u[run], t), row = near_tap<K>(v[run], t);
      bool const is_far = max(vabs(u[run]), vabs(v[run])) >= F(1 << 20);  // where near_tap is none
      bool const has_taps = !filled || (unsigned(column + tile.u + K - 1) < unsigned(p.x_axis.size + K - 1) &&
                                        unsigned(row + tile.v + K - 1) < unsigned(p.y_axis.size + K - 1));
      if (x_of(run) >= width || y_of(run) >= height || !(has_taps || is_far)) continue;
      count |= 1u << run;
      far |= is_far;
      box = {min(box.left, column), min(box.top, row), max(box.right, column), max(box.bottom, row)};
    }
    box = {warp_reduce(box.left, Min()), warp_reduce(box.top, Min()), -warp_reduce(-box.right, Min()),
           -warp_reduce(-box.bottom, Min())};
    if (box.left > box.right) continue;  // none
    far = __any_sync(0xffffffffu, far) || box.right - box.left > 64 || box.bottom - box.top > 64;
    // Vectors of four begin where those of the image do. Rows are an odd multiple of four: those of a run in other
    // banks.
    int const left = far ? 0 : ((box.left + tile.u) & -4) - tile.u, top = box.top, rows = box.bottom - top + K;
    int const columns = box.right - left + K, pitch = columns <= 20 ? 20 : ((columns + 3) & -8) | 4;
    bool const fits = !far && rows * pitch <= kCells;

    for_each_channel_group<Sums<F>::kChannels>(p.grad.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      T const* const grad = p.grad.row(tile.b, first, 0);
      auto const offset_of = [&](int run) { return y_of(run) * int(p.grad.row_stride) + x_of(run) * int(p.grad.step); };
      F g[kCoordsPerLane][N];
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
#pragma unroll
        for (int k = 0; k < N; ++k)
          g[run][k] = count >> run & 1 ? F(read(grad[k * p.grad.channel_stride + offset_of(run)])) : F(0);
      F* const to = p.sums + tile.image * p.grad_x.batch_stride + first * p.grad_x.channel_stride;
      F to_u[kCoordsPerLane], to_v[kCoordsPerLane];
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run) to_u[run] = u[run], to_v[run] = v[run];
      auto const next_run = [&] {
#pragma unroll
        for (int next = 1; next < kCoordsPerLane; ++next) {
          to_u[next - 1] = to_u[next], to_v[next - 1] = to_v[next];
#pragma unroll
          for (int k = 0; k < N; ++k) g[next - 1][k] = g[next][k];
        }
      };
      if (!fits) {
#pragma unroll 1
        for (int run = 0; run < kCoordsPerLane; ++run, next_run())
          if (count >> run & 1) scatter_pixel<K, N>(p, to, to_u[0], to_v[0], tile, g[0]);
        return;
      }
      __syncwarp();  // before the previous sums are overwritten
      for (int i = 4 * lane; i < rows * pitch; i += 4 * 32)
#pragma unroll
        for (int k = 0; k < N; ++k) *reinterpret_cast<Vector<F, 4>*>(sums + k * kCells + i) = {};
      __syncwarp();

#pragma unroll 1
      for (int run = 0; run < kCoordsPerLane; ++run, next_run()) {
        F tx, ty, wx[K], wy[K];
        int const column = near_tap<K>(to_u[0], tx), row = near_tap<K>(to_v[0], ty);
        int const at = (row - top) * pitch + (column - left);
        tap_weights(tx, wx);
        tap_weights(ty, wy);
        bool waits = count >> run & 1;
        do {
          if (waits) atomicExch(numbers + at, lane);
          __syncwarp();
          bool const adds = waits && numbers[at] == lane;
#pragma unroll
          for (int j = 0; j < K; ++j)
#pragma unroll
            for (int i = 0; i < K; ++i) {
              F const weight = wx[i] * wy[j];
              F* const sum = sums + (at + j * pitch + i);
              if (adds && weight != 0)
#pragma unroll
                for (int k = 0; k < N; ++k) sum[k * kCells] += weight * g[0][k];
              __syncwarp();
            }
          waits = waits && !adds;
        } while (__any_sync(0xffffffffu, waits));
      }

      int const stride = int(p.grad_x.row_stride), to_left = left + tile.u, to_top = top + tile.v;
      if (stride % 4 == 0 && to_left >= 0 && to_top >= 0 && to_left + columns <= p.x_axis.size &&
          to_top + rows <= p.y_axis.size) {
        for (int row = lane_y; row < rows; row += 4)
          for (int column = 4 * lane_x; column < columns; column += 32)
#pragma unroll
            for (int k = 0; k < N; ++k) {
              Vector<F, 4> const four =
                  *reinterpret_cast<Vector<F, 4> const*>(sums + k * kCells + row * pitch + column);
              if (four.v[0] != 0 || four.v[1] != 0 || four.v[2] != 0 || four.v[3] != 0)
                add_four(to + k * p.grad_x.channel_stride + ((to_top + row) * stride + to_left + column), four);
            }
      } else {
        for (int row = 0; row < rows; ++row) {
          int const to_y = pixel_at(p.y_axis, to_top + row);
          if (unsigned(to_y) >= unsigned(p.y_axis.size)) continue;
          for (int column = lane; column < columns; column += 32) {
            int const to_x = pixel_at(p.x_axis, to_left + column);
            if (unsigned(to_x) >= unsigned(p.x_axis.size)) continue;
#pragma unroll
            for (int k = 0; k < N; ++k) {
              F const sum = sums[k * kCells + row * pitch + column];
              if (sum != 0) atomicAdd(to + k * p.grad_x.channel_stride + (to_y * stride + to_x), sum);
            }
          }
        }
      }
    });
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
