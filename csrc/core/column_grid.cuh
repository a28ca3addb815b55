// How planes are split into blocks of threads that traverse columns downwards, and which part of a plane a block has.
// Adjacent blocks overlap by the reach of their windows.
#pragma once

#include "core/launch.cuh"

namespace kv {
namespace {

struct ColumnGrid {
  unsigned across, down, blocks;  // blocks in a row and in a column of a plane; blocks of all planes
  int rows, columns;              // per block

  // A block is no wider than its plane needs; the number of its columns is a multiple of `multiple`. It reads `more`
  // rows than it completes, `group` at a time, and the number of rows per block minimizes the work of each
  // multiprocessor. That holds `resident` blocks of the most columns, and no more blocks than fit its shared memory,
  // where each has `bytes`.
  ColumnGrid(int64_t planes, int64_t height, int64_t width, int most_columns, int reach, int more, int resident,
             int64_t bytes, int multiple = 32, int group = 1)
      : across(0), rows(1), columns(0) {
    int64_t const fewest = 1 + ceil_div(max(width - most_columns, int64_t(0)), most_columns - 2 * reach);
    for (int64_t parts = fewest; parts <= fewest + 2; ++parts) {
      int64_t const each = ceil_div(ceil_div(width + 2 * reach * (parts - 1), parts), multiple) * multiple;
      if (across == 0 || parts * each < int64_t(across) * columns) across = unsigned(parts), columns = int(each);
    }
    double min_work = INFINITY;
    int64_t const machine = multiprocessors();
    int64_t const fitting = max((int64_t(227) << 10) / (bytes + 1024), int64_t(1));
    int64_t const held = min(int64_t(resident) * most_columns / columns, fitting);
    for (int64_t parts = 1; parts <= height / 8 + 1; ++parts) {
      int64_t const each = ceil_div(ceil_div(height, parts), group) * group;
      int64_t const count = ceil_div(planes * across * ceil_div(height, each), machine);
      double const work = double(ceil_div(count, held) * held) * double(each + more);
      if (work < min_work) min_work = work, rows = int(each);
    }
    down = unsigned(ceil_div(height, rows));
    blocks = unsigned(planes * across * down);
  }
};

// The part of a plane that a block of a ColumnGrid has.
struct ColumnBlock {
  int64_t plane;
  int left, y0, y1, width, height;  // its first column and its rows; the sizes of the plane
  int first, last;                  // it writes columns from `first` to before `last`

  // `work` has images x and the sizes of the grid. `reach`: columns on either side of the block whose results are
  // incomplete; a multiple of the columns of a thread.
  template <class Work>
  __device__ __forceinline__ ColumnBlock(Work const& work, int columns, int reach)
      : width(int(work.x.width)), height(int(work.x.height)) {
    unsigned const line = blockIdx.x / work.across, block = blockIdx.x - line * work.across;
    plane = line / work.down;
    left = int(block) * (columns - 2 * reach);
    first = block == 0 ? 0 : left + reach;
    last = block + 1 == work.across ? width : left + columns - reach;
    y0 = int(line - unsigned(plane) * work.down) * work.rows;
    y1 = min(y0 + work.rows, height);
  }
  __device__ __forceinline__ bool owns(int c) const { return c >= first && c < last; }
};

// The position of a thread that has the column `column` along y. Along x it has Rows columns, from `x` on, of row `r`
// of the Rows rows that are processed together.
template <int Rows>
struct RowGroupPosition : ColumnBlock {
  int column, r, x;

  template <class Work>
  __device__ __forceinline__ RowGroupPosition(Work const& work, int reach) : ColumnBlock(work, int(blockDim.x), reach) {
    int const columns = int(blockDim.x);
    column = left + int(threadIdx.x);
    r = int(threadIdx.x) / (columns / Rows);
    x = left + Rows * (int(threadIdx.x) - r * (columns / Rows));
  }
};

}  // namespace
}  // namespace kv
