"""A program's own certificate, and TLS with peers that are known by theirs: the fingerprint is the name.

`cryptography` is imported only where a certificate is made: who stays on loopback needs no package more.
"""

from __future__ import annotations

import datetime
import hashlib
import ipaddress
import re
import ssl
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from shared.bounded import shown
from shared.errors import ConfigError
from shared.private_files import make_private_folder, read_private, write_private

if TYPE_CHECKING:
    from cryptography import x509

KEY_NAME = "key.pem"
CERTIFICATE_NAME = "certificate.pem"
HANDSHAKE_WITHIN_S = 3.0  # as long as a stranger may take to join


# By OpenSSL's names.
_TOO_WEAK = "a certificate of the chain above it is too weak"
_UNUSABLE = {
    "EE_KEY_TOO_SMALL": "its key is too short, RSA needs 2048 bits",
    "CA_KEY_TOO_SMALL": _TOO_WEAK,
    "CA_MD_TOO_WEAK": _TOO_WEAK,
    "KEY_VALUES_MISMATCH": "the key belongs to another certificate",
    "KEY_TYPE_MISMATCH": "the key belongs to another certificate",
    "NO_CERTIFICATE_ASSIGNED": "the key belongs to another certificate",  # one of another kind
}
_PEM = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)


class _HasPassword(Exception):
    """Of a key."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Key and certificate of one program."""

    key: Path
    certificate: Path
    fingerprint: bytes  # SHA-256 of the certificate (DER)

    def server_context(self) -> ssl.SSLContext:
        """TLS 1.3 for the robot link."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.load_cert_chain(self.certificate, self.key, _refuse_password)
        return context


def open_identity(folder: Path) -> Identity:
    """Raises ConfigError: there is none, or it cannot be used."""
    key, certificate = folder / KEY_NAME, folder / CERTIFICATE_NAME
    if read_private(key) is None or not certificate.is_file():
        raise ConfigError(f"{folder} holds no key and certificate; make them with `access init`")
    remedy = "put a certificate and its key there, or run `access init --renew`"
    try:
        der = first_certificate(certificate.read_text("ascii", errors="replace"))
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cadata=der)  # parses it
    except (OSError, ValueError) as exc:  # ssl.SSLError is an OSError
        raise ConfigError(f"{certificate} holds no certificate (PEM) that can be read; {remedy}") from exc
    identity = Identity(key, certificate, fingerprint_of_der(der))
    try:
        identity.server_context()
    except _HasPassword as exc:
        raise ConfigError(
            f"{key} cannot be used: the key has a password, for which nobody can be asked; {remedy}"
        ) from exc
    except OSError as exc:
        reason = getattr(exc, "reason", None) or ""
        why = _UNUSABLE.get(reason, f"{KEY_NAME} holds no key (PEM) that can be read")
        raise ConfigError(f"{certificate} and {key} cannot be used: {why}; {remedy}") from exc
    return identity


def _refuse_password() -> str:
    """In place of OpenSSL's own way, which would ask at the terminal and wait."""
    raise _HasPassword


def make_identity(folder: Path, common_name: str, names: Iterable[str], days: int, now: datetime.datetime) -> Identity:
    """A new key and self-signed certificate in place of the old ones.

    Args:
        names: names and addresses that browsers and other programs reach it by.
        days: until when others than pinning peers take it for valid.
    Raises:
        ConfigError: the folder cannot be written, or `cryptography` is not installed.
    """
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
    except ImportError as exc:
        raise ConfigError(
            f"certificates need {exc.name}, which is not installed; install sentinel-robot with [robot] or [station]"
        ) from exc
    make_private_folder(folder)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name[:64])])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName([_general_name(name) for name in dict.fromkeys(names)]), False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), False)
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    form = serialization.PrivateFormat.PKCS8
    write_private(folder / KEY_NAME, key.private_bytes(pem, form, serialization.NoEncryption()))
    write_private(folder / CERTIFICATE_NAME, certificate.public_bytes(pem))
    return open_identity(folder)


def _general_name(name: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        pass
    try:
        return x509.DNSName(name.encode("idna").decode())
    except UnicodeError as exc:
        raise ConfigError(f"{shown(name)} is no host name: its labels have 1 to 63 characters") from exc


def days_left(identity: Identity, now: datetime.datetime) -> float:
    """How long browsers still take the certificate for valid."""
    from cryptography import x509

    certificate = x509.load_pem_x509_certificate(identity.certificate.read_bytes())
    return (certificate.not_valid_after_utc - now).total_seconds() / 86_400


def first_certificate(text: str) -> bytes:
    """The first one (DER) of a file: those that vouch for it may follow, and words stand before. Raises ValueError."""
    found = _PEM.search(text)
    if found is None:
        raise ValueError("no certificate in PEM form")
    return ssl.PEM_cert_to_DER_cert(found[0])


def fingerprint_of_der(der: bytes) -> bytes:
    return hashlib.sha256(der).digest()


def show_fingerprint(fingerprint: bytes) -> str:
    """As browsers show a certificate's SHA-256, for people who compare the two."""
    return ":".join(f"{byte:02x}" for byte in fingerprint)


def pinning_context() -> ssl.SSLContext:
    """TLS to a peer that is recognised by its fingerprint afterwards, before a word is said.

    No authority could vouch for a robot, and its clock may be wrong: OpenSSL is to check neither name nor date.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context
