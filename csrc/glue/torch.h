// torch's headers, and those of the standard library that the glue needs: compiled once for all operators' entries, of
// the CPU and of CUDA.
#pragma once

// What would need the libstdc++ of GCC 13, where that is the compiler, is left out of torch's headers. The messages of
// their own checks are streams. What they tell is that torch and this library disagree about the stable interface; the
// condition and its place remain. And an included <iostream> asks libstdc++ to make std::cout, which nothing here uses:
// with its guard defined, the headers get the streams' types alone.
#define STRIP_ERROR_MESSAGES
#include <istream>
#include <ostream>
#define _GLIBCXX_IOSTREAM
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
