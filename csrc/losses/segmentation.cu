// Losses of segmentations on CUDA. A thread processes several pixels. It reads their logits once, class by class, into
// a column of shared memory that only this thread accesses. There the logits become exponentials, from which it
// computes sums or gradients.
//
// Where planes of a whole number of vectors begin at aligned addresses, a thread has adjacent pixels, which are read as
// one vector. Elsewhere it has every 32nd pixel, so that the pixels of a warp are adjacent wherever a plane begins:
//
//   aligned      0 0 0 0 1 1 1 1 2 2 2 2 ...                          threads of the pixels
//   elsewhere    0 1 2 3 ... 31 0 1 2 3 ... 31 0 1 2 3 ... 31 0 1 2 3 ... 31
#include "core/launch.cuh"
#include "core/row_sums.cuh"
#include "segmentation.h"

namespace kv::losses::cuda {
namespace {

constexpr int kThreads = 128;      // per block; fewer, a half or a quarter, to stay within
constexpr int kBytes = 76 * 1024;  // this much shared memory, or more with many classes
constexpr int kAtOnce = 8;         // classes whose loads a thread issues before it waits
constexpr int kFinalizeThreads = 1024;

struct Math {
  __device__ __forceinline__ float exp(float x) const { return fast_exp2(x * kLog2E<float>); }
  __device__ __forceinline__ double exp(double x) const { return ::exp(x); }
  __device__ __forceinline__ float log(float x) const { return logf(x); }
  __device__ __forceinline__ double log(double x) const { return ::log(x); }
};

// The larger of both; if one is NaN, the other one: the exponential of the NaN remains NaN.
__device__ __forceinline__ float largest(float a, float b) { return fmaxf(a, b); }
__device__ __forceinline__ double largest(double a, double b) { return fmax(a, b); }

// The P pixels of a thread in a sample: their labels, their counts (1, 0 or NaN), and their column of shared memory.
template <class T, int P, bool Adjacent>
struct Pixels {
  using F = Compute<T>;
  static constexpr int kApart = Adjacent ? 1 : 32;  // from one pixel of the thread to the next
  Logits<T> const& logits;
  F* const column;
  int const stride;
  int inside = P;  // pixels of the thread that are in the chunk; the others are ignored
  int label[P];
  F counts[P], maximum[P], sum[P];

  __device__ __forceinline__ Pixels(Logits<T> const& logits, void* shared)
      : logits(logits), column(static_cast<F*>(shared) + P * threadIdx.x), stride(P * int(blockDim.x)) {}

  __device__ __forceinline__ Vector<F, P> get(int c) const {
    return *reinterpret_cast<Vector<F, P> const*>(column + c * stride);
  }
  __device__ __forceinline__ void set(int c, Vector<F, P> const& v) const {
    *reinterpret_cast<Vector<F, P>*>(column + c * stride) = v;
  }
  // The value of pixel i in class c, as a scalar.
  __device__ __forceinline__ F& at(int c, int i) const { return column[c * stride + i]; }

  // The elements of the pixels, of which the first one is at `from`.
  template <class S>
  __device__ __forceinline__ Vector<S, P> load(S const* from) const {
    if constexpr (Adjacent) {
      return *reinterpret_cast<Vector<S, P> const*>(from);
    } else {
      Vector<S, P> vector;
#pragma unroll
      for (int i = 0; i < P; ++i) vector.v[i] = i < inside ? from[kApart * i] : S{};
      return vector;
    }
  }
  template <class S>
  __device__ __forceinline__ void store(S* to, F const (&v)[P]) const {
    if constexpr (Adjacent) {
      store_vector(to, v);
    } else {
#pragma unroll
      for (int i = 0; i < P; ++i)
        if (i < inside) to[kApart * i] = round_to<S>(v[i]);
    }
  }

