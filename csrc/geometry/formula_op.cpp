// Formulas: schemas and entries, for CPU and CUDA.
#include "geometry/formula_glue.h"

namespace kv::geometry {
namespace {

// The operator of a formula and its gradient, whose arguments are those of the formula.
template <class F, int I>
using FormulaInput = std::conditional_t<(I < F::kRequired || I == 0), Tensor const&, std::optional<Tensor> const&>;
template <int>
using ScalarArgument = double;
template <int>
using RowCount = int64_t;

template <class F, class Name, class Others = std::make_integer_sequence<int, F::kInputs - 1>,
          class ScalarSequence = std::make_integer_sequence<int, F::kScalars>,
          class RowCounts = std::make_integer_sequence<int, F::kOptionalLastRow>>
struct FormulaEntry;
template <class F, class Name, int... I, int... K, int... R>
struct FormulaEntry<F, Name, std::integer_sequence<int, I...>, std::integer_sequence<int, K...>,
                    std::integer_sequence<int, R...>> {
  using Inputs = std::optional<Tensor>[F::kInputs];
  using Scalars = std::array<double, F::kScalars>;

  static Tensor forward(Tensor const& first, FormulaInput<F, I + 1>... others, ScalarArgument<K>... scalars,
                        RowCount<R>... rows) {
    FormulaArguments<F> arguments(Name::text, first, first.scalar_type(), Inputs{first, others...}, Scalars{scalars...},
                                  (0 + ... + rows));
    return arguments.result(Name::text, first);
  }

  static Tensor backward(Tensor const& grad, Tensor const& first, FormulaInput<F, I + 1>... others,
                         ScalarArgument<K>... scalars, RowCount<R>... rows) {
    constexpr char const* op = Name::backward;
    FormulaArguments<F> arguments(op, first, first.scalar_type(), Inputs{first, others...}, Scalars{scalars...},
                                  (0 + ... + rows));
    int64_t const batch = grad.dim() > 0 ? grad.size(0) : 0;
    KV_CHECK((arguments.params.batch == 1 || arguments.params.batch == batch) && has_extent(grad, arguments.extent()) &&
                 grad.scalar_type() == first.scalar_type() && grad.device() == first.device(),
             op, ": expected grad of shape ", extent_text(arguments.extent()), ", all of one type and device");
    arguments.params.batch = batch;
    Tensor const dense_grad = dense(grad),
                 grad_inputs = empty({batch, __builtin_popcountll(arguments.params.present)}, grad);
    arguments.params.grad = typed_pointer(op, dense_grad);
    arguments.params.grad_inputs = typed_pointer(op, grad_inputs);
    KV_RUN(formula_backward, grad, arguments.params, batch, 2 * F::kInputSize * F::kOutputSize);
    return grad_inputs;
  }
};

}  // namespace

#define KV_FORMULA_OPERATOR(name, Formula, inputs)                                \
  namespace {                                                                     \
  struct name##_name {                                                            \
    static constexpr char const* text = #name;                                    \
    static constexpr char const* backward = #name "_backward";                    \
  };                                                                              \
  constexpr auto& name = FormulaEntry<Formula, name##_name>::forward;             \
  constexpr auto& name##_backward = FormulaEntry<Formula, name##_name>::backward; \
  }                                                                               \
  KV_OPERATOR(name, "(" inputs ") -> Tensor")                                     \
  KV_OPERATOR(name##_backward, "(Tensor grad, " inputs ") -> Tensor")

KV_FORMULAS(KV_FORMULA_OPERATOR)

#undef KV_FORMULA_OPERATOR

}  // namespace kv::geometry
