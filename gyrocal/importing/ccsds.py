"""CCSDS attitude messages as blocks of entries and lines, in either of their two forms: KVN, and XML.

In KVN a block stands between ``NAME_START`` and ``NAME_STOP`` and holds entries, KEYWORD = value, and lines of numbers. XML has
the same entries as elements; lines are elements ``attLine`` and ``covLine`` of an ACM, and in an AEM every number has an
element of its own. Both are read into the same blocks, and both are written from them (504.0-B-2; 505.0-B-3 for XML).

This reader is our own because no kept library reads the files that people have: ``ccsds-ndm-py`` (beta, one author) refuses
AEM 1.0, the version of most of them.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Literal

from gyrocal.errors import InputError
from gyrocal.files import replacing

Form = Literal["kvn", "xml"]

VERSIONS = {"AEM": ("1.0", "2.0"), "ACM": ("2.0",)}  # the last one is written
ELEMENTS = ("Q1", "Q2", "Q3", "QC")


@dataclass(frozen=True)
class Block:
    """One block of a message.

    Attributes
    ----------
    kind : META, DATA, ATT, COV, AD, …
    entries : keywords and values; of several comments the last
    lines : words of each line, and where it stands, for messages
    """

    kind: str
    entries: dict[str, str] = field(default_factory=dict)
    lines: list[tuple[str, list[str]]] = field(default_factory=list)


def read(path: Path, kind: str) -> tuple[str, list[Block]]:
    """Version and blocks of an AEM or ACM, in the order in which they stand."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"{path}: cannot be read: {fault}") from None
    version, blocks = (_from_xml if text.lstrip().startswith("<") else _from_kvn)(text, kind, path)
    if version not in VERSIONS[kind]:
        raise InputError(f"{path}: {kind} version {version} is not read; read is {' or '.join(VERSIONS[kind])}")
    return version, blocks


def _from_kvn(text: str, kind: str, path: Path) -> tuple[str, list[Block]]:
    lines = text.splitlines()
    first = next((line for line in lines if line.strip()), "")
    key, _, version = (part.strip() for part in first.partition("="))
    if key != f"CCSDS_{kind}_VERS":
        raise InputError(f"{path}: not an {kind}: it begins neither with CCSDS_{kind}_VERS nor as XML")
    blocks: list[Block] = []
    open_blocks: list[Block] = []
    for number, line in enumerate(lines, 1):
        words = line.strip()
        if words.endswith("_START") and " " not in words:
            open_blocks.append(Block(words.removesuffix("_START")))
            blocks.append(open_blocks[-1])
        elif words.endswith("_STOP") and " " not in words:
            if not open_blocks or open_blocks.pop().kind != words.removesuffix("_STOP"):
                raise InputError(f"{path}: line {number}: {words} ends no block")
        elif not words or words.startswith("COMMENT") or not open_blocks:
            continue
        elif "=" in words:
            name, _, value = (part.strip() for part in words.partition("="))
            open_blocks[-1].entries[name] = value
        else:
            open_blocks[-1].lines.append((f"line {number}", words.split()))
    if open_blocks:
        raise InputError(f"{path}: {open_blocks[-1].kind}_START without {open_blocks[-1].kind}_STOP: is the file whole?")
    return version, blocks


def _from_xml(text: str, kind: str, path: Path) -> tuple[str, list[Block]]:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as fault:
        raise InputError(f"{path}: not XML: {fault}") from None
    if _name(root) != kind.lower():
        raise InputError(f"{path}: not an {kind}: its XML begins with <{_name(root)}>")
    blocks = []
    for segment in root.iter():
        if _name(segment) != "segment":
            continue
        for part in segment:
            if _name(part) == "metadata":
                blocks.append(_block("META", part))
                if "QUATERNION_TYPE" in blocks[-1].entries:  # of lines; here the elements have names
                    blocks[-1].entries["QUATERNION_TYPE"] = "LAST"
            elif kind == "AEM":
                states = [state for state in part if _name(state) == "attitudeState"]
                blocks.append(Block("DATA", {}, [_state(k, state) for k, state in enumerate(states, 1)]))
            else:
                blocks += [_block(_name(element).upper(), element) for element in part]
    return root.get("version", "unknown"), blocks


def _name(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def _block(kind: str, element: ET.Element) -> Block:
    block = Block(kind)
    for child in element:
        words = (child.text or "").split()
        if _name(child) == f"{kind.lower()}Line":
            block.lines.append((f"line {len(block.lines) + 1} of <{kind.lower()}>", words))
        elif not len(child) and _name(child) != "COMMENT":
            block.entries[_name(child)] = " ".join(words)
    return block


def _state(number: int, state: ET.Element) -> tuple[str, list[str]]:
    """One attitude of an AEM in XML as the words of a line in KVN; elements are found by their names, whatever their order."""
    found = {_name(one): (one.text or "").strip() for one in state.iter()}
    return f"attitude {number}", [found[name] for name in ("EPOCH", *ELEMENTS) if name in found]


def write(path: str | os.PathLike[str], kind: str, blocks: Sequence[Block], title: str, form: Form) -> None:
    """Write a message; the blocks of an AEM are META and DATA in turn, those of an ACM META and its data."""
    header = {
        "COMMENT": f"written by gyrocal {metadata.version('gyrocal')}: {title}",
        "CREATION_DATE": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S}",
        "ORIGINATOR": "GYROCAL",
    }
    text = {"kvn": _kvn, "xml": _xml}[form](kind, header, blocks)
    with replacing(path) as file:
        file.write(text.encode())


def _kvn(kind: str, header: dict[str, str], blocks: Sequence[Block]) -> str:
    def entries(values: dict[str, str]) -> list[str]:
        one_line = {name: " ".join(value.split()) for name, value in values.items()}
        return [f"COMMENT {value}" if name == "COMMENT" else f"{name} = {value}" for name, value in one_line.items()]

    lines = [f"CCSDS_{kind}_VERS = {VERSIONS[kind][-1]}", *entries(header), ""]
    for block in blocks:
        lines += [f"{block.kind}_START", *entries(block.entries)]
        lines += [*(" ".join(words) for _, words in block.lines), f"{block.kind}_STOP", ""]
    return "\n".join(lines)


def _xml(kind: str, header: dict[str, str], blocks: Sequence[Block]) -> str:
    root = ET.Element(kind.lower(), id=f"CCSDS_{kind}_VERS", version=VERSIONS[kind][-1])

    def grown(parent: ET.Element, name: str, entries: dict[str, str]) -> ET.Element:
        element = ET.SubElement(parent, name)
        for key, value in entries.items():
            ET.SubElement(element, key).text = value
        return element

    grown(root, "header", header)
    body = ET.SubElement(root, "body")
    segment = data = body
    for block in blocks:
        if block.kind == "META":
            segment = ET.SubElement(body, "segment")
            grown(segment, "metadata", block.entries)
            data = ET.SubElement(segment, "data")
        elif block.kind == "DATA":
            for _, words in block.lines:
                state = grown(ET.SubElement(data, "attitudeState"), "quaternionEphemeris", {"EPOCH": words[0]})
                grown(state, "quaternion", dict(zip(ELEMENTS, words[1:], strict=True)))
        else:
            element = grown(data, block.kind.lower(), block.entries)
            for _, words in block.lines:
                ET.SubElement(element, f"{block.kind.lower()}Line").text = " ".join(words)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
