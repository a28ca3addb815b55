// Color programs of one frequent step whose parameters are numbers, from planes to planes of the same type, on CUDA.
// The step is a constant, and a thread takes 16 bytes of each channel, which may begin anywhere. Results of one channel
// are vectors: the first thread of a sample begins before it, where its result is none.
#include <algorithm>
#include <iterator>
#include <utility>

#include "core/row_vectors.cuh"
#include "program.cuh"
#include "program_step.h"

namespace kv::color::cuda {
namespace {

constexpr Step kAnyType[] = {Step::affine, Step::rgb_to_hsv, Step::hsv_to_rgb, Step::weighted_sum, Step::scale_shift};
constexpr Step kBytes[] = {Step::luma_u8_fixed_point, Step::scale_shift};

template <Step kStep>
constexpr int kChannelsOf = kPerValueSteps >> int(kStep) & 1 ? 1 : 3;
template <Step kStep>
constexpr int kResultsOf = kOneChannelSteps >> int(kStep) & 1 ? 1 : kChannelsOf<kStep>;

// OpenCV's luma of four pixels, exactly. A pixel's sum has its level in the third byte.
__device__ __forceinline__ uint32_t luma_of_bytes(uint32_t r, uint32_t g, uint32_t b, uint32_t of_rg, uint32_t of_b) {
  constexpr uint32_t kHalf = 1 << 15;
  uint32_t const low = __byte_perm(r, g, 0x5140), high = __byte_perm(r, g, 0x7362);  // r0 g0 r1 g1, r2 g2 r3 g3
  uint32_t const s0 = __dp2a_lo(of_rg, low, __dp2a_lo(of_b, b, kHalf)),
                 s1 = __dp2a_hi(of_rg, low, __dp2a_lo(of_b << 16, b, kHalf)),
                 s2 = __dp2a_lo(of_rg, high, __dp2a_hi(of_b, b, kHalf)),
                 s3 = __dp2a_hi(of_rg, high, __dp2a_hi(of_b << 16, b, kHalf));
  return __byte_perm(__byte_perm(s0, s1, 0x0062), __byte_perm(s2, s3, 0x0062), 0x5410);
}

template <class T, Step kStep>
__global__ void __launch_bounds__(kThreads) run_one_step(__grid_constant__ Program<float> const p) {
  constexpr int P = 16 / sizeof(T), C = kChannelsOf<kStep>, kResults = kResultsOf<kStep>;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    T const* const from = static_cast<T const*>(p.x.data) + n * p.x.outer_stride;
    T* const to = static_cast<T*>(p.y.data) + n * p.y.outer_stride;
    auto const before = [](T const* at) { return int(reinterpret_cast<uintptr_t>(at) % 16 / sizeof(T)); };
    int64_t const i = (int64_t(blockIdx.x) * kThreads + threadIdx.x) * P - (kResults == 1 ? before(to) : 0);
    bool const whole = i >= 0 && i + 2 * P <= p.pixels;
    uint32_t words[C][4];
    auto const each = [&](auto load) {  // of all channels before it waits for one
#pragma unroll
      for (int k = 0; k < C; ++k) {
        Vector<uint32_t, 4> const four = load(from + k * p.x.channel_stride + i);
        __builtin_memcpy(words[k], four.v, sizeof(four));
      }
    };
    bool aligned = true;
#pragma unroll
    for (int k = 0; k < C; ++k) aligned = aligned && before(from + k * p.x.channel_stride + i) == 0;
    if (whole && aligned) {
      each([](T const* own) { return *reinterpret_cast<Vector<uint32_t, 4> const*>(own); });
    } else if (whole) {
      each([](T const* own) { return load_shifted(own); });
    } else {
      each([&](T const* own) {
        Vector<uint32_t, 4> four{};
#pragma unroll
        for (int j = 0; j < P; ++j) {
          if (!is_in(i + j, p.pixels)) continue;
          T const element = own[j];
          uint32_t bits = 0;
          __builtin_memcpy(&bits, &element, sizeof(element));
          four.v[4 * j / P] |= bits << 128 * j / P % 32;
        }
        return four;
      });
    }

    Vector<T, P> results[kResults];
    if constexpr (kStep == Step::luma_u8_fixed_point) {
      uint32_t const of_rg = uint32_t(p.numbers[0]) * 2 | uint32_t(p.numbers[1]) << 17,
                     of_b = uint32_t(p.numbers[2]) * 2;
      uint32_t levels[4];
#pragma unroll
      for (int j = 0; j < 4; ++j) levels[j] = luma_of_bytes(words[0][j], words[1][j], words[2][j], of_rg, of_b);
      __builtin_memcpy(results, levels, sizeof(levels));
    } else {
      float c[C][P];
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j) {
          uint32_t const word = words[k][4 * j / P];
          if constexpr (sizeof(T) == 1) {
            c[k][j] = scaled_byte_of(word, j % 4, 1.f / 255);
          } else {
            T elements[P / 4];
            __builtin_memcpy(elements, &word, sizeof(word));
            c[k][j] = read(elements[j % (P / 4)]);
          }
        }
      EvaluateStep<float, C, P> values{c, p.numbers};
      run_step(kStep, values);
#pragma unroll
      for (int k = 0; k < kResults; ++k) {
        if constexpr (sizeof(T) == 1)
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] *= 255;
        results[k] = rounded<T>(c[k]);
      }
    }

