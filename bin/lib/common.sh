# Shared by every script in bin/: the project's location, messages, long steps and virtual machines. Source this file.
set -Eeuo pipefail
# Reports the location of an unexpected failure.
trap 'printf "situ: %s failed at line %s: %s\n" "${0##*/}" "$LINENO" "$BASH_COMMAND" >&2' ERR

SITU_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
export SITU_ROOT
SITU_STATE="$SITU_ROOT/.situ"
NPM_MARK=node_modules/.package-lock.json

# These variables decide which code a virtual machine loads. They are meant for mix and iex, which do not use
# this file.
unset ERL_LIBS ERL_FLAGS ERL_AFLAGS ERL_ZFLAGS ERL_COMPILER_OPTIONS ERL_INETRC ERL_ROOTDIR ELIXIR_ERL_OPTIONS
unset "${!ERL_OTP@}"

# Elixir requires a UTF-8 locale, and a minimal system sets none.
case "${LC_ALL:-${LC_CTYPE:-${LANG:-}}}" in
  *UTF-8* | *utf8* | *utf-8*) ;;
  *) export LC_ALL=C.UTF-8 ;;
esac

# rustup installs to this folder, which is on the PATH only in new shells.
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

# version_at_least HAVE WANT: succeeds if HAVE >= WANT, compared number by number.
version_at_least() { [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]; }

check_writable() {
  mkdir -p "$SITU_STATE/log" 2>/dev/null ||
    fail "cannot write to $SITU_ROOT" "the checkout is read-only" "copy it to a writable folder"
}

