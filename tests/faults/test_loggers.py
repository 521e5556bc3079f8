"""Loggers beside a run's own get its curves, results and settings, are refused in a line, and change nothing else."""

from __future__ import annotations

import csv
import signal
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from command import checkpoint, complaint, dies, plp, same, smoke_run, tiny_smoke
from lightning.pytorch.loggers import CSVLogger, Logger

from plp_lightning.runs.directory import RunDirectory

STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"
PHASES = ("alignment", "adaptation")


class Told(Logger):
    """Prints what it is told; its runs are open until they are finished, as W&B's are."""

    unfinished: ClassVar[list[str]] = []

    def __init__(self, name: str = "nobody", save_dir: str = ".", broken: bool = False, fails: bool = False) -> None:
        super().__init__()
        if broken:
            raise ValueError("is broken")
        self.title, self.folder, self.fails = name, save_dir, fails

    @property
    def name(self) -> str:
        return self.title

    @property
    def version(self) -> str:
        return ""

    @property
    def experiment(self) -> Told:
        return self

    def log_metrics(self, metrics: Any, step: int | None = None) -> None:
        print("told", self.title, *sorted(name for name in metrics if name.startswith("final/")))

    def log_hyperparams(self, params: Any, *args: Any) -> None:
        if self.fails:
            raise RuntimeError("no account\nhere")
        assert not self.unfinished
        self.unfinished.append(self.title)
        print("settings", self.title, params["experiment"], params["seed"], self.folder)

    def finish(self) -> None:
        self.unfinished.remove(self.title)


OWN = ["--allow_imports", "test_loggers"]


def title(phase: str) -> str:
    return f"smoke-plp-goal_3-seed_0-{phase}"


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "metrics.csv").open(newline="") as file:
        return [*csv.DictReader(file)]


def values(rows: list[dict[str, str]], metric: str) -> list[float]:
    return [float(row[metric]) for row in rows if row.get(metric)]


def fitted(root: Path, *words: object) -> RunDirectory:
    answer = plp("fit", *tiny_smoke(root), *words)
    assert answer.code == 0, answer
    return smoke_run(root)


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return fitted(tmp_path_factory.mktemp("logged"), "--trainer.logger", "CSVLogger")


@pytest.mark.parametrize("phase", PHASES)
def test_a_logger_gets_curves_results_and_settings_of_each_phase(phase: str, logged: RunDirectory) -> None:
    folder = logged.phase(phase) / title(phase) / "version_0"
    found, own = rows(folder), rows(logged.phase(phase))
    for metric in ("train/bc", "val/bc"):
        expected = [float(row["value"]) for row in own if row["metric"] == metric]
        assert values(found, metric) == pytest.approx(expected)
        assert expected
    assert values(found, "final/target_success") == [logged.phase_record(phase)["trials"]["target"]["success"]]
    told = yaml.safe_load((folder / "hparams.yaml").read_text())
    assert told["experiment"] == "smoke"
    assert told["adaptation.epochs"] == 2


def test_a_logger_changes_nothing_of_a_run_and_is_kept_as_plain_data(logged: RunDirectory, tmp_path: Path) -> None:
    plain, again = fitted(tmp_path / "plain"), tmp_path / "again"
    for phase in PHASES:
        assert same(checkpoint(logged, phase)["state_dict"], checkpoint(plain, phase)["state_dict"])
    one, other = logged.read_results(), plain.read_results()
    assert one["config_sha256"] == other["config_sha256"]
    assert one["settings"] == other["settings"]
    assert not list(plain.path.rglob("version_*"))
    assert plp("fit", "--config", logged.config, "--run_root", again).code == 0
    assert rows(smoke_run(again).phase("alignment") / title("alignment") / "version_0")


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_run_with_a_logger_is_resumed_exactly(end: int, logged: RunDirectory, tmp_path: Path) -> None:
    assert dies(["fit", *tiny_smoke(tmp_path), "--trainer.logger", "CSVLogger"], STEP, 14, end) != 0
    run = smoke_run(tmp_path)
    assert plp("fit", "--resume", run.path).code == 0
    for phase in PHASES:
        assert same(checkpoint(run, phase)["state_dict"], checkpoint(logged, phase)["state_dict"])
        assert rows(run.phase(phase)) == rows(logged.phase(phase))


