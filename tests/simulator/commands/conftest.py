"""Fixtures of the commands' tests."""

from collections.abc import Callable

import pytest


@pytest.fixture(scope="session")
def one_error() -> Callable[..., None]:
    """Return a function that asserts that a run ended with one clear message that has all the words given."""

    def check(result: tuple[int, str, str], *words: str, code: int = 2) -> None:
        found, out, err = result
        assert found == code, err
        assert "Traceback" not in out + err
        assert err.count("error: ") == 1
        message = err[err.index("error: ") :]
        for word in words:
            assert word in message, message

    return check
