// Model inputs on CUDA, in one launch for all images. A block makes the patches of a tile, some patches wide and some
// rows of them high, of all channels:
//
//   weights of the columns and rows of the tile            in shared memory, once
//   rows of the image, resized along x                     levels (bytes) or numbers, in shared memory
//   pixels of the tile: weighted rows, normalized          in shared memory, in the order of the patches
//   copies of whole patches                                vectors of adjacent elements, once a repeat
//
// Bytes that shrink a few times have a kernel of their own, in vision_patches_bytes.cu.
#include "contrib/vision_patches.cuh"

namespace kv::contrib::cuda {
namespace {

using geometry::ResizeAxis;

constexpr int kThreads = 384, kBlocks = 3;  // of a multiprocessor at once
constexpr int kColumns = 128;               // of a tile, about
constexpr int64_t kShared = 100000;         // bytes, so that two blocks share a multiprocessor

// What all blocks of a launch share: sizes of a tile and of its parts of shared memory, in bytes.
struct Tiles {
  int across, down;                 // patches
  int rows, taps_x, taps_y;         // of the image that a tile reads, at most; of a pixel, at most, a multiple of 4
  int stride;                       // elements of a row of the image in shared memory, of all channels
  int weights_x, weights_y, lines;  // where these begin, after the patches
  int bytes;

