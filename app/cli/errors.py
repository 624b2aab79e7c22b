"""What a command says when it cannot do what it was asked: one clear line, no traceback."""


class CommandError(Exception):
    """An expected failure; its text is printed to stderr.

    ``exit_code`` is 2 for a request that cannot be meant, 1 for one that did not work out.
    """

    def __init__(self, message: str, exit_code: int = 1) -> None:
        super().__init__(message)
        self.exit_code = exit_code