def test_each_phase_has_a_logger_of_its_own_which_is_told_settings_once_and_finished(tmp_path: Path) -> None:
    answer = plp("fit", *tiny_smoke(tmp_path), *OWN, "--trainer.logger=test_loggers.Told")
    assert answer.code == 0, answer
    lines = answer.out.splitlines()
    folders = {phase: smoke_run(tmp_path).phase(phase) for phase in PHASES}
    told = [f"settings {title(phase)} smoke 0 {folder}" for phase, folder in folders.items()]
    assert [line for line in lines if line.startswith("settings")] == told
    for phase in PHASES:
        assert sum(line.startswith(f"told {title(phase)} final/") for line in lines) == 1
    assert Told.unfinished == []


FORMS = {
    "a word": ("CSVLogger", ["CSVLogger"]),
    "an import path": ("lightning.pytorch.loggers.CSVLogger", ["CSVLogger"]),
    "a class": ("{class_path: CSVLogger, init_args: {prefix: x}}", ["CSVLogger x"]),
    "a list": ("[TensorBoardLogger, {class_path: CSVLogger}]", ["TensorBoardLogger", "CSVLogger"]),
    "nothing": ("null", []),
    "only a run's own": ("true", []),
    "an empty list": ("[]", []),
}


def loggers(*words: object) -> list[str]:
    """Classes, each with its prefix, in the configuration that is kept."""
    answer = plp("fit", *tiny_smoke(Path("nowhere")), *words, "--print_config")
    assert answer.code == 0, answer
    found = yaml.safe_load(answer.out)["trainer"]["logger"] or []
    return [f"{x['class_path'].rsplit('.', 1)[1]} {x['init_args']['prefix']}".strip() for x in found]


@pytest.mark.parametrize("form", FORMS)
def test_files_and_flags_name_loggers_in_all_forms(form: str, tmp_path: Path) -> None:
    text, expected = FORMS[form]
    (tmp_path / "page.yaml").write_text(f"trainer: {{logger: {text}}}\n")
    page = ["--config", tmp_path / "page.yaml"]
    assert loggers(*page) == expected
    assert loggers("--trainer.logger", text) == expected
    (tmp_path / "more.yaml").write_text("trainer: {logger+: CSVLogger}\n")
    more = ["--config", tmp_path / "more.yaml", f"--trainer.logger+={text}"]
    assert loggers(*page, *more) == [*expected, "CSVLogger", *expected]


