"""What a client can read and ask with, besides the tools: resources and prompts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import Struct

from armadico.observe.jsons import JsonObject

SCHEME: Final = "armadico://"

PNG: Final = "image/png"


class Resource(Struct, frozen=True):
    """A resource; it is read by a tool, so that reading it is recorded and limited as a call is."""

    uri: str
    what: str
    kind: str  # its MIME type
    tool: str


class Prompt(Struct, frozen=True):
    """A text for a language model; `{name}` in it is replaced by the argument."""

    name: str
    what: str
    arguments: Mapping[str, str]  # what each one is
    text: str


RESOURCES: Final = {
    resource.uri: resource
    for resource in (
        Resource(f"{SCHEME}map", "The map, with the robot and its goal on it", PNG, "map"),
        Resource(f"{SCHEME}places", "The named places", "application/json", "places"),
        Resource(f"{SCHEME}status", "The robot now", "application/json", "where"),
    )
}

PROMPTS: Final = {
    prompt.name: prompt
    for prompt in (
        Prompt(
            "errand",
            "Have the robot do an errand",
            {"errand": "what is to be done, such as: see whether the kitchen is free"},
            "Have the robot do this: {errand}\n"
            "Look first: `where` and `places`. Go to one place after the other by name, with"
            " `goto` and `wait_s`, and read how each ended before the next. If a goal is refused"
            " or fails, say why in its own words; do not try the same again more than once. Report"
            " only what the answers say. If the robot is stopped, a person has to release it.",
        ),
        Prompt(
            "explain",
            "Explain what the robot does now, and why",
            {},
            "Explain to somebody beside the robot what it does now and why: use `where`, `why` and"
            " `history`. Name what is not known.",
        ),
    )
}


def listed_resources() -> JsonObject:
    rows: list[JsonObject] = [
        {
            "uri": each.uri,
            "name": each.uri.removeprefix(SCHEME),
            "description": each.what,
            "mimeType": each.kind,
        }
        for each in RESOURCES.values()
    ]
    return {"resources": rows}


def listed_prompts() -> JsonObject:
    rows: list[JsonObject] = [
        {
            "name": each.name,
            "description": each.what,
            "arguments": [
                {"name": name, "description": what, "required": True}
                for name, what in each.arguments.items()
            ],
        }
        for each in PROMPTS.values()
    ]
    return {"prompts": rows}


def prompted(name: str, arguments: Mapping[str, str]) -> JsonObject:
    """Return a prompt's message. Raises ValueError for an unknown name or wrong arguments."""
    prompt = PROMPTS.get(name)
    if prompt is None:
        raise ValueError(f"no prompt {name!r}; known: {', '.join(PROMPTS)}")
    if set(arguments) != set(prompt.arguments):
        wanted = ", ".join(prompt.arguments) or "none"
        raise ValueError(f"prompt {name}: expected the arguments {wanted}")
    text = prompt.text
    for each, value in arguments.items():
        text = text.replace("{" + each + "}", value)
    message: JsonObject = {"role": "user", "content": {"type": "text", "text": text}}
    return {"description": prompt.what, "messages": [message]}
