// Loads libkvision.so into LibTorch, without Python, and runs traced calls, each of which gives its largest difference
// from what Python computed on the machine that traced it; for tools/test_arm.py.
//
//     call_operator path/to/libkvision.so CALL.pt...

#include <dlfcn.h>
#include <torch/script.h>

#include <iostream>

// Takes the place of cpuinfo's in libc10.so, which crashes in qemu-user on the host's files about its processor.
// Without answers torch takes the kernels that every processor runs.
extern "C" bool cpuinfo_initialize() { return false; }

int main(int count, char** arguments) {
  if (!dlopen(arguments[1], RTLD_NOW | RTLD_GLOBAL)) {
    std::cerr << dlerror() << '\n';
    return 1;
  }
  torch::InferenceMode no_gradients;
  bool right = count > 2;
  for (int i = 2; i < count; ++i) {
    double const difference = torch::jit::load(arguments[i]).forward({}).toTensor().item<double>();
    std::cout << arguments[i] << ": " << difference << std::endl;
    right = right && difference < 1e-4;  // NaN is wrong
  }
  return right ? 0 : 1;
}
