"""What other packages call: the entry point `virtual` of the group `armadico.rehearsals`.

    found = find(REHEARSALS, "virtual").load()(mesh, {"goal": [8.0, 1.0, None]}, samples=4)
    found["small"], found["full"], found["picture"]

It takes and returns plain values, so that a caller needs no type of this package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import msgspec

from armadico.core.config_errors import ConfigError
from armadico.observe.jsons import JsonObject
from armadico.rehearsal.fork import Errand
from armadico.rehearsal.rehearse import SAMPLES, WITHIN_S, rehearsed

if TYPE_CHECKING:
    from armadico.mesh.zenoh import ZenohMesh


def rehearse(
    mesh: ZenohMesh,
    errand: Mapping[str, object],
    *,
    samples: int = SAMPLES,
    within_s: float = WITHIN_S,
    seed: int = 0,
    world: str | None = None,
    done: Callable[[int], None] = lambda _: None,
    picture: bool = False,
) -> JsonObject:
    """Rehearse an errand of the society on an open, joined mesh, which is only observed.

    It blocks, at most for `within_s` and about a second more. It may be called from any thread, and
    all that it starts has ended when it returns or raises.

    Args:
        mesh: The mesh; nothing is published on it.
        errand: The fields of `Errand`: `goal` as x, y (m) and a heading (rad, or None), or
            `mission`; `without`, `sets`, `kills`. Empty: the present mission goes on.
        samples: The number of samples.
        within_s: The answer comes after so long, with what has ended by then.
        seed: The first sample's.
        world: The map, by name or path, if it is not here under the name that the society has.
        done: Called with the number of samples that have ended, in this thread.
        picture: Whether to draw the paths.

    Returns:
        `answer`: yes, no or unknown; `says`: one sentence; `small`: JSON of less than 1.5 kB;
        `full`: everything, with the paths; `picture`: an SVG, or "".

    Raises:
        ConfigError: The errand cannot be this society's, such as an agent that does not take part.
    """
    try:
        wanted = msgspec.convert(errand, Errand, strict=False)
        unknown = sorted({*errand} - {*Errand.__struct_fields__})
        if unknown:
            known = ", ".join(Errand.__struct_fields__)
            raise ConfigError(f"rehearse: no field {unknown[0]!r}; expected {known}")
    except msgspec.ValidationError as error:
        raise ConfigError(f"rehearse: {error}") from None
    found = rehearsed(
        mesh, wanted, samples=samples, within_s=within_s, seed=seed, world=world, done=done
    )
    drawing = ""
    if picture and found.runs:
        from armadico.rehearsal.picture import drawn

        drawing = drawn(found)
    return {
        "answer": str(found.judgement.answer),
        "says": found.says,
        "small": found.small,
        "full": found.full,
        "picture": drawing,
    }
