"""The validated scales that are shipped, word by word, with their scoring, source and terms.

Only wordings that may be shipped, each in the languages that we could check; the words are the scales' own and are
never changed. Of Godspeed we found no terms that allow to ship its words: who asks it supplies them, what is here is
how it is built and scored. RoSAS, MDMT, HRIES, the TiA of Körber and German wordings of trust scales are left out.
"""

from __future__ import annotations

from desirepath.analysis.scales import Scale, ScaleItem

_AGREE_LOW = {"en": "Strongly disagree", "de": "Stimme überhaupt nicht zu"}
_AGREE_HIGH = {"en": "Strongly agree", "de": "Stimme voll zu"}
_SUS = (
    (
        "I think that I would like to use this system frequently.",
        "Ich kann mir sehr gut vorstellen, das System regelmäßig zu nutzen.",
    ),
    ("I found the system unnecessarily complex.", "Ich empfinde das System als unnötig komplex."),
    ("I thought the system was easy to use.", "Ich empfinde das System als einfach zu nutzen."),
    (
        "I think that I would need the support of a technical person to be able to use this system.",
        "Ich denke, dass ich technischen Support brauchen würde, um das System zu nutzen.",
    ),
    (
        "I found the various functions in this system were well integrated.",
        "Ich finde, dass die verschiedenen Funktionen des Systems gut integriert sind.",
    ),
    (
        "I thought there was too much inconsistency in this system.",
        "Ich finde, dass es im System zu viele Inkonsistenzen gibt.",
    ),
    (
        "I would imagine that most people would learn to use this system very quickly.",
        "Ich kann mir vorstellen, dass die meisten Leute das System schnell zu beherrschen lernen.",
    ),
    ("I found the system very cumbersome to use.", "Ich empfinde die Bedienung als sehr umständlich."),
    (
        "I felt very confident using the system.",
        "Ich habe mich bei der Nutzung des Systems sehr sicher gefühlt.",
    ),
    (
        "I needed to learn a lot of things before I could get going with this system.",
        "Ich musste eine Menge Dinge lernen, bevor ich mit dem System arbeiten konnte.",
    ),
)
_TLX = (
    ("mental_demand", "How mentally demanding was the task?", "Very Low", "Very High"),
    ("physical_demand", "How physically demanding was the task?", "Very Low", "Very High"),
    ("temporal_demand", "How hurried or rushed was the pace of the task?", "Very Low", "Very High"),
    (
        "performance",
        "How successful were you in accomplishing what you were asked to do?",
        "Perfect",
        "Failure",
    ),
    ("effort", "How hard did you have to work to accomplish your level of performance?", "Very Low", "Very High"),
    (
        "frustration",
        "How insecure, discouraged, irritated, stressed, and annoyed were you?",
        "Very Low",
        "Very High",
    ),
)

_TRUST = (  # agreeing with the first five lowers the score
    "The system is deceptive.",
    "The system behaves in an underhanded manner.",
    "I am suspicious of the system's intent, action, or outputs.",
    "I am wary of the system.",
    "The system's actions will have a harmful or injurious outcome.",
    "I am confident in the system.",
    "The system provides security.",
    "The system has integrity.",
    "The system is dependable.",
    "The system is reliable.",
    "I can trust the system.",
    "I am familiar with the system.",
)
_SHORT_TRUST = (6, 10, 11)
_LIKEABILITY = ("like", "friendly", "kind", "pleasant", "nice")
_INTELLIGENCE = ("competent", "knowledgeable", "responsible", "intelligent", "sensible")
_MCGRATH = (
    "McGrath, M. J., Lack, O., Tisch, J. and Duenser, A. (2025). Measuring trust in artificial intelligence: "
    "validation of an established scale and its short form. Frontiers in Artificial Intelligence 8, 1582880"
)
_BARTNECK = (
    "Bartneck, C., Kulic, D., Croft, E. and Zoghbi, S. (2009). Measurement instruments for the anthropomorphism, "
    "animacy, likeability, perceived intelligence, and perceived safety of robots. International Journal of Social "
    "Robotics 1, 71-81"
)


