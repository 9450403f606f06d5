"""A data set described in the standards that tools read. What the tables are, and all words, stand in `tables.yaml`.

Frictionless Data Package (`datapackage.json`, the CSV tables), Psych-DS (`dataset_description.json`), Croissant
(`croissant.json`, the Parquet tables), Citation File Format (`CITATION.cff`) and the licence.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import yaml

from desirepath.analysis.scales import frozen_scale
from desirepath.grammar.questionnaires import frozen_questionnaire
from desirepath.store.dataset.columns import FLOATS, MOMENT, NUMBER, TEXT, WHOLE, YES_NO, Column, Table
from desirepath.store.dataset.tables import TABLES

Json = dict[str, Any]
DATA_PACKAGE, PSYCH_DS, CROISSANT = "datapackage.json", "dataset_description.json", "croissant.json"
CITATION, LICENCE = "CITATION.cff", "LICENSE.txt"
_DICTIONARY_HEAD = Path(__file__).with_name("data-dictionary-head.md")
NOT_STATED = "not stated in the protocol: ask the study's experimenter before you use or share these data"


@dataclass(frozen=True)
class Licence:
    """spdx: identifier in the SPDX list."""

    spdx: str
    title: str
    url: str


_CC, _ODC = "https://creativecommons.org", "https://opendatacommons.org/licenses"
LICENCES = {
    licence.spdx.upper(): licence
    for licence in (
        Licence("CC-BY-4.0", "Creative Commons Attribution 4.0 International", f"{_CC}/licenses/by/4.0/"),
        Licence("CC-BY-SA-4.0", "Creative Commons Attribution Share Alike 4.0", f"{_CC}/licenses/by-sa/4.0/"),
        Licence("CC-BY-NC-4.0", "Creative Commons Attribution Non Commercial 4.0", f"{_CC}/licenses/by-nc/4.0/"),
        Licence("CC-BY-ND-4.0", "Creative Commons Attribution No Derivatives 4.0", f"{_CC}/licenses/by-nd/4.0/"),
        Licence("CC0-1.0", "Creative Commons Zero 1.0 Universal", f"{_CC}/publicdomain/zero/1.0/"),
        Licence("ODbL-1.0", "Open Data Commons Open Database License 1.0", f"{_ODC}/odbl/1-0/"),
        Licence("PDDL-1.0", "Open Data Commons Public Domain Dedication 1.0", f"{_ODC}/pddl/1-0/"),
    )
}


def find_licence(licence: str | None) -> Licence | None:
    """The one that a protocol names, however it writes it; None: not stated, or none of these."""
    return LICENCES.get("-".join((licence or "").upper().split()))


@dataclass(frozen=True)
class About:
    """What the descriptions say of a study. created_at: ISO time. licence: as the protocol has it, None: not stated."""

    study: str
    name: str
    protocol: str
    created_at: str
    licence: str | None
    citation: str

    @property
    def known_licence(self) -> Licence | None:
        return find_licence(self.licence)

    @property
    def description(self) -> str:
        return (
            f"Answers, sessions and robot trajectories of the study {self.name!r} (protocol {self.protocol}), "
            "collected with Desire Path. Every column is explained in data-dictionary.md."
        )


def write_descriptions(out: Path, about: About, tables: Iterable[Table]) -> None:
    """Write all of them into the data set's folder, where its tables lie already."""
    tables = tuple(tables)
    _write_json(out / DATA_PACKAGE, data_package(out, about, tables))
    _write_json(out / PSYCH_DS, psych_ds(about, tables))
    _write_json(out / CROISSANT, croissant(out, about, tables))
    (out / CITATION).write_text(citation(about), encoding="utf-8", newline="")
    (out / LICENCE).write_text(licence_text(about), encoding="utf-8", newline="")


# ---- Frictionless ----------------------------------------------------------------------------------------------------

_FRICTIONLESS: Mapping[pa.DataType, str] = {
    TEXT: "string",
    WHOLE: "integer",
    NUMBER: "number",
    YES_NO: "boolean",
    MOMENT: "datetime",
}


