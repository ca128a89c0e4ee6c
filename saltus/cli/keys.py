"""`saltus keys`: who may join a run over a network."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from saltus.cli.output import JsonOption, print_json
from saltus.flags import CommandGroup, Subcommands

DAYS = 365


@dataclass(frozen=True, kw_only=True)
class _KeysOption:
    keys: Path = Path("keys")
    """Folder of the authority."""


@dataclass(frozen=True, kw_only=True)
class Init(_KeysOption):
    """Makes an authority in a folder, and the certificate of a router.

    Example: saltus keys init --address 192.168.123.10:7447
    """

    address: str
    """Address of the router's machine, as others reach it: host:port."""
    days: int = DAYS
    """Days for which the router's certificate holds."""

    def run(self) -> int:
        """Writes the folder; 0."""
        from saltus.wire.certificates import create_authority

        create_authority(self.keys, self.address, self.days)
        print(
            f"an authority in {self.keys}, and a router's certificate for {self.address}, "
            f"{self.days} days"
        )
        keys = f"--keys {self.keys}"
        print(f"next: saltus keys issue viewer {keys}; saltus up --listen {self.address} {keys}")
        return 0


@dataclass(frozen=True, kw_only=True)
class Issue(_KeysOption):
    """Makes a certificate for a role: one file, with which any Zenoh program joins.

    A role may publish and subscribe to its own keys only: render, heightmap, scan, policy and
    controller what the process of that name does; recorder, viewer and operator read everything.

    Example: saltus keys issue viewer
    """

    role: tyro.conf.Positional[
        Literal[
            "render", "heightmap", "scan", "policy", "controller", "recorder", "viewer", "operator"
        ]
    ]
    """The part that its holder has in a run."""
    days: int = DAYS
    """Days for which the certificate holds."""

    def run(self) -> int:
        """Writes the file; 0."""
        from saltus.wire.certificates import issue_certificate

        path = issue_certificate(self.keys, self.role, self.days)
        print(
            f"{path}: give it to its holder alone, who has it as client.json5 in the folder of the "
            "run"
        )
        return 0


@dataclass(frozen=True, kw_only=True)
class Revoke(_KeysOption):
    """Takes a certificate off the list of those that may do anything.

    A router reads the list when it starts.

    Example: saltus keys revoke viewer-1f3a0b77
    """

    name: tyro.conf.Positional[str]
    """Name of the certificate, see saltus keys list."""

    def run(self) -> int:
        """Changes the list; 0."""
        from saltus.wire.certificates import revoke_certificate

        revoke_certificate(self.keys, self.name)
        print(f"{self.name} may do nothing at a router that starts from now on: start yours anew")
        return 0


@dataclass(frozen=True, kw_only=True)
class ListKeys(_KeysOption, JsonOption):
    """Shows who may join.

    Example: saltus keys list --keys keys
    """

    def run(self) -> int:
        """Prints; 0."""
        from dataclasses import asdict

        from saltus.wire.certificates import load_authority

        known = load_authority(self.keys)
        if self.json:
            print_json(
                {"address": known.address, "issued": [asdict(each) for each in known.issued]}
            )
            return 0
        for each in known.issued:
            print(
                f"{each.name:24}{each.role:12}{'revoked' if each.revoked else f'until {each.until}'}"
            )
        return 0


Commands = (
    Annotated[Init, tyro.conf.subcommand("init")]
    | Annotated[Issue, tyro.conf.subcommand("issue")]
    | Annotated[Revoke, tyro.conf.subcommand("revoke")]
    | Annotated[ListKeys, tyro.conf.subcommand("list")]
)


@dataclass(frozen=True, kw_only=True)
class KeysCommands(CommandGroup):
    """Certificates for those who join a run over a network."""

    command: Subcommands[Commands]
