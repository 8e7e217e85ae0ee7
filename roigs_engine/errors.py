"""The engine's error tree: every failure a person can mend is an `EngineError`.

An `EngineError` carries one line that says what is wrong and, where it helps, one that says what
to change. The command line prints it without a traceback and exits with status 2; the add-on shows
it in its panel.
"""


class EngineError(Exception):
    """Root of all errors that bad input, a bad machine or a bad run folder can cause.

    Args:
        message: one line, what is wrong, with names and numbers.
        hint: one line, what to change; may be empty.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = " ".join(message.split())
        self.hint = " ".join(hint.split())

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".strip()


class SceneError(EngineError):
    """A COLMAP model or its photos cannot be used."""


class RoiError(EngineError):
    """A region of interest is malformed, unknown or empty."""


class ConfigError(EngineError):
    """A setting has a wrong name, type or range."""


class RunFolderError(EngineError):
    """A run folder or a file in it (checkpoint, PLY) cannot be read, written or continued."""


class KernelError(EngineError):
    """The compiled kernels are missing, cannot be built, or refuse their input."""


class TrainingError(EngineError):
    """Training has come to numbers that are none."""


class Stopped(Exception):  # noqa: N818 - a request that was followed, not an error
    """The run was asked to stop; what is done so far is on disk and can be gone on with."""
