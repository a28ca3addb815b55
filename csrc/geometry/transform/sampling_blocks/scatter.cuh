// The gradient of the image on CUDA, by scattering: a warp adds a blocklet of the output to its taps, in private sums
// in shared memory. These are then added by atomics to a zeroed buffer of the compute type. Where the taps of the
// blocklet exceed the sums, the warp adds directly to the buffer.
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

// The coordinates next to the image that represent all those out of bounds; none under reflection.
template <class F>
struct CoordLimits {
  F first_u, last_u, first_v, last_v;
  template <class T>
  __device__ __forceinline__ CoordLimits(SampleImageBackward<T> const& p, Tile<F> const& tile) {
    bool const reflects = p.x_axis.padding == Padding::reflection;
    first_u = reflects ? -INFINITY : F(-4 - tile.u), last_u = reflects ? INFINITY : F(p.x_axis.size + 3 - tile.u);
    first_v = reflects ? -INFINITY : F(-4 - tile.v), last_v = reflects ? INFINITY : F(p.y_axis.size + 3 - tile.v);
  }
};

// What a warp scatters at a time: a blocklet of output pixels, of which each thread has one in every run. Those of a
// run are two apart, so that few of them have a tap in common, and their sums in different banks:
//
//   0 1 0 1
//   2 3 2 3
//   1 0 1 0
//   3 2 3 2
template <class F>
struct Blocklet {
  int const x0, y0, lane_y;
  F u[kCoordsPerLane], v[kCoordsPerLane];  // the sampling coordinates, relative to the tile
  unsigned runs = 0;                       // a bit for each run whose pixel has taps
  int left, top, rows, columns, pitch;     // the bounding box of all taps, and the distance of its rows in the sums
  bool fits = false;                       // whether the sums hold the box

  __device__ __forceinline__ Blocklet(Tile<F> const& tile, int index, int lane_x, int lane_y)
      : x0(tile.x + index % (kTile / kBlockletWidth) * kBlockletWidth + 2 * lane_x),
        y0(tile.y + index / (kTile / kBlockletWidth) * kBlockletHeight + 2 * lane_y),
        lane_y(lane_y) {}
  __device__ __forceinline__ int x(int run) const { return x0 + ((lane_y + run) & 1); }
  __device__ __forceinline__ int y(int run) const { return y0 + run / 2; }
  __device__ __forceinline__ bool has_taps(int run) const { return runs >> run & 1; }

  // Phase 1: the sampling coordinates.
  template <class T>
  __device__ __forceinline__ void find_coords(SampleImageBackward<T> const& p, Tile<F> const& tile,
                                              TileCoords<F> const& coords) {
    if (!p.coords.has_map()) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        tile.map.apply(F(x(run) - tile.x), F(y(run) - tile.y), u[run], v[run]);
    } else {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run)
        coords.near(min(y(run), int(p.grad.height) - 1), min(x(run), int(p.grad.width) - 1), u[run], v[run]);
    }
    if (p.x_axis.padding == Padding::reflection) {
#pragma unroll
      for (int run = 0; run < kCoordsPerLane; ++run) {
        u[run] = reflected_near(p.x_axis, u[run], tile.u);
        v[run] = reflected_near(p.y_axis, v[run], tile.v);
      }
    }
  }

  // Phase 2: which pixels have taps, and the bounding box of the taps. False if none has.
  template <int K, class T>
  __device__ __forceinline__ bool find_box(SampleImageBackward<T> const& p, Tile<F> const& tile,
                                           CoordLimits<F> const& limits) {
    bool const filled = p.x_axis.padding == Padding::fill;
    TapBounds box = TapBounds::empty();
    bool far = false;
#pragma unroll
    for (int run = 0; run < kCoordsPerLane; ++run) {
      u[run] = vclamp(u[run], limits.first_u, limits.last_u);
      v[run] = vclamp(v[run], limits.first_v, limits.last_v);
      F t;
      int const column = near_tap<K>(u[run], t), row = near_tap<K>(v[run], t);
      bool const is_far = max(vabs(u[run]), vabs(v[run])) >= F(1 << 20);  // where near_tap is none
      bool const has_taps = !filled || (unsigned(column + tile.u + K - 1) < unsigned(p.x_axis.size + K - 1) &&
                                        unsigned(row + tile.v + K - 1) < unsigned(p.y_axis.size + K - 1));
      if (x(run) >= int(p.grad.width) || y(run) >= int(p.grad.height) || !(has_taps || is_far)) continue;
      runs |= 1u << run;
      far |= is_far;
      box = {min(box.left, column), min(box.top, row), max(box.right, column), max(box.bottom, row)};
    }
    box = {warp_reduce(box.left, Min()), warp_reduce(box.top, Min()), -warp_reduce(-box.right, Min()),
           -warp_reduce(-box.bottom, Min())};
    if (box.left > box.right) return false;
    far = __any_sync(0xffffffffu, far) || box.right - box.left > 64 || box.bottom - box.top > 64;
    // Vectors of four begin where those of the image do. Rows are an odd multiple of four: those of a run in other
    // banks.
    left = far ? 0 : ((box.left + tile.u) & -4) - tile.u, top = box.top, rows = box.bottom - top + K;
    columns = box.right - left + K, pitch = columns <= 20 ? 20 : ((columns + 3) & -8) | 4;
    fits = !far && rows * pitch <= Sums<F>::kCells;
    return true;
  }
};

