"""A study as tidy rows, ready to be analysed: who took part, what they chose, rated, ranked. Pure.

Where the rows come from (a data set on disk, this installation's tables) is `tidy_tables.py`'s.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from desirepath.analysis.scales import Scale
from desirepath.learning.rules.rule import Rule
from desirepath.simulation.trajectory import Trajectory

PROBES = ("repeat", "swap")  # roles of queries that are asked again
FARTHEST = 3.0  # of two vectors of nine weights from 0 to 1
TRIAD = "transitivity"  # role of the three pairs of three trajectories
FACTORS = ("outline", "lidar")  # of explanations (chapter 8)
AWARENESS = ("perception", "intelligibility", "prediction")
"""How the keys of the items begin whose mean, the reversed ones inverted, is the awareness score (two of each)."""
Load = Callable[[str], Trajectory]
"""A trajectory by its id."""


@dataclass(frozen=True)
class ParticipantRow:
    """state: of the last session (completed, active, paused, expired, none). order: the conditions as they came.
    groups: stage -> what of a block's `one_of` this participant meets, levels joined by "-". own_policy: what became of
    the policy made from their answers (shown, not_surely_better, ...), None where none was to be made. further: answers
    to pairs that were asked on since it was not surely theirs (`ask_on`); they taught and are in no analysis."""

    code: str
    simulated: bool
    excluded: str | None
    withdrawn: bool
    state: str
    order: tuple[str, ...]
    groups: Mapping[str, str] = field(default_factory=dict)
    own_policy: str | None = None
    further: int = 0


@dataclass(frozen=True)
class Choice:
    """One answered query. first, second: trajectories in the order they were shown; chosen: which of these two.
    device: what it was answered on, as far as the page reported; `headset` (all, partly): watched with one."""

    person: str
    condition: str
    view: str
    query: str
    role: str
    first: str
    second: str
    chosen: str
    decision_s: float | None
    device: Mapping[str, Any] = field(default_factory=dict)

    @property
    def rejected(self) -> str:
        return self.first if self.second_chosen else self.second

    @property
    def second_chosen(self) -> bool:
        return self.chosen == self.second


@dataclass(frozen=True)
class Degree:
    """How clear the answer to one regular pair was, where that was asked: slight, clear or no_difference; None: it was
    A or B, where there could be no difference."""

    person: str
    condition: str
    degree: str | None


@dataclass(frozen=True)
class SeveralAnswer:
    """One answer to several trajectories of a scene. ask: order, best or groups; of: how many; best: the number of the
    one that was liked best, None where a pile of several was."""

    person: str
    condition: str
    ask: str
    of: int
    best: int | None
    decision_s: float | None


@dataclass(frozen=True)
class MarkedDrive:
    """One trajectory that was watched to mark moments in it. marks: (seconds to the tap, why), why None where nobody
    said."""

    person: str
    condition: str
    trajectory: str
    marks: tuple[tuple[float, str | None], ...]


@dataclass(frozen=True)
class Rating:
    """One item of a questionnaire. condition: the block that it was about, None outside blocks. value: as answered; a
    ranking's is the list of options, best first. asking: the stage that asked, which tells before from after.
    """

    person: str
    condition: str | None
    questionnaire: str
    item: str
    value: Any
    asking: str = ""


def find_askings(ratings: Iterable[Rating]) -> dict[str, set[str]]:
    """Questionnaire -> the stages outside blocks that asked it: two where it was asked before and after."""
    askings: dict[str, set[str]] = defaultdict(set)
    for rating in ratings:
        if rating.condition is None:
            askings[rating.questionnaire].add(rating.asking)
    return askings


def find_topic(rating: Rating, topics: Mapping[str, set[str]]) -> str:
    """What a rating is about: its condition; outside blocks "", or its asking where there are several."""
    if rating.condition is not None:
        return rating.condition
    return rating.asking if len(topics[rating.questionnaire]) > 1 else ""


@dataclass(frozen=True)
class Comparison:
    """One blind comparison of two policies. chosen, rejected: arms (own, base, other, neutral,
    population). opponent: what is the same for equal policies that stood against the own one, where the data set tells.
    stand_in: it was made from a simulated person's answers. earlier: so many people's want is the population's, where
    the data set tells."""

    person: str
    chosen: str
    rejected: str
    look_alike: bool
    opponent: str | None = None
    stand_in: bool = False
    earlier: int | None = None


@dataclass(frozen=True)
class Guess:
    """Whether a person guessed which of the last pair came from their own answers."""

    person: str
    right: bool


@dataclass(frozen=True)
class Meeting:
    """A person met their robot, after everything blind. agreement: 1 to 5; distance: from learned to corrected
    weights."""

    person: str
    agreement: int
    corrected: bool
    distance: float


@dataclass(frozen=True)
class MethodChoice:
    """One blind comparison of the robots of two methods. chosen, rejected: the methods."""

    person: str
    chosen: str
    rejected: str
    look_alike: bool


@dataclass(frozen=True)
class Taught:
    """What a method taught of one person. weights: objective -> weight above 0 that its robot was conditioned on.
    seconds: from the answer before the method's first thing to do to that of its last; None: not known."""

    person: str
    method: str
    weights: Mapping[str, float]
    seconds: float | None


