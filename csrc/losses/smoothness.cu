// Smoothness of inverse depth on CUDA: each thread goes down adjacent columns. Neighbors are read again, from the
// cache, by the threads whose pixels they are.
#include "core/row_sums.cuh"
#include "smoothness.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = kSmoothThreads;
constexpr int kVector = 4, kAnywhere = 2;  // columns of a thread where rows are aligned, and of others
static_assert(kThreads == kSumThreads);

// The pixels of a sample that a thread processes: P columns from x on and the rows y ... end - 1. kVector columns are a
// vector of aligned rows; others are read and written one by one. C is the number of channels of the image, so that the
// loads of all of them are in flight at the same time; 0 serves any number, one after the other.
template <class T, int P, int C>
struct Columns {
  using F = Compute<T>;
  static constexpr bool kAligned = P == kVector;
  int64_t sample;
  int x, y, end, width, height;
  T const *depth, *image;  // the first pixel in row y
  int64_t depth_stride, image_stride, channel_stride;
  int channels;
  F exponent;

  __device__ __forceinline__ Columns(DepthAndImage<T> const& p, unsigned across, unsigned blocks)
      : width(int(p.depth.width)),
        height(int(p.depth.height)),
        depth_stride(p.depth.row_stride),
        image_stride(p.image.row_stride),
        channel_stride(p.channel_stride()),
        channels(C > 0 ? C : int(p.channels)),
        exponent(p.exponent()) {
    unsigned const s = blockIdx.x / blocks, i = (blockIdx.x - s * blocks) * kThreads + threadIdx.x, strip = i / across;
    sample = s;
    x = int(i - strip * across) * P;
    y = int(strip) * kSmoothRows;
    end = min(y + kSmoothRows, height);
    depth = p.depth.row(sample, y) + x;
    image = p.image.row(sample * p.channels, y) + x;
  }
  __device__ __forceinline__ bool is_empty() const { return y >= height; }
  __device__ __forceinline__ void next_row() { ++y, depth += depth_stride, image += image_stride; }
  // The offsets of the neighbors; 0 where there is none.
  __device__ __forceinline__ int to_left() const { return x > 0 ? -1 : 0; }
  __device__ __forceinline__ int to_right() const { return x + P < width ? P : 0; }
  __device__ __forceinline__ bool has_below() const { return y + 1 < height; }
  __device__ __forceinline__ bool has(int j) const { return kAligned || x + j < width; }
  // Whether column x + j and the one to its left are both in bounds.
  __device__ __forceinline__ bool has_edge(int j) const {
    return (j > 0 || x > 0) && ((kAligned && j < P) || x + j < width);
  }

  // The smoothness term: `apart` is the sum of the image's absolute differences, and `difference` that of the depth.
  // With `signs`, the sign of the difference replaces its absolute value.
  __device__ __forceinline__ F edge_term(bool exists, F apart, F difference, F weight, bool signs) const {
    if (!exists) return F(0);
    return (signs ? sign_of(difference) : F(fabs(difference))) * fast_exp2(apart * exponent) * weight;
  }
  // The terms of the edges to the row below, which `exists`.
  __device__ __forceinline__ void edges_below(bool exists, F weight, bool signs, F (&terms)[P]) const {
    int64_t const image_below = exists ? image_stride : 0, depth_below = exists ? depth_stride : 0;
    F apart[P] = {}, own[P], below[P];
#pragma unroll 4
    for (int c = 0; c < channels; ++c) {
      T const* const pixels = image + c * channel_stride;
      load(pixels, own);
      load(pixels + image_below, below);
#pragma unroll
      for (int j = 0; j < P; ++j) apart[j] += fabs(below[j] - own[j]);
    }
    load(depth, own);
    load(depth + depth_below, below);
#pragma unroll
    for (int j = 0; j < P; ++j) terms[j] = edge_term(exists, apart[j], below[j] - own[j], weight, signs);
  }

