"""The reference pages are what the code says, and the profile on them can be copied."""

import importlib.util
import re
from pathlib import Path

import pytest

from saltus.effects.effect import Effect
from saltus.effects.profile import EFFECTS, Profile
from saltus.wire import schemas
from saltus.wire.events import CODES
from saltus.wire.messages import ControllerMode, HeightmapStatus
from saltus.wire.topics import TOPICS

ROOT = Path(__file__).parents[2]
_spec = importlib.util.spec_from_file_location("reference", ROOT / "tools" / "reference.py")
assert _spec is not None
assert _spec.loader is not None
reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(reference)
PAGES: dict[str, str] = reference.pages()


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_those_that_the_code_makes(page: str) -> None:
    assert (ROOT / "docs" / "reference" / page).read_text() == PAGES[page], (
        "run python tools/reference.py"
    )


def test_every_effect_topic_and_field_is_explained() -> None:
    for name in EFFECTS:
        assert f"\n### {name}\n" in PAGES["effects.md"]
    for topic in TOPICS.values():
        assert f"| `{topic.name}` |" in PAGES["messages.md"]
        for field in schemas.FIELDS.get(topic.message, ()):
            assert field.definition in PAGES["messages.md"]


def test_every_event_that_a_process_sends_is_explained_and_no_other() -> None:
    """By the source: what follows `event(` and its like is a code,
    or made of one of an enumeration.
    """
    rooms = ("saltus", "render", "heightmap", "policy", "controller")
    sources = [
        path.read_text()
        for room in rooms
        for path in (ROOT / room).rglob("*.py")
        if path.name != "events.py"
    ]
    sent = {
        code
        for text in sources
        for code in re.findall(r"""\b(?:_?event|_tell)\(\s*"(\w+)\"""", text)
    }
    assert len(sent) >= 10
    assert sent <= CODES.keys()
    made = {code for code in CODES if re.match(r"mode_|heightmap_(ok|warming|degraded)$", code)}
    assert len(made) == len(ControllerMode) + len(HeightmapStatus) - 1
    assert [
        code for code in CODES.keys() - made if not any(f'"{code}"' in text for text in sources)
    ] == []
    assert all(f"| `{code}` |" in PAGES["messages.md"] for code in CODES)


def test_the_profile_to_copy_is_one_without_effect() -> None:
    profile = Profile.from_toml(reference.null_profile())
    effects: list[Effect[object]] = [
        e for part in ("actuator", "body", "imu", "camera") for e in getattr(profile, part)
    ]
    assert len(effects) > 20
    assert all(effect.is_null() for effect in effects)
