// torch's headers, and those of the standard library that the glue needs: compiled once for all operators' entries, of
// the CPU and of CUDA.
#pragma once

#define USE_CUDA  // declares how to ask for the current stream, which is defined where CUDA is
#include <torch/csrc/inductor/aoti_torch/c/shim.h>
#include <torch/csrc/stable/accelerator.h>
#include <torch/csrc/stable/library.h>
#include <torch/csrc/stable/ops.h>
#include <torch/csrc/stable/tensor.h>

#include <concepts>
#include <initializer_list>
#include <optional>
#include <string>
#include <tuple>
#include <vector>
