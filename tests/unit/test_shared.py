"""Parts that devices share: one for all who lease it, ended after the last."""

from __future__ import annotations

from labkit.devices.shared import SharedParts


def test_a_part_is_made_once_and_ended_after_its_last_user() -> None:
    ended: list[str] = []
    parts = SharedParts()
    first = parts.lease("a", lambda: "made first", ended.append)
    second = parts.lease("a", lambda: "made second", ended.append)
    assert first.part == second.part == "made first"
    first.close()
    first.close()  # again does nothing
    assert (parts.items(), ended) == ((("a", "made first"),), [])
    second.close()
    assert (parts.items(), ended) == ((), ["made first"])
    assert parts.lease("a", lambda: "made again").part == "made again"


def test_a_part_that_the_caller_gave_is_used_and_never_ended() -> None:
    ended: list[str] = []
    parts = SharedParts({"a": "given"})
    lease = parts.lease("a", lambda: "made", ended.append)
    lease.close()
    assert (lease.part, ended, parts.values()) == ("given", [], ("given",))


def test_a_part_that_cannot_be_made_leaves_nothing() -> None:
    parts = SharedParts()
    try:
        parts.lease("a", lambda: 1 // 0)
    except ZeroDivisionError:
        assert parts.items() == ()
