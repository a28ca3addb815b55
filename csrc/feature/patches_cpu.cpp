// Patches of local affine frames on the CPU. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "patches.h"

namespace kv::feature::KV_ISA {
namespace {

// The coordinates of the samples along an axis of a patch.
template <class F>
struct PatchCoordinates {
  Scratch<F> u;
  KV_HD explicit PatchCoordinates(int n) : u(n) {
    for (int k = 0; k < n; ++k) u.data[k] = patch_coordinate<F>(k, n);
  }
};

// Calls samples(width, index, u, v) over a patch, without overlap.
template <class T, class Call>
KV_HD void for_each_sample(PatchCoordinates<Compute<T>> const& at, int n, Call samples) {
  constexpr int N = kLanes<T>;
  for (int i = 0; i < n; ++i) {
    int j = 0;
    for (; j + N <= n; j += N) samples(Width<N>{}, int64_t(i) * n + j, load<N>(at.u.data + j), at.u.data[i]);
    for (; j < n; ++j) samples(Width<1>{}, int64_t(i) * n + j, at.u.data[j], at.u.data[i]);
  }
}

// Pixels at indices.
template <int N, class T, class I>
KV_HD Lanes<Compute<T>, N> gather(T const* p, I const& indices) {
  if constexpr (N == 1) {
    return load<1>(p + indices);
  } else {
#if defined(__AVX512F__)
    if constexpr (__is_same(T, float) && N == 16)
      return (Lanes<float, N>)_mm512_i32gather_ps((__m512i)indices, p, sizeof(T));
#elif defined(__AVX2__)
    if constexpr (__is_same(T, float) && N == 8)
      return (Lanes<float, N>)_mm256_i32gather_ps(p, (__m256i)indices, sizeof(T));
#endif
    Lanes<Compute<T>, N> v;
    for (int i = 0; i < N; ++i) v[i] = load<1>(p + indices[i]);
    return v;
  }
}

template <class V>
KV_HD auto sum_of_lanes(V const& v) {
  if constexpr (__is_same(V, float) || __is_same(V, double)) {
    return v;
  } else {
    auto sum = v[0];
    for (int i = 1; i < int(sizeof(V) / sizeof(v[0])); ++i) sum += v[i];
    return sum;
  }
}

}  // namespace

// Patches [begin, end) of all images.
template <class T>
void sample_patches(SamplePatches<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n;
  PatchCoordinates<F> const at(p.n);
  for (int64_t k = begin; k < end; ++k) {
    T* const out = p.patches + k * p.channels * area;
    LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
    if (f.level < 0) {
      for (int64_t i = 0; i < p.channels * area; ++i) store<1>(out + i, F(0));
      continue;
    }
    T const* const level = p.level(k / p.count, f.level);
    int64_t const stride = p.plane_stride(f.level);
    for (int i = 0; i < p.n; ++i)
      for_each_vector<T>(0, p.n, [&](auto width, int64_t j) KV_INLINE {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        BilinearTaps<F, V> const taps(f, load<N>(at.u.data + j), at.u.data[i]);
        for (int c = 0; c < p.channels; ++c) {
          T const* const plane = level + c * stride;
          V values[4];
          for (int t = 0; t < 4; ++t) values[t] = gather<N>(plane, taps.indices[t]);
          store<N>(out + c * area + int64_t(i) * p.n + j, taps.sample(values));
        }
      });
  }
}

namespace {

// Adds the gradient of a plane's patches to it, in their order.
template <class T>
KV_HD void scatter_to_plane(SamplePatchesBackward<T> const& p, PatchCoordinates<Compute<T>> const& at, int64_t plane) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n, b = plane / p.channels, c = plane % p.channels;
  for (int64_t k = b * p.count; k < (b + 1) * p.count; ++k) {
    LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
    if (f.level < 0) continue;
    F* const to = p.grad_pyramid + plane * p.shape.size + p.shape.offsets[f.level];
    T const* const grad = p.grad + (k * p.channels + c) * area;
    for_each_sample<T>(at, p.n, [&](auto width, int64_t i, auto u, F v) KV_INLINE {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      BilinearTaps<F, V> const taps(f, u, v);
      V w[4];
      taps.weights(w);
      V const g = load<N>(grad + i);
      for (int t = 0; t < 4; ++t) {
        V const weighted = w[t] * g;
        if constexpr (N == 1)
          to[taps.indices[t]] += weighted;
        else
          for (int lane = 0; lane < N; ++lane) to[taps.indices[t][lane]] += weighted[lane];
      }
    });
  }
}

template <class T>
KV_HD void differentiate_frame(SamplePatchesBackward<T> const& p, PatchCoordinates<Compute<T>> const& at, int64_t k) {
  using F = Compute<T>;
  int64_t const area = int64_t(p.n) * p.n;
  F total[6] = {};
  LevelFrame<F> const f = level_frame(p.frames + 6 * k, p.shape, p.window);
  if (f.level >= 0) {
    T const* const level = p.pyramid + k / p.count * p.channels * p.shape.size + p.shape.offsets[f.level];
    T const* const grad = p.grad + k * p.channels * area;
    for_each_sample<T>(at, p.n, [&](auto width, int64_t i, auto u, F v) KV_INLINE {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      BilinearTaps<F, V> const taps(f, u, v);
      V gx{}, gy{};
      for (int c = 0; c < p.channels; ++c) {
        T const* const plane = level + c * p.shape.size;
        V values[4], along_x, along_y;
        for (int t = 0; t < 4; ++t) values[t] = gather<N>(plane, taps.indices[t]);
        taps.gradient(values, along_x, along_y);
        V const g = load<N>(grad + c * area + i);
        gx += g * along_x, gy += g * along_y;
      }
      V sums[6] = {};
      add_frame_gradient<F, V>(sums, gx, gy, u, v);
      for (int s = 0; s < 6; ++s) total[s] += sum_of_lanes(sums[s]);
    });
  }
  for (int i = 0; i < 6; ++i) p.grad_frames[6 * k + i] = total[i] * (i < 3 ? f.scale_x : f.scale_y);
}

}  // namespace

// The planes of the pyramids first, then the frames, where they are requested.
template <class T>
void sample_patches_backward(SamplePatchesBackward<T> const& p, int64_t begin, int64_t end) {
  int64_t const planes = p.grad_pyramid ? p.batch * p.channels : 0;
  PatchCoordinates<Compute<T>> const at(p.n);
  for (int64_t i = begin; i < end; ++i)
    if (i < planes)
      scatter_to_plane(p, at, i);
    else
      differentiate_frame(p, at, i - planes);
}

KV_INSTANTIATE(sample_patches, SamplePatches)
KV_INSTANTIATE(sample_patches_backward, SamplePatchesBackward)

}  // namespace kv::feature::KV_ISA
