"""What goes wrong with input, in one sentence."""


class InputError(ValueError):
    """Input that breaks a rule: the message names the rule, the value and the remedy.

    The command line prints it and exits with code 2; nothing else is caught there.
    """
