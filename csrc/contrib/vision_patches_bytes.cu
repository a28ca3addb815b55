// Model inputs of bytes on CUDA, by tensor cores: both axes are products with banded matrices of weights, exact sums of
// integers. A weight has 16 bits, of which the high and the low byte are multiplied apart. A block goes down a strip of
// an image, some patches wide; a warp has 16 columns of the result:
//
//   rows of the image       shared memory, those of the next chunk by asynchronous copies meanwhile
//   16 columns x 8 rows     weights (16 x 32 k) times rows (32 k x 8), rounded to levels
//   16 rows x 8 columns     weights (16 x 16) times levels (16 x 8), rounded, normalized
//   patches                 shared memory, in the order of the result; then copied by vectors
//
// A thread's levels of 16 rows are the operand of the second product as they are, in registers: the weights of the
// rows are in their order, 2 t, 2 t + 1, 2 t + 8, 2 t + 9 for t = lane % 4.
//
// Special case: bytes. H200: 1.04 (SigLIP 2, 256 patches) to 2.24 (2048x1536 to a million pixels) times as fast as the
// kernel for any images.
#include "contrib/vision_patches.cuh"
#include "core/row_prefetcher.cuh"
#include "core/row_vectors.cuh"

namespace kv::contrib::cuda {
namespace {

constexpr int kChunk = 16;  // rows of the image that are copied and resized at once
constexpr int kMaxWarps = 16, kMaxThreads = 32 * kMaxWarps;
constexpr int kColumns = 128, kRows = 32;  // of a tile, about
constexpr int kStrips = 24;                // of each multiprocessor, about
constexpr int64_t kShared = 110000;        // bytes of a block, at most

// What all blocks of a launch share. Parts of shared memory begin at bytes.
struct ByteTiles {
  int across, down;    // patches
  int strip;           // tiles one below the other of a block
  int group;           // merge, if tiles are whole blocks of patches, or 1
  int vector;          // bytes of a vector of the result
  int taps_x;          // of a pixel, at most
  int steps;           // of 32 columns of the image that 16 of the result read
  int pitch;           // bytes of a row of the image in shared memory
  int ring, per_ring;  // chunks of 16 rows that a tile reads, at most, and 2^16 / ring
  int chunks_y;        // that 16 rows of the result read
  int y_weights, levels, x_weights, patches;
  int bytes;

  // chunk % ring, where their product is below 2^16
  __device__ __forceinline__ int slot(int chunk) const { return chunk - (chunk * per_ring >> 16) * ring; }
};

// d = a b + c for integers: 16 x 32 weights (their low bytes unsigned) and 32 x 8 levels.
template <bool Signed>
__device__ __forceinline__ void multiply(int (&d)[4], uint4 a, uint32_t b0, uint32_t b1, int const (&c)[4]) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  if constexpr (Signed)
    asm("mma.sync.aligned.m16n8k32.row.col.s32.s8.u8.s32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%10, %11, "
        "%12, %13};"
        : "=r"(d[0]), "=r"(d[1]), "=r"(d[2]), "=r"(d[3])
        : "r"(a.x), "r"(a.y), "r"(a.z), "r"(a.w), "r"(b0), "r"(b1), "r"(c[0]), "r"(c[1]), "r"(c[2]), "r"(c[3]));
  else
    asm("mma.sync.aligned.m16n8k32.row.col.s32.u8.u8.s32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%10, %11, "
        "%12, %13};"
        : "=r"(d[0]), "=r"(d[1]), "=r"(d[2]), "=r"(d[3])
        : "r"(a.x), "r"(a.y), "r"(a.z), "r"(a.w), "r"(b0), "r"(b1), "r"(c[0]), "r"(c[1]), "r"(c[2]), "r"(c[3]));
#endif
}
// The same for 16 x 16 and 16 x 8.
template <bool Signed>
__device__ __forceinline__ void multiply(int (&d)[4], uint32_t a0, uint32_t a1, uint32_t b, int const (&c)[4]) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  if constexpr (Signed)
    asm("mma.sync.aligned.m16n8k16.row.col.s32.s8.u8.s32 {%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
        : "=r"(d[0]), "=r"(d[1]), "=r"(d[2]), "=r"(d[3])
        : "r"(a0), "r"(a1), "r"(b), "r"(c[0]), "r"(c[1]), "r"(c[2]), "r"(c[3]));
  else
    asm("mma.sync.aligned.m16n8k16.row.col.s32.u8.u8.s32 {%0, %1, %2, %3}, {%4, %5}, {%6}, {%7, %8, %9, %10};"
        : "=r"(d[0]), "=r"(d[1]), "=r"(d[2]), "=r"(d[3])
        : "r"(a0), "r"(a1), "r"(b), "r"(c[0]), "r"(c[1]), "r"(c[2]), "r"(c[3]));
#endif
}

