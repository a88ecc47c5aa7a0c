# SPDX-License-Identifier: GPL-3.0-or-later
"""Stacks of height operators: data that is read from and written to JSON.

    {"version": 1,
     "entries": [{"effect": "rivers", "parameters": {"years": 3e5}, "seed": 4},
                 {"effect": "snow", "on": false, "name": "First snow",
                  "mask": {"image": "valley.png", "factor": 0.8,
                           "rules": [{"of": "height", "low": 600, "edge": 50},
                                     {"of": "slope", "high": 45, "edge": 10},
                                     {"of": "aspect", "low": 0, "edge": 0.5, "direction": 0}]}}]}

A parameter that is missing has its default. Units are those of the operator's declaration (metres, years, degrees). An
image's path is relative to the folder of the stack's file. mask.py explains the rules. A preset may contain the heights
in metres of the land that it was designed for, "heights": [0, 1470]; fitted.py adapts it to other land.
"""

import functools
import hashlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from ..attributes.layers import NAMES as BY_PRODUCTS
from ..errors import TerrainError, named_once, shown
from ..plain_numbers import keep_plain_numbers, plain_number
from ..run.named_file import cause, open_regular, read_named
from .catalogue import HEIGHT_OPERATORS, RENAMED, key_name
from .height_operator import HeightOperator
from .mask import GroundRule, HeightMask

T = TypeVar("T")
VERSION = 1
MAX_BYTES = 1 << 20
EXPECTED = "a JSON file of entries"
MAX_ENTRIES, MAX_RULES = 64, 16
MAX_SEED = 2**31 - 1
MIN_HEIGHT_M, MAX_HEIGHT_M = -12_000, 20_000  # of the land that a stack was designed for
_TOP = ("version", "entries", "heights")
_ENTRY = ("effect", "parameters", "seed", "on", "name", "mask")
_MASK = ("image", "rules", "factor")
_RULE_DEFAULTS = {"low": -math.inf, "high": math.inf, "edge": 0.0, "direction": 0.0}
_RULE = ("of", *_RULE_DEFAULTS)


@dataclass(frozen=True)
class Entry:
    """One height operator of a stack.

    `effect`: the operator's name. `parameters`: values by name; others have their defaults. `seed`: of its noise. `on`:
    whether it is applied. `mask`: None for the whole ground. `name`: label for users.
    """

    effect: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    on: bool = True
    mask: HeightMask | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Convert numbers of other libraries, as NumPy's, to Python's, and an earlier name of the effect to its name.

        So keys and JSON are the same.
        """
        keep_plain_numbers(self, "A stack entry's")
        object.__setattr__(self, "effect", RENAMED.get(self.effect, self.effect))
        if isinstance(self.parameters, Mapping):
            parameters = {n: plain_number(v, float, f"The parameter {n}") for n, v in self.parameters.items()}
            object.__setattr__(self, "parameters", parameters)

    @property
    def declaration(self) -> HeightOperator:
        """Return the declaration of the height operator."""
        return HEIGHT_OPERATORS[self.effect]

    @property
    def values(self) -> dict[str, float]:
        """Return the values of all parameters."""
        return self.declaration.defaults() | dict(self.parameters)


@dataclass(frozen=True)
class Stack:
    """Height operators in the order of their application.

    `heights`: lowest and highest height in metres of the land that the stack was designed for, None for any land.
    """

    entries: tuple[Entry, ...] = ()
    heights: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "A stack's")

    @property
    def active(self) -> tuple[Entry, ...]:
        """Return the entries that are switched on and whose mask is not 0 everywhere."""
        return tuple(e for e in self.entries if e.on and (e.mask is None or e.mask.factor > 0.0))

    @property
    def mask_images(self) -> set[str]:
        """Return the image files of the active entries' masks."""
        return {e.mask.image for e in self.active if e.mask is not None and e.mask.image}

    def check(self, where: str = "The stack") -> None:
        """Raise TerrainError for an invalid entry. where: subject of the error."""
        if len(self.entries) > MAX_ENTRIES:
            raise TerrainError(f"{where} has {len(self.entries)} entries", expected=f"at most {MAX_ENTRIES}")
        for number, entry in enumerate(self.entries, 1):
            _check_entry(_part_of(f"Entry {number}", where), entry)

    def key(self) -> str:
        """Return a hex digest of all that determines the result: images by content, attributes of masks by version."""
        content = []
        for entry in self.active:
            mask = entry.mask
            mask_key = None if mask is None else (replace(mask, image=""), file_identity(mask.image), *mask.versions)
            values = sorted(entry.values.items())
            content.append((key_name(entry.effect), entry.declaration.version, values, entry.seed, mask_key))
        return hashlib.blake2b(repr(content).encode(), digest_size=16).hexdigest()


