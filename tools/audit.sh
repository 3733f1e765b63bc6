#!/bin/sh
# Looks the pinned versions up among known vulnerabilities, where pip-audit can be had and its database answers.
# Exit status 1 where it finds one; where it can't run, that is said and is no failure.
set -u
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$1" -m venv "$scratch/venv" # pip-audit brings packages of its own
python=$scratch/venv/bin/python
if ! "$python" -m pip --disable-pip-version-check --quiet install pip-audit 2>/dev/null; then
    echo "audit: pip-audit can't be had here: nothing was looked up"
    exit 0
fi
said=$("$python" -m pip_audit --requirement constraints.txt --no-deps --disable-pip --progress-spinner off 2>&1)
status=$?
case $said in
*"No known vulnerabilities found"*) echo "audit: no known vulnerabilities" ;;
*"known vulnerabilit"*)
    echo "$said"
    exit 1
    ;;
*) echo "audit: pip-audit could not look anything up (exit status $status): $(printf %s "$said" | tail -n 1 | cut -c1-120)" ;;
esac
