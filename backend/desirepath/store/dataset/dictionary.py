"""The data dictionary: what every file and column of a data set means, in Markdown."""

from __future__ import annotations

from desirepath.store.dataset.columns import (
    CHECKSUMS_FILE,
    DEMONSTRATION_FOLDER,
    DICTIONARY_FILE,
    PROTOCOL_FOLDER,
    STUDY_FILE,
    TRAJECTORY_FOLDER,
)
from desirepath.store.dataset.descriptions import CITATION, CROISSANT, DATA_PACKAGE, LICENCE, PSYCH_DS
from desirepath.store.dataset.minari_episodes import FOLDER as MINARI_FOLDER
from desirepath.store.dataset.minari_episodes import NAMESPACE
from desirepath.store.dataset.preference_pairs import FOLDER as PAIRS_FOLDER
from desirepath.store.dataset.tables import TABLES


def data_dictionary() -> str:
    """The data dictionary in Markdown, as it lies in every data set and in docs/."""
    lines = [
        "# Data dictionary",
        "",
        "What the files of an exported study mean. Written by `desirepath export`; do not edit by hand.",
        "",
        "Every table comes as Parquet (typed, exact; what `desirepath import` reads) and, if not said otherwise, as",
        "CSV (UTF-8, comma, quotes doubled). In CSV, a line of a text that a spreadsheet could take for a formula",
        "(beginning with `=`, `+`, `-`, `@`, tab or line break, also behind a semicolon, and no number) has an",
        "apostrophe put before it, and carriage returns are line feeds. Units are SI and in the column's",
        "name; angles are radians. Ids are random or hashes; nothing that identifies a person is exported: no",
        "recruiting ids (where one was typed into a text it reads `[removed]`), no network addresses, no link tokens,",
        "no completion codes, no problem reports. A completion code that is the same for everybody reads `REMOVED` in",
        "the protocol's copy, and the address people return by `https://removed.invalid/`; `sha256` in",
        f"`{STUDY_FILE}` is the protocol's as it ran, `written_sha256` that of this copy. Free-text answers are",
        "exported as they were written: read them before you publish.",
        "",
        "**Who withdrew** is one row in `participants` with code and times, so that the flow of participants adds up.",
        "Their sessions, trials, answers, events and the trajectories that only they saw are not in the data set. Data",
        "sets written before they withdrew still hold them: replace those by a new one.",
        "",
        "**Data for publication** (`--open-data`) hold nothing of who did not agree to it but that row.",
        "",
        "**Before you analyse**, leave out rows with `excluded` or `practice` true, and decide about `simulated` ones.",
        "",
        "**Where the person stood** is in the scene: `person.pose.x` and `person.pose.y` (metres, in the same frame as",
        "`poses`) and `person.pose.yaw` (radians) of column `scene` and of `scene` in a trajectory's `meta`.",
        "",
        "| file | holds |",
        "|---|---|",
        f"| `{STUDY_FILE}` | study, protocol hash, setups, licence, citation, counts |",
        f"| `{PROTOCOL_FOLDER}/` | the study's frozen copy of the protocol and its texts |",
        f"| `{TRAJECTORY_FOLDER}/ID.npz` | arrays of one trajectory: `poses` (T+1, 3: x m, y m, yaw rad), "
        "`observations` and `next_observations` (T, n), `actions` (T, 2), `rewards` (T), `dones` (T); `meta`: JSON "
        "bytes with scene, outcome, dt. Read with `numpy.load(path, allow_pickle=False)` |",
        f"| `{DEMONSTRATION_FOLDER}/ID.npz` | one demonstration, where paths were drawn: `stroke_points`, "
        "`stroke_speeds`, `stroke_times_s` as drawn; cubic B-splines `spline_knots`, `spline_coefficients`, "
        "`speed_knots`, `speed_coefficients`; `commands` (T, 2: m/s, rad/s); `trajectory`: bytes of its NPZ |",
        f"| `{PAIRS_FOLDER}/` | the pairs that may be learned from as JSON lines `prompt`, `chosen`, `rejected`: "
        "`train`, `practice` and `probes` apart; `datasets.load_dataset` opens the folder, TRL takes its columns |",
        f"| `{MINARI_FOLDER}/` | the trajectories as episodes with observation and action spaces, a Minari dataset "
        f"per setup: with `MINARI_DATASETS_PATH` set to this folder `minari.load_dataset('{NAMESPACE}/SETUP-v0')` |",
        f"| `{DATA_PACKAGE}` | Frictionless Data Package of the CSV tables: types, keys, what refers to what |",
        f"| `{CROISSANT}` | Croissant description of the Parquet tables |",
        f"| `{PSYCH_DS}` | Psych-DS metadata (schema.org): every variable; files keep our names, not that standard's |",
        f"| `{CITATION}`, `{LICENCE}` | how to cite, and what may be done with the data |",
        f"| `{DICTIONARY_FILE}` | this text |",
        f"| `{CHECKSUMS_FILE}` | sha256 of every other file; check with `sha256sum -c {CHECKSUMS_FILE}` |",
    ]
    for table in TABLES:
        endings = "`.csv`, `.parquet`" if table.csv else "`.parquet` only"
        lines += ["", f"## {table.name}", "", f"One row per {table.row}. {endings}", "", "| column | type | meaning |"]
        lines += ["|---|---|---|"]
        lines += [f"| `{c.name}` | {c.type_name()} | {c.meaning} |" for c in table.columns]
    return "\n".join(lines) + "\n"
