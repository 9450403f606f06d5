"""A study as a folder to deposit at Zenodo, OSF or elsewhere: data, report, preregistration, licence, metadata.

What the data set holds is `store/dataset/writing.py`'s: here always what may be published. Nothing is sent anywhere.
"""

from __future__ import annotations

import json
import re
import shutil
import uuid
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sqlalchemy import func, select

from desirepath.report.findings import NothingToReport, Who
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_folder
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.descriptions import CITATION, LICENCE, NOT_STATED, find_licence
from desirepath.store.dataset.writing import ExportError, export_study, write_checksums
from desirepath.store.models import Response, Study, utc_now
from desirepath.store.models import Session as SessionRow
from desirepath.study.preregistration import preregistration
from desirepath.study.protocol.freezing import thaw

DATA, REPORT, README, PREREGISTRATION = "data", "report", "README.md", "preregistration.md"
ZENODO, DATACITE = ".zenodo.json", "datacite.json"
LONGEST_AUTHOR, MOST_AUTHORS = 200, 50
_ORCID = re.compile(r"[0-9]{4}-[0-9]{4}-[0-9]{4}-[0-9]{3}[0-9X]")
SIMULATED = "All answers were given by simulated participants: programs, no people."
PARTLY = "Some participants are simulated: programs, no people; the column `simulated` of participants.csv marks them."


@dataclass(frozen=True)
class Author:
    """Who made the study. name: as catalogues want it, family name first."""

    name: str
    affiliation: str = ""
    orcid: str = ""

    @classmethod
    def read(cls, written: str) -> Author:
        """`Family, Given; affiliation; ORCID`, the last two optional. ValueError says what is wrong."""
        parts = [part.strip() for part in written.split(";")]
        if not parts[0] or len(parts) > 3 or len(written) > LONGEST_AUTHOR or not written.isprintable():
            raise ValueError(
                f"author = {written[:80]!r}: write 'Family, Given; affiliation; ORCID', the last two if you like, at "
                f"most {LONGEST_AUTHOR} characters"
            )
        name, affiliation, orcid = [*parts, "", ""][:3]
        if orcid and not _ORCID.fullmatch(orcid):
            raise ValueError(f"author = {written[:80]!r}: {orcid!r} is no ORCID, such as 0000-0002-1825-0097")
        return cls(name, affiliation, orcid)


def write_deposit(
    db: Database, files: ArtefactStore, study_id: str, to: Path, *, authors: list[Author], who: Who | None = None
) -> dict[str, Any]:
    """Write the folder (made if missing, must be empty). who: whose answers the report is about, default people where
    any count, else simulated ones. Returns {"study", "folder", "files", "report_of", "simulated", "to_fill_in"}.
    Raises what `export_study` raises."""
    if to.exists() and (not to.is_dir() or any(to.iterdir())):
        raise ExportError(f"to = {str(to)!r}: is not an empty folder; choose another one")
    if len(authors) > MOST_AUTHORS:
        raise ValueError(f"author: {len(authors)} are named; at most {MOST_AUTHORS} can be")
    partial = to.with_name(f".{to.name}-{uuid.uuid4().hex}")
    try:
        partial.mkdir(parents=True)
        export_study(db, files, study_id, partial / DATA, open_data=True)
        told = _describe(db, study_id, partial, authors, who)
        listed = len(write_checksums(partial)) + 1
        if to.exists():
            to.rmdir()
        partial.rename(to)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {"study": study_id, "folder": str(to), "files": listed, **told}


def _describe(db: Database, study_id: str, out: Path, authors: list[Author], who: Who | None) -> dict[str, Any]:
    """Everything beside the data."""
    data, load = read_folder(out / DATA)
    kinds = {row.simulated for row in data.people}
    simulated = "all" if kinds == {True} else "some" if True in kinds else "none"
    chosen: Who = who or ("simulated" if simulated == "all" else "people")
    try:
        write_study_report(
            data, load, out / REPORT, who=chosen, command=f"desirepath studies report STUDY --who {chosen}"
        )
    except NothingToReport as nothing:
        report = f"There is none: {nothing}"
        shutil.rmtree(out / REPORT, ignore_errors=True)
    else:
        report = f"`{REPORT}/report.html` with every test, about: {chosen}. Figures and tables lie beside it."
    with db.session() as s:
        study = s.get_one(Study, study_id)
        answers = s.scalar(select(func.count(Response.id)).join(SessionRow).where(SessionRow.study_id == study_id)) or 0
        written = preregistration(thaw(study), now=study.created_at.date().isoformat())
        name, licence = study.name, study.protocol.get("licence")
    note = (
        f"> Made of the protocol as the study was opened with it; {answers} answers came since. Nothing here proves "
        "when it was written: what counts is the copy that was registered before the first answer, if there is one.\n\n"
    )
    (out / PREREGISTRATION).write_text(note + written, encoding="utf-8")
    for copied in (CITATION, LICENCE):
        shutil.copy(out / DATA / copied, out / copied)
    shutil.move(out / LICENCE, out / "LICENSE")
    marked = {"all": SIMULATED, "some": PARTLY, "none": ""}[simulated]
    title = f"{name} (simulated participants)" if simulated == "all" else name
    missing = [what for what, there in (("authors", authors), ("licence", licence)) if not there]
    _write_json(out / ZENODO, zenodo(title, marked, licence, authors))
    _write_json(out / DATACITE, datacite(title, marked, licence, authors))
    (out / README).write_text(readme(title, marked, report, missing), encoding="utf-8")
    return {"report_of": chosen, "simulated": simulated, "to_fill_in": missing}


