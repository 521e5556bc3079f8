from __future__ import annotations

import itertools
import signal
from pathlib import Path

import pytest
import yaml
from command import ROOT, checkpoint, dies, plp, results, same, smoke_run, tiny_smoke

from plp_lightning.runs.directory import RunDirectory
from plp_lightning.runs.metrics_file import read_rows

OVERLAY = ["--config", str(ROOT / "configs" / "methods" / "cdil.yaml")]
PHASES = ("positions", "alignment", "dynamics", "adaptation")
FEW = [word for name in ("positions", "dynamics") for word in (f"--{name}.epochs", "1")]
MOMENTS = {"first epoch of alignment": 8, "second epoch of alignment": 17, "second epoch of adaptation": 30}
"""Steps 1 to 6 are positions, 7 to 20 alignment, 21 to 26 dynamics, 27 to 32 adaptation."""
STEP = "plp_lightning.callbacks.preemption:Preemption.on_train_batch_end"


def words(run_root: Path) -> list[str]:
    experiment, tiny = tiny_smoke(run_root)[:2], tiny_smoke(run_root)[2:]
    return [*experiment, *OVERLAY, *tiny, *FEW]


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    root = tmp_path_factory.mktemp("cdil")
    answer = plp("fit", *words(root))
    assert answer.code == 0, answer
    run = smoke_run(root, "cdil")
    assert [checkpoint(run, phase)["global_step"] for phase in PHASES] == [6, 14, 6, 6]
    return run


def test_a_run_gives_results_and_can_be_tested_again(unbroken: RunDirectory) -> None:
    found = results(unbroken)
    assert found["method"] == "cdil"
    for trial in ("target", "source", "proxy", "proxy_source"):
        assert (found[trial]["episodes"], found[trial]["invalid"]) == (4, 0)
    assert 0 <= found["alignment"]["closeness"] <= 1
    answer = plp("test", unbroken.path)
    assert answer.code == 0, answer


def test_success_is_evaluated_where_what_acts_has_been_trained(unbroken: RunDirectory) -> None:
    assert [sorted(unbroken.phase_record(phase)["trials"]) for phase in PHASES[:3]] == [[]] * 3
    assert results(unbroken)["target"]["before"] is None
    answer = plp("fit", "--resume", unbroken.path)
    row = next(line for line in answer.out.splitlines() if "target task in target domain" in line)
    assert row.split("│")[4].strip() == "–"


def test_checkpoints_are_chosen_by_the_sum_of_a_phase_s_own_losses(unbroken: RunDirectory) -> None:
    for phase in PHASES:
        values = {name: float(value) for _, name, value in read_rows(unbroken.phase(phase) / "metrics.csv")}
        own = [value for name, value in values.items() if name.startswith("val/") and name != "val/loss"]
        assert values["val/loss"] == pytest.approx(sum(own), rel=1e-4)
        assert "val/bc" not in values
        assert unbroken.checkpoint(phase, "best").exists()


def test_a_phase_changes_the_parts_that_it_trains_and_no_others(unbroken: RunDirectory) -> None:
    trained = {"alignment": {"translator", "pace"}, "dynamics": {"inverse_dynamics"}, "adaptation": {"clones"}}
    for before, after in itertools.pairwise(PHASES):
        one, other = (checkpoint(unbroken, phase)["state_dict"] for phase in (before, after))
        names = [name for name in other if name.startswith("policy.")]
        changed = {name.split(".")[1] for name in names if not same(one[name], other[name])}
        assert changed == trained[after]


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_resumes_to_the_same_weights(moment: str, unbroken: RunDirectory, tmp_path: Path) -> None:
    assert dies(["fit", *words(tmp_path)], STEP, MOMENTS[moment], signal.SIGKILL) == -signal.SIGKILL
    run = smoke_run(tmp_path, "cdil")
    answer = plp("fit", "--resume", run.path)
    assert answer.code == 0, answer
    for phase in PHASES:
        ours, theirs = checkpoint(run, phase), checkpoint(unbroken, phase)
        assert same(ours["state_dict"], theirs["state_dict"]), phase
        assert same(ours["optimizer_states"], theirs["optimizer_states"]), phase
    assert results(run) == results(unbroken)


def test_the_page_sets_what_it_shares_with_the_method() -> None:
    page = ["--config", str(ROOT / "configs" / "p2p_umaze.yaml")]
    printed = yaml.safe_load(plp("fit", *page, *OVERLAY, "--print_config").out)
    assert printed["policy"]["init_args"]["scaling"] == {"position": 1.0, "velocity": 1.0}
    assert printed["alignment"]["class_path"].endswith("CdilAlignment")
    adaptation = printed["adaptation"]["init_args"]
    assert adaptation.keys() == {"epochs", "optimizer", "lr_scheduler"}
    assert (adaptation["epochs"], adaptation["lr_scheduler"]) == (25, None)
    assert adaptation["optimizer"]["class_path"].endswith("FusedAdamW")
    assert adaptation["optimizer"]["init_args"] == {"lr": 5e-4, "weight_decay": 1e-5, "first_moment": 0.9}


def test_images_are_translated_as_their_feature_points(tmp_path: Path) -> None:
    seen = ["--config", str(ROOT / "tests" / "conf" / "seen.yaml")]
    answer = plp("fit", *seen, *OVERLAY, *tiny_smoke(tmp_path)[2:], *FEW, "--policy.init_args.image_channels", "[4, 3]")
    assert answer.code == 0, answer
    (run,) = (RunDirectory(path.parent) for path in tmp_path.rglob("results.json"))
    assert 0 <= results(run)["alignment"]["closeness"] <= 1
    learned = checkpoint(run, "adaptation")["state_dict"]
    assert learned["policy.translator.encoders.source.0.weight"].shape[1] == 3 + 2 * 3
    eyes = [name for name in learned if name.startswith("policy.perception.image_encoders")]
    assert eyes
    assert all(same(learned[name], checkpoint(run, "positions")["state_dict"][name]) for name in eyes)
