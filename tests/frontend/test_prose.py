"""Texts of a study become safe HTML: what a protocol's author writes can never act on a participant's page."""

from desirepath.web.core.guides import prose


def test_headings_stay_below_the_page_s_own() -> None:
    assert prose("# One\n\n## Two\n\n### Three") == "<h2>One</h2>\n<h2>Two</h2>\n<h3>Three</h3>\n"
    assert prose("# One\n\n#### Four", shift=3) == "<h4>One</h4>\n<h6>Four</h6>\n"


def test_raw_html_is_shown_as_text() -> None:
    html = prose("<script>alert(1)</script>\n\nand <img src=x onerror=alert(1)>")
    assert "<script" not in html
    assert "<img" not in html
    assert "&lt;script&gt;" in html


def test_links_leave_the_step_in_place_and_scripts_are_no_links() -> None:
    assert 'target="_blank" rel="noopener noreferrer"' in prose("[us](https://example.org)")
    assert "href" not in prose("[us](javascript:alert(1))")


def test_images_are_not_fetched_from_elsewhere() -> None:
    assert "<img" not in prose("![x](https://example.org/x.png)")
