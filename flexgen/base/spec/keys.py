"""Rows for the keys of files: one row is rendered as reader, JSON schema, writer, page and message
of a key.

A `Format` is a table with its `Key` rows in the order in which they are read; `Kinds` are the
tables that a key ``type`` selects. What a row cannot say in data is a function of the table and
its `Context`.
"""

from __future__ import annotations

import inspect
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flexgen.base.checks.type_checks import checks_of
from flexgen.base.checks.types_of_values import Check as TypeCheck
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.ports import identifier_problem
from flexgen.base.spec.tables import IDENTIFIER, LARGEST, Table, closest

Schema = dict[str, Any]
REQUIRED: Any = type("Required", (), {"__repr__": lambda self: "REQUIRED"})()


@dataclass
class Context:
    """Context of a key: values that it can depend on, besides its table."""

    # values of the whole file so far; None: the next table is the whole file
    file: dict[str, Any] | None = None
    values: dict[str, Any] = field(default_factory=dict)  # of this table so far
    # taken, by kind
    names: defaultdict[str, dict[str, Table]] = field(default_factory=lambda: defaultdict(dict))
    before: Sequence[Any] = ()  # earlier entries of the list of which the table is an entry
    last: bool = True  # whether the table is the last entry of its list
    outer: Table | None = None  # that contains the list

    def of_file(self, name: str) -> Any:
        """A value of the whole file."""
        return (self.file or {})[name]


Check = Callable[[Table, Context], None]


@dataclass(frozen=True)
class Type:
    """Type of a key: its reader, its JSON schema without description, and its writer."""

    read: Callable[[Table, Key, Context], Any]
    schema: Schema
    angle: bool = False  # the key ends in _rad or _deg
    write: Callable[[Any], Any] = lambda value: value
    rule: str = ""  # the end of the text of every key of this type
    form: Form | Callable[[], Form] | None = None  # of a table, or of the tables of a list
    many: bool = False  # a list of tables
    most: int = 0  # a table, or a list of at most so many
    plural: bool = False  # the attribute of the objects has an s more than the key


@dataclass(frozen=True)
class Key:
    """A key of a table."""

    name: str  # without _rad and _deg
    type: Type
    doc: str = ""  # what it is; [] is replaced by the unit, which else is put at the end
    unit: str = ""
    # a value, or a function of table and context that gives a value or REQUIRED
    default: Any = REQUIRED
    note: str = ""  # in the message of a wrong value; by default the unit
    check: Check | None = None  # checks the value together with those before it
    attribute: str = ""  # of the object that has the value, where its name is another

    @property
    def names(self) -> tuple[str, ...]:
        """The key as it is in files, with each of its units."""
        return (f"{self.name}_rad", f"{self.name}_deg") if self.type.angle else (self.name,)

    @property
    def field(self) -> str:
        """Attribute of the object that has the value."""
        return self.attribute or (f"{self.name}s" if self.type.plural else self.name)

    @property
    def what(self) -> str:
        """Description of the value in messages: the note of the key, else its unit."""
        return self.note or self.unit

    def read(self, table: Table, here: Context) -> Any:
        """The value in a table; ModelError where it is wrong."""
        value = self.default
        if not any(name in table for name in self.names):
            value = value(table, here) if callable(value) else value
            if value is not REQUIRED:
                return value
        return self.type.read(table, self, here)


@dataclass(frozen=True)
class Format:
    """A table: its keys in the order of reading."""

    doc: str
    keys: tuple[Key, ...]
    make: Callable[..., Any] = dict  # makes an object of the values, which are given by keyword
    take: Callable[[Any], Mapping[str, Any]] = vars  # the values of an object, by attribute
    before: Check | None = None  # checks the table before its keys are read
    where: bool = False  # whether the object gets the position in the file too
    # one of these keys, with those that go with it
    either: Mapping[str, Sequence[str]] = field(default_factory=dict)
    definition: str = ""  # name in the JSON schema of a table that occurs at several places

    def __getitem__(self, name: str) -> Key:
        return next(key for key in self.keys if key.name == name)

    @property
    def names(self) -> tuple[str, ...]:
        """The keys as they are in files."""
        return names_of(self.keys)

    def without(self, *names: str) -> Format:
        """The table without some keys, in its place."""
        return replace(
            self, keys=tuple(key for key in self.keys if key.name not in names), definition=""
        )

    def typed(self, **types: Type) -> Format:
        """The table with other types of some keys."""
        keys = (
            replace(key, type=types[key.name]) if key.name in types else key for key in self.keys
        )
        return replace(self, keys=tuple(keys))

    def optional(self) -> Format:
        """The table with no required key."""
        made = (
            replace(key, default=None) if key.default is REQUIRED else key for key in self.keys
        )
        return replace(self, keys=tuple(made))


