"""Store data classes in files and read them back by their types alone, without running anything.

A file is an NPZ of all arrays and of a JSON tree of all other values, in which texts name
arrays. Annotations tell how to read a tree: data classes, tuples, mappings by text, arrays,
numbers, texts, booleans, each of these or None, JSON. For an annotation with derived data
classes the tree names the class.
"""

from __future__ import annotations

import json
import operator
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labkit.storage import npz
from labkit.storage.npz import Arrays
from labkit.types import JSON

TREE = "tree"

KINDS: dict[type, str] = {
    np.floating: "f",
    np.signedinteger: "i",
    np.unsignedinteger: "u",
}
"""Of numbers of any size."""

FIELDS = "__dataclass_fields__"
"""Key that marks a data class."""

PLAIN: dict[type, Callable[[Any], JSON]] = {
    float: float,
    int: operator.index,
    bool: bool,
    str: str,
}
"""JSON's types, and conversions from NumPy's types to Python's."""


def dump(value: object, kind: Any) -> bytes:
    """Return the file of a value.

    Parameters
    ----------
    kind : the value's type, as an annotation states it

    Raises
    ------
    TypeError
        The value is of another type, or the type cannot be stored.
    """
    arrays: Arrays = {}
    tree = json.dumps(taken_apart(value, kind, arrays)).encode()
    arrays[TREE] = np.frombuffer(tree, np.uint8)
    return npz.packed(arrays, compressed=False)


def load(content: bytes, kind: Any) -> Any:
    """Return the value in a file. Raises ValueError for a file damaged, or of another type."""
    arrays = npz.unpacked(content, lambda _: len(content))  # nothing is compressed
    try:
        return put_together(json.loads(arrays.pop(TREE).tobytes()), kind, arrays)
    except (LookupError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"it holds no {kind}: {error}") from error


def taken_apart(value: Any, kind: Any, arrays: Arrays) -> JSON:
    """Return a value as JSON, and add its arrays to `arrays`. Raises TypeError."""
    if _is_json(kind):
        return typing.cast("JSON", value)
    kind, may_lack = _without_none(kind)
    origin = typing.get_origin(kind) or kind
    inner = typing.get_args(kind)
    if value is None and may_lack:
        return None
    if origin is typing.Literal:
        return str(value)
    if origin is np.ndarray:
        name = str(len(arrays))
        arrays[name] = _array(value, inner)
        return name
    if origin is tuple:
        each = zip(value, _of_each(inner, len(value)), strict=True)
        return [taken_apart(one, of, arrays) for one, of in each]
    if origin in (dict, Mapping):
        return {key: taken_apart(one, inner[1], arrays) for key, one in value.items()}
    if origin in PLAIN:
        return PLAIN[origin](value)
    found = _named(type(value).__name__, origin)
    if not isinstance(value, found):
        raise TypeError(f"{type(value)} is another class than {found}")
    held = {
        name: taken_apart(getattr(value, name), of, arrays) for name, of in _fields(found)
    }
    return [found.__name__, held]


def put_together(tree: Any, kind: Any, arrays: Arrays) -> Any:
    """Return the value of a type that JSON and arrays stand for. Raises LookupError, TypeError, ValueError."""
    if _is_json(kind):
        return tree
    kind, may_lack = _without_none(kind)
    origin = typing.get_origin(kind) or kind
    inner = typing.get_args(kind)
    if tree is None and may_lack:
        return None
    if origin is typing.Literal:
        return inner[inner.index(tree)]
    if origin is np.ndarray:
        return _array(arrays[_checked(tree, str)], inner)
    if origin is tuple:
        each = zip(_checked(tree, list), _of_each(inner, len(tree)), strict=True)
        return tuple(put_together(one, of, arrays) for one, of in each)
    if origin in (dict, Mapping):
        entries = _checked(tree, dict).items()
        return {key: put_together(one, inner[1], arrays) for key, one in entries}
    if origin in PLAIN:
        return _checked(tree, origin)
    name, held = _checked(tree, list)
    found = _named(name, origin)
    return found(
        **{field: put_together(held[field], of, arrays) for field, of in _fields(found)}
    )


def _is_json(kind: Any) -> bool:
    """Return whether a type is `JSON`, in which annotations are nested to any depth."""
    return {*PLAIN, NoneType} < set(typing.get_args(kind))


def _without_none(kind: Any) -> tuple[Any, bool]:
    """Return a type, of X or None the X; and whether None is allowed. Raises TypeError for any other union."""
    if typing.get_origin(kind) not in (typing.Union, UnionType):
        return kind, False
    others = [one for one in typing.get_args(kind) if one is not NoneType]
    if len(others) != 1:
        raise TypeError(f"{kind}: allowed is one type, or None")
    return others[0], True


def _of_each(inner: tuple[Any, ...], count: int) -> tuple[Any, ...]:
    """Return the types of a tuple's members. inner: the tuple's arguments."""
    return inner[:1] * count if inner[1:] == (Ellipsis,) else inner


def _array(value: Any, inner: Sequence[Any]) -> NDArray[Any]:
    """Return an array if its numbers are of an allowed kind. Raises TypeError otherwise."""
    (allowed,) = typing.get_args(inner[1])
    kind = KINDS.get(allowed) or np.dtype(allowed).kind
    if not isinstance(value, np.ndarray) or value.dtype.kind != kind:
        raise TypeError(f"an array of {allowed.__name__} is needed, not {type(value)}")
    return value


def _checked(tree: Any, kind: type) -> Any:
    """Return a JSON value if it is of a type. Raises TypeError otherwise."""
    if kind is float and type(tree) is int:
        return float(tree)
    if type(tree) is not kind:
        raise TypeError(f"a {kind.__name__} is needed, not {type(tree).__name__}")
    return tree


def _named(name: object, base: Any) -> Any:
    """Return the data class of a name, `base` or derived from it. Raises TypeError."""
    # of a class with slots Python has two of one name: the later one is in use
    known = {one.__name__: one for one in _family(base) if hasattr(one, FIELDS)}
    if not isinstance(name, str) or name not in known:
        raise TypeError(f"{name!r} is no data class of {base}")
    return known[name]


def _family(base: Any) -> Iterator[Any]:
    if not isinstance(base, type):
        raise TypeError(f"{base} is no type that a file can hold")
    yield base
    derived: type
    for derived in base.__subclasses__():
        yield from _family(derived)


@cache
def _fields(data_class: type) -> tuple[tuple[str, Any], ...]:
    """Return the names and types of a data class's arguments."""
    hints = typing.get_type_hints(data_class)
    return tuple((one.name, hints[one.name]) for one in fields(data_class) if one.init)
