"""The one error class for mistakes that a user can mend.

The command line prints an ``InputError`` as one message with exit code 2; any other exception is our own fault (1).
"""


class InputError(ValueError):
    """Bad input.

    Attributes:
        path: where it is: an argument, a key (``camera.sensor.shape``), an option or a file; empty where the reason says it.
        reason: what came, what was expected and the cure. ``InputError(reason)`` has an empty path.
        place: where a configuration says it (``file:line:column``, ``--set a.b=c``), once that is known.
    """

    place = ""

    def __init__(self, path: object, reason: str | None = None) -> None:
        self.path, self.reason = ("", str(path)) if reason is None else (str(path), reason)
        super().__init__(self.path, self.reason)

    def __str__(self) -> str:
        """Return the one line that a user reads, after the place."""
        return f"{self.path}: {self.reason}" if self.path else self.reason
