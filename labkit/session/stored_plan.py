"""The plan in a session's folder: as it was run, with the target's picture beside it, both held by their checksums."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labkit.errors import SessionError, printable
from labkit.files import (
    check_name,
    checksum_problem,
    copy_durably,
    sha256_of,
    write_atomically,
)
from labkit.plan import Plan
from labkit.plan.text import read_text
from labkit.session.journal import Event

PLAN = "plan.toml"


@dataclass(frozen=True, slots=True)
class PlanSource:
    """A plan to begin a session with: its TOML, the folder that file names in it are relative to, what to call it."""

    plan: Plan
    text: str
    folder: Path
    name: str


def plan_source(plan: Plan | Path | str) -> PlanSource:
    """Of a plan made in Python, or of one in a file, whose text is kept as it stands. Raises PlanError."""
    if isinstance(plan, Plan):
        return PlanSource(plan, plan.to_toml(), Path(), "given")
    path = Path(plan)
    return PlanSource(Plan.load(path), read_text(path), path.parent, str(path))


def store_plan(plan: Plan, text: str, folder: Path, taken: Sequence[str]) -> dict[str, str]:
    """Write plan.toml, and the target's picture beside it; what the "created" event holds of them.

    taken: names in the folder that a picture may not have. Raises SessionError where `text` names the picture in another
    way than by one plain string.
    """
    fields = {}
    if plan.target.file is not None:
        name = re.sub(r"[^A-Za-z0-9._-]", "_", plan.target.file.name).lstrip(".")
        name = name if name not in (*taken, PLAN, "") else f"target-{name}"
        text = _with_target_file(text, name)
        fields["target_sha256"] = copy_durably(plan.target.file, folder / check_name(name))
        fields["target_file"] = name
        fields["target_source"] = printable(str(plan.target.file))
    write_atomically(folder / PLAN, text.encode())
    return {**fields, "plan_sha256": hashlib.sha256(text.encode()).hexdigest()}


def plan_as_run(folder: Path, planned: Event) -> Plan:
    """The plan in a session's folder. planned: the "created" or "replanned" event that belongs to it.

    Raises SessionError if plan or picture are not as they were then.
    """
    if damage := plan_damage(folder, planned):
        raise SessionError(
            f"{'; '.join(damage)}: a session's plan stays as it was run; restore it, or analyse with another one: "
            f"labkit fit {folder} --plan OTHER.toml"
        )
    return Plan.load(folder / PLAN)


def plan_damage(folder: Path, planned: Event) -> list[str]:
    """What is wrong with the plan and its target's picture, a line each."""
    files = ((PLAN, "plan_sha256"), (planned.get("target_file"), "target_sha256"))
    problems = (
        checksum_problem(folder / name, planned.get(key, "")) for name, key in files if name
    )
    return [problem for problem in problems if problem]


def changed_tables(begun: Plan, now: Plan) -> list[str]:
    """The tables in which two plans differ, a target's picture compared by content."""
    plans = [begun, now]
    if (
        begun.target.file
        and now.target.file
        and sha256_of(begun.target.file) == sha256_of(now.target.file)
    ):
        plans = [
            plan.model_copy(
                update={"target": plan.target.model_copy(update={"file": None})}
            )
            for plan in plans
        ]
    return [
        name
        for name in Plan.model_fields
        if getattr(plans[0], name) != getattr(plans[1], name)
    ]


def _with_target_file(text: str, name: str) -> str:
    """The plan with [target] file = name, all else as it was, comments too.

    Raises SessionError where the file's name is not written as a plain one-line string.
    """
    wanted = tomllib.loads(text)
    if wanted["target"]["file"] == name:
        return text
    wanted["target"]["file"] = name
    for literal in re.finditer(r"\"(?:[^\"\\\n]|\\.)*\"|'[^'\n]*'", text):
        changed = f'{text[: literal.start()]}"{name}"{text[literal.end() :]}'
        try:
            if tomllib.loads(changed) == wanted:
                return changed
        except tomllib.TOMLDecodeError:
            continue
    raise SessionError(
        "plan: target.file must be written as one plain string on its own line"
    )
