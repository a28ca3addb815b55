// Color programs on lists of images of different sizes, for the entries of operators.
#pragma once

#include "color/lists/program_list.h"
#include "color/program_glue.h"
#include "glue/image_list.h"

namespace kv::color {

// The images (C, H, W), of which those are copied whose pixels are not one row of planes or of interleaved pixels, nor
// one number where kernels take such `scalars`.
inline Tensors in_pixel_rows(Tensors const& images, Layout layout, bool scalars = false) {
  Tensors rows;
  rows.reserve(images.size());
  for (Tensor const& x : images) {
    auto const sizes = x.sizes(), strides = x.strides();
    int64_t const channels = sizes[0], width = sizes[2], pixels = sizes[1] * width;
    bool const last = layout == Layout::channels_last;
    int64_t const step = last ? channels : 1;
    bool const fits = (channels == 1 || strides[0] == (last ? 1 : pixels)) && (width == 1 || strides[2] == step) &&
                      (sizes[1] == 1 || strides[1] == width * step);
    if (fits || (scalars && is_expanded_scalar(x))) {
      rows.push_back(x);
      continue;
    }
    Tensor const copy = as_layout(dense(as_batch(x)), layout);
    rows.push_back(view_of(copy, {channels, sizes[1], width}, {copy.stride(1), copy.stride(2), copy.stride(3)}));
  }
  return rows;
}

// The images of a list, whose pixels are rows of a layout, and results of a layout: what programs of a list, and their
// gradients, have in common.
struct ListedImages {
  char const* op;
  Tensors const &rows, &results;
  ProgramArguments const& a;
  bool same_layout;

  // Fills tables with the images that `is_in` says, of which items_of(pixels) is the number of items, and calls run()
  // with each. `add(b, i)` writes what else belongs to image b in entry i.
  template <class F, class IsIn, class Add, class ItemsOf, class Run>
  void for_each_table(ProgramTable& p, Type<F>, int64_t& parts, IsIn is_in, Add add, ItemsOf items_of, Run run) const {
    int64_t const batch = int64_t(rows.size()), channels = rows[0].size(0);
    for (int64_t b = 0; b < batch;) {
      int64_t items = 0;
      parts = p.count = 0;
      for (; b < batch && p.count < kMaxListed; ++b) {
        Tensor const &x = rows[size_t(b)], &y = results[size_t(b)];
        int64_t const pixels = x.size(1) * x.size(2);
        bool const as_values = channels > 1 && a.samples(1, channels, pixels, same_layout).per_value;
        KV_CHECK(channels * pixels <= INT32_MAX, op, ": expected images of less than 2^31 elements");
        p.listed[p.count] = {x.const_data_ptr(), y.mutable_data_ptr(), int(b),    int(pixels),
                             int(items),         int(parts),           as_values, false};
        add(size_t(b), p.count);
        if (!is_in(p.count)) continue;
        int64_t const of_sample = as_values ? channels * pixels : pixels;
        items += items_of(of_sample);
        parts += mean_parts_of<F>(batch, of_sample);
        KV_CHECK(items <= INT32_MAX, op, ": expected less than 2^31 chunks of pixels");
        ++p.count;
      }
      p.items = int(items);
      if (p.count) run();
    }
  }

