// Model inputs of bytes on CUDA, by tensor cores: both axes are products with banded matrices of weights, which are
// 16-bit floats. Levels of bytes are exact in those, and so is their rounding. A block goes down a strip of an image,
// some patches wide; a warp has 16 columns of the result and reads what they need to registers:
//
//   16 columns x 8 rows     weights (16 x 16 k) times pixels (16 k x 8), rounded to levels
//   16 rows x 8 columns     weights (16 x 16 k) times levels (16 k x 8), rounded to levels
//                           levels (16 x 8) times a diagonal of the factor of the channel, plus its offset
//   patches                 shared memory, in the order of the result; then copied by vectors
//
// One more warp finds the weights of the rows of the next tile. Planes of pixels that fit are copied to shared memory,
// a tile ahead of their use: warps waited for loads to registers nearly half of the time. A thread's result of a
// product is its operand of the next one as it is: nothing between pixels and patches leaves registers. Pairs of bytes,
// widened to words, are pairs of subnormal floats in 2^-24, as are levels: a sum in that unit is rounded to a level by
// its conversion to 16 bits. Weights have 11 bits and add up to 1; what their rounding leaves is given to one of the
// smallest.
#include "contrib/vision_patches_bytes.cuh"

namespace kv::contrib::cuda {
namespace {

constexpr int kRows = 32;            // of a tile, at most
constexpr int kPrologue = 2;         // tiles that would take as long as what is done once a strip
constexpr int64_t kShared = 113000;  // bytes of a block, at most: two fit a multiprocessor
// Columns of a tile, at most: 8 warps with that of the weights of rows have 128 registers a thread, in two blocks.
// Where weights of columns are in shared memory and more patches fit the wide ones, these are worth it with 96.
constexpr int kColumns = 112, kWideColumns = 128;
constexpr int threads_of(int columns) { return 2 * columns + 32; }

// What all blocks of a launch share. Parts of shared memory begin at bytes.
struct ByteTiles {
  int across, down;              // patches
  int strip;                     // tiles one below the other of a block
  int group;                     // merge, if tiles are whole blocks of patches, or 1
  unsigned per_size, per_group;  // 2^16 over these, rounded up
  int vector;                    // bytes of a vector of the result
  uint32_t per_plane;            // 2^32 over the vectors of a plane of a patch, rounded up
  int steps;                     // of 16 columns of the image that 16 of the result read
  int chunks;                    // of the image that a tile reads, at most
  int x_weights, pixels, patches;
  // Planes of pixels in shared memory, if those of two tiles fit: rows, vectors of 16 bytes that are copied of a row,
  // 2^32 over these, rounded up, and bytes from row to row and from plane to plane.
  bool stages;
  int rows, vectors;
  uint32_t per_vectors, pitch, plane;
  int bytes;
};

// --- the kernel ------------------------------------------------------------------------------------------------------

// Copies patches from shared memory to the result, each plane of them `repeats` times.
template <class V>
__device__ __forceinline__ void copy_patches(unsigned char const* from, unsigned char* to, int bytes, int plane_bytes,
                                             uint32_t per_plane, int repeats) {
  constexpr int kBytes = int(sizeof(V));
  if (repeats <= 1) {
#pragma unroll 4
    for (int v = int(threadIdx.x); v < bytes / kBytes; v += int(blockDim.x))
      __stcs(reinterpret_cast<V*>(to) + v, reinterpret_cast<V const*>(from)[v]);
    return;
  }
  int const each = plane_bytes / kBytes, more = (repeats - 1) * each;
#pragma unroll 2
  for (int v = int(threadIdx.x); v < bytes / kBytes; v += int(blockDim.x)) {
    V const value = reinterpret_cast<V const*>(from)[v];
    V* const copies = reinterpret_cast<V*>(to) + v + int(__umulhi(unsigned(v), per_plane)) * more;
#pragma unroll 1
    for (int n = 0; n < repeats; ++n) __stcs(copies + n * each, value);
  }
}

// How levels become numbers of patches: the bits of two floats that add up to the factor of what they lack to 255,
// twice each, and the number of 255.
struct alignas(16) Normalization {
  float4 most;
  uint32_t high, low;
};

// What shared memory begins with, before the weights of the rows of two tiles.
struct Shared {
  Normalization of_channels[kMaxPatchChannels];
  TileRows of_tiles[2];
};

// Whether pixels are copied to shared memory a tile ahead of their use.
constexpr bool stages(int steps, bool planes) { return planes && (steps == 2 || steps == 3); }
constexpr int blocks_at_once(int steps, bool planes) { return steps == 2 && planes ? 3 : 2; }

// `Chunks`: of a tile, or 0 for any number.
template <class U, int Steps, int Chunks, bool Planes, int Columns = kColumns>
__global__ void __launch_bounds__(threads_of(Columns), blocks_at_once(Steps, Planes))
    make_patches_of_bytes(__grid_constant__ VisionPatches<uint8_t> const p, __grid_constant__ Table const table,
                          __grid_constant__ ByteTiles const tiles) {
  extern __shared__ __align__(16) unsigned char memory[];
  Shared& shared = *reinterpret_cast<Shared*>(memory);
  constexpr int kSize = int(sizeof(U));
  constexpr bool kStages = stages(Steps, Planes);
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
  double const scale_y = axis_y.scale();
  float const per_unit_y = float(1 / max(scale_y, 1.));

  auto const over = [](int x, unsigned per) { return int(unsigned(x) * per >> 16); };  // of few pixels or patches
  // Where columns and rows are in the patches. Those after the last one are as it is, so that all are stored.
  int const row_elements = p.repeats ? size : size * channels, tile_rows = tiles.down * size;
  uint32_t row_at[4];  // of rows lane / 4 + 8 n
#pragma unroll
  for (int n = 0; n < 4; ++n) {
    int const y = min(lane / 4 + 8 * n, tile_rows - 1), i = over(y, tiles.per_size), above = over(i, tiles.per_group);
    row_at[n] =
        opaque(shared_address(memory + tiles.patches) +
               kSize * ((above * across + i - above * group) * group * elements + (y - i * size) * row_elements));
  }
  bool const by_pairs = p.repeats && size % 2 == 0, has_columns = x0 < columns;
  auto const column_of_tile = [&](int x) { return min(x, by_pairs ? columns - 2 + x % 2 : columns - 1); };
  uint32_t at[4];  // bytes before columns x0 + 2 t, x0 + 2 t + 1, and 8 further
#pragma unroll
  for (int e = 0; e < 4; ++e) {
    int const x = column_of_tile(x0 + lane % 4 * 2 + e % 2 + e / 2 * 8), j = over(x, tiles.per_size);
    int const before = over(j, tiles.per_group), column = x - j * size;
    at[e] = opaque(kSize * ((before * (group - 1) * group + j) * elements + (p.repeats ? column : column * channels)));
  }
  if (thread < channels) {
    float const factor = -512 * p.scale[thread];  // of levels in 1 / 512
    uint32_t const high = round_to_half(factor).bits;
    uint32_t const low = round_to_half(factor - read(Half{uint16_t(high)})).bits;
    float const most = 255 * p.scale[thread] + p.offset[thread];
    shared.of_channels[thread] = {{most, most, most, most}, high * 0x10001, low * 0x10001};
  }
  uint32_t const diagonal = lane / 8 == lane % 4 ? 0xffffu << (16 * (lane / 4 % 2)) : 0;

  // The pixels and weights of the columns of the warp.
  int const steps = Steps > 0 ? Steps : tiles.steps, first_column = tile_j * size;
  double const scale_x = axis_x.scale();
  int const first_pixel = axis_x.first(axis_x.center(first_column + min(x0, columns - 1), scale_x), scale_x);
  Source<Steps, Planes> const source(image, channels, first_pixel, steps);
  uint4 weights[Steps > 0 ? Steps : 1]{};
  uint4* const more_weights = reinterpret_cast<uint4*>(memory + tiles.x_weights) + warp * steps * 32 + lane;
  if (has_columns) {
    int const own_columns[] = {first_column + column_of_tile(x0 + lane / 4),
                               first_column + column_of_tile(x0 + lane / 4 + 8)};
    find_x_weights<Steps>(axis_x, own_columns, source.from, steps, source.is_split(), [&](int s, uint4 pairs) {
      if constexpr (Steps > 0)
        weights[s] = pairs;
      else
        more_weights[32 * s] = pairs;
    });
  }

  int const first_of_tile = axis_x.first(axis_x.center(first_column, scale_x), scale_x);
  uint8_t const* const image_rows =
      static_cast<uint8_t const*>(image.data) + (kStages ? first_of_tile : source.offset());
  int top = 0;                                       // of the rows of the image that a tile reads, plus lane / 4
  uint32_t words[4][Source<Steps, Planes>::kWords];  // of the next chunk, or of this one
  auto const load = [&](uint8_t const* plane, int chunk) {
    if constexpr (Steps > 0 && !kStages) source.load(plane, top + kChunk * chunk, words);
  };
  // Starts copies of the pixels of a tile. Vectors with a pixel of a row are safe to copy as a whole.
  uint32_t const pixels = shared_address(memory + tiles.pixels);
  auto const stage = [&](int i, int which) {
    int const first_row = axis_y.first(axis_y.center(i * size, scale_y), scale_y);
    uint32_t const all = pixels + which * channels * tiles.plane;
#pragma unroll 1
    for (int v = thread; v < tiles.rows * tiles.vectors; v += int(blockDim.x) - 32) {
      int const row = int(__umulhi(unsigned(v), tiles.per_vectors)), x = 16 * (v - row * tiles.vectors);
      uint64_t from = reinterpret_cast<uint64_t>(image_rows) +
                      uint64_t(unsigned(min(first_row + row, source.last_row))) * source.row_stride;
      uint32_t to = all + row * tiles.pitch + x;
#pragma unroll 1
      for (int c = 0; c < channels; ++c, from += image.channel_stride, to += tiles.plane)
        start_copy(to, (from & ~uint64_t(15)) + x, x <= int(from % 16) + source.last - first_of_tile);
    }
  };
  // The weights of the rows of a tile, while the patches of another one are made.
  int const y_bytes = tiles.chunks * 2048;
  bool const is_of_rows = thread + 32 >= int(blockDim.x);
  auto const find_rows = [&](int i, int which) {
    write_y_weights(axis_y, scale_y, per_unit_y, i * size, min(tiles.down, image.rows - i) * size,
                    memory + sizeof(Shared) + which * y_bytes, y_bytes, shared.of_tiles[which]);
  };
  auto const begin_tile = [&](int which) {
    top = shared.of_tiles[which].top + lane / 4;
    if (has_columns) load(image_rows, 0);
  };
  if (is_of_rows) {
    find_rows(begin_i, 0);
  } else if constexpr (kStages) {
    stage(begin_i, 0);
    wait_for_copies();
  }
  __syncthreads();
  begin_tile(0);

  uint32_t const own_memory = opaque(shared_address(memory) + int(sizeof(Shared)) + 16 * lane);
  int const plane_bytes = kSize * (p.repeats ? size * size : 1);
  int64_t const strip_index = p.index(image, begin_i, tile_j);
  int which = 0;
  for (int i = begin_i; i < end_i; i += tiles.down, which ^= 1) {
    int const down = min(tiles.down, image.rows - i), next_i = i + tiles.down;
    if (next_i < end_i) {
      if (is_of_rows)
        find_rows(next_i, which ^ 1);
      else if constexpr (kStages)
        stage(next_i, which ^ 1);
    }
    if (has_columns) {
      uint32_t const y_weights = own_memory + which * y_bytes;
      uint4 of_rows[2][2];  // weights of 16 rows of the result, of 16 of the image
      auto const load_weights = [&](int chunk) {
#pragma unroll
        for (int m = 0; m < 2; ++m)
#pragma unroll
          for (int k = 0; k < 2; ++k) of_rows[m][k] = load_shared(y_weights + 2048 * chunk + 1024 * m + 512 * k);
      };
      if (Chunks == 1) load_weights(0);
      int const chunks = Chunks > 0 ? Chunks : (shared.of_tiles[which].count + kChunk - 1) / kChunk;
      uint8_t const* plane = image_rows;
      uint32_t plane_at = 0;  // bytes before the plane in the patches
      uint32_t rows_at = pixels + which * channels * tiles.plane + lane / 4 * tiles.pitch;
      int c = 0;
#pragma unroll 1
      do {
        uint8_t const* const next_plane = c + 1 < channels ? plane + image.channel_stride : plane;
        float rows[2][2][4];  // by 16 rows and 8 columns
#pragma unroll
        for (auto& sums : rows) begin_sums(sums);
#pragma unroll 1
        for (int k = 0; k < chunks; ++k) {
          float sums[4][4];
          begin_sums(sums);
          if constexpr (Steps > 0) {
            // Of the column from which on a row is loaded, in the first row of the lane.
            unsigned address = unsigned(reinterpret_cast<uintptr_t>(plane)) + unsigned(top) * source.row_stride;
            if constexpr (kStages) {
              uint32_t const before = source.from - first_of_tile;
              source.load(rows_at + k * (kChunk * tiles.pitch), tiles.pitch, address % 16 + before,
                          (address + 8 * source.row_stride) % 16 + before, words);
              address += before;
            } else {
              address += source.from - source.offset();
            }
            if (source.pixels == Pixels::shifted) source.shift(address, words);
#pragma unroll
            for (int s = 0; s < Steps; ++s)
#pragma unroll
              for (int j = 0; j < 4; ++j) multiply(sums[j], weights[s], low_pair(words[j][s]), high_pair(words[j][s]));
            bool const is_last = k + 1 == chunks;
            load(is_last ? next_plane : plane, is_last ? 0 : k + 1);
          } else {
            uint8_t const* from[4];
#pragma unroll
            for (int j = 0; j < 4; ++j) from[j] = source.row_of(plane, top + kChunk * k + 8 * j);
            auto const add = [&](auto pixels) {
#pragma unroll 2
              for (int s = 0; s < steps; ++s) {
                uint4 const weight = more_weights[32 * s];
                uint32_t words[4];
#pragma unroll
                for (int j = 0; j < 4; ++j)
                  words[j] = source.template word<pixels()>(from[j], source.from + column_of<0>(s));
#pragma unroll
                for (int j = 0; j < 4; ++j) multiply(sums[j], weight, low_pair(words[j]), high_pair(words[j]));
              }
            };
            if (source.pixels == Pixels::aligned)
              add(std::integral_constant<Pixels, Pixels::aligned>{});
            else if (Planes || source.pixels == Pixels::shifted)
              add(std::integral_constant<Pixels, Pixels::shifted>{});
            else if (source.pixels == Pixels::interleaved && source.is_safe(top - lane / 4 + kChunk * (k + 1)))
              add(std::integral_constant<Pixels, Pixels::interleaved>{});
            else
              add(std::integral_constant<Pixels, Pixels::apart>{});
          }
          uint32_t levels[4][2];
#pragma unroll
          for (int j = 0; j < 4; ++j)
            levels[j][0] = levels_of(sums[j][0], sums[j][1]), levels[j][1] = levels_of(sums[j][2], sums[j][3]);
          if (Chunks != 1) load_weights(k);
#pragma unroll
          for (int m = 0; m < 2; ++m)
#pragma unroll
            for (int l = 0; l < 2; ++l)
#pragma unroll
              for (int n = 0; n < 2; ++n) multiply(rows[m][n], of_rows[m][l], levels[2 * l][n], levels[2 * l + 1][n]);
        }

        Normalization const normalization = shared.of_channels[c];
        uint32_t const high = normalization.high & diagonal, low = normalization.low & diagonal;
        plane = next_plane;
#pragma unroll
        for (int m = 0; m < 2; ++m) {
          float v[2][4];
#pragma unroll
          for (int n = 0; n < 2; ++n) {
            uint32_t const upper = levels_below(rows[m][n][0], rows[m][n][1]);
            uint32_t const lower = levels_below(rows[m][n][2], rows[m][n][3]);
            multiply(v[n], upper, lower, high, normalization.most);
            multiply(v[n], upper, lower, low, {v[n][0], v[n][1], v[n][2], v[n][3]});
          }
          if (by_pairs) {
#pragma unroll
            for (int n = 0; n < 4; ++n)
              store_shared(row_at[2 * m + n % 2] + at[n / 2 * 2] + plane_at,
                           rounded_pair(v[n / 2][n % 2 * 2], v[n / 2][n % 2 * 2 + 1], U{}));
          } else {
#pragma unroll
            for (int n = 0; n < 8; ++n)
              store_shared(row_at[2 * m + n / 2 % 2] + at[n / 4 * 2 + n % 2] + plane_at, round_to<U>(v[n / 4][n % 4]));
          }
        }
        plane_at += plane_bytes, rows_at += tiles.plane;
      } while (++c < channels);
    }
    __syncthreads();
    if (next_i < end_i) begin_tile(which ^ 1);
    // Patches that are adjacent in the result, or single ones.
    bool const is_whole = group == p.merge;
    int const run = is_whole ? across * group : 1, bytes = kSize * elements * run;
    int n = 0;
#pragma unroll 1
    for (int y = 0; y < down; y += group)
#pragma unroll 1
      for (int x = 0; x < across; x += is_whole ? across : 1, ++n) {
        int64_t const index =
            is_whole ? strip_index + int64_t(i - begin_i + y) * image.columns : p.index(image, i + y, tile_j + x);
        auto* const to = static_cast<unsigned char*>(p.patches) + index * p.elements() * int64_t(kSize);
        unsigned char const* const from = memory + tiles.patches + n * bytes;
        auto const copy = [&](auto vector) {
          copy_patches<decltype(vector)>(from, to, bytes, kSize * size * size, tiles.per_plane, p.repeats);
        };
        if (tiles.vector == 16)
          copy(uint4{});
        else if (tiles.vector == 8)
          copy(uint2{});
        else if constexpr (sizeof(U) == 2)
          copy(uint16_t{});
        else
          copy(uint32_t{});
      }
    if constexpr (kStages) wait_for_copies();
    __syncthreads();
  }
}

// --- launches --------------------------------------------------------------------------------------------------------

// The largest tiles that fit shared memory, of blocks of merged patches where possible.
template <class U>
ByteTiles tiles_of(VisionPatches<uint8_t> const& p, PatchImage const* images, int count, bool planes) {
  int const size = p.patch;
  double shrink_x = 0, shrink_y = 0;
  int64_t across_all = 0, down_all = 0;
  for (int n = 0; n < count; ++n) {
    int64_t const columns = int64_t(images[n].columns) * size, rows = int64_t(images[n].rows) * size;
    shrink_x = max(shrink_x, double(images[n].width) / double(columns));
    shrink_y = max(shrink_y, double(images[n].height) / double(rows));
    across_all = max(across_all, int64_t(images[n].columns)), down_all = max(down_all, int64_t(images[n].rows));
  }
  // Pixels of the image that so many adjacent ones of the result read: less than a window more than from the first
  // one's center to the last one's.
  auto const read = [&](int64_t pixels, double shrink) {
    return int64_t(ceil(double(pixels - 1) * shrink + 2 * geometry::filter_radius(p.filter) * max(shrink, 1.)));
  };
  int64_t const steps = max(ceil_div(read(16, shrink_x) + 7, 16), int64_t(2));  // from a multiple of 8 on
  auto const with = [&](int64_t across, int64_t down) {
    int64_t const columns = across * size, rows = down * size, warps = ceil_div(columns, 16);
    int64_t const chunks = ceil_div(read(rows, shrink_y), kChunk);
    ByteTiles t{};
    t.across = int(across), t.down = int(down);
    t.group = across % p.merge == 0 && down % p.merge == 0 ? p.merge : 1;
    int64_t const unit = int64_t(sizeof(U)) * (p.repeats > 1        ? size * size
                                               : t.group == p.merge ? t.group * t.group * p.patch_elements()
                                                                    : p.patch_elements());
    t.per_size = unsigned(ceil_div(1 << 16, size)), t.per_group = unsigned(ceil_div(1 << 16, t.group));
    t.vector = unit % 16 == 0 ? 16 : unit % 8 == 0 ? 8 : int(sizeof(U));
    int64_t const plane_vectors = ceil_div(int64_t(sizeof(U)) * size * size, t.vector);
    t.per_plane = uint32_t(ceil_div(int64_t(1) << 32, max(plane_vectors, int64_t(2))));
    t.steps = int(steps), t.chunks = int(chunks);
    int64_t const x_weights = sizeof(Shared) + 2 * chunks * 2048;
    int64_t const pixels = x_weights + (steps > 3 ? warps * steps * 512 : 0);
    int64_t const patch_bytes = columns * rows * p.channels * int64_t(sizeof(U));
    t.rows = int(min(read(rows, shrink_y), chunks * kChunk));
    t.vectors = int(ceil_div(read(columns, shrink_x) + 15, 16));
    t.per_vectors = uint32_t(ceil_div(int64_t(1) << 32, t.vectors));
    // Products read rows and columns of no weight after the last ones.
    int64_t pixel_bytes = 0;
    for (int64_t const pitch : {int64_t(16) * t.vectors, ceil_div(16 * t.vectors - 32, 64) * 64 + 32}) {
      int64_t const bytes = 2 * p.channels * t.rows * pitch + (chunks * kChunk - t.rows) * pitch + 64;
      if (!stages(t.steps, planes) || pixels + bytes + patch_bytes > kShared) break;
      t.stages = true, t.pitch = uint32_t(pitch), t.plane = uint32_t(t.rows * pitch);
      pixel_bytes = ceil_div(bytes, 16) * 16;
    }
    t.x_weights = int(x_weights), t.pixels = int(pixels), t.patches = int(pixels + pixel_bytes);
    t.bytes = int(min(pixels + pixel_bytes + patch_bytes, int64_t(INT32_MAX)));
    return t;
  };
  auto const whole = [&](int64_t n) { return max(n >= p.merge ? n / p.merge * p.merge : n, int64_t(1)); };
  int64_t across = whole(min(int64_t((steps > 3 ? kWideColumns : kColumns) / size), across_all));
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

// Tiles of a strip, so that blocks, of which so many run at once, finish soonest: long strips, and whole waves of them.
int strip_of(ByteTiles const& tiles, PatchImage const* images, int count, int at_once) {
  int most = 1;
  for (int n = 0; n < count; ++n) most = max(most, int(ceil_div(images[n].rows, tiles.down)));
  int best = 1;
  int64_t least = INT64_MAX;
  for (int parts = 1; parts <= most; parts += (parts + 1) / 2) {
    int const strip = int(ceil_div(most, parts));
    int64_t blocks = 0;
    for (int n = 0; n < count; ++n)
      blocks += ceil_div(images[n].columns, tiles.across) * ceil_div(images[n].rows, tiles.down * strip);
    int64_t const tiles_each = ceil_div(blocks, int64_t(at_once)) * (strip + kPrologue);
    if (tiles_each < least) least = tiles_each, best = strip;
  }
  return best;
}

template <class U>
int launch(VisionPatches<uint8_t> const& p, CUstream_st* stream) {
  for (int first = 0; first < p.count; first += kImages) {
    VisionPatches<uint8_t> part = p;
    part.count = min(p.count - first, kImages);
    bool planes = true;
    for (int n = first; n < first + part.count; ++n) planes = planes && p.images[n].step == 1;
    ByteTiles tiles = tiles_of<U>(p, p.images + first, part.count, planes);
    planes = planes && (tiles.steps > 3 || tiles.stages);
    for (int n = first; n < first + part.count; ++n)
      if (max(p.images[n].row_stride, p.images[n].step * p.images[n].width) > INT32_MAX / 8) return kUnsupported;
    if (tiles.bytes > max_shared_bytes(kShared) || tiles.down * p.patch > kRows) return kUnsupported;
    tiles.strip =
        strip_of(tiles, p.images + first, part.count, multiprocessors() * blocks_at_once(tiles.steps, planes));
    Table table;
    unsigned const blocks = fill_table(part, p.images + first, tiles.across, tiles.down * tiles.strip, table);
    if (blocks == 0) continue;
    int const threads = int(ceil_div(tiles.across * p.patch, 16) + 1) * 32;
    auto const kernel_of = [&](auto of_planes) {
      constexpr bool kPlanes = of_planes();
      if (tiles.steps == 2 && tiles.chunks == 1) return make_patches_of_bytes<U, 2, 1, kPlanes>;
      if (tiles.steps == 2) return make_patches_of_bytes<U, 2, 0, kPlanes>;
      if (tiles.steps == 3) return make_patches_of_bytes<U, 3, 0, kPlanes>;
      if (threads <= threads_of(kColumns)) return make_patches_of_bytes<U, 0, 0, kPlanes>;
      return make_patches_of_bytes<U, 0, 0, kPlanes, kWideColumns>;
    };
    auto* const kernel = planes ? kernel_of(std::true_type{}) : kernel_of(std::false_type{});
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
  if (major < 8 || (p.repeats > 1 && p.patch < 4)) return kUnsupported;
  for (int c = 0; c < p.channels; ++c)  // see Normalization
    if (!(p.scale[c] * 512 < 60000)) return kUnsupported;
  return p.dtype == DType::bfloat16 ? launch<BFloat16>(p, stream) : launch<float>(p, stream);
}

}  // namespace kv::contrib::cuda
