// Patches on the CPU: rows [begin, end) of all patches, or of all planes. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "patches.h"

namespace kv::contrib::KV_ISA {

template <class T>
void extract_patches(Extract<T> const& p, int64_t begin, int64_t end) {
  PatchGrid const& grid = p.grid;
  for (int64_t r = begin; r < end;) {  // the rows of one channel of a patch
    int64_t const patch = r / grid.height / grid.channels, c = r / grid.height % grid.channels;
    int64_t const j = patch % grid.across, i = patch / grid.across % grid.down,
                  sample = patch / grid.across / grid.down;
    int64_t const top = i * grid.step_y - grid.top, left = j * grid.step_x - grid.left, width = grid.width;
    int64_t const first = clamp(-left, int64_t(0), width), last = clamp(p.image.width - left, first, width);
    T const* const plane = p.image.plane(sample * grid.channels + c) + left;
    for (int64_t row = r % grid.height; row < grid.height && r < end; ++row, ++r) {
      int64_t const y = top + row;
      T* const to = p.patches + r * width;
      if (y < 0 || y >= p.image.height || first == last) {
        __builtin_memset(to, 0, width * sizeof(T));
        continue;
      }
      if (first > 0) __builtin_memset(to, 0, first * sizeof(T));
      __builtin_memcpy(to + first, plane + y * p.image.row_stride + first, (last - first) * sizeof(T));
      if (last < width) __builtin_memset(to + last, 0, (width - last) * sizeof(T));
    }
  }
}

template <class T>
void combine_patches(Combine<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  PatchGrid const& grid = p.grid;
  int64_t const width = p.image.width;
  Scratch<F> sums(width);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.image.height, y = r % p.image.height;
    for (int64_t x = 0; x < width; ++x) sums.data[x] = 0;
    int const last = PatchGrid::last(int(y) + grid.top, grid.step_y, grid.down);
    for (int i = PatchGrid::first(int(y) + grid.top, grid.height, grid.step_y); i <= last; ++i)
      for (int j = 0; j < grid.across; ++j) {
        T const* const from = p.patches + grid.row(plane, i, j, y) * grid.width;
        int64_t const left = int64_t(j) * grid.step_x - grid.left;
        int64_t x = max(left, int64_t(0));
        int64_t const end_of_patch = min(left + grid.width, width);
        constexpr int N = kLanes<T>;
        for (; x + N <= end_of_patch; x += N)
          store<N>(sums.data + x, Lanes<F, N>(load<N>(sums.data + x) + load<N>(from + x - left)));
        for (; x < end_of_patch; ++x) sums.data[x] += load<1>(from + x - left);
      }
    T* const to = p.image.row(plane, y);
    for_each_vector<T>(0, width, [&](auto n, int64_t x) {
      constexpr int M = decltype(n)::value;
      store<M>(to + x, load<M>(sums.data + x));
    });
  }
}

KV_INSTANTIATE_WITH_BYTES(extract_patches, Extract)
KV_INSTANTIATE(combine_patches, Combine)

}  // namespace kv::contrib::KV_ISA
