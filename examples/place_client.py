"""Ask a station which room its robot is in, and at which place; nothing but Python's standard library.

python examples/place_client.py [--station http://127.0.0.1:8080] [--follow]
A station that others reach asks who you are: --token TOKEN --certificate station-data/access/certificate.pem
"""

from __future__ import annotations

import argparse
import json
import ssl
import sys
import time
import urllib.error
import urllib.request
from typing import Any

POLL_S = 0.5


class Station:
    """The calls of docs/api.md, as far as this example needs them."""

    def __init__(self, address: str, token: str = "", certificate: str | None = None) -> None:
        self.address = address.rstrip("/")
        self.headers = {"Content-Type": "application/json", "X-Driver": "place_client"}
        if token:
            self.headers["Authorization"] = f"Bearer {token}"
        tls = urllib.request.HTTPSHandler(context=ssl.create_default_context(cafile=certificate))
        # Directly: a proxy of the network knows no loopback.
        self.opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), tls)

    def call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """One call. Raises RuntimeError with the station's own sentence."""
        request = urllib.request.Request(
            self.address + path,
            method=method,
            data=None if body is None else json.dumps(body).encode(),
            headers=self.headers,
        )
        try:
            with self.opener.open(request, timeout=10) as answer:
                text = answer.read()
        except urllib.error.HTTPError as exc:
            raise RuntimeError(json.load(exc)["detail"]) from exc  # errors are problem documents (RFC 9457)
        except OSError as exc:
            raise RuntimeError(f"no station at {self.address} ({exc}); start `station serve`") from exc
        return json.loads(text) if text else None

    def current_place(self) -> dict[str, Any]:
        answer: dict[str, Any] = self.call("GET", "/place/current")
        return answer

    def rename(self, place_id: str, name: str) -> None:
        self.call("PATCH", f"/places/{place_id}", {"name": name})


def sentence(answer: dict[str, Any]) -> str:
    """The answer as a person would say it."""
    place, room = answer["place"], answer["room"]
    words = [f"in {room['name']} ({room['probability']:.0%})"] if room else []
    if place and not answer["place_elsewhere"]:  # else it is another room's, behind a door
        away = "" if answer["distance_m"] is None else f", {answer['distance_m']:.1f} m from its middle"
        words.append(f"at {place['name']} ({answer['probability']:.0%}{away})")
    return f"{', '.join(words) or answer['state']}: {answer['reason']}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Ask a station which room its robot is in, and at which place.")
    parser.add_argument("--station", default="http://127.0.0.1:8080")
    parser.add_argument("--follow", action="store_true", help="say every change until Ctrl-C")
    parser.add_argument("--token", default="", help="from `station access add`")
    parser.add_argument("--certificate", help="the station's certificate.pem")
    options = parser.parse_args()
    station = Station(options.station, options.token, options.certificate)
    told = None
    try:
        while True:
            answer = station.current_place()
            room = answer["room"] and answer["room"]["id"]
            now = (answer["state"], answer["place"], room)
            if now != told:
                told = now
                print(sentence(answer), flush=True)
            if not options.follow:
                return 0 if answer["place"] or room else 1
            time.sleep(POLL_S)
    except RuntimeError as exc:
        print(f"place_client: {exc}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0


if __name__ == "__main__":
    sys.exit(main())
