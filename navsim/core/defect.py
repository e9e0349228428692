"""What navsim raises where it contradicts itself: to be reported to its developers, no input corrects it."""


class Defect(Exception):
    """A result that cannot be right; the message says of what. The command ends with exit 3."""