  // Loads the logits of the pixels from `pixel` on, of those before `end`, into the column; 0 where the label is
  // ignored.
  __device__ __forceinline__ void read_logits(int64_t sample, int64_t pixel, int64_t end) {
    if constexpr (!Adjacent) inside = int(min(ceil_div(end - pixel, kApart), int64_t(P)));
    int const classes = int(logits.classes);
    auto const labels = load(logits.labels(sample) + pixel);
    T const* from = logits.sample(sample) + pixel;
#pragma unroll
    for (int i = 0; i < P; ++i) maximum[i] = -F(INFINITY);
#pragma unroll 1
    for (int c = 0; c < classes; c += kAtOnce, from += kAtOnce * logits.pixels) {
      Vector<T, P> vectors[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) vectors[k] = load(from + min(k, classes - 1 - c) * logits.pixels);
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        Vector<F, P> x;
#pragma unroll
        for (int i = 0; i < P; ++i) x.v[i] = read(vectors[k].v[i]), maximum[i] = largest(x.v[i], maximum[i]);
        set(min(c + k, classes - 1), x);  // clamped to the last class instead of a branch
      }
    }
#pragma unroll
    for (int i = 0; i < P; ++i) {
      label[i] = logits.class_of(labels.v[i]);
      counts[i] = Adjacent || i < inside ? logits.counts(labels.v[i]) : F(0);
      if (counts[i] == 0) {
        maximum[i] = 0;
#pragma unroll 1
        for (int c = 0; c < classes; ++c) at(c, i) = 0;
      }
    }
  }

  // Calls f(first class, vectors) for the column, four classes at a time, so that a thread waits once for four loads.
  template <class Call>
  __device__ __forceinline__ void for_each_class(Call f) const {
    int c = 0;
    auto const call = [&](auto count) {
      Vector<F, P> vectors[decltype(count)::value];
#pragma unroll
      for (int k = 0; k < decltype(count)::value; ++k) vectors[k] = get(c + k);
      f(c, vectors);
      c += decltype(count)::value;
    };
#pragma unroll 1
    while (c + 4 <= int(logits.classes)) call(std::integral_constant<int, 4>{});
#pragma unroll 1
    while (c < int(logits.classes)) call(std::integral_constant<int, 1>{});
  }

