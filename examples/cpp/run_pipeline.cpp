// Runs what save_pipeline.py saved, without Python, and compares the results: run_pipeline FOLDER
// Either file may be missing.
#include <torch/csrc/inductor/aoti_package/model_package_loader.h>
#include <torch/script.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using Tensors = std::vector<torch::Tensor>;

c10::Dict<c10::IValue, c10::IValue> read_case(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": cannot be read; save_pipeline.py writes it");
  std::vector<char> const bytes{std::istreambuf_iterator<char>(file), {}};
  return torch::jit::pickle_load(bytes).toGenericDict();
}

bool is_there(std::string const& path, std::string const& name) {
  bool const there = std::ifstream(path).good();
  if (!there) std::cout << name << ": there is no " << path << std::endl;
  return there;
}

void check(std::string const& name, Tensors const& results, Tensors const& expected) {
  if (results.size() != expected.size()) throw std::runtime_error(name + ": another number of results than in Python");
  double difference = 0;
  for (size_t i = 0; i < results.size(); ++i) {
    if (results[i].sizes() != expected[i].sizes()) throw std::runtime_error(name + ": other sizes than in Python");
    difference = std::max(difference, (results[i] - expected[i]).abs().max().item<double>());
  }
  std::cout << name << ": largest difference from Python " << difference;
  if (!(difference < 1e-5)) throw std::runtime_error(name + ": the results are not those of Python");
}

// Compares the results with Python's, and prints the fastest of ten runs.
template <class Run>
void try_out(std::string const& name, Tensors const& expected, Run const& run) {
  check(name, run(), expected);
  double fastest = 1e9;
  for (int i = 0; i < 10; ++i) {
    auto const begin = std::chrono::steady_clock::now();
    run()[1].cpu();  // waits for the device
    fastest =
        std::min(fastest, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count());
  }
  std::cout << ", " << fastest << " ms" << std::endl;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 2) throw std::runtime_error("usage: run_pipeline FOLDER");
  std::string const folder = std::string(argv[1]) + "/";
  torch::InferenceMode const no_gradients;
  auto const from_python = read_case(folder + "case.pt");
  torch::Tensor const image = from_python.at("image").toTensor();
  Tensors const expected{from_python.at("edges").toTensor(), from_python.at("similarity").toTensor()};
  std::cout << "image " << image.sizes() << " on " << image.device() << "\n";

  if (is_there(folder + "pipeline.pt", "traced module")) {
    torch::jit::Module module = torch::jit::load(folder + "pipeline.pt", image.device());
    try_out("traced module", expected, [&]() -> Tensors {
      auto const results = module.forward({image}).toTuple();
      return {results->elements()[0].toTensor(), results->elements()[1].toTensor()};
    });
  }

  if (is_there(folder + "pipeline.pt2", "AOTInductor package")) {
    torch::inductor::AOTIModelPackageLoader package(folder + "pipeline.pt2");
    try_out("AOTInductor package", expected, [&] { return package.run({image}); });
    // It takes any batch; the traced module takes the one it was traced with.
    try_out("AOTInductor package, batch of 1", {expected[0].slice(0, 0, 1), expected[1].slice(0, 0, 1)},
            [&] { return package.run({image.slice(0, 0, 1)}); });
  }
} catch (std::exception const& error) {
  std::cerr << "run_pipeline: " << error.what() << "\n";
  return 1;
}
