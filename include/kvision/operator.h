// How C++ reaches an operator of kvision and gives it a gradient. Included by the header of each module.
//
//   call<"sobel">(input, normalized, eps)                       the operator, through torch's dispatcher
//   differentiable(tensors, compute, saved, gradient)           what autograd sees of it
//
// Argument types are those of the schema: Tensor, std::optional<Tensor>, int64_t, double, bool, std::string for str,
// and std::vector for lists.
#pragma once

#include <ATen/core/LegacyTypeDispatch.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/csrc/autograd/custom_function.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace kvision {

using at::Tensor;
using torch::autograd::variable_list;

namespace detail {

template <size_t N>
struct Name {
  char text[N];
  consteval Name(char const (&literal)[N]) { std::copy_n(literal, N, text); }
};

// What the dispatcher takes for an argument: strings and lists as views, all else as it is.
template <class T>
T const& as_argument(T const& value) {
  return value;
}
inline std::string_view as_argument(std::string const& value) { return value; }
template <class T>
at::ArrayRef<T> as_argument(std::vector<T> const& values) {
  return values;
}

template <Name name, class Result = Tensor, class... Args>
Result call(Args const&... args) {
  using Signature = Result(decltype(as_argument(args))...);
  static auto const op = c10::Dispatcher::singleton()
                             .findSchemaOrThrow((std::string("kvision::") + name.text).c_str(), "")
                             .template typed<Signature>();
  return op.call(as_argument(args)...);
}

// What a gradient is computed from. `wanted(i)`: whether the i-th tensor needs its gradient.
struct Backward {
  variable_list grads, saved;
  std::function<bool(size_t)> wanted;
};
// Gives the gradients of the tensors in their order; an undefined Tensor for one that is not wanted. Made of
// differentiable functions, it can itself be differentiated.
using Gradient = std::function<variable_list(Backward const&)>;
using Compute = std::function<variable_list()>;

// One autograd function for all operators: what it computes and how that is differentiated are arguments.
struct Function : torch::autograd::Function<Function> {
  struct Capsule : torch::CustomClassHolder {
    Gradient gradient;
    std::vector<int64_t> places;
    Capsule(Gradient gradient, std::vector<int64_t> places)
        : gradient(std::move(gradient)), places(std::move(places)) {}
  };

  // `tensors` are the defined ones, autograd takes no others; `places` has where each argument stands there, or -1.
  static variable_list forward(torch::autograd::AutogradContext* ctx, at::TensorList,
                               std::vector<int64_t> const& places, Compute const& compute, variable_list const& saved,
                               Gradient const& gradient) {
    ctx->save_for_backward(saved);
    ctx->saved_data["capsule"] = c10::IValue::make_capsule(c10::make_intrusive<Capsule>(gradient, places));
    at::AutoDispatchBelowADInplaceOrView below_autograd;
    return compute();
  }

  static variable_list backward(torch::autograd::AutogradContext* ctx, variable_list grads) {
    auto const holder = ctx->saved_data["capsule"].toCapsule();
    auto const& capsule = static_cast<Capsule const&>(*holder);
    auto const wanted = [&](size_t i) { return capsule.places[i] >= 0 && ctx->needs_input_grad(capsule.places[i]); };
    variable_list all = capsule.gradient({std::move(grads), ctx->get_saved_variables(), wanted});
    all.resize(capsule.places.size());
    variable_list found;
    for (size_t i = 0; i < all.size(); ++i)
      if (capsule.places[i] >= 0) found.push_back(all[i]);
    found.resize(found.size() + 4);  // forward's other four arguments have none
    return found;
  }
};

inline bool wants_gradient(variable_list const& tensors) {
  auto const requires_grad = [](Tensor const& t) { return t.defined() && t.requires_grad(); };
  return at::GradMode::is_enabled() && std::any_of(tensors.begin(), tensors.end(), requires_grad);
}

// The results of `compute`, which depends on `tensors`. Backward calls `gradient` with what was `saved`; of tensors,
// that may hold constants only.
inline variable_list differentiable(variable_list const& tensors, Compute const& compute, variable_list const& saved,
                                    Gradient const& gradient) {
  if (wants_gradient(tensors)) {
    variable_list defined;
    std::vector<int64_t> places;
    for (Tensor const& t : tensors) {
      places.push_back(t.defined() ? int64_t(defined.size()) : -1);
      if (t.defined()) defined.push_back(t);
    }
    return Function::apply(at::TensorList(defined), places, compute, saved, gradient);
  }
  at::AutoDispatchBelowADInplaceOrView below_autograd;
  return compute();
}

// An operator that is linear in `x` and has no gradient to other tensors; `transpose` takes the gradient back.
template <Name name, class... Args>
Tensor linear(Tensor const& x, std::function<Tensor(Tensor const&)> const& transpose, Args const&... args) {
  auto const compute = [&] { return variable_list{call<name>(x, args...)}; };
  auto const gradient = [=](Backward const& b) { return variable_list{transpose(b.grads[0])}; };
  return differentiable({x}, compute, {}, gradient)[0];
}

// For a gradient whose own derivative has no kernel.
inline Gradient no_second_derivative(char const* op) {
  return [op](Backward const&) -> variable_list {
    TORCH_CHECK_NOT_IMPLEMENTED(false, op, ": C++ has no second derivative of it; Python's kvision has");
  };
}

}  // namespace detail
}  // namespace kvision