  // Runs tables twice: the first run sums what belongs to means, `program` is that of the table, and between() follows
  // it.
  template <class F, class IsIn, class Add, class RunTable, class Between>
  void run_around_means(ProgramTable& p, Program<F>& program, Tensor const& means, IsIn is_in, Add add,
                        RunTable run_table, Between between) const {
    int64_t const batch = int64_t(rows.size());
    int64_t parts = 0;
    for_each_table(
        p, Type<F>{}, parts, is_in, add, [&](int64_t pixels) { return mean_parts_of<F>(batch, pixels); },
        [&] {
          Tensor const memory = empty({parts}, means);
          program.parts = static_cast<F*>(memory.mutable_data_ptr());
          program.measures_mean = true;
          run_table();
          program.measures_mean = false;
          int64_t items = 0;
          for (int i = 0; i < p.count; ++i) {
            int64_t const pixels = p.listed[i].pixels;
            p.listed[i].first = int(items);
            items += blocks_per_sample<F>(batch, p.listed[i].as_values ? pixels * rows[0].size(0) : pixels);
          }
          p.items = int(items);
          between();
          run_table();
        });
  }
};

// Where the pixels of an image of a list are, without its memory.
inline Pixels listed_pixels(char const* op, Tensor const& x, Layout layout) {
  int64_t const count = x.size(0);
  return {nullptr, dtype_of(op, x), int(count), 1, 0, 0, 1, layout == Layout::planar ? 1 : count};
}

// Runs a program on images of a layout whose results exist already, and returns the means that contrast was taken
// around. `like` is a batch of as many images, in the layout of the results.
inline Tensor run_program_on_list(char const* op, Tensors const& images, Layout layout, Tensors const& results,
                                  Tensor const& like, ProgramArguments const& a, PlanArgument const& plan,
                                  std::vector<double> const& numbers) {
  int64_t const batch = int64_t(images.size());
  bool const around_mean = a.sequence.contrast >= 0;
  Tensor const means =
      around_mean ? empty({batch, 1}, like, Layout::planar, a.in_double ? ScalarType::Double : ScalarType::Float)
                  : like;
  Tensors const rows = in_pixel_rows(images, layout);
  a.dispatch_compute([&]<class F>(Type<F> type) {
    Layout const out = layout_of(like);
    ListedImages const listed{op, rows, results, a, layout == out};
    ProgramList<F> p;
    p.all = program_of<F>(a, {batch, 1, 0, a.per_value, false}, numbers, plan.columns);
    p.all.x = listed_pixels(op, images[0], layout);
    p.all.y = listed_pixels(op, results[0], out);
    p.samples = batch;
    if (around_mean) p.all.means = static_cast<F*>(means.mutable_data_ptr());
    // The samples of the table: by one launch, and where the compute type has no kernel for lists, by one for each.
    auto const run_table = [&] {
#if defined(KV_CUDA)
      if constexpr (sizeof(F) > sizeof(float)) {
        for (int i = 0; i < p.count; ++i) KV_RUN(program, like, program_at(p, i), 1, 0);
        return;
      }
#endif
      KV_RUN(program_list, like, p, p.items, 3 * kChunk<F>);
    };
    auto const add = [](size_t, int) {};
    int64_t parts = 0;
    if (!around_mean)
      return listed.for_each_table(
          p, type, parts, [](int) { return true; }, add,
          [&](int64_t pixels) { return blocks_per_sample<F>(batch, pixels); }, run_table);
    auto const in_two_runs = [&]([[maybe_unused]] int i) {
#if defined(KV_CUDA)
      if constexpr (sizeof(F) == sizeof(float)) return !cuda::takes_clusters(p, i);
#endif
      return true;
    };
#if defined(KV_CUDA)
    if constexpr (sizeof(F) == sizeof(float))
      listed.for_each_table(
          p, type, parts, [&](int i) { return !in_two_runs(i); }, add, [](int64_t) { return 1; },
          [&] { KV_RUN(program_list_by_clusters, like, p, p.items, 0); });
#endif
    listed.run_around_means(p, p.all, means, in_two_runs, add, run_table, [] {});
  });
  return means;
}

// Writes the gradients of the images of a list, of which `like` is a batch, to `results`, from those of the results of
// a program. `means` are those of run_program_on_list, or nothing without contrast.
inline void program_list_gradients(char const* op, Tensors const& grads, Tensors const& images, Tensors const& results,
                                   Tensor const& like, ProgramArguments const& a, PlanArgument const& plan,
                                   std::vector<double> const& numbers, OptionalTensor const& means) {
  int64_t const batch = int64_t(images.size()), channels = a.sequence.one_channel ? 1 : images[0].size(0);
  bool fit = grads.size() == images.size();
  for (size_t b = 0; fit && b < images.size(); ++b)
    fit =
        grads[b].size(0) == channels && grads[b].size(1) == images[b].size(1) && grads[b].size(2) == images[b].size(2);
  KV_CHECK(fit && grads[0].device() == images[0].device(), op, ": grads do not fit the results of the images");
  KV_CHECK(grads[0].scalar_type() != ScalarType::Byte && images[0].scalar_type() != ScalarType::Byte, op,
           ": bytes have no gradient");
  bool const around_mean = a.sequence.contrast >= 0;
  ScalarType const computes = a.in_double ? ScalarType::Double : ScalarType::Float;
  KV_CHECK(around_mean ? (means && means->dim() == 2 && means->size(0) == batch && means->size(1) == 1 &&
                          means->scalar_type() == computes && means->device() == images[0].device())
                       : !means,
           op, ": expected the means that contrast was taken around");
  Layout const layout = layout_of(like), out = channels == 1 ? Layout::planar : layout;
  bool const has_scalars = std::any_of(grads.begin(), grads.end(), is_expanded_scalar);
  if (!has_scalars && has_transpose(a, plan, numbers)) {
    TransposedProgram const transposed(plan, numbers);
    PlanArgument const back{int64_t(dtype_of(op, like)), layout == Layout::planar ? 0 : 1, transposed.steps,
                            transposed.columns};
    ProgramArguments const of_transposed = transposed_arguments(op, as_batch(grads[0]), a, back, transposed.numbers);
    run_program_on_list(op, grads, out, results, like, of_transposed, back, transposed.numbers);
    return;
  }
  Tensors const rows = in_pixel_rows(images, layout), of_rows = in_pixel_rows(grads, out, true);
  a.dispatch_compute([&]<class F>(Type<F> type) {
    ListedImages const listed{op, rows, results, a, true};
    ProgramBackwardList<F> p;
    p.all = {};
    Program<F>& forward = p.all.forward;
    forward = program_of<F>(a, {batch, 1, 0, a.per_value, false}, numbers, plan.columns);
    p.samples = batch;
    set_needed_inputs(p.all, false);
    p.all.needs_grad_x = true;
    forward.x = listed_pixels(op, images[0], layout);
    p.all.grad_x = listed_pixels(op, results[0], layout);
    p.all.grad = listed_pixels(op, grads[0], out);
    Tensor dense_means;
    if (around_mean) {
      dense_means = dense(*means);
      forward.means = static_cast<F*>(const_cast<void*>(dense_means.const_data_ptr()));
    }
    auto const run_table = [&] {
#if defined(KV_CUDA)
      if constexpr (sizeof(F) > sizeof(float)) {
        for (int i = 0; i < p.count; ++i) KV_RUN(program_backward, like, program_at(p, i), 1, 0);
        return;
      }
#endif
      KV_RUN(program_list_backward, like, p, p.items, 12 * kChunk<F>);
    };
    auto const all = [](int) { return true; };
    auto const add = [&](size_t b, int i) {
      p.grads[i] = of_rows[b].const_data_ptr();
      p.is_scalar[i] = is_expanded_scalar(of_rows[b]);
    };
    int64_t parts = 0;
    if (!around_mean)
      return listed.for_each_table(
          p, type, parts, all, add, [&](int64_t pixels) { return blocks_per_sample<F>(batch, pixels); }, run_table);
#if defined(KV_CUDA)
    p.all.resumes = like.scalar_type() == computes;  // halves would be rounded between runs
#endif
    Pixels const grad = p.all.grad;
    auto const resume = [&] {
      if (!p.all.resumes) return;
      p.all.grad = p.all.grad_x;
      for (int i = 0; i < p.count; ++i) p.grads[i] = p.listed[i].y, p.is_scalar[i] = false;
    };
    auto const run_from_grads = [&] {
      if (forward.measures_mean) p.all.grad = grad;
      run_table();
    };
    listed.run_around_means(p, forward, dense_means, all, add, run_from_grads, resume);
  });
}

}  // namespace kv::color