// The runs that are left: coordinates and gradients of the next one are the first.
template <int N, class F>
struct Runs {
  F u[kCoordsPerLane], v[kCoordsPerLane], g[kCoordsPerLane][N];

  // Phase 3: the gradients of N channels; `grad` is the first row of the first one.
  template <class T>
  __device__ __forceinline__ Runs(Blocklet<F> const& blocklet, Images<T const> const& image, T const* grad) {
    auto const offset_of = [&](int run) {
      return blocklet.y(run) * int(image.row_stride) + blocklet.x(run) * int(image.step);
    };
#pragma unroll
    for (int run = 0; run < kCoordsPerLane; ++run)
#pragma unroll
      for (int k = 0; k < N; ++k)
        g[run][k] = blocklet.has_taps(run) ? F(read(grad[k * image.channel_stride + offset_of(run)])) : F(0);
#pragma unroll
    for (int run = 0; run < kCoordsPerLane; ++run) u[run] = blocklet.u[run], v[run] = blocklet.v[run];
  }
  __device__ __forceinline__ void next() {
#pragma unroll
    for (int next = 1; next < kCoordsPerLane; ++next) {
      u[next - 1] = u[next], v[next - 1] = v[next];
#pragma unroll
      for (int k = 0; k < N; ++k) g[next - 1][k] = g[next][k];
    }
  }
};

// Phase 4: adds all runs to the sums of a warp. Pixels with a tap in common take turns: each writes its index to the
// cell of its first tap, and the one whose index stays adds. Only the warp itself accesses its sums: plain additions,
// where atomics on floats are loops.
template <int K, int N, class F>
__device__ __forceinline__ void add_in_turns(Blocklet<F> const& blocklet, Runs<N, F>& runs, F* sums, int* numbers) {
  constexpr int kCells = Sums<F>::kCells;
  int const lane = threadIdx.x % 32, pitch = blocklet.pitch;
  __syncwarp();  // before the previous sums are overwritten
  for (int i = 4 * lane; i < blocklet.rows * pitch; i += 4 * 32)
#pragma unroll
    for (int k = 0; k < N; ++k) *reinterpret_cast<Vector<F, 4>*>(sums + k * kCells + i) = {};
  __syncwarp();
#pragma unroll 1
  for (int run = 0; run < kCoordsPerLane; ++run, runs.next()) {
    F tx, ty, wx[K], wy[K];
    int const column = near_tap<K>(runs.u[0], tx), row = near_tap<K>(runs.v[0], ty);
    int const at = (row - blocklet.top) * pitch + (column - blocklet.left);
    tap_weights(tx, wx);
    tap_weights(ty, wy);
    bool waits = blocklet.has_taps(run);
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
            for (int k = 0; k < N; ++k) sum[k * kCells] += weight * runs.g[0][k];
          __syncwarp();
        }
      waits = waits && !adds;
    } while (__any_sync(0xffffffffu, waits));
  }
}

