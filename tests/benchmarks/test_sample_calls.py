"""The table of sample calls says what its tensors are."""

import inspect

import pytest
import torch

from benchmarks.sample_calls import SampleCall, Size, public_functions, sample_calls, sample_modules

pytestmark = pytest.mark.interface

SIZE = Size(2, 3, 20, 24)


def test_tensors_have_the_axes_and_ranges_of_their_entries():
    for call in (*sample_calls(), *sample_modules()):
        for name, x in call.tensors(SIZE).items():
            axes = call.axes[name]
            assert tuple(x.shape) == axes.shape(SIZE), f"{call.name}, {name}: {tuple(x.shape)}, expected {axes.axes}"
            if axes.make is None:
                low, high = SIZE.number(axes.low), SIZE.number(axes.high)
                assert x.isfinite().all() and low <= x.min() and x.max() <= high, f"{call.name}, {name}"


def test_every_function_has_one_entry_in_the_order_of_its_arguments():
    calls = list(sample_calls())
    assert len({call.name for call in calls}) == len(calls)
    assert {call.name for call in calls} <= set(public_functions())
    for call in calls:
        parameters = list(inspect.signature(call.function()).parameters)
        given = [name for name in call.axes if name[0] != "_"]
        assert given == [name for name in parameters if name in given], call.name
        assert set(call.others) <= set(parameters), call.name


def test_a_module_is_made_once():
    import kvision as K

    call = SampleCall("filters.BoxBlur", {"input": next(iter(sample_calls())).axes["input_tensor"]}, {}, (3,))
    x = torch.rand(1, 2, 5, 6)
    assert torch.equal(call.call(K, {"input": x}), K.filters.box_blur(x, 3))
    assert call.module(K, x.device) is call.module(K, x.device)
