# Loaded by `iex -S mix`.
import Situ.Time, only: [ms: 1, s: 1]
alias Situ.{Message, Pipeline, Store, Time}

IO.puts("""
Situ: `{:ok, p} = Situ.Pipeline.start_link(fn p -> ... end)`, then `Situ.inspect(p)` or `Situ.Pipeline.info(p)`.
`h Situ` explains the operators; `Situ.to_list(stream_fun)` runs a small pipeline and gives its messages.
""")
