"""CREW: the ranks of one run. Rank 0 owns the run and tells the others which phase comes next; they train along."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from datetime import timedelta
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import torch
from torch.distributed import (  # type: ignore[attr-defined]  # torch exports its stores so
    DistError,
    PrefixStore,
    TCPStore,
    destroy_process_group,
    init_process_group,
)

from datamodules.errors import ConfigError, UserError
from plp_lightning.placement import HOME, Place, place

PATIENCE = timedelta(days=30)
"""Time that ranks wait for rank 0, which may evaluate in simulators meanwhile."""
STARTING, LEAVING, FLEEING = timedelta(minutes=10), timedelta(seconds=30), timedelta(seconds=3)
HERE, GONE, NEXT, FAULT, OVER = "here", "gone", "next", "fault", "over"


class RankLostError(UserError):
    """A rank of a run has ended before the run was over."""


class NextPhase(NamedTuple):
    """A phase that all ranks train."""

    run: Path
    phase: str
    weights: Path | None  # Checkpoint that it begins with

    def to_json(self) -> str:
        """Its text, for :meth:`from_json`."""
        return json.dumps([None if part is None else str(part) for part in self])

    @classmethod
    def from_json(cls, text: str) -> NextPhase:
        """Inverse of :meth:`to_json`."""
        run, phase, weights = json.loads(text)
        return cls(Path(run), phase, None if weights is None else Path(weights))


def own_place(count: int) -> Place | None:
    """Give the place of this process in a run of ``count`` ranks; None if nobody but itself starts the others.

    Raises:
        ConfigError: If another number of processes was started.
    """
    found = place() if count > 1 else None
    if found is not None and found.total != count:
        told = f"trainer.devices is {count}, and {found.total} processes were started together"
        raise ConfigError(f"{told}; expected as many: set --trainer.devices {found.total}")
    return found


class Crew:
    """All ranks of a run, in the hands of rank 0; they end when the block is left.

    Args:
        count: Number of ranks; with 1 there is nobody to tell anything.
        words: Arguments of ``plp`` that further ranks are started with, unless a launcher has started them.

    Raises:
        RankLostError: If another rank ends before it is told to.
    """

    def __init__(self, count: int, words: Sequence[str] = ()) -> None:
        self.count, self.words, self.place = count, words, own_place(count)
        self.store: TCPStore | None = None
        self.children: list[subprocess.Popen[bytes]] = []
        self.told, self.together, self.over = 0, False, False

    def __enter__(self) -> Crew:
        if self.place is not None:  # who is not here yet would never know that this rank has failed
            self._open()
            self._wait_for(HERE, STARTING)
        return self

    def tell(self, phase: NextPhase) -> None:
        """Let all other ranks train a phase along with this one, which is to begin at once."""
        if self.count > 1:
            self._gather()
            self._say(phase.to_json())

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.over = True
        try:
            if isinstance(error, RuntimeError) and self.together and (reason := self._lost(error)):
                raise RankLostError(
                    f"{reason}; expected all ranks to stay: go on with plp fit --resume RUN_DIR"
                ) from error
        finally:
            self._dismiss(finished=error is None)

    def _dismiss(self, finished: bool) -> None:
        if self.store is not None:
            with contextlib.suppress(RankLostError, RuntimeError):
                if finished:
                    self._say("")
                else:
                    self.store.set(OVER, "")
                self._wait_for(GONE, LEAVING if finished else FLEEING)
        for child in self.children:
            child.kill()
            child.wait()
        if self.together and finished:
            destroy_process_group()

    def _open(self) -> TCPStore:
        address, port, served = (HOME, 0, False) if self.place is None else self.place[2:]
        if self.store is None:
            try:
                self.store = TCPStore(address, port, is_master=not served, wait_for_workers=False, timeout=STARTING)
            except (DistError, RuntimeError) as error:
                told = f"{address}:{port}: no place for ranks to meet ({str(error).splitlines()[0]})"
                raise ConfigError(f"{told}; expected a free port: set MASTER_PORT") from None
        return self.store

    def _gather(self) -> None:
        """Have all ranks here, ready to take steps together."""
        if self.together:
            return
        store = self._open()
        if self.place is None:
            self.children = [self._started(rank, store.port) for rank in range(1, self.count)]
            self._wait_for(HERE, STARTING)
        meet(store, 0, self.count)
        self.together = True
        if torch.cuda.is_available():
            threading.Thread(target=self._mind, daemon=True).start()

    def _mind(self) -> None:
        """End this process some time after another rank: a step on GPUs would wait for that one without end."""
        while not (reason := self._ended()):
            time.sleep(1)
        time.sleep(LEAVING.total_seconds())  # as a rule the main thread notices, and leaves in order
        if not self.over:
            print(f"plp: {reason}; expected all ranks to stay: go on with plp fit --resume RUN_DIR", file=sys.stderr)
            os._exit(2)

    def _started(self, rank: int, port: int) -> subprocess.Popen[bytes]:
        numbers = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": self.count, "MASTER_PORT": port}
        told = {name: str(number) for name, number in numbers.items()} | {"MASTER_ADDR": HOME}
        told["TORCH_CPP_LOG_LEVEL"] = "ERROR"  # Rank 0 has the word when connections break
        command = [sys.executable, "-m", "plp_lightning", "fit", *self.words]
        nothing = subprocess.DEVNULL
        return subprocess.Popen(command, env={**os.environ, **told}, stdin=nothing, stdout=nothing)

    def _say(self, text: str) -> None:
        self._open().set(f"{NEXT}/{self.told}", text)
        self.told += 1

    def _wait_for(self, what: str, most: timedelta) -> None:
        """Wait until all other ranks are ``here``, or ``gone``."""
        end, store = time.monotonic() + most.total_seconds(), self._open()
        while store.add(what, 0) < self.count - 1:
            if lost := self._ended():
                raise RankLostError(f"{lost}; expected it to join: see what it says, then plp fit --resume RUN_DIR")
            if time.monotonic() > end:
                raise RankLostError(
                    f"not all of {self.count} ranks are {what}; expected them within {most}: start anew"
                )
            time.sleep(0.05)

    def _ended(self) -> str:
        """Tell which rank has ended, and by what; empty if none is known to."""
        codes = {rank: child.poll() for rank, child in enumerate(self.children, 1)}
        told = (f"rank {rank} has ended (exit code {code})" for rank, code in codes.items() if code is not None)
        return self._fault() or next(told, "")

    def _fault(self) -> str:
        with contextlib.suppress(RuntimeError):
            return self._open().get(FAULT).decode() if self._open().check([FAULT]) else ""
        return ""

    def _lost(self, error: RuntimeError) -> str:
        """Tell which rank was lost if that is what an error comes from."""
        for _ in range(20):  # who ends needs a moment for it
            if reason := self._ended():
                return reason
            time.sleep(0.1)
        return "a rank has ended" if from_others(error) else ""


def from_others(error: BaseException) -> bool:
    """Tell whether an error comes from a collective operation in which others did not take part."""
    words = ("gloo", "nccl", "connection closed", "connection reset", "broken pipe")
    return isinstance(error, DistError) or any(word in str(error).lower() for word in words)


def meet(store: TCPStore, rank: int, count: int) -> None:
    """Let ranks compute together: over NCCL on GPUs, over gloo elsewhere."""
    backend = "cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo"
    init_process_group(backend, store=PrefixStore("group", store), rank=rank, world_size=count, timeout=PATIENCE)


class Member:
    """A rank beside rank 0; it ends at once when rank 0 does.

    Args:
        own: Its place.
    """

    def __init__(self, own: Place) -> None:
        self.own, self.store = own, self._reached(own)
        threading.Thread(target=self._watch, daemon=True).start()
        self.store.add(HERE, 1)
        meet(self.store, own.rank, own.total)

    def phases(self) -> Iterator[NextPhase]:
        """Phases to train, when rank 0 tells of them, until it says that all are done."""
        number = 0
        while text := self._heard(number):
            yield NextPhase.from_json(text)
            number += 1
        self.store.add(GONE, 1)

    def complain(self, fault: str) -> None:
        """Leave the reason why this rank ends where rank 0 finds it."""
        with contextlib.suppress(RuntimeError):
            self.store.set(FAULT, f"rank {self.own.rank}: {fault}")

    def _heard(self, number: int) -> str:
        self.store.wait([f"{NEXT}/{number}"], PATIENCE)
        return self.store.get(f"{NEXT}/{number}").decode()

    def _watch(self) -> None:
        """End this process when rank 0 says so, or has gone without a word, which a waiting main thread would miss."""
        with contextlib.suppress(RuntimeError):
            store = self._reached(self.own)
            while not store.check([OVER]):
                time.sleep(0.2)
            store.add(GONE, 1)
        os._exit(2)

    @staticmethod
    def _reached(own: Place) -> TCPStore:
        return TCPStore(own.address, own.port, is_master=False, wait_for_workers=False, timeout=STARTING)
