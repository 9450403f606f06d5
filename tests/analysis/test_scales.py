"""Validated scales score as their sources say, and a changed word is noticed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from desirepath.analysis.colour_plates import CONES, colour_plate, figure_and_ground
from desirepath.analysis.scale_wordings import SCALES
from desirepath.analysis.scales import wording_digest

SUS, TLX = SCALES["sus"], SCALES["raw_tlx"]


def test_the_usability_scale_scores_as_brooke_says():
    """Odd items count answer - 1, even ones 5 - answer, the sum times 2.5."""
    sheet = dict(zip((item.key for item in SUS.items), (5, 4, 2, 1, 2, 3, 2, 4, 5, 4), strict=True))
    odd = sum(sheet[f"sus_{n}"] - 1 for n in (1, 3, 5, 7, 9))
    even = sum(5 - sheet[f"sus_{n}"] for n in (2, 4, 6, 8, 10))
    assert SUS.score(sheet) == pytest.approx((odd + even) * 2.5)
    best = {item.key: 1 if item.reversed else 5 for item in SUS.items}
    assert SUS.score(best) == 100.0
    assert SUS.score(dict.fromkeys(best, 3)) == 50.0


def test_the_raw_task_load_is_the_mean_of_six_answers_in_steps_of_five():
    ratings = dict(zip((item.key for item in TLX.items), (11, 1, 21, 5, 9, 13), strict=True))
    assert TLX.score(ratings) == pytest.approx(sum((one - 1) * 5 for one in ratings.values()) / 6)


def test_trust_in_automation_is_the_mean_of_seven_points_with_distrust_turned_round():
    """Jian et al.'s items 1 to 5 are distrust; the short form is items 6, 10 and 11 (McGrath et al.)."""
    trust, short = SCALES["tias"], SCALES["s_tias"]
    assert [item.reversed for item in trust.items] == [True] * 5 + [False] * 7
    sheet = dict(zip((item.key for item in trust.items), (1, 2, 3, 2, 1, 6, 5, 5, 6, 7, 6, 4), strict=True))
    assert trust.score(sheet) == pytest.approx((7 + 6 + 5 + 6 + 7 + 6 + 5 + 5 + 6 + 7 + 6 + 4) / 12)
    assert short.score({key: sheet[key] for key in ("trust_6", "trust_10", "trust_11")}) == pytest.approx(19 / 3)
    assert trust.score({key: 1 if item.reversed else 7 for key, item in zip(sheet, trust.items, strict=True)}) == 7.0
    assert [item.text["en"] for item in short.items] == [
        "I am confident in the system.",
        "The system is reliable.",
        "I can trust the system.",
    ]


@pytest.mark.parametrize("name", ["godspeed_likeability", "godspeed_intelligence"])
def test_godspeed_is_the_mean_of_five_pairs_of_words(name):
    scale = SCALES[name]
    keys = [item.key for item in scale.items]
    assert scale.score(dict(zip(keys, (1, 2, 5, 4, 4), strict=True))) == pytest.approx(16 / 5)
    assert (scale.lowest, scale.highest, scale.points) == (1.0, 5.0, 5)
    assert "supplies them" in scale.licence
    assert scale.languages == ()  # its words are not here
    worded = scale.with_words([replace(item, text={"en": item.key}) for item in scale.items])
    assert worded.languages == ("en",)
    with pytest.raises(ValueError, match=f"{name} has the items {keys[0]}, .* none of them reversed"):
        scale.with_words(scale.items[:4])
    with pytest.raises(ValueError, match=r"reversed: tlx_x$"):
        replace(TLX, items=(replace(TLX.items[0], key="tlx_x", reversed=True),)).with_words(TLX.items[:1])


def test_the_short_user_experience_questionnaire_has_two_subscales_from_minus_three_to_three():
    ueq = SCALES["ueq_s"]
    sheet = dict(zip((item.key for item in ueq.items), (7, 6, 5, 4, 1, 2, 3, 4), strict=True))
    scores = {part.name: part.score(sheet) for part in ueq.scored}
    expected = {"ueq_s_pragmatic_quality": 1.5, "ueq_s_hedonic_quality": -1.5, "ueq_s": 0.0}
    assert scores == pytest.approx(expected)
    assert SCALES["umux_lite"].score({"umux_lite_1": 5, "umux_lite_2": 7}) == pytest.approx((5 + 7 - 2) * 100 / 12)
    ipq = {part.name: part for part in SCALES["ipq"].scored}
    assert "ipq" not in ipq  # no score of all
    assert ipq["ipq_realism"].score({f"ipq_real{k}": 7 for k in (1, 2, 3, 4)}) == pytest.approx((0 + 6 * 3) / 4)


@pytest.mark.parametrize(("of", "blind"), [("protan", 0), ("deutan", 1)])
def test_a_plates_digit_differs_from_its_ground_in_one_cone_alone(of, blind):
    figure, ground = (CONES @ colour for colour in figure_and_ground(of))
    others = [cone for cone in range(3) if cone != blind]
    assert figure[others] == pytest.approx(ground[others])
    assert abs(figure[blind] - ground[blind]) / ground[blind] > 0.25
    dots = colour_plate("6", of)
    assert dots == colour_plate.__wrapped__("6", of)
    assert all(x - r >= 0 and x + r <= 100 for x, _, r, _ in dots)


def test_every_scale_says_where_it_is_from_and_why_it_may_be_shipped():
    for scale in SCALES.values():
        assert len(scale.source) > 40
        assert scale.licence
        assert len({item.key for item in scale.items}) == len(scale.items)


def test_a_missing_or_impossible_answer_is_named():
    answers = {item.key: 3 for item in SUS.items}
    with pytest.raises(ValueError, match="sus_4 = None: sus needs an answer from 1 to 5"):
        SUS.score({key: value for key, value in answers.items() if key != "sus_4"})
    with pytest.raises(ValueError, match="sus_1 = 6"):
        SUS.score({**answers, "sus_1": 6})


@pytest.mark.parametrize("scale", SCALES.values(), ids=lambda scale: scale.name)
def test_one_changed_word_is_another_wording(scale):
    for language in scale.languages:
        items = [(item.text[language], item.low[language], item.high[language]) for item in scale.items]
        assert wording_digest(items, scale.points) == scale.digest(language)
        changed = [(items[0][0].replace(" ", " so ", 1), *items[0][1:])]
        assert wording_digest(changed + items[1:], scale.points) != scale.digest(language)
