"""Boundary-value problems as scripts state and solve them."""

from __future__ import annotations

from typing import ClassVar

from casadi_skin.zero.statement import Statement


class BoundaryValueProblem(Statement):
    __doc__ = Statement.__doc__
    always_confirmed: ClassVar[bool] = False  # but where a solution does not meet Ipopt's own test

    def __repr__(self) -> str:
        start, end = (end if isinstance(end, int | float) else "a parameter" for end in self.interval)
        conditions, integrals = (sum(int(e.numel()) for e in group) for group in (self.conditions, self.integrals))
        counts = f"{conditions} conditions, {integrals} integrals"
        free = f"; free: {', '.join(self.free)}" if self.free else ""
        return f"<BoundaryValueProblem: {self.model.name} from {start} to {end}, {counts}{free}>"
