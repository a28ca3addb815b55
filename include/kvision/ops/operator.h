// How C++ calls an operator of torch.ops.kvision and differentiates it. An operator is one declaration:
//
//   inline constexpr Operator<"sobel", Tensor(Tensor input, bool normalized, double eps)>
//       sobel{{detail::sobel_gradients}};
//
// Its name, its schema as a C++ type, and a rule for its gradients. tools/generate.py writes the declarations. It is
// then called as `sobel(input, true, 1e-6)`. Calls and graphs are not templates: arguments are c10::IValue, as the
// dispatcher has them, and there is one autograd function.
#pragma once

#include <ATen/core/LegacyTypeDispatch.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/csrc/autograd/custom_function.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

namespace kvision {

using at::Tensor;
using torch::autograd::variable_list;

namespace ops {

// What a schema calls Tensor?, int[] and float[].
using OptionalTensor = std::optional<Tensor>;
using Ints = std::vector<int64_t>;
using Floats = std::vector<double>;

using Arguments = std::vector<c10::IValue>;
using NamedArguments = std::initializer_list<std::pair<std::string_view, c10::IValue>>;

struct Rule;

// What a rule computes gradients from.
struct Backward {
  c10::OperatorHandle op;
  variable_list grads;                // of the results
  Arguments arguments;                // without the first one, if the rule does not save it
  variable_list results;              // those that the rule saves
  Ints sizes;                         // of the first argument
  std::function<bool(size_t)> needs;  // whether the gradient to this argument is needed

  // Calls an operator with arguments found by their names: those that are `named` here, those of the differentiated
  // operator, the gradients (grad...), and for other tensors its saved results in their order.
  variable_list call(std::string const& name, NamedArguments named = {}) const;
  variable_list call(std::string const& name, NamedArguments named, Rule const& rule) const;
  // The same with all arguments in order.
  variable_list run(std::string const& name, Arguments arguments, Rule const& rule) const;

  Tensor const& grad() const { return grads[0]; }
  Tensor tensor(size_t i) const { return arguments[i].isTensor() ? arguments[i].toTensor() : Tensor(); }
  OptionalTensor optional(size_t i) const { return arguments[i].toOptional<Tensor>(); }
  Ints image_size() const { return {sizes.begin() + 2, sizes.end()}; }
  Ints batch_size() const { return {sizes[0], sizes[2], sizes[3]}; }  // the number of images, height and width
};

// The gradients to the arguments, of which the first ones are tensors, in their order. Undefined ones are zero; to
// arguments behind the last one there is no gradient.
struct Rule {
  variable_list (*gradients)(Backward const&) = nullptr;  // without it the results are constants
  size_t saved_results = 0;                               // how many of the last results it needs: if any, only the
                                                          // first result is differentiable
  bool saves_input = true;                                // whether it needs the first argument
};

namespace detail {

inline c10::OperatorHandle find(std::string const& name) {
  return c10::Dispatcher::singleton().findSchemaOrThrow(("kvision::" + name).c_str(), "");
}

inline std::string name_of(c10::OperatorHandle const& op) { return op.operator_name().name.substr(9); }

inline variable_list compute(c10::OperatorHandle const& op, Arguments arguments) {
  at::AutoDispatchBelowADInplaceOrView below_autograd;
  op.callBoxed(arguments);
  variable_list results;
  for (c10::IValue const& result : arguments) results.push_back(result.toTensor());
  return results;
}

struct Call : torch::CustomClassHolder {
  c10::OperatorHandle op;
  Rule rule;
  Arguments arguments;
  std::vector<size_t> tensors;  // which arguments are tensors
  Ints sizes;

  Call(c10::OperatorHandle const& op, Rule const& rule, Arguments all) : op(op), rule(rule), arguments(std::move(all)) {
    for (size_t i = 0; i < arguments.size(); ++i)
      if (arguments[i].isTensor()) tensors.push_back(i);
    sizes = arguments[0].isTensor() ? arguments[0].toTensor().sizes().vec() : Ints();
  }
};

struct Function : torch::autograd::Function<Function> {
  static variable_list forward(torch::autograd::AutogradContext* ctx, at::TensorList tensors,
                               c10::intrusive_ptr<Call> const& call) {
    variable_list results = compute(call->op, call->arguments), saved = tensors.vec();
    if (!call->rule.saves_input && call->tensors[0] == 0) saved[0] = Tensor();
    for (size_t i : call->tensors) call->arguments[i] = c10::IValue();
    saved.insert(saved.end(), results.end() - call->rule.saved_results, results.end());
    ctx->save_for_backward(saved);
    ctx->saved_data["call"] = c10::IValue::make_capsule(call);
    if (call->rule.saved_results > 0) ctx->mark_non_differentiable({results.begin() + 1, results.end()});
    return results;
  }

