"""Rights on a run's bus: a router's access list, from the publishers and readers in `topics`."""

from collections.abc import Mapping
from typing import Literal

from saltus.wire.topics import SHARED, TOPICS

PROCESSES = ("render", "heightmap", "scan", "policy", "controller")
LISTENERS = ("recorder", "viewer", "operator")
"""They may read everything."""
ROLES = PROCESSES + LISTENERS
_SPEAKERS = (*PROCESSES, "operator")  # under topics where every process has a key of its own
_EVERYTHING = [
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
    "liveliness_token",
    "liveliness_query", "declare_liveliness_subscriber",
]  # fmt: skip


def keys(role: str, verb: Literal["put", "subscribe"], prefix: str) -> list[str]:
    """The keys of a robot that a role may put to or subscribe to.

    Nobody may get, as nothing answers queries.
    """
    if verb == "subscribe" and role in LISTENERS:
        return [f"{prefix}/**", f"{prefix}/{SHARED}"]
    found = []
    for topic in TOPICS.values():
        key, every = f"{prefix}/{topic.name}", topic.publisher == "*"
        if verb == "put" and every and role in _SPEAKERS:
            found.append(f"{key}/{role}")
        elif role in topic.readers if verb == "subscribe" else role == topic.publisher:
            found += [] if every else [key]
            found += [f"{key}/*"] if every or topic.named else []
    return found


def access_control(names: Mapping[str, str], prefix: str) -> dict[str, object]:
    """Zenoh's `access_control`: what is not allowed here is denied.

    The owner of the router may do everything.

    Args:
        names: Role of each certificate, by the common name in it.
        prefix: Of the robot's keys.
    """
    rules: list[dict[str, object]] = [
        _rule("everything", _EVERYTHING, ["ingress", "egress"], ["**", f"**/{SHARED}"])
    ]
    subjects: list[dict[str, object]] = [{"id": "owner", "link_protocols": ["unixsock-stream"]}]
    policies = [{"rules": ["everything"], "subjects": ["owner"]}]
    for role in ROLES:
        members = [name for name, its in names.items() if its == role]
        if not members:
            continue
        own = []
        if puts := keys(role, "put", prefix):
            own += [
                _rule(f"{role} puts", ["put"], ["ingress"], puts),
                # A publisher sends only what somebody is known to subscribe to, and a recorder does
                # to everything
                _rule(f"{role} is told of subscribers", ["declare_subscriber"], ["egress"], ["**"]),
            ]
        if reads := keys(role, "subscribe", prefix):
            own += [
                _rule(f"{role} subscribes", ["declare_subscriber"], ["ingress"], reads),
                _rule(f"{role} is sent", ["put"], ["egress"], reads),
            ]
        rules += own
        subjects.append({"id": role, "cert_common_names": members, "link_protocols": ["tls"]})
        policies.append({"rules": [str(rule["id"]) for rule in own], "subjects": [role]})
    return {
        "enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects,
        "policies": policies,
    }  # fmt: skip


def _rule(
    name: str, messages: list[str], flows: list[str], expressions: list[str]
) -> dict[str, object]:
    return {
        "id": name,
        "messages": messages,
        "flows": flows,
        "permission": "allow",
        "key_exprs": expressions,
    }