  // Of a row of a channel, a multiple of four.
  KV_HD int columns(int patch) const { return (across * patch + 3) / 4 * 4; }
};

// Writes the normalized weights of pixel i, `stride` apart, zeros up to `taps`; returns the first pixel of its band.
__device__ __noinline__ int write_band(Axis const& axis, int i, float* weights, int stride, int taps) {
  double const scale = axis.scale(), center = axis.center(i, scale);
  int const first = axis.first(center, scale);
  float const per_unit = float(1 / max(scale, 1.));
  float x = float(first - center) * per_unit, sum = 0;
  int const count = min(taps, axis.source - first);
#pragma unroll 1
  for (int k = 0; k < taps; ++k, x += per_unit) {
    float const weight = k < count ? geometry::filter_at(axis.filter, true, x) : 0.f;
    weights[k * stride] = weight;
    sum += weight;
  }
  float const norm = 1 / sum;
#pragma unroll 1
  for (int k = 0; k < taps; ++k) weights[k * stride] *= norm;
  return first;
}

// The pixels of a column of rows [0, count) of an image, resized along x.
template <class T, class Line>
__device__ __forceinline__ void resize_column(T const* row, int64_t row_stride, int64_t step, int count,
                                              float const* weights, int stride, int taps, Line* to, int to_stride) {
#pragma unroll 1
  for (int r = 0; r < count; ++r, row += row_stride, to += to_stride) {
    float sum = 0;
#pragma unroll 4
    for (int k = 0; k < taps; ++k) {
      float const weight = weights[k * stride];
      if (sizeof(T) == 1 || weight != 0) sum += weight * read(row[k * step]);
    }
    *to = round_to<Line>(sum);
  }
}

template <class T, class U>
__global__ void __launch_bounds__(kThreads, kBlocks)
    make_patches(__grid_constant__ VisionPatches<T> const p, __grid_constant__ Table const table, Tiles const tiles) {
  using Line = std::conditional_t<sizeof(T) == 1, uint8_t, float>;
  extern __shared__ __align__(16) unsigned char memory[];
  U* const pixels = reinterpret_cast<U*>(memory);
  float* const weights_x = reinterpret_cast<float*>(memory + tiles.weights_x);
  float* const weights_y = reinterpret_cast<float*>(memory + tiles.weights_y);
  Line* const lines = reinterpret_cast<Line*>(memory + tiles.lines);
  int const thread = int(threadIdx.x), size = p.patch, elements = p.patch_elements();

  PatchImage const& image = table.images[image_of_block(p, table)];
  int const block = int(blockIdx.x) - image.first_unit;
  int const tiles_across = (image.columns + tiles.across - 1) / tiles.across;
  int const tiles_down = (image.rows + tiles.down - 1) / tiles.down;
  U* const patches = static_cast<U*>(p.patches);
  if (block >= tiles_across * tiles_down) return clear_padding<U>(p, image, block - tiles_across * tiles_down);
  if (p.mask && block == 0) write_mask(p, image);

  int const tile_i = block / tiles_across * tiles.down, tile_j = block % tiles_across * tiles.across;
  int const across = min(tiles.across, image.columns - tile_j), down = min(tiles.down, image.rows - tile_i);
  int const columns = across * size, rows = down * size, stride_x = tiles.columns(size), channels = p.channels;
  int* const first_x = reinterpret_cast<int*>(weights_x + tiles.taps_x * stride_x);
  int* const first_y = reinterpret_cast<int*>(weights_y + tiles.taps_y * tiles.down * size);
  Axis const axis_x(p.filter, image.width, image.columns * size), axis_y(p.filter, image.height, image.rows * size);
  for (int t = thread; t < columns + rows; t += kThreads) {
    if (t < columns)
      first_x[t] = write_band(axis_x, tile_j * size + t, weights_x + t, stride_x, tiles.taps_x);
    else
      first_y[t - columns] =
          write_band(axis_y, tile_i * size + t - columns, weights_y + (t - columns) * tiles.taps_y, 1, tiles.taps_y);
  }
  __syncthreads();

  // Along x. The bands of the last rows end last.
  int const taps_x = axis_x.taps(), taps_y = axis_y.taps();
  int const top = first_y[0];
  int const bottom = min(first_y[rows - 1] + taps_y, image.height);
  int const read_rows = min(bottom - top, tiles.rows);
  for (int t = thread; t < columns * channels; t += kThreads) {
    int const c = t / columns, x = t - c * columns, first = first_x[x];
    T const* const row = p.row(image, c, top) + first * image.step;
    Line* const to = lines + c * stride_x + x;
    float const* const weights = weights_x + x;
    int const taps = min(taps_x, image.width - first);
    resize_column(row, image.row_stride, image.step, read_rows, weights, stride_x, taps, to, tiles.stride);
  }
  __syncthreads();

  // Along y: four adjacent columns a thread, every few rows, to the order of the patches.
  int const quads = (columns + 3) / 4, all = quads * channels, at_once = max(kThreads / all, 1);
  for (int t = thread; t < all * at_once; t += kThreads) {
    int const rest = t % all, c = rest / quads, x = 4 * (rest - c * quads);
    int at[4];  // in a row of patches
#pragma unroll
    for (int e = 0; e < 4; ++e) {
      int const j = (x + e) / size, column = x + e - j * size;
      at[e] = j * elements + (p.repeats ? c * size * size + column : column * channels + c);
    }
    float const scale = p.scale[c], offset = p.offset[c];
    int const row_elements = p.repeats ? size : size * channels;
    // Two columns that are adjacent in a patch are stored together.
    bool const by_pairs = p.repeats && size % 2 == 0 && elements % 2 == 0;
    for (int y = t / all; y < rows; y += at_once) {
      float const* const weights = weights_y + y * tiles.taps_y;
      Line const* from = lines + (first_y[y] - top) * tiles.stride + c * stride_x + x;
      int const taps = min(taps_y, top + read_rows - first_y[y]);
      float sums[4]{};
#pragma unroll 4
      for (int k = 0; k < taps; ++k, from += tiles.stride) {
        float const weight = weights[k];
        if constexpr (sizeof(T) == 1) {
          uint32_t const word = *reinterpret_cast<uint32_t const*>(from);
#pragma unroll
          for (int e = 0; e < 4; ++e) sums[e] += weight * byte_of<float>(word, e);
        } else if (weight != 0) {
          float4 const four = *reinterpret_cast<float4 const*>(from);
          sums[0] += weight * four.x, sums[1] += weight * four.y;
          sums[2] += weight * four.z, sums[3] += weight * four.w;
        }
      }
      int const i = y / size;
      U* const to = pixels + i * tiles.across * elements + (y - i * size) * row_elements;
      U values[4];
#pragma unroll
      for (int e = 0; e < 4; ++e) {
        if constexpr (sizeof(T) == 1) sums[e] = min(max(rintf(sums[e]), 0.f), 255.f);
        values[e] = round_to<U>(sums[e] * scale + offset);
      }
      if (by_pairs) {
        *reinterpret_cast<Vector<U, 2>*>(to + at[0]) = {values[0], values[1]};
        if (x + 2 < columns) *reinterpret_cast<Vector<U, 2>*>(to + at[2]) = {values[2], values[3]};
      } else {
#pragma unroll
        for (int e = 0; e < 4; ++e)
          if (x + e < columns) to[at[e]] = values[e];
      }
    }
  }
  __syncthreads();

  // A warp copies the plane of a patch, or all of it where channels are interleaved.
  constexpr int kPer8 = 8 / int(sizeof(U));
  int const planes = p.repeats ? channels : 1, length = elements / planes, repeats = max(p.repeats, 1);
  bool const by_8 = length % kPer8 == 0;
  for (int t = thread / 32; t < down * across * planes; t += kThreads / 32) {
    int const patch = t / planes, plane = t - patch * planes, i = patch / across, j = patch - i * across;
    U const* const from = pixels + (i * tiles.across + j) * elements + plane * length;
    U* const to = patches + p.index(image, tile_i + i, tile_j + j) * p.elements() + int64_t(plane) * repeats * length;
    for (int n = 0; n < repeats; ++n) {
      if (by_8)
        for (int e = thread % 32; e < length / kPer8; e += 32)
          __stcs(reinterpret_cast<uint2*>(to + n * length) + e, reinterpret_cast<uint2 const*>(from)[e]);
      else
        for (int e = thread % 32; e < length; e += 32) to[n * length + e] = from[e];
    }
  }
}

// The largest tiles that fit shared memory.
template <class T, class U>
Tiles tiles_of(VisionPatches<T> const& p, PatchImage const* images, int count) {
  Tiles tiles{};
  int const size = p.patch;
  double shrink = 0;
  for (int n = 0; n < count; ++n) {
    ResizeAxis const x = p.axis(images[n].width, int64_t(images[n].columns) * size);
    ResizeAxis const y = p.axis(images[n].height, int64_t(images[n].rows) * size);
    tiles.taps_x = max(tiles.taps_x, (x.max_taps + 3) / 4 * 4),
    tiles.taps_y = max(tiles.taps_y, (y.max_taps + 3) / 4 * 4);
    shrink = max(shrink, double(y.num) / double(y.den));
  }
  auto const with = [&](int across, int down) {
    Tiles t = tiles;
    t.across = across, t.down = down;
    int const columns = t.columns(size), rows = down * size;
    auto const round_up = [](int64_t n) { return (n + 15) / 16 * 16; };
    t.rows = int(rows * shrink) + t.taps_y + 2;
    t.stride = (p.channels * columns + 15) / 16 * 16;
    int64_t const weights_x = round_up(int64_t(across) * down * p.patch_elements() * sizeof(U));
    int64_t const weights_y = weights_x + round_up(4 * int64_t(columns) * (t.taps_x + 1));
    int64_t const lines = weights_y + round_up(4 * int64_t(rows) * (t.taps_y + 1));
    int64_t const bytes = lines + round_up((int64_t(t.rows) * t.stride + 16) * (sizeof(T) == 1 ? 1 : 4));
    t.weights_x = int(weights_x), t.weights_y = int(weights_y), t.lines = int(lines);
    t.bytes = int(min(bytes, int64_t(INT32_MAX)));  // more than fits, as then the others may be
    return t;
  };
  int across = max(kColumns / size, 1), down = 2;
  Tiles best = with(across, down);
  while (best.bytes > kShared && (across > 1 || down > 1)) {
    if (down > 1)
      down /= 2;
    else
      across /= 2;
    best = with(across, down);
  }
  return best;
}

template <class T, class U>
int launch(VisionPatches<T> const& p, CUstream_st* stream) {
  auto* const kernel = make_patches<T, U>;
  for (int first = 0; first < p.count; first += kImages) {
    VisionPatches<T> part = p;
    part.count = min(p.count - first, kImages);
    Tiles const tiles = tiles_of<T, U>(p, p.images + first, part.count);
    if (tiles.bytes > max_shared_bytes(227 * 1024)) return cudaErrorInvalidConfiguration;
    Table table;
    unsigned const blocks = fill_table(part, p.images + first, tiles.across, tiles.down, table);
    if (blocks == 0) continue;
    if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, tiles.bytes))
      return error;
    kernel<<<blocks, kThreads, unsigned(tiles.bytes), stream>>>(part, table, tiles);
    if (int const error = cudaGetLastError()) return error;
  }
  return cudaSuccess;
}

}  // namespace

template <class T>
int vision_patches(VisionPatches<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1)
    if (int const error = vision_patches_of_bytes(p, stream); error != kUnsupported) return error;
  return p.dtype == DType::bfloat16 ? launch<T, BFloat16>(p, stream) : launch<T, float>(p, stream);
}

KV_INSTANTIATE_ONE(vision_patches, VisionPatches, float)
KV_INSTANTIATE_ONE(vision_patches, VisionPatches, uint8_t)

}  // namespace kv::contrib::cuda
