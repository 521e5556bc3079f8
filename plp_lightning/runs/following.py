"""FOLLOWING: a rank beside rank 0 trains the phases of a run along; it writes nothing and says nothing."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from typing import NoReturn

from datamodules.errors import UserError
from plp_lightning.placement import Place
from plp_lightning.runs.crew import Member, NextPhase, from_others
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.fit import prepare_phase, train
from plp_lightning.runs.resumption import resumption
from plp_lightning.runs.threads import use_threads
from plp_lightning.runs.trainer import joining_trainer
from plp_lightning.stopping import SIGNALS

LEAVING = (signal.SIGTERM, signal.SIGINT)


def follow(experiment: Experiment, own: Place) -> NoReturn:
    """Train along until rank 0 says that all is done, then end this process.

    From the first phase on signals are rank 0's affair, which saves and leaves: this process ends when that one does.
    """
    os.environ["LOCAL_RANK"] = str(own.rank)  # Lightning's way to choose the device
    use_threads(experiment.threads)
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL if number in LEAVING else signal.SIG_IGN)
    code = _followed(experiment, own)
    sys.stderr.flush()
    os._exit(code)  # not by way of a group whose other ranks may be gone


def _followed(experiment: Experiment, own: Place) -> int:
    """Exit code of this rank."""
    member = None
    try:
        member = Member(own)
        for told in member.phases():
            for number in LEAVING:
                signal.signal(number, signal.SIG_IGN)
            _follow(experiment, told)
    except UserError as error:
        assert member is not None
        member.complain(str(error))
        return 2
    except BaseException as error:
        if from_others(error):
            return 2
        traceback.print_exc()
        if member is not None:
            member.complain(f"{type(error).__name__}: {error}")
        return 1
    return 0


def _follow(experiment: Experiment, told: NextPhase) -> None:
    run = RunDirectory(told.run)
    phase = prepare_phase(experiment, told.phase, told.weights)
    resumed = resumption(run, told.phase)
    train(joining_trainer(experiment, run, told.phase, phase, resumed), experiment, phase, resumed)
