"""One part of an export: what it declares, defines and generates."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from casadi_skin.export.c_text import Call, comment


@dataclass(frozen=True)
class Size:
    """A constant of the header: NAME_`suffix`, what it is in words."""

    suffix: str
    value: int
    words: str


@dataclass(frozen=True)
class Part:
    """What one name of `what` adds: constants, declarations, definitions, generated functions, C files.

    In texts `@p` stands for the prefix of functions and arrays, `@P` for that of constants.
    """

    title: str
    sizes: tuple[Size, ...] = ()
    declarations: tuple[str, ...] = ()
    definitions: tuple[str, ...] = ()
    functions: tuple[ca.Function, ...] = ()
    files: tuple[str, ...] = ()


def declared(prototype: str, words: str) -> str:
    """A declaration with its comment."""
    return f"{comment(words)}\n{prototype};"


def called(title: str, call: Call, size: str, words: str, *more: Size) -> Part:
    """The part that is one generated function behind a plain prototype."""
    sizes = (*more, Size(size, call.work, "doubles of work"))
    return Part(title, sizes, (declared(call.prototype, words),), (call.text(),), (call.function,))
