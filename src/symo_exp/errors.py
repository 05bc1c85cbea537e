"""The one error that a user causes and can mend."""


class ConfigError(ValueError):
    """Bad input, said in one line: what was given, what was wanted, what to do.

    The entry point prints the message without a traceback and exits with code 2.
    """
