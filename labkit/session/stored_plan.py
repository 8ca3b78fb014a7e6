"""Store the plan in a session's folder, as run, with the target's picture and both checksums."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from labkit.errors import SessionError, printable
from labkit.plan import Plan
from labkit.plan.text import read_text
from labkit.session.journal import Event
from labkit.storage.files import (
    check_name,
    checksum_problem,
    copy_durably,
    sha256_of,
    write_atomically,
)

PLAN_FILE = "plan.toml"


@dataclass(frozen=True, slots=True)
class PlanSource:
    """A plan for a new session: its TOML, the folder of the files it names, and its name for messages."""

    plan: Plan
    text: str
    folder: Path
    name: str


def plan_source(plan: Plan | Path | str) -> PlanSource:
    """Return the source of a plan made in Python, or of a file, whose text is kept unchanged.

    Raises PlanError.
    """
    if isinstance(plan, Plan):
        return PlanSource(plan, plan.to_toml(), Path(), "given")
    path = Path(plan)
    return PlanSource(Plan.load(path), read_text(path), path.parent, str(path))


def store_plan(plan: Plan, text: str, folder: Path, taken: Sequence[str]) -> dict[str, str]:
    """Write plan.toml and the target's picture; return their entry for the "created" event.

    taken: names in the folder that a picture may not have. Raises SessionError unless
    `text` names the picture by one plain string.
    """
    fields = {}
    if plan.target.file is not None:
        name = re.sub(r"[^A-Za-z0-9._-]", "_", plan.target.file.name).lstrip(".")
        name = name if name not in (*taken, PLAN_FILE, "") else f"target-{name}"
        text = _with_target_file(text, name)
        fields["target_sha256"] = copy_durably(plan.target.file, folder / check_name(name))
        fields["target_file"] = name
        fields["target_source"] = printable(str(plan.target.file))
    write_atomically(folder / PLAN_FILE, text.encode())
    return {**fields, "plan_sha256": hashlib.sha256(text.encode()).hexdigest()}


def plan_as_run(folder: Path, planned: Event) -> Plan:
    """Return the plan in a session's folder.

    planned: the "created" or "replanned" event of the plan. Raises SessionError if plan or
    picture changed since.
    """
    if damage := plan_damage(folder, planned):
        raise SessionError(
            f"{'; '.join(damage)}: a session's plan stays as it was run; restore it, or analyse with another one: "
            f"labkit fit {folder} --plan OTHER.toml"
        )
    return Plan.load(folder / PLAN_FILE)


def plan_damage(folder: Path, planned: Event) -> list[str]:
    """Return the faults of the plan and its target's picture, one line each."""
    files = ((PLAN_FILE, "plan_sha256"), (planned.get("target_file"), "target_sha256"))
    problems = (
        checksum_problem(folder / name, planned.get(key, "")) for name, key in files if name
    )
    return [problem for problem in problems if problem]


def changed_tables(begun: Plan, now: Plan) -> list[str]:
    """Return the tables in which two plans differ, a target's picture compared by content."""
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
    """Return the plan with [target] file = name and the rest unchanged, comments too.

    Raises SessionError unless the file's name is a plain one-line string.
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