def land_name(source_key: str, stack: Stack) -> str:
    """Return 16 hexadecimal digits that identify the result of a stack; they name its folder and are in its record.

    source_key: key of the source's store. Numbers pass through JSON first, as on their way to the child process.
    """
    received = stack_from(stack_content(stack))
    return hashlib.blake2b(f"{source_key} {received.key()}".encode(), digest_size=8).hexdigest()


def check_by_products(stack: Stack, source: Iterable[str]) -> None:
    """Raise TerrainError if a mask reads a layer that neither the source nor an earlier operator has.

    Only active entries count. source: names of the source's layers.
    """
    available = set(source)
    for number, entry in enumerate(stack.entries, 1):
        if entry not in stack.active:
            continue
        for rule in entry.mask.rules if entry.mask is not None else ():
            if rule.of in BY_PRODUCTS and rule.of not in available:
                found = ", ".join(name for name in BY_PRODUCTS if name in available) or "none"
                raise TerrainError(
                    f"The mask of entry {number} of the stack, {entry.name or entry.effect}, has a rule about "
                    f"{rule.of}, which is not there",
                    expected=f"a layer of an entry above it ({found})",
                    fix=f"move an entry that writes {rule.of} above it",
                )
        available |= {layer.name for layer in entry.declaration.layers}


def file_identity(image: str) -> tuple:
    """Return a tuple that changes with the content of a file, for keys.

    It is () without a file, and the name alone if the file cannot be read.
    """
    if not image:
        return ()
    try:
        status = os.stat(image)
        digest = _file_digest(os.path.realpath(image), status.st_size, status.st_mtime_ns)
        return Path(image).suffix.lower(), digest  # the suffix decides how it is read
    except (OSError, ValueError):
        return (image,)  # reading it raises the error


