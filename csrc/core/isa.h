// Instruction sets. Every *_cpu.cpp is compiled once for each, into its own namespace KV_ISA; the best one that the
// processor has is chosen when the library is loaded, and can be chosen by name (environment KVISION_ISA, kvision._C).
// Code of csrc/M is in namespace kv::M, that of csrc/core and csrc/glue in kv.
//
// An operator's header declares its kernel once, for CPU and CUDA:
//
//   KV_KERNEL(sobel, Sobel)     // template <class T> void sobel(Sobel<T> const&, int64_t begin, int64_t end) on CPU,
//                               // template <class T> int sobel(Sobel<T> const&, CUstream_st*) on CUDA
//
// *_cpu.cpp defines it inside `namespace kv::filters::KV_ISA`, *.cu inside `namespace kv::filters::cuda`; each ends in
// KV_INSTANTIATE(...). The glue calls KV_RUN (glue.h), which picks the namespace among those of the module.
#pragma once

#include "half.h"

struct CUstream_st;  // what cudaStream_t points to; the glue needs no CUDA header for it

namespace kv {

enum class Isa : int { baseline = 0, avx2 = 1, avx512 = 2 };

Isa active_isa();  // module.cpp

#define KV_DECLARE_CPU(isa, name, Params)                         \
  namespace isa {                                                 \
  template <class T>                                              \
  void name(Params<T> const& params, int64_t begin, int64_t end); \
  }
#if !defined(__x86_64__)
#define KV_ONLY_ISA baseline  // of aarch64, which has NEON
#endif
#if !defined(KV_ONLY_ISA)
#define KV_DECLARE_ALL_CPU(name, Params) \
  KV_DECLARE_CPU(baseline, name, Params) KV_DECLARE_CPU(avx2, name, Params) KV_DECLARE_CPU(avx512, name, Params)
#define KV_FOR_ISA(name, params, begin, end)                           \
  do {                                                                 \
    if constexpr (::kv::kHasAvx512<decltype(::kv::stored_in(params))>) \
      if (::kv::active_isa() == ::kv::Isa::avx512) {                   \
        avx512::name(params, begin, end);                              \
        break;                                                         \
      }                                                                \
    if constexpr (::kv::kHasBaseline)                                  \
      if (::kv::active_isa() == ::kv::Isa::baseline) {                 \
        baseline::name(params, begin, end);                            \
        break;                                                         \
      }                                                                \
    avx2::name(params, begin, end);                                    \
  } while (0)
#else
#define KV_DECLARE_ALL_CPU(name, Params) KV_DECLARE_CPU(KV_ONLY_ISA, name, Params)
#define KV_FOR_ISA(name, ...) KV_ONLY_ISA::name(__VA_ARGS__)
#endif

// CMakeLists.txt leaves it out of libraries for the machine that they are built on, where that has AVX2.
#if defined(KV_WITHOUT_BASELINE)
constexpr bool kHasBaseline = false;
#else
constexpr bool kHasBaseline = true;
#endif

// AVX-512 serves the types that most images have; compiled for all of them it would take a sixth of the whole build.
// The others gain little by it over AVX2, which serves them.
template <class T>
constexpr bool kHasAvx512 = __is_same(T, float) || __is_same(T, uint8_t);
template <template <class> class Params, class T>
T stored_in(Params<T> const&);

#define KV_KERNEL(name, Params)                           \
  KV_DECLARE_ALL_CPU(name, Params)                        \
  namespace cuda {                                        \
  template <class T>                                      \
  int name(Params<T> const& params, CUstream_st* stream); \
  }

#if defined(__CUDACC__)
#define KV_INSTANTIATE_ONE(name, Params, T) template int name<T>(Params<T> const&, CUstream_st*);
#else
#define KV_INSTANTIATE_ONE(name, Params, T) template void name<T>(Params<T> const&, int64_t, int64_t);
#endif
// The storage types an operator serves: all of them have the floats, some of them bytes too; others compute in one of
// the two wide floats whatever is stored.
#if defined(__AVX512F__) && !defined(__CUDACC__)
#define KV_INSTANTIATE(name, Params) KV_INSTANTIATE_ONE(name, Params, float)
#define KV_INSTANTIATE_COMPUTED(name, Params) KV_INSTANTIATE_ONE(name, Params, float)
#else
#define KV_INSTANTIATE(name, Params)           \
  KV_INSTANTIATE_COMPUTED(name, Params)        \
  KV_INSTANTIATE_ONE(name, Params, ::kv::Half) \
  KV_INSTANTIATE_ONE(name, Params, ::kv::BFloat16)
#define KV_INSTANTIATE_COMPUTED(name, Params) \
  KV_INSTANTIATE_ONE(name, Params, float)     \
  KV_INSTANTIATE_ONE(name, Params, double)
#endif
#define KV_INSTANTIATE_WITH_BYTES(name, Params) \
  KV_INSTANTIATE(name, Params)                  \
  KV_INSTANTIATE_ONE(name, Params, uint8_t)

}  // namespace kv
