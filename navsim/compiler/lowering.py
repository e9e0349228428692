"""LLVM code of one function: numba's own, without what a navsim kernel does not need.

numba keeps each variable of several blocks in memory, and clears it where it ends. A variable is often a tuple of a
hundred arrays, so that copies were a third of the code. Here a variable that is assigned once is its value itself, and
arguments, which the caller holds, are not counted.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from numba.core import ir
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs
from numba.core.lowering import Lower


class DirectLower(Lower):
    """numba's lowering with fewer copies of variables."""

    def _find_singly_assigned_variable(self) -> None:
        """Find the variables that need no memory: assigned once, in a block that all their users follow."""
        super()._find_singly_assigned_variable()
        self._arguments: set[str] = set()
        if self.generator_info:
            return
        steps = [(at, step) for at, block in self.blocks.items() for step in block.find_insts(ir.Assign)]
        assignments = Counter(step.target.name for _, step in steps)
        self._arguments = {
            step.target.name for _, step in steps
            if isinstance(step.value, ir.Arg) and assignments[step.target.name] == 1
        }  # fmt: skip
        before = compute_cfg_from_blocks(self.blocks).dominators()
        users: dict[str, set[int]] = {}
        for at, names in compute_use_defs(self.blocks).usemap.items():
            for name in names:
                users.setdefault(name, set()).add(at)
        for at, step in steps:
            name = step.target.name
            followed = all(at < user and at in before[user] for user in users.get(name, ()))
            if assignments[name] == 1 and followed and self._holds_nothing(name):
                self._singly_assigned_vars.add(name)

    def _holds_nothing(self, name: str) -> bool:
        """Whether no memory must be freed when the variable ends."""
        model = self.context.data_model_manager[self.typeof(name)]
        return not self.context.enable_nrt or name in self._arguments or not model.contains_nrt_meminfo()

    def incref(self, typ: Any, val: Any) -> None:
        """Count a reference, but not that of an argument."""
        if not self._of_argument:
            super().incref(typ, val)

    _of_argument = False

    def lower_assign(self, ty: Any, inst: Any) -> Any:
        """The value to be assigned."""
        self._of_argument = inst.target.name in self._arguments
        try:
            return super().lower_assign(ty, inst)
        finally:
            self._of_argument = False

    def storevar(self, value: Any, name: str, argidx: int | None = None) -> None:
        """Assign a value to a variable."""
        if name in self._singly_assigned_vars or not self._holds_nothing(name):
            super().storevar(value, name, argidx)
        else:
            self.builder.store(value, self.getvar(name))

    def delvar(self, name: str) -> None:
        """End a variable."""
        if not self._holds_nothing(name):
            super().delvar(name)
