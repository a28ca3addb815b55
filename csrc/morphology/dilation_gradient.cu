// The gradient of dilation and erosion on CUDA by tiles of the image, for windows that are not too large for it, flat
// or not, in one launch and without other memory: first the maxima of all windows that have a pixel of the tile, with
// the parts of their ties, then the sums of these. One kernel for all types, which takes a while to compile; it looks
// at the type where it reads and writes images.
#include "core/dtype.cuh"
#include "dilation_tiles.cuh"

namespace kv::cuda {
namespace {

constexpr int kGradientThreads = 288;

struct AnyGradient {
  DilationBackward<float> p;  // of images that are stored as `type`
  DType type;
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
// Row y of a plane of them, as what they are.
template <class T, class F>
__device__ __forceinline__ auto row_of(Planes<F> const& images, int64_t plane, int64_t y, T) {
  using Type = std::conditional_t<std::is_const_v<F>, T const, T>;
  return reinterpret_cast<Type*>(images.data) + (images.row(plane, y) - images.data);
}

__global__ void __launch_bounds__(kGradientThreads, 3)
    gradient_by_tiles(__grid_constant__ AnyGradient const any, int across, int down) {
  DilationBackward<float> const& p = any.p;
  using Value = Ties<float>;
  extern __shared__ __align__(16) unsigned char bytes[];
  Window<float> const& window = p.window;
  GradientTile const tile(window);
  Place const at(across, down, tile.kRows, tile.kColumns);
  int const height = int(p.x.height), width = int(p.x.width), y0 = at.y, x0 = at.x;
  int64_t const sample = at.plane / p.planes;
  int const rows = min(tile.kRows, height - y0), columns = min(tile.kColumns, width - x0);
  // The windows, and the first of them.
  int const rows_of_windows = rows + window.height - 1, windows_of_row = columns + window.width - 1;
  int const top = y0 + window.top - (window.height - 1), left = x0 + window.left - (window.width - 1);
  bool const flat = is_flat(window, sample);
  Value* const found = reinterpret_cast<Value*>(bytes);                         // (rows of windows, tile.windows)
  Value* const along_y = reinterpret_cast<Value*>(bytes + tile.first_bytes());  // (rows of windows, tile.pixels)
  float* const pixels =
      flat ? reinterpret_cast<float*>(found) : reinterpret_cast<float*>(along_y);  // (.., tile.pixels)

  float const sign = window.sign();
  int const columns_of_pixels = windows_of_row + window.width - 1;
  dispatch_floating_dtype(any.type, [&](auto stored) {
    auto const* const first = row_of(p.x, at.plane, 0, stored) + (left - window.left);
    for_each_place(rows_of_windows + window.height - 1, columns_of_pixels, [&](int row, int column) {
      int const y = top - window.top + row, x = left - window.left + column;
      bool const inside = y >= 0 && y < height && x >= 0 && x < width;
      pixels[row * tile.pixels + column] = (inside ? read(first[y * p.x.row_stride + column]) : window.value) * sign;
    });
  });
  __syncthreads();

  // Maxima and ties to what the pixels get of them. The minimum of maxima is the maximum of what is negated.
  auto const share_out = [&] {
    dispatch_floating_dtype(any.type, [&](auto stored) {
      auto const* const grad = row_of(p.grad, at.plane, 0, stored) + left;
      for_each_place(rows_of_windows, windows_of_row, [&](int row, int column) {
        int const y = top + row, x = left + column;
        Value& of = found[row * tile.windows + column];
        Value const ties = of;
        bool const counts = y >= 0 && y < height && x >= 0 && x < width && ties.most == ties.most;
        of = {minus_infinity<float>(), 0};
        if (counts) of = {-ties.most, share(read(grad[y * p.grad.row_stride + column]), ties.count)};
      });
    });
    __syncthreads();
  };
  auto const store = [&](auto sum) {
    dispatch_floating_dtype(any.type, [&](auto stored) {
      auto const* const x_row = row_of(p.x, at.plane, y0, stored) + x0;
      auto* const out = row_of(p.grad_x, at.plane, y0, stored) + x0;
      for_each_place(rows, columns, [&](int y, int x) {
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
    for_each_place(rows_of_windows, windows_of_row, [&](int row, int column) {
      Value ties{minus_infinity<float>(), 0};
      for_each_member(
          [&](int i, int j, float offset) { ties.add(pixels[(row + i) * tile.pixels + column + j] + offset, 1.f); });
      found[row * tile.windows + column] = ties;
    });
    __syncthreads();
    share_out();
    for_each_place(rows, columns, [&](int y, int x) {
      float const own = pixels[(y + window.height - 1) * tile.pixels + x + window.width - 1];
      float sum = 0;
      for_each_member([&](int i, int j, float offset) {
        Value const& of = found[(y + window.height - 1 - i) * tile.windows + x + window.width - 1 - j];
        sum += own + offset == -of.most ? of.count : 0.f;
      });
      dispatch_floating_dtype(any.type, [&](auto stored) {
        row_of(p.grad_x, at.plane, y0 + y, stored)[x0 + x] = round_to<decltype(stored)>(sum);
      });
    });
    return;
  }

  // Calls join_windows for `rows` rows of windows at each of `columns` columns, from `from(row, column)`.
  auto const go_down = [&](int rows, int columns, int stride, auto read_at) {
    with_group(window.height, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(columns, (rows + N - 1) / N, [&](int column, int group) {
        join_windows<N>(
            window.height, [&](int i) { return read_at(group * N + i, column); },
            [&](int j, Value const& value) {
              if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
            });
      });
    });
    __syncthreads();
  };
  auto const go_across = [&](int rows, int columns, int stride) {
    with_group(window.width, [&](auto group_size) {
      constexpr int N = decltype(group_size)::value;
      for_each_group(rows, (columns + N - 1) / N, [&](int row, int group) {
        Value const* const from = along_y + row * stride + group * N;
        join_windows<N>(
            window.width, [&](int i) { return from[i]; },
            [&](int j, Value const& value) {
              if (group * N + j < columns) found[row * tile.windows + group * N + j] = value;
            });
      });
    });
    __syncthreads();
  };
  go_down(rows_of_windows, columns_of_pixels, tile.pixels,
          [&](int row, int column) { return Value{pixels[row * tile.pixels + column], 1}; });
  go_across(rows_of_windows, windows_of_row, tile.pixels);
  share_out();
  go_down(rows, windows_of_row, tile.windows, [&](int row, int column) { return found[row * tile.windows + column]; });
  go_across(rows, columns, tile.windows);
  store([&](int y, int x, float own) {
    Value const& of = found[y * tile.windows + x];
    return own == -of.most ? of.count : 0.f;
  });
}

}  // namespace

template <class T>
int dilation_gradient(DilationBackward<T> const& p, CUstream_st* stream) {
  AnyGradient const any{{as_floats(p.grad), as_floats(p.x), as_floats(p.grad_x), p.window, p.planes, nullptr},
                        kDType<T>};
  return launch_tiles(gradient_by_tiles, any, p.x, GradientTile::kRows, GradientTile::kColumns, kGradientThreads,
                      GradientTile(p.window).bytes(), stream);
}

template int dilation_gradient(DilationBackward<float> const&, CUstream_st*);
template int dilation_gradient(DilationBackward<Half> const&, CUstream_st*);
template int dilation_gradient(DilationBackward<BFloat16> const&, CUstream_st*);

}  // namespace kv::cuda
