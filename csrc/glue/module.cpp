// What libkvision.so says about itself and which instruction set is active; plain C functions, called by kvision._C and
// by C++ users. Compiled into the CPU library only.
#include <atomic>
#include <cstdlib>
#include <cstring>

#include "core/isa.h"

namespace kv {
namespace {

constexpr char const* kNames[] = {"baseline", "avx2", "avx512"};

bool supported(Isa isa) {
#if defined(__x86_64__)
  __builtin_cpu_init();
  switch (isa) {
    case Isa::avx512:
      return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
             __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") && supported(Isa::avx2);
    case Isa::avx2:
      return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("f16c");
    case Isa::baseline:
      break;
  }
#endif
  return isa == Isa::baseline;
}

// The named instruction set if the processor has it, else the best one there is.
Isa choose(char const* name) {
  for (int i = 2; i >= 0; --i)
    if (name && std::strcmp(name, kNames[i]) == 0 && supported(Isa(i))) return Isa(i);
  for (int i = 2; i > 0; --i)
    if (supported(Isa(i))) return Isa(i);
  return Isa::baseline;
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
  for (int i = 0; i < 3; ++i)
    if (std::strcmp(name, kv::kNames[i]) == 0) return kv::supported(kv::Isa(i));
  return false;
}
KV_EXPORT bool kvision_set_isa(char const* name) {
  if (!kvision_isa_supported(name)) return false;
  kv::active = kv::choose(name);
  return true;
}