  // The thread's pixels of a row, as elements `First` and following of v; the last one of the row instead of those
  // after it.
  template <int First = 0, int N>
  __device__ __forceinline__ void load(T const* pixels, F (&v)[N]) const {
    static_assert(First + P <= N);
    Vector<T, P> vector;
    if constexpr (kAligned) {
      vector = *reinterpret_cast<Vector<T, P> const*>(pixels);
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j) vector.v[j] = pixels[min(j, width - 1 - x)];
    }
#pragma unroll
    for (int j = 0; j < P; ++j) v[First + j] = read(vector.v[j]);
  }
  __device__ __forceinline__ void store(T* row, F const (&v)[P]) const {
    if constexpr (kAligned) {
      store_vector(row + x, v);
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (has(j)) row[x + j] = round_to<T>(v[j]);
    }
  }
};

template <class T, int P, int C>
__global__ void __launch_bounds__(kThreads)
    sum_roughness(__grid_constant__ Smoothness<T> const p, unsigned across, unsigned blocks) {
  using F = Compute<T>;
  Columns<T, P, C> at(p.of, across, blocks);
  F sum = 0;
  if (!at.is_empty()) {
    int const right = at.to_right();
#pragma unroll 1
    for (; at.y < at.end; at.next_row()) {
      bool const has_below = at.has_below();
      int64_t const image_below = has_below ? at.image_stride : 0, depth_below = has_below ? at.depth_stride : 0;
      F along_x[P] = {}, along_y[P] = {}, own[P + 1], below[P];
      auto const load = [&](T const* pixels, int64_t to_below) {
        at.load(pixels, own);
        own[P] = read(pixels[right]);
        at.load(pixels + to_below, below);
      };
#pragma unroll 4
      for (int c = 0; c < at.channels; ++c) {
        load(at.image + c * at.channel_stride, image_below);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          along_x[j] += fabs(own[j + 1] - own[j]);
          along_y[j] += fabs(below[j] - own[j]);
        }
      }
      load(at.depth, depth_below);
#pragma unroll
      for (int j = 0; j < P; ++j)
        sum += at.edge_term(at.has_edge(j + 1), along_x[j], own[j + 1] - own[j], p.of.along_x, false) +
               at.edge_term(has_below && at.has(j), along_y[j], below[j] - own[j], p.of.along_y, false);
    }
  }
  sum = block_sum<kSumThreads>(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T, int P, int C, bool OfImage>
__global__ void __launch_bounds__(kThreads)
    roughness_backward(__grid_constant__ SmoothnessBackward<T> const p, unsigned across, unsigned blocks) {
  using F = Compute<T>;
  Columns<T, P, C> at(p.of, across, blocks);
  if (at.is_empty()) return;
  F const g = p.grad[at.sample], of_x = g * p.of.along_x, of_y = g * p.of.along_y,
          inverse_channels = F(1) / F(at.channels);
  constexpr bool kSigns = !OfImage;
  int const left = at.to_left(), right = at.to_right();
  F above[P] = {};  // the edges to the row above
  if (at.y > 0) {
    Columns<T, P, C> upper = at;
    upper.depth -= at.depth_stride, upper.image -= at.image_stride;
    upper.edges_below(true, of_y, kSigns, above);
  }
#pragma unroll 1
  for (; at.y < at.end; at.next_row()) {
    F own[P + 2], apart[P + 1] = {}, beside[P + 1], below[P], result[P];  // beside[j]: to the left of column x + j
    auto const load = [&](T const* pixels) {
      own[0] = read(pixels[left]);
      at.template load<1>(pixels, own);
      own[P + 1] = read(pixels[right]);
    };
#pragma unroll 4
    for (int c = 0; c < at.channels; ++c) {
      load(at.image + c * at.channel_stride);
#pragma unroll
      for (int j = 0; j <= P; ++j) apart[j] += fabs(own[j + 1] - own[j]);
    }
    load(at.depth);
#pragma unroll
    for (int j = 0; j <= P; ++j) beside[j] = at.edge_term(at.has_edge(j), apart[j], own[j + 1] - own[j], of_x, kSigns);
    at.edges_below(at.has_below(), of_y, kSigns, below);
    if constexpr (!OfImage) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = (beside[j] - beside[j + 1]) + (above[j] - below[j]);
      at.store(p.out.row(at.sample, at.y), result);
    } else {
      int64_t const to_above = at.y > 0 ? -at.image_stride : 0, to_below = at.has_below() ? at.image_stride : 0;
#pragma unroll 1
      for (int c = 0; c < at.channels; ++c) {
        T const* const pixels = at.image + c * at.channel_stride;
        F upper[P], lower[P];
        load(pixels);
        at.load(pixels + to_above, upper);
        at.load(pixels + to_below, lower);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          F const middle = own[j + 1];
          F const sum = (part_of(beside[j], F(own[j] - middle)) + part_of(beside[j + 1], F(own[j + 2] - middle))) +
                        (part_of(above[j], F(upper[j] - middle)) + part_of(below[j], F(lower[j] - middle)));
          result[j] = sum * inverse_channels;
        }
        at.store(p.out.row(at.sample * at.channels + c, at.y), result);
      }
    }
#pragma unroll
    for (int j = 0; j < P; ++j) above[j] = below[j];
  }
}

