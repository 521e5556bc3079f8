"""``plp fit --help``: one screen, and where the rest is."""

from __future__ import annotations

from plp_lightning.cli.options import OptionParser

BRIEF = """usage: plp fit --config PAGE [--config PAGE …] [--KEY VALUE …]
       plp fit --resume RUN_DIR

Train every phase of a method, evaluate and report. Pages are YAML files, or names that plp list tells; later ones and
flags beat earlier ones.

  plp fit --config r2r                                 an experiment of the paper
  plp fit --config r2r --config methods/gama           with another method
  plp fit --config arms.yaml --seed 1                  your own two robots: docs/own_robots.md

{options}

the keys that are changed most, and the groups they are of:
  --seed, --threads          seed of all that is random; threads of torch
  --data.*                   --data.file, --data.target_task, --data.trajectories, --data.batch_size: demonstrations
  --collection.*             how lacking demonstrations are collected
  --policy.*                 --policy.hidden, --policy.decoder_state: sizes, and what its parts see
  --alignment.*              a phase: --alignment.epochs, --alignment.optimizer.lr, --alignment.terms.mmd.weight
  --adaptation.*             the next phase, likewise
  --evaluation.*             --evaluation.final_episodes: success, scores, pictures, films
  --trainer.*                Lightning's: --trainer.accelerator, --trainer.precision, --trainer.logger
  --run_root, --callbacks, --score, --allow_imports, --cuda_graphs

where the rest is:
  plp fit --help all                        every key, with type and default
  plp fit --config PAGE --print_config      every key as the page resolves it
  plp fit --policy.help PortablePolicy      settings of a class; --alignment.help and so on
  plp list                                  experiments, methods, simulators, tasks"""


def brief_help(parser: OptionParser) -> str:
    """The screen, with the options that only ``plp fit`` has."""
    _, _, options = parser.format_help().partition("options:")
    return BRIEF.format(options=f"options:{options}".rstrip())
