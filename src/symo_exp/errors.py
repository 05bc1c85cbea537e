"""The one error that a user causes and can mend."""


class ConfigError(ValueError):
    """Bad input, said in one line: what was given, what was wanted, what to do.

    The entry point prints the message without a traceback and exits with code 2.
    """

    def __init__(self, message: object) -> None:
        super().__init__(" ".join(str(message).split()))  # what a user gave may have more lines
