// The gradient of the image on CUDA, by gathering: a pixel of the source reads the gradients of all output pixels that
// have it as a tap. The inverse map gives their neighborhood, which is small and of equal size for all pixels of a
// tile. Results are deterministic, and each is written once. It serves warps by a matrix with fill padding; with other
// paddings, border pixels would be taps of all output pixels out of bounds.
#pragma once

#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

// The number of adjacent candidates that are tested together: for a rotation without scaling, all of them.
template <int K>
constexpr int kCandidatesPerStep = K == 4 ? 3 : K + 1;

// A tile of the source, in shared memory: the output pixels that may have its pixels as taps.
template <class F>
struct GatherTile {
  Homography<F> map, back;  // from coords, which count from (u, v), to pixels, which count from (x, y), and back
  int64_t b, image;
  int x, y, u, v;
  F reach_x, reach_y;  // from the output coordinate of a pixel
  int columns, rows;   // of candidates, from there on
  TapBounds coords;    // candidates of all pixels

  // For a located tile of a warp from the source to the output. By four threads of the first half of a warp, of which
  // each takes a corner, and the whole warp. Where the horizon is near, all output pixels are candidates.
  template <int K, class T>
  __device__ __forceinline__ void init(Tile<F> tile, SampleImageBackward<T> const& p) {
    constexpr F reach = F(K) / 2;
    // Half of the warp inverts, half does not: both take as long as one.
    MatrixUse const use = threadIdx.x & 16 ? p.coords.use : inverse_use(p.coords.use);
    Homography<double> const way = homography(p.coords.matrices + tile.b * p.coords.matrix_stride, use);
    Homography<double> whole;
#pragma unroll
    for (int i = 0; i < 9; ++i) whole.m[i] = shuffle_xor(way.m[i], 16);
    whole.affine = way.affine;  // both ways
    tile.bind(way, use.source);
    b = tile.b;
    image = tile.image;
    x = tile.x;
    y = tile.y;
    u = tile.u;
    v = tile.v;
    back = tile.map;
    F const at_x = F(threadIdx.x & 1 ? min(kTile, int(p.grad_x.width) - x) - 1 : 0);
    F const at_y = F(threadIdx.x & 2 ? min(kTile, int(p.grad_x.height) - y) - 1 : 0);
    F corner_u, corner_v, low = back.weight(at_x, at_y), high = low;
    back.apply(at_x, at_y, corner_u, corner_v);
    reach_x = reach_y = 0;
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      F const to_x = at_x + (i & 1 ? reach : -reach), to_y = at_y + (i & 2 ? reach : -reach);
      F to_u, to_v;
      back.apply(to_x, to_y, to_u, to_v);
      reach_x = max(reach_x, vabs(to_u - corner_u));
      reach_y = max(reach_y, vabs(to_v - corner_v));
      low = min(low, back.weight(to_x, to_y));
      high = max(high, back.weight(to_x, to_y));
    }
    struct Corners {
      F reach_x, reach_y, low, high;
    };
    auto const of_all =
        warp_reduce<4>(Corners{reach_x, reach_y, low, high}, [](Corners const& a, Corners const& b) -> Corners {
          return {max(a.reach_x, b.reach_x), max(a.reach_y, b.reach_y), min(a.low, b.low), max(a.high, b.high)};
        });
    reach_x = of_all.reach_x;
    reach_y = of_all.reach_y;
    low = of_all.low;
    high = of_all.high;
    // A distance that goes from p to p + d is a linear function of p over the weights at both: so much it may be more
    // between the corners.
    F const min_weight = min(vabs(low), vabs(high)), max_weight = max(vabs(low), vabs(high));
    F const more = back.affine ? F(1) : max_weight / min_weight * (max_weight / min_weight);
    reach_x = reach_x * more + F(kCoordRounding);
    reach_y = reach_y * more + F(kCoordRounding);
    coords = TapBounds::empty();
    coords.template add<2>(corner_u - reach_x, corner_v - reach_y, F(kCoordRounding),
                           F(1 << 20));  // near the first candidates
    coords.template merge_lanes<4>();
    int const width = int(p.grad.width), height = int(p.grad.height);
    bool const near = low * high > 0 && reach_x < F(width) && reach_y < F(height) && coords.right < INT_MAX / 4;
    columns = near ? int(2 * reach_x) + 1 : width;
    rows = near ? int(2 * reach_y) + 1 : height;
    if (near) {
      coords.move(u, v);
      coords.right += (columns + kCandidatesPerStep<K> - 1) / kCandidatesPerStep<K> * kCandidatesPerStep<K> - 1;
      coords.bottom += rows - 1;
    } else {
      coords = TapBounds::all();
      reach_x = reach_y = 0;
      u = v = 0;
#pragma unroll
      for (int i = 0; i < 9; ++i) back.m[i] = i == 8;
      back.affine = true;
    }
    map = bind_to_tile<F>(whole, u, v, x, y);
  }
  // Whether no output pixel has a pixel of the tile as a tap.
  __device__ __forceinline__ bool is_unread(int width, int height) const {
    return coords.right < 0 || coords.left >= width || coords.bottom < 0 || coords.top >= height;
  }
};