  static variable_list backward(torch::autograd::AutogradContext* ctx, variable_list grads) {
    auto const holder = ctx->saved_data["call"].toCapsule();
    auto const& call = static_cast<Call const&>(*holder);
    size_t const count = call.tensors.size();
    variable_list const saved = ctx->get_saved_variables();
    Arguments arguments = call.arguments;
    for (size_t k = 0; k < count; ++k)
      if (saved[k].defined()) arguments[call.tensors[k]] = saved[k];
    auto const needs = [&](size_t i) {
      auto const k = std::find(call.tensors.begin(), call.tensors.end(), i) - call.tensors.begin();
      return size_t(k) < count && ctx->needs_input_grad(k);
    };
    variable_list const gradients = call.rule.gradients(
        {call.op, std::move(grads), std::move(arguments), {saved.begin() + count, saved.end()}, call.sizes, needs});
    variable_list of_tensors(count + 1);  // the call itself has none
    for (size_t k = 0; k < count; ++k) {
      size_t const i = call.tensors[k];
      if (!ctx->needs_input_grad(k)) continue;
      TORCH_CHECK_NOT_IMPLEMENTED(i < gradients.size(), name_of(call.op), ": C++ has no gradient to ",
                                  call.op.schema().arguments()[i].name(), "; Python's kvision has");
      of_tensors[k] = gradients[i];
    }
    return of_tensors;
  }
};

inline variable_list run(c10::OperatorHandle const& op, Rule const& rule, Arguments arguments) {
  auto const requires_grad = [](c10::IValue const& x) { return x.isTensor() && x.toTensor().requires_grad(); };
  if (!rule.gradients || !at::GradMode::is_enabled() || std::none_of(arguments.begin(), arguments.end(), requires_grad))
    return compute(op, std::move(arguments));
  auto const call = c10::make_intrusive<Call>(op, rule, std::move(arguments));
  variable_list tensors;
  for (size_t i : call->tensors) tensors.push_back(call->arguments[i].toTensor());
  return Function::apply(at::TensorList(tensors), call);
}

// A gradient that was computed from `tensors` without an operator, and cannot be differentiated again.
struct Once : torch::autograd::Function<Once> {
  static variable_list forward(torch::autograd::AutogradContext* ctx, at::TensorList, Tensor const& gradient,
                               std::string const& name) {
    ctx->saved_data["name"] = name;
    return {gradient};
  }
  static variable_list backward(torch::autograd::AutogradContext* ctx, variable_list const&) {
    TORCH_CHECK_NOT_IMPLEMENTED(false, ctx->saved_data["name"].toStringRef(),
                                ": C++ has no second derivative of it; Python's kvision has");
  }
};

inline c10::IValue minus(c10::IValue const& numbers) {
  Ints opposite = numbers.toIntVector();
  for (int64_t& x : opposite) x = -x;
  return opposite;
}

inline Tensor once(std::string const& name, Tensor const& gradient, variable_list const& tensors) {
  if (!at::GradMode::is_enabled()) return gradient;
  return Once::apply(at::TensorList(tensors), gradient.detach(), name)[0];
}

inline bool is_tensor(c10::Argument const& argument) {
  return argument.type()->isSubtypeOf(*c10::OptionalType::ofTensor());
}

inline Arguments match(Backward const& b, c10::OperatorHandle const& op, NamedArguments named) {
  auto const& known = b.op.schema().arguments();
  size_t next_grad = 0, next_result = 0;
  Arguments matched;
  for (c10::Argument const& argument : op.schema().arguments()) {
    auto const is_it = [&](auto const& other) {
      if constexpr (requires { other.first; })
        return other.first == argument.name();
      else
        return other.name() == argument.name();
    };
    if (auto const it = std::find_if(named.begin(), named.end(), is_it); it != named.end())
      matched.push_back(it->second);
    else if (auto const it = std::find_if(known.begin(), known.end(), is_it); it != known.end())
      matched.push_back(b.arguments[it - known.begin()]);
    else if (argument.name() == "grad" || argument.name() == "gradient" || argument.name().starts_with("grad_"))
      matched.push_back(b.grads.at(next_grad++));
    else if (is_tensor(argument) && next_result < b.results.size())
      matched.push_back(b.results[next_result++]);
    else
      TORCH_INTERNAL_ASSERT(false, name_of(op), ": ", name_of(b.op), " has no ", argument.name(), " for its gradient");
  }
  return matched;
}

// A name as a template's argument.
template <size_t N>
struct Name {
  char text[N];
  consteval Name(char const (&literal)[N]) { std::copy_n(literal, N, text); }
};

template <class T>
using Parameter = std::conditional_t<std::is_arithmetic_v<T>, T, T const&>;

template <class T>
c10::IValue boxed(T const& x) {
  return x;
}
inline c10::IValue boxed(Tensor const& x) { return x.defined() ? c10::IValue(x) : c10::IValue(); }
inline c10::IValue boxed(OptionalTensor const& x) { return x ? boxed(*x) : c10::IValue(); }

template <class Result>
Result unboxed(variable_list&& results) {
  if constexpr (std::is_same_v<Result, Tensor>)
    return std::move(results[0]);
  else
    return [&]<size_t... i>(std::index_sequence<i...>) {
      return Result{std::move(results[i])...};
    }(std::make_index_sequence<std::tuple_size_v<Result>>());
}

}  // namespace detail

// --- rules

// The results are constants.
inline constexpr Rule non_differentiable{};

// Python alone has the gradient.
inline constexpr Rule no_gradient{[](Backward const& b) -> variable_list {
  std::string const name = detail::name_of(b.op);
  size_t const backward = name.find("_backward");
  if (backward == std::string::npos)
    TORCH_CHECK_NOT_IMPLEMENTED(false, name, ": C++ has no gradient of it; Python's kvision has");
  TORCH_CHECK_NOT_IMPLEMENTED(false, name.substr(0, backward),
                              ": C++ has no second derivative of it; Python's kvision has");
}};

inline variable_list Backward::call(std::string const& name, NamedArguments named, Rule const& rule) const {
  auto const other = detail::find(name);
  return detail::run(other, rule, detail::match(*this, other, named));
}
inline variable_list Backward::call(std::string const& name, NamedArguments named) const {
  return call(name, named, no_gradient);
}
inline variable_list Backward::run(std::string const& name, Arguments arguments, Rule const& rule) const {
  return detail::run(detail::find(name), rule, std::move(arguments));
}

// Any operator by its name: call("sobel_backward", {grad, input, true, 1e-6}).
inline variable_list call(std::string const& name, Arguments arguments, Rule const& rule = no_gradient) {
  auto const op = detail::find(name);
  op.schema().checkAndNormalizeInputs(arguments);
  return detail::run(op, rule, std::move(arguments));
}

// The operator <name>_backward gives the gradients to all tensors side by side, (B, n).
inline constexpr Rule side_by_side{[](Backward const& b) -> variable_list {
  Arguments arguments = b.arguments;
  arguments.insert(arguments.begin(), b.grad());
  auto const backward = detail::find(detail::name_of(b.op) + "_backward");
  Tensor const all = detail::run(backward, no_gradient, std::move(arguments))[0];
  variable_list gradients;
  int64_t first = 0;
  for (size_t i = 0; i < b.arguments.size(); ++i) {
    Tensor const x = b.tensor(i);
    gradients.emplace_back();
    if (!x.defined()) continue;
    Ints shape = x.sizes().vec();
    shape[0] = 1;
    int64_t const count = c10::multiply_integers(shape);
    shape[0] = all.size(0);
    if (b.needs(i)) gradients.back() = all.narrow(1, first, count).reshape(shape);
    first += count;
  }
  return gradients;
}};

// --- operators

template <detail::Name name, class Schema>
struct Operator;

template <detail::Name op, class Result, class... Types>
struct Operator<op, Result(Types...)> {
  Rule rule;

  Result operator()(detail::Parameter<Types>... arguments) const {
    static auto const handle = detail::find(op.text);
    return detail::unboxed<Result>(detail::run(handle, rule, {detail::boxed(arguments)...}));
  }
};

// Results of more than one tensor.
using Two = std::tuple<Tensor, Tensor>;
using Three = std::tuple<Tensor, Tensor, Tensor>;
using Four = std::tuple<Tensor, Tensor, Tensor, Tensor>;
using Five = std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor>;

}  // namespace ops
}  // namespace kvision
