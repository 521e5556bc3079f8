"""FOLLOWING: a rank beside rank 0 trains the phases of a run along; it writes nothing and says nothing."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from pathlib import Path
from typing import NoReturn

import torch

from datamodules.errors import UserError
from plp_lightning.placement import Place
from plp_lightning.runs.crew import Member, from_others
from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.experiment import Experiment
from plp_lightning.runs.fit import prepare_phase, train
from plp_lightning.runs.resumption import resumption
from plp_lightning.runs.trainer import joining_trainer
from plp_lightning.stopping import SIGNALS


def follow(experiment: Experiment, own: Place) -> NoReturn:
    """Train along until rank 0 says that all is done, then end this process.

    Signals are rank 0's affair, which saves and leaves: this process ends when that one does.
    """
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    os.environ["LOCAL_RANK"] = str(own.rank)  # Lightning's way to choose the device
    torch.set_num_threads(experiment.threads)
    code, member = 1, Member(own)
    try:
        _follow(experiment, member)
        code = 0
    except UserError as error:
        member.complain(str(error))
        code = 2
    except BaseException as error:
        if not from_others(error):
            member.complain(f"{type(error).__name__}: {error}")
            traceback.print_exc()
    sys.stderr.flush()
    os._exit(code)  # not by way of a group whose other ranks may be gone


def _follow(experiment: Experiment, member: Member) -> None:
    for job in member.jobs():
        run = RunDirectory(Path(job.run))
        phase = prepare_phase(experiment, job.phase, job.weights)
        resumed = resumption(run, job.phase)
        train(joining_trainer(experiment, run, job.phase, phase, resumed), experiment, phase, resumed)