@dataclass(frozen=True)
class Kinds:
    """Tables of several kinds, which the key ``type`` selects."""

    doc: str
    kinds: Mapping[str, Format]
    shared: tuple[Key, ...] = ()  # keys of all kinds, read before the type
    default: str = ""  # the kind where there is no key type; empty: it is required
    strict: bool = True  # a key of no kind is refused before the type is read
    foreign: str = ""  # what is expected instead of a key of another kind, with the key for {}
    # the objects have an attribute type; else each kind has a class of its own
    typed: bool = False
    definition: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The keys of all kinds."""
        every = names_of(self.shared) + tuple(
            name for form in self.kinds.values() for name in form.names
        )
        return tuple(dict.fromkeys(("type", *every)))

    def kind_of(self, value: Any) -> str:
        """The kind of an object."""
        if self.typed:
            return str(value.type)
        return next(kind for kind, form in self.kinds.items() if form.make is type(value))


Form = Format | Kinds


def names_of(keys: Sequence[Key]) -> tuple[str, ...]:
    """The keys as they are in files."""
    return tuple(name for key in keys for name in key.names)


def read(table: Table, form: Form, here: Context) -> Any:
    """Read a table: its values as a dict, or what its format makes of them.

    Raises
    ------
    ModelError
        A key is unknown, missing or wrong.
    """
    values: dict[str, Any] = {}
    here = replace(here, values=values, file=values if here.file is None else here.file)
    extra: dict[str, Any] = {}
    if isinstance(form, Kinds):
        kind = _kind(table, form, here)
        extra = {"type": kind} if form.typed else {}
        form = form.kinds[kind]
    else:
        table.only(*form.names)
    if form.before is not None:
        form.before(table, here)
    _read_keys(table, form.keys, here)
    if form.where:
        extra["where"] = table.where()
    fields = {key.name: key.field for key in form.keys}
    try:
        return form.make(
            **{fields.get(name, name): value for name, value in values.items()}, **extra
        )
    except ArgumentError as error:
        raise ArgumentError(f"{table.file}:{table.line}: {error}") from error


def _kind(table: Table, form: Kinds, here: Context) -> str:
    """The kind of a table, by its key ``type``; its shared keys are read. A key of another kind is
    refused with the kinds that have it.
    """
    if form.strict:
        table.only(*form.names)
    _read_keys(table, form.shared, here)
    kind = (
        form.default
        if form.default and "type" not in table
        else table.choice("type", tuple(form.kinds))
    )
    known = ("type", *names_of(form.shared), *form.kinds[kind].names)
    for name in form.names if form.foreign else ():
        if name in table and name not in known:
            raise table.fail(name, form.foreign.format(name))
    for name in table.entries:
        # (all names take time)
        if name not in known and f"{name}_rad" not in known and name in form.names:
            owners = " or ".join(
                f'"{other}"' for other, own in form.kinds.items() if name in own.names
            )
            raise table.fail(
                name, closest(name, known), f'a key of type = {owners}, with type = "{kind}"'
            )
    table.only(*known)
    return kind


def _read_keys(table: Table, keys: Sequence[Key], here: Context) -> None:
    for key in keys:
        here.values[key.name] = key.read(table, here)
        if key.check is not None:
            key.check(table, here)


# --- types of keys -------------------------------------------------------------------------------


def of_class(made: Callable[..., Any], doc: str = "") -> Format:
    """The table whose keys are the parameters of a class, with their types and defaults."""
    rows = []
    for name, known in inspect.signature(made).parameters.items():
        check = checks_of(made).get(name)
        if check is not None:
            default = REQUIRED if known.default is known.empty else known.default
            rows.append(Key(name, _of_check(check), default=default))
    return Format(doc, tuple(rows), made)


def _of_check(check: TypeCheck) -> Type:
    """The type of a key whose values pass the check of an annotation; whole numbers become floats
    where fractions are allowed.
    """
    words = check.words.removesuffix(" or None").replace("True or False", "true or false")

    def read_value(table: Table, key: Key, here: Context) -> Any:
        value = table.plain(key.name, words)
        if not check.passes(value):
            raise table.fail(key.name, words)
        if isinstance(value, int) and not isinstance(value, bool) and check.passes(0.5):
            return float(value)
        return tuple(value) if isinstance(value, list) else value

    return Type(read_value, {"title": words})


def required(doc: str, make: Callable[..., Any] = dict, **types: Type) -> Format:
    """A table of required keys whose names and units say all."""
    return Format(doc, tuple(Key(name, kind) for name, kind in types.items()), make)


def _numbers(
    above: float | None = None, least: float | None = None, most: float = math.inf
) -> Schema:
    """JSON schema of numbers ``> above`` or ``>= least``, and ``<= most``, within the largest size
    of a model file.
    """
    low = (
        {"exclusiveMinimum": above}
        if above is not None
        else {"minimum": -LARGEST if least is None else least}
    )
    return {"type": "number", "maximum": min(most, LARGEST), **low}


def number(
    *, above: float | None = None, least: float | None = None, most: float = math.inf
) -> Type:
    """A number, ``> above`` or ``>= least``, and ``<= most``."""
    return Type(
        lambda table, key, here: table.number(key.name, above=above, least=least, most=most),
        _numbers(above, least, most),
    )


def by_name(of: Callable[[Context], Sequence[str]], least: float | None = None) -> Type:
    """A table with numbers for some of the names of the context."""

    def read_numbers(table: Table, key: Key, here: Context) -> dict[str, float]:
        inner = table.table(key.name)
        if inner is None:
            raise table.fail(key.name, f"a table of numbers: {key.what or key.doc}")
        inner.only(*of(here))
        return {name: inner.number(name, least=least) for name in inner.entries}

    return Type(read_numbers, {"type": "object", "additionalProperties": _numbers(least=least)})


def any_table() -> Type:
    """A table with any keys."""

    def read_any(table: Table, key: Key, here: Context) -> Table:
        found = table.table(key.name)
        if found is None:
            raise table.fail(key.name, "a table")
        return found

    return Type(read_any, {"type": "object"})


def each(*kinds: type, what: str, schema: Schema) -> Type:
    """A list of values of these types, which are checked further later; ``what`` they are."""

    def read_each(table: Table, key: Key, here: Context) -> list[Any]:
        found = table.plain(key.name, f"a list of {what}")
        if not isinstance(found, list) or not all(isinstance(value, kinds) for value in found):
            raise table.fail(key.name, f"a list of {what}")
        return found

    return Type(read_each, list_of(schema))


def among(*numbers: int) -> Type:
    """One of the known whole numbers."""

    def read_known(table: Table, key: Key, here: Context) -> int:
        found = table.number(key.name)
        if found not in numbers:
            raise table.fail(key.name, "one of " + ", ".join(map(str, numbers)))
        return int(found)

    return Type(read_known, {"enum": list(numbers)})


def whole(low: int, high: int) -> Type:
    """A whole number from ``low`` to ``high``."""
    limits = {"type": "integer", "minimum": low, "maximum": high}
    return Type(lambda table, key, here: table.whole(key.name, low, high), limits)


def vector(*lengths: int | range, size: Callable[[Context], int] | None = None) -> Type:
    """A list of numbers of one of these lengths, or of a length that depends on the context."""

    def read_vector(table: Table, key: Key, here: Context) -> tuple[float, ...]:
        return table.vector(key.name, size(here) if size is not None else sizes, what=key.what)

    sizes = [n for length in lengths for n in ([length] if isinstance(length, int) else length)]
    return Type(read_vector, list_of(_numbers(), *lengths))


def list_of(items: Schema, *lengths: int | range) -> Schema:
    """The schema of a list with one of these lengths; without lengths of any."""
    out: Schema = {"type": "array", "items": items}
    if len(lengths) > 1:
        return out | {"anyOf": [{"minItems": n, "maxItems": n} for n in lengths]}
    for n in lengths:
        out |= (
            {"minItems": n[0], "maxItems": n[-1]}
            if isinstance(n, range)
            else {"minItems": n, "maxItems": n}
        )
    return out


def direction() -> Type:
    """A direction in space, normalized."""
    return Type(lambda table, key, here: table.axis(key.name), list_of(_numbers(), 3))


def angle() -> Type:
    """An angle in rad, under a key for each unit."""
    return Type(lambda table, key, here: table.angle(key.name), _numbers(), angle=True)


def text(pattern: str = "") -> Type:
    """A text."""
    return Type(
        lambda table, key, here: table.text(key.name),
        {"type": "string"} | ({"pattern": pattern} if pattern else {}),
    )


def flag() -> Type:
    """True or false."""
    return Type(lambda table, key, here: table.flag(key.name), {"type": "boolean"})


def choice(*words: str, of: Callable[[Context], Sequence[str]] | None = None) -> Type:
    """One of the known words, which may depend on the context."""

    def read_choice(table: Table, key: Key, here: Context) -> str:
        return table.choice(key.name, words if of is None else of(here))

    return Type(read_choice, {"type": "string"} | ({"enum": list(words)} if words else {}))


def known(of: Callable[[Context], Sequence[str]]) -> Type:
    """A text that is one of the words of the context."""

    def read_known(table: Table, key: Key, here: Context) -> str:
        given = table.text(key.name)
        words = of(here)
        if given not in words:
            raise table.fail(key.name, closest(given, words))
        return given

    return Type(read_known, {"type": "string"})


def words(least: int = 1) -> Type:
    """A name or a list of at least so many different names."""
    several = {
        "type": "array",
        "items": {"type": "string"},
        "minItems": least,
        "uniqueItems": True,
    }
    return Type(
        lambda table, key, here: tuple(table.words(key.name, least)),
        {"anyOf": [{"type": "string"}, several]},
    )


def name(kind: str = "", problem_of: Callable[[str], str | None] = identifier_problem) -> Type:
    """An identifier; with a kind one that nothing of this kind has yet."""

    def read_name(table: Table, key: Key, here: Context) -> str:
        taken = here.names[kind]
        found = table.name(key.name, taken, problem_of)
        if kind:
            taken[found] = table
        return found

    rule = ": a letter, then at most 30 letters, digits or underscores"
    return Type(read_name, {"type": "string", "pattern": IDENTIFIER}, rule=rule)


def sub(form: Form | Callable[[], Form]) -> Type:
    """The type of a key whose value is a table, which is read by a form.

    A function in place of the form: for a form that is defined later, or contains itself. A
    missing table is an error.
    """

    def read_sub(table: Table, key: Key, here: Context) -> Any:
        inner = table.table(key.name)
        if inner is None:
            raise table.fail(key.name, f"a table: {key.what or key.doc}")
        return read(inner, form() if callable(form) else form, here)

    return Type(read_sub, {}, form=form)


def one_or_more(form: Form | Callable[[], Form], most: int) -> Type:
    """A table, or a list of up to ``most`` tables: its object, or a tuple of objects where there
    are several.
    """
    one = sub(form)

    def read_tables(table: Table, key: Key, here: Context) -> Any:
        """One table as its object, or a list of them, ``most`` at most, as a tuple; a list of one
        as the object.
        """
        if not isinstance(
            table.plain(key.name, f"a table or a list of tables: {key.what or key.doc}"), list
        ):
            return one.read(table, key, here)
        tables = table.tables(key.name)
        if len(tables) > most:
            raise table.fail(key.name, f"at most {most} tables", f"{len(tables)}")
        found = tuple(read(inner, form() if callable(form) else form, here) for inner in tables)
        return found if len(found) > 1 else found[0]

    return Type(read_tables, {}, form=form, most=most)


def listed(
    form: Form | Callable[[], Form], least: int = 1, most: int = 0, plural: bool = True
) -> Type:
    """Type of a key that holds a list of tables of one form, such as ``[[motor]]``.

    It reads them as a tuple of objects, in the order of the file.

    Parameters
    ----------
    form : Form, or a function that gives it
        Keys of each table.
    least : int
        1: an empty or missing list is an error; 0: it is read as an empty tuple. The reader
        checks no larger number.
    most : int
        Largest number of tables; 0: no limit.
    plural : bool
        Whether the attribute of the Python object is the plural of the key: the key ``motor``
        becomes the attribute ``motors``.
    """

    def read_list(table: Table, key: Key, here: Context) -> tuple[Any, ...]:
        """The objects of a list of tables; rules of an entry see the ones before it, and whether
        it is the last.
        """
        tables = table.tables(key.name, required=least > 0)
        if most and len(tables) > most:
            raise table.fail(key.name, f"at most {most} {key.what}", f"{len(tables)}")
        objects: list[Any] = []
        for k, inner in enumerate(tables):
            # rules of an entry may depend on the earlier ones, and on whether it is the last one
            is_last = k + 1 == len(tables)
            context = replace(here, before=objects, last=is_last, outer=table)
            objects.append(read(inner, form() if callable(form) else form, context))
        return tuple(objects)

    limits = {"minItems": least} | ({"maxItems": most} if most else {})
    return Type(read_list, {"type": "array", **limits}, form=form, many=True, plural=plural)
