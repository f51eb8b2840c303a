"""How long this machine makes a waiting process wait: `python -m tests.support.stopping.canary FILE`.

It runs at the chain's priority and asks to be woken every 5 ms. Where that is more than 1 ms late, one line says when
(monotonic ns) and how late (ns).
"""

from __future__ import annotations

import os
import sys
import time

PERIOD_NS = 5_000_000
WORTH_SAYING_NS = 1_000_000


def main() -> None:
    fd = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    parent = os.getppid()
    while os.getppid() == parent:
        due_ns = time.monotonic_ns() + PERIOD_NS
        time.sleep(PERIOD_NS * 1e-9)
        now_ns = time.monotonic_ns()
        if now_ns - due_ns > WORTH_SAYING_NS:
            os.write(fd, b"%d %d\n" % (now_ns, now_ns - due_ns))


if __name__ == "__main__":
    main()