  // Replaces logits by their exponentials relative to the maximum, and passes each to f(class, vector).
  template <class Call>
  __device__ __forceinline__ void exponentiate(Call f) {
#pragma unroll
    for (int i = 0; i < P; ++i) sum[i] = 0;
    for_each_class([&](int c, auto& vectors) {
      constexpr int N = sizeof(vectors) / sizeof(*vectors);
#pragma unroll
      for (int k = 0; k < N; ++k)
#pragma unroll
        for (int i = 0; i < P; ++i)
          vectors[k].v[i] = Math{}.exp(vectors[k].v[i] - maximum[i]), sum[i] += vectors[k].v[i];
#pragma unroll
      for (int k = 0; k < N; ++k) set(c + k, vectors[k]), f(c + k, vectors[k]);
    });
  }
};

// Calls f(sample, first pixel, end of the chunk) for the pixels of chunk `chunk` that the thread processes, P at a
// time.
template <int P, bool Adjacent, class T, class Call>
__device__ __forceinline__ void for_each_run(Logits<T> const& logits, int64_t sample, int64_t chunk, Call f) {
  int const t = int(threadIdx.x), first = Adjacent ? P * t : t / 32 * 32 * P + t % 32;
  int64_t const end = min((chunk + 1) * logits.chunk, logits.pixels);
#pragma unroll 1
  for (int64_t pixel = chunk * logits.chunk + first; pixel < end; pixel += P * int64_t(blockDim.x))
    f(sample, pixel, end);
}

// --- overlap of regions ----------------------------------------------------------------------------------------------

// Every thread has its own sums, so that the order of additions does not depend on the labels.
template <class T, int P, bool Adjacent>
__global__ void __launch_bounds__(kThreads) sum_classes(__grid_constant__ Overlap<T> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char shared[];
  int const classes = int(p.logits.classes), threads = int(blockDim.x), lane = threadIdx.x % 32;
  int64_t const sample = blockIdx.x / p.logits.chunks, chunk = blockIdx.x - sample * p.logits.chunks;
  Pixels<T, P, Adjacent> pixels(p.logits, shared);
  F* const sums = reinterpret_cast<F*>(shared) + classes * pixels.stride;  // (3, classes, threads)
#pragma unroll 1
  for (int i = 0; i < 3 * classes; ++i) sums[i * threads + threadIdx.x] = 0;

  for_each_run<P, Adjacent>(p.logits, sample, chunk, [&](int64_t sample, int64_t pixel, int64_t end) {
    pixels.read_logits(sample, pixel, end);
    pixels.exponentiate([](int, Vector<F, P> const&) {});
    F scale[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      scale[i] = pixels.counts[i] / pixels.sum[i];
      int const own = pixels.label[i] * threads + threadIdx.x;
      sums[own] += pixels.at(pixels.label[i], i) * scale[i];
      sums[own + 2 * classes * threads] += pixels.counts[i];
    }
    pixels.for_each_class([&](int c, auto& vectors) {
      constexpr int N = sizeof(vectors) / sizeof(*vectors);
      F* const to = sums + (classes + c) * threads + threadIdx.x;
      F all[N];
#pragma unroll
      for (int k = 0; k < N; ++k) all[k] = to[k * threads];
#pragma unroll
      for (int k = 0; k < N; ++k)
#pragma unroll
        for (int i = 0; i < P; ++i) all[k] += vectors[k].v[i] * scale[i];
#pragma unroll
      for (int k = 0; k < N; ++k) to[k * threads] = all[k];
    });
  });
  __syncthreads();
  for (int i = threadIdx.x / 32; i < 3 * classes; i += threads / 32) {
    F sum = 0;
    for (int t = lane; t < threads; t += 32) sum += sums[i * threads + t];
    sum = warp_reduce(sum, Sum());
    if (lane == 0) p.partial[blockIdx.x * int64_t(3 * classes) + i] = sum;
  }
}

// The totals of a sample, computed by one warp and returned to all of its threads.
template <class F>
__device__ __forceinline__ OverlapTotals<F> totals_of(OverlapTerms<F> const& terms, F const* sums, int classes,
                                                      int64_t loss) {
  OverlapTotals<F> const own = OverlapTotals<F>::of(terms, sums, classes, loss, threadIdx.x % 32, 32);
  return {
      {warp_reduce(own.all.both, Sum()), warp_reduce(own.all.predicted, Sum()), warp_reduce(own.all.labelled, Sum())},
      warp_reduce(own.weight, Sum()),
      warp_reduce(own.score, Sum())};
}

// One block per loss sums the chunks, with one warp per sample.
template <class F>
__global__ void __launch_bounds__(kFinalizeThreads)
    finalize_overlap(OverlapTerms<F> const terms, int64_t batch, int classes, int64_t chunks, F const* partial, F* sums,
                     F* loss) {
  constexpr int kWarps = kFinalizeThreads / 32;
  __shared__ F losses[kWarps];
  int const bins = 3 * classes, warp = threadIdx.x / 32;
  sums += blockIdx.x * batch * bins, partial += blockIdx.x * batch * chunks * bins;
  for (int64_t i = threadIdx.x; i < batch * bins; i += kFinalizeThreads) {
    F const* const from = partial + i / bins * chunks * bins + i % bins;
    F sum = 0;
#pragma unroll 16
    for (int64_t chunk = 0; chunk < chunks; ++chunk) sum += from[chunk * bins];
    sums[i] = sum;
  }
  __syncthreads();
  F sum = 0;
  for (int64_t b = warp; b < batch; b += kWarps)
    sum += totals_of(terms, sums + b * bins, classes, blockIdx.x).loss(terms);
  losses[warp] = sum;
  __syncthreads();
  if (threadIdx.x > 0) return;
  for (int w = 1; w < kWarps; ++w) sum += losses[w];
  loss[blockIdx.x] = sum / F(batch);
}

template <class T, int P, bool Adjacent>
__global__ void __launch_bounds__(kThreads) find_overlap_backward(__grid_constant__ OverlapBackward<T> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char shared[];
  int const classes = int(p.logits.classes);
  int64_t const sample = blockIdx.x / p.logits.chunks, loss = sample / p.logits.batch;
  Pixels<T, P, Adjacent> pixels(p.logits, shared);
  F* const of_both = reinterpret_cast<F*>(shared) + classes * pixels.stride;
  F* const of_all = of_both + classes;
  F const* const sums = p.sums + sample * 3 * classes;
  OverlapTotals<F> const totals = totals_of(p.terms, sums, classes, loss);
  F const grad = p.grad[loss] / F(p.logits.batch);
  for (int c = threadIdx.x; c < classes; c += int(blockDim.x)) {
    Region<F> const r = Region<F>::of(sums, classes, c);
    totals.gradients(p.terms, grad, p.terms.weight_of(loss, c, r), r, of_both[c], of_all[c]);
  }
  __syncthreads();

  for_each_run<P, Adjacent>(
      p.logits, sample, blockIdx.x - sample * p.logits.chunks, [&](int64_t sample, int64_t pixel, int64_t end) {
        pixels.read_logits(sample, pixel, end);
        F dot[P] = {}, scale[P];
        pixels.exponentiate([&](int c, Vector<F, P> const& e) {
#pragma unroll
          for (int i = 0; i < P; ++i) dot[i] += e.v[i] * of_all[c];
        });
#pragma unroll
        for (int i = 0; i < P; ++i) {
          dot[i] = (dot[i] + pixels.at(pixels.label[i], i) * of_both[pixels.label[i]]) / pixels.sum[i];
          scale[i] = pixels.counts[i] / pixels.sum[i];
        }
        T* to = p.grad_logits + sample * classes * p.logits.pixels + pixel;
#pragma unroll 4
        for (int c = 0; c < classes; ++c, to += p.logits.pixels) {
          Vector<F, P> const e = pixels.get(c);
          F const all = of_all[c], own = all + of_both[c];
          F d[P];
#pragma unroll
          for (int i = 0; i < P; ++i) {
            F const derivative = e.v[i] * scale[i] * ((c == pixels.label[i] ? own : all) - dot[i]);
            d[i] = pixels.counts[i] == 0 ? F(0) : derivative;
          }
          pixels.store(to, d);
        }
      });
}

// --- the focal loss --------------------------------------------------------------------------------------------------

// For the pixels from `pixel` on: their losses, the gradients by log p, and the reciprocal sums of exponentials.
template <class T, int P, bool Adjacent>
__device__ __forceinline__ void evaluate(Pixels<T, P, Adjacent>& pixels, FocalTerms<Compute<T>> const& terms,
                                         int64_t sample, int64_t pixel, int64_t end, Compute<T> (&loss)[P],
                                         Compute<T> (&derivative)[P], Compute<T> (&scale)[P]) {
  using F = Compute<T>;
  pixels.read_logits(sample, pixel, end);
  F label[P], rest[P] = {};  // rest: the sum over the other classes
#pragma unroll
  for (int i = 0; i < P; ++i) label[i] = pixels.at(pixels.label[i], i);
  pixels.exponentiate([&](int c, Vector<F, P> const& e) {
#pragma unroll
    for (int i = 0; i < P; ++i) rest[i] += c == pixels.label[i] ? F(0) : e.v[i];
  });
#pragma unroll
  for (int i = 0; i < P; ++i) {
    F const factor = pixels.counts[i] * terms.factor(sample / pixels.logits.batch, pixels.label[i]);
    focal_of_pixels(factor, terms.gamma, label[i], pixels.maximum[i], rest[i], Math{}, loss[i], derivative[i],
                    scale[i]);
    if (pixels.counts[i] == 0) loss[i] = derivative[i] = 0;
  }
}

template <class T, int P, bool Adjacent>
__global__ void __launch_bounds__(kThreads) find_focal(__grid_constant__ Focal<T> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char shared[];
  int64_t const sample = blockIdx.x / p.logits.chunks;
  Pixels<T, P, Adjacent> pixels(p.logits, shared);
  F sum = 0;
  for_each_run<P, Adjacent>(p.logits, sample, blockIdx.x - sample * p.logits.chunks,
                            [&](int64_t sample, int64_t pixel, int64_t end) {
                              F loss[P], derivative[P], scale[P];
                              evaluate(pixels, p.terms, sample, pixel, end, loss, derivative, scale);
                              if (p.map) pixels.store(p.map + sample * p.logits.pixels + pixel, loss);
#pragma unroll
                              for (int i = 0; i < P; ++i) sum += loss[i];
                            });
  if (p.map) return;
  sum = block_sum<kThreads>(sum, int(blockDim.x) / 32);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T, int P, bool Adjacent>
__global__ void __launch_bounds__(kThreads) find_focal_backward(__grid_constant__ FocalBackward<T> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char shared[];
  int const classes = int(p.logits.classes);
  int64_t const sample = blockIdx.x / p.logits.chunks;
  F const of_sum = p.of_sums ? p.grad[sample / p.logits.batch] : F(0);
  Pixels<T, P, Adjacent> pixels(p.logits, shared);
  for_each_run<P, Adjacent>(
      p.logits, sample, blockIdx.x - sample * p.logits.chunks, [&](int64_t sample, int64_t pixel, int64_t end) {
        F loss[P], derivative[P], scale[P];
        evaluate(pixels, p.terms, sample, pixel, end, loss, derivative, scale);
        F const* const grad = p.grad + sample * p.logits.pixels + pixel;
#pragma unroll
        for (int i = 0; i < P; ++i) {
          derivative[i] = pixels.counts[i] == 0 ? F(0) : derivative[i] * (p.of_sums ? of_sum : grad[pixels.kApart * i]);
          scale[i] *= derivative[i];
        }
        T* to = p.grad_logits + sample * classes * p.logits.pixels + pixel;
#pragma unroll 4
        for (int c = 0; c < classes; ++c, to += p.logits.pixels) {
          Vector<F, P> const e = pixels.get(c);
          F d[P];
#pragma unroll
          for (int i = 0; i < P; ++i) d[i] = (c == pixels.label[i] ? derivative[i] : F(0)) - e.v[i] * scale[i];
          pixels.store(to, d);
        }
      });
}

// --- launching -------------------------------------------------------------------------------------------------------

// Calls f with the number of pixels per thread, and whether they are adjacent: if the alignment of `other` and of the
// logits allows it.
template <class T, class Call>
int with_pixels(Logits<T> const& logits, void const* other, Call f) {
  auto const aligned = [](void const* at) { return reinterpret_cast<uintptr_t>(at) % 16 == 0; };
  if constexpr (sizeof(T) == 8)
    return f(std::integral_constant<int, 1>{}, std::true_type{});
  else if (logits.pixels % 4 == 0 && aligned(logits.data) && aligned(logits.target) && aligned(other))
    return f(std::integral_constant<int, 4>{}, std::true_type{});
  else
    return f(std::integral_constant<int, 4>{}, std::false_type{});
}

// A kernel whose threads each need `numbers` values of shared memory per class, and whose block needs `more` values per
// class in addition.
template <class F, class Params>
int launch(void (*kernel)(Params), Params const& p, int numbers, int more, CUstream_st* stream) {
  int64_t const classes = p.logits.classes;
  int threads = kThreads;
  auto const bytes = [&] { return int(classes * sizeof(F) * (threads * numbers + more)); };
  while (threads > 32 && bytes() > max_shared_bytes(kBytes)) threads /= 2;
  if (bytes() > 48 * 1024)
    if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes())) return error;
  kernel<<<unsigned(p.logits.samples() * p.logits.chunks), threads, bytes(), stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int overlap(Overlap<T> const& p, CUstream_st* stream) {
  int const error = with_pixels(p.logits, nullptr, [&](auto pixels, auto adjacent) {
    constexpr int P = decltype(pixels)::value;
    return launch<Compute<T>>(sum_classes<T, P, adjacent.value>, p, P + 3, 0, stream);
  });
  if (error) return error;
  finalize_overlap<<<unsigned(p.logits.losses), kFinalizeThreads, 0, stream>>>(
      p.terms, p.logits.batch, int(p.logits.classes), p.logits.chunks, p.partial, p.sums, p.loss);
  return cudaGetLastError();
}

template <class T>
int overlap_backward(OverlapBackward<T> const& p, CUstream_st* stream) {
  return with_pixels(p.logits, p.grad_logits, [&](auto pixels, auto adjacent) {
    constexpr int P = decltype(pixels)::value;
    return launch<Compute<T>>(find_overlap_backward<T, P, adjacent.value>, p, P, 2, stream);
  });
}

template <class T>
int focal(Focal<T> const& p, CUstream_st* stream) {
  int const error = with_pixels(p.logits, p.map, [&](auto pixels, auto adjacent) {
    constexpr int P = decltype(pixels)::value;
    return launch<Compute<T>>(find_focal<T, P, adjacent.value>, p, P, 0, stream);
  });
  if (error || p.map) return error;
  return sum_chunks(p.partial, p.logits.losses, p.logits.batch * p.logits.chunks, p.sums, stream);
}

template <class T>
int focal_backward(FocalBackward<T> const& p, CUstream_st* stream) {
  return with_pixels(p.logits, p.grad_logits, [&](auto pixels, auto adjacent) {
    constexpr int P = decltype(pixels)::value;
    return launch<Compute<T>>(find_focal_backward<T, P, adjacent.value>, p, P, 0, stream);
  });
}

KV_INSTANTIATE(overlap, Overlap)
KV_INSTANTIATE(overlap_backward, OverlapBackward)
KV_INSTANTIATE(focal, Focal)
KV_INSTANTIATE(focal_backward, FocalBackward)

}  // namespace kv::losses::cuda
