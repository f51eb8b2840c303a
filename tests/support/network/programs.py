"""A paired robot and station at the two ends of an emulated network: what each needs before it starts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from shared.access import Role
from shared.certificates import open_identity
from shared.token_book import TokenBook
from station.access.paired_robots import PairedRobot, PairedRobots
from station.access.visitors import access_folder
from tests.support.access import NOW, set_up
from tests.support.network.emulator import Network

ROBOT_PORT, SIM_PORT, PAGE_PORT = 7400, 7401, 8080  # nobody else's: the namespaces are new


@dataclass(frozen=True, slots=True)
class Ends:
    """Where the robot's settings are, and its address as the station knows it."""

    robot_config: Path
    robot_address: str

    @classmethod
    def paired(cls, network: Network, folder: Path, data: Path, world: str, seed: int) -> Ends:
        """Key, certificate and token, as pairing leaves them behind; `data` is the station's folder."""
        host, keys = network.robot.address, set_up(folder / "robot-access")
        token = TokenBook(keys).add("station", Role.DRIVE, NOW.timestamp())
        fingerprint = open_identity(keys).fingerprint.hex()
        PairedRobots(access_folder(data)).store(
            PairedRobot(
                robot_id="robot", name="Robot", host=host, port=ROBOT_PORT, fingerprint=fingerprint, token=token.text
            )
        )
        config = folder / "robot.toml"
        config.write_text(
            f'[identity]\nid = "robot"\n[server]\nhost = "{host}"\nport = {ROBOT_PORT}\n[access]\nfolder = "{keys}"\n'
            f'[simulated]\nworld = "{world}"\nseed = {seed}\nsim_port = {SIM_PORT}\n'
        )
        return cls(config, f"{host}:{ROBOT_PORT}")
