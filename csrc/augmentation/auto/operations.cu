// The operations of policies on a batch on CUDA, and their gradients.
#include "augmentation/auto/operations.cuh"

namespace kv::augmentation::cuda {
namespace {

template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    measure_planes(__grid_constant__ ApplyOperations<T> const p, unsigned parts) {
  unsigned const plane = blockIdx.x / parts, channels = unsigned(p.channels()), b = plane / channels;
  measure_plane<P>(p, p.warp.x, b, b, int(plane - b * channels), blockIdx.x - plane * parts, parts);
}

template <class T, int C, class Vectors>
__global__ void __launch_bounds__(kThreads, 4)
    apply_to_tiles(__grid_constant__ ApplyOperations<T> const p, geometry::cuda::TileGrid tiles) {
  apply_to_tile<C>(p, tiles, 0, Vectors{});
}

// --- gradients -------------------------------------------------------------------------------------------------------

// The sums of a plane, for operations that need some: kGradientSums numbers, added up by the blocks of the plane.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    sum_gradients(__grid_constant__ ApplyOperationsBackward<T> const p, unsigned parts) {
  __shared__ int32_t results[kGradientSums];
  unsigned const plane = blockIdx.x / parts, part = blockIdx.x - plane * parts;
  int const channels = p.forward.channels(), t = int(threadIdx.x);
  int64_t const b = plane / unsigned(channels);
  int const channel = int(plane - b * channels);
  Operation const operation = p.forward.operation_of(b);
  if (operation != Operation::contrast && operation != Operation::auto_contrast) return;  // as all blocks of the plane

