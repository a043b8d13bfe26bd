"""The one exception that means "what you gave cannot be used"."""


class BadInput(Exception):
    """Input that cannot be used; the message is one line: the file, what is wrong, the remedy.

    The command prints the message and exits with status 2. Anything else that escapes is a bug.
    """
