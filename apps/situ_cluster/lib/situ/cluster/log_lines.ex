defmodule Situ.Cluster.LogLines do
  @moduledoc false
  # Keeps the last lines that each node has logged, and makes them readable from any node:
  # `bin/situ cluster logs`.
  #
  # A handler of Erlang's logger stores the last 2,000 lines of a node in a table. A line has at
  # most 4,000 characters and is meant for people. Anybody with the cluster's cookie can read the
  # lines.
  @max_lines 2_000
  @max_characters 4_000
  # This key holds the last line number; all other keys are line numbers.
  @counter :last

  @typedoc "`n` increases by one from line to line; `time` is ns since 1970."
  @type line :: %{n: pos_integer(), time: Situ.Time.t(), level: atom(), text: String.t()}

  @doc "Starts storing lines in a table that belongs to the calling process and ends with it."
  @spec start_handler() :: :ok
  def start_handler do
    if :ets.whereis(__MODULE__) == :undefined do
      :ets.new(__MODULE__, [:named_table, :public, :ordered_set])
      :ets.insert(__MODULE__, {@counter, 0})
    end

    _ = :logger.remove_handler(__MODULE__)

    # Supervisors report every process they start, for example for each TLS connection; this is not worth a line.
    filters = [progress: {&:logger_filters.progress/2, :stop}]
    :logger.add_handler(__MODULE__, __MODULE__, %{level: :info, filters: filters})
  end

  @doc "Returns the newest lines (at most `max`) after line number `from`, oldest first."
  @spec read(non_neg_integer(), pos_integer()) :: [line()]
  def read(from \\ 0, max \\ @max_lines) do
    rows =
      :ets.select(__MODULE__, [
        {{:"$1", :"$2"}, [{:is_integer, :"$1"}, {:>, :"$1", from}], [{{:"$1", :"$2"}}]}
      ])

    for {n, {time, level, text}} <- Enum.take(rows, -max),
        do: %{n: n, time: time, level: level, text: text}
  rescue
    # This node is not, or is no longer, a member.
    ArgumentError -> []
  end

  # Logger calls this function in the process that logs the event.
  @doc false
  @spec log(:logger.log_event(), :logger.handler_config()) :: term()
  def log(%{level: level, meta: %{time: time}} = event, _config) do
    text =
      event
      |> :logger_formatter.format(%{single_line: true, template: [:msg]})
      |> IO.chardata_to_string()
      |> String.slice(0, @max_characters)

    n = :ets.update_counter(__MODULE__, @counter, 1)
    :ets.insert(__MODULE__, {n, {time * 1_000, level, text}})
    :ets.delete(__MODULE__, n - @max_lines)
  rescue
    # The table ends with the node's membership, and logging must not fail because of it.
    _ in [ArgumentError, UnicodeConversionError] -> :ok
  end
end
