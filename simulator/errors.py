"""The one error class for mistakes that a user can mend.

The command line prints an ``InputError`` as one message with exit code 2; any other exception is our own fault (1).
"""


class InputError(ValueError):
    """Bad input. The message names the argument, what came, what was expected and the cure."""
