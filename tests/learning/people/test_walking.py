"""Somebody outside the list walks a whole study, marked as simulated, by name."""

from __future__ import annotations

from desirepath.study.simulated.participant import Character


def test_a_family_gives_every_bot_its_next_member_and_the_data_say_who_it_was() -> None:
    character = Character(oracle="network,shortest,context")
    character.check()
    assert [character.preference(number) for number in range(6)] == [
        "network:0", "shortest", "context:0", "network:1", "shortest", "context:1",
    ]  # fmt: skip
    assert character.as_stored(3)["name"] == "network:1"
