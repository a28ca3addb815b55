// Loads libkvision.so into LibTorch, without Python, and compares an operator with torch's own; for tools/test_arm.py.
//
//     call_operator path/to/libkvision.so

#include <ATen/ATen.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <dlfcn.h>

#include <iostream>

// Takes the place of cpuinfo's in libc10.so, which crashes in qemu-user on the host's files about its processor.
// Without answers torch takes the kernels that every processor runs.
extern "C" bool cpuinfo_initialize() { return false; }

int main(int, char** arguments) {
  if (!dlopen(arguments[1], RTLD_NOW | RTLD_GLOBAL)) {
    std::cerr << dlerror() << '\n';
    return 1;
  }
  auto sobel = c10::Dispatcher::singleton().findSchemaOrThrow("kvision::sobel", "");
  // Rows of more and of fewer pixels than a vector, so that both loops run.
  float largest = 0;
  for (int64_t width : {1, 3, 70}) {
    at::Tensor image = at::arange(2 * 3 * 7 * width, at::kFloat).sin().reshape({2, 3, 7, width});
    torch::jit::Stack stack{image, true, 1e-6};
    sobel.callBoxed(&stack);
    at::Tensor kernel = at::tensor({-1.0f, 0.0f, 1.0f, -2.0f, 0.0f, 2.0f, -1.0f, 0.0f, 1.0f}).reshape({1, 3, 3}) / 8;
    at::Tensor padded = at::replication_pad2d(image.reshape({6, 1, 7, width}), {1, 1, 1, 1});
    at::Tensor gradient = at::conv2d(padded, at::stack({kernel, kernel.mT()}));
    at::Tensor expected = (gradient.square().sum(1) + 1e-6).sqrt().reshape_as(image);
    largest = std::max(largest, (stack[0].toTensor() - expected).abs().max().item<float>());
  }
  std::cout << "sobel: largest difference from torch " << largest << '\n';
  return largest < 1e-6f ? 0 : 1;
}
