"""Exception for a defect of navsim itself: no input corrects it, and it should be reported to the developers."""


class Defect(Exception):
    """A result that cannot be right; the message names it. The command ends with exit code 3."""
