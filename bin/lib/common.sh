# Shared by every script in bin/: where the project is, how to speak, how to run a long step. Sourced, not run.
set -Eeuo pipefail
# A failure nobody foresaw still says where it was.
trap 'printf "situ: %s failed at line %s: %s\n" "${0##*/}" "$LINENO" "$BASH_COMMAND" >&2' ERR

SITU_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
export SITU_ROOT
SITU_STATE="$SITU_ROOT/.situ"
NPM_MARK=node_modules/.package-lock.json

# These variables decide which code a virtual machine loads. They are meant for mix and iex, which do not use
# this file.
unset ERL_LIBS ERL_FLAGS ERL_AFLAGS ERL_ZFLAGS ERL_COMPILER_OPTIONS ERL_INETRC ERL_ROOTDIR ELIXIR_ERL_OPTIONS
unset "${!ERL_OTP@}"

# Elixir wants a UTF-8 locale; a bare machine has none set.
case "${LC_ALL:-${LC_CTYPE:-${LANG:-}}}" in
  *UTF-8* | *utf8* | *utf-8*) ;;
  *) export LC_ALL=C.UTF-8 ;;
esac

# rustup installs here and asks for a new shell; a script needs no new shell.
[ -d "${CARGO_HOME:-$HOME/.cargo}/bin" ] && PATH="${CARGO_HOME:-$HOME/.cargo}/bin:$PATH"
export PATH

say() { printf '%s\n' "$*" >&2; }

# fail WHAT [WHY] [FIX]
fail() {
  say "situ: $1"
  [ -n "${2:-}" ] && say "  Why: $2"
  [ -n "${3:-}" ] && say "  Fix: $3"
  exit 1
}

have() { command -v "$1" >/dev/null 2>&1; }

# version_at_least HAVE WANT: true when HAVE >= WANT, compared number by number.
version_at_least() { [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]; }

check_writable() {
  mkdir -p "$SITU_STATE/log" 2>/dev/null ||
    fail "cannot write to $SITU_ROOT" "the checkout is read-only" "copy it to a folder you may write to"
}

# step LABEL COMMAND...: runs a long command with its output in a log, shows that it lives, and on failure the end of
# the log. On a terminal one line counts the seconds; elsewhere one line a minute is printed.
step() {
  local label=$1 log started now said=0
  shift
  check_writable
  log="$SITU_STATE/log/$(printf '%s' "$label" | tr -cs 'A-Za-z0-9' '-' | cut -c1-40).log"
  started=$(date +%s)
  # A process group of its own would not get Ctrl-C; the plain background job does, and is ended with us.
  "$@" >"$log" 2>&1 </dev/null &
  local pid=$!
  # shellcheck disable=SC2064
  trap "kill $pid 2>/dev/null; exit 130" INT TERM
  [ -t 2 ] || say "$label ..."
  while kill -0 "$pid" 2>/dev/null; do
    now=$(($(date +%s) - started))
    if [ -t 2 ]; then
      printf '\r%s ... %ds ' "$label" "$now" >&2
    elif [ $((now / 60)) -gt "$said" ]; then
      said=$((now / 60))
      say "$label ... ${said} min"
    fi
    sleep 0.2
  done
  local status=0
  wait "$pid" || status=$?
  trap - INT TERM
  now=$(($(date +%s) - started))
  if [ "$status" -eq 0 ]; then
    [ -t 2 ] && printf '\r%s: done in %ds      \n' "$label" "$now" >&2
    return 0
  fi
  [ -t 2 ] && printf '\n' >&2
  say "--- the end of $log:"
  tail -n 25 "$log" >&2
  say "---"
  return "$status"
}

# built_since STAMP FOLDER...: true when no source file is newer than STAMP.
built_since() {
  local stamp=$1
  shift
  [ -f "$stamp" ] && [ -z "$(find "$@" \( -name node_modules -o -name target -o -name _build -o -name tmp \
    -o -path '*/priv/native' -o -path '*/priv/static' -o -path '*/priv/onnxruntime' \) -prune \
    -o -type f -newer "$stamp" -print -quit 2>/dev/null)" ]
}