def data_package(out: Path, about: About, tables: Iterable[Table]) -> Json:
    """Data Package v1: every CSV table with types, keys and what refers to what; hash and size of the file."""
    package: Json = {
        "profile": "data-package",
        "name": f"study-{about.study}",
        "title": about.name,
        "description": about.description,
        "created": about.created_at,
        "resources": [_resource(out, table) for table in tables if table.csv],
    }
    if about.known_licence is not None:
        known = about.known_licence
        package["licenses"] = [{"name": known.spdx, "title": known.title, "path": known.url}]
    return package


def _resource(out: Path, table: Table) -> Json:
    content = (out / f"{table.name}.csv").read_bytes()
    schema: Json = {"fields": [_field(table, column) for column in table.columns], "missingValues": [""]}
    if table.key:
        schema["primaryKey"] = list(table.key)
    if table.refers:
        schema["foreignKeys"] = [
            {"fields": [column], "reference": {"resource": other, "fields": [key]}}
            for column, other, key in table.refers
        ]
    return {
        "profile": "tabular-data-resource",
        "name": table.name,
        "path": f"{table.name}.csv",
        "description": f"One row per {table.row}.",
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "dialect": {"delimiter": ",", "lineTerminator": "\n", "quoteChar": '"', "doubleQuote": True, "header": True},
        "bytes": len(content),
        "hash": f"sha256:{hashlib.sha256(content).hexdigest()}",
        "schema": schema,
    }


def _field(table: Table, column: Column) -> Json:
    field: Json = {
        "name": column.name,
        "type": "object" if column.json else _FRICTIONLESS[column.type],
        "description": column.meaning,
    }
    if column.name in table.key:
        field["constraints"] = {"required": True}
    return field


# ---- Psych-DS --------------------------------------------------------------------------------------------------------


def psych_ds(about: About, tables: Iterable[Table]) -> Json:
    """The metadata file of Psych-DS (schema.org JSON-LD) with every variable. Its rule for folders and names of data
    files is not followed: tables keep the names under which they always were."""
    variables: dict[str, Json] = {}
    for table in tables:
        for column in table.columns:
            known = variables.setdefault(
                column.name,
                {"@type": "PropertyValue", "name": column.name, "description": column.meaning, "tables": []},
            )
            known["tables"].append(table.name)
    measured = [
        {
            **{k: v for k, v in variable.items() if k != "tables"},
            "measurementTechnique": f"in {', '.join(variable['tables'])}",
        }
        for variable in variables.values()
    ]
    return {"@context": "https://schema.org/", "@type": "Dataset", **_schema_org(about), "variableMeasured": measured}


def _schema_org(about: About) -> Json:
    return {
        "name": about.name,
        "description": about.description,
        "identifier": about.study,
        "dateCreated": about.created_at,
        "license": about.known_licence.url if about.known_licence else about.licence or NOT_STATED,
    }


# ---- Croissant -------------------------------------------------------------------------------------------------------

_CROISSANT: Mapping[pa.DataType, str] = {
    TEXT: "sc:Text",
    WHOLE: "sc:Integer",
    NUMBER: "sc:Float",
    YES_NO: "sc:Boolean",
    MOMENT: "sc:DateTime",
    FLOATS: "sc:Float",
}
_CONTEXT: Json = json.loads(Path(__file__).with_name("croissant_context.json").read_text(encoding="utf-8"))


def croissant(out: Path, about: About, tables: Iterable[Table]) -> Json:
    """Croissant 1.0: every Parquet file with its hash, every table as a record set."""
    tables = tuple(tables)
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        **_schema_org(about),
        "citeAs": about.citation,
        "datePublished": about.created_at[:10],
        "version": "1.0.0",
        "distribution": [_file_object(out / f"{table.name}.parquet") for table in tables],
        "recordSet": [_record_set(table) for table in tables],
    }