@functools.lru_cache(maxsize=256)
def _file_digest(file: str, _size: int, _changed_ns: int) -> str:
    """Return a hex digest of a file. Raises OSError, for a pipe or a device too.

    _size, _changed_ns: the file's, only for the cache.
    """
    with open_regular(file, links=True) as handle:
        return hashlib.file_digest(handle, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def _part_of(part: str, where: str) -> str:
    """Return the subject of an error, "Entry 2 of the stack", for a part ("Entry 2") and its owner ("The stack")."""
    return f"{part} of {where[0].lower()}{where[1:]}"


def _check_entry(where: str, entry: Entry) -> None:
    """Raise TerrainError for an unknown effect, a parameter or seed out of range, or an invalid mask.

    where: subject of the error, as "Entry 2 of the stack".
    """
    name = f"{where}, {entry.effect},"
    if entry.effect not in HEIGHT_OPERATORS:
        effect = shown(repr(entry.effect))
        raise TerrainError(f"{where} has the effect {effect}", expected=f"one of: {', '.join(HEIGHT_OPERATORS)}")
    parameters = {p.name: p for p in entry.declaration.parameters}
    for parameter, value in entry.parameters.items():
        if parameter not in parameters:
            known = f"some of: {', '.join(parameters)}" if parameters else "no parameters"
            raise TerrainError(f"{name} has a parameter {shown(repr(parameter))}", expected=known)
        p = parameters[parameter]
        if not p.min <= value <= p.max:
            expected = f"{p.min:g} to {p.max:g} {p.unit}".rstrip()
            raise TerrainError(f"{name} has {parameter} {value:g}", expected=expected)
    if not 0 <= entry.seed <= MAX_SEED:
        raise TerrainError(f"{name} has the seed {shown(entry.seed)}", expected=f"0 to {MAX_SEED}")
    if entry.mask is not None:
        entry.mask.check(_part_of("The mask", name))


def read_stack(path: str | os.PathLike) -> Stack:
    """Read and check a stack's file. Raises TerrainError, which names the file and the entry."""
    path = Path(path)
    text = read_named(path, "The stack", EXPECTED, MAX_BYTES, links=False)
    try:
        content = json.loads(text.decode("utf-8-sig"), object_pairs_hook=named_once)  # raises for repeated names
    except (ValueError, RecursionError) as reason:
        raise TerrainError(f"The stack {shown(path)} cannot be read ({cause(reason)})", expected=EXPECTED) from None
    return stack_from(content, f"The stack {path}", path.absolute().parent)


def stack_from(content: object, where: str = "The stack", folder: Path | None = None) -> Stack:
    """Return a checked stack from parsed JSON. Raises TerrainError.

    where: subject of errors. folder: base of relative image paths, None if they stay as they are. content: the parsed
    JSON.
    """
    top = _check_object(where, content, _TOP)
    version = top.get("version")
    if version != VERSION or type(version) is not int:
        raise TerrainError(f"{where} has version {shown(repr(version))}", expected=f"{VERSION}")
    entries = _check_list(where, "entries", top.get("entries"), MAX_ENTRIES)
    stack = Stack(
        tuple(
            _parse_entry(_part_of(f"Entry {number}", where), entry, folder) for number, entry in enumerate(entries, 1)
        ),
        _heights(where, top.get("heights")),
    )
    stack.check(where)
    return stack


def _heights(where: str, content: object) -> tuple[float, float] | None:
    """Return the lowest and highest height of the land in metres, None if not given.

    Raises TerrainError unless they are 1 m apart or more, from MIN_HEIGHT_M to MAX_HEIGHT_M. where: subject of the
    error. content: the parsed JSON.
    """
    if content is None:
        return None
    if isinstance(content, list) and len(content) == 2 and all(type(v) in (int, float) for v in content):
        low, high = content
        if MIN_HEIGHT_M <= low <= high - 1 and high <= MAX_HEIGHT_M:
            return float(low), float(high)
    raise TerrainError(
        f"{where} has heights {shown(repr(content))}",
        expected="the land's lowest and highest height in metres, as [0, 1500], at least 1 m apart and within "
        f"{MIN_HEIGHT_M:,} .. {MAX_HEIGHT_M:,}",
    )


def _parse_entry(where: str, content: object, folder: Path | None) -> Entry:
    """Return the entry that parsed JSON describes.

    Raises TerrainError for another type or an unknown name; `Stack.check` has the ranges. where: subject of errors.
    folder: of relative image names, None if they are relative to the working folder.
    """
    entry = _check_object(where, content, _ENTRY)
    parameters = entry.get("parameters", {})
    if not isinstance(parameters, dict):
        raise TerrainError(f"{where} has parameters {shown(repr(parameters))}", expected="an object of numbers")
    mask = entry.get("mask")
    return Entry(
        effect=_read_typed(where, entry, "effect", str, default="", expected="a text"),
        parameters={name: _read_number(where, {name: value}, name, default=None) for name, value in parameters.items()},
        seed=_read_typed(where, entry, "seed", int, default=0, expected="a whole number"),
        on=_read_typed(where, entry, "on", bool, default=True, expected="true or false"),
        name=_read_typed(where, entry, "name", str, default="", expected="a text"),
        mask=None if mask is None else _parse_mask(_part_of("The mask", where), mask, folder),
    )


def _parse_mask(where: str, content: object, folder: Path | None) -> HeightMask:
    """Return the mask that parsed JSON describes.

    Raises TerrainError. where: subject of errors. folder: of relative image names.
    """
    mask = _check_object(where, content, _MASK)
    image = _read_typed(where, mask, "image", str, default="", expected="the name of a file")
    if image and folder is not None:
        image = str(folder / image)
    rules = _check_list(where, "rules", mask.get("rules", []), MAX_RULES)
    return HeightMask(
        image, tuple(_parse_rule(where, rule) for rule in rules), _read_number(where, mask, "factor", 1.0)
    )


def _parse_rule(where: str, content: object) -> GroundRule:
    """Return the rule that parsed JSON describes. Raises TerrainError. where: subject of errors."""
    rule = _check_object(where, content, _RULE)
    numbers = {name: _read_number(where, rule, name, default) for name, default in _RULE_DEFAULTS.items()}
    return GroundRule(_read_typed(where, rule, "of", str, default="", expected="a text"), **numbers)


def _check_object(where: str, content: object, known: tuple[str, ...]) -> dict:
    """Return `content` if it is a JSON object with `known` keys only. Raises TerrainError.

    where: subject of the error.
    """
    if not isinstance(content, dict):
        raise TerrainError(f"{where} is {shown(repr(content))}", expected=f"an object with {', '.join(known)}")
    if unknown := sorted(set(content) - set(known)):
        raise TerrainError(f"{where} has {shown(repr(unknown[0]))}", expected=", ".join(known))
    return content


def _check_list(where: str, name: str, content: object, max_length: int) -> list:
    """Return `content` if it is a list of at most `max_length` items. Raises TerrainError.

    where, name: words in the error for the list's owner and for its items.
    """
    if not isinstance(content, list) or len(content) > max_length:
        found = f"{len(content)} {name}" if isinstance(content, list) else f"{name} {shown(repr(content))}"
        raise TerrainError(f"{where} has {found}", expected=f"a list of at most {max_length}")
    return content


def _read_typed(where: str, content: dict, name: str, kind: type[T], default: T, expected: str) -> T:
    """Return the value `name` of an object, or its default. Raises TerrainError unless it is exactly of a `kind`.

    expected: words for that kind in the error, as "a text". where: subject of the error.
    """
    value = content.get(name, default)
    if type(value) is kind:
        return value
    raise TerrainError(f"{where} has {name} {shown(repr(value))}", expected=expected)


def _read_number(where: str, content: dict, name: str, default: float | None) -> float:
    """Return the number `name` of an object, or its default. Raises TerrainError for text, NaN or more than 1e300.

    where: subject of the error.
    """
    value: Any = content.get(name, default)
    if type(value) not in (int, float) or (name in content and not abs(value) <= 1e300):
        raise TerrainError(f"{where} has {shown(name)} {shown(repr(value))}", expected="a number")
    return float(value)


def stack_content(stack: Stack) -> dict:
    """Return the JSON content that `stack_from` reads."""
    heights = {} if stack.heights is None else {"heights": list(stack.heights)}
    return {"version": VERSION, **heights, "entries": [_entry_content(entry) for entry in stack.entries]}


def _entry_content(entry: Entry) -> dict:
    """Return an entry as JSON content.

    Left out are `on` if it is on, an empty name, a missing mask or image, and limits of rules that equal their
    defaults.
    """
    content = {"effect": entry.effect, "parameters": dict(entry.parameters), "seed": entry.seed}
    content |= {} if entry.on else {"on": False}
    content |= {"name": entry.name} if entry.name else {}
    if entry.mask is not None:
        rules = [
            {"of": rule.of} | {n: getattr(rule, n) for n, v in _RULE_DEFAULTS.items() if getattr(rule, n) != v}
            for rule in entry.mask.rules
        ]
        mask = {"image": entry.mask.image} if entry.mask.image else {}
        content["mask"] = mask | {"rules": rules, "factor": entry.mask.factor}
    return content


def write_stack(stack: Stack, path: str | os.PathLike) -> None:
    """Write a stack's file, with relative paths of images below its folder. Raises TerrainError."""
    from ..run.partial_files import written_beside

    path = Path(path)
    folder = path.absolute().parent
    try:
        with written_beside(path) as partial:
            text = json.dumps(stack_content(_with_relative_images(stack, folder)), indent=1, allow_nan=False)
            partial.write_text(text + "\n", encoding="utf-8")
    except OSError as reason:
        problem = f"The stack {path} cannot be written ({reason.strerror or reason})"
        raise TerrainError(problem, fix="choose another name") from reason


def _with_relative_images(stack: Stack, folder: Path) -> Stack:
    """Return the stack with images of masks in `folder` named relative to it, so that both can be moved together."""

    def make_relative(entry: Entry) -> Entry:
        """Return the entry with its image relative to the folder, unchanged if it lies elsewhere."""
        if entry.mask is None or not entry.mask.image or not Path(entry.mask.image).is_relative_to(folder):
            return entry
        image = Path(entry.mask.image).relative_to(folder).as_posix()
        return replace(entry, mask=replace(entry.mask, image=image))

    return replace(stack, entries=tuple(map(make_relative, stack.entries)))