  Images<T const> const& x = p.forward.warp.x;
  int64_t const pixels = x.height * x.width, each = pixels_of_part(pixels, parts);
  int64_t const begin = min(int64_t(part) * each, pixels);
  float const* const measured = p.forward.measured + b * channels * kMeasured;
  T const* const grad = p.warp.grad.row(b, channel, 0);
  float const mean =
      channels == kColors ? mean_of<kColors>(measured, channels, pixels) : mean_of<1>(measured, channels, pixels);
  float const factor = p.forward.value_of(b);
  float const lowest = measured[channel * kMeasured], highest = measured[channel * kMeasured + 1];
  float sums[kGradientSums] = {};
  enhance::for_each_vector<kThreads, P>(x.row(b, channel, 0), 1, int(begin), int(min(begin + each, pixels)),
                                        [&](auto const& vector, int i) {
                                          int j = 0;
#pragma unroll
                                          for (T const stored : vector.v) {
                                            float const v = read(stored), g = read(grad[i + j++]);
                                            if (operation == Operation::contrast) {
                                              sums[0] += color::blend_vjp_gray(v, g, mean, factor);
                                            } else {
                                              sums[0] += g, sums[1] += g * (v - lowest);
                                              sums[2] += v == lowest, sums[3] += v == highest;
                                            }
                                          }
                                        });
  block_reduce<kThreads>(sums, Sum());
  if (t == 0)
#pragma unroll
    for (int i = 0; i < kGradientSums; ++i) results[i] = __float_as_int(sums[i]);
  __syncthreads();
  if (parts > 1) {
    cluster_arrive();
    cluster_wait();
  }
  if (part == 0 && t < kGradientSums) {
    float sum = 0;
    for (unsigned rank = 0; rank < parts; ++rank) sum += __int_as_float(load_of_block(&results[t], rank));
    p.sums[int64_t(plane) * kGradientSums + t] = sum;
  }
  if (parts > 1) {  // shared memory exists until it has been read
    cluster_arrive();
    cluster_wait();
  }
}

// The gradient of a thread's pixels that sharpen() makes: of row y of a plane from column x on. Image and gradient are
// dense. The gradient of a pixel goes to the 3 x 3 pixels around it, which depends on the 5 x 5 pixels of the image.
template <class T>
__device__ __forceinline__ void sharpen_vjp(T const* plane, T const* grad, int height, int width, int x, int y,
                                            float factor, Vector<T, kGroup>& result) {
  float pixels[5][kGroup + 4], lines[5][kGroup + 2];  // from column x - 2 on; sums of three, from x - 1 on
#pragma unroll
  for (int r = 0; r < 5; ++r) {
    T const* const row = plane + clamp(y + r - 2, 0, height - 1) * width;
#pragma unroll
    for (int j = 0; j < kGroup + 4; ++j) pixels[r][j] = read(row[clamp(x + j - 2, 0, width - 1)]);
#pragma unroll
    for (int j = 0; j < kGroup + 2; ++j) lines[r][j] = pixels[r][j] + pixels[r][j + 1] + pixels[r][j + 2];
  }
  float own[kGroup], around[kGroup] = {};
#pragma unroll
  for (int r = 0; r < 3; ++r) {
    int const from_y = y + r - 1;
    if (from_y < 0 || from_y >= height) continue;
#pragma unroll
    for (int j = 0; j < kGroup + 2; ++j) {
      int const from_x = x + j - 1;
      if (from_x < 0 || from_x >= width) continue;
      float const v = pixels[r + 1][j + 1], g = read(grad[from_y * width + from_x]);
      float const smooth = enhance::smoothed(lines[r][j] + lines[r + 1][j] + lines[r + 2][j], v, 0.f);
      bool const is_inner = from_y > 0 && from_y + 1 < height && from_x > 0 && from_x + 1 < width;
      enhance::SharpenedVjp<float> of{enhance::clipped_vjp(v, g, 0.f), 0, 0};
      if (is_inner) of = enhance::sharpened_vjp(v, smooth, g, factor);
      if (r == 1 && j >= 1 && j <= kGroup) own[j - 1] = of.own + enhance::smoothed(0.f, of.around, 0.f);
#pragma unroll
      for (int i = max(j - 2, 0); i <= min(j, kGroup - 1); ++i) around[i] += of.around;
    }
  }
#pragma unroll
  for (int i = 0; i < kGroup; ++i) result.v[i] = round_to<T>(own[i] + enhance::smoothed(around[i], 0.f, 0.f));
}

// Operations that move pixels, and those that do nothing, have their gradients from the warp.
template <class T, int C, class Vectors>
__global__ void __launch_bounds__(kThreads, 3)
    apply_to_gradients(__grid_constant__ ApplyOperationsBackward<T> const p, geometry::cuda::TileGrid tiles) {
  geometry::cuda::Tile<float> tile;
  tile.locate(tiles, 0);
  int64_t const b = tile.b;
  Images<T const> const &from = p.forward.warp.x, &grad = p.warp.grad;
  Images<T> const& to = p.warp.grad_x;
  int const width = int(from.width), height = int(from.height), channels = channels_of<C>(from.channels);
  Operation const operation = p.forward.operation_of(b);
  if (moves_pixels(operation) || operation == Operation::none || operation == Operation::identity) return;
  PixelGroup<T, Vectors> const group({}, tile.x, tile.y, width, height, operation == Operation::sharpness);
  if (group.count <= 0) return;
  float const* const measured = p.forward.measured + b * channels * kMeasured;
  float const* const sums = p.sums + b * channels * kGradientSums;
  float const value = p.forward.value_of(b);
  auto const apply = [&](int first) {
    Vector<T, kGroup> result[C];
    auto const store = [&] {
#pragma unroll
      for (int k = 0; k < C; ++k) group.store(to, b, first + k, result[k]);
    };
    if (operation == Operation::sharpness) {
#pragma unroll
      for (int k = 0; k < C; ++k)
        sharpen_vjp(from.row(b, first + k, 0), grad.row(b, first + k, 0), height, width, group.x, group.y, value,
                    result[k]);
      return store();
    }
    Vector<T, kGroup> stored[C];
#pragma unroll
    for (int k = 0; k < C; ++k) {
      stored[k] = group.load(from, b, first + k);
      result[k] = group.load(grad, b, first + k);
    }
    if (operation == Operation::equalize) {  // levels have none
#pragma unroll
      for (int k = 0; k < C; ++k) {
        bool const changes = measured[(first + k) * kMeasured] != 0;
#pragma unroll
        for (int j = 0; j < kGroup; ++j)
          if (changes && level_of(stored[k].v[j]) < kLevels) result[k].v[j] = round_to<T>(0.f);
      }
      return store();
    }
    int64_t const pixels = width * int64_t(height);
    ColorOperation const color = measured_operation<T, C>(operation, value, measured, first, channels, pixels);
    float c[C][kGroup], g[C][kGroup];
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < kGroup; ++j) c[k][j] = read(stored[k].v[j]), g[k][j] = read(result[k].v[j]);
    color::cuda::StepInputGradient<float, C, kGroup> gradient{c, g, color.parameters};
    run_color(color.step, gradient);
    if (operation == Operation::contrast) {
      float of_mean = 0;
#pragma unroll
      for (int k = 0; k < channels; ++k) of_mean += sums[k * kGradientSums];
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < kGroup; ++j) g[k][j] += of_mean / float(pixels) * gray_weight<C>(k, channels);
    } else if (operation == Operation::auto_contrast) {
#pragma unroll
      for (int k = 0; k < C; ++k) {
        float const *const range = measured + (first + k) * kMeasured, *const own = sums + (first + k) * kGradientSums;
        float const lowest = range[0], highest = range[1];
        if (lowest == highest) continue;
        enhance::RangeGradient<float> const of_range({own[0], own[1], own[2], own[3]}, lowest, highest, 1.f, kRangeEps);
#pragma unroll
        for (int j = 0; j < kGroup; ++j) {
          if (c[k][j] == lowest) g[k][j] += of_range.grad_smallest;
          if (c[k][j] == highest) g[k][j] += of_range.grad_largest;
        }
      }
    }
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < kGroup; ++j) result[k].v[j] = round_to<T>(g[k][j]);
    store();
  };