// Four numbers as levels of bytes, the first one lowest.
__device__ __forceinline__ uint32_t packed_levels(int a, int b, int c, int d) {
  uint32_t high, all;
  asm("cvt.pack.sat.u8.s32.b32 %0, %1, %2, 0;" : "=r"(high) : "r"(d), "r"(c));
  asm("cvt.pack.sat.u8.s32.b32 %0, %1, %2, %3;" : "=r"(all) : "r"(b), "r"(a), "r"(high));
  return all;
}

// The bits of weights behind the point. Their high bytes are signed: weights are below 2 in size, or 1 where an image
// shrinks to its half or less.
__device__ __forceinline__ int bits_of(Axis const& axis) { return axis.source >= 2 * axis.result ? 15 : 14; }

// Rows of the image that a tile is the first one of its strip to read: chunks of 16 from the strip's first row on.
struct Rows {
  int i, begin, end;  // row of patches, chunks
  __device__ __forceinline__ Rows(Axis const& axis, double scale, int top, int i, int rows, int begin)
      : i(i), begin(begin) {
    end = max((axis.end(axis.center(rows - 1, scale), scale) - top + kChunk - 1) / kChunk, begin);
  }
};

// Columns [from, from + width) of the image, as they come to shared memory.
struct Source {
  int from, width;
  bool by_bytes;    // pixels or rows are not as in a plane
  bool is_aligned;  // all rows alike, so that the copies are asynchronous
  int row, vector;  // where the thread begins
  int rows_apart, vectors_apart;

  __device__ __forceinline__ Source(PatchImage const& image, int channels, int first, int end) {
    by_bytes = image.step != 1 || image.row_stride < 32;
    is_aligned = image.row_stride % 16 == 0 && (channels == 1 || image.channel_stride % 16 == 0);
    from = first - (is_aligned && !by_bytes ? int((reinterpret_cast<uintptr_t>(image.data) + first) % 16) : 0);
    width = end - from;
    int const vectors = this->vectors(), threads = int(blockDim.x), thread = int(threadIdx.x);
    row = thread / vectors, vector = thread - row * vectors;
    rows_apart = threads / vectors, vectors_apart = threads - rows_apart * vectors;
  }
  __device__ __forceinline__ int vectors() const { return (width + 15) / 16; }

  // Copies a chunk of all channels, from row y on.
  __device__ __forceinline__ void copy(VisionPatches<uint8_t> const& p, PatchImage const& image, int y, int pitch,
                                       unsigned char* to) const {
    int const lines = p.channels * kChunk, count = min(image.height - y, kChunk);
    if (by_bytes) {
      for (int line = int(threadIdx.x / 32); line < lines; line += int(blockDim.x / 32)) {
        int const c = line / kChunk, r = line % kChunk;
        uint8_t const* const row = p.row(image, c, y + r) + from * image.step;
        if (r < count)
          for (int x = int(threadIdx.x % 32); x < width; x += 32) to[line * pitch + x] = row[x * image.step];
      }
      return;
    }
    int const all = vectors(), row_stride = int(image.row_stride), channel_stride = int(image.channel_stride);
    uint8_t const* const first = p.row(image, 0, y) + from;
    for (int line = row, v = vector; line < lines;) {
      int const c = line / kChunk, r = line % kChunk;
      uint8_t const* const at = first + (c * channel_stride + r * row_stride + 16 * v);
      unsigned char* const vector_to = to + line * pitch + 16 * v;
      // After the last row the memory may end; after another one there is a row.
      int const left = y + r + 1 < image.height ? 32 : image.width - (from + 16 * v);
      if (r < count) {
        if (!is_aligned)
          *reinterpret_cast<Vector<uint8_t, 16>*>(vector_to) = load_unaligned<16>(at, at + left);
        else if (left >= 16)
          copy_async_if<16>(uint32_t(__cvta_generic_to_shared(vector_to)), at, true, false);
        else
          for (int i = 0; i < 16; ++i) vector_to[i] = i < left ? at[i] : uint8_t(0);
      }
      line += rows_apart, v += vectors_apart;
      if (v >= all) v -= all, ++line;
    }
  }
};