# build_prod: compiles everything for use, when a source changed since the last time. Programs that start at the same
# time wait for the first one to build.
build_prod() {
  local stamp="$SITU_ROOT/_build/prod/.built" lock
  cd "$SITU_ROOT"
  built_since "$stamp" apps native config mix.exs && return
  check_writable
  exec {lock}>"$SITU_STATE/build.lock"
  flock --nonblock "$lock" || { say "Waiting for another build ..." && flock "$lock"; }
  if ! built_since "$stamp" apps native config mix.exs; then
    MIX_ENV=prod step "Building Situ (minutes the first time, seconds later)" mix compile ||
      fail "the build failed" "see the messages above" "mend the code, or run bin/setup if a tool or library is missing"
    touch "$stamp"
  fi
  exec {lock}>&-
}

# elixir_prod ARGS...: runs elixir on the production build, without mix. Ctrl-C ends it, with the status people expect (130).
# elixir_plain: the same without the flags of a release.
elixir_prod() { elixir_with "$(release_flags)" "$@"; }
elixir_plain() { elixir_with "" "$@"; }
release_flags() { grep '^[+-]' "$SITU_ROOT/rel/vm.args.eex" | tr '\n' ' '; }

elixir_with() {
  local flags=$1 colours=
  shift
  if [ -t 1 ] && [ -t 2 ] && [ -z "${NO_COLOR:-}" ]; then colours="-elixir ansi_enabled true"; fi
  start_vm "$flags $colours" -s elixir start_cli -extra "$@"
}

# situ_prod ARGS...: the command line itself, started by erl: elixir's own start refuses arguments that are no UTF-8, which names of
# files may be.
situ_prod() { start_vm "$(release_flags)" -s Elixir.Situ.CLI start -extra "$@"; }

# start_vm FLAGS ARGS...: becomes a virtual machine with the production build, which loads nothing from the current
# folder.
#
# Erlang's code server always begins with "." in its path, and looks there for the modules of its own start. So the
# machine starts in a folder of this checkout, removes "." from its path before anything else runs, and only then enters
# the caller's folder. It enters by a handle, since the name may not be UTF-8. It does not read .erlang (no_dot_erlang).
start_vm() {
  local elixir yaws folder flags=$1 here=$PWD
  shift
  elixir=$(dirname "$(dirname "$(readlink -f "$(command -v elixir)")")")
  yaws=$(ls -d /usr/lib/yaws-*/ebin 2>/dev/null | head -n 1 || true)
  # A folder that may be entered but not listed has no handle, and is entered by its name.
  if { exec {folder}<.; } 2>/dev/null && [ -d "/dev/fd/$folder/" ]; then folder=/dev/fd/$folder; else folder=$here; fi
  cd "$SITU_ROOT/bin/lib"
  # A crash dump contains the whole memory, tokens too: none is written unless ERL_CRASH_DUMP names a file.
  [ -n "${ERL_CRASH_DUMP:-}" ] || export ERL_CRASH_DUMP_SECONDS=0
  # Standard output is for results: warnings of Erlang's and of Elixir's logger go to standard error. Reports of
  # supervisors stay out, as with Elixir's logger: a reader that closes the pipe early (head) is not worth one.
  local erlang_log="[{handler,default,logger_std_h,#{config=>#{type=>standard_error},"
  erlang_log+="filters=>[{reports,{fun'logger_filters':domain/2,{stop,sub,[otp,sasl]}}}]}}]"
  # shellcheck disable=SC2086
  exec erl -boot no_dot_erlang -noshell +Bd $flags \
    -pa "$elixir"/lib/*/ebin ${yaws:+"$yaws"} "$SITU_ROOT"/_build/prod/lib/*/ebin \
    -kernel logger "$erlang_log" -logger console '[{device,standard_error}]' \
    -run code del_path . -run file set_cwd / -run file set_cwd "$folder" "$@"
}