# step LABEL COMMAND...: runs a long command with its output in a log, and shows the end of the log on failure. On a
# terminal, one line counts the seconds; otherwise it prints one line per minute.
step() {
  local label=$1 log started now said=0
  shift
  check_writable
  log="$SITU_STATE/log/$(printf '%s' "$label" | tr -cs 'A-Za-z0-9' '-' | cut -c1-40).log"
  started=$(date +%s)
  # A separate process group would not receive Ctrl-C. A plain background job does, and ends with this script.
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
    # Ctrl-C ends it, too, which is not an error of this script.
    sleep 0.2 || true
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

# built_since STAMP FOLDER...: succeeds if no source file is newer than STAMP.
built_since() {
  local stamp=$1
  shift
  [ -f "$stamp" ] && [ -z "$(find "$@" \( -name node_modules -o -name __pycache__ -o -name target -o -name _build -o -name tmp \
    -o -path '*/priv/native' -o -path '*/priv/static' -o -path '*/priv/onnxruntime' \) -prune \
    -o -type f -newer "$stamp" -print -quit 2>/dev/null)" ]
}

# build_prod: compiles everything for use if a source changed since the last build. Programs that start simultaneously
# wait for the first one to build.
build_prod() {
  local stamp="$SITU_ROOT/_build/prod/.built" lock
  cd "$SITU_ROOT"
  built_since "$stamp" apps clients/python/src native config mix.exs && return
  check_writable
  exec {lock}>"$SITU_STATE/build.lock"
  flock --nonblock "$lock" || { say "Waiting for another build ..." && flock "$lock"; }
  if ! built_since "$stamp" apps clients/python/src native config mix.exs; then
    MIX_ENV=prod step "Building Situ (minutes the first time, seconds later)" mix compile ||
      fail "the build failed" "see the messages above" "fix the code, or run bin/setup if a tool or library is missing"
    touch "$stamp"
  fi
  exec {lock}>&-
}

# elixir_prod ARGS...: runs elixir on the production build, without mix. Ctrl-C ends it with the usual status (130).
# elixir_plain ARGS...: does the same without the flags of a release.
elixir_prod() { elixir_with "$(release_flags)" "$@"; }
elixir_plain() { elixir_with "" "$@"; }
release_flags() {
  local file=$SITU_ROOT/rel/vm.args.eex
  if in_release; then file=$(release_folder)/vm.args; fi
  grep '^[+-]' "$file" | tr '\n' ' '
}

# in_release: succeeds if this file belongs to a release, which needs neither mix nor a build.
in_release() { [ -d "$SITU_ROOT/releases" ]; }
release_folder() { dirname "$SITU_ROOT"/releases/*/start_clean.boot; }

elixir_with() {
  local flags=$1 colours=
  shift
  if [ -t 1 ] && [ -t 2 ] && [ -z "${NO_COLOR:-}" ]; then colours="-elixir ansi_enabled true"; fi
  start_vm "$flags $colours" -s elixir start_cli -extra "$@"
}

# situ_prod ARGS...: runs the command line. It is started by erl, because the program elixir rejects arguments that are
# not UTF-8, such as some file names. An escript cannot contain the native libraries, and the `eval` of a release
# changes its arguments. `bin/situ --version` takes about 0.3 s of CPU time, nearly all of it for the start of the VM.
situ_prod() { start_vm "$(release_flags)" -s Elixir.Situ.CLI start -extra "$@"; }

# situ_draining ARGS...: runs the command line so that Ctrl-C, and SIGTERM, end it in an orderly way: the machine
# receives SIGTERM, delivers its last messages and closes its recordings. A second Ctrl-C kills it. This script waits,
# because a virtual machine cannot handle SIGINT.
situ_draining() {
  local status=0 stops=0
  (
    trap '' INT
    start_vm "$(release_flags) +Bi" -s Elixir.Situ.CLI start -extra "$@"
  ) <&0 &
  vm=$!
  # shellcheck disable=SC2317
  stop_vm() {
    stops=$((stops + 1))
    if [ "$stops" -eq 1 ]; then kill -TERM "$vm" 2>/dev/null; else kill -KILL "$vm" 2>/dev/null; fi || true
  }
  trap stop_vm INT TERM
  # A signal ends `wait`, but not the machine.
  while :; do
    status=0
    wait "$vm" 2>/dev/null || status=$?
    kill -0 "$vm" 2>/dev/null || break
  done
  # A killed machine leaves its last status line on the terminal.
  if [ "$stops" -gt 1 ]; then printf '\n' >&2; status=130; fi
  exit "$status"
}

# start_vm FLAGS ARGS...: replaces this process by a virtual machine with the production build. It loads no code from
# the current folder.
#
# Erlang's code server always starts with "." in its path and searches it for the modules of its own startup. The
# machine therefore starts in a folder of this checkout, removes "." from its path before anything else runs, and only
# then changes to the caller's folder. It uses a file handle, because the folder's name may not be UTF-8. It does not
# read .erlang (no_dot_erlang).
start_vm() {
  local erl elixir code flags=$1
  shift
  enter_start_folder
  if in_release; then
    erl=("$SITU_ROOT"/erts-*/bin/erl -boot "$(release_folder)/start_clean" -boot_var RELEASE_LIB "$SITU_ROOT/lib")
    code=("$SITU_ROOT"/lib/*/ebin)
  else
    elixir=$(dirname "$(dirname "$(readlink -f "$(command -v elixir)")")")
    erl=(erl -boot no_dot_erlang)
    code=("$elixir"/lib/*/ebin $(find_yaws) "$SITU_ROOT"/_build/prod/lib/*/ebin)
  fi
  # A crash dump contains the entire memory, including tokens, so none is written unless ERL_CRASH_DUMP names a file.
  [ -n "${ERL_CRASH_DUMP:-}" ] || export ERL_CRASH_DUMP_SECONDS=0
  # Standard output is for results, so the loggers of Erlang and Elixir write to standard error. As in Elixir's logger,
  # supervisor reports are omitted: a reader that closes the pipe early (head) should not cause one.
  local erlang_log="[{handler,default,logger_std_h,#{config=>#{type=>standard_error},"
  erlang_log+="filters=>[{reports,{fun'logger_filters':domain/2,{stop,sub,[otp,sasl]}}}]}}]"
  local lines='{format,<<"$time [$level] $message\n">>}'
  if [ "${SITU_LOG_FORMAT:-}" = json ]; then lines="{format,{'Elixir.Situ.JsonLog',format}},{metadata,all}"; fi
  # shellcheck disable=SC2086
  exec "${erl[@]}" -noshell +Bd $flags -pa "${code[@]}" \
    -kernel logger "$erlang_log" \
    -logger console "[{device,standard_error},$lines]" \
    -run code del_path . -run file set_cwd / -run file set_cwd "$caller_folder" "$@"
}

find_yaws() { ls -d /usr/lib/yaws-*/ebin 2>/dev/null | head -n 1 || true; }

# enter_start_folder: changes to the folder where machines start, and sets caller_folder, by which a machine returns.
enter_start_folder() {
  local handle here=$PWD
  # A folder that cannot be listed cannot be opened either, so the machine changes to it by name.
  if { exec {handle}<.; } 2>/dev/null && [ -d "/dev/fd/$handle/" ]; then caller_folder=/dev/fd/$handle; else caller_folder=$here; fi
  cd "$SITU_ROOT/bin/lib"
}

# situ_iex [FILE]: opens Elixir's shell on the production build, with FILE or the project of the current folder.
situ_iex() {
  local iex=(iex --erl "-boot no_dot_erlang") code
  enter_start_folder
  export SITU_IEX_FILE=${1:-}
  code="$(find_yaws) $(printf '%s ' "$SITU_ROOT"/_build/prod/lib/*/ebin)"
  if in_release; then
    ERTS_BIN=$(echo "$SITU_ROOT"/erts-*/bin/)
    export ERTS_BIN
    iex=("$(release_folder)/iex" --boot "$(release_folder)/start_clean" --boot-var RELEASE_LIB "$SITU_ROOT/lib")
    code=$(printf '%s ' "$SITU_ROOT"/lib/*/ebin)
  fi
  exec "${iex[@]}" --dot-iex "$SITU_ROOT/bin/lib/dot_iex.exs" --erl "$(release_flags) -pa $code \
    -run code del_path . -run file set_cwd / -run file set_cwd $caller_folder"
}