// Writes the weights of all columns, `taps` of each, and the first pixels that they read.
__device__ __forceinline__ void write_x_weights(Axis const& axis, int first_column, int columns, int taps,
                                                int16_t* weights, int* first) {
  double const scale = axis.scale();
  float const per_unit = float(1 / max(scale, 1.)), unit = float(1 << bits_of(axis));
  for (int x = int(threadIdx.x); x < columns; x += int(blockDim.x)) {
    double const center = axis.center(first_column + x, scale);
    int const begin = axis.first(center, scale), count = min(taps, axis.end(center, scale) - begin);
    float const start = float(begin - center) * per_unit;
    float sum = 0;
#pragma unroll 1
    for (int k = 0; k < count; ++k) sum += geometry::filter_at(axis.filter, true, start + k * per_unit);
    float const factor = unit / sum;
#pragma unroll 1
    for (int k = 0; k < taps; ++k) {
      float const weight = k < count ? geometry::filter_at(axis.filter, true, start + k * per_unit) : 0.f;
      weights[x * taps + k] = int16_t(__float2int_rn(weight * factor));
    }
    first[x] = begin;
  }
}

// The weights of a lane for 32 columns of the image from `at` on, high and low bytes. Columns of the result that are
// not there have none.
__device__ __forceinline__ void find_x_weights(int16_t const* weights, int const* first, int taps, int columns, int x,
                                               int at, uint4& high, uint4& low) {
  uint32_t h[4]{}, l[4]{};
#pragma unroll
  for (int i = 0; i < 4; ++i) {
    int const column = x + int(threadIdx.x % 32 / 4) + i % 2 * 8;
    if (column >= columns) continue;
    int const tap = at + int(threadIdx.x % 4) * 4 + i / 2 * 16 - first[column];
#pragma unroll
    for (int b = 0; b < 4; ++b) {
      int const weight = tap + b >= 0 && tap + b < taps ? weights[column * taps + tap + b] : 0;
      h[i] |= uint32_t((weight >> 8) & 255) << (8 * b);
      l[i] |= uint32_t(weight & 255) << (8 * b);
    }
  }
  high = {h[0], h[1], h[2], h[3]}, low = {l[0], l[1], l[2], l[3]};
}

// Where the levels begin and end, in chunks of 16 rows, that 16 rows of a tile read.
struct Chunks {
  int begin, end;
};

// Adds the weights of `rows` rows of the result, from `first_row` on, to `weights`, which are zeros: by 16 rows, chunk
// and lane. Eight threads a row. `top`: of the strip.
__device__ __forceinline__ void write_y_weights(Axis const& axis, double scale, float per_unit, int first_row, int rows,
                                                int top, int chunks, unsigned char* weights, Chunks* of_blocks) {
  float const unit = float(1 << bits_of(axis));
  int const all = (8 * rows + 31) / 32 * 32;
#pragma unroll 1
  for (int t = int(threadIdx.x); t < all; t += int(blockDim.x)) {
    int const r = min(t / 8, rows - 1), block = r / 16;
    double const center = axis.center(first_row + r, scale);
    int const first = axis.first(center, scale), count = axis.end(center, scale) - first;
    int const begin = (axis.first(axis.center(first_row + 16 * block, scale), scale) - top) / 16;
    float const start = float(first - center) * per_unit;
    auto const filter = [&](int k) { return geometry::filter_at(axis.filter, true, start + k * per_unit); };
    float sum = 0, last = 0;
#pragma unroll 1
    for (int k = t % 8; k < count; k += 8) sum += last = filter(k);
    sum += __shfl_xor_sync(0xffffffffu, sum, 1);
    sum += __shfl_xor_sync(0xffffffffu, sum, 2);
    sum += __shfl_xor_sync(0xffffffffu, sum, 4);
    float const factor = unit / sum;
    if (t / 8 >= rows) continue;
    if (t % 8 == 0 && r % 16 == 0) of_blocks[block].begin = begin;
    if (t % 8 == 0 && (r % 16 == 15 || r == rows - 1)) of_blocks[block].end = (first + count - 1 - top) / 16 + 1;
#pragma unroll 1
    for (int k = t % 8; k < count; k += 8) {
      int const weight = __float2int_rn((k + 8 < count ? filter(k) : last) * factor);
      int const y = first + k - top, at = y % 8;
      int const lane = r % 8 * 4 + at / 2, byte = r % 16 / 8 * 4 + y % 16 / 8 * 2 + at % 2;
      unsigned char* const to = weights + ((block * chunks + y / 16 - begin) * 32 + lane) * 16 + byte;
      to[0] = uint8_t(weight >> 8), to[8] = uint8_t(weight);
    }
  }
}

