// The gradient of dilation and erosion on CUDA by tiles of the image, for all windows that fit into shared memory, flat
// or not, in one launch without a workspace. A block computes the maxima of all windows that read a pixel of the tile
// with the gradients of their ties, then the sums of these. One kernel serves all types, because it is slow to compile;
// it dispatches on the type where it reads and writes images.
#include "core/dtype.cuh"
#include "dilation_tiles.cuh"

namespace kv::morphology::cuda {
namespace {

constexpr int kBackwardThreads = 288;

struct AnyTypeBackward {
  DilationBackward<float> p;  // the images are stored as `type`
  DType type;
  bool flat_left_out;
};
template <class T>
auto as_floats(Planes<T> const& p) {
  using F = std::conditional_t<std::is_const_v<T>, float const, float>;
  return Planes<F>{reinterpret_cast<F*>(p.data),
                   p.outer,
                   p.inner,
                   p.outer_stride,
                   p.inner_stride,
                   p.row_stride,
                   p.height,
                   p.width,
                   p.step};
}
// Row y of a plane as a pointer to the storage type.
template <class T, class F>
__device__ __forceinline__ auto row_of(Planes<F> const& images, int64_t plane, int64_t y, T) {
  using Type = std::conditional_t<std::is_const_v<F>, T const, T>;
  return reinterpret_cast<Type*>(images.data) + (images.row(plane, y) - images.data);
}

__global__ void __launch_bounds__(kBackwardThreads, 3)
    backward_by_tiles(__grid_constant__ AnyTypeBackward const any, int across, int down) {
  DilationBackward<float> const& p = any.p;
  using Value = Ties<float>;
  extern __shared__ __align__(16) unsigned char bytes[];
  StructuringElement<float> const& window = p.window;
  BackwardTileLayout const layout(window);
  Tile const tile(across, down, layout.kRows, layout.kColumns);
  int const height = int(p.x.height), width = int(p.x.width), y0 = tile.y, x0 = tile.x;
  int64_t const sample = tile.plane / p.planes;
  int const rows = min(layout.kRows, height - y0), columns = min(layout.kColumns, width - x0);
  // The number of windows, and the position of the first.
  int const rows_of_windows = rows + window.height - 1, windows_of_row = columns + window.width - 1;
  int const top = y0 + window.top - (window.height - 1), left = x0 + window.left - (window.width - 1);
  bool const flat = is_flat(window, sample);
  if (flat && any.flat_left_out) return;
  Value* const results = reinterpret_cast<Value*>(bytes);                         // (rows of windows, layout.windows)
  Value* const along_y = reinterpret_cast<Value*>(bytes + layout.first_bytes());  // (rows of windows, layout.pixels)
  float* const pixels =
      flat ? reinterpret_cast<float*>(results) : reinterpret_cast<float*>(along_y);  // (.., layout.pixels)

  float const sign = window.sign();
  int const columns_of_pixels = windows_of_row + window.width - 1;
  dispatch_floating_dtype(any.type, [&](auto stored) {
    auto const* const first = row_of(p.x, tile.plane, 0, stored) + (left - window.left);
    for_each_pixel(rows_of_windows + window.height - 1, columns_of_pixels, [&](int row, int column) {
      int const y = top - window.top + row, x = left - window.left + column;
      bool const inside = y >= 0 && y < height && x >= 0 && x < width;
      pixels[row * layout.pixels + column] = (inside ? read(first[y * p.x.row_stride + column]) : window.value) * sign;
    });
  });
  __syncthreads();

  // Replaces maxima and tie counts by negative maxima and tie gradients: a minimum of maxima is computed as the maximum
  // of their negatives.
  auto const to_gradients = [&] {
    dispatch_floating_dtype(any.type, [&](auto stored) {
      auto const* const grad = row_of(p.grad, tile.plane, 0, stored) + left;
      for_each_pixel(rows_of_windows, windows_of_row, [&](int row, int column) {
        int const y = top + row, x = left + column;
        Value& window_result = results[row * layout.windows + column];
        Value const ties = window_result;
        bool const counts = y >= 0 && y < height && x >= 0 && x < width && ties.value == ties.value;
        window_result = {minus_infinity<float>(), 0};
        if (counts) window_result = {-ties.value, tie_gradient(read(grad[y * p.grad.row_stride + column]), ties.count)};
      });
    });
    __syncthreads();
  };
  auto const store = [&](auto sum) {
    dispatch_floating_dtype(any.type, [&](auto stored) {
      auto const* const x_row = row_of(p.x, tile.plane, y0, stored) + x0;
      auto* const out = row_of(p.grad_x, tile.plane, y0, stored) + x0;
      for_each_pixel(rows, columns, [&](int y, int x) {
        float const own = read(x_row[y * p.x.row_stride + x]) * sign;
        out[y * p.grad_x.row_stride + x] = round_to<decltype(stored)>(sum(y, x, own));
      });
    });
  };

  if (!flat) {
    auto const for_each_member = [&](auto f) {
      for (int i = 0; i < window.height; ++i)
        for (int j = 0; j < window.width; ++j) {
          float const offset = window.offset(sample, i * window.width + j);
          if (offset != minus_infinity<float>()) f(i, j, offset);
        }
    };
    for_each_pixel(rows_of_windows, windows_of_row, [&](int row, int column) {
      Value ties{minus_infinity<float>(), 0};
      for_each_member(
          [&](int i, int j, float offset) { ties.add(pixels[(row + i) * layout.pixels + column + j] + offset, 1.f); });
      results[row * layout.windows + column] = ties;
    });
    __syncthreads();
    to_gradients();
    for_each_pixel(rows, columns, [&](int y, int x) {
      float const own = pixels[(y + window.height - 1) * layout.pixels + x + window.width - 1];
      float sum = 0;
      for_each_member([&](int i, int j, float offset) {
        Value const& window_result = results[(y + window.height - 1 - i) * layout.windows + x + window.width - 1 - j];
        sum += own + offset == -window_result.value ? window_result.count : 0.f;
      });
      dispatch_floating_dtype(any.type, [&](auto stored) {
        row_of(p.grad_x, tile.plane, y0 + y, stored)[x0 + x] = round_to<decltype(stored)>(sum);
      });
    });
    return;
  }

  // Combines windows along y for `rows` rows at each of `columns` columns, from `read_at(row, column)`.
  auto const combine_columns = [&](int rows, int columns, int stride, auto read_at) {
    dispatch_group_size(window.height, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(columns, (rows + N - 1) / N, [&](int column, int group) {
        combine_windows<N>(
            window.height, [&](int i) { return read_at(group * N + i, column); },
            [&](int j, Value const& value) {
              if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
            });
      });
    });
    __syncthreads();
  };
  auto const combine_rows = [&](int rows, int columns, int stride) {
    dispatch_group_size(window.width, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(rows, (columns + N - 1) / N, [&](int row, int group) {
        Value const* const from = along_y + row * stride + group * N;
        combine_windows<N>(
            window.width, [&](int i) { return from[i]; },
            [&](int j, Value const& value) {
              if (group * N + j < columns) results[row * layout.windows + group * N + j] = value;
            });
      });
    });
    __syncthreads();
  };
  combine_columns(rows_of_windows, columns_of_pixels, layout.pixels,
                  [&](int row, int column) { return Value{pixels[row * layout.pixels + column], 1}; });
  combine_rows(rows_of_windows, windows_of_row, layout.pixels);
  to_gradients();
  combine_columns(rows, windows_of_row, layout.windows,
                  [&](int row, int column) { return results[row * layout.windows + column]; });
  combine_rows(rows, columns, layout.windows);
  store([&](int y, int x, float own) {
    Value const& window_result = results[y * layout.windows + x];
    return own == -window_result.value ? window_result.count : 0.f;
  });
}

}  // namespace

template <class T>
int dilation_backward_tiles(DilationBackward<T> const& p, bool flat_left_out, CUstream_st* stream) {
  AnyTypeBackward const any{
      {as_floats(p.grad), as_floats(p.x), as_floats(p.grad_x), p.window, p.planes, nullptr}, kDType<T>, flat_left_out};
  return launch_tiles(backward_by_tiles, any, p.x, BackwardTileLayout::kRows, BackwardTileLayout::kColumns,
                      kBackwardThreads, BackwardTileLayout(p.window).bytes(), stream);
}

template int dilation_backward_tiles(DilationBackward<float> const&, bool, CUstream_st*);
template int dilation_backward_tiles(DilationBackward<Half> const&, bool, CUstream_st*);
template int dilation_backward_tiles(DilationBackward<BFloat16> const&, bool, CUstream_st*);

}  // namespace kv::morphology::cuda