def _file_object(path: Path) -> Json:
    return {
        "@type": "cr:FileObject",
        "@id": path.name,
        "name": path.name,
        "contentUrl": path.name,
        "encodingFormat": "application/x-parquet",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _record_set(table: Table) -> Json:
    fields = []
    for column in table.columns:
        field: Json = {
            "@type": "cr:Field",
            "@id": f"{table.name}/{column.name}",
            "name": f"{table.name}/{column.name}",
            "description": column.meaning,
            "dataType": _CROISSANT[column.type],
            "source": {"fileObject": {"@id": f"{table.name}.parquet"}, "extract": {"column": column.name}},
        }
        fields.append(field | ({"repeated": True} if column.type == FLOATS else {}))
    return {
        "@type": "cr:RecordSet",
        "@id": table.name,
        "name": table.name,
        "description": f"One row per {table.row}.",
        "key": [{"@id": f"{table.name}/{name}"} for name in table.key],
        "field": fields,
    }


# ---- for people ---------------------------------------------------------------------------------------------------


def data_dictionary() -> str:
    """The data dictionary in Markdown, as it lies in every data set and in docs/."""
    lines = _DICTIONARY_HEAD.read_text(encoding="utf-8").splitlines()
    for table in TABLES:
        endings = "`.csv`, `.parquet`" if table.csv else "`.parquet` only"
        lines += ["", f"## {table.name}", "", f"One row per {table.row}. {endings}", "", "| column | type | meaning |"]
        lines += ["|---|---|---|"]
        lines += [f"| `{c.name}` | {c.type_name()} | {c.meaning} |" for c in table.columns]
    return "\n".join(lines) + "\n"


def instruments_asked(files: Mapping[str, str]) -> str:
    """Of a study's files: every instrument and validated scale it asks, with items, scoring, source and terms, as the
    last part of its data dictionary; "" where it asks none."""
    lines: list[str] = []
    for name, content in files.items():
        if not name.startswith("questionnaires/"):
            continue
        asked = frozen_questionnaire(name, content)
        scales = [frozen_scale(files[f"scales/{block.scale}.json"]) for block in asked.blocks if block.scale]
        head = asked.instrument
        known = ", ".join(head.names if head else [scale.names[-1] for scale in scales])
        if not known:
            continue
        lines += ["", f"### {known} (`{name.removeprefix('questionnaires/').removesuffix('.yaml')}`)", ""]
        for scored in (part for scale in scales for part in scale.scored):
            keys = ", ".join(f"`{item.key}`{' (reversed)' if item.reversed else ''}" for item in scored.items)
            lines.append(f"- {scored.names[-1]}, {scored.lowest:g} to {scored.highest:g}: {keys}; {scored.scoring}")
        told = [(head.source, head.licence)] if head else [(scale.source, scale.licence) for scale in scales]
        for source, licence in dict.fromkeys(told):
            lines += [f"- Source: {source}", f"- Terms of its words: {licence}"]
        if head:
            lines += [f"- Words in {language}: {said}" for language, said in head.translations.items()]
    first = (
        "Stored as answered, from 1; scores are in the report's `scales.csv`. Who reuses an instrument minds its terms."
    )
    return "\n".join(["", "## Instruments of this study", "", first, *lines, ""]) if lines else ""


# ---- citation and licence --------------------------------------------------------------------------------------------


def citation(about: About) -> str:
    """CITATION.cff 1.2.0. A study names no authors, so they are the ones whom its citation names."""
    cited: Json = {
        "cff-version": "1.2.0",
        "type": "dataset",
        "title": about.name,
        "message": f"If you use these data, please cite: {about.citation}",
        "authors": [{"name": "The experimenters of the study, see message"}],
        "date-released": about.created_at[:10],
    }
    if about.known_licence is not None:
        cited["license"] = about.known_licence.spdx
    return str(yaml.safe_dump(cited, sort_keys=False, allow_unicode=True, width=120))


def licence_text(about: About) -> str:
    """What may be done with the data, in words and by its address."""
    known = about.known_licence
    if known is not None:
        return f"{known.title} ({known.spdx})\n{known.url}\n"
    return f"{about.licence or NOT_STATED}\n"


def _write_json(path: Path, data: Json) -> None:
    path.write_text(json.dumps(data, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", newline="")
