"""What the strict YAML reader reads, refuses, and how it tells the place."""

import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from simulator.config.yaml import Mark, YamlError, parse_yaml, read_yaml
from simulator.errors import InputError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("1.5e-3", 0.0015),
        ("-2E+1", -20.0),
        (".5", 0.5),
        ("1.", 1.0),
        (".inf", math.inf),
        ("-.inf", -math.inf),
        ("10", 10),
        ("-7", -7),
        ("0", 0),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        # The rest is text here, though PyYAML's own loader takes it for booleans, times, base 60 or 16.
        ("on", "on"),
        ("no", "no"),
        ("2026-11-21", "2026-11-21"),
        ("1:30", "1:30"),
        ("0x10", "0x10"),
        ("1_000", "1_000"),
        ("inf", "inf"),
        ("Größe 日本 😀", "Größe 日本 😀"),
        ('"\\ud83d\\ude00"', "😀"),
        ("'1e3'", "1e3"),
        ('"010"', "010"),
    ],
)
def test_scalars(text: str, value: object) -> None:
    data = parse_yaml(f"key: {text}", "f").data
    assert data == {"key": value}
    assert type(data["key"]) is type(value)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("a: 1\nb: 2\na: 3", "3:1", ["a:", "line 1"]),
        ("a: {b: 1, b: 1}", "1:11", ["b:"]),
        ("a: 1\nb: &x 2", "2:4", ["anchor &x"]),
        ("a: 1\nb: *x", "2:4", ["alias *x"]),
        ("a: !!str 1", "1:4", ["tag !!str"]),
        ("a: !!python/object/apply:os.getcwd []", "1:4", ["tag !!python/object/apply:os.getcwd"]),
        ("a: ! 1", "1:4", ["tag !"]),
        ("a: 010", "1:4", ["leading zero", "write 10, or '010'"]),
        ("a: -007", "1:4", ["leading zero", "write 7"]),
        ("a: .nan", "1:4", ["not a number"]),
        ("a: 1e999", "1:4", ["too large", ".inf"]),
        ("a: " + "9" * 5000, "1:4", ["5000 digits"]),
        ("1: a", "1:1", ["a key must be a word", "'1'"]),
        ("~: a", "1:1", ["a key must be a word"]),
        ("? [a]\n: 1", "1:3", ["a key must be a word"]),
        ("", "1:1", ["empty", "flatlight init"]),
        ("# only a comment\n", "1:1", ["empty"]),
        ("a: 1\n---\nb: 1", "2:1", ["second document"]),
        ("a:\n\tb: 1", "2:1", ["tab", "spaces"]),
        ("a: [1, 2", "1:9", ["not valid YAML", "flow sequence"]),
        ("a: b: c", "1:5", ["not valid YAML", "mapping values"]),
        ("a: 1\nb: \x07", "2:4", ["U+0007"]),
        ('a: "\\0"', "1:4", ["NUL"]),
        ('a: "\\ud800"', "1:4", ["unpaired surrogate"]),
        ("a: " + "[" * 20 + "]" * 20, "1:23", ["nested more than 20"]),
        ("[" * 100_000, "1:21", ["nested more than 20"]),
    ],
)
def test_refused_texts(text: str, place: str, words: list[str]) -> None:
    with pytest.raises(YamlError) as caught:
        parse_yaml(text, "f.yaml")
    message = str(caught.value)
    assert message.startswith(f"f.yaml:{place}: ")
    assert all(word in message for word in words), message
    assert "\n" not in message


def test_twenty_levels_are_read() -> None:
    data = parse_yaml("[" * 20 + "]" * 20, "f").data
    for _ in range(19):
        (data,) = data
    assert data == []


def test_every_fault_is_listed_in_the_order_of_the_text() -> None:
    with pytest.raises(YamlError) as caught:
        parse_yaml("a: 010\nb: &x 1\na: .nan\nc: .nan", "f")
    assert [mark for mark, _ in caught.value.problems] == [Mark(1, 4), Mark(2, 4), Mark(3, 1), Mark(4, 4)]


def test_places_of_keys_and_values() -> None:
    document = parse_yaml("a: 1\nb:\n  c: [10, {d: x}]\n", "f")
    assert document.keys[("b",)] == Mark(2, 1)
    assert document.keys[("b", "c")] == Mark(3, 3)
    assert document.values[("b", "c")] == Mark(3, 6)
    assert document.values[("b", "c", 0)] == Mark(3, 7)
    assert document.keys[("b", "c", 1, "d")] == Mark(3, 12)
    assert document.values[("b", "c", 1, "d")] == Mark(3, 15)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"a: 1\nb: caf\xe9\n", ["f.yaml:2:7", "UTF-8", "0xe9"]),
        ("a: 1".encode("utf-16"), ["f.yaml:1:1", "UTF-8"]),
        (b"a: " + b"x" * (1 << 20), ["larger than 1 MiB"]),
    ],
)
def test_refused_files(tmp_path: Path, raw: bytes, words: list[str]) -> None:
    path = tmp_path / "f.yaml"
    path.write_bytes(raw)
    with pytest.raises(InputError) as caught:
        read_yaml(path, "f.yaml")
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_file_of_exactly_one_mib_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "f.yaml"
    start = b"\xef\xbb\xbfa: 1\n#"
    path.write_bytes(start + b"x" * ((1 << 20) - len(start)))
    assert read_yaml(path, "f.yaml").data == {"a": 1}


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^none\.yaml: "):
        read_yaml(tmp_path / "none.yaml", "none.yaml")
    with pytest.raises(InputError, match=r"^folder: "):
        read_yaml(tmp_path, "folder")


def _read_alike(word: str) -> bool:
    """Leave out what PyYAML (YAML 1.1) writes bare as text but YAML 1.2 reads as a number, such as 0E0 and 1.0e5."""
    try:
        float(word)
    except ValueError:
        return True
    return not word.isprintable() or not isinstance(yaml.safe_load(word), str)  # PyYAML quotes what is not printable


letters = st.characters(codec="utf-8", exclude_characters="\0", exclude_categories=["Cs"])
words = st.text(letters, max_size=12).filter(_read_alike)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**30), 10**30) | st.floats(allow_nan=False) | words,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words, inner, max_size=4),
    max_leaves=20,
)


@given(plain, st.booleans())
def test_agrees_with_pyyaml_on_plain_data(data: object, flow: bool) -> None:
    """PyYAML writes what only its own rules would misread (``on``, ``010``) in quotes, so both must read the same."""
    text = yaml.safe_dump(data, default_flow_style=flow, sort_keys=False)
    if "&id" in text:
        return  # an object that stands twice is written as an alias
    ours = parse_yaml(text, "f").data
    assert ours == yaml.safe_load(text) == data
    assert repr(ours) == repr(data)  # 1 and 1.0 and True are equal, but not the same
