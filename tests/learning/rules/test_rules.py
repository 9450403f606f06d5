"""A rule that lasts: read of a sentence, asked back where it is not clear, and obeyed while driving."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_conditioned
from desirepath.learning.rules.homes import rooms_of, rule_places, rule_scene, unavailable
from desirepath.learning.rules.obedience import drive_by, obeyed_steps
from desirepath.learning.rules.obeying import ObeyingPolicy, Situation
from desirepath.learning.rules.reading import read_rule
from desirepath.learning.rules.rule import Rectangle, Rule, Wish, Zone, collisions, weights_by
from desirepath.learning.rules.spelling import mend
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import arrived
from desirepath_experiments.benchmarks.rules import (
    LabelledRule,
    RulesConfig,
    benchmark_rules,
    judge_change,
    judge_context,
)

HOMES = 24


@pytest.fixture(scope="module")
def homes() -> list[Scene]:
    return [rule_scene(7_000_000 + number) for number in range(HOMES)]


@pytest.mark.parametrize(
    ("language", "sentence", "context", "change"),
    [
        ("en", "When I sit, keep behind me", "sitting", "zone:front"),
        ("en", "when i sit keep behind me", "sitting", "zone:front"),
        ("en", "in the corridor go slower", "room:corridor", "faster:-"),
        ("en", "Never between me and the sofa", "always", "zone:between:sofa"),
        ("en", "Take your time unless I'm in a hurry", "no_hurry", "faster:-"),
        ("en", "If we have guests in the living room, keep your distance", "others+room:living_room", "farther:+"),
        ("en", "Slow down near the sofa", "near:sofa", "faster:-"),
        ("en", "Don't go into the kitchen", "always", "zone:room:kitchen"),
        ("en", "When I walk, don't you come so close", "walking", "farther:+"),
        ("en", "I find it creepy to have you behind me when I stand", "standing", "zone:behind"),
        ("en", "I hate to be on your right side", "always", "person_on_left:+"),
        ("de", "Links von dir zu gehen gefällt mir nicht", "always", "person_on_right:+"),
        ("de", "Es ist mir unheimlich, dich hinter mir zu haben, wenn ich gehe", "walking", "zone:behind"),
        ("de", "Wenn ich sitze, bleib hinter mir", "sitting", "zone:front"),
        ("de", "Außer in der Küche bitte langsam fahren", "not:room:kitchen", "faster:-"),
        ("de", "Halt dich von der Lampe fern", "always", "zone:lamp"),
        ("de", "Fahr langsamer am Sofa vorbei", "near:sofa", "faster:-"),
        ("de", "Wenn ich gehe, halt mich auf deiner linken Seite", "walking", "person_on_left:+"),
        ("de", "Besuch da und ich sitze: mehr Abstand", "others+sitting", "farther:+"),
        ("de", "Zügig fahren, bloß im Wohnzimmer nicht", "not:room:living_room", "faster:+"),
        ("de", "Ich will nicht, dass du hinter mir fährst", "always", "zone:behind"),
        ("de", "in der küchhe nihct vor mir farhen", "room:kitchen", "zone:front"),
        ("de", "Halt dich vom Ohrensessel fern", "always", "zone:chair"),
        ("de", "Fahr so, dass du mich nicht rechts hast", "always", "person_on_left:+"),
        ("en", "It would be nice if you didn't go so fast in the hall", "room:corridor", "faster:-"),
        ("de", "Mir ist wohler, wenn du hinter mir bleibst", "always", "zone:front"),
        ("en", "guests here = more distance", "others", "farther:+"),
        ("en", "Go faster, but not in the bedroom", "not:room:bedroom", "faster:+"),
        ("en", "When I stand or walk, keep more distance", "not:sitting", "farther:+"),
        ("en", "Only when I'm sitting may you drive behind me", "not:sitting", "zone:behind"),
        ("en", "When I'm in the bedroom, don't come in", "always", "zone:room:bedroom"),
        ("en", "You needn't slow down near me", "always", "slower_near_person:-"),
    ],
)
def test_a_sentence_becomes_a_situation_and_a_change(language, sentence, context, change) -> None:
    got = read_rule(sentence, language)
    assert (got.rule.context, got.rule.changes) == (frozenset(context.split("+")), frozenset(change.split(";")))
    assert not got.asked


@pytest.mark.parametrize(
    ("sentence", "about"),
    [
        ("Go slower when it is raining", "context"),
        ("slowly in front of the mirror", "context"),
        ("When I sit, you may drive behind me", "nothing"),
        ("Bring me tea when I sit", "nothing"),
        ("Not here", "place"),
    ],
)
def test_what_is_not_clear_is_asked_back(sentence, about) -> None:
    assert about in [one.about for one in read_rule(sentence, "en").asked]


def test_what_is_asked_back_is_quoted_as_it_was_typed() -> None:
    typed = "langsahmer wenns regnet"
    (asked,) = read_rule(typed, "de").asked
    assert typed[asked.start : asked.end] == "wenns regnet"


@pytest.mark.parametrize("word", ["closet", "setting", "music"])
def test_another_word_is_no_typing_error(word) -> None:
    assert mend(word, "en").text == word


def test_two_rules_that_ask_for_opposites_collide_unless_they_never_hold_at_once() -> None:
    rules = [
        read_rule(sentence, "en").rule
        for sentence in (
            "When I sit, come closer",
            "When I walk, keep away from me",
            "In the kitchen, keep your distance",
        )
    ]
    assert list(collisions(rules)) == [(0, 2, "closer")]
    off = [rules[0], rules[1], rules[2].model_copy(update={"on": False})]
    assert list(collisions(off)) == []


def test_of_opposites_that_hold_at_once_the_first_rule_counts() -> None:
    near, far = Rule(wishes=(Wish(objective="closer"),)), Rule(wishes=(Wish(objective="farther"),))
    assert weights_by({}, [near, far])[0] == {"closer": 1.0}
    assert weights_by({"closer": 0.5}, [far, near])[0] == {"farther": 1.0}
    assert weights_by({"smoother": 0.4}, [Rule(wishes=(Wish(objective="faster", more=False),))])[1] < 1


def test_a_home_says_which_rooms_it_has_and_what_nobody_can_tell_there(homes) -> None:
    assert {area.name for area in rooms_of(homes[0])} == {"kitchen", "living_room", "bedroom", "study", "doorway"}
    scene = homes[0]
    sofa = next(one for one in scene.obstacles if one.kind == "sofa")
    assert any(area.name == "living_room" and area.holds(sofa.pose.x, sofa.pose.y) for area in rooms_of(scene))
    unknown = read_rule("When guests are here, keep your distance in the bathroom", "en").rule
    assert {one.label for one in unavailable(unknown, tuple(homes))} == {"others", "room:bathroom"}
    assert Scene.from_dict(scene.as_dict()) == scene


@pytest.mark.parametrize(
    ("sentence", "least_gain"),
    [
        ("In the kitchen go slower", 0.3),
        ("Slow down in the doorway", 0.2),
        ("Not in front of me", 0.1),
        ("When I sit, keep behind me", 0.05),
    ],
)
def test_a_robot_obeys_more_than_without_the_rule(homes, sentence, least_gain) -> None:
    rule = read_rule(sentence, "en").rule
    shares = []
    for rules in ([rule], []):
        policy = ObeyingPolicy(load_conditioned("study_room/conditioned"), {}, rules)
        driven = rollout(get_setup("study_room"), policy, homes)
        counted = [obeyed_steps(rule, one) for one in driven]
        shares.append(sum(did for _, did in counted) / sum(held for held, _ in counted))
    assert shares[0] > shares[1] + least_gain


def test_a_robot_is_led_around_somebody_who_walks_past_a_room_it_must_not_enter() -> None:
    rule = read_rule("Don't go into the kitchen", "en").rule
    walks = next(place for place, scene in enumerate(rule_places()) if scene.walk)
    assert arrived(drive_by([rule], [rule_places()[walks]], [walks])).all()


def test_a_robot_whose_goal_lies_in_the_room_drives_as_without_the_rule(homes) -> None:
    rule = read_rule("Don't go into the kitchen", "en").rule
    kitchens = [(one, area) for one in homes for area in rooms_of(one) if area.name == "kitchen"]
    inside = [scene for scene, area in kitchens if area.holds(scene.goal.x, scene.goal.y)][:2]
    assert inside
    for told, usual in zip(drive_by([rule], inside), drive_by([], inside), strict=True):
        np.testing.assert_array_equal(told.poses, usual.poses)


def test_a_zone_that_no_home_has_holds_nowhere_and_is_said_to(homes) -> None:
    bathroom = read_rule("Don't go into the bathroom", "en").rule
    assert bathroom.complete
    assert obeyed_steps(bathroom, drive_by([bathroom], homes[:1])[0])[0] == 0
    assert [one.label for one in unavailable(bathroom, tuple(homes))] == ["room:bathroom"]
    assert unavailable(read_rule("Don't go into the kitchen", "en").rule, tuple(homes)) == []


def test_a_zone_is_obeyed_where_the_whole_robot_keeps_out(homes) -> None:
    driven = drive_by([], homes[:1])[0]
    x, y = map(float, driven.poses[1, :2])
    beside = get_setup("study_room").robot.radius_m / 2
    counted = []
    for gap in (beside, 3 * beside):
        drawn = Rectangle(x=x, y=y + gap + 0.05, length=0.1, width=0.1)
        first = replace(driven, poses=driven.poses[:2], actions=driven.actions[:1])
        counted.append(obeyed_steps(Rule(zones=(Zone(kind="here", drawn=drawn),)), first))
    assert counted == [(1, 0), (1, 1)]


def test_a_drawn_zone_counts_in_its_place_alone(homes) -> None:
    drawn = Rectangle(x=0.5, y=1.0, length=1.0, width=2.0, place=1)
    rule = Rule(zones=(Zone(kind="here", drawn=drawn),))
    here, there = (Situation.at(homes[0], (0, 0, 0), 0.0, place) for place in (1, 0))
    assert [area.length for area in here.areas(rule.zones[0])] == [1.0]
    assert there.areas(rule.zones[0]) == []
    assert not Rule(zones=(Zone(kind="here"),)).complete


def test_more_rules_than_anybody_keeps_are_refused() -> None:
    with pytest.raises(LearningError, match="at most"):
        ObeyingPolicy(load_conditioned("study_room/conditioned"), {}, [Rule()] * 13)


def test_sentences_of_another_folder_are_measured(tmp_path) -> None:
    rows = "manner\tcontext\tchange\tsentence\nshort\tsitting\tcloser:+\tWhen I sit, come closer\n"
    (tmp_path / "rules_test_en.tsv").write_text(rows, encoding="utf-8")
    read = benchmark_rules(RulesConfig(sentences=tmp_path))["sentences"]
    assert (read["en"]["n"], read["de"]["n"]) == (1, 0)
    assert read["en"]["change"]["right"]["value"] == 1


def test_labelled_sentences_are_judged_by_situation_and_by_change() -> None:
    def judged(context: str, change: str, sentence: str) -> tuple[str, str]:
        labelled = LabelledRule("short", frozenset(context.split("+")), frozenset(change.split(";")), sentence)
        got = read_rule(sentence, "en")
        return judge_context(labelled, got), judge_change(labelled, got)

    assert judged("near:person", "faster:-", "Slow down when you are near me") == ("right", "right")
    assert judged("unknown", "faster:-", "Go slower when it is raining") == ("right", "right")
    assert judged("sitting", "closer:+", "When I sit, keep your distance") == ("right", "wrong_direction")
    assert judged("walking", "ask", "When I sit, bring me tea") == ("wrong", "right")


def test_a_doorway_is_a_situation_and_no_place_to_keep_out_of(homes) -> None:
    doors = [area for area in rooms_of(homes[0]) if area.name == "doorway"]
    assert len(doors) == 4
    slow = read_rule("Slow down in the doorway", "en").rule
    assert unavailable(slow, tuple(homes)) == []
    out = read_rule("Don't go into the doorway", "en").rule
    assert [one.of for one in unavailable(out, tuple(homes))] == ["doorway"]


@pytest.mark.parametrize(
    ("language", "sentence", "change"),
    [
        ("en", "Don't drive in front of me but behind me", "zone:front"),
        ("en", "Stay behind me and don't come closer", "zone:front"),
        ("de", "Statt hinter mir fahr lieber vor mir", "zone:behind"),
        ("de", "Dass du hinter mir fährst, gefällt mir nicht", "zone:behind"),
    ],
)
def test_what_is_denied_of_two_places_is_where_it_must_not_be(language, sentence, change) -> None:
    assert change in read_rule(sentence, language).rule.changes
    assert len(read_rule(sentence, language).rule.zones) == 1


@pytest.mark.parametrize(
    ("sentence", "zone"),
    [
        ("I would rather have you behind me than in front of me", "front"),
        ("I'd rather you drove behind me than in front of me", "front"),
        ("Rather behind me than in front of me", "front"),
        ("When I sit I'd rather have you in front of me than behind me", "behind"),
        ("I prefer you in front of me to behind me", "front"),
        ("Rather than behind me, drive in front of me", "behind"),
        ("I'd like you in front of me rather than behind me", "behind"),
        ("Instead of driving in front of me, stay behind me", "front"),
        ("It's fine to drive behind me, but not in front of me", "front"),
        ("Don't stop in front of me", "front"),
        ("I mind you driving behind me", "behind"),
        ("Lieber hinter mir als vor mir", "front"),
        ("Ich habe dich lieber vor mir als hinter mir", "behind"),
        ("Wenn ich gehe, fahr lieber hinter mir als vor mir", "front"),
        ("Eher vor mir als hinter mir", "behind"),
        ("Hinter mir ist besser als vor mir", "front"),
        ("Fahr lieber vor mir statt hinter mir", "behind"),
        ("Hör auf, hinter mir zu fahren", "behind"),
        ("Nie, nie hinter mir fahren", "behind"),
        ("Wenn ich sitze, musst du hinter mir bleiben", "front"),
        ("Im Esszimmer musst du immer hinter mir bleiben", "front"),
        ("Musst du immer hinter mir fahren", "behind"),
        ("Immer musst du vor mir herfahren", "front"),
        ("Wenn ich sitze, musst du dann hinter mir fahren?", "behind"),
    ],
)
def test_where_it_must_not_be_is_the_place_that_is_denied_or_not_preferred(sentence, zone) -> None:
    got = read_rule(sentence, "en")
    assert [one.label for one in got.rule.zones] == [f"zone:{zone}"]
    assert not got.asked


@pytest.mark.parametrize(
    "sentence",
    [
        "You don't have to stay behind me",
        "There's no need to stay behind me",
        "When I walk you needn't stay behind me",
        "You needn't avoid the kitchen",
        "You don't have to stay out of the bedroom",
        "You don't need to keep away from the sofa",
        "It is not necessary that you stay behind me",
        "No need to stay between me and the sofa",
        "You needn't avoid that corner",
        "Du musst nicht hinter mir bleiben",
        "Du brauchst nicht hinter mir zu bleiben",
        "Du musst nicht aus der Küche bleiben",
        "Wenn ich sitze, musst du nicht hinter mir bleiben",
        "Du musst die Küche nicht meiden",
        "Es ist nicht nötig, hinter mir zu bleiben",
        "Du brauchst dich nicht vom Sofa fernzuhalten",
    ],
)
def test_what_need_not_be_is_not_forbidden(sentence) -> None:
    _assert_asked(sentence)


@pytest.mark.parametrize(
    "sentence",
    [
        "Don't stay out of the kitchen",
        "Stop avoiding the kitchen",
        "Don't leave the kitchen",
        "Don't keep away from the sofa",
        "Don't stop driving behind me",
        "I can't stand it when you are not behind me",
        "I hate it when you aren't behind me",
        "Nothing is better than having you behind me",
        "Verlass nie die Küche",
        "Bleib nicht aus der Küche weg",
        "Meide nicht die Küche",
        "Halt dich nicht vom Sofa fern",
        "Hör nicht auf, hinter mir zu fahren",
        "Ich mag es nicht, wenn du nicht hinter mir bist",
        "Nichts ist besser als dich hinter mir zu haben",
        "Nichts ist mir lieber als dich hinter mir zu haben",
    ],
)
def test_what_is_denied_twice_is_asked_back(sentence) -> None:
    _assert_asked(sentence)


@pytest.mark.parametrize(
    "sentence",
    [
        "I don't mind you driving behind me",
        "It's fine to drive behind me when I sit",
        "It's okay to drive in front of me",
        "It doesn't bother me when you drive behind me",
        "You're welcome to drive behind me",
        "Driving behind me is fine with me",
        "Feel free to drive behind me when I sit",
        "I don't care whether you drive behind me",
        "Mir ist egal, ob du hinter mir fährst",
        "Du darfst ruhig zwischen mir und dem Sofa fahren",
        "Fahr ruhig hinter mir, wenn ich sitze",
        "Sie dürfen ruhig vor mir fahren",
        "Es stört mich nicht, wenn du hinter mir fährst",
        "Von mir aus fahr hinter mir",
        "Das ist in Ordnung, wenn du hinter mir fährst",
        "Fahr ruhig in die Küche",
    ],
)
def test_what_is_allowed_is_no_order(sentence) -> None:
    _assert_asked(sentence)


def _assert_asked(sentence: str) -> None:
    got = read_rule(sentence, "en")
    assert not got.rule.changes
    assert {one.about for one in got.asked} & {"nothing", "wish"}