// The next integer.
__device__ __forceinline__ int above(float x, float& whole) {
  constexpr float kLarge = 0x1.8p23f;
  float const sum = __fadd_ru(x, kLarge);
  whole = sum - kLarge;
  return __float_as_int(sum) - 0x4b400000;
}
__device__ __forceinline__ int above(double x, double& whole) {
  whole = ::ceil(x);
  return int(whole);
}

// 1 / x, of a weight; NaN, which is no valid coordinate, where there is none.
__device__ __forceinline__ float reciprocal_or_nan(float x) {
  float y;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return fmaf(y, fmaf(-x, y, 1), y);
}
__device__ __forceinline__ double reciprocal_or_nan(double x) { return 1 / x; }

// Writes the gradient of a pixel, or adds it to that of earlier samples.
template <bool kAdds, class T, class F>
__device__ __forceinline__ void put(T& to, F sum) {
  if constexpr (kAdds)
    to += sum;
  else
    to = round_to<T>(sum);
}

// The gradient of N channels of a pixel (x, y) in its tile, from the gradients where they are.
template <int K, int N, bool kAdds, class T, class F, class Out>
__device__ __noinline__ void gather_unstaged(SampleImageBackward<T> const& p, GatherTile<F> const& tile,
                                             Images<Out> const& out, int first, int y, int x) {
  F center_u, center_v, first_u, first_v, sums[N] = {};
  tile.back.apply(F(x), F(y), center_u, center_v);
  int const u0 = above(center_u - tile.reach_x, first_u), v0 = above(center_v - tile.reach_y, first_v);
  int const width = int(p.grad.width), height = int(p.grad.height);
  for (int v = max(v0, -tile.v); v < min(v0 + tile.rows, height - tile.v); ++v)
    for (int u = max(u0, -tile.u); u < min(u0 + tile.columns, width - tile.u); ++u) {
      F coord_x, coord_y;
      tile.map.apply(F(u), F(v), coord_x, coord_y);
      F const weight = weight_at<K>(coord_x, x) * weight_at<K>(coord_y, y);
      if (weight == 0) continue;
      T const* const grad = p.grad.row(tile.b, first, v + tile.v) + (u + tile.u) * p.grad.step;
#pragma unroll
      for (int k = 0; k < N; ++k) sums[k] += weight * F(read(grad[k * p.grad.channel_stride]));
    }
#pragma unroll
  for (int k = 0; k < N; ++k) put<kAdds>(out.row(tile.image, first + k, tile.y + y)[tile.x + x], sums[k]);
}

// Zeros for a tile of all channels. `aligned`: rows are vectors of 16 bytes; a warp writes adjacent pixels otherwise.
template <class T>
__device__ __forceinline__ void clear_tile(Images<T> const& to, int64_t b, int x0, int y0, bool aligned) {
  auto const clear = [&](auto zero) {
    constexpr int kPixels = int(sizeof(zero) / sizeof(T)), kAcross = kTile / kPixels;
    int const x = x0 + threadIdx.x % kAcross * kPixels, width = int(to.width), bottom = min(y0 + kTile, int(to.height));
    for (int y = y0 + threadIdx.x / kAcross; x < width && y < bottom; y += kThreads / kAcross)
      for (int c = 0; c < to.channels; ++c) *reinterpret_cast<decltype(zero)*>(to.row(b, c, y) + x) = zero;
  };
  aligned ? clear(Vector<T, 16 / int(sizeof(T))>{}) : clear(T{});
}

