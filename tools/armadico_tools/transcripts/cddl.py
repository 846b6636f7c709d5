"""The messages as CDDL (RFC 8610), from the annotations that `decode` checks.

What CDDL cannot express is in the text before it. Messages are arrays, so names of fields are
comments only. `epoch`, `number` and similar have no rules of their own, so that no name of CDDL's
prelude is redefined.
"""

from __future__ import annotations

from typing import Final

from msgspec import inspect as types

from armadico.core.messages import LARGEST_PAYLOAD, PROTOCOL, Message
from armadico_tools.docs_fields import ours

HEAD: Final = f"""\
; Armadico's messages, protocol {PROTOCOL}. Written by `python -m armadico_tools.transcripts`.
; Which message travels on which key: docs/protocol.md. Payloads that must be read and that must be
; refused: docs/transcripts/vectors.jsonl.
;
; Beyond this schema: at most {LARGEST_PAYLOAD:,} bytes, no tags, no indefinite lengths. A text has
; no control characters (U+0000 to 001F, 007F to 009F, 2028, 2029), nor any that turn the direction
; of writing (061C, 200E, 200F, 202A to 202E, 2066 to 2069), and its length counts in characters:
; the sizes here are those in bytes, of four a character. A float may be sent as an integer; NaN and
; the infinities are refused. What stands at the end and is not known is ignored.

"""

RESERVED: Final = frozenset({"number", "text", "time", "any", "bytes", "float", "int", "bool"})
"""Names of CDDL's prelude: zcbor makes C names of fields, and mistakes these for types."""


def schema() -> str:
    kinds = ours()[1]
    first = "message = " + " /\n    ".join(kind.__name__ for kind in kinds)
    return HEAD + "\n\n".join([first, *(rule(kind) for kind in kinds)]) + "\n"


def rule(kind: type[Message]) -> str:
    info = types.type_info(kind)
    assert isinstance(info, types.StructType), f"{kind.__name__} is a struct"
    lines = [
        f"    {'' if field.required else '? '}{_name(field.name)}: {text(field.type)},"
        f"{_range(field.type)}"
        for field in info.fields
    ]
    return "\n".join([f"{kind.__name__} = [", *lines, "    * any", "]"])


def text(info: types.Type) -> str:
    match info:
        case types.UnionType(types=members):
            return " / ".join(text(member) for member in members)
        case types.VarTupleType(item_type=item, max_length=most):
            inner = text(item)
            often = "*" if most is None else f"0*{most}"
            return f"[{often} ({inner})]" if " / " in inner else f"[{often} {inner}]"
        case types.StructType(cls=cls):
            return cls.__name__
        case types.EnumType(cls=cls):
            return " / ".join(f'"{member.value}"' for member in cls)
        case types.LiteralType(values=values):
            return " / ".join(f'"{value}"' for value in values)
        case types.FloatType():
            return "float / int"
        case types.IntType(ge=low, le=high):
            return f"{low}..{high}"
        case types.StrType(min_length=least, max_length=most):
            return f"tstr .size ({least or 0}..{4 * (most or 0)})"
        case types.BoolType():
            return "bool"
        case types.BytesType(max_length=most):
            return f"bstr .size (0..{most})"
        case types.NoneType():
            return "nil"
    raise TypeError(f"no CDDL for {info}")


def _range(info: types.Type) -> str:
    """The range of floats as a comment: few tools support CDDL's ranges of floats."""
    match info:
        case types.UnionType(types=members):
            return next((found for member in members if (found := _range(member))), "")
        case types.VarTupleType(item_type=item):
            return _range(item)
        case types.FloatType(gt=None, ge=low, le=high):
            return f"  ; {low:g} to {high:g}"
        case types.FloatType(gt=above, le=high):
            return f"  ; above {above:g}, to {high:g}"
    return ""


def _name(field: str) -> str:
    return f"{field}_" if field in RESERVED else field.replace("_", "-")