// Levels of 16 columns in 8 rows. A thread has those of columns lane / 4 and lane / 4 + 8, in rows 2 t and 2 t + 1.
template <int Steps>
struct XWeights {
  uint4 high[Steps > 0 ? Steps : 1], low[Steps > 0 ? Steps : 1];
  uint4 const* memory;  // of the lane, where they are more than registers hold
  int steps, bits;

  // `half`, in the unit of sums, four times.
  __device__ __forceinline__ void resize(unsigned char const* from, int const (&half)[4], int (&levels)[4]) const {
    int h[4], l[4];
    int const zeros[4]{};
    auto const add = [&](uint4 high, uint4 low, int s, int const(&c)[4], int const(&d)[4]) {
      uint32_t const a = *reinterpret_cast<uint32_t const*>(from + 32 * s);
      uint32_t const b = *reinterpret_cast<uint32_t const*>(from + 32 * s + 16);
      multiply<true>(h, high, a, b, c);
      multiply<false>(l, low, a, b, d);
    };
    if constexpr (Steps > 0) {
      add(high[0], low[0], 0, zeros, half);
#pragma unroll
      for (int s = 1; s < Steps; ++s) add(high[s], low[s], s, h, l);
    } else {
      add(memory[0], memory[32], 0, zeros, half);
#pragma unroll 1
      for (int s = 1; s < steps; ++s) add(memory[64 * s], memory[64 * s + 32], s, h, l);
    }
#pragma unroll
    for (int i = 0; i < 4; ++i) levels[i] = (h[i] * 256 + l[i]) >> bits;
  }
};

// Copies patches from shared memory to the result, each plane of them `repeats` times.
template <class V>
__device__ __forceinline__ void copy_patches(unsigned char const* from, unsigned char* to, int bytes, int plane_bytes,
                                             int repeats) {
  constexpr int kBytes = int(sizeof(V));
  if (repeats <= 1) {
#pragma unroll 4
    for (int v = int(threadIdx.x); v < bytes / kBytes; v += int(blockDim.x))
      __stcs(reinterpret_cast<V*>(to) + v, reinterpret_cast<V const*>(from)[v]);
    return;
  }
  int const each = plane_bytes / kBytes;
#pragma unroll 1
  for (int v = int(threadIdx.x); v < bytes / kBytes; v += int(blockDim.x)) {
    V const value = reinterpret_cast<V const*>(from)[v];
    int const plane = v / each;
    V* const copies = reinterpret_cast<V*>(to) + plane * repeats * each + (v - plane * each);
#pragma unroll 1
    for (int n = 0; n < repeats; ++n) __stcs(copies + n * each, value);
  }
}

// Four times the same number, which is loaded at once: a product takes it from four registers.
struct alignas(16) Four {
  int v[4];
};
// How sums become numbers of patches. Sums are floats by bits that were added to them; levels of bytes are in 255ths.
struct alignas(16) Normalization {
  float per_level, below, scale, shift;
  __device__ __forceinline__ float operator()(int sum) const {
    return fmaf(__saturatef(fmaf(__int_as_float(sum), per_level, below)), scale, shift);
  }
};
__device__ __forceinline__ Vector<float, 2> rounded_pair(float a, float b, float) { return {a, b}; }
__device__ __forceinline__ uint32_t rounded_pair(float a, float b, BFloat16) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return to_bfloat16(a).bits | uint32_t(to_bfloat16(b).bits) << 16;
#else
  uint32_t both;
  asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(b), "f"(a));
  return both;
#endif
}

