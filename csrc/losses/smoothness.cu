// Smoothness of inverse depth on CUDA: each thread traverses a column downwards. Neighbors are read again, from the
// cache, by the threads whose pixels they are.
#include "core/row_sums.cuh"
#include "smoothness.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = kSmoothColumns;
static_assert(kThreads == kSumThreads);

// The part of a sample that a block processes, and the column of a thread.
template <class T>
struct Column {
  using F = Compute<T>;
  int64_t sample;
  int x, y, end, width, height;  // rows y ... end - 1
  T const *depth, *image;        // the pixel in row y
  int64_t depth_stride, image_stride, channel_stride;
  int channels;
  F exponent;

  __device__ __forceinline__ Column(DepthAndImage<T> const& p, unsigned across, unsigned down)
      : width(int(p.depth.width)),
        height(int(p.depth.height)),
        depth_stride(p.depth.row_stride),
        image_stride(p.image.row_stride),
        channel_stride(p.channel_stride()),
        channels(int(p.channels)),
        exponent(p.exponent()) {
    unsigned const line = blockIdx.x / across, s = line / down;
    sample = s;
    x = int(blockIdx.x - line * across) * kSmoothColumns + int(threadIdx.x);
    y = int(line - s * down) * kSmoothRows;
    end = min(y + kSmoothRows, height);
    depth = p.depth.row(sample, y) + x;
    image = p.image.row(sample * p.channels, y) + x;
  }
  __device__ __forceinline__ void next_row() { ++y, depth += depth_stride, image += image_stride; }
  // The offsets of the neighbors; 0 where there is none.
  __device__ __forceinline__ int to_left() const { return x > 0 ? -1 : 0; }
  __device__ __forceinline__ int to_right() const { return x + 1 < width ? 1 : 0; }
  __device__ __forceinline__ bool has_below() const { return y + 1 < height; }

  // The smoothness term: `apart` is the sum of the image's absolute differences, and `difference` that of the depth.
  // With `signs`, the sign of the difference replaces its absolute value.
  __device__ __forceinline__ F edge_term(bool exists, F apart, F difference, F weight, bool signs) const {
    if (!exists) return F(0);
    return (signs ? sign_of(difference) : F(fabs(difference))) * fast_exp2(apart * exponent) * weight;
  }
  // The term of the edge to the row below.
  __device__ __forceinline__ F below(F weight, bool signs) const {
    F apart = 0;
#pragma unroll 4
    for (int c = 0; c < channels; ++c) {
      T const* const at = image + c * channel_stride;
      apart += fabs(read(at[image_stride]) - read(*at));
    }
    return edge_term(true, apart, read(depth[depth_stride]) - read(*depth), weight, signs);
  }
};

template <class T>
__global__ void __launch_bounds__(kThreads)
    sum_roughness(__grid_constant__ Smoothness<T> const p, unsigned across, unsigned down) {
  using F = Compute<T>;
  Column<T> at(p.of, across, down);
  F sum = 0;
  if (at.x < at.width) {
    int const right = at.to_right();
#pragma unroll 2
    for (; at.y < at.end; at.next_row()) {
      bool const has_below = at.has_below();
      int64_t const under = has_below ? at.image_stride : 0;
      F along_x = 0, along_y = 0;
#pragma unroll 4
      for (int c = 0; c < at.channels; ++c) {
        T const* const pixel = at.image + c * at.channel_stride;
        F const own = read(*pixel);
        along_x += fabs(read(pixel[right]) - own);
        along_y += fabs(read(pixel[under]) - own);
      }
      F const own = read(*at.depth), adjacent = read(at.depth[right]);
      F const below = read(at.depth[has_below ? at.depth_stride : 0]);
      sum += at.edge_term(right != 0, along_x, adjacent - own, p.of.along_x, false) +
             at.edge_term(has_below, along_y, below - own, p.of.along_y, false);
    }
  }
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    roughness_backward(__grid_constant__ SmoothnessBackward<T> const p, unsigned across, unsigned down) {
  using F = Compute<T>;
  Column<T> at(p.of, across, down);
  if (at.x >= at.width) return;
  F const g = p.grad[at.sample], of_x = g * p.of.along_x, of_y = g * p.of.along_y,
          inverse_channels = F(1) / F(at.channels);
  bool const signs = !p.of_image;
  int const left = at.to_left(), right = at.to_right();
  F up = 0;
  if (at.y > 0) {
    Column<T> above = at;
    above.depth -= at.depth_stride, above.image -= at.image_stride;
    up = above.below(of_y, signs);
  }
#pragma unroll 1
  for (; at.y < at.end; at.next_row()) {
    F to_left = 0, to_right = 0;
#pragma unroll 4
    for (int c = 0; c < at.channels; ++c) {
      T const* const pixel = at.image + c * at.channel_stride;
      F const own = read(*pixel);
      to_left += fabs(own - read(pixel[left]));
      to_right += fabs(read(pixel[right]) - own);
    }
    F const own = read(*at.depth);
    F const before = at.edge_term(left != 0, to_left, own - read(at.depth[left]), of_x, signs);
    F const behind = at.edge_term(right != 0, to_right, read(at.depth[right]) - own, of_x, signs);
    F const down_edge = at.has_below() ? at.below(of_y, signs) : F(0);
    if (!p.of_image) {
      p.out.row(at.sample, at.y)[at.x] = round_to<T>((before - behind) + (up - down_edge));
    } else {
      int64_t const over = at.y > 0 ? -at.image_stride : 0, under = at.has_below() ? at.image_stride : 0;
#pragma unroll 2
      for (int c = 0; c < at.channels; ++c) {
        T const* const pixel = at.image + c * at.channel_stride;
        F const middle = read(*pixel);
        auto const part = [&](F edge, int64_t to) { return part_of(edge, F(read(pixel[to]) - middle)); };
        F const sum = (part(before, left) + part(behind, right)) + (part(up, over) + part(down_edge, under));
        p.out.row(at.sample * at.channels + c, at.y)[at.x] = round_to<T>(sum * inverse_channels);
      }
    }
    up = down_edge;
  }
}

struct Blocks {
  unsigned across, down, count;
  template <class T>
  explicit Blocks(Planes<T> const& p)
      : across(unsigned(ceil_div(p.width, kSmoothColumns))),
        down(unsigned(ceil_div(p.height, kSmoothRows))),
        count(unsigned(p.count() * across * down)) {}
};

}  // namespace

template <class T>
int smoothness(Smoothness<T> const& p, CUstream_st* stream) {
  Blocks const blocks(p.of.depth);
  sum_roughness<<<blocks.count, kThreads, 0, stream>>>(p, blocks.across, blocks.down);
  return sum_chunks(p.partial, p.of.depth.count(), p.chunks, p.sums, stream);
}

template <class T>
int smoothness_backward(SmoothnessBackward<T> const& p, CUstream_st* stream) {
  Blocks const blocks(p.of.depth);
  roughness_backward<<<blocks.count, kThreads, 0, stream>>>(p, blocks.across, blocks.down);
  return cudaGetLastError();
}

KV_INSTANTIATE(smoothness, Smoothness)
KV_INSTANTIATE(smoothness_backward, SmoothnessBackward)

}  // namespace kv::losses::cuda
