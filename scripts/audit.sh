#!/usr/bin/env bash
# Known holes in what is installed (pip-audit asks an advisory database over the network) and in our own code (bandit).
# ADVISORIES=DIR: a copy of that database instead of the network (scripts/audit_copy.py).
# Exit code 0: both clean. 1: something was found. 3: the database was not reached or is old, so nothing is known of today.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=.venv/bin
$bin/bandit -q -c pyproject.toml -r robot station shared
echo "audit: bandit has nothing to say"
ignored_ids() { sed -n 's/^- `\([A-Z0-9-]*\)`.*/\1/p' docs/audit.md; }
if [ -n "${ADVISORIES:-}" ]; then
  # shellcheck disable=SC2046  # one option and one word each
  exec $bin/python scripts/audit_copy.py "$ADVISORIES" $(ignored_ids | sed 's/^/--ignore /')
fi
[ -x $bin/pip-audit ] || $bin/python -m pip install --disable-pip-version-check --quiet -c constraints.txt "pip-audit>=2.8"
report=$(mktemp)
trap 'rm -f "$report"' EXIT
ignored=$(ignored_ids | sed 's/^/--ignore-vuln /')
# shellcheck disable=SC2086  # one option and one word each
$bin/pip-audit --local --skip-editable --progress-spinner off --format json --output "$report" $ignored >/dev/null 2>&1 || true
$bin/python - "$report" <<'PYTHON'
"""pip-audit ends with 0 also when it could look up nothing; that is not clean."""
import json
import sys
from pathlib import Path

text = Path(sys.argv[1]).read_text()
packages = json.loads(text)["dependencies"] if text else []
asked = [p for p in packages if "vulns" in p]
found = [(p["name"], p["version"], v["id"], v["fix_versions"]) for p in asked for v in p["vulns"]]
for name, version, advisory, fixed in found:
    print(f"audit: {name} {version}: {advisory}, mended in {', '.join(fixed) or 'no release yet'}")
if found:
    sys.exit(1)
if len(asked) < len(packages) / 2 or not asked:
    print(f"audit: the advisory database knew {len(asked)} of {len(packages)} packages; is it reached from here?")
    sys.exit(3)
print(f"audit: no known hole in {len(asked)} packages")
PYTHON