template <class U, int Steps>
__global__ void __launch_bounds__(kMaxThreads, 2)
    make_patches_of_bytes(__grid_constant__ VisionPatches<uint8_t> const p, __grid_constant__ Table const table,
                          __grid_constant__ ByteTiles const tiles) {
  extern __shared__ __align__(16) unsigned char memory[];
  __shared__ Chunks of_blocks[8];
  __shared__ int row_at[128];  // bytes of the patches before a row of a tile
  __shared__ Four half, magic;
  __shared__ Normalization of_channels[kMaxPatchChannels];
  constexpr int kSize = int(sizeof(U));
  int const thread = int(threadIdx.x), lane = thread % 32, warp = thread / 32;
  int const size = p.patch, elements = p.patch_elements(), channels = p.channels;

  PatchImage const& image = table.images[image_of_block(p, table)];
  int const block = int(blockIdx.x) - image.first_unit;
  int const strips_across = (image.columns + tiles.across - 1) / tiles.across;
  int const strips_down = (image.rows + tiles.down * tiles.strip - 1) / (tiles.down * tiles.strip);
  if (block >= strips_across * strips_down) return clear_padding<U>(p, image, block - strips_across * strips_down);
  if (p.mask && block == 0) write_mask(p, image);

  int const tile_j = block % strips_across * tiles.across, across = min(tiles.across, image.columns - tile_j);
  int const begin_i = block / strips_across * tiles.strip * tiles.down;
  int const end_i = min(begin_i + tiles.strip * tiles.down, image.rows);
  int const columns = across * size, group = tiles.group, x0 = 16 * warp;
  Axis const axis_x(p.filter, image.width, image.columns * size), axis_y(p.filter, image.height, image.rows * size);
  double const scale_x = axis_x.scale(), scale_y = axis_y.scale();
  float const per_unit_y = float(1 / max(scale_y, 1.));
  int const first = axis_x.first(axis_x.center(tile_j * size, scale_x), scale_x);
  int const end = axis_x.end(axis_x.center(tile_j * size + columns - 1, scale_x), scale_x);
  int const top = axis_y.first(axis_y.center(begin_i * size, scale_y), scale_y);
  Source const source(image, channels, first, end);

  // Copies are one ahead of what is resized.
  auto const rows_of = [&](int i, int begin) {
    return Rows(axis_y, scale_y, top, i, min(i + tiles.down, image.rows) * size, begin);
  };
  Rows ahead = rows_of(begin_i, 0);
  int ahead_chunk = 0;
  int const buffer_bytes = channels * kChunk * tiles.pitch;
  auto const copy = [&] {
    while (ahead_chunk == ahead.end) {
      if (ahead.i + tiles.down >= end_i) return;
      ahead = rows_of(ahead.i + tiles.down, ahead.end);
    }
    source.copy(p, image, top + kChunk * ahead_chunk, tiles.pitch, memory + ahead_chunk % 2 * buffer_bytes);
    __pipeline_commit();
    ++ahead_chunk;
  };
  copy();

  // Weights of columns, and where columns and rows are in the patches.
  int16_t* const x_table = reinterpret_cast<int16_t*>(memory + tiles.patches);
  int* const x_first = reinterpret_cast<int*>(memory + tiles.levels);
  write_x_weights(axis_x, tile_j * size, columns, tiles.taps_x, x_table, x_first);
  int const row_elements = p.repeats ? size : size * channels;
  for (int r = thread; r < tiles.down * size; r += int(blockDim.x)) {
    int const i = r / size;
    row_at[r] = kSize * ((i / group * across * group + i % group * group) * elements + (r - i * size) * row_elements);
  }
  int at[4];  // bytes before columns x0 + 2 t, x0 + 2 t + 1, and 8 further
#pragma unroll
  for (int e = 0; e < 4; ++e) {
    int const x = min(x0 + lane % 4 * 2 + e % 2 + e / 2 * 8, columns - 1), j = x / size, column = x - j * size;
    at[e] = tiles.patches +
            kSize * ((j / group * group * group + j % group) * elements + (p.repeats ? column : column * channels));
  }
  __syncthreads();
  XWeights<Steps> weights;
  weights.bits = bits_of(axis_x), weights.steps = tiles.steps;
  bool const has_columns = x0 < columns;
  int const offset = has_columns ? (x_first[x0] - source.from) & -4 : 0;
  if (has_columns) {
    uint4* const own = reinterpret_cast<uint4*>(memory + tiles.x_weights) + warp * tiles.steps * 64 + lane;
    weights.memory = own;
#pragma unroll
    for (int s = 0; s < (Steps > 0 ? Steps : tiles.steps); ++s) {
      uint4 high, low;
      find_x_weights(x_table, x_first, tiles.taps_x, columns, x0, source.from + offset + 32 * s, high, low);
      if constexpr (Steps > 0)
        weights.high[s] = high, weights.low[s] = low;
      else
        own[64 * s] = high, own[64 * s + 32] = low;
    }
  }
  uint2* const all_levels = reinterpret_cast<uint2*>(memory + tiles.levels) + warp * channels * tiles.ring * 32 + lane;
  int const y_words = (tiles.down * size + 15) / 16 * tiles.chunks_y * 32;
  // A sum of levels, in 1 / 2^bits, becomes the float 512 (or 256) + sum by adding its bits.
  int const bits_y = bits_of(axis_y);
  int const whole = -1 << bits_y;  // the bits before the point
  if (thread < 4) {
    half.v[thread] = 1 << (weights.bits - 1);
    magic.v[thread] = (bits_y == 14 ? 0x44000000 : 0x43800000) + (1 << (bits_y - 1));
    if (thread < channels)
      of_channels[thread] = {1 / 255.f, -(bits_y == 14 ? 512.f : 256.f) * (1 / 255.f), 255 * p.scale[thread],
                             p.offset[thread]};
  }
  bool const by_pairs = p.repeats && size % 2 == 0;
  int const columns_left = columns - x0 - lane % 4 * 2, plane_bytes = kSize * (p.repeats ? size * size : 1);

  int64_t const strip_index = p.index(image, begin_i, tile_j);
  int chunk = 0;
  for (int i = begin_i; i < end_i; i += tiles.down) {
    int const down = min(tiles.down, image.rows - i), rows = down * size;
    Rows const read = rows_of(i, chunk);
    for (int t = thread; t < y_words; t += int(blockDim.x))
      reinterpret_cast<uint4*>(memory + tiles.y_weights)[t] = uint4{};
    bool const has_rows = read.begin < read.end;
#pragma unroll 1
    do {
      if (has_rows) __pipeline_wait_prior(0);
      __syncthreads();
      if (has_rows) copy();
      if (chunk == read.begin)
        write_y_weights(axis_y, scale_y, per_unit_y, i * size, rows, top, tiles.chunks_y, memory + tiles.y_weights,
                        of_blocks);
      if (has_rows && has_columns) {
        Four const added = half;
        unsigned char const* from = memory + chunk % 2 * buffer_bytes + lane / 4 * tiles.pitch + offset + lane % 4 * 4;
        uint2* to = all_levels + tiles.slot(chunk) * 32;
#pragma unroll 1
        for (int c = 0; c < channels; ++c, from += kChunk * tiles.pitch, to += tiles.ring * 32) {
          int a[4], b[4];
          weights.resize(from, added.v, a);
          weights.resize(from + 8 * tiles.pitch, added.v, b);
          *to = {packed_levels(a[0], a[1], b[0], b[1]), packed_levels(a[2], a[3], b[2], b[3])};
        }
      }
      chunk += has_rows;
    } while (chunk < read.end);
    if (read.end - read.begin < 2) __syncthreads();  // else the last rows came after the weights
    if (has_columns) {
      uint4 const* weight = reinterpret_cast<uint4 const*>(memory + tiles.y_weights) + lane;
#pragma unroll 1
      for (int b = 0; 16 * b < rows; ++b, weight += tiles.chunks_y * 32) {
        Chunks const chunks = of_blocks[b];
        int const first_slot = tiles.slot(chunks.begin), row = 16 * b + lane / 4;
        int const to[] = {row_at[row], row_at[row + 8]};
        bool const stored[] = {row < rows, row + 8 < rows};
        uint2 const* levels = all_levels;
        unsigned char* plane = memory;
#pragma unroll 1
        for (int c = 0; c < channels; ++c, levels += tiles.ring * 32, plane += plane_bytes) {
          int h[2][4], l[2][4];
          int const zeros[4]{};
          int slot = first_slot;
          auto const add = [&](uint4 w, int const(&h0)[4], int const(&h1)[4], int const(&l0)[4], int const(&l1)[4]) {
            uint2 const level = levels[slot * 32];
            multiply<true>(h[0], w.x, w.y, level.x, h0);
            multiply<true>(h[1], w.x, w.y, level.y, h1);
            multiply<false>(l[0], w.z, w.w, level.x, l0);
            multiply<false>(l[1], w.z, w.w, level.y, l1);
            slot = slot + 1 == tiles.ring ? 0 : slot + 1;
          };
          Four const added = magic;
          add(weight[0], zeros, zeros, added.v, added.v);
#pragma unroll 1
          for (int k = 1; k < chunks.end - chunks.begin; ++k) add(weight[32 * k], h[0], h[1], l[0], l[1]);
          Normalization const normalization = of_channels[c];
#pragma unroll
          for (int n = 0; n < 2; ++n) {
            float v[4];
#pragma unroll
            for (int k = 0; k < 4; ++k) v[k] = normalization((h[n][k] * 256 + l[n][k]) & whole);
#pragma unroll
            for (int e = 0; e < 2; ++e) {
              unsigned char* const row_to = plane + to[e];
              if (by_pairs) {
                auto const pair = rounded_pair(v[2 * e], v[2 * e + 1], U{});
                if (stored[e] && 8 * n < columns_left)
                  *reinterpret_cast<std::remove_const_t<decltype(pair)>*>(row_to + at[2 * n]) = pair;
              } else if (stored[e]) {
#pragma unroll
                for (int k = 0; k < 2; ++k)
                  if (8 * n + k < columns_left)
                    *reinterpret_cast<U*>(row_to + at[2 * n + k]) = round_to<U>(v[2 * e + k]);
              }
            }
          }
        }
      }
    }
    __syncthreads();

    // Patches that are adjacent in the result, or single ones.
    bool const is_whole = group == p.merge;
    int const run = is_whole ? across * group : 1, bytes = kSize * elements;
    int n = 0;
#pragma unroll 1
    for (int y = 0; y < down; y += group)
#pragma unroll 1
      for (int x = 0; x < across; x += is_whole ? across : 1, ++n) {
        int64_t const index =
            is_whole ? strip_index + int64_t(i - begin_i + y) * image.columns : p.index(image, i + y, tile_j + x);
        auto* const to = static_cast<unsigned char*>(p.patches) + index * p.elements() * int64_t(kSize);
        unsigned char const* const from = memory + tiles.patches + n * run * bytes;
        if (tiles.vector == 16)
          copy_patches<uint4>(from, to, bytes * run, kSize * size * size, p.repeats);
        else if (tiles.vector == 8)
          copy_patches<uint2>(from, to, bytes * run, kSize * size * size, p.repeats);
        else if constexpr (sizeof(U) == 2)
          copy_patches<uint16_t>(from, to, bytes * run, kSize * size * size, p.repeats);
        else
          copy_patches<uint32_t>(from, to, bytes * run, kSize * size * size, p.repeats);
      }
  }
}

