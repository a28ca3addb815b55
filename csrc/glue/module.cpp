// How libkvision.so was built and which instruction set is active, as plain C functions for kvision._C and C++ users.
// Compiled into the CPU library only.
#include <atomic>
#include <cstdlib>
#include <cstring>

#include "core/isa.h"

namespace kv {
namespace {

#if defined(__aarch64__)
constexpr char const* kNames[] = {"neon"};  // every processor has it: what the compiler makes of vectors by itself
#else
constexpr char const* kNames[] = {"baseline", "avx2", "avx512"};
#endif
constexpr int kIsas = sizeof kNames / sizeof *kNames;

// Whether this library has kernels for it and this processor runs them.
bool supported(Isa isa) {
#if defined(KV_ONLY_ISA)
  return isa == Isa::KV_ONLY_ISA;  // no other kernels are here
#else
  __builtin_cpu_init();
  switch (isa) {
    case Isa::avx512:
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") && supported(Isa::avx2);
    case Isa::avx2:
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("f16c");
    default:
      return isa == Isa::baseline && kHasBaseline;
  }
#endif
}

// The named instruction set if it is supported, else the best one that is.
Isa choose(char const* name) {
  Isa best = Isa::baseline;
  for (int i = 0; i < kIsas; ++i)
    if (supported(Isa(i))) {
      if (name && std::strcmp(name, kNames[i]) == 0) return Isa(i);
      best = Isa(i);
    }
  return best;
}

std::atomic<Isa> active{choose(std::getenv("KVISION_ISA"))};

}  // namespace

Isa active_isa() { return active.load(std::memory_order_relaxed); }

}  // namespace kv

#define KV_EXPORT extern "C" __attribute__((visibility("default")))

KV_EXPORT char const* kvision_version() { return KV_VERSION; }
KV_EXPORT char const* kvision_compiler() { return __VERSION__; }
KV_EXPORT char const* kvision_active_isa() { return kv::kNames[int(kv::active_isa())]; }
KV_EXPORT bool kvision_isa_supported(char const* name) {
  for (int i = 0; i < kv::kIsas; ++i)
    if (std::strcmp(name, kv::kNames[i]) == 0) return kv::supported(kv::Isa(i));
  return false;
}
KV_EXPORT bool kvision_set_isa(char const* name) {
  if (!kvision_isa_supported(name)) return false;
  kv::active = kv::choose(name);
  return true;
}
