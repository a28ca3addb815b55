"""Random scenes."""

import pytest

import kvision as K

G = K.geometry
BAD = [
    (lambda: G.generate_scene(0, 3), ValueError, "generate_scene: expected num_views"),
]  # fmt: skip


@pytest.mark.parametrize("call, error, message", BAD, ids=range(len(BAD)))
def test_errors(call, error, message):
    with pytest.raises(error, match=message) as caught:
        call()
    assert isinstance(caught.value, K.core.exceptions.BaseError)