// --- launches --------------------------------------------------------------------------------------------------------

// The largest tiles that fit shared memory, of blocks of merged patches where possible.
template <class U>
ByteTiles tiles_of(VisionPatches<uint8_t> const& p, PatchImage const* images, int count) {
  int const size = p.patch;
  double shrink_x = 0, shrink_y = 0;
  int64_t taps_x = 0, across_all = 0, down_all = 0;
  for (int n = 0; n < count; ++n) {
    int64_t const columns = int64_t(images[n].columns) * size, rows = int64_t(images[n].rows) * size;
    shrink_x = max(shrink_x, double(images[n].width) / double(columns));
    shrink_y = max(shrink_y, double(images[n].height) / double(rows));
    taps_x = max(taps_x, int64_t(p.axis(images[n].width, columns).max_taps));
    across_all = max(across_all, int64_t(images[n].columns)), down_all = max(down_all, int64_t(images[n].rows));
  }
  // Pixels of the image that so many adjacent ones of the result read: less than a window more than from the first
  // one's center to the last one's.
  auto const read = [&](int64_t pixels, double shrink) {
    return int64_t(ceil(double(pixels - 1) * shrink + 2 * geometry::filter_radius(p.filter) * max(shrink, 1.)));
  };
  auto const with = [&](int64_t across, int64_t down) {
    int64_t const columns = across * size, rows = down * size, warps = ceil_div(columns, 16);
    int64_t const chunks_y = ceil_div(read(16, shrink_y) + 15, 16);
    int64_t const steps = ceil_div(read(16, shrink_x) + 3, 32), rows_read = read(rows, shrink_y);
    int64_t const vectors = ceil_div(read(columns, shrink_x) + 15, 16);
    ByteTiles t{};
    t.across = int(across), t.down = int(down);
    t.group = across % p.merge == 0 && down % p.merge == 0 ? p.merge : 1;
    int64_t const unit = int64_t(sizeof(U)) * (p.repeats > 1        ? size * size
                                               : t.group == p.merge ? t.group * t.group * p.patch_elements()
                                                                    : p.patch_elements());
    t.vector = unit % 16 == 0 ? 16 : unit % 8 == 0 ? 8 : int(sizeof(U));
    t.taps_x = int(taps_x), t.steps = int(steps);
    t.pitch = int(16 * (vectors | 1));
    t.ring = int(ceil_div(rows_read + 15, 16)), t.per_ring = (65536 + t.ring - 1) / t.ring;
    t.chunks_y = int(chunks_y);
    int64_t const in_registers = steps <= 2 ? 0 : steps;
    t.y_weights = 2 * p.channels * kChunk * t.pitch;
    t.levels = int(t.y_weights + ceil_div(rows, 16) * chunks_y * 512);
    t.x_weights = int(t.levels + max(warps * p.channels * t.ring * 256, 4 * columns));
    t.patches = int(t.x_weights + warps * in_registers * 1024);
    int64_t const end = t.patches + max(columns * rows * p.channels * int64_t(sizeof(U)), 2 * columns * taps_x);
    t.bytes = int(min(max(end, int64_t(t.y_weights + 32 * steps)), int64_t(INT32_MAX)));
    return t;
  };
  auto const whole = [&](int64_t n) { return max(n >= p.merge ? n / p.merge * p.merge : n, int64_t(1)); };
  int64_t across = whole(min(int64_t(kColumns / size), across_all));
  int64_t down = whole(min(int64_t(kRows / size), down_all));
  ByteTiles tiles = with(across, down);
  while (tiles.bytes > kShared && (across > 1 || down > 1)) {
    if (down > 1)
      down = whole(down / 2);
    else
      across = whole(across / 2);
    tiles = with(across, down);
  }
  return tiles;
}