@dataclass(frozen=True)
class ToldRules:
    """The rules that one person told. read: which stand as their sentence was read; picked: of those shown obeyed and
    broken which was picked as meant (obeyed, broken, neither); places: in how many homes; edits: changes after telling.
    """

    person: str
    rules: tuple[Rule, ...]
    read: Sequence[bool]
    picked: Sequence[str]
    edits: int
    places: int


@dataclass(frozen=True)
class ImportanceRanking:
    """One trial of chapter 8. ranking: the scene's objects, or people, the most important first. scores: of each, how
    much it moved the robot, or was attended to, where it stood, 0 to 1. outline, lidar, attention: what of that was
    shown. role: `regular` counts."""

    person: str
    condition: str
    query: str
    role: str
    outline: bool
    lidar: bool
    ranking: Sequence[str]
    scores: Mapping[str, float]
    decision_s: float | None = None
    attention: bool = False


@dataclass(frozen=True)
class ItemText:
    """An item as its questionnaire words it, in the report's language. options: value -> label. lowest, points: the
    ends of its scale; type `score`: of a validated scale of several items.

    instructed: an attention check, whose answer is no opinion; it is in no rating.
    """

    questionnaire: str
    key: str
    type: str
    text: str
    points: int
    options: Mapping[str, str]
    reversed: bool = False
    instructed: bool = False
    lowest: float = 1.0


OF_PEOPLE = [
    "choices", "degrees", "several", "ratings", "comparisons", "guesses", "meetings", "importance", "method_choices",
    "taught", "told_rules", "marked",
]  # fmt: skip
"""What of a study's data are rows of somebody's."""


@dataclass(frozen=True)
class StudyData:
    """Everybody of a study with all that they answered; nobody is left out yet. protocol: the frozen copy, plain.
    newest: the same of its latest version, None where the study was never revised. scales: validated scales with the
    questionnaire that each stands in."""

    name: str
    study: str
    protocol: Mapping[str, Any]
    protocol_hash: str
    items: Sequence[ItemText]
    people: Sequence[ParticipantRow]
    choices: Sequence[Choice]
    ratings: Sequence[Rating]
    comparisons: Sequence[Comparison]
    newest: Mapping[str, Any] | None = None
    scales: Sequence[tuple[str, Scale]] = ()
    guesses: Sequence[Guess] = ()
    meetings: Sequence[Meeting] = ()
    importance: Sequence[ImportanceRanking] = ()
    method_choices: Sequence[MethodChoice] = ()
    taught: Sequence[Taught] = ()
    degrees: Sequence[Degree] = ()
    told_rules: Sequence[ToldRules] = ()
    several: Sequence[SeveralAnswer] = ()
    marked: Sequence[MarkedDrive] = ()

    def of(self, codes: set[str]) -> StudyData:
        """The same study with only these people's answers; `people` stays whole."""
        rows: dict[str, Any] = {name: [row for row in getattr(self, name) if row.person in codes] for name in OF_PEOPLE}
        return replace(self, **rows)

    @property
    def conditions(self) -> tuple[str, ...]:
        """What is compared, by the alphabet, so that no table depends on who came first: the conditions of regular
        queries, or of importance rankings; without either those that were rated, as an evaluation's controllers. Ways
        of telling the robot are conditions, of which choosing is one."""
        if self.taught:
            return tuple(sorted({lesson.method for lesson in self.taught}))
        queried = {choice.condition for choice in self.choices if choice.role == "regular"}
        queried |= {ranking.condition for ranking in self.importance if ranking.role == "regular"}
        return tuple(sorted(queried or {rating.condition for rating in self.ratings if rating.condition is not None}))

    def item(self, questionnaire: str, key: str) -> ItemText:
        """The item's words; its key where the questionnaire's file is not there."""
        texts = (item for item in self.items if (item.questionnaire, item.key) == (questionnaire, key))
        return next(texts, ItemText(questionnaire, key, "scale", key.replace("_", " "), 7, {}))

    def place(self, questionnaire: str, key: str) -> int:
        """Where the item stands among all; items whose file is not there come last, in the order they were met."""
        keys = [(item.questionnaire, item.key) for item in self.items]
        return keys.index((questionnaire, key)) if (questionnaire, key) in keys else len(keys)
