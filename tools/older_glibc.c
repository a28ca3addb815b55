// What GCC's libstdc++.a takes from a glibc newer than 2.28, for libraries that must run there, and what glibc itself links
// statically; tools/older_glibc.py compiles it. Hidden: nothing but the library it is linked into sees these.
#define _GNU_SOURCE
#include <stdint.h>
#include <sys/random.h>
#include <sys/stat.h>

#define KV_HIDDEN __attribute__((visibility("hidden")))

int __fxstat64(int version, int file, struct stat64* status);

// 2.32. Zero: there may be threads, so reference counts stay atomic.
KV_HIDDEN char __libc_single_threaded = 0;

// 2.33; before, a macro for the function that takes the version of the structure.
KV_HIDDEN int fstat64(int file, struct stat64* status) { return __fxstat64(1, file, status); }

// 2.36, the source of std::random_device.
KV_HIDDEN uint32_t arc4random(void) {
  uint32_t value;
  while (getrandom(&value, sizeof value, 0) != sizeof value) {
  }
  return value;
}

// Of libc_nonshared.a, which the stubs lack: the static CUDA runtime registers its end, which must run when this library
// is unloaded.
extern void* __dso_handle KV_HIDDEN;
int __cxa_atexit(void (*function)(void*), void* argument, void* library);
KV_HIDDEN int atexit(void (*function)(void)) { return __cxa_atexit((void (*)(void*))function, 0, __dso_handle); }
