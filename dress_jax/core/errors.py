"""Faults in what the user gave."""


class InputError(ValueError):
    """Bad input: one message that says what is wrong, where, and how to mend it.

    Args:
        problem: what is wrong.
        where: the file, panel, edge or option at fault, outermost first.
        mend: what the user can do about it.
    """

    def __init__(self, problem: str, *, where: str = "", mend: str = ""):
        self.problem = problem
        self.where = where
        self.mend = mend
        parts = [f"{where}: {problem}" if where else problem]
        if mend:
            parts.append(mend)
        super().__init__(". ".join(part.rstrip(".") for part in parts) + ".")
