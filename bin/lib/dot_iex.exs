# Loaded by `situ iex`.
import Situ.Time, only: [ms: 1, s: 1]
alias Situ.{Message, Pipeline, Store, Time}
Situ.CLI.Interactive.start(System.get_env("SITU_IEX_FILE", ""))
