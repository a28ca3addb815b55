// The gradient to the image on CUDA, in one of two ways.
//
// Gather: a pixel of the source looks for the places that have it as a tap. By the map the other way round they lie in
// the quadrangle that its surroundings go to. The same bits every run, nothing is written twice. For warps by a matrix
// whose outside is the fill: else pixels at the rim would be taps of places all around.
//
// Scatter: every place adds to its taps by atomics, into zeros.
#include "patch.cuh"

namespace kv::cuda {
namespace {

// --- gather
// --------------------------------------------------------------------------------------------------------

// Of a row or column of places: first, last + 1.
struct Range {
  int first, last;
  __device__ __forceinline__ Range within(Range const& other) const {
    return {max(first, other.first), min(last, other.last)};
  }
};

// The places near which an area of the source is, all of them if the horizon runs through it.
template <class F>
__device__ __forceinline__ void candidates(Homography<F> const& back, F left, F top, F right, F bottom, int64_t height,
                                           int64_t width, Range& rows, Range& columns) {
  F low_u = F(width), high_u = -1, low_v = F(height), high_v = -1;
  int signs = 0;
#pragma unroll
  for (int corner = 0; corner < 4; ++corner) {
    F const x = corner & 1 ? right : left, y = corner & 2 ? bottom : top;
    F u, v;
    back.at(x, y, u, v);
    signs += back.affine || back.weight(x, y) > 0 ? 1 : -1;
    low_u = min(low_u, u);
    high_u = max(high_u, u);
    low_v = min(low_v, v);
    high_v = max(high_v, v);
  }
  bool const all = (signs != 4 && signs != -4) || !(high_u - low_u < F(width)) || !(high_v - low_v < F(height));
  // A margin for what rounding does to places on the way there and back.
  F const margin = F(0.01) + F(1e-6) * F(width + height);
  columns = {all ? 0 : max(0, int(::ceil(low_u - margin))),
             all ? int(width) : int(min(F(width), ::floor(high_u + margin) + 1))};
  rows = {all ? 0 : max(0, int(::ceil(low_v - margin))),
          all ? int(height) : int(min(F(height), ::floor(high_v + margin) + 1))};
}

template <class F, int K>
__global__ void __launch_bounds__(kThreads, sizeof(F) == 8 ? 2 : 5)
    gather_tiles(__grid_constant__ SampleTranspose<F> const p, Tiles tiles, bool aligned) {
  using Gradients = Patch<F>;
  __shared__ Tile<F> tile;
  __shared__ Homography<F> shared_back;
  __shared__ Range shared_rows[kTileRow], shared_columns[kTileRow];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  F const reach = F(K) / 2;
  if (threadIdx.x == 0) tile.open(tiles, p.places);
  if (threadIdx.x == 32) {
    unsigned const sample = blockIdx.x / (tiles.across * tiles.down);
    shared_back = inverse_homography(p.places.matrices + sample * p.places.matrix_stride, p.places.use);
  }
  __syncthreads();
  if (threadIdx.x < kTileRow) {
    int const left = tile.x + int(threadIdx.x) * kTile;
    candidates(shared_back, left - reach, tile.y - reach, min(left + kTile, width) - 1 + reach,
               min(tile.y + kTile, height) - 1 + reach, p.grad.height, p.grad.width, shared_rows[threadIdx.x],
               shared_columns[threadIdx.x]);
  }
  __syncthreads();
  Homography<F> const map = tile.map, back = shared_back;
  int64_t const b = tile.b;
  Axis<F> const x_axis{int(p.grad.width), Padding::fill, true}, y_axis{int(p.grad.height), Padding::fill, true};
#pragma unroll 1
  for (int i = 0; i < int(tiles.row) && tile.x + i * kTile < width; ++i) {
    int const x = tile.x + i * kTile + column_in_tile();
    Range rows = shared_rows[i], columns = shared_columns[i];
    Gradients const patch(shared_pixels, {columns.first, rows.first, columns.last - 1, rows.last - 1});
    bool const patched = patch.fits && columns.first < columns.last && rows.first < rows.last;
    in_groups<Gradients::kChannels>(p.grad.channels, [&](int first, auto number) {
      constexpr int N = number.value;
      if (patched) patch.template load<N>(p.grad, b, first, x_axis, y_axis, aligned, [](int) { return F(0); });
      F const* const plane = p.grad.row(b, first, 0);
#pragma unroll 1
      for (int y = tile.y + row_in_tile(); x < width && y < min(tile.y + kTile, height); y += kRunRows) {
        candidates(back, x - reach, y - reach, x + reach, y + reach, p.grad.height, p.grad.width, rows, columns);
        F sums[N] = {};
        // Of gradients at rows and columns from an origin on, those of the next channel `apart`.
        auto const gather = [&](F const* origin, int64_t row, int64_t step, int64_t apart) {
#pragma unroll 1
          for (int v = rows.first; v < rows.last; ++v)
#pragma unroll 1
            for (int u = columns.first; u < columns.last; ++u) {
              F place_x, place_y;
              map.at(F(u), F(v), place_x, place_y);
              F const weight = weight_at<K>(place_x, x) * weight_at<K>(place_y, y);
              if (weight == 0) continue;
              F const* const grad = origin + v * row + u * step;
#pragma unroll
              for (int k = 0; k < N; ++k) sums[k] += weight * grad[k * apart];
            }
        };
        if (patched) {
          rows = rows.within(shared_rows[i]);  // what rounding adds to these is nothing's tap
          columns = columns.within(shared_columns[i]);
          gather(patch.pixels - (patch.top * Gradients::kPitch + patch.left), Gradients::kPitch, 1, Gradients::kSize);
        } else {
          gather(plane, p.grad.row_stride, p.grad.step, p.grad.channel_stride);
        }
#pragma unroll
        for (int k = 0; k < N; ++k) p.grad_x.row(b, first + k, y)[x] = sums[k];
      }
    });
  }
}

// --- scatter
// ------------------------------------------------------------------------------------------------------

template <class F, int K>
__global__ void __launch_bounds__(kThreads) scatter_tiles(__grid_constant__ SampleTranspose<F> const p, Tiles tiles) {
  __shared__ Tile<F> tile;
  if (threadIdx.x == 0) tile.open(tiles, p.places);
  __syncthreads();
  PlacesOf<F> const places(p.places, tile);
  int64_t const b = tile.b;
  int const x = tile.x + column_in_tile();
  F* const planes = p.grad_x.row(b, 0, 0);
#pragma unroll 1
  for (int y = tile.y + row_in_tile(); x < p.grad.width && y < min(tile.y + kTile, int(p.grad.height)); y += kRunRows) {
    F u, v;
    places.at(y, x, u, v);
    Window<K, F> const window(p, u, v);
    F wx[K], wy[K];
    tap_weights(window.tx, wx);
    tap_weights(window.ty, wy);
    F const* const grad = p.grad.row(b, 0, y) + x * p.grad.step;
    window.for_each(p, p.grad_x.row_stride, 1, [&](int j, int i, int64_t at) {
      F const weight = wx[i] * wy[j];
      if (at < 0 || weight == 0) return;
      for (int c = 0; c < p.grad.channels; ++c)
        atomicAdd(planes + c * p.grad_x.channel_stride + at, weight * grad[c * p.grad.channel_stride]);
    });
  }
}

}  // namespace

template <class F>
int sample_transpose(SampleTranspose<F> const& p, CUstream_st* stream) {
  bool const gathers = p.places.matrices && p.x_axis.padding == Padding::fill;
  auto const over = [](auto const& images, int row) { return Tiles(images.batch, images.height, images.width, row); };
  Tiles const tiles =
      gathers ? over(p.grad_x, tile_row(p.grad_x.batch, p.grad_x.height, p.grad_x.width)) : over(p.grad, 1);
  if (!gathers) {
    int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
    cudaError_t const error = cudaMemsetAsync(p.grad_x.data, 0, size_t(count) * sizeof(F), stream);
    if (error != cudaSuccess) return error;
  }
  with_taps(p.interpolation, [&](auto taps) {
    constexpr int K = taps.value;
    size_t const bytes = Patch<F>::bytes(p.grad.channels);
    if (gathers)
      gather_tiles<F, K><<<tiles.count, kThreads, bytes, stream>>>(p, tiles, in_packs(p.grad));
    else
      scatter_tiles<F, K><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(sample_transpose, SampleTranspose)

}  // namespace kv::cuda
