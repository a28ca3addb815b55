// Gradients of color programs on lists of images on CUDA, in one launch, or two around a mean: a block finds its image
// in the table and works as blocks of batches do.
#include "color/lists/program_list.h"
#include "color/program_backward.cuh"

namespace kv::color::cuda {
namespace {

static_assert(sizeof(ProgramBackwardList<float>) <= 32764, "more than a kernel's parameters");

template <int C>
__global__ void __launch_bounds__(kThreads, 3)
    run_backward_of_list(__grid_constant__ ProgramBackwardList<float> const p) {
  __shared__ Sample<float> sample;
  __shared__ PartialGrads<float> partial_grads;
  int const entry = p.entry_of(int(blockIdx.x));
  ListedPixels const& own = p.listed[entry];
  ProgramBackward<float> const& all = p.all;
  Program<float> const& program = all.forward;
  Pixels const x = p.pixels_of(program.x, const_cast<void*>(own.x), own), grad = p.grad_of(entry),
               grad_x = p.pixels_of(all.grad_x, own.y, own);
  int64_t const pixels = own.as_values ? own.pixels * int64_t(program.x.channels) : own.pixels;
  int const block = int(blockIdx.x) - own.first, blocks = p.end_of(entry) - own.first;
  float* const parts = program.parts + own.part;
  MeanParts<float> const mean{parts, mean_parts_of<float>(p.samples, pixels), pixels};
  auto const run = [&](auto elements) {  // not inlined: spills a fifth of the bytes
    run_backward_block<float, C, elements.value>(all, sample, partial_grads, x, grad, grad_x, own.sample, 0, 0, 0,
                                                 pixels, block, blocks, parts + block, nullptr, mean);
  };
  own.by_vectors ? run(std::false_type{}) : run(std::true_type{});
}

}  // namespace

template <>
int program_list_backward<float>(ProgramBackwardList<float> const& params, CUstream_st* stream) {
  ProgramBackwardList<float> p = params;
  for (int i = 0; i < p.count; ++i) {
    ProgramBackward<float> own = program_at(p, i);
    set_access<float, kPixelsPerThread<float>>({&own.forward.x, &own.grad, &own.grad_x}, 1);
    p.listed[i].by_vectors = own.forward.x.access != Access::elements;
  }
  for (Pixels* x : {&p.all.forward.x, &p.all.grad, &p.all.grad_x})
    x->access = x->type == DType::float32 && x->step == 1 ? Access::plain_vectors : Access::vectors;
  bool const values = p.all.forward.x.channels == 1 || p.listed[0].as_values;
  values ? run_backward_of_list<1><<<unsigned(p.items), kThreads, 0, stream>>>(p)
         : run_backward_of_list<3><<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::color::cuda
