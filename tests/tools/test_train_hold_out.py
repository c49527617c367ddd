from __future__ import annotations

import pytest

from tdpg_deploy.errors import ConfigError
from tools.train.hold_out import split


@pytest.mark.parametrize(
    ("count", "held_out"), [(2, [1]), (9, [8]), (10, [9]), (19, [9]), (25, [9, 19])]
)
def test_every_tenth_is_held_out_and_never_none(count: int, held_out: list[int]) -> None:
    kept, out = split(range(count), 200)
    assert out == held_out
    assert sorted(kept + out) == list(range(count))


def test_one_record_is_too_few() -> None:
    with pytest.raises(ConfigError, match=r"200 are too few .* give 201 or more"):
        split([0], 200)
