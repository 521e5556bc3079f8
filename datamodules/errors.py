"""Mistakes that a user can mend: one line that says what was found, what was expected and what to do."""


class UserError(Exception):
    """Something the user handed us is wrong; the command line prints the message alone and exits with 2.

    Messages quote files of others: characters that could steer a terminal are told by their codes.
    """

    def __str__(self) -> str:
        return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in super().__str__())


class TrajectoryFileError(UserError):
    """A trajectory file is missing, damaged, hostile or not in the plp-trajectories format."""


class MissingTrajectoriesError(UserError):
    """A (domain, task) pair that the experiment needs has no demonstrations and nothing can collect them."""


class ConfigError(UserError):
    """A key, a name or a value of the configuration is wrong."""


class CheckpointError(UserError):
    """A checkpoint is missing, damaged or holds more than plain data."""
