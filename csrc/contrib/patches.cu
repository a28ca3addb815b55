// Patches on CUDA: a thread copies a vector of a row of a patch, or sums a vector of a row of the image. Those of
// patches are aligned, those of images need not be. Rows are numbered within the group of a block, a row of patches or
// a plane, so that 32 bits suffice.
#include "core/row_vectors.cuh"
#include "patches.h"

namespace kv::contrib::cuda {
namespace {

constexpr int kThreads = 256;

// Division of 32-bit numbers by a number that is known on the host, as a product with an error below 1 / divisor.
struct Divisor {
  uint64_t inverse;  // 2^64 / divisor, rounded up
  explicit Divisor(int64_t divisor) : inverse(divisor > 1 ? ~uint64_t(0) / uint64_t(divisor) + 1 : 0) {}
  __device__ __forceinline__ unsigned operator()(unsigned n) const {
    return inverse ? unsigned(__umul64hi(inverse, n)) : n;
  }
};

// Divides rows of `vectors` vectors among blocks: 2^shift threads take the vectors of a row, so a block has kThreads >>
// shift rows of a group of `rows`.
struct Blocks {
  int vectors, shift;
  unsigned rows, blocks_per_group;
  Divisor groups;
  Blocks(int64_t vectors, int64_t rows)
      : vectors(int(vectors)), shift(0), rows(unsigned(rows)), blocks_per_group(0), groups(1) {
    while ((1 << shift) < vectors && (1 << shift) < kThreads) ++shift;
    blocks_per_group = unsigned(ceil_div(rows, kThreads >> shift));
    groups = Divisor(blocks_per_group);
  }
  // False after the group's last row.
  __device__ __forceinline__ bool locate(unsigned& group, unsigned& row) const {
    group = groups(blockIdx.x);
    row = (blockIdx.x - group * blocks_per_group) * (kThreads >> shift) + (threadIdx.x >> shift);
    return row < rows;
  }
  // Calls f(i) for the thread's vectors of a row; with WholeWarps in all threads of a warp, also behind the row.
  template <bool WholeWarps = false, class Call>
  __device__ __forceinline__ void for_each_vector(Call f) const {
#pragma unroll 1
    for (int i = threadIdx.x & ((1 << shift) - 1); (WholeWarps ? i & ~31 : i) < vectors; i += 1 << shift) f(i);
  }
};

struct Divisors {
  Divisor height, channels, down, step_y, step_x;
  explicit Divisors(PatchGrid const& g)
      : height(g.height), channels(g.channels), down(g.down), step_y(g.step_y), step_x(g.step_x) {}
};

// A group is a row of patches, which has (across, C, height) rows of pixels.
template <class T, int P, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    extract(__grid_constant__ Extract<T> const p, __grid_constant__ Blocks const blocks,
            __grid_constant__ Divisors const by, T const* image_end) {
  PatchGrid const& grid = p.grid;
  unsigned patch_row, row;
  if (!blocks.locate(patch_row, row)) return;
  unsigned const sample = by.down(patch_row), i = patch_row - sample * grid.down;
  unsigned const q = by.height(row), j = by.channels(q), channel = q - j * unsigned(grid.channels);
  int const y = int(i) * grid.step_y - grid.top + int(row - q * grid.height), left = int(j) * grid.step_x - grid.left;
  bool const in_bounds = y >= 0 && y < p.image.height;
  T const* const from = p.image.row(sample * grid.channels + channel, in_bounds ? y : 0) + left;
  T* const to = p.patches + (int64_t(patch_row) * blocks.rows + row) * grid.width;
  blocks.for_each_vector([&](int k) {
    Vector<T, P> vector{};
    int const column = left + k * P, width = int(p.image.width);
    if constexpr (Aligned) {
      if (in_bounds && column >= 0 && column < width) vector = *reinterpret_cast<Vector<T, P> const*>(from + k * P);
    } else if (in_bounds) {
      if (column >= 0 && column + P <= width) {
        vector = load_unaligned<P>(from + k * P, image_end);
      } else {
#pragma unroll
        for (int e = 0; e < P; ++e)
          if (column + e >= 0 && column + e < width) vector.v[e] = from[k * P + e];
      }
    }
    store_vector(to + k * P, vector);
  });
}

// The first and the last patch along an axis that have pixel x.
__device__ __forceinline__ int first_patch(int x, int size, Divisor const& step) {
  return x < size ? 0 : int(step(unsigned(x - size))) + 1;
}
__device__ __forceinline__ int last_patch(int x, Divisor const& step, int count) {
  return min(int(step(unsigned(x))), count - 1);
}

// A group is a plane of the image.
template <class T, int P, bool Aligned>
__global__ void __launch_bounds__(kThreads)
    combine(__grid_constant__ Combine<T> const p, __grid_constant__ Blocks const blocks,
            __grid_constant__ Divisors const by) {
  using F = Compute<T>;
  PatchGrid const& grid = p.grid;
  unsigned plane, y;
  if (!blocks.locate(plane, y)) return;
  int const below = int(y) + grid.top;
  int const first_i = first_patch(below, grid.height, by.step_y), last_i = last_patch(below, by.step_y, grid.down);
  unsigned const sample = by.channels(plane);
  int64_t const channel = plane - sample * unsigned(grid.channels);
  T* const to = p.image.row(plane, y);
  blocks.for_each_vector<!Aligned>([&](int k) {
    int const right = k * P + grid.left;
    int const first_j = first_patch(right, grid.width, by.step_x), last_j = last_patch(right, by.step_x, grid.across);
    F sums[P] = {};
    for (int i = k < blocks.vectors ? first_i : last_i + 1; i <= last_i; ++i)
      for (int j = first_j; j <= last_j; ++j) {
        int64_t const patch = (int64_t(sample) * grid.down + i) * grid.across + j;
        int64_t const row = (patch * grid.channels + channel) * grid.height + (below - i * grid.step_y);
        T const* const from = p.patches + row * grid.width + (right - j * grid.step_x);
        Vector<T, P> const vector = *reinterpret_cast<Vector<T, P> const*>(from);
#pragma unroll
        for (int e = 0; e < P; ++e) sums[e] += read(vector.v[e]);
      }
    if constexpr (Aligned)
      store_vector(to + k * P, sums);
    else
      store_striped<P, kThreads / 32>(to + k * P, sums, k * P, int(p.image.width));
  });
}

// Whether the P pixels of each vector of the image are in the same patches.
template <int P>
bool is_in_step(PatchGrid const& grid) {
  return grid.width % P == 0 && grid.step_x % P == 0 && grid.left % P == 0;
}

// Calls f with the pixels of a vector, and with whether those of the image are aligned: 16 bytes where they are so in
// the patches and `unaligned` in the image, else one.
template <class T, class F>
void with_vectors(Planes<T> const& image, void const* patches, PatchGrid const& grid, bool unaligned, F f) {
  constexpr int P = 16 / int(sizeof(T));
  bool const whole = reinterpret_cast<uintptr_t>(patches) % 16 == 0 && grid.width % P == 0;
  // Special case, H200: 1.04 (patches32) to 1.14 (patches32 backward) times as fast as unaligned rows.
  if (whole && is_vectorizable<P>(image) && is_in_step<P>(grid))
    f(std::integral_constant<int, P>{}, std::true_type{});
  else if (whole && unaligned)
    f(std::integral_constant<int, P>{}, std::false_type{});
  else
    f(std::integral_constant<int, 1>{}, std::true_type{});
}

}  // namespace

template <class T>
int extract_patches(Extract<T> const& p, CUstream_st* stream) {
  int64_t const rows = int64_t(p.grid.across) * p.grid.channels * p.grid.height;
  int64_t const patch_rows = p.image.count() / p.grid.channels * p.grid.down;
  if (rows > UINT32_MAX / 2) return cudaErrorInvalidValue;
  T const* const image_end = p.image.row(p.image.count() - 1, p.image.height - 1) + p.image.width;
  with_vectors(p.image, p.patches, p.grid, true, [&](auto pixels, auto aligned) {
    constexpr int P = decltype(pixels)::value;
    Blocks const blocks(p.grid.width / P, rows);
    extract<T, P, aligned.value><<<unsigned(patch_rows * blocks.blocks_per_group), kThreads, 0, stream>>>(
        p, blocks, Divisors(p.grid), image_end);
  });
  return cudaGetLastError();
}

template <class T>
int combine_patches(Combine<T> const& p, CUstream_st* stream) {
  constexpr int kVector = 16 / int(sizeof(T));
  bool const has_warps = p.image.width > 16 * kVector;  // each row
  with_vectors(p.image, p.patches, p.grid, has_warps && is_in_step<kVector>(p.grid), [&](auto pixels, auto aligned) {
    constexpr int P = decltype(pixels)::value;
    Blocks const blocks(ceil_div(p.image.width, P), p.image.height);
    combine<T, P, aligned.value>
        <<<unsigned(p.image.count() * blocks.blocks_per_group), kThreads, 0, stream>>>(p, blocks, Divisors(p.grid));
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(extract_patches, Extract)
KV_INSTANTIATE(combine_patches, Combine)

}  // namespace kv::contrib::cuda
