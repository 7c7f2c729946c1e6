from typing import Literal

import attrs
import numpy as np
import pytest

import tvsysid as tv
from tvsysid.validators import at_least, between, one_of, optional, positive


@attrs.frozen
class Settings:
    window: float = attrs.field(default=0.1, validator=positive)
    order: int | None = attrs.field(default=None, validator=optional(at_least(0)))
    level: float = attrs.field(default=0.95, validator=between(0, 1))
    kind: str = attrs.field(default="a", validator=one_of(Literal["a", "b"]))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        *(
            ({"window": wrong}, f"Settings: window must be a positive number, got {wrong!r}")
            for wrong in (0, np.nan, np.inf, True, "wide", None)
        ),
        ({"order": 1.5}, "order must be a whole number of 0 or more, or None, got 1.5"),
        ({"order": -1}, "order must be a whole number of 0 or more, or None, got -1"),
        ({"level": 95}, "level must be a number from 0 to 1, got 95"),
        ({"kind": "c"}, "kind must be one of 'a', 'b', got 'c'"),
    ],
)
def test_settings_that_cannot_be_used_are_refused(settings, message):
    with pytest.raises(tv.InputError, match=message):
        Settings(**settings)


def test_numbers_of_numpy_are_numbers():
    assert Settings(np.float32(1), np.int64(2), 0).order == 2
