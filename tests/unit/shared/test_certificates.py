"""A key and certificate that a person put in place of ours: used, or refused in a sentence."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.asymmetric.types import CertificateIssuerPrivateKeyTypes
from cryptography.x509.oid import NameOID

from shared.certificates import fingerprint_of_der, make_identity, open_identity
from shared.errors import ConfigError

PEM = serialization.Encoding.PEM
ONE, OTHER = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))


def certificate(key: CertificateIssuerPrivateKeyTypes) -> x509.Certificate:
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "station.home")])
    now = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .sign(key, hashes.SHA256())
    )


def pem(key: CertificateIssuerPrivateKeyTypes, password: bytes = b"") -> bytes:
    hidden = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    return key.private_bytes(PEM, serialization.PrivateFormat.PKCS8, hidden)


def put(folder: Path, key: bytes, chain: bytes) -> Path:
    (folder / "key.pem").write_bytes(key)
    (folder / "key.pem").chmod(0o600)
    (folder / "certificate.pem").write_bytes(chain)
    return folder


WEAK = rsa.generate_private_key(65537, 1024)
MINE = certificate(ONE).public_bytes(PEM)


@pytest.mark.parametrize(
    ("key", "chain", "said"),
    [
        (pem(WEAK), certificate(WEAK).public_bytes(PEM), "too short, RSA needs 2048 bits"),
        (pem(OTHER), MINE, "the key belongs to another certificate"),
        (pem(WEAK), MINE, "the key belongs to another certificate"),
        (pem(ONE, b"secret"), MINE, "the key has a password"),
        (b"none", MINE, "key.pem holds no key"),
        (pem(ONE), b"none", "certificate.pem holds no certificate"),
        (pem(ONE), b"\xff\xfe", "certificate.pem holds no certificate"),
        (pem(ONE), b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n", "holds no certificate"),
        (pem(ONE), MINE[:200] + MINE[-30:], "certificate.pem holds no certificate"),
    ],
)
def test_what_cannot_be_used_is_a_sentence(tmp_path: Path, key: bytes, chain: bytes, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        open_identity(put(tmp_path, key, chain))
    assert "ssl" not in str(refused.value).lower() and "Errno" not in str(refused.value)
    assert "\n" not in str(refused.value) and "access init --renew" in str(refused.value)


def test_a_chain_with_words_before_it_is_used_and_known_by_its_first_certificate(tmp_path: Path) -> None:
    chain = b"subject=CN = station.home\n" + MINE + certificate(OTHER).public_bytes(PEM)
    der = x509.load_pem_x509_certificate(MINE).public_bytes(serialization.Encoding.DER)
    assert open_identity(put(tmp_path, pem(ONE), chain)).fingerprint == fingerprint_of_der(der)


@pytest.mark.parametrize("name", ["../x", 300 * "a"])
def test_a_name_that_no_host_has_is_a_sentence_and_the_old_certificate_stays(tmp_path: Path, name: str) -> None:
    now = datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC)
    before = make_identity(tmp_path, "station", ["station.home"], 1, now)
    with pytest.raises(ConfigError, match="is no host name"):
        make_identity(tmp_path, "station", [name], 1, now)
    assert open_identity(tmp_path).fingerprint == before.fingerprint