def _trust_item(number: int) -> ScaleItem:
    text = {"en": _TRUST[number - 1]}
    return ScaleItem(f"trust_{number}", text, {"en": "Not at all"}, {"en": "Extremely"}, reversed=number <= 5)


def _godspeed(name: str, words: str, keys: tuple[str, ...]) -> Scale:
    return Scale(
        name=name,
        names=(f"Godspeed {words}",),
        points=5,
        items=tuple(ScaleItem(f"{name}_{key}", {}, {}, {}) for key in keys),
        lowest=1.0,
        highest=5.0,
        scoring="the mean of the five pairs of words: 1 to 5",
        source=_BARTNECK,
        licence="no terms found that allow to ship its words: who asks it supplies them and knows the terms",
    )


SCALES: dict[str, Scale] = {
    scale.name: scale
    for scale in (
        Scale(
            name="sus",
            names=("SUS", "System Usability Scale"),
            points=5,
            items=tuple(
                ScaleItem(f"sus_{n}", {"en": en, "de": de}, _AGREE_LOW, _AGREE_HIGH, reversed=n % 2 == 0)
                for n, (en, de) in enumerate(_SUS, 1)
            ),
            lowest=0.0,
            highest=100.0,
            scoring="odd items: answer - 1, even items: 5 - answer; the sum times 2.5: 0 to 100",
            source="Brooke, J. (1996). SUS: a 'quick and dirty' usability scale. In Usability Evaluation in Industry, "
            "189-194; German: Rummel, B. (2015), System Usability Scale - jetzt auch auf Deutsch",
            licence="free to use where the source is named (Brooke, J. (2013). SUS: a retrospective. Journal of "
            "Usability Studies 8, 29-40)",
        ),
        Scale(
            name="raw_tlx",
            names=("TLX", "RTLX", "NASA-TLX", "NASA TLX", "Task Load Index"),
            points=21,
            items=tuple(
                ScaleItem(f"tlx_{key}", {"en": text}, {"en": low}, {"en": high}) for key, text, low, high in _TLX
            ),
            lowest=0.0,
            highest=100.0,
            scoring="each of 21 gradations is 5 points, 0 to 100; the mean of the six, unweighted: 0 to 100",
            source="Hart, S. G. and Staveland, L. E. (1988). Development of NASA-TLX. In Human Mental Workload, "
            "139-183; unweighted: Hart, S. G. (2006), NASA-Task Load Index: 20 years later",
            licence="a work of the United States government, free to use",
        ),
        Scale(
            name="tias",
            names=("TIAS", "Trust in Automation Scale"),
            points=7,
            items=tuple(map(_trust_item, range(1, len(_TRUST) + 1))),
            lowest=1.0,
            highest=7.0,
            scoring="the mean of the twelve, the first five turned round (8 - answer): 1 to 7",
            source="Jian, J.-Y., Bisantz, A. M. and Drury, C. G. (2000). Foundations for an empirically determined "
            "scale of trust in automated systems. International Journal of Cognitive Ergonomics 4, 53-71; wording as "
            f"in {_MCGRATH}",
            licence="printed in articles of Frontiers, which publishes all of them under CC BY 4.0 (also in "
            "doi:10.3389/fpsyg.2023.1078438, table 2); terms of the article of 2000 not found; name the sources",
        ),
        Scale(
            name="s_tias",
            names=("S-TIAS", "Short Trust in Automation Scale"),
            points=7,
            items=tuple(map(_trust_item, _SHORT_TRUST)),
            lowest=1.0,
            highest=7.0,
            scoring="the mean of the three: 1 to 7",
            source=_MCGRATH,
            licence="CC BY 4.0, as all articles of Frontiers; name the source",
        ),
        _godspeed("godspeed_likeability", "III: Likeability", _LIKEABILITY),
        _godspeed("godspeed_intelligence", "IV: Perceived Intelligence", _INTELLIGENCE),
    )
}