// Vectors and columns across an image, and blocks of a sample.
template <int P>
struct Grid {
  unsigned across, blocks;
  template <class T>
  explicit Grid(Planes<T> const& p)
      : across(unsigned(ceil_div(p.width, P))),
        blocks(unsigned(ceil_div(across * ceil_div(p.height, kSmoothRows), kThreads))) {}
};

// Calls f with the columns of a thread and the channels of the image as constants: 3, or 0 for any number, which is
// rare, and of float64.
template <class T, class F>
void with_columns(DepthAndImage<T> const& p, bool aligned, F f) {
  std::integral_constant<int, kAnywhere> const anywhere;
  if constexpr (sizeof(T) < 8)
    // Special case, H200: 1.53 (smoothness) to 2.4 (smoothness backward) times as fast as any number.
    if (p.channels == 3) {
      std::integral_constant<int, 3> const three;
      return aligned ? f(std::integral_constant<int, kVector>{}, three) : f(anywhere, three);
    }
  f(anywhere, std::integral_constant<int, 0>{});
}

}  // namespace

template <class T>
int smoothness(Smoothness<T> const& p, CUstream_st* stream) {
  int64_t chunks = 0;
  with_columns(p.of, is_vectorizable<kVector>(p.of.depth) && is_vectorizable<kVector>(p.of.image),
               [&](auto pixels, auto channels) {
                 Grid<pixels.value> const grid(p.of.depth);
                 chunks = grid.blocks;
                 sum_roughness<T, pixels.value, channels.value>
                     <<<unsigned(p.of.depth.count()) * grid.blocks, kThreads, 0, stream>>>(p, grid.across, grid.blocks);
               });
  return sum_chunks(p.partial, p.of.depth.count(), chunks, p.sums, stream);
}

template <class T>
int smoothness_backward(SmoothnessBackward<T> const& p, CUstream_st* stream) {
  bool const aligned =
      is_vectorizable<kVector>(p.of.depth) && is_vectorizable<kVector>(p.of.image) && is_vectorizable<kVector>(p.out);
  with_columns(p.of, aligned, [&](auto pixels, auto channels) {
    Grid<pixels.value> const grid(p.of.depth);
    auto* const kernel = p.of_image ? roughness_backward<T, pixels.value, channels.value, true>
                                    : roughness_backward<T, pixels.value, channels.value, false>;
    kernel<<<unsigned(p.of.depth.count()) * grid.blocks, kThreads, 0, stream>>>(p, grid.across, grid.blocks);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(smoothness, Smoothness)
KV_INSTANTIATE(smoothness_backward, SmoothnessBackward)

}  // namespace kv::losses::cuda
