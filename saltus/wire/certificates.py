"""A small certificate authority in a folder:
who may join a run's router over a network, and in which role.
"""

import ipaddress
import secrets
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from saltus.config import load_config as read_toml_file
from saltus.config import to_toml
from saltus.errors import ConfigError, check_known, nearest_hint
from saltus.files import atomic_write
from saltus.wire.joining import ClientCertificate, write_client
from saltus.wire.roles import ROLES, access_control
from saltus.wire.router import NetworkAccess

STATE = "keys.toml"
AUTHORITY = "authority"
ROUTER = "router"
PRIVATE_SUFFIXES = (".internal", ".local", ".lan", ".home.arpa")
"""Suffixes of names for which no public authority issues certificates."""
_AUTHORITY_DAYS = 3650


@dataclass(frozen=True, kw_only=True)
class IssuedCertificate:
    """One certificate that was issued."""

    name: str
    """Its common name, which no other has."""
    role: str
    serial: str
    """In hexadecimal digits."""
    until: str
    """Its last day, ISO 8601."""
    revoked: bool = False


@dataclass(frozen=True, kw_only=True)
class AuthorityKeys:
    """State of an authority, which its folder holds beside keys and certificates."""

    address: str
    """Address of the router, as others connect to it: host:port."""
    issued: tuple[IssuedCertificate, ...] = ()

    @property
    def names(self) -> dict[str, str]:
        """Role of each certificate that may join, by its common name."""
        return {
            each.name: each.role for each in self.issued if not each.revoked and each.role != ROUTER
        }


def create_authority(folder: Path, address: str, days: int) -> AuthorityKeys:
    """Makes an authority, and a certificate for a router at `address`, host:port.

    Raises:
        ConfigError: the folder has one already, or a public authority might issue a certificate for
            the host.
    """
    host = host_of(address)
    if (folder / STATE).exists():
        raise ConfigError(
            f"{folder} holds an authority already: its certificates would be worth nothing; name "
            "another"
        )
    if not _private(host):
        hint = f"a private address, or a name that ends in {', '.join(PRIVATE_SUFFIXES)}"
        raise ConfigError(
            f"'{host}' might get a certificate from a public authority, which clients trust too: "
            f"{hint}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    key = _new_key()
    name = _name(f"saltus {secrets.token_hex(4)}")
    constraints = x509.BasicConstraints(ca=True, path_length=0)
    certificate = _builder(name, name, key, _AUTHORITY_DAYS).add_extension(
        constraints, critical=True
    )
    _write(folder, AUTHORITY, _pem(key), certificate.sign(key, hashes.SHA256()))
    keys, router = _issue(folder, AuthorityKeys(address=address), ROUTER, days)
    _write(folder, ROUTER, router.key, x509.load_pem_x509_certificate(router.certificate))
    return keys


def issue_certificate(folder: Path, role: str, days: int) -> Path:
    """Makes a certificate for a role.

    Returns the one file that its holder needs, and nobody else should have.

    Raises:
        ConfigError: there is no authority, or no such role.
    """
    check_known("there is no role", role, ROLES)
    keys, certificate = _issue(folder, load_authority(folder), role, days)
    path = folder / f"{keys.issued[-1].name}.json5"
    write_client(path, f"tls/{keys.address}", certificate)
    return path


def revoke_certificate(folder: Path, name: str) -> None:
    """Takes a certificate off the list of those that may do anything,
    from the router's next start on.

    Raises:
        ConfigError: there is no authority, or no such certificate that may join.
    """
    keys = load_authority(folder)
    if name not in keys.names:
        raise ConfigError(f"no certificate '{name}' may join: {nearest_hint(name, keys.names)}")
    issued = tuple(replace(each, revoked=each.revoked or each.name == name) for each in keys.issued)
    _save(folder, replace(keys, issued=issued))


def load_authority(folder: Path) -> AuthorityKeys:
    """Reads the folder of an authority; `ConfigError` where there is none."""
    if not (folder / STATE).is_file():
        raise ConfigError(f"{folder} holds no authority: saltus keys init makes one")
    return read_toml_file(AuthorityKeys, folder / STATE)


def network_of(folder: Path, listen: str, prefix: str) -> NetworkAccess:
    """How a router lets in over a network whom the authority in `folder` knows.

    Args:
        folder: Of the authority.
        listen: Address of this machine, host:port.
        prefix: Of the robot's keys.
    """
    host_of(listen)
    keys = load_authority(folder)
    return NetworkAccess(
        listen=f"tls/{listen}",
        certificate=_read(folder, ROUTER),
        access_control=access_control(keys.names, prefix),
    )


def host_of(address: str) -> str:
    """The host of host:port; `ConfigError` where it is none."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigError(f"'{address}' is no address: one looks like 192.168.123.10:7447")
    return host.strip("[]")


def _private(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_private
    except ValueError:
        return "." not in host or host.endswith(PRIVATE_SUFFIXES)


def _issue(
    folder: Path, keys: AuthorityKeys, role: str, days: int
) -> tuple[AuthorityKeys, ClientCertificate]:
    """Signs a certificate for a new key and puts it on the list."""
    own, key = _read(folder, AUTHORITY), _new_key()
    try:
        signer = serialization.load_pem_private_key(own.key, None)
        issuer = x509.load_pem_x509_certificate(own.certificate).subject
    except ValueError as error:
        raise ConfigError(f"the authority in {folder} is damaged: {error}") from error
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise ConfigError(f"the authority in {folder} is not one of saltus keys init")
    name = ROUTER if role == ROUTER else f"{role}-{secrets.token_hex(4)}"
    usages = [
        ExtendedKeyUsageOID.SERVER_AUTH if role == ROUTER else ExtendedKeyUsageOID.CLIENT_AUTH
    ]
    certificate = (
        _builder(_name(name), issuer, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        .add_extension(
            x509.SubjectAlternativeName([_alternative(role, name, keys)]), critical=False
        )
        .sign(signer, hashes.SHA256())
    )
    until = certificate.not_valid_after_utc.date().isoformat()
    one = IssuedCertificate(
        name=name, role=role, serial=f"{certificate.serial_number:x}", until=until
    )
    keys = replace(keys, issued=(*keys.issued, one))
    _save(folder, keys)
    text = certificate.public_bytes(serialization.Encoding.PEM)
    return keys, ClientCertificate(authority=own.certificate, certificate=text, key=_pem(key))


def _alternative(role: str, name: str, keys: AuthorityKeys) -> x509.GeneralName:
    host = host_of(keys.address) if role == ROUTER else f"{name}.internal"
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _builder(subject: x509.Name, issuer: x509.Name, key: Any, days: int) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))  # clocks of robots are set late
        .not_valid_after(now + timedelta(days=days))
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(folder: Path, name: str, key: bytes, certificate: x509.Certificate) -> None:
    _private_file(folder / f"{name}.key").write_bytes(key)
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))


def _read(folder: Path, name: str) -> ClientCertificate:
    files = (f"{AUTHORITY}.pem", f"{name}.pem", f"{name}.key")
    try:
        authority, certificate, key = ((folder / file).read_bytes() for file in files)
    except OSError as error:
        raise ConfigError(f"{error.filename} cannot be read: {error.strerror}") from error
    return ClientCertificate(authority=authority, certificate=certificate, key=key)


def _save(folder: Path, keys: AuthorityKeys) -> None:
    with atomic_write(folder / STATE) as new:
        _private_file(new).write_text(to_toml(keys), encoding="utf-8")


def _private_file(path: Path) -> Path:
    path.unlink(missing_ok=True)
    path.touch(mode=0o600)
    return path
