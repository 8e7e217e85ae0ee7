"""Error tree of the engine. A failure that the user can fix is an `EngineError`.

An `EngineError` has one line for the error and, if it helps, one line that says what to change. The
command line prints both without a traceback and exits with status 2. The add-on shows them in its
panel.
"""

LONGEST = 500
"""Characters of an error's message; what files say may be longer."""
LONGEST_TEXT = 1000
"""Characters of a hint, or of another message, which may list all options."""


def shortened(text: str, most: int = LONGEST_TEXT) -> str:
    """The text, without its middle if it is longer than `most` characters."""
    end = most // 3
    return text if len(text) <= most else f"{text[: most - end - 3]} … {text[-end:]}"


class EngineError(Exception):
    """Base class of all errors caused by the input, the machine or the run folder.

    `message` is one line, what is wrong, with names and numbers; `hint` one line, what to change.
    Both are shortened.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = shortened(" ".join(message.split()), LONGEST)
        self.hint = shortened(" ".join(hint.split()))

    def __str__(self) -> str:
        return f"{self.message} {self.hint}".strip()


class SceneError(EngineError):
    """A COLMAP model or its photos cannot be used."""


class RoiError(EngineError):
    """A box is malformed, unknown or empty."""


class ConfigError(EngineError):
    """A setting has a wrong name, type or range."""


class RunFolderError(EngineError):
    """A run folder or a file in it (checkpoint, PLY) cannot be read, written or resumed."""


class KernelError(EngineError):
    """The compiled kernels are missing, cannot be built, or do not accept their input."""


class GpuMemoryError(KernelError):
    """The GPU memory is full."""


class TrainingError(EngineError):
    """Training diverged: a loss, a gradient or a parameter is NaN or Inf."""


class Stopped(Exception):  # noqa: N818 - a request, not an error
    """The work was stopped on request; what is done so far is on disk."""

    resumes = False  # whether the same request continues from there