#pragma unroll 1
  for (int first = 0; first < channels; first += C) apply(first);
}

// --- launching -------------------------------------------------------------------------------------------------------

// Launches a kernel that takes all planes of the images x, by clusters where planes are large.
template <class Params, class T>
int launch_for_planes(void (*kernel)(Params, unsigned), Params const& p, Images<T const> const& x,
                      CUstream_st* stream) {
  int64_t const parts = parts_of_planes(kernel, x.height * x.width);
  return launch_clusters(kernel, unsigned(x.batch * x.channels * parts), kThreads, 0, unsigned(parts), stream, p,
                         unsigned(parts));
}
template <class T>
int launch_measuring(ApplyOperations<T> const& p, CUstream_st* stream) {
  constexpr int P = enhance::kRowVector<T>;
  return launch_for_planes(p.warp.x.step == 1 ? measure_planes<T, P> : measure_planes<T, 1>, p, p.warp.x, stream);
}

template <class T>
__global__ void __launch_bounds__(kThreads) choose(__grid_constant__ ChooseOperations<T> const p, int64_t steps) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < steps) p.choose(i);
}

}  // namespace

template <class T>
int apply_operations(ApplyOperations<T> const& p, CUstream_st* stream) {
  Images<T const> const& x = p.warp.x;
  if (int const error = launch_measuring(p, stream)) return error;
  geometry::cuda::TileGrid const tiles(x.batch, x.height, x.width, 1);
  bool const vectors = has_vectors(x) && has_vectors(p.warp.y);
  auto* const of_colors =
      vectors ? apply_to_tiles<T, kColors, std::true_type> : apply_to_tiles<T, kColors, std::false_type>;
  auto* const of_planes = vectors ? apply_to_tiles<T, 1, std::true_type> : apply_to_tiles<T, 1, std::false_type>;
  auto* const kernel = x.channels == kColors ? of_colors : of_planes;
  kernel<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int apply_operations_backward(ApplyOperationsBackward<T> const& p, CUstream_st* stream) {
  Images<T const> const& x = p.forward.warp.x;
  if (int const error = launch_measuring(p.forward, stream)) return error;
  if (int const error = geometry::cuda::sample_image_backward(p.warp, stream)) return error;
  if (int const error = launch_for_planes(sum_gradients<T, enhance::kRowVector<T>>, p, x, stream)) return error;
  geometry::cuda::TileGrid const tiles(x.batch, x.height, x.width, 1);
  bool const vectors = has_vectors(x) && has_vectors(p.warp.grad) && has_vectors(p.warp.grad_x);
  auto* const of_colors =
      vectors ? apply_to_gradients<T, kColors, std::true_type> : apply_to_gradients<T, kColors, std::false_type>;
  auto* const of_planes =
      vectors ? apply_to_gradients<T, 1, std::true_type> : apply_to_gradients<T, 1, std::false_type>;
  auto* const kernel = x.channels == kColors ? of_colors : of_planes;
  kernel<<<tiles.blocks, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int choose_operations(ChooseOperations<T> const& p, CUstream_st* stream) {
  int64_t const steps = p.batch * p.count * p.length;
  choose<<<unsigned(ceil_div(steps, int64_t(kThreads))), kThreads, 0, stream>>>(p, steps);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, float)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, uint8_t)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations, ApplyOperations, ::kv::BFloat16)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, float)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, ::kv::Half)
KV_INSTANTIATE_ONE(apply_operations_backward, ApplyOperationsBackward, ::kv::BFloat16)
KV_INSTANTIATE_ONE(choose_operations, ChooseOperations, float)

}  // namespace kv::augmentation::cuda
