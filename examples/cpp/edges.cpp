// Straightens a photograph, blurs it, finds its edges and checks the gradient of it all: edges IN.ppm OUT.ppm
#include <kvision/kvision.h>
#include <torch/types.h>

#include <cmath>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string>

namespace {

// A binary PPM as a (1, 3, H, W) tensor in [0, 1].
torch::Tensor read_ppm(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": cannot be read");
  std::string magic;
  int64_t width = 0, height = 0, largest = 0;
  file >> magic >> width >> height >> largest;
  file.get();
  if (!file || magic != "P6" || largest != 255) throw std::runtime_error(path + ": not a binary PPM of 8 bits");
  torch::Tensor pixels = torch::empty({1, height, width, 3}, torch::kByte);
  if (!file.read(static_cast<char*>(pixels.data_ptr()), pixels.numel())) throw std::runtime_error(path + ": too short");
  return pixels.permute({0, 3, 1, 2}).to(torch::kFloat) / 255;  // channels-last in memory, as kvision reads it
}

void write_ppm(std::string const& path, torch::Tensor const& image) {
  torch::Tensor const pixels = (image[0].permute({1, 2, 0}) * 255).round().clamp(0, 255).to(torch::kByte).contiguous();
  std::ofstream file(path, std::ios::binary);
  file << "P6\n" << pixels.size(1) << " " << pixels.size(0) << "\n255\n";
  file.write(static_cast<char const*>(pixels.data_ptr()), pixels.numel());
  if (!file) throw std::runtime_error(path + ": cannot be written");
}

// The edges of an image that is turned by `angle` degrees, (B,), about its middle.
torch::Tensor edges(torch::Tensor const& image, torch::Tensor const& angle) {
  auto const options =
      kvision::TransformOptions().mode(kvision::Interpolation::bilinear).padding_mode(kvision::PaddingMode::reflection);
  torch::Tensor const straight = kvision::rotate(image, angle, {}, options);
  return kvision::sobel(kvision::gaussian_blur2d(straight, 5, 1.5));
}

// The derivative along a random direction of image and angle, by autograd and by a central difference.
void check_gradient(torch::Tensor const& image, double degrees) {
  torch::Tensor const x = image.to(torch::kDouble).requires_grad_();
  torch::Tensor const angle = torch::full({1}, degrees, torch::kDouble).requires_grad_();
  edges(x, angle).sum().backward();
  torch::Tensor const direction = torch::randn_like(x), step = 1e-6 * direction;
  double const analytic = ((x.grad() * direction).sum() + angle.grad().sum()).item<double>();
  torch::NoGradGuard no_grad;
  torch::Tensor const after = edges(x + step, angle + 1e-6), before = edges(x - step, angle - 1e-6);
  double const numeric = ((after - before).sum() / 2e-6).item<double>();
  std::cout << "derivative along a random direction: autograd " << analytic << ", numeric " << numeric << "\n";
  if (!(std::abs(analytic - numeric) < 1e-4 * std::abs(numeric))) throw std::runtime_error("the gradient is wrong");
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 3) throw std::runtime_error("usage: edges IN.ppm OUT.ppm");
  double const degrees = 3;
  torch::Tensor const image = read_ppm(argv[1]), result = edges(image, torch::full({1}, degrees));
  write_ppm(argv[2], result / result.max());
  std::cout << argv[1] << " -> " << argv[2] << ", " << image.sizes() << "\n";
  check_gradient(image.slice(2, 0, 64).slice(3, 0, 64), degrees);
} catch (std::exception const& error) {
  std::cerr << "edges: " << error.what() << "\n";
  return 1;
}