    int const left = int(min(p.pixels - i, int64_t(1) << 30));
    bool const all_whole = kResults == 1 ? whole : __all_sync(0xffffffffu, whole);
#pragma unroll
    for (int k = 0; k < kResults; ++k) {
      T* const own = to + k * p.y.channel_stride + i;
      if (all_whole && before(own) == 0) {
        store_vector(own, results[k]);
      } else if constexpr (kResults == 1) {
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (is_in(i + j, p.pixels)) own[j] = results[k].v[j];
      } else {
        store_anywhere<P, kThreads / 32>(own, results[k], 0, left);
      }
    }
  }
}

// Whether values of the samples, of which steps that do not mix channels compute each alone, follow each other.
bool is_dense(Program<float> const& p, Pixels const& x) {
  if (x.channels == 1) return p.samples == 1 && x.step == 1;
  bool const planes = x.step == 1 && x.channel_stride == p.pixels, last = x.step == 3 && x.channel_stride == 1;
  return (planes || last) && x.inner == 1 && x.outer_stride == 3 * p.pixels;
}

template <class T, Step kStep>
int launch(Program<float> p, CUstream_st* stream) {
  constexpr int64_t P = 16 / sizeof(T);
  if (kChannelsOf<kStep> == 1) p.pixels *= p.samples * p.x.channels, p.samples = 1;
  dim3 const grid = grid_of(p.samples, ceil_div(p.pixels + P, kThreads * P));
  run_one_step<T, kStep><<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
// Calls f with the step of the program as a constant, if it is one of kSteps.
template <auto const& kSteps, class Call>
bool with_step(Step step, Call f) {
  return [&]<size_t... I>(std::index_sequence<I...>) {
    return ((step == kSteps[I] && (f(std::integral_constant<Step, kSteps[I]>{}), true)) || ...);
  }(std::make_index_sequence<std::size(kSteps)>{});
}

}  // namespace

// Special case, H200: 1.13 (rgb_to_hsv at 335x513) to 1.66 (gray) times as fast as the kernel of any program, float16.
bool takes_step(Program<float> const& p) {
  Step const step = p.step[0];
  auto const is_one_of = [&](auto const& steps) {
    return std::find(std::begin(steps), std::end(steps), step) != std::end(steps);
  };
  bool const bytes = p.x.type == DType::uint8;
  if (p.steps != 1 || p.has_order() || p.measures_mean || p.x.type != p.y.type || p.x.type == DType::float64 ||
      !(bytes ? is_one_of(kBytes) : is_one_of(kAnyType)))
    return false;
  float sum = 0;
  for (int i = 0; i < p.count; ++i) {
    float const x = p.numbers[i];  // weights of bytes are integers of 16 bits, and levels of their sums bytes
    sum += x;
    if (p.column[i] >= 0 || (step == Step::luma_u8_fixed_point && !(x >= 0 && x < 1 << 15 && x == float(int(x)))))
      return false;
  }
  if (step == Step::luma_u8_fixed_point && sum > 1 << 15) return false;
  if (is_per_value(step)) return p.x.step == p.y.step && is_dense(p, p.x) && is_dense(p, p.y);
  return p.x.step == 1 && p.y.step == 1 && p.x.channels == 3;
}

int program_of_step(Program<float> const& p, CUstream_st* stream) {
  int error = 0;
  auto const run = [&]<class T, auto const & kSteps>() {
    with_step<kSteps>(p.step[0], [&](auto step) { error = launch<T, step.value>(p, stream); });
  };
  if (p.x.type == DType::uint8) run.template operator()<uint8_t, kBytes>();
  if (p.x.type == DType::float32) run.template operator()<float, kAnyType>();
  if (p.x.type == DType::float16) run.template operator()<Half, kAnyType>();
  if (p.x.type == DType::bfloat16) run.template operator()<BFloat16, kAnyType>();
  return error;
}

}  // namespace kv::color::cuda
