"""Ways to damage an input: as bytes, as words of a text, and as a tree of values."""

from __future__ import annotations

import copy
import random
import struct
from typing import Any

ODD_INTEGERS = (0, 1, -1, 2, 255, 65_535, 1 << 20, 1 << 31, (1 << 32) - 1, (1 << 63) - 1, 1 << 63)
ODD_FLOATS = (
    *(0.0, -0.0, -1.0, 1e-300, 5e-324, 1e15, 1e38, 1e39, 1e308, -1e308),
    *(float("nan"), float("inf"), float("-inf")),
)
ODD_TEXTS = (
    *("", " ", ".", "..", "../../x", "..\\..\\x", "/etc/passwd", "C:\\x", "C:x", "\\\\host\\x"),
    *("NUL", "con.json", "a\0b", "a\nb", "a\rb", "a/b", "ä" * 300, "x" * 5000, "\ud800", "\udcff"),
    *("²", "٣", "9" * 5000, "name.", "-", "--help", "%s{0}", "$(touch x)", "`touch x`", "\u202e"),
)
ODD_VALUES = (
    *ODD_INTEGERS,
    *ODD_FLOATS,
    *ODD_TEXTS,
    None,
    True,
    False,
    [],
    {},
    [[]],
    [{}],
    10**400,
)
ODD_WORDS = ("nan", "inf", "-inf", "1e999", "0", "-1", "9" * 30, "9" * 5000, "x", "²", "0x1", "1_0")


def bytes_damaged(dice: random.Random, data: bytes, most: int = 3) -> bytes:
    """The bytes after one to `most` cuts, flips, insertions or numbers out of place."""
    bad = bytearray(data)
    for _ in range(dice.randint(1, most)):
        at = dice.randrange(len(bad) + 1)
        match dice.randrange(9):
            case 0:
                del bad[at:]
            case 1 if bad:
                bad[at % len(bad)] ^= 1 << dice.randrange(8)
            case 2:
                bad[at : at + 8] = struct.pack("<Q", dice.choice(ODD_INTEGERS) % (1 << 64))
            case 3:
                bad[at : at + 8] = struct.pack("<d", dice.choice(ODD_FLOATS))
            case 4:
                bad[at : at + 4] = struct.pack(">I", dice.choice(ODD_INTEGERS) % (1 << 32))
            case 5:
                del bad[at : at + dice.randint(1, 64)]
            case 6:
                bad[at:at] = bad[: dice.randint(1, 64)]
            case 7:
                bad[at:at] = dice.randbytes(dice.randint(1, 16))
            case _:
                count = dice.randint(1, 32)
                bad[at : at + count] = bytes([dice.choice((0, 10, 255))]) * count
    return bytes(bad)


def words_damaged(dice: random.Random, text: str) -> str:
    """The text after one to three words or lines were changed, moved or lost."""
    lines = text.split("\n")
    for _ in range(dice.randint(1, 3)):
        at = dice.randrange(len(lines))
        words = lines[at].split(" ")
        word = dice.randrange(len(words))
        match dice.randrange(6):
            case 0:
                words[word] = dice.choice(ODD_WORDS)
            case 1:
                del words[word]
            case 2:
                words.insert(word, dice.choice(ODD_WORDS))
            case 3:
                words = []
            case 4:
                words = [*words, "\n", *words]
            case _:
                words = words[:word]
        lines[at] = " ".join(words)
    return "\n".join(lines)


def tree_damaged(dice: random.Random, tree: Any, *, same_type: bool = False, most: int = 3) -> Any:
    """A copy of nested lists and dicts after one to `most` values were replaced, lost or doubled.

    `same_type`: numbers stay numbers and texts texts, for files that can hold nothing else.
    """
    tree = copy.deepcopy(tree)
    for _ in range(dice.randint(1, most)):
        places = list(_places(tree))
        if not places:
            return tree
        home, key = dice.choice(places)
        value = home[key]
        if isinstance(home, list) and dice.random() < 0.3:
            match dice.randrange(3):
                case 0 if not (same_type and isinstance(value, (int, float))):
                    del home[key]
                case 1 if not (same_type and isinstance(value, (int, float))):
                    home.insert(key, copy.deepcopy(value))
                case _:
                    other = dice.randrange(len(home))
                    home[key], home[other] = home[other], home[key]
        elif isinstance(home, dict) and dice.random() < 0.2:
            del home[key]
        elif not same_type:
            home[key] = copy.deepcopy(dice.choice(ODD_VALUES))
        elif isinstance(value, float):
            home[key] = dice.choice(ODD_FLOATS)
        elif isinstance(value, int):
            home[key] = dice.choice((*ODD_INTEGERS, value + 1, value - 1))
        elif isinstance(value, str):
            home[key] = dice.choice(ODD_TEXTS)
    return tree


def _places(tree: Any) -> Any:
    """Every (container, key) below `tree`."""
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in list(keys):
        yield tree, key
        yield from _places(tree[key])
