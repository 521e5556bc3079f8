from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator

import pytest

from plp_lightning.stopping import SIGNALS, PreemptedError, stoppable


@pytest.fixture(autouse=True)
def _heard() -> Iterator[None]:
    """Whoever started the tests may have them ignore some, as nohup does."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_leaves_the_block_with_its_exit_code_and_the_old_handler(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(PreemptedError, match=f"stopped by {number.name}") as found, stoppable():
        os.kill(os.getpid(), number)
    assert found.value.exit_code == 128 + number
    assert signal.getsignal(number) is before


def test_a_block_without_a_signal_changes_nothing() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)]
    with stoppable():
        assert signal.getsignal(signal.SIGTERM) is not before[0]
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)] == before


def test_a_signal_that_the_parent_process_ignores_stays_ignored() -> None:
    """As nohup asks for."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stoppable():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_whoever_survives_the_errors_of_others_does_not_survive_a_signal() -> None:
    def survive() -> None:
        with contextlib.suppress(Exception), stoppable():
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(PreemptedError):
        survive()
