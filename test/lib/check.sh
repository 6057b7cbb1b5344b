# Counts and reports the checks of system tests that are shell scripts. Source this file.
# bin/test adds up the closing lines, `N passed, N failed`.
set -uo pipefail
ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
passed=0 failed=0

# check NAME COMMAND...: runs a check, which passes if the command succeeds.
check() {
  local name=$1
  shift
  if "$@" >"$WORK/check.log" 2>&1; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    echo "FAILED: $name"
    sed 's/^/    /' "$WORK/check.log" | tail -n 20
  fi
}

# run COMMAND...: runs a command with its output in $WORK/out and its exit status in $status.
run() {
  status=0
  "$@" >"$WORK/out" 2>&1 </dev/null || status=$?
}

# says TEXT...: succeeds if the last run printed every TEXT.
says() {
  local text
  for text in "$@"; do
    grep -qF -- "$text" "$WORK/out" || { echo "did not print: $text"; cat "$WORK/out"; return 1; }
  done
}

# exits STATUS: succeeds if the last run ended with this status.
# exits STATUS: succeeds if the last run ended with this status.
exits() { [ "$status" -eq "$1" ] || { echo "exit status $status, expected $1"; cat "$WORK/out"; return 1; }; }

finish() {
  echo "$passed passed, $failed failed"
  [ "$failed" -eq 0 ]
}
