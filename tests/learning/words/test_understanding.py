"""A wish in plain words becomes preference weights; what was not understood is said, and what is unclear asked back."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from desirepath.learning.preferences.objectives import preference_weights
from desirepath.learning.words.clauses import clauses_of
from desirepath.learning.words.lexicon import (
    LANGUAGES,
    LONGEST,
    LONGEST_WORD,
    MOST_WORDS,
    Language,
    form_of,
    lexicon,
    words_of,
)
from desirepath.learning.words.second_reader import ENDS, Doubts, hash_features, second_reader
from desirepath.learning.words.understanding import WordsReader, words_reader
from desirepath_experiments.benchmarks.labelled_wishes import Case
from desirepath_experiments.benchmarks.words import read_sentences
from tests.learning.words.measure import measure, read_cases


def said(sentence, language="en"):
    return words_reader(language).understand(sentence)


@pytest.mark.parametrize(
    ("language", "sentence"),
    [("en", "Stay well away from me but don't dawdle"), ("de", "Bleib weit weg von mir, aber trödel nicht")],
)
def test_the_sentence_of_the_issue_is_two_wishes_with_its_words_marked(language, sentence):
    got = said(sentence, language)
    assert list(got.weights) == ["farther", "faster"]
    assert got.weights["farther"] > got.weights["faster"] > 0
    preference_weights(got.weights)  # what the policy takes
    marked = {mark.objective: sentence[mark.start : mark.end] for mark in got.marks}
    assert marked.keys() == {"farther", "faster"}
    assert {"away", "weg"} & set(marked["farther"].split())
    assert not got.not_understood
    assert not got.questions


def test_a_denied_contrary_is_a_wish_and_a_denied_wish_is_none():
    assert said("Don't come close to me").foremost == "farther"
    assert said("Komm mir nicht zu nahe", "de").foremost == "farther"
    assert said("You don't need to hurry").weights == {}
    assert said("Du musst dich nicht beeilen", "de").weights == {}


@pytest.mark.parametrize(
    ("sentence", "language", "more", "less"),
    [
        ("Rather early than far away", "en", "faster", "farther"),
        ("Rather far away than early", "en", "farther", "faster"),
        ("Lieber sanft als kurz", "de", "smoother", "shorter"),
        ("Keep your distance even if that means a longer way", "en", "farther", "shorter"),
        ("Tempo ist mir wichtiger als sanfte Kurven", "de", "faster", "smoother"),
    ],
)
def test_in_a_comparison_the_preferred_weighs_more(sentence, language, more, less):
    got = said(sentence, language).weights
    assert got[more] > got.get(less, 0)


def test_what_was_not_understood_is_said_and_what_is_unclear_is_asked_back():
    got = said("Play some music")
    assert got.weights == {}
    assert [("Play some music")[a:b] for a, b in got.not_understood] == ["Play some music"]
    assert said("Be careful").questions[0].offered == ("farther", "slower_near_person", "smoother")
    assert said("Fahr links an mir vorbei", "de").questions[0].offered == ("person_on_left", "person_on_right")


@pytest.mark.parametrize(
    ("sentence", "language", "offered"),
    [
        ("near but far", "en", ("closer", "farther")),
        ("Come close to me and stay far away from me", "en", ("closer", "farther")),
        ("Keep your distance but come near", "en", ("farther", "closer")),
        ("Pass on my left, and on my right", "en", ("person_on_left", "person_on_right")),
        ("Nah, aber weit weg", "de", ("closer", "farther")),
        ("Halt mich auf deiner linken Seite und auf deiner rechten Seite", "de", ("person_on_left", "person_on_right")),
    ],
)
def test_who_asks_for_opposites_is_asked_back_which_they_mean(sentence, language, offered):
    got = said(sentence, language)
    assert not set(got.weights) & set(offered)
    (asked,) = got.questions
    assert asked.offered == offered
    assert sentence[asked.start : asked.end] == sentence


@pytest.mark.parametrize(
    ("sentence", "weights"),
    [
        ("Stay near me, be quick, but keep far away", {"faster": 1.0}),  # what is beside a contradiction counts
        ("Rather near than far", {"closer": 1.0}),  # a comparison is none
        ("Above all come close, and keep away from me", {"closer": 1.0}),  # it says itself what comes first
        ("Don't come close, stay far away", {"farther": 1.0}),  # the same, said twice
    ],
)
def test_what_only_looks_like_a_contradiction_is_none(sentence, weights):
    assert said(sentence).weights == weights


def test_a_denial_in_the_second_half_does_not_turn_the_first_half_round():
    got = said("Halt Abstand, und fahr nicht so schnell", "de")
    assert list(got.weights) == ["farther"]
    assert said("Keep away, and not so fast near me").weights.keys() == {"farther", "slower_near_person"}
    for sentence in ("Keep away, and not so fast", "Stay away from me and don't go so fast"):
        got = said(sentence)
        assert list(got.weights) == ["farther"]
        assert [(one.about, one.offered) for one in got.questions] == [("slowness", ("slower_near_person",))]
    between = said("Komm nah heran, aber halt Abstand, und fahr nicht so schnell", "de")
    assert not between.weights
    assert [question.offered for question in between.questions] == [("closer", "farther"), ("slower_near_person",)]


def test_what_is_not_understood_beside_a_wish_does_not_turn_it_round():
    got = said("Stay away from me and don't rush")
    assert list(got.weights) == ["farther"]
    assert len(got.questions) == 1
    assert list(said("close to me, I don't want").weights) == ["farther"], "a half that only denies still does"


def test_marked_are_the_words_that_moved_the_weights_and_no_others():
    kept = gone = empty = words = 0
    for language in LANGUAGES:
        reader = words_reader(language)
        for one in read_sentences("development", language):
            got = reader.understand(one.sentence)
            for objective in got.weights:
                mine = [mark for mark in got.marks if mark.objective == objective]
                without = one.sentence
                for mark in sorted(mine, key=lambda mark: -mark.start):
                    without = without[: mark.start] + without[mark.end :]
                gone += objective not in reader.understand(without).weights
                kept += objective in reader.understand(without).weights
            marked = [
                word.form for mark in got.marks for word in words_of(one.sentence[mark.start : mark.end], language)
            ]
            words += len(marked)
            empty += sum(word in ("a", "the", "me", "it", "to", "der", "die", "mir", "ich", "zu") for word in marked)
    assert gone / (gone + kept) > 0.85  # 0.79 and 0.82 before only these were marked
    assert empty / words < 0.1


def test_a_bit_weighs_half():
    assert said("A bit more distance please").weights["farther"] == 0.5


@pytest.mark.parametrize("sentence", ["", " ", "?!", "🙂" * 100, "a" * LONGEST, "and, " * 60, "‮\x00far"])
def test_whatever_is_typed_is_read_in_bounded_time(sentence):
    began = time.monotonic()
    said(sentence)
    assert time.monotonic() - began < 20
    with pytest.raises(ValueError, match=str(LONGEST)):
        said("x" * (LONGEST + 1))


def test_what_is_compared_keeps_its_part():
    said_first = "Rather early than far away"
    clauses = clauses_of(said_first, lexicon("en").tokens(said_first), "en")
    assert [(one.role, one.better, [token.form for token in one.tokens]) for one in clauses] == [
        ("main", True, ["rather", "early"]),
        ("lesser", False, ["far away"]),
    ]


@pytest.mark.parametrize("language", LANGUAGES)
def test_two_hundred_test_sentences(language):
    sentences = read_sentences("test", language)
    assert len(sentences) >= 200
    assert len({one.sentence for one in sentences}) == len(sentences)
    assert sum(one.case == "negation" for one in sentences) >= 40


@pytest.mark.parametrize(
    ("sentence", "language", "understood"),
    [
        ("Please don't come close to me, and don't hurry", "en", {"farther": True, "faster": False}),
        ("take your time", "en", {"faster": False}),
        ("less speed more distance", "en", {"faster": False, "farther": True}),
        ("Beeil dich nicht", "de", {"faster": False}),
        ("Bloß keine Eile", "de", {"faster": False}),
        ("It isn't slow enough", "en", {"faster": False}),
        ("Why don't you hurry?", "en", {"faster": True}),
        ("Ich bitte dich, dich nicht zu beeilen", "de", {"faster": False}),
        ("Statt zu rasen, halt lieber Abstand", "de", {"farther": True}),
    ],
)
def test_speed_denied_is_never_read_as_speed(sentence, language, understood):
    got = said(sentence, language)
    assert {mark.objective: mark.wanted for mark in got.marks if not mark.waived} == understood
    assert not got.weights.keys() - {name for name, wanted in understood.items() if wanted}


@pytest.mark.parametrize("sentence", ["Not too fast, not too slow", "Keep far away while passing as close as you can"])
def test_a_contradiction_is_shown_and_asked_back(sentence):
    got = said(sentence)
    assert got.weights == {}
    (asked,) = got.as_dict(sentence)["contradictions"]
    assert len(asked["offered"]) == 2


def test_slowness_in_general_cannot_be_had_and_that_is_asked():
    got = said("Drive slowly")
    assert got.weights == {}
    (asked,) = got.questions
    assert (asked.about, asked.offered) == ("slowness", ("slower_near_person",))
    assert said("Drive slowly when you pass me").weights == {"slower_near_person": 1.0}


def test_an_unknown_word_beside_a_wish_makes_it_a_question():
    got = said("I abhor fast robots")
    assert got.weights == {}
    assert got.questions[0].offered == ("faster", "slower_near_person")


def test_a_sentence_of_the_other_language_is_read_in_it():
    got = said("Please keep your distance", "de")
    assert (got.language, list(got.weights)) == ("en", ["farther"])
    assert said("Komm mir nicht zu nahe", "en").language == "de"
    assert said("Salut, ne viens pas trop près", "en").weights == {}


def test_umlauts_and_slips_of_the_finger():
    assert form_of("größer", "de") == form_of("groesser", "de")
    assert said("Bitte Abstnad halten", "de").weights == {"farther": 1.0}
    assert said("Bitte nciht so nahe kommen", "de").weights == {}, "what may be a mistyped denial is asked back"


def cases_of(written: str, language: Language) -> list[Case]:
    (file,) = Path(__file__).parent.glob(f"{written}_{language}.csv*")
    return read_cases(file)


@pytest.mark.parametrize("language", LANGUAGES)
def test_on_the_development_sentences_no_direction_is_wrong(language):
    found = measure(cases_of("development", language), language)
    assert [case.sentence for case in found["wrong_direction"] + found["wrong_otherwise"]] == []
    assert len(found["right"]) >= 0.95 * sum(map(len, found.values()))
    assert sum(map(len, found.values())) >= 200


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("written", ["fresh", "fresh_b", "fresh_c", "caution", "voices", "orders"])
def test_of_others_sentences_and_of_treacherous_ones_none_is_read_in_the_wrong_direction(written, language):
    """fresh, fresh_b, fresh_c: by writers who knew neither code nor data; caution: comparisons, thresholds,
    descriptions, questions that are none, what was all right; voices: what the robot did, typing errors, mockery;
    orders: short ones, several at once, denied contraries; one German one is still read as more than it says."""
    found = measure(cases_of(written, language), language)
    assert [case.sentence for case in found["wrong_direction"]] == []
    known = ["Fahr bei mir weniger schnell"] if (written, language) == ("orders", "de") else []
    assert [case.sentence for case in found["wrong_otherwise"]] == known
    least = {"fresh": 0.65, "fresh_b": 0.66, "fresh_c": 0.76, "caution": 0.55, "voices": 0.8, "orders": 0.88}[written]
    assert len(found["right"]) >= least * sum(map(len, found.values()))


@pytest.mark.parametrize(
    ("sentence", "language"),
    [
        ("It comes closer than I'd like", "en"),
        ("It rushed past me instead of taking its time", "en"),
        ("Any slower and I'd fall asleep", "en"),
        ("Closer? Never!", "en"),
        ("Twice as far away would still be close enough", "en"),
        ("Er bleibt weiter weg als nötig", "de"),
        ("Für mich war er eher schnell", "de"),
        ("Ohne Tempo geht gar nichts", "de"),
    ],
)
def test_where_two_directions_are_possible_it_is_asked(sentence, language):
    got = said(sentence, language)
    assert got.questions
    assert got.weights == {}


@pytest.mark.parametrize(
    ("sentence", "language", "weights"),
    [
        ("I'd rather it came directly than wander about", "en", {}),
        ("Better too far than too near", "en", {"farther": 1.0}),
        ("Leave the furniture some more space", "en", {"clearance": 1.0}),
        ("Distance, not speed, is what counts for me", "en", {"farther": 1.0}),
        ("Es wäre besser, wenn er nicht so nah kommt, sie erschrickt sonst", "de", {"farther": 1.0}),
    ],
)
def test_comparisons_and_their_parts(sentence, language, weights):
    assert said(sentence, language).weights == weights


def test_not_to_slow_down_because_of_somebody_is_meant_beside_them():
    for sentence in ("Don't brake because of me", "It shouldn't go slower just because I'm standing there"):
        assert [(mark.objective, mark.wanted) for mark in said(sentence).marks] == [("slower_near_person", False)]


@pytest.mark.parametrize(
    ("sentence", "language"),
    [
        ("Wouldn't a detour be nicer?", "en"),
        ("A fast robot at my side makes me wobble.", "en"),
        ("Zoom past me, I love the wind", "en"),
        ("Take the detour and go direct.", "en"),
        ("Why does it always slow down?", "en"),
        ("Wäre ein Umweg nicht schöner?", "de"),
        ("Ein schneller Roboter neben mir macht mich nervös.", "de"),
        ("Volles Tempo, auch an mir vorbei.", "de"),
    ],
)
def test_what_the_whole_sentence_makes_doubtful_is_never_read_as_speed_or_a_way_of_its_own(sentence, language):
    got = said(sentence, language)
    assert got.questions or got.weights == {}
    assert not {"faster", "shorter"} & got.weights.keys()


@pytest.mark.parametrize(
    ("sentence", "language"),
    [("The speed was fine, the distance was fine.", "en"), ("Abstand und Tempo waren genau richtig.", "de")],
)
def test_what_was_all_right_is_no_wish(sentence, language):
    got = said(sentence, language)
    assert (got.marks, got.questions) == ((), ())


def test_right_as_an_adverb_is_no_side():
    assert {mark.objective for mark in said("Stay off the sofa and drive right up to me").marks} <= {
        "clearance",
        "closer",
    }
    assert said("Keep me on your right").weights == {"person_on_right": 1.0}


def wishes(sentence, language):
    return {(mark.objective, mark.wanted) for mark in said(sentence, language).marks if not mark.waived}


@pytest.mark.parametrize(
    ("sentence", "language", "wish"),
    [
        ("Slwo down generally, it scares the cat.", "en", ("faster", False)),
        ("Go fsat!", "en", ("faster", True)),
        ("colser to me please", "en", ("closer", True)),
        ("Stay away from me, keep your distamce", "en", ("farther", True)),
        ("Lagnsamer bitte.", "de", ("faster", False)),
        ("It makes to many detours.", "en", ("shorter", True)),
        ("It came to close to me.", "en", ("farther", True)),
        ("way to slow", "en", ("faster", True)),
    ],
)
def test_typing_errors_are_mended_before_phrases_are_looked_for(sentence, language, wish):
    assert wishes(sentence, language) == {wish}


@pytest.mark.parametrize("word", ["closet", "closed", "master", "show", "snow", "wicht", "kaum", "schlechten"])
def test_another_word_is_no_typing_error(word):
    for language in LANGUAGES:
        assert not {"near", "slow", "fast", "smooth"} & lexicon(language).tokens(word)[0].senses
    assert wishes("I prefer slow to fast", "en") == {("faster", False)}, "here `to` is not `too`"


@pytest.mark.parametrize(
    ("sentence", "language", "wish"),
    [
        ("Please tell it to calm down, it was racing through the room like it was late.", "en", ("faster", False)),
        ("It does everything in such a rush. I don't like it.", "en", ("faster", False)),
        ("It kept rushing around", "en", ("faster", False)),
        ("It zoomed along and I loved it.", "en", ("faster", True)),
        ("It crept through the room. Faster please.", "en", ("faster", True)),
        ("Der ist gerast, das hat mir Angst gemacht.", "de", ("faster", False)),
        ("Er hat dauernd Umwege gemacht, das stört mich.", "de", ("shorter", True)),
        ("Er kam mir viel zu nah.", "de", ("farther", True)),
        ("Mach mal sachte.", "de", ("faster", False)),
    ],
)
def test_what_is_told_with_a_verdict_is_a_wish(sentence, language, wish):
    assert wishes(sentence, language) == {wish}
    assert [one.about for one in said(sentence, language).questions] in ([], ["slowness"])


@pytest.mark.parametrize(
    ("sentence", "language"),
    [
        ("It was racing through the room.", "en"),
        ("It doesn't keep its distance.", "en"),
        ("It never slows down near me.", "en"),
        ("It wouldn't slow down", "en"),
        ("It likes to go fast.", "en"),
        ("It came close and raced.", "en"),
        ("My husband likes it fast, I don't", "en"),
        ("Who needs speed?", "en"),
        ("Er hält keinen Abstand.", "de"),
        ("Langsamer geht es wohl nicht.", "de"),
        ("Dieses Gerase!", "de"),
        ("Abstand ja, Tempo nein", "de"),
        ("Niemand hetzt dich.", "de"),
    ],
)
def test_what_is_told_without_a_verdict_is_asked_back(sentence, language):
    assert said(sentence, language).questions
    assert not {"faster", "closer", "slower_near_person"} & said(sentence, language).weights.keys()
    assert ("faster", False) not in wishes(sentence, language)


class Doubting:
    """A second reader that doubts whatever it is told to."""

    def __init__(self, turned=(), unsaid=()):
        self.given = Doubts(frozenset(turned), frozenset(unsaid))

    def doubts(self, text, tokens):
        return self.given


def doubted(sentence, **doubts):
    return WordsReader("en", lambda _: Doubting(**doubts)).understand(sentence)


def test_a_wish_that_the_second_reader_doubts_is_asked_back():
    got = doubted("Keep your distance and be quick", turned=[("farther", True)])
    assert list(got.weights) == ["faster"]
    assert [one.offered for one in got.questions] == [("farther", "closer")]


def test_a_wrong_direction_becomes_a_question():
    sentence = "Less of a gap between us"  # the rules read the contrary
    assert WordsReader("en", lambda _: None).understand(sentence).weights == {"farther": 1.0}
    got = said(sentence)
    assert (got.weights, [one.offered for one in got.questions]) == ({}, [("farther", "closer")])


def test_that_nothing_is_said_does_not_count_against_a_short_clause_of_known_words():
    unsaid = [("farther", True)]
    assert doubted("Keep your distance", unsaid=unsaid).weights == {"farther": 1.0}
    long = "I would like it to always keep a large distance from all the people here"
    assert said(long).weights == {"farther": 1.0}
    assert doubted(long, unsaid=unsaid).weights == {}


def test_a_contradiction_stays_one_whatever_is_doubted():
    for turned in ([], [("closer", True)], [("farther", True)], [("closer", True), ("farther", True)]):
        (asked,) = doubted("near but far", turned=turned).questions
        assert (asked.about, asked.offered) == ("contradiction", ("closer", "farther"))


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_second_reader_adds_no_wish_and_moves_no_weight_but_to_ask(language):
    alone = WordsReader(language, lambda _: None)
    for name in ("fresh", "fresh_b", "fresh_c", "caution", "voices", "development", "orders"):
        for case in cases_of(name, language):
            before, after = alone.understand(case.sentence), said(case.sentence, language)
            assert after.weights.keys() <= before.weights.keys(), case.sentence
            assert set(after.marks) <= set(before.marks), case.sentence
            assert after.marks == before.marks or after.questions, case.sentence


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_second_reader_takes_linear_time_and_loads_without_the_laboratory(language):
    second = second_reader(language)

    def features(text):
        began = time.process_time()
        hash_features(text, lexicon(language).tokens(text), language)
        return time.process_time() - began

    word = "a" * LONGEST_WORD + " "
    short, long = (min(features(word * many) for _ in range(5)) for many in (MOST_WORDS // 4, MOST_WORDS))
    assert long < 4 * 3 * short
    assert second.log_odds("", []).shape == (len(ENDS), 2)
    loaded = "import sys; from desirepath.learning.words.second_reader import second_reader as one; "
    loaded += f"one({language!r}); sys.exit('sklearn' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", loaded], check=False).returncode == 0