// Phase 5: adds the sums to N channels in memory, by vectors where all of the box is in the image.
template <int N, class T, class F>
__device__ __forceinline__ void add_to_image(SampleImageBackward<T> const& p, Tile<F> const& tile,
                                             Blocklet<F> const& blocklet, F const* sums, F* to) {
  constexpr int kCells = Sums<F>::kCells;
  int const lane = threadIdx.x % 32, lane_x = lane % 8, lane_y = lane / 8;
  int const rows = blocklet.rows, columns = blocklet.columns, pitch = blocklet.pitch;
  int const stride = int(p.grad_x.row_stride), left = blocklet.left + tile.u, top = blocklet.top + tile.v;
  if (stride % 4 == 0 && left >= 0 && top >= 0 && left + columns <= p.x_axis.size && top + rows <= p.y_axis.size) {
    for (int row = lane_y; row < rows; row += 4)
      for (int column = 4 * lane_x; column < columns; column += 32)
#pragma unroll
        for (int k = 0; k < N; ++k) {
          Vector<F, 4> const four = *reinterpret_cast<Vector<F, 4> const*>(sums + k * kCells + row * pitch + column);
          if (four.v[0] != 0 || four.v[1] != 0 || four.v[2] != 0 || four.v[3] != 0)
            add_four(to + k * p.grad_x.channel_stride + ((top + row) * stride + left + column), four);
        }
    return;
  }
  for (int row = 0; row < rows; ++row) {
    int const y = pixel_at(p.y_axis, top + row);
    if (unsigned(y) >= unsigned(p.y_axis.size)) continue;
    for (int column = lane; column < columns; column += 32) {
      int const x = pixel_at(p.x_axis, left + column);
      if (unsigned(x) >= unsigned(p.x_axis.size)) continue;
#pragma unroll
      for (int k = 0; k < N; ++k) {
        F const sum = sums[k * kCells + row * pitch + column];
        if (sum != 0) atomicAdd(to + k * p.grad_x.channel_stride + (y * stride + x), sum);
      }
    }
  }
}

template <int K, class T>
__device__ __forceinline__ void scatter_block(SampleImageBackward<T> const& p, TileGrid const& tiles) {
  using F = Compute<T>;
  __shared__ Tile<F> tile;
  extern __shared__ __align__(16) unsigned char shared_sums[];
  tile.init_for_block(tiles, p);
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int const sums_per_warp = Sums<F>::channels(p.grad.channels) * Sums<F>::kCells;
  F* const sums = reinterpret_cast<F*>(shared_sums) + warp * sums_per_warp;
  int* const numbers = reinterpret_cast<int*>(reinterpret_cast<F*>(shared_sums) + kScatterWarps * sums_per_warp) +
                       warp * Sums<F>::kCells;
  TileCoords<F> const coords(p.coords, tile);
  CoordLimits<F> const limits(p, tile);
#pragma unroll 1
  for (int index = warp; index < kTile * kTile / (kBlockletWidth * kBlockletHeight); index += kScatterWarps) {
    Blocklet<F> blocklet(tile, index, lane % 8, lane / 8);
    blocklet.find_coords(p, tile, coords);
    if (!blocklet.template find_box<K>(p, tile, limits)) continue;
    for_each_channel_group<Sums<F>::kChannels>(p.grad.channels, [&](int first, auto channels) {
      constexpr int N = channels.value;
      F* const to = p.sums + tile.image * p.grad_x.batch_stride + first * p.grad_x.channel_stride;
      Runs<N, F> runs(blocklet, p.grad, p.grad.row(tile.b, first, 0));
      if (blocklet.fits) {
        add_in_turns<K>(blocklet, runs, sums, numbers);
        add_to_image<N>(p, tile, blocklet, sums, to);
        return;
      }
#pragma unroll 1
      for (int run = 0; run < kCoordsPerLane; ++run, runs.next())
        if (blocklet.has_taps(run)) scatter_pixel<K, N>(p, to, runs.u[0], runs.v[0], tile, runs.g[0]);
    });
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