template <class U>
int launch(VisionPatches<uint8_t> const& p, CUstream_st* stream) {
  for (int first = 0; first < p.count; first += kImages) {
    VisionPatches<uint8_t> part = p;
    part.count = min(p.count - first, kImages);
    ByteTiles tiles = tiles_of<U>(p, p.images + first, part.count);
    for (int n = first; n < first + part.count; ++n)
      if (p.images[n].channel_stride * p.channels + p.images[n].row_stride * 64 > INT32_MAX) return kUnsupported;
    if (tiles.bytes > max_shared_bytes(kShared) || tiles.down * p.patch > 128) return kUnsupported;
    // Strips so long that there are some waves of them: the weights of their columns are found once.
    int64_t all = 0;
    for (int n = first; n < first + part.count; ++n)
      all += ceil_div(p.images[n].rows, tiles.down) * ceil_div(p.images[n].columns, tiles.across);
    int64_t const longest = 65535 / (int64_t(tiles.ring) * tiles.ring);  // see ByteTiles::slot
    if (longest == 0) return kUnsupported;
    tiles.strip = int(clamp(all / (kStrips * multiprocessors()), int64_t(1), min(longest, int64_t(32))));
    Table table;
    unsigned const blocks = fill_table(part, p.images + first, tiles.across, tiles.down * tiles.strip, table);
    if (blocks == 0) continue;
    int const threads = int(ceil_div(tiles.across * p.patch, 16)) * 32;
    auto* const kernel = tiles.steps == 1   ? make_patches_of_bytes<U, 1>
                         : tiles.steps == 2 ? make_patches_of_bytes<U, 2>
                                            : make_patches_of_bytes<U, 0>;
    if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, tiles.bytes))
      return error;
    kernel<<<blocks, threads, unsigned(tiles.bytes), stream>>>(part, table, tiles);
    if (int const error = cudaGetLastError()) return error;
  }
  return cudaSuccess;
}

}  // namespace

int vision_patches_of_bytes(VisionPatches<uint8_t> const& p, CUstream_st* stream) {
  int device = 0, major = 0;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&major, cudaDevAttrComputeCapabilityMajor, device);
  if (major < 8) return kUnsupported;
  return p.dtype == DType::bfloat16 ? launch<BFloat16>(p, stream) : launch<float>(p, stream);
}

}  // namespace kv::contrib::cuda
