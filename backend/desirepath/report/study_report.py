"""Writes a study's report into a folder: one HTML file, figures as PNG and SVG, a CSV beside each, all tests as CSV."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from desirepath.analysis.scales import Scale
from desirepath.analysis.tested import Tested
from desirepath.explain.printed import page
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, Who, analyse, device_words
from desirepath.report.policy_table import PolicyRow, policies_section
from desirepath.report.report_text import brief, every_test, facts, sections
from desirepath.report.study_data import Load, StudyData

REPORT_FILE = "report.html"
TESTS_FILE = "tests.csv"
POLICIES_FILE = "policies.csv"
SCALES_FILE = "scales.csv"
ANSWERS_FILE = "answers.csv"
RANKINGS_FILE = "importance_rankings.csv"
FINDINGS_FILE = "findings.json"
FIGURES_FOLDER = "figures"


def write_study_report(
    data: StudyData,
    load: Load,
    out: Path,
    *,
    who: Who = "people",
    plan: AnalysisPlan | None = None,
    command: str = "",
    policies: Sequence[PolicyRow] = (),
) -> dict[str, Any]:
    """Analyse the study and write its report into `out` (made if missing). policies: learned from its views, if any.

    Returns {"report", "participants", "answers", "simulated", "tests", "significant", "deviations", "figures"}.
    Raises NothingToReport if nobody of `who` has answers that count.
    """
    from desirepath.explain.pictures import write_csv  # loads matplotlib, which is slow
    from desirepath.report.report_figures import pictures

    findings = analyse(data, load, who, plan)
    out.mkdir(parents=True, exist_ok=True)
    drawn = pictures(findings)
    files = [path for picture in drawn for path in picture.save(out / FIGURES_FOLDER)]
    if findings.tests:
        write_csv(out / TESTS_FILE, [_row(test, findings.plan.alpha) for test in findings.tests])
    if scores := scale_rows(findings):
        write_csv(out / SCALES_FILE, scores)
    if answers := answer_rows(data, findings):
        write_csv(out / ANSWERS_FILE, answers)
    if findings.explained:
        write_csv(out / RANKINGS_FILE, [trial.row() for trial in findings.explained.trials])
    if policies:
        write_csv(out / POLICIES_FILE, [policy.row() for policy in policies])
    (out / FINDINGS_FILE).write_text(json.dumps(findings_dict(findings), indent=1) + "\n", encoding="utf-8")
    protocol = f"{data.protocol.get('protocol', 'unknown')}, version {data.protocol.get('version', '–')}"
    html = page(
        __package__,
        "study_report.html",
        name=data.name,
        simulated=findings.simulated,
        analysed=findings.flow.analysed,
        brief=brief(findings),
        deviations=findings.deviations,
        sections=[
            *sections(findings, drawn, out / FIGURES_FOLDER),
            *([policies_section(policies)] if policies else []),
            *every_test(findings),
        ],
        facts=facts(findings, study=data.study, protocol=protocol, protocol_hash=data.protocol_hash, command=command),
    )
    (out / REPORT_FILE).write_text(html, encoding="utf-8")
    return {
        "report": str(out / REPORT_FILE),
        "participants": findings.flow.analysed,
        "answers": sum(of.answers for of in findings.of_condition.values()),
        "simulated": findings.simulated,
        "tests": len(findings.tests),
        "significant": [test.about for test in findings.tests if test.significant(findings.plan.alpha)],
        "deviations": list(findings.deviations),
        "figures": [str(path) for path in files],
    }


def _row(test: Tested, alpha: float) -> dict[str, object]:
    row = {name: None if value != value else value for name, value in test.as_dict().items()}  # nan: not known
    return {**row, "significant": test.significant(alpha), "sentence": test.sentence(alpha)}


def answer_rows(data: StudyData, findings: Findings) -> list[dict[str, object]]:
    """Every answer to a query of those analysed, practice trials and probes marked, with view and device."""
    people = {row.code: row for row in data.people if row.code in findings.analysed}
    return [
        {
            "participant": choice.person,
            "condition": choice.condition,
            "view": choice.view,
            "device": device_words(choice, people[choice.person]),
            "role": choice.role,
            "query": choice.query,
            "first": choice.first,
            "second": choice.second,
            "second_chosen": choice.second_chosen,
            "decision_s": choice.decision_s,
        }
        for choice in data.choices
        if choice.person in people
    ]


def scale_rows(findings: Findings) -> list[dict[str, object]]:
    """Every score of a validated scale."""
    return [
        {
            "participant": score.person,
            "questionnaire": of.questionnaire,
            "scale": of.scale.name,
            "condition": score.condition or "",
            "asking": score.asking,
            "score": score.score,
        }
        for of in findings.scales
        for score in of.scores
    ]


def findings_dict(findings: Findings) -> dict[str, Any]:
    """The findings as plain JSON: pairs as "a, b", numbers that are not known as null."""
    plain: dict[str, Any] = _plain(
        {field.name: getattr(findings, field.name) for field in dataclasses.fields(findings)}
    )
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, AnalysisPlan):
        return value.model_dump(mode="json")
    if isinstance(value, Scale):
        return value.name
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {", ".join(key) if isinstance(key, tuple) else str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