def test_flags_replace_the_loggers_of_files(tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_text("trainer: {logger: [TensorBoardLogger, CSVLogger]}\n")
    page = ["--config", tmp_path / "page.yaml"]
    assert loggers(*page, "--trainer.logger.prefix", "y") == ["TensorBoardLogger", "CSVLogger y"]
    assert loggers(*page, "--trainer.logger=CSVLogger") == ["CSVLogger"]


def test_settings_belong_to_the_logger_before_them() -> None:
    words = "--trainer.logger CSVLogger --trainer.logger.prefix 5 --trainer.logger+=TensorBoardLogger"
    assert loggers(*words.split(), "--trainer.logger.init_args.prefix=b") == ["CSVLogger 5", "TensorBoardLogger b"]


def test_a_place_and_a_name_that_are_given_stay(tmp_path: Path) -> None:
    words = ["--trainer.logger=CSVLogger", f"--trainer.logger.save_dir={tmp_path}/x", "--trainer.logger.name=a {title}"]
    fitted(tmp_path, *words)
    assert {path.name for path in (tmp_path / "x").iterdir()} == {f"a {title(phase)}" for phase in PHASES}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("Nothing", "trainer.logger: unknown class 'Nothing'"),
        ("EarlyStopping", "trainer.logger: unknown class 'EarlyStopping'"),
        ("os.path.join", "importing 'os.path.join' is not allowed"),
        ("mine.Logger", "importing 'mine.Logger' is not allowed; expected a class of this project"),
        ("5", "trainer.logger is 5; expected a logger's class, or a list of them"),
        ("false", "trainer.logger is False; expected a logger's class"),
        ("[CSVLogger,[]]", "trainer.logger is ['CSVLogger', []]; expected"),
        ("{class_path:3}", "trainer.logger is {'class_path:3': None}; expected"),
        ("[{init_args:{}}]", "trainer.logger"),
        ("", "--trainer.logger has no value"),
        ("--seed 1", "--trainer.logger has no value"),
        ("CSVLogger --trainer.logger.prefx x", "unknown key 'trainer.logger.prefx'; did you mean"),
        ("CSVLogger --trainer.logger.flush_logs_every_n_steps x", "flush_logs_every_n_steps is x; expected int"),
        ("null --trainer.logger.save_dir x", "--trainer.logger.save_dir is of no logger; expected its class before it"),
        ("Board", "trainer.logger is "),
    ],
)
def test_what_is_no_logger_is_refused_before_a_run_begins(words: str, told: str, tmp_path: Path) -> None:
    assert told in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--trainer.logger", *words.split())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("settings", ["3", "[]", "word"])
def test_settings_of_a_logger_are_keys_and_values(settings: str, tmp_path: Path) -> None:
    page = tmp_path / "page.yaml"
    page.write_text(f"trainer: {{logger: [{{class_path: CSVLogger, init_args: {settings}}}]}}\n")
    assert "init_args is " in complaint("fit", *tiny_smoke(tmp_path / "runs"), "--config", page)


def test_a_logger_that_cannot_be_built_is_refused_before_a_run_begins(tmp_path: Path) -> None:
    words = [*OWN, "--trainer.logger", "test_loggers.Told", "--trainer.logger.broken", "true"]
    assert "is broken; mend the logger's settings" in complaint("fit", *tiny_smoke(tmp_path / "runs"), *words)
    assert not (tmp_path / "runs").exists()


def test_a_logger_that_cannot_begin_is_told_in_a_line(tmp_path: Path) -> None:
    words = [*OWN, "--trainer.logger", "test_loggers.Told", "--trainer.logger.fails", "true"]
    told = complaint("fit", *tiny_smoke(tmp_path), *words)
    assert "Told can't begin (RuntimeError: no account here)" in told


@pytest.mark.parametrize("error", [RuntimeError("the server\nis gone"), KeyError("gone")])
def test_a_logger_that_fails_while_it_logs_is_told_in_a_line(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object) -> None:
        raise error

    monkeypatch.setattr("lightning.fabric.loggers.csv_logs._ExperimentWriter.log_metrics", fail)
    answer = plp("fit", *tiny_smoke(tmp_path), "--trainer.logger", "CSVLogger")
    assert answer.code == 2, answer
    assert f"plp: a logger failed ({type(error).__name__}: " in answer.err.splitlines()[-1]
    assert "--resume" in answer.err


@pytest.mark.parametrize(("name", "package"), [("WandbLogger", "wandb"), ("MLFlowLogger", "mlflow")])
def test_a_logger_whose_package_is_missing_says_what_to_install(name: str, package: str, tmp_path: Path) -> None:
    available = sys.modules[f"lightning.pytorch.loggers.{package}"].__dict__[f"_{package.upper()}_AVAILABLE"]
    if available:
        pytest.skip("it is installed here")
    told = complaint("fit", *tiny_smoke(tmp_path / "runs"), "--trainer.logger", name)
    assert f"pip install {package}" in told
    assert not (tmp_path / "runs").exists()


def test_loggers_of_lightning_are_known_by_short_names() -> None:
    assert CSVLogger.__name__ in plp("fit", "--trainer.logger.help", "CSVLogger").out
