"""The manual inside the lab: every page leads to the part that fits it, and no link of any document leads nowhere."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
import yaml

from desirepath.installed import DOCS, FRONTEND
from desirepath.web.application import create_application
from desirepath.web.core.guides import FITTING, GUIDES, HERE, PICTURE, anchor_of, find, fitting_guide, guide
from tests.fences import DOCUMENTS, FENCE
from tests.web.lab_services import Walked

TITLE = "Learning Personalized and Human-Aware Robot Navigation"


def anchors(name: str) -> set[str]:
    return {passage.anchor for passage in guide(name).passages}


def test_every_link_of_the_manual_leads_to_something_that_is_there():
    assert sorted(GUIDES) == sorted(path.stem for path in DOCS.glob("*.md"))
    for name in GUIDES:
        for address in re.findall(r'href="([^"]+)"', guide(name).html):
            if "://" in address:
                continue
            to, _, part = address.removeprefix(f"{HERE}/").partition("#")
            to = to or name
            assert to in GUIDES, (name, address)
            assert not part or part in anchors(to), (name, address)


def test_fences_begin_as_the_sites_builder_reads_them():
    """Any other first line would end a block there instead, and swallow the headings behind it."""
    for name in GUIDES:
        begins = re.findall(r"^```(.+)$", (DOCS / f"{name}.md").read_text("utf-8"), re.MULTILINE)
        assert [one for one in begins if not re.fullmatch(r'\w+(?: title="[^"]+")?', one)] == [], name


def test_links_of_templates_lead_to_parts_of_the_manual():
    for template in (FRONTEND / "templates").rglob("*.html"):
        for name, part in re.findall(rf'href="{HERE}/([\w-]+)(?:#([\w-]+))?"', template.read_text("utf-8")):
            assert name in GUIDES, template
            assert not part or part in anchors(name), (template, part)


def test_links_of_readme_and_notebook_lead_to_files_and_their_parts():
    for path in DOCUMENTS:
        for address in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", path.read_text("utf-8"))):
            to, _, part = address.partition("#")
            if "://" in to or PICTURE.fullmatch(address.replace("-dark", "-light")):
                assert "://" in to or (path.parent / to).exists(), (path, address)
                continue
            file = path.parent / to if to else path
            assert file.exists(), (path, address)
            headings = re.findall(r"^#+ (.+)$", file.read_text("utf-8"), re.MULTILINE) if part else []
            assert not part or part in map(anchor_of, headings), (path, address)


def _texts_of(node: object) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    for below in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from _texts_of(below)


def test_labels_that_the_manual_names_are_those_of_the_pages():
    """*Label*: what a page, a button or a part of the manual is called."""
    texts = [
        text
        for file in (FRONTEND / "locales" / "en").rglob("*.yaml")
        for text in _texts_of(yaml.safe_load(file.read_text("utf-8")))
    ]
    titles = [passage.title for name in GUIDES for passage in guide(name).passages]
    whole = {text.casefold().rstrip(".:") for text in (*texts, *titles)}
    shown = whole | {text.partition(" (")[0] for text in whole}
    for name in GUIDES:
        words = FENCE.sub("", (DOCS / f"{name}.md").read_text("utf-8"))
        labels = set(re.findall(r"(?<!\*)\*([A-Z][^*\n]+)\*(?!\*)", words)) - {TITLE}
        assert {label for label in labels if label.casefold().rstrip(".") not in shown} == set(), name


def test_words_are_found_in_headings_first():
    first, *others = find("reward network")
    assert (first.guide.name, first.passage.anchor) == ("your-policies", "inputs-of-a-reward-network")
    assert all("reward" in f"{one.passage.title} {one.passage.words}".casefold() for one in others)
    assert find("") == find("xyzzy") == []


def test_words_are_found_by_their_beginnings_and_whole_ones_first():
    assert find("olicies") == []
    assert find("polic")
    whole = ["ROS" in re.findall(r"\w+", f"{one.passage.title} {one.passage.words}") for one in find("ROS")]
    assert whole == sorted(whole, reverse=True)
    assert whole[0], "RoSAS comes after ROS"


def test_the_manual_says_how_to_cite_what_the_citation_file_says():
    cited = yaml.safe_load((DOCS.parent / "CITATION.cff").read_text("utf-8"))
    told = next(one.words for one in guide("index").passages if one.title == "How to cite")
    thesis = cited["references"][0]
    for said in (cited["title"], cited["version"], thesis["title"], thesis["institution"]["name"], thesis["year"]):
        assert str(said) in told


def test_every_page_leads_to_a_part_that_exists(lab_services):
    for where in FITTING.values():
        name, _, part = where.partition("#")
        assert name in GUIDES
        assert not part or part in anchors(name), where
    routes = create_application(lab_services).openapi()["paths"]
    reached = [one for one in FITTING if any(route == one or route.startswith(f"{one}/") for route in routes)]
    assert reached == list(FITTING)
    assert fitting_guide("/lab/studies/{study_id}/recruit").endswith("#recruiting-and-paying")
    assert fitting_guide("/lab/password") == HERE


@pytest.mark.parametrize(
    ("page", "part"),
    [
        ("/lab/new", "experimenters-guide#a-new-study"),
        ("/lab/studies/STUDY/recruit", "experimenters-guide#recruiting-and-paying"),
        ("/lab/studies/STUDY/protocol", "protocol-reference"),
        ("/lab/jobs", "analysts-guide#jobs"),
    ],
)
def test_who_needs_a_guide_is_led_to_its_part(lab, walked: Walked, page, part):
    assert f'href="{HERE}/{part}"' in lab.get(page.replace("STUDY", walked.id)).text


def test_guides_are_read_by_who_is_signed_in(lab, visitor):
    listed = lab.get(HERE).text
    for name in GUIDES:
        shown = lab.get(f"{HERE}/{name}")
        assert shown.status_code == 200
        title = (DOCS / f"{name}.md").read_text().partition("\n")[0].removeprefix("# ")
        assert title.replace("'", "’") in shown.text.replace("&#39;", "’").replace("'", "’")
        assert f'href="{HERE}/{name}"' in listed
    assert lab.get(f"{HERE}/../secrets").status_code == 404
    assert lab.get(f"{HERE}/numbers").status_code == 404
    assert f'href="{HERE}/limits#in-operation"' in lab.get(f"{HERE}?find=backups downloaded").text
    visitor.cookies.clear()
    assert visitor.get(f"{HERE}/data-dictionary").status_code in (303, 401)


def test_the_data_dictionary_of_an_export_stands_among_the_guides(lab, walked: Walked):
    assert 'href="/lab/guides/data-dictionary"' in lab.get(f"/lab/studies/{walked.id}/data").text
    assert lab.get("/lab/data-dictionary").headers["location"] == "/lab/guides/data-dictionary"