// The gradients of a tile by one sample: `channels` of them from `begin` on, to `out`.
template <int K, bool kAdds, bool Aligned, class T, class F, class Out>
__device__ __forceinline__ void gather_tile(SampleImageBackward<T> const& p, GatherTile<F> const& tile,
                                            Images<Out> const& out, int begin, int channels, void* shared_pixels) {
  using Gradients = SourceTile<T, Aligned>;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  Axis<F> const x_axis{int(p.grad.width), Padding::fill, true}, y_axis{int(p.grad.height), Padding::fill, true};
  Gradients source_tile(shared_pixels, tile.coords, p.grad);
  int const x = column_in_tile<T>();
  for_each_channel_group<Gradients::kChannels>(channels, [&](int group, auto number) {
    constexpr int N = number.value;
    int const first = begin + group;
    if (source_tile.fits) source_tile.template load<N>(p.grad, tile.b, first, x_axis, y_axis, [](int) { return T{}; });
    if (tile.x + x >= width) return;
    F poison = 0;  // NaN where one of the gradients is no finite number: it may have had no weight
    Out* planes[N];
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = out.row(tile.image, first + k, 0);
    int to = (tile.y + row_in_tile<T>()) * width + tile.x + x;
    T const* const origin = source_tile.origin(tile.u, tile.v);
    int const pitch = source_tile.pitch(), plane = source_tile.plane();
#pragma unroll 1
    for (int y = row_in_tile<T>(); source_tile.fits && y < min(kTile, height - tile.y);
         y += kRowStep, to += kRowStep * width) {
      F center_u, center_v, first_u, first_v, sums[N] = {};
      tile.back.apply(F(x), F(y), center_u, center_v);
      int const u = above(center_u - tile.reach_x, first_u), v = above(center_v - tile.reach_y, first_v);
      auto const gather = [&](auto affine) {
        T const* row = origin + (v * pitch + u);
        F const(&m)[9] = tile.map.m;
        F from_x = first_u * m[0] + (first_v * m[1] + m[2]), from_y = first_u * m[3] + (first_v * m[4] + m[5]);
        // Of an affine map coordinates count from the pixel: one addition less for each. Not those of the nearest
        // pixel, where halves go to even ones.
        int const pixel_x = K > 1 && affine.value ? 0 : x, pixel_y = K > 1 && affine.value ? 0 : y;
        from_x -= F(x - pixel_x);
        from_y -= F(y - pixel_y);
        F from_weight = first_u * m[6] + (first_v * m[7] + m[8]);
#pragma unroll 1
        for (int j = 0; j < tile.rows; ++j, row += pitch) {
          F coord_x = from_x, coord_y = from_y, weight = from_weight;
          T const* grad = row;
#pragma unroll 1
          for (int i = 0; i < tile.columns; i += kCandidatesPerStep<K>)
#pragma unroll
            for (int n = 0; n < kCandidatesPerStep<K>; ++n, ++grad) {
              F const scale = affine.value ? F(1) : reciprocal_or_nan(weight);
              F const tap_weight = weight_at<K>(coord_x * scale, pixel_x) * weight_at<K>(coord_y * scale, pixel_y);
#pragma unroll
              for (int k = 0; k < N; ++k) sums[k] += tap_weight * F(read(grad[k * plane]));
              coord_x += m[0];
              coord_y += m[3];
              if constexpr (!affine.value) weight += m[6];
            }
          from_x += m[1];
          from_y += m[4];
          from_weight += m[7];
        }
      };
      tile.map.affine ? gather(std::true_type{}) : gather(std::false_type{});
      if constexpr (kAdds) {
        F own = 0;
#pragma unroll
        for (int k = 0; k < N; ++k) own += sums[k] * 0;
        if (own != 0) {  // what is added cannot be written again afterwards
          gather_unstaged<K, N, kAdds>(p, tile, out, first, y, x);
          continue;
        }
      }
#pragma unroll
      for (int k = 0; k < N; ++k) {
        if constexpr (!kAdds) poison += sums[k] * 0;
        put<kAdds>(planes[k][to], sums[k]);
      }
    }
    if (!source_tile.fits || poison != 0)
#pragma unroll 1
      for (int y = row_in_tile<T>(); y < min(kTile, height - tile.y); y += kRowStep)
        gather_unstaged<K, N, kAdds>(p, tile, out, first, y, x);
  });
}

// One sample an image: the gradients of a block's tiles.
template <int K, bool Aligned, class T>
__device__ __forceinline__ void gather_block(SampleImageBackward<T> const& p, TileGrid const& tiles, bool aligned_out) {
  using F = Compute<T>;
  __shared__ GatherTile<F> shared_tiles[kMaxTilesPerBlock];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  if (threadIdx.x < 32) {
    int const number = threadIdx.x / 4 % kMaxTilesPerBlock;
    Tile<F> located;
    located.locate(tiles, number);
    GatherTile<F> tile;
    tile.template init<K>(located, p);
    if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMaxTilesPerBlock) shared_tiles[number] = tile;
  }
  __syncthreads();
#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block) && shared_tiles[number].x < int(p.grad_x.width); ++number) {
    GatherTile<F> const& tile = shared_tiles[number];
    if (tile.is_unread(int(p.grad.width), int(p.grad.height)))
      clear_tile(p.grad_x, tile.b, tile.x, tile.y, aligned_out);
    else
      gather_tile<K, false, Aligned>(p, tile, p.grad_x, 0, p.grad.channels, shared_pixels);
  }
}

}  // namespace
}  // namespace kv::geometry::cuda