KEYWORDS = ["human-robot interaction", "robot navigation", "preference learning"]


def _description(marked: str) -> str:
    return " ".join(
        part
        for part in (
            marked,
            "Answers, sessions and robot trajectories of a study with Desire Path, with its protocol, data dictionary, "
            "report and checksums. Who did not agree to publication is not in it, nor is whoever withdrew.",
        )
        if part
    )


def zenodo(title: str, marked: str, licence: str | None, authors: list[Author]) -> dict[str, Any]:
    """Metadata of a Zenodo deposition, as its legacy REST interface names them."""
    known = find_licence(licence)
    creators = [
        {"name": author.name}
        | ({"affiliation": author.affiliation} if author.affiliation else {})
        | ({"orcid": author.orcid} if author.orcid else {})
        for author in authors
    ]
    return {
        "title": title,
        "upload_type": "dataset",
        "description": _description(marked),
        "creators": creators,
        "keywords": [*KEYWORDS, "simulated data"] if marked else KEYWORDS,
        "access_right": "open" if known else "closed",
        "language": "eng",
        "notes": marked,
    } | ({"license": known.spdx.lower()} if known else {})


def datacite(title: str, marked: str, licence: str | None, authors: list[Author]) -> dict[str, Any]:
    """The same in DataCite's schema 4, without an identifier, which whoever takes the deposit gives."""
    known = find_licence(licence)
    creators = [
        {"name": author.name, "nameType": "Personal"}
        | ({"affiliation": [{"name": author.affiliation}]} if author.affiliation else {})
        | (
            {
                "nameIdentifiers": [
                    {"nameIdentifier": f"https://orcid.org/{author.orcid}", "nameIdentifierScheme": "ORCID"}
                ]
            }
            if author.orcid
            else {}
        )
        for author in authors
    ]
    rights = {"rights": known.title, "rightsUri": known.url, "rightsIdentifier": known.spdx} if known else None
    return {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Study data"},
        "titles": [{"title": title}],
        "creators": creators,
        "publisher": {"name": ""},
        "publicationYear": str(utc_now().year),
        "subjects": [{"subject": word} for word in (*KEYWORDS, *(["simulated data"] if marked else []))],
        "descriptions": [{"description": _description(marked), "descriptionType": "Abstract"}],
        "rightsList": [rights] if rights else [{"rights": licence or NOT_STATED}],
        "language": "en",
    }


def readme(title: str, marked: str, report: str, missing: list[str]) -> str:
    """What lies where, and what to do before it is published."""
    told = [
        f"# {title}",
        "",
        *([f"**{marked}**", ""] if marked else []),
        _description(""),
        "",
        "| file | what |",
        "|---|---|",
    ]
    told += [
        f"| `{DATA}/` | tables as CSV and Parquet, trajectories, protocol with every text and questionnaire |",
        f"| `{DATA}/data-dictionary.md` | every column; the study's instruments with source, scoring and terms |",
        f"| `{DATA}/codebook.csv` | codes of open questions |",
        f"| `{DATA}/datapackage.json`, `dataset_description.json`, `croissant.json` | the same for programs |",
        f"| `{REPORT}/` | the analysis |",
        f"| `{PREREGISTRATION}` | hypotheses, design, sample, measures and analysis as the protocol has them |",
        f"| `LICENSE`, `{CITATION}` | what may be done with the data, how to cite them |",
        f"| `{ZENODO}`, `{DATACITE}` | metadata |",
        f"| `{CHECKSUMS_FILE}` | sha256 of every file (`sha256sum -c {CHECKSUMS_FILE}`) |",
    ]
    told += ["", "## Report", "", report, "", "## Before you publish", ""]
    told += [f"- Fill in the {what} in `{ZENODO}` and `{DATACITE}`." for what in missing]
    told += [
        "- Read the free texts in `data/questionnaire_items.csv` and `data/responses.csv`: nobody went over them.",
        "- Words of validated scales in `data/protocol` are their owners': mind the terms in the data dictionary.",
        f"- Written by desirepath {version('desirepath')}; nothing was sent anywhere.",
    ]
    return "\n".join(told) + "\n"


def _write_json(path: Path, data: Any) -> None:
    path.write_text(json.dumps(data, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
